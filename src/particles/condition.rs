//! Conditions on the attributes of particles, such as `Type=1,2 and age<2.5`.

use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A conjunction of conditions on particles.
///
/// Each condition is written as a name, an operator (`=`, `!=`, `<`, `<=`, `>` or `>=`) and a
/// value; `and` joins conditions. Several values after `=` are alternatives: `mk=0,2`. A component
/// of a vector is written as `velocity.y` or `velocity[1]`; `x`, `y` and `z` are the position.
/// Names and values may be quoted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Where(Vec<Condition>);

/// A condition on one attribute.
#[derive(Debug, Clone, PartialEq)]
pub struct Condition {
    /// The name of the attribute, with or without a component.
    pub name: String,
    /// How the attribute's value is compared.
    pub comparison: Comparison,
    /// The value to compare with, or several alternatives.
    pub values: Vec<String>,
}

/// A comparison of an attribute with a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Comparison {
    Equal,
    NotEqual,
    Less,
    LessOrEqual,
    Greater,
    GreaterOrEqual,
}

/// The operators and their texts. Operators of two characters come first, so that `<=` is not read
/// as `<`.
const OPERATORS: [(&str, Comparison); 7] = [
    ("!=", Comparison::NotEqual),
    ("<=", Comparison::LessOrEqual),
    (">=", Comparison::GreaterOrEqual),
    ("==", Comparison::Equal),
    ("=", Comparison::Equal),
    ("<", Comparison::Less),
    (">", Comparison::Greater),
];

impl Condition {
    /// Whether the condition selects a type of particles.
    pub(crate) fn is_of_type(&self) -> bool {
        self.name == "type"
    }
}

impl Comparison {
    /// Whether the comparison depends on order, as `<` does.
    #[must_use]
    pub fn is_of_order(self) -> bool {
        !matches!(self, Self::Equal | Self::NotEqual)
    }

    /// Whether a stored integer satisfies the comparison with integers, like
    /// [`holds`](Self::holds). The result is exact even for integers that f64 cannot represent.
    pub(crate) fn holds_whole(self, stored: i64, values: &[i64]) -> bool {
        match (self, values) {
            (Self::Equal, _) => values.contains(&stored),
            (Self::NotEqual, _) => !values.contains(&stored),
            (Self::Less, &[value]) => stored < value,
            (Self::LessOrEqual, &[value]) => stored <= value,
            (Self::Greater, &[value]) => stored > value,
            (Self::GreaterOrEqual, &[value]) => stored >= value,
            _ => false,
        }
    }

    /// Whether a stored number satisfies the comparison: `Equal` with any of the values, `NotEqual`
    /// with all of them, and an order comparison with the only value.
    ///
    /// A number stored as f32 equals the decimal number from which it was rounded. NaN differs from
    /// every value.
    #[must_use]
    pub fn holds(self, stored: f64, values: &[f64]) -> bool {
        let rounded = |value: f64| value.fract() != 0.0 && f64::from(value as f32) == stored;
        let equal = |value: f64| stored == value || rounded(value);
        match (self, values) {
            (Self::Equal, _) => values.iter().any(|&value| equal(value)),
            (Self::NotEqual, _) => !values.iter().any(|&value| equal(value)),
            (Self::Less, &[value]) => stored < value && !equal(value),
            (Self::LessOrEqual, &[value]) => stored < value || equal(value),
            (Self::Greater, &[value]) => stored > value && !equal(value),
            (Self::GreaterOrEqual, &[value]) => stored > value || equal(value),
            _ => false,
        }
    }
}

impl Where {
    /// The conditions.
    #[must_use]
    pub fn conditions(&self) -> &[Condition] {
        &self.0
    }

    /// The types of particles that are named by conditions such as `type=wall`.
    #[cfg(feature = "hdf5")]
    pub(crate) fn types(several: &[Self]) -> impl Iterator<Item = &str> {
        let conditions = several.iter().flat_map(Self::conditions);
        conditions.filter_map(|condition| match &condition.values[..] {
            [only] if condition.is_of_type() && condition.comparison == Comparison::Equal => {
                Some(&**only)
            }
            _ => None,
        })
    }

    /// Joins several conjunctions into one; returns `None` if they contain no conditions.
    #[must_use]
    pub fn joined(several: &[Self]) -> Option<Self> {
        let all: Vec<_> = several.iter().flat_map(|some| some.0.iter().cloned()).collect();
        (!all.is_empty()).then_some(Self(all))
    }
}

/// Splits a text at the separators that are outside quotes. `separator` returns the length of a
/// separator at the start of a text.
fn split(text: &str, separator: impl Fn(&str) -> Option<usize>) -> Vec<&str> {
    let (mut pieces, mut start, mut quote) = (Vec::new(), 0, None);
    let mut at = 0;
    while let Some(character) = text[at..].chars().next() {
        match quote {
            Some(open) if character == open => quote = None,
            None if matches!(character, '"' | '\'') => quote = Some(character),
            None => {
                if let Some(length) = separator(&text[at..]) {
                    pieces.push(&text[start..at]);
                    at += length;
                    start = at;
                    continue;
                }
            }
            Some(_) => {}
        }
        at += character.len_utf8();
    }
    pieces.push(&text[start..]);
    pieces
}

