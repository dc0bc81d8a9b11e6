//! Kinds of attributes: plain numbers, colours, which programs look for by other names and types,
//! and whole numbers such as identifiers, of which there are no means.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{AttributeInfo, Particles, VELOCITY_NAMES, carried_infos};

/// Particles whose values are looked at together.
const CHUNK: usize = 1 << 14;

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

/// A whole number that a mesh cannot carry.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error(
    "the attribute {name} has the value {value}, and a mesh carries whole numbers of 32 bits; store it as floating-point \
     numbers, or leave it out"
)]
pub struct TooWide {
    /// The name of the attribute.
    pub name: String,
    /// The value, or the greatest of 64 bits if it exceeds that.
    pub value: i64,
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
/// what is bright for shares.
///
/// # Errors
/// [`TooWide`] for whole numbers that do not fit.
pub fn settled(
    particles: &(impl Particles + ?Sized),
    carried: &[usize],
) -> Result<Vec<AttributeInfo>, TooWide> {
    let mut infos = carried_infos(particles.attributes(), carried);
    for (info, &index) in infos.iter_mut().zip(carried) {
        let components = info.components;
        match info.kind {
            AttributeKind::Wide => {
                let [low, high] = folded(
                    particles,
                    [0_i64; 2],
                    |first, count, [low, high]| {
                        let mut values = vec![0; count * components];
                        particles.integers(index, first, &mut values);
                        values.iter().fold([low, high], |[low, high], &x| [low.min(x), high.max(x)])
                    },
                    |[a, b], [c, d]| [a.min(c), b.max(d)],
                );
                info.kind = if i32::try_from(low).is_ok() && i32::try_from(high).is_ok() {
                    AttributeKind::Signed
                } else if low >= 0 && u32::try_from(high).is_ok() {
                    AttributeKind::Unsigned
                } else {
                    let value = if i32::try_from(low).is_ok() { high } else { low };
                    return Err(TooWide { name: info.name.clone(), value });
                };
            }
            AttributeKind::Colour => {
                let [within, beyond] = folded(
                    particles,
                    [true, false],
                    |first, count, seen| {
                        let mut values = vec![0.0; count * components];
                        particles.attribute(index, first, &mut values);
                        let finite = values.iter().filter(|x| x.is_finite());
                        finite.fold(seen, |[within, beyond], &x| {
                            [within && (0.0..=255.0).contains(&x), beyond || x > BRIGHT]
                        })
                    },
                    |[a, b], [c, d]| [a && c, b || d],
                );
                if within && beyond {
                    info.kind = AttributeKind::ByteColour;
                }
            }
            _ => {}
        }
    }
    Ok(infos)
}

/// Looks at all particles, a chunk at a time, and joins the findings.
fn folded<T: Copy + Send + Sync>(
    particles: &(impl Particles + ?Sized),
    nothing: T,
    look: impl Fn(usize, usize, T) -> T + Sync,
    join: impl Fn(T, T) -> T + Sync,
) -> T {
    let chunks = (0..particles.len().div_ceil(CHUNK)).into_par_iter().map(|chunk| {
        let first = chunk * CHUNK;
        let count = CHUNK.min(particles.len() - first);
        let found = look(first, count, nothing);
        particles.release(first..first + count);
        found
    });
    chunks.reduce(|| nothing, &join)
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
