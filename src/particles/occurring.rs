//! Counts the values of attributes that have few distinct values.

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{AttributeInfo, Particles, chunks};

/// Maximum number of distinct values of a listed attribute.
const MOST_VALUES: usize = 8;

/// An attribute with few distinct values.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ValueCounts {
    /// The name of the attribute or label.
    pub name: String,
    /// The values, in order, each with the number of particles that have it.
    pub values: Vec<(Value, usize)>,
}

/// A value of an attribute.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Value {
    /// An integer, if the attribute contains only integers.
    Integer(i64),
    /// A number.
    Number(f64),
    /// A text.
    Text(String),
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Integer(number) => write!(f, "{number}"),
            Self::Number(number) => write!(f, "{number}"),
            Self::Text(text) => f.write_str(text),
        }
    }
}

/// Finds the scalar attributes and labels with few distinct values.
pub fn occurring(particles: &dyn Particles) -> Vec<ValueCounts> {
    let scalars = particles.attributes().iter().enumerate().filter(|(_, i)| i.components == 1);
    let sources = scalars.map(|(index, info)| (AttributeOrLabel::of(index, info), &info.name));
    let labels = particles.labels().iter().enumerate();
    let sources = sources.chain(labels.map(|(index, l)| (AttributeOrLabel::Label(index), &l.name)));
    let found = sources.filter_map(|(source, name)| {
        let values = values_of(particles, source)?;
        let values = values.into_iter().map(|(_, value, count)| (value, count)).collect();
        Some(ValueCounts { name: name.clone(), values })
    });
    found.collect()
}

/// A scalar attribute or a label.
#[derive(Debug, Clone, Copy)]
pub(super) enum AttributeOrLabel {
    /// A scalar attribute.
    Attribute(usize),
    /// A scalar attribute of integers.
    Integers(usize),
    /// A label.
    Label(usize),
}

impl AttributeOrLabel {
    /// The scalar attribute with this index.
    pub(super) fn of(index: usize, info: &AttributeInfo) -> Self {
        if info.kind.is_whole() { Self::Integers(index) } else { Self::Attribute(index) }
    }

    /// Sort keys of the values of a range of particles.
    pub(super) fn keys(self, particles: &dyn Particles, range: Range<usize>) -> Vec<u64> {
        let (first, count) = (range.start, range.len());
        match self {
            Self::Attribute(index) => {
                let mut numbers = vec![0.0; count];
                particles.component((index, 0), first, &mut numbers);
                numbers.into_iter().map(ordered).collect()
            }
            Self::Integers(index) => {
                let mut numbers = vec![0; count];
                particles.integers(index, first, &mut numbers);
                numbers.into_iter().map(ordered_integer).collect()
            }
            Self::Label(index) => {
                let mut texts = vec![0; count];
                particles.label(index, first, &mut texts);
                texts.into_iter().map(u64::from).collect()
            }
        }
    }

    fn value(self, particles: &dyn Particles, key: u64) -> Value {
        let text = |index: usize| particles.labels()[index].texts.get(key as usize).cloned();
        match self {
            Self::Attribute(_) => Value::Number(number(key)),
            Self::Integers(_) => Value::Integer(ordered_integer(key as i64) as i64),
            Self::Label(index) => Value::Text(text(index).unwrap_or_default()),
        }
    }
}

/// The distinct values, each with its key and its number of particles; `None` if there are too many
/// values, or on average fewer than two particles per value.
pub(super) fn values_of(
    particles: &dyn Particles,
    source: AttributeOrLabel,
) -> Option<Vec<(u64, Value, usize)>> {
    let counts = counted(particles, source)?;
    let values = counts.into_iter().map(|(key, n)| (key, source.value(particles, key), n));
    Some(values.collect())
}

/// The number of particles with each key; `None` if there are too many keys, or on average fewer
/// than two particles per key.
fn counted(particles: &dyn Particles, source: AttributeOrLabel) -> Option<BTreeMap<u64, usize>> {
    let all = particles.len();
    let counts = chunks(particles, |range| {
        let mut counts = BTreeMap::new();
        for key in source.keys(particles, range) {
            *counts.entry(key).or_insert(0) += 1;
            if counts.len() > MOST_VALUES {
                return None;
            }
        }
        Some(counts)
    });
    let joined = counts.try_reduce(BTreeMap::new, |mut counts, others| {
        others.into_iter().for_each(|(key, count)| *counts.entry(key).or_insert(0) += count);
        (counts.len() <= MOST_VALUES).then_some(counts)
    })?;
    (!joined.is_empty() && joined.len() * 2 <= all).then_some(joined)
}

/// The sort key of a number. Keys are ordered like the numbers, and -0 has the same key as 0.
fn ordered(number: f64) -> u64 {
    let bits = (number + 0.0).to_bits();
    if bits >> 63 == 1 { !bits } else { bits | 1 << 63 }
}

/// The sort key of an integer. The function is its own inverse.
fn ordered_integer(number: i64) -> u64 {
    number as u64 ^ (1 << 63)
}

/// The inverse of [`ordered`].
fn number(key: u64) -> f64 {
    f64::from_bits(if key >> 63 == 1 { key & !(1 << 63) } else { !key })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::{CHUNK, Cloud};

    #[test]
    fn occurring_values_are_listed_in_order_with_their_counts() {
        let count = 3 * CHUNK;
        let positions = vec![[0.0_f64; 3]; count];
        let phase: Vec<f32> = (0..count).map(|i| [-1.0, 2.5, -0.0, 0.0][i % 4]).collect();
        let ids: Vec<f32> = (0..count).map(|i| i as f32).collect();
        let late: Vec<f32> = (0..count).map(|i| (i / (count / 9)) as f32).collect();
        let cloud = Cloud::new(&positions).with("phase", &phase).with("id", &ids);
        let cloud = cloud.with("late", &late);
        let quarter = count / 4;
        let values = [(-1.0, quarter), (0.0, 2 * quarter), (2.5, quarter)];
        let values = values.map(|(number, count)| (Value::Number(number), count)).to_vec();
        assert_eq!(occurring(&cloud), [ValueCounts { name: "phase".into(), values }]);
    }
}
