//! Kinds of attributes: plain numbers, colours, which programs look for by other names and types,
//! and whole numbers such as identifiers, of which there are no means.

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{AttributeInfo, Particles, VELOCITY_NAMES, carried_infos, chunks};

/// The meaning of an attribute's numbers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AttributeKind {
    /// Plain numbers, as of a density or a velocity.
    #[default]
    Number,
    /// Shares of red, green and blue, and perhaps of alpha, from 0 to 1.
    Colour,
    /// Shares of red, green and blue, and perhaps of alpha, from 0 to 255.
    ByteColour,
    /// Whole numbers that 32 bits hold with a sign.
    Signed,
    /// Whole numbers that 32 bits hold without a sign.
    Unsigned,
    /// Whole numbers of 64 bits, as stored. None are carried to a mesh: it takes those that
    /// [`settled`] finds to fit 32 bits.
    Wide,
}

/// An attribute whose values do not fit the kind of number that a mesh carries.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KindFault {
    /// A whole number that a mesh cannot carry.
    #[error(
        "attribute {name} has the value {value}, but the mesh stores it as integers from {} to \
         {}. Store the attribute as floating-point numbers, or leave it out",
        limits[0],
        limits[1]
    )]
    TooWide {
        /// The name of the attribute.
        name: String,
        /// The value, or the greatest of 64 bits if it exceeds that.
        value: i64,
        /// The least and the greatest value that the mesh can carry.
        limits: [i64; 2],
    },
    /// A colour from 0 to 255 in a sequence whose colours are from 0 to 1.
    #[error(
        "colour {name} has the value {greatest} and looks like bytes from 0 to 255, but the \
         calibration frame has colours from 0 to 1. Store colours in the same way in all \
         frames, start the sequence at a frame with bright colours, or leave the attribute out"
    )]
    Scale {
        /// The name of the attribute.
        name: String,
        /// The greatest value.
        greatest: f32,
    },
}

/// The kind that one frame's values settle for an attribute of all frames.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SettledKind {
    /// The attribute as it is stored.
    pub stored: AttributeInfo,
    /// The kind that its values settle.
    pub kind: AttributeKind,
    /// Whether the values leave no doubt of it.
    pub is_evident: bool,
}

/// Shares of light that are brighter are numbers up to 255.
const BRIGHT: f32 = 16.0;

/// Names of colours, in lower case.
const COLOURS: [&str; 8] = ["cd", "color", "colors", "colour", "colours", "diffuse", "rgb", "rgba"];

/// Names of shares of a colour, in lower case.
pub const SHARES: [&str; 4] = ["red", "green", "blue", "alpha"];

/// Whether an attribute of this name is a colour, if it has three or four components.
#[must_use]
pub fn is_colour_name(name: &str) -> bool {
    COLOURS.contains(&&*name.to_ascii_lowercase())
}

/// Whether this names a colour, or one of its shares.
#[must_use]
pub fn asks_for_colour(name: &str) -> bool {
    is_colour_name(name) || SHARES.contains(&&*name.to_ascii_lowercase())
}

impl AttributeKind {
    /// The kind of an attribute of floating-point numbers.
    #[must_use]
    pub fn of_floats(name: &str, components: usize) -> Self {
        match components {
            3 | 4 if is_colour_name(name) => Self::Colour,
            _ => Self::Number,
        }
    }

    /// The kind of an attribute of bytes.
    #[must_use]
    pub fn of_bytes(name: &str, components: usize) -> Self {
        match Self::of_floats(name, components) {
            Self::Colour => Self::ByteColour,
            other => other,
        }
    }

    /// The kind of numbers of which some are of this kind, and some of another.
    #[must_use]
    pub fn together(self, other: Self) -> Self {
        match (self, other) {
            _ if self == other => self,
            // Pieces hand out bytes as shares beside others.
            _ if self.is_colour() && other.is_colour() => Self::Colour,
            _ if self.is_whole() && other.is_whole() => Self::Wide,
            _ => Self::Number,
        }
    }

    /// Whether it is whole numbers: a vertex takes the one of the nearest particle.
    #[must_use]
    pub fn is_whole(self) -> bool {
        matches!(self, Self::Signed | Self::Unsigned | Self::Wide)
    }

