//! Columns of text: a list of the different texts, and a number in every row.

use std::collections::HashMap;
use std::sync::Mutex;

use crate::particles::Label;

/// Maximum number of different texts of a label.
const MOST: usize = 4096;

/// The texts of a column in the rows so far.
#[derive(Debug, Default)]
pub struct Texts(Mutex<HashMap<Vec<u8>, u32>>);

/// A thread's cache of the texts.
pub type Known = HashMap<Vec<u8>, u32>;

impl Texts {
    /// The number of a text; undefined if there are too many texts.
    pub fn number(&self, known: &mut Known, text: &[u8]) -> u32 {
        if let Some(&number) = known.get(text) {
            return number;
        }
        let mut all = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let next = all.len() as u32;
        let number =
            if all.len() > MOST { next } else { *all.entry(text.to_owned()).or_insert(next) };
        if known.len() <= MOST {
            known.insert(text.to_owned(), number);
        }
        number
    }

    /// The label, and for the number of each text its index in the label; `None` if there are too
    /// many texts.
    pub fn label(self, name: &str) -> Option<(Label, Vec<u32>)> {
        let all = self.0.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        if all.len() > MOST {
            return None;
        }
        // Threads may have found the texts in any order.
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
