//! The particles that satisfy conditions on their attributes.

use std::ops::Range;

use rayon::prelude::*;
use thiserror::Error;

use super::condition::{Comparison, Condition, Where};
use super::occurring::{ValueCounts, occurring};
use super::sieve::{GROUP, Sieve};
use super::{AttributeInfo, Label, Particles, RereadError, attribute_called, particle_count};

/// Names of the components of vectors, and of the axes of positions.
const AXES: [&str; 3] = ["x", "y", "z"];

/// The reason why particles cannot be selected.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SelectionFault {
    /// An attribute that the particles do not have.
    #[error(
        "cannot select particles by {name:?}: there is no such attribute; available attributes: {}",
        listed(known)
    )]
    NoAttribute {
        /// The name in the condition.
        name: String,
        /// The names of the available attributes.
        known: Vec<String>,
    },
    /// A vector where a number is needed, or a component that the vector does not have.
    #[error("cannot select particles by {name:?}: {}", with_components(attribute, *components))]
    Component {
        /// The name in the condition.
        name: String,
        /// The name of the attribute.
        attribute: String,
        /// The number of its components.
        components: usize,
    },
    /// A text that cannot be compared with numbers.
    #[error(
        "cannot select particles by {name:?}: its values are numbers, but the condition compares \
         them with {value:?}"
    )]
    Text {
        /// The name in the condition.
        name: String,
        /// The text.
        value: String,
    },
    /// An order comparison of texts.
    #[error(
        "cannot compare {name:?} with < or >: its values are text, which can only be compared with \
         = and !="
    )]
    Order {
        /// The name in the condition.
        name: String,
    },
    /// A condition on the type of particles that allows several types, or excludes the type that is
    /// read.
    #[error(
        "cannot apply {condition}: meniscus reads only one type of particle at a time; choose \
         one with type=NAME; available types: {}",
        listed(known)
    )]
    Types {
        /// The condition.
        condition: String,
        /// The types of particles in the input.
        known: Vec<String>,
    },
    /// No particle satisfies all conditions.
    #[error("{} {conditions}{}", no_particle(*of), values_text(values))]
    None {
        /// The number of particles.
        of: usize,
        /// The conditions.
        conditions: String,
        /// The distinct values of the attributes in the conditions, for attributes with few
        /// distinct values.
        values: Vec<ValueCounts>,
    },
    /// The particles cannot be read.
    #[error("{0}")]
    Unread(#[from] RereadError),
    /// The caller cancelled the work.
    #[error("cancelled")]
    Cancelled,
}

fn listed(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// The subject and verb of a message about particles that fail a condition.
fn no_particle(of: usize) -> String {
    match of {
        1 => "the only particle does not satisfy".to_owned(),
        of => format!("none of {of} particles satisfies"),
    }
}

/// Part of a message that lists the values of attributes.
fn values_text(values: &[ValueCounts]) -> String {
    let one = |of: &ValueCounts| {
        let listed = of.values.iter();
        let listed = listed.map(|(value, count)| format!("{value} ({})", particle_count(*count)));
        format!("; values of {}: {}", of.name, listed.collect::<Vec<_>>().join(", "))
    };
    values.iter().map(one).collect()
}

/// Part of a message that says how many components an attribute has, and how to name one of them.
fn with_components(attribute: &str, components: usize) -> String {
    let example = match components {
        1 => return format!("the attribute is a single number; use {attribute}"),
        2 | 3 => ".y",
        _ => "[0]",
    };
    format!(
        "the attribute has {components} components; name one of them, such as {attribute}{example}"
    )
}

/// The value that a condition tests for each particle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ConditionOperand {
    /// A component of an attribute.
    Component(usize, usize),
    /// A coordinate.
    Position(usize),
}

/// A condition on stored values.
#[derive(Debug)]
enum StoredCondition {
    /// Compares a number with values.
    Number(ConditionOperand, Comparison, Vec<f64>),
    /// Compares an integer component of an attribute with integers.
    Whole((usize, usize), Comparison, Vec<i64>),
    /// A label. For each of its texts, the list says whether the text satisfies the condition.
    Label(usize, Vec<bool>),
}

/// Splits the name of a component, such as `velocity.y` or `velocity[1]`, into the name of the
/// attribute and the index of the component.
fn component(name: &str) -> Option<(&str, usize)> {
    if let Some((attribute, axis)) = name.rsplit_once('.') {
        return Some((attribute, AXES.iter().position(|known| *known == axis)?));
    }
    let (attribute, index) = name.strip_suffix(']')?.rsplit_once('[')?;
    Some((attribute, index.parse().ok()?))
}

/// The integer that a string represents, as in `7`, `7.0` or `1e6`; `None` for anything else.
fn integer(text: &str) -> Option<i64> {
    /// The least number above all 64-bit integers.
    const BEYOND: f64 = -(i64::MIN as f64);
    let real = || text.parse().ok().filter(|real: &f64| real.fract() == 0.0 && real.abs() < BEYOND);
    text.parse().ok().or_else(|| Some(real()? as i64))
}

