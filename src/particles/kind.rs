//! Kinds of attributes: plain numbers; colours, for which programs expect other names and types;
//! and integers such as identifiers, which must not be averaged.

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{AttributeInfo, Particles, carried_infos, chunks, velocity_attribute};

/// The meaning of an attribute's numbers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AttributeKind {
    /// Plain numbers, such as a density or a velocity.
    #[default]
    Number,
    /// Red, green and blue, and optionally alpha, from 0 to 1.
    Colour,
    /// Red, green and blue, and optionally alpha, from 0 to 255.
    ByteColour,
    /// Red, green and blue, and optionally alpha, from 0 to 65535.
    ShortColour,
    /// A colour in integers of any other type, as the input stores it. A mesh with vertices never
    /// has this kind: [`settled`] replaces it with [`ByteColour`](Self::ByteColour) or
    /// [`Number`](Self::Number).
    WholeColour,
    /// Integers that fit into signed 32-bit integers.
    Signed,
    /// Integers that fit into unsigned 32-bit integers.
    Unsigned,
    /// 64-bit integers, as the input stores them. A mesh never has this kind: [`settled`] replaces
    /// it with a 32-bit kind that fits the values.
    Wide,
}

/// An attribute whose values do not fit the number type of the mesh.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KindFault {
    /// An integer that the mesh cannot store.
    #[error(
        "attribute {name:?} has the value {value}, but the mesh stores it as integers from {} to \
         {}; store floating-point numbers in the particle file, or do not transfer the attribute",
        limits[0],
        limits[1]
    )]
    TooWide {
        /// The name of the attribute.
        name: String,
        /// The value, or the greatest i64 if the value exceeds it.
        value: i64,
        /// The range of integers that the mesh can store.
        limits: [i64; 2],
    },
    /// A colour from 0 to 255 in a sequence whose colours are from 0 to 1.
    #[error(
        "colour {name:?} contains the value {greatest}, so its range seems to be 0 to 255, but in \
         the calibration frame (usually the first), the range seems to be 0 to 1; use the same \
         range in all frames, or do not transfer the attribute; if the range is 0 to 255 in all \
         frames, the calibration frame is too dark to show this (it has no value above 16), so \
         begin with a frame that has a value above 16"
    )]
    Scale {
        /// The name of the attribute.
        name: String,
        /// The greatest value.
        greatest: f32,
    },
    /// An integer colour with a value outside the range from 0 to 255, in a sequence whose colours
    /// are in this range.
    #[error(
        "colour {name:?} has the value {value}, but in the calibration frame (usually the first), \
         all values are integers from 0 to 255, so meniscus treats the attribute as a colour from \
         0 to 255 in all frames; use this range in all frames, or do not transfer the attribute; \
         if values outside this range are correct, begin with a frame that contains such a value"
    )]
    NoByte {
        /// The name of the attribute.
        name: String,
        /// The value that is farthest outside the range.
        value: f32,
    },
    /// A fraction in a sequence whose other frames have integers.
    #[error(
        "attribute {name:?} has the value {value}, but is an integer in other frames; store \
         floating-point numbers in all frames, or do not transfer the attribute"
    )]
    Fraction {
        /// The name of the attribute.
        name: String,
        /// The value.
        value: f64,
    },
    /// An attribute whose type cannot be converted to the type that it has in other frames.
    #[error(
        "attribute {name:?} is {own} per particle, but {shared} in other frames; store the \
         attribute in the same way in all frames, or do not transfer it"
    )]
    Type {
        /// The name of the attribute.
        name: String,
        /// The type of the attribute in this frame, as text.
        own: String,
        /// The type of the attribute in other frames, as text.
        shared: String,
    },
}

/// The kind of an attribute in all frames, determined from the values of one frame.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SettledKind {
    /// The attribute as it is stored.
    pub stored: AttributeInfo,
    /// The kind that fits its values.
    pub kind: AttributeKind,
    /// Whether the values determine the kind.
    pub is_evident: bool,
}