    /// A whole number as a mesh carries it: its low 32 bits, in place of those of an f32.
    #[must_use]
    pub fn word(whole: i64) -> f32 {
        f32::from_bits(whole as u32)
    }

    /// The whole number that a mesh carries as `word`.
    #[must_use]
    pub fn whole(self, word: f32) -> i64 {
        match self {
            Self::Unsigned => word.to_bits().into(),
            _ => (word.to_bits() as i32).into(),
        }
    }

    /// The number that a mesh carries as `word`, rounded to f32.
    #[must_use]
    pub fn number(self, word: f32) -> f32 {
        if self.is_whole() { self.whole(word) as f32 } else { word }
    }

    /// The least and the greatest whole number that a mesh can carry.
    fn limits(self) -> [i64; 2] {
        match self {
            Self::Unsigned => [0, u32::MAX.into()],
            _ => [i32::MIN.into(), i32::MAX.into()],
        }
    }

    /// Whether it is a colour.
    #[must_use]
    pub fn is_colour(self) -> bool {
        matches!(self, Self::Colour | Self::ByteColour)
    }

    /// Whether it is the default.
    pub(crate) fn is_number(&self) -> bool {
        *self == Self::Number
    }

    /// A share of a colour from 0 to 1, which programs expect: what lies beyond is cut off, and NaN
    /// is 0.
    #[must_use]
    pub fn share(self, value: f32) -> f32 {
        let share = if self == Self::ByteColour { value / 255.0 } else { value };
        if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) }
    }

    /// A share of a colour from 0 to 255, by [`share`](Self::share).
    #[must_use]
    pub fn byte(self, value: f32) -> u8 {
        // A whole byte comes back as it was.
        (f64::from(self.share(value)) * 255.0).round() as u8
    }
}

/// The number of the first colour among attributes.
#[must_use]
pub fn colour_attribute(attributes: &[AttributeInfo]) -> Option<usize> {
    attributes.iter().position(|info| info.kind.is_colour())
}

/// The carried attributes with the kinds that their values settle: whole numbers of 64 bits that fit
/// 32, and colours of floating-point numbers that are from 0 to 255, of which some are far beyond
/// what is bright for shares. An attribute that is stored as in `known` has the kind known of it.
///
/// # Errors
/// [`KindFault`] for values that do not fit their kind.
pub fn settled(
    particles: &(impl Particles + ?Sized),
    carried: &[usize],
    known: &[SettledKind],
) -> Result<Vec<AttributeInfo>, KindFault> {
    let infos = carried_infos(particles.attributes(), carried).into_iter().zip(carried);
    infos.map(|(info, &index)| of_values(particles, index, info, known)).collect()
}

/// The kinds that the values of the carried attributes settle for all frames; without attributes
/// whose values do not fit, which are an error of this frame alone.
pub fn settled_for_all(
    particles: &(impl Particles + ?Sized),
    carried: &[usize],
) -> Vec<SettledKind> {
    let infos = carried_infos(particles.attributes(), carried).into_iter().zip(carried);
    let settled = infos.filter_map(|(stored, &index)| {
        let kind = of_values(particles, index, stored.clone(), &[]).ok()?.kind;
        let is_float = stored.kind == AttributeKind::Colour;
        let is_evident = !is_float || evident_scale(particles, index).is_some();
        Some(SettledKind { stored, kind, is_evident })
    });
    settled.collect()
}

/// Attributes with their known kinds, where no value determines them.
#[must_use]
pub fn known_of(mut infos: Vec<AttributeInfo>, known: &[SettledKind]) -> Vec<AttributeInfo> {
    for info in &mut infos {
        if let Some(known) = known.iter().find(|known| known.stored == *info) {
            info.kind = known.kind;
        }
    }
    infos
}