impl Condition {
    /// The index of the attribute that this condition tests; `None` for a position, or if there is
    /// no such attribute.
    pub(crate) fn attribute(&self, infos: &[AttributeInfo]) -> Option<usize> {
        let of_component =
            || component(&self.name).and_then(|(name, _)| attribute_called(name, infos));
        attribute_called(&self.name, infos).or_else(of_component)
    }

    /// Whether a text satisfies the condition; `None` for an order comparison.
    pub(crate) fn of_text(&self, text: &str) -> Option<bool> {
        let is_one = self.values.iter().any(|value| value == text.trim());
        match self.comparison {
            Comparison::Equal => Some(is_one),
            Comparison::NotEqual => Some(!is_one),
            _ => None,
        }
    }

    fn operand(
        &self,
        infos: &[AttributeInfo],
        labels: &[Label],
    ) -> Result<ConditionOperand, SelectionFault> {
        let name = self.name.clone();
        let Some(index) = self.attribute(infos) else {
            let axis = AXES.iter().position(|axis| name.eq_ignore_ascii_case(axis));
            let names = infos.iter().map(|info| &info.name);
            let known = || names.chain(labels.iter().map(|label| &label.name)).cloned().collect();
            let missing = || SelectionFault::NoAttribute { name, known: known() };
            return axis.map(ConditionOperand::Position).ok_or_else(missing);
        };
        let info = &infos[index];
        let named = attribute_called(&name, infos).is_none().then(|| component(&name)).flatten();
        let component = named.map_or(0, |(_, component)| component);
        if named.is_none() && info.components != 1 || component >= info.components {
            let (attribute, components) = (info.name.clone(), info.components);
            return Err(SelectionFault::Component { name, attribute, components });
        }
        Ok(ConditionOperand::Component(index, component))
    }

    fn stored(
        &self,
        infos: &[AttributeInfo],
        labels: &[Label],
    ) -> Result<StoredCondition, SelectionFault> {
        let name = &self.name;
        let is_called = |label: &Label| label.name == *name;
        let is_alike = |label: &Label| label.name.eq_ignore_ascii_case(name);
        let exact = labels.iter().position(is_called);
        let alike = exact.or_else(|| labels.iter().position(is_alike));
        if let Some(index) = alike.filter(|_| exact.is_some() || self.attribute(infos).is_none()) {
            let order = || SelectionFault::Order { name: name.clone() };
            let passes = |text: &String| self.of_text(text).ok_or_else(order);
            let texts = labels[index].texts.iter().map(passes).collect::<Result<_, _>>()?;
            return Ok(StoredCondition::Label(index, texts));
        }
        let operand = self.operand(infos, labels)?;
        let value = |text: &String| {
            let fault = || SelectionFault::Text { name: name.clone(), value: text.clone() };
            text.parse().map_err(|_| fault())
        };
        let values = self.values.iter().map(value).collect::<Result<_, _>>()?;
        let whole: Option<Vec<i64>> = self.values.iter().map(|text| integer(text)).collect();
        Ok(match (operand, whole) {
            (ConditionOperand::Component(index, component), Some(whole))
                if infos[index].kind.is_whole() =>
            {
                StoredCondition::Whole((index, component), self.comparison, whole)
            }
            _ => StoredCondition::Number(operand, self.comparison, values),
        })
    }
}

impl StoredCondition {
    /// Clears the bits of the particles in `range` that do not satisfy the condition.
    fn apply(&self, particles: &dyn Particles, range: Range<usize>, words: &mut [u64]) {
        let (first, count) = (range.start, range.len());
        match self {
            Self::Number(operand, comparison, values) => {
                let mut numbers = vec![0.0; count];
                match *operand {
                    ConditionOperand::Component(index, component) => {
                        particles.component((index, component), first, &mut numbers)
                    }
                    ConditionOperand::Position(axis) => {
                        let mut positions = vec![[0.0; 3]; count];
                        particles.positions(first, &mut positions);
                        let along = positions.iter().map(|position| position[axis]);
                        numbers.iter_mut().zip(along).for_each(|(to, along)| *to = along);
                    }
                }
                clear_failing(words, &numbers, |&number| comparison.holds(number, values));
            }
            Self::Whole((index, component), comparison, values) => {
                let components = particles.attributes()[*index].components;
                let mut all = vec![0; count * components];
                particles.integers(*index, first, &mut all);
                let numbers: Vec<i64> =
                    all.into_iter().skip(*component).step_by(components).collect();
                clear_failing(words, &numbers, |&number| comparison.holds_whole(number, values));
            }
            Self::Label(index, passes) => {
                let mut texts = vec![0; count];
                particles.label(*index, first, &mut texts);
                clear_failing(words, &texts, |&text| {
                    passes.get(text as usize).is_some_and(|&pass| pass)
                });
            }
        }
    }
}