impl SettledKind {
    /// Whether the values of another frame, which have the kind `found`, determine the kind of this
    /// attribute, although the values of its own frame do not.
    fn is_determined_by(&self, found: &Self) -> bool {
        let (own, other) = (&self.stored, &found.stored);
        let is_float = own.kind.is_whole() && found.kind == AttributeKind::Number;
        let is_same_size = (&own.name, own.components) == (&other.name, other.components);
        !self.is_evident && found.is_evident && (own == other || is_float && is_same_size)
    }
}

/// Updates `kinds`, which come from one frame, with `found`, the kinds from another frame. A kind
/// is replaced if the values of the other frame determine it and the values of its own frame do
/// not.
pub fn determine(kinds: &mut [SettledKind], found: Vec<SettledKind>) {
    for found in found {
        if let Some(known) = kinds.iter_mut().find(|known| known.is_determined_by(&found)) {
            *known = found;
        }
    }
}

/// If the greatest value of a floating-point colour exceeds this number, the scale is 0 to 255.
const BRIGHT: f32 = 16.0;

/// The greatest value of a colour in bytes.
const BYTE: f32 = 255.0;

/// The greatest value of a colour in unsigned 16-bit integers.
const SHORT: f32 = 65535.0;

/// Names of colours, in lower case.
const COLOURS: [&str; 8] = ["cd", "color", "colors", "colour", "colours", "diffuse", "rgb", "rgba"];

/// Names of colour components, in lower case.
pub const COMPONENT_NAMES: [&str; 4] = ["red", "green", "blue", "alpha"];

/// Whether an attribute with this name and three or four components is a colour.
#[must_use]
pub fn is_colour_name(name: &str) -> bool {
    COLOURS.contains(&&*name.to_ascii_lowercase())
}

/// Whether this is the name of a colour or of one of its components.
#[must_use]
pub fn is_colour_or_component_name(name: &str) -> bool {
    is_colour_name(name) || COMPONENT_NAMES.contains(&&*name.to_ascii_lowercase())
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

    /// The kind of an attribute in a mesh file. Whether integers wider than a byte are a colour
    /// depends on all frames of a simulation, so in a mesh file they count as plain numbers.
    pub(crate) fn of_mesh(self) -> Self {
        match self {
            Self::ShortColour | Self::WholeColour => Self::Number,
            other => other,
        }
    }

    /// The kind that can hold the values of both kinds.
    #[must_use]
    pub fn together(self, other: Self) -> Self {
        match (self, other) {
            _ if self == other => self,
            // If some pieces of a frame store colours as integers and others as fractions, the
            // frame has fractions.
            (Self::Colour, _) if other.is_colour() => Self::Colour,
            (_, Self::Colour) if self.is_colour() => Self::Colour,
            _ if self.is_colour() && other.is_colour() => Self::WholeColour,
            _ if self.is_whole() && other.is_whole() => Self::Wide,
            _ => Self::Number,
        }
    }

    /// Whether the values are integers. A vertex takes an integer from the nearest particle, not an
    /// average.
    #[must_use]
    pub fn is_whole(self) -> bool {
        matches!(self, Self::Signed | Self::Unsigned | Self::Wide)
    }

    /// Encodes an integer as a mesh stores it: an f32 whose bits are the low 32 bits of the
    /// integer.
    #[must_use]
    pub fn word(whole: i64) -> f32 {
        f32::from_bits(whole as u32)
    }

    /// The integer that a mesh stores as `word`.
    #[must_use]
    pub fn whole(self, word: f32) -> i64 {
        match self {
            Self::Unsigned => word.to_bits().into(),
            _ => (word.to_bits() as i32).into(),
        }
    }

    /// The number that a mesh stores as `word`, rounded to f32.
    #[must_use]
    pub fn number(self, word: f32) -> f32 {
        if self.is_whole() { self.whole(word) as f32 } else { word }
    }

    /// Checks that a mesh can store the integers of attribute `name` between these extremes.
    pub(super) fn check_whole(self, name: &str, [low, high]: [i64; 2]) -> Result<(), KindFault> {
        let limits @ [least, greatest] = self.limits();
        if least <= low && high <= greatest {
            return Ok(());
        }
        let value = if low < least { low } else { high };
        Err(KindFault::TooWide { name: name.to_owned(), value, limits })
    }

    /// The alpha of an opaque colour.
    pub(super) fn opaque(self) -> f32 {
        match self {
            Self::ByteColour | Self::WholeColour => BYTE,
            Self::ShortColour => SHORT,
            _ => 1.0,
        }
    }

    /// The range of integers that a mesh can store.
    fn limits(self) -> [i64; 2] {
        match self {
            Self::Unsigned => [0, u32::MAX.into()],
            _ => [i32::MIN.into(), i32::MAX.into()],
        }
    }

    /// Whether this is a colour.
    #[must_use]
    pub fn is_colour(self) -> bool {
        matches!(self, Self::Colour | Self::ByteColour) || self.is_whole_colour()
    }

    /// Whether this is a colour in integers wider than a byte.
    pub(crate) fn is_whole_colour(self) -> bool {
        matches!(self, Self::ShortColour | Self::WholeColour)
    }

    /// Whether this is a colour, as the input stores it, whose scale depends on its values.
    pub(crate) fn has_open_scale(self) -> bool {
        self == Self::Colour || self.is_whole_colour()
    }

    /// Whether this is the default kind.
    pub(crate) fn is_number(&self) -> bool {
        *self == Self::Number
    }

    /// A colour component from 0 to 1, as programs expect it: clamped, with NaN as 0.
    #[must_use]
    pub fn share(self, value: f32) -> f32 {
        let share = match self {
            Self::ByteColour | Self::WholeColour => value / BYTE,
            Self::ShortColour => value / SHORT,
            _ => value,
        };
        if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) }
    }

    /// A colour component from 0 to 255, from [`share`](Self::share).
    #[must_use]
    pub fn byte(self, value: f32) -> u8 {
        // If the stored colour is an integer from 0 to 255, the result is this integer.
        (f64::from(self.share(value)) * 255.0).round() as u8
    }
}

