//! Kinds of attributes: plain numbers, and colours, which programs look for by other names and
//! types.

use serde::{Deserialize, Serialize};

use super::AttributeInfo;

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
}

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
