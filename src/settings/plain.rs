//! Values of settings as text or as numbers, as callers in C pass them.

use super::value::trimmed;
use super::{Faces, Source, Where, faces};
use crate::grid::Walls;

/// The largest count that a caller may give as a 64-bit float: 2^53. A 64-bit float represents all
/// integers up to this count exactly.
const LARGEST_COUNT: f64 = 9_007_199_254_740_992.0;

/// Descriptions of the expected value, for the errors of both kinds of sources.
mod expected {
    pub const NUMBER: &str = "expected a number";
    pub const COUNT: &str = "expected a whole number, 0 or greater";
    pub const SWITCH: &str = "expected true or false";
    pub const TEXT: &str = "expected text";
    pub const POINT: &str = "expected 3 numbers: x, y, z";
    pub const FACES: &str = "expected 6 numbers: the lowest corner and the highest";
    pub const WALLS: &str = "expected auto or 6 numbers: the lowest corner and the highest";

    pub fn one_of(words: &[&str]) -> String {
        format!("expected one of {}", words.join(", "))
    }

    /// Text of the error for a count that is too large for its setting.
    pub fn smaller() -> String {
        "expected a smaller number".into()
    }
}

/// Text in the command line's syntax, independent of the locale.
///
/// An error says what is expected, such as "expected a number".
impl Source for &str {
    type Error = String;

    fn number(&self) -> Result<f64, String> {
        self.parse().map_err(|_| expected::NUMBER.into())
    }

    fn count<T: TryFrom<u64>>(&self) -> Result<T, String> {
        let count: u64 = self.parse().map_err(|_| expected::COUNT)?;
        T::try_from(count).map_err(|_| expected::smaller())
    }

    fn switch(&self) -> Result<bool, String> {
        self.parse().map_err(|_| expected::SWITCH.into())
    }

    fn text(&self) -> Result<String, String> {
        Ok((*self).to_owned())
    }

    fn one_of(&self, words: &[&str]) -> Result<usize, String> {
        words.iter().position(|word| word == self).ok_or_else(|| expected::one_of(words))
    }

    fn names(&self) -> Result<Vec<String>, String> {
        let Ok(names) = self.split(',').map(trimmed).collect::<Result<_, _>>();
        Ok(names)
    }

    fn point(&self) -> Result<[f64; 3], String> {
        faces::point(self).map_err(|_| expected::POINT.into())
    }

    fn faces(&self) -> Result<Faces, String> {
        self.parse()
            .map_err(|_: String| format!("{}, or - for both ends of an axis", expected::FACES))
    }

    fn walls(&self) -> Result<Walls, String> {
        let ends = faces::ends(self);
        ends.map(Walls::from).map_err(|_| format!("{}, or - for an open side", expected::WALLS))
    }

    fn conditions(&self) -> Result<Where, String> {
        self.parse()
    }

    fn is_word(&self, word: &str) -> bool {
        *self == word
    }
}

/// One number, or several for a point, a box or walls. -inf and inf stand for an open axis of a
/// box, or for an open side of walls. A switch is 0 or 1.
///
/// An error says what is expected, such as "expected a number".
impl Source for &[f64] {
    type Error = String;

    fn number(&self) -> Result<f64, String> {
        match self {
            [number] => Ok(*number),
            _ => Err(expected::NUMBER.into()),
        }
    }

    fn count<T: TryFrom<u64>>(&self) -> Result<T, String> {
        match self {
            [count] if count.fract() == 0.0 && (0.0..=LARGEST_COUNT).contains(count) => {
                T::try_from(*count as u64).map_err(|_| expected::smaller())
            }
            _ => Err(expected::COUNT.into()),
        }
    }

    fn switch(&self) -> Result<bool, String> {
        match self {
            [0.0] => Ok(false),
            [1.0] => Ok(true),
            _ => Err(expected::SWITCH.into()),
        }
    }

    fn text(&self) -> Result<String, String> {
        Err(expected::TEXT.into())
    }

    fn one_of(&self, words: &[&str]) -> Result<usize, String> {
        Err(expected::one_of(words))
    }

    fn names(&self) -> Result<Vec<String>, String> {
        Err(expected::TEXT.into())
    }

    fn point(&self) -> Result<[f64; 3], String> {
        <[f64; 3]>::try_from(*self).map_err(|_| expected::POINT.into())
    }