/// The index of the first colour among the attributes.
#[must_use]
pub fn colour_attribute(attributes: &[AttributeInfo]) -> Option<usize> {
    attributes.iter().position(|info| info.kind.is_colour())
}

/// The vertex attributes, each with a kind that fits its values. 64-bit integers get a 32-bit kind.
/// Colours get a scale:
///
/// - Floating-point colours are from 0 to 255 if their values are too large for fractions.
/// - Unsigned 16-bit integers are from 0 to 65535 if a value exceeds 255, otherwise from 0 to 255.
/// - Other integers are colours from 0 to 255 if all values are in this range, otherwise numbers.
///
/// If `known` contains an attribute with the same stored description, its known kind is used.
///
/// # Errors
/// [`KindFault`] for values that do not fit their kind.
pub fn settled(
    particles: &dyn Particles,
    carried: &[usize],
    known: &[SettledKind],
) -> Result<Vec<AttributeInfo>, KindFault> {
    let infos = carried_infos(particles.attributes(), carried).into_iter().zip(carried);
    infos.map(|(info, &index)| of_values(particles, index, info, known)).collect()
}

/// The kinds of the vertex attributes for all frames, from the values of one frame. Attributes
/// whose values fit no kind are left out, because their values are an error in this frame only.
pub fn settled_for_all(particles: &dyn Particles, carried: &[usize]) -> Vec<SettledKind> {
    let infos = carried_infos(particles.attributes(), carried).into_iter().zip(carried);
    let settled = infos.filter_map(|(stored, &index)| {
        let kind = of_values(particles, index, stored.clone(), &[]).ok()?.kind;
        let is_evident = match stored.kind {
            kind if kind.has_open_scale() => evident_scale(particles, index).is_some(),
            // If all integers are equal, the attribute may have fractions in other frames.
            kind if kind.is_whole() => !is_constant(particles, index),
            _ => true,
        };
        Some(SettledKind { stored, kind, is_evident })
    });
    settled.collect()
}