/// An attribute with the kind that is known of it, if its values fit that, else with the kind that
/// they settle.
fn of_values(
    particles: &(impl Particles + ?Sized),
    index: usize,
    mut info: AttributeInfo,
    known: &[SettledKind],
) -> Result<AttributeInfo, KindFault> {
    let known = known.iter().find(|known| known.stored == info).map(|known| known.kind);
    match info.kind {
        AttributeKind::Wide => {
            let [low, high] = whole_extremes(particles, index);
            let fits = |kind: &AttributeKind| {
                let [least, greatest] = kind.limits();
                least <= low && high <= greatest
            };
            let kinds = match known {
                Some(known) => vec![known],
                None => vec![AttributeKind::Signed, AttributeKind::Unsigned],
            };
            info.kind = kinds.iter().copied().find(fits).ok_or_else(|| {
                let limits = kinds[0].limits();
                let value = if low < limits[0] { low } else { high };
                KindFault::TooWide { name: info.name.clone(), value, limits }
            })?;
        }
        AttributeKind::Colour => {
            let extremes = extremes(particles, index);
            let kind = AttributeKind::of_shares(extremes);
            if (known, kind) == (Some(AttributeKind::Colour), AttributeKind::ByteColour) {
                return Err(KindFault::Scale { name: info.name, greatest: extremes[1] });
            }
            info.kind = known.unwrap_or(kind);
        }
        _ => {}
    }
    Ok(info)
}

impl AttributeKind {
    /// The kind of colours of floating-point numbers between these extremes.
    fn of_shares([least, greatest]: [f32; 2]) -> Self {
        let is_bytes = least >= 0.0 && greatest > BRIGHT && greatest <= 255.0;
        if is_bytes { Self::ByteColour } else { Self::Colour }
    }
}

/// The scale that the values of a colour leave no doubt of: bytes, or shares some of which are
/// above 0 and none above 1. `None` where they may be either.
pub fn evident_scale(particles: &(impl Particles + ?Sized), index: usize) -> Option<AttributeKind> {
    let extremes = extremes(particles, index);
    let kind = AttributeKind::of_shares(extremes);
    let is_evident = kind == AttributeKind::ByteColour || extremes[1] > 0.0 && extremes[1] <= 1.0;
    is_evident.then_some(kind)
}

/// The least and the greatest finite value of an attribute, and 0.
fn extremes(particles: &(impl Particles + ?Sized), index: usize) -> [f32; 2] {
    let components = particles.attributes()[index].components;
    let of_chunk = |range: Range<usize>| {
        let mut values = vec![0.0_f32; range.len() * components];
        particles.attribute(index, range.start, &mut values);
        let finite = values.iter().filter(|x| x.is_finite());
        finite.fold([0.0_f32; 2], |[low, high], &x| [low.min(x), high.max(x)])
    };
    chunks(particles, of_chunk).reduce(|| [0.0; 2], |[a, b], [c, d]| [a.min(c), b.max(d)])
}

/// The least and the greatest whole number of an attribute, and 0.
fn whole_extremes(particles: &(impl Particles + ?Sized), index: usize) -> [i64; 2] {
    let components = particles.attributes()[index].components;
    let of_chunk = |range: Range<usize>| {
        let mut values = vec![0_i64; range.len() * components];
        particles.integers(index, range.start, &mut values);
        values.iter().fold([0_i64; 2], |[low, high], &x| [low.min(x), high.max(x)])
    };
    chunks(particles, of_chunk).reduce(|| [0; 2], |[a, b], [c, d]| [a.min(c), b.max(d)])
}

/// Whether whole numbers under this name are a direction nevertheless.
pub(crate) fn is_direction_name(info: &AttributeInfo) -> bool {
    info.components == 3 && VELOCITY_NAMES.contains(&&*info.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_of_colours_come_back_and_nothing_lies_beyond_them() {
        for byte in 0..=u8::MAX {
            assert_eq!(AttributeKind::ByteColour.byte(f32::from(byte)), byte);
        }
        let shares = [-1.0, 0.0, 0.5, 1.0, 7.0, f32::NAN].map(|x| AttributeKind::Colour.byte(x));
        assert_eq!(shares, [0, 0, 128, 255, 255, 0]);
    }

    #[test]
    fn colours_have_the_name_and_the_components_of_one() {
        let is_colour = |name, components| AttributeKind::of_floats(name, components).is_colour();
        assert!(is_colour("Cd", 3) && is_colour("RGBA", 4) && is_colour("Colors", 3));
        assert!(!is_colour("Cd", 1) && !is_colour("velocity", 3) && !is_colour("red", 3));
        assert_eq!(AttributeKind::of_bytes("rgb", 3), AttributeKind::ByteColour);
    }
}
