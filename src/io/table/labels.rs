//! Columns of text. A column is stored as a list of its different texts, and for each row the
//! number of the row's text.

use std::collections::HashMap;
use std::sync::Mutex;

use crate::particles::Label;

/// Maximum number of different texts in a column.
const MOST_TEXTS: usize = 4096;

/// The different texts of a column in the rows that were decoded so far, with their numbers.
#[derive(Debug, Default)]
pub struct Texts(Mutex<HashMap<Vec<u8>, u32>>);

/// A thread's cache of texts and their numbers.
pub type Known = HashMap<Vec<u8>, u32>;

impl Texts {
    /// The number of a text. The number is arbitrary if the column has too many different texts.
    pub fn number(&self, known: &mut Known, text: &[u8]) -> u32 {
        if let Some(&number) = known.get(text) {
            return number;
        }
        let mut all = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let next = all.len() as u32;
        let number =
            if all.len() > MOST_TEXTS { next } else { *all.entry(text.to_owned()).or_insert(next) };
        if known.len() <= MOST_TEXTS {
            known.insert(text.to_owned(), number);
        }
        number
    }

    /// Returns the label, and a list that gives, for the number of each text, the index of this
    /// text in the label. Returns `None` if there are too many different texts.
    pub fn label(self, name: &str) -> Option<(Label, Vec<u32>)> {
        let all = self.0.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        if all.len() > MOST_TEXTS {
            return None;
        }
        // Sort the texts, because their numbers depend on the order in which threads found them.
        let mut texts: Vec<_> = all.into_iter().collect();
        texts.sort();
        let mut places = vec![0; texts.len()];
        for (place, (_, number)) in (0..).zip(&texts) {
            places[*number as usize] = place;
        }
        let texts = texts.iter().map(|(text, _)| String::from_utf8_lossy(text).into_owned());
        Some((Label { name: name.to_owned(), texts: texts.collect() }, places))
    }
}