/// The vertex attributes. Attributes that `known` contains have their known kinds. A frame without
/// particles also gets the other attributes in `known`, so that all frames have the same
/// attributes.
#[must_use]
pub fn known_of(
    particles: &dyn Particles,
    carried: &[usize],
    known: &[SettledKind],
) -> Vec<AttributeInfo> {
    let stored = carried_infos(particles.attributes(), carried);
    let is_missing = |name: &str| stored.iter().all(|info| info.name != name);
    let missing = known.iter().map(|known| &known.stored);
    let missing = missing.filter(|info| particles.is_empty() && is_missing(&info.name));
    let mut infos: Vec<_> = stored.iter().chain(missing).cloned().collect();
    for info in &mut infos {
        if let Some(known) = known.iter().find(|known| known.stored == *info) {
            info.kind = known.kind;
        }
    }
    infos
}

/// An attribute with its known kind, or with a kind that fits its values if none is known. Values
/// that do not fit the kind give an error.
fn of_values(
    particles: &dyn Particles,
    index: usize,
    mut info: AttributeInfo,
    known: &[SettledKind],
) -> Result<AttributeInfo, KindFault> {
    let known = known.iter().find(|known| known.stored == info).map(|known| known.kind);
    match info.kind {
        AttributeKind::Wide => {
            let extremes = whole_extremes(particles, index);
            let check = |kind: AttributeKind| kind.check_whole(&info.name, extremes).map(|()| kind);
            info.kind = match known {
                Some(known) => check(known)?,
                None => check(AttributeKind::Signed)
                    .or_else(|fault| check(AttributeKind::Unsigned).map_err(|_| fault))?,
            };
        }
        stored if stored.has_open_scale() => {
            let [least, greatest] = extremes(particles, index);
            let kind = stored.of_extremes([least, greatest]);
            match (known, kind) {
                (Some(AttributeKind::Colour), AttributeKind::ByteColour) => {
                    return Err(KindFault::Scale { name: info.name, greatest });
                }
                (
                    Some(AttributeKind::ByteColour),
                    AttributeKind::ShortColour | AttributeKind::Number,
                ) => {
                    let value = if greatest > BYTE { greatest } else { least };
                    return Err(KindFault::NoByte { name: info.name, value });
                }
                _ => info.kind = known.unwrap_or(kind),
            }
        }
        _ => {}
    }
    Ok(info)
}

impl AttributeKind {
    /// The kind of a stored colour whose values lie between these extremes.
    fn of_extremes(self, [least, greatest]: [f32; 2]) -> Self {
        let fits_bytes = least >= 0.0 && greatest <= BYTE;
        match self {
            Self::Colour if fits_bytes && greatest > BRIGHT => Self::ByteColour,
            Self::ShortColour | Self::WholeColour if fits_bytes => Self::ByteColour,
            Self::WholeColour => Self::Number,
            other => other,
        }
    }
}

/// The kind that [`settled`] gives to a colour, if its values determine it; `None` if several kinds
/// are possible, for example if all values are 0.
pub fn evident_scale(particles: &dyn Particles, index: usize) -> Option<AttributeKind> {
    let extremes = extremes(particles, index);
    let stored = particles.attributes()[index].kind;
    let kind = stored.of_extremes(extremes);
    let is_evident = if stored.is_whole_colour() {
        extremes != [0.0; 2]
    } else {
        kind == AttributeKind::ByteColour || extremes[1] > 0.0 && extremes[1] <= 1.0
    };
    is_evident.then_some(kind)
}

/// The kind of the values of a colour; `None` if the attribute is not a colour.
pub(super) fn colour_kind(particles: &dyn Particles, index: usize) -> Option<AttributeKind> {
    let kind = match particles.attributes()[index].kind {
        stored if stored.has_open_scale() => stored.of_extremes(extremes(particles, index)),
        stored => stored,
    };
    kind.is_colour().then_some(kind)
}

/// Whether all integers of an attribute are equal.
fn is_constant(particles: &dyn Particles, index: usize) -> bool {
    if particles.is_empty() {
        return true;
    }
    let components = particles.attributes()[index].components;
    let mut first = vec![0_i64; components];
    particles.integers(index, 0, &mut first);
    let of_chunk = |range: Range<usize>| {
        let mut values = vec![0_i64; range.len() * components];
        particles.integers(index, range.start, &mut values);
        values.iter().all(|value| *value == first[0])
    };
    chunks(particles, of_chunk).all(|is_constant| is_constant)
}