/// The length of the separator at the start of a text: `&&`, or `and` between spaces. The length
/// includes the spaces before `and`.
fn and(text: &str) -> Option<usize> {
    if text.starts_with("&&") {
        return Some(2);
    }
    let rest = text.trim_start();
    let word = rest.get(..3).filter(|word| word.eq_ignore_ascii_case("and"))?;
    let after = &rest[word.len()..];
    let blanks = text.len() - rest.len();
    let ends = after.is_empty() || after.starts_with(char::is_whitespace);
    (blanks > 0 && ends).then_some(blanks + word.len())
}

/// A name or a value without its quotes.
fn unquoted(text: &str) -> &str {
    let text = text.trim();
    let within = |quote| text.strip_prefix(quote).and_then(|rest| rest.strip_suffix(quote));
    within('"').or_else(|| within('\'')).unwrap_or(text)
}

impl FromStr for Condition {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || {
            format!("expected a condition such as Type=1, mk=0,2 or age<2.5, got {:?}", text.trim())
        };
        let length = |text: &str| {
            OPERATORS.iter().find(|(written, _)| text.starts_with(written)).map(|(w, _)| w.len())
        };
        let sides = split(text, length);
        let [name, values] = sides[..] else { return Err(expected()) };
        let written = &text[name.len()..text.len() - values.len()];
        let comparison = OPERATORS.iter().find(|(known, _)| *known == written);
        let (name, (_, comparison)) = (unquoted(name), comparison.ok_or_else(expected)?);
        let values = split(values, |text| text.starts_with(',').then_some(1));
        // An empty value must be quoted.
        if name.is_empty() || values.iter().any(|value| value.trim().is_empty()) {
            return Err(expected());
        }
        let values: Vec<String> = values.into_iter().map(|v| unquoted(v).to_owned()).collect();
        if comparison.is_of_order() {
            let number = |value: &String| value.parse::<f64>().is_ok_and(|value| !value.is_nan());
            if values.len() > 1 || !values.iter().all(number) {
                return Err(format!("expected one number after {written} in {:?}", text.trim()));
            }
        }
        Ok(Self { name: name.to_owned(), comparison: *comparison, values })
    }
}

impl FromStr for Where {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        split(text, and).into_iter().map(str::parse).collect::<Result<_, _>>().map(Self)
    }
}

impl TryFrom<String> for Where {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Where> for String {
    fn from(conditions: Where) -> Self {
        conditions.to_string()
    }
}

/// A name or a value, quoted if necessary.
fn quoted(text: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "_.-+[]:/".contains(c);
    let quote = if text.contains('"') { '\'' } else { '"' };
    if !text.is_empty() && text.chars().all(plain) {
        text.to_owned()
    } else {
        format!("{quote}{text}{quote}")
    }
}

impl Display for Condition {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let written = OPERATORS.iter().rev().find(|(_, known)| *known == self.comparison);
        let values: Vec<_> = self.values.iter().map(|value| quoted(value)).collect();
        let written = written.map_or("", |(written, _)| written);
        write!(f, "{}{written}{}", quoted(&self.name), values.join(","))
    }
}

impl Display for Where {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let all: Vec<_> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&all.join(" and "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_round_trip_through_their_text() {
        for (text, plain) in [
            ("Type=3", "Type=3"),
            (" mk = 0, 2 ", "mk=0,2"),
            ("phase != boundary AND age<2.5", "phase!=boundary and age<2.5"),
            ("a==1&&b>=-2e3", "a=1 and b>=-2e3"),
            ("'Point ID'=7", "\"Point ID\"=7"),
            ("\"a<b and c\"!='x,y',\"z\"", "\"a<b and c\"!=\"x,y\",z"),
            ("velocity.y<=0 and velocity[0]>1", "velocity.y<=0 and velocity[0]>1"),
            ("android=1", "android=1"),
        ] {
            let read: Where = text.parse().unwrap();
            assert_eq!(read.to_string(), plain);
            assert_eq!(plain.parse(), Ok(read), "{plain}");
        }
    }

    #[test]
    fn invalid_conditions_are_refused() {
        for text in [
            "", "Type", "=3", "Type=", "Type=1,", "a<1,2", "a<b", "a<nan", "a=1 and", "a=1=2",
            "a!1",
        ] {
            assert!(text.parse::<Where>().is_err(), "{text:?}");
        }
    }

    #[test]
    fn stored_f32_values_compare_equal_to_their_decimal_text() {
        use Comparison::{Equal, Greater, GreaterOrEqual, Less, LessOrEqual, NotEqual};
        let tenth = f64::from(0.1_f32);
        for (comparison, stored, values, holds) in [
            (Equal, tenth, &[0.1][..], true),
            (NotEqual, tenth, &[0.1], false),
            (Greater, tenth, &[0.1], false),
            (GreaterOrEqual, tenth, &[0.1], true),
            (LessOrEqual, tenth, &[0.1], true),
            (Less, f64::from(0.7_f32), &[0.7], false),
            (Equal, 16_777_216.0, &[16_777_217.0], false),
            (Equal, 2.0, &[0.0, 2.0], true),
            (NotEqual, 2.0, &[0.0, 2.0], false),
            (Equal, f64::NAN, &[f64::NAN], false),
            (NotEqual, f64::NAN, &[1.0], true),
            (Less, f64::NAN, &[1.0], false),
        ] {
            assert_eq!(
                comparison.holds(stored, values),
                holds,
                "{stored} {comparison:?} {values:?}"
            );
        }
    }
}