    fn faces(&self) -> Result<Faces, String> {
        match **self {
            [x0, y0, z0, x1, y1, z1] => Ok(Faces::from_corners([[x0, y0, z0], [x1, y1, z1]])),
            _ => Err(expected::FACES.into()),
        }
    }

    fn walls(&self) -> Result<Walls, String> {
        match **self {
            [x0, y0, z0, x1, y1, z1] => Ok(Walls::from_corners([[x0, y0, z0], [x1, y1, z1]])),
            _ => Err(expected::WALLS.into()),
        }
    }

    fn conditions(&self) -> Result<Where, String> {
        Err(expected::TEXT.into())
    }

    fn is_word(&self, _: &str) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Iso, Settings, Tank};

    fn set<S: Source>(name: &str, source: S) -> Result<Settings, S::Error> {
        let mut settings = Settings::default();
        assert!(settings.set(name, &source)?, "no setting {name}");
        Ok(settings)
    }

    #[test]
    fn text_and_numbers_set_equal_values() {
        let numbers = |name, numbers: &[f64]| set(name, numbers).unwrap();
        let text = |name, text: &str| set(name, text).unwrap();
        assert_eq!(text("spacing", "5e-2"), numbers("spacing", &[0.05]));
        assert_eq!(text("smallest_drop", "7"), numbers("smallest_drop", &[7.0]));
        assert_eq!(text("detail", "true"), numbers("detail", &[1.0]));
        assert_eq!(text("iso", "0.4"), numbers("iso", &[0.4]));
        assert_eq!(text("iso", "auto").iso, Some(Iso::Auto));
        let origin = numbers("origin", &[1.0, -2.0, 0.5]);
        for list in ["1,-2,0.5", "1, -2, 0.5", "1 -2 0.5", " 1\t-2  .5"] {
            assert_eq!(text("origin", list), origin, "{list:?}");
        }
        let (lo, hi) = (f64::NEG_INFINITY, f64::INFINITY);
        let domain = numbers("domain", &[0.0, lo, 1.0, 2.0, hi, 3.0]);
        for list in ["0,-,1,2,-,3", "0 - 1 2 - 3"] {
            assert_eq!(text("domain", list), domain, "{list:?}");
        }
        let open_above = numbers("domain", &[0.0, 0.0, 1.0, 2.0, hi, 3.0]);
        assert_eq!(text("domain", "0,0,1,2,-,3"), open_above);
        assert_eq!(text("domain", "auto").domain, Some(Tank::Auto));
        for list in ["heat,age", "heat, age", " heat\t, age "] {
            assert_eq!(text("attributes", list).attributes.unwrap(), ["heat", "age"], "{list:?}");
        }
    }

    #[test]
    fn values_of_a_wrong_type_are_refused_with_the_expected_type() {
        for (name, text, expected) in [
            ("spacing", "0,05", "expected a number"),
            ("spacing", "", "expected a number"),
            ("smallest_drop", "-1", "expected a whole number, 0 or greater"),
            ("smallest_drop", "4294967296", "expected a smaller number"),
            ("detail", "yes", "expected true or false"),
            ("up", "x", "expected one of y, z"),
            ("iso", "Auto", "expected a number"),
        ] {
            assert_eq!(set(name, text).unwrap_err(), expected, "{name} {text:?}");
        }
        assert!(set("origin", "1,2").unwrap_err().starts_with(expected::POINT));
        assert!(set("domain", "Auto").unwrap_err().starts_with(expected::WALLS));
        assert!(set("periodic", "0,-,1,2,3,4").unwrap_err().starts_with(expected::FACES));
        for (name, numbers, expected) in [
            ("spacing", &[][..], "expected a number"),
            ("smallest_drop", &[0.5], "expected a whole number, 0 or greater"),
            ("smallest_drop", &[f64::NAN], "expected a whole number, 0 or greater"),
            ("smallest_drop", &[1e300], "expected a whole number, 0 or greater"),
            ("smallest_drop", &[4_294_967_296.0], "expected a smaller number"),
            ("detail", &[2.0], "expected true or false"),
            ("up", &[1.0], "expected one of y, z"),
            ("attributes", &[1.0], "expected text"),
            ("format", &[1.0], "expected one of bgeo, "),
            ("origin", &[1.0, 2.0], expected::POINT),
            ("periodic", &[1.0, 2.0, 3.0], expected::FACES),
        ] {
            let found = set(name, numbers).unwrap_err();
            assert!(found.starts_with(expected), "{name} {numbers:?}: {found}");
        }
    }
}