/// The minimum and maximum over 0 and all finite values of an attribute.
fn extremes(particles: &dyn Particles, index: usize) -> [f32; 2] {
    let components = particles.attributes()[index].components;
    let of_chunk = |range: Range<usize>| {
        let mut values = vec![0.0_f32; range.len() * components];
        particles.attribute(index, range.start, &mut values);
        let finite = values.iter().filter(|x| x.is_finite());
        finite.fold([0.0_f32; 2], |[low, high], &x| [low.min(x), high.max(x)])
    };
    chunks(particles, of_chunk).reduce(|| [0.0; 2], |[a, b], [c, d]| [a.min(c), b.max(d)])
}

/// The minimum and maximum over 0 and all integers of an attribute.
pub(super) fn whole_extremes(particles: &dyn Particles, index: usize) -> [i64; 2] {
    let components = particles.attributes()[index].components;
    let of_chunk = |range: Range<usize>| {
        let mut values = vec![0_i64; range.len() * components];
        particles.integers(index, range.start, &mut values);
        values.iter().fold([0_i64; 2], |[low, high], &x| [low.min(x), high.max(x)])
    };
    chunks(particles, of_chunk).reduce(|| [0; 2], |[a, b], [c, d]| [a.min(c), b.max(d)])
}

/// Whether an integer attribute is a direction: it has three components and the name of a velocity.
pub(crate) fn is_direction_name(info: &AttributeInfo) -> bool {
    velocity_attribute(std::slice::from_ref(info)).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_bytes_round_trip_and_fractions_are_clamped() {
        for byte in 0..=u8::MAX {
            assert_eq!(AttributeKind::ByteColour.byte(f32::from(byte)), byte);
        }
        let shares = [-1.0, 0.0, 0.5, 1.0, 7.0, f32::NAN].map(|x| AttributeKind::Colour.byte(x));
        assert_eq!(shares, [0, 0, 128, 255, 255, 0]);
    }

    #[test]
    fn colours_are_recognised_by_name_and_component_count() {
        let is_colour = |name, components| AttributeKind::of_floats(name, components).is_colour();
        assert!(is_colour("Cd", 3) && is_colour("RGBA", 4) && is_colour("Colors", 3));
        assert!(!is_colour("Cd", 1) && !is_colour("velocity", 3) && !is_colour("red", 3));
        assert_eq!(AttributeKind::of_bytes("rgb", 3), AttributeKind::ByteColour);
    }

    #[test]
    fn integers_are_a_colour_only_in_a_range_that_a_colour_can_have() {
        use AttributeKind::{ByteColour, Number, ShortColour, WholeColour};
        for (stored, extremes, kind) in [
            (WholeColour, [0.0, 255.0], ByteColour),
            (WholeColour, [0.0, 1.0], ByteColour),
            (WholeColour, [0.0, 256.0], Number),
            (WholeColour, [-1.0, 255.0], Number),
            (ShortColour, [0.0, 255.0], ByteColour),
            (ShortColour, [0.0, 256.0], ShortColour),
        ] {
            assert_eq!(stored.of_extremes(extremes), kind, "{stored:?} {extremes:?}");
        }
        for (short, byte) in [(0.0, 0), (257.0, 1), (32768.0, 128), (65535.0, 255)] {
            assert_eq!(ShortColour.byte(short), byte);
        }
    }

    #[test]
    fn integer_colours_of_pieces_have_the_scale_of_all_pieces() {
        use AttributeKind::{ByteColour, Colour, Number, ShortColour, WholeColour};
        for (one, other, kind) in [
            (ByteColour, WholeColour, WholeColour),
            (ByteColour, ShortColour, WholeColour),
            (ShortColour, ShortColour, ShortColour),
            (Colour, WholeColour, Colour),
            (Number, WholeColour, Number),
        ] {
            assert_eq!([one.together(other), other.together(one)], [kind; 2], "{one:?} {other:?}");
        }
    }
}
