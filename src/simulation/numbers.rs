//! The numbers in the names of a simulation's files: which digits they are, and what the names have in common besides.

use std::path::{Path, PathBuf};

use crate::error::SimulationError;

/// The common part of the names of a simulation's files. A name with `.gz` appended is no other.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Family {
    /// Before the number.
    pub prefix: String,
    /// After the number.
    pub suffix: String,
}

impl std::fmt::Display for Family {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}{{}}{}", self.prefix, self.suffix)
    }
}

/// A file name with a place for a number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern {
    /// The folder of the files.
    pub folder: PathBuf,
    /// Before the number.
    pub prefix: String,
    /// After the number.
    pub suffix: String,
    /// The least number of digits, where `{:04}` says so; padded with zeros.
    pub width: Option<usize>,
}

impl Pattern {
    /// Reads `{}` or `{:04}` in the name of `path`; `None` where there is none.
    ///
    /// # Errors
    /// [`SimulationError::Names`] for more than one, one in a folder's name, or braces that say something else.
    pub fn parse(path: &Path) -> Result<Option<Self>, SimulationError> {
        let wrong = |what: &str| Err(SimulationError::Names(format!("{}: {what}", path.display())));
        let Some(name) = path.file_name().and_then(|name| name.to_str()) else { return Ok(None) };
        let folder = path.parent().unwrap_or(Path::new(""));
        if folder.to_string_lossy().contains("{}") {
            return wrong("{} stands for the number in a file's name, not in a folder's");
        }
        let Some((prefix, rest)) = name.split_once('{') else { return Ok(None) };
        let Some((inside, suffix)) = rest.split_once('}') else { return Ok(None) };
        if suffix.contains('{') {
            return wrong("one {} is enough");
        }
        let width = match inside {
            "" => None,
            _ => match inside.strip_prefix(":0").and_then(|width| width.parse().ok()) {
                Some(width @ 1..=20) => Some(width),
                _ => return wrong("a frame's number is written {} or, padded to four digits, {:04}"),
            },
        };
        let (prefix, suffix) = (prefix.to_owned(), suffix.to_owned());
        Ok(Some(Self { folder: folder.to_owned(), prefix, suffix, width }))
    }

    /// The digits of a name that fits.
    pub(super) fn digits<'a>(&self, name: &'a str) -> Option<&'a str> {
        let digits = name.strip_prefix(&*self.prefix)?.strip_suffix(&*self.suffix)?;
        let padded = |width: usize| digits.len() == width || digits.len() > width && !digits.starts_with('0');
        let fits = all_digits(digits) && self.width.is_none_or(padded);
        fits.then_some(digits)
    }

    /// The name for a number, spelled `digits` where no width is given.
    #[must_use]
    pub fn path(&self, number: u64, digits: &str) -> PathBuf {
        let Self { folder, prefix, suffix, width } = self;
        folder.join(match width {
            Some(width) => format!("{prefix}{number:0width$}{suffix}"),
            None => format!("{prefix}{digits}{suffix}"),
        })
    }
}

fn all_digits(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit())
}

/// Cuts a name around the last digits before its extension.
pub(super) fn split_number(name: &str) -> Option<(&str, &str, &str)> {
    let plain = name.strip_suffix(".gz").unwrap_or(name);
    let stem = match plain.rsplit_once('.') {
        Some((stem, extension)) if !all_digits(extension) => stem,
        _ => plain,
    };
    let is_digit = |c: char| c.is_ascii_digit();
    let end = stem.rfind(is_digit)? + 1;
    let start = stem[..end].trim_end_matches(is_digit).len();
    Some((&name[..start], &name[start..end], &name[end..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_is_the_last_digits_before_the_extensions() {
        for (name, parts) in [
            ("ParticleData_Fluid_12.bgeo", ("ParticleData_Fluid_", "12", ".bgeo")),
            ("fluid.0042.bgeo.gz", ("fluid.", "0042", ".bgeo.gz")),
            ("Part_0005.bi4", ("Part_", "0005", ".bi4")),
            ("run3_é7.csv", ("run3_é", "7", ".csv")),
            ("12.npy", ("", "12", ".npy")),
            ("v2.final_3.ply", ("v2.final_", "3", ".ply")),
            ("fluid.0042", ("fluid.", "0042", "")),
        ] {
            assert_eq!(split_number(name), Some(parts));
        }
        assert_eq!(split_number("fluid.bgeo"), None);
    }

    #[test]
    fn a_pattern_matches_what_it_writes() {
        let padded = Pattern::parse(Path::new("a/x_{:04}.ply")).unwrap().unwrap();
        assert_eq!(padded.path(42, "42"), Path::new("a/x_0042.ply"));
        assert_eq!(padded.digits("x_0042.ply"), Some("0042"));
        assert_eq!(padded.digits("x_12345.ply"), Some("12345"));
        assert_eq!((padded.digits("x_42.ply"), padded.digits("x_01234567.ply")), (None, None));
        let plain = Pattern::parse(Path::new("x{}")).unwrap().unwrap();
        assert_eq!(plain.path(42, "0042"), Path::new("x0042"));
        assert_eq!((plain.digits("x"), plain.digits("x4a"), plain.digits("x007")), (None, None, Some("007")));
        for wrong in ["x_{}_{}.ply", "x_{:4}.ply", "x_{n}.ply", "a_{}/x_{}.ply"] {
            Pattern::parse(Path::new(wrong)).unwrap_err();
        }
        assert_eq!(Pattern::parse(Path::new("x.ply")).unwrap(), None);
    }
}