/// Clears the bits of the values for which `holds` returns false.
fn clear_failing<T>(words: &mut [u64], values: &[T], holds: impl Fn(&T) -> bool) {
    for (word, values) in words.iter_mut().zip(values.chunks(64)) {
        let bits = values.iter().map(&holds).enumerate();
        *word &= bits.fold(0, |bits, (bit, holds)| bits | u64::from(holds) << bit);
    }
}

/// Selects the particles that satisfy all conditions. Stops with [`SelectionFault::Cancelled`] when
/// `goes_on` returns false.
///
/// # Errors
/// [`SelectionFault`] if a condition cannot be applied, or if the particles cannot be read.
pub fn select<'a>(
    particles: &dyn Particles,
    conditions: impl IntoIterator<Item = &'a Condition>,
    goes_on: impl Fn() -> bool + Sync,
) -> Result<Sieve, SelectionFault> {
    let (infos, labels) = (particles.attributes(), particles.labels());
    let tests = conditions.into_iter().map(|condition| condition.stored(infos, labels));
    let tests = tests.collect::<Result<Vec<_>, _>>()?;
    let mut words = Sieve::none(particles.len());
    let groups = words.par_chunks_mut(GROUP / 64).enumerate();
    groups.try_for_each(|(group, words)| {
        let first = group * GROUP;
        let range = first..particles.len().min(first + GROUP);
        words.fill(u64::MAX);
        let beyond = 64 * words.len() - range.len();
        words[words.len() - 1] >>= beyond;
        for test in &tests {
            test.apply(particles, range.clone(), words);
        }
        particles.release(range);
        if goes_on() { Ok(()) } else { Err(SelectionFault::Cancelled) }
    })?;
    particles.check()?;
    Ok(Sieve::new(words))
}

impl SelectionFault {
    /// The error for conditions that no particle satisfies.
    pub(crate) fn none(particles: &dyn Particles, conditions: &[Where]) -> Self {
        let conditions = Where::joined(conditions);
        let names = conditions.iter().flat_map(Where::conditions).map(|c| c.name.as_str());
        let names: Vec<&str> = names.collect();
        let mut values = occurring(particles);
        values.retain(|of| names.iter().any(|name| of.name.eq_ignore_ascii_case(name)));
        let conditions = conditions.as_ref().map(ToString::to_string).unwrap_or_default();
        Self::None { of: particles.len(), conditions, values }
    }
}

/// The particles that a sieve selects from other particles.
#[derive(Debug)]
pub struct SelectedParticles<'a> {
    particles: &'a dyn Particles,
    sieve: Sieve,
}

impl<'a> SelectedParticles<'a> {
    /// Selects particles with a sieve.
    pub fn new(particles: &'a dyn Particles, sieve: Sieve) -> Self {
        Self { particles, sieve }
    }

    /// Splits `count` selected particles, starting with number `first`, into runs that are
    /// contiguous among all particles. Calls `take` with each run and the number of selected
    /// particles in the runs before it.
    fn each_run(&self, first: usize, count: usize, mut take: impl FnMut(Range<usize>, usize)) {
        let mut rows = self.sieve.rows(first).take(count).peekable();
        let mut at = 0;
        while let Some(start) = rows.next() {
            let mut end = start + 1;
            while rows.next_if_eq(&end).is_some() {
                end += 1;
            }
            take(start..end, at);
            at += end - start;
        }
        assert!(at == count, "particles from {first} on of {}", self.sieve.count());
    }
}

impl Particles for SelectedParticles<'_> {
    fn len(&self) -> usize {
        self.sieve.count()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        self.each_run(first, out.len(), |run, at| {
            self.particles.positions(run.start, &mut out[at..at + run.len()]);
        });
    }

    fn check(&self) -> Result<(), RereadError> {
        self.particles.check()
    }

    fn goes_on(&self) -> bool {
        self.particles.goes_on()
    }

    fn resident_bytes(&self) -> u64 {
        self.particles.resident_bytes() + self.sieve.bytes()
    }

    fn release(&self, range: Range<usize>) {
        self.particles.release(self.sieve.around(range));
    }

    fn attributes(&self) -> &[AttributeInfo] {
        self.particles.attributes()
    }

    fn labels(&self) -> &[Label] {
        self.particles.labels()
    }

    fn label(&self, index: usize, first: usize, out: &mut [u32]) {
        self.each_run(first, out.len(), |run, at| {
            self.particles.label(index, run.start, &mut out[at..at + run.len()]);
        });
    }

    fn component(&self, of: (usize, usize), first: usize, out: &mut [f64]) {
        self.each_run(first, out.len(), |run, at| {
            self.particles.component(of, run.start, &mut out[at..at + run.len()]);
        });
    }

    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        let components = self.attributes()[index].components;
        self.each_run(first, out.len() / components, |run, at| {
            let out = &mut out[at * components..(at + run.len()) * components];
            self.particles.integers(index, run.start, out);
        });
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let components = self.attributes()[index].components;
        self.each_run(first, out.len() / components, |run, at| {
            let out = &mut out[at * components..(at + run.len()) * components];
            self.particles.attribute(index, run.start, out);
        });
    }
}
