//! Values of settings, and their conversion from a caller's values.

use std::convert::Infallible;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::{Faces, Tank};
use crate::field::indicator::IndicatorKind;
use crate::grid::{PeriodicMesh, Walls};
use crate::io::input::InputFormat;
use crate::particles::condition::Where;
use crate::surface::mesh::up::UpAxis;

/// The method that makes the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum MethodName {
    /// Discrete indicator functions.
    Dif,
    /// Kernels of Mueller, Charypar and Gross 2003.
    Mueller,
    /// Kernels of Zhu and Bridson 2005.
    ZhuBridson,
    /// Anisotropic kernels of Yu and Turk 2013.
    YuTurk,
}

/// A requested isovalue.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Iso {
    /// The isovalue is measured.
    Auto,
    /// A value between 0 and 1.
    #[serde(untagged)]
    Value(f64),
}

impl FromStr for Iso {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            _ => text
                .parse()
                .map(Self::Value)
                .map_err(|_| "expected a number between 0 and 1, or auto".to_owned()),
        }
    }
}

/// Removes the whitespace around a name from a list. This function never fails. It returns a
/// `Result` because the parser of the command line requires one.
pub(super) fn trimmed(name: &str) -> Result<String, Infallible> {
    Ok(name.trim().to_owned())
}

/// A field of [`Settings`](super::Settings) that may have no value.
pub(super) trait OptionalSetting {
    /// Whether the field has no value.
    fn is_unset(&self) -> bool;
}

impl<T> OptionalSetting for Option<T> {
    fn is_unset(&self) -> bool {
        self.is_none()
    }
}

impl OptionalSetting for bool {
    fn is_unset(&self) -> bool {
        !self
    }
}

/// The value of a setting from a caller in another language, such as Python or C. Each method that
/// returns a `Result` fails for a value of another type.
#[allow(missing_docs, clippy::missing_errors_doc)]
pub trait Source {
    type Error;
    fn number(&self) -> Result<f64, Self::Error>;
    /// Takes a non-negative integer.
    fn count<T: TryFrom<u64>>(&self) -> Result<T, Self::Error>;
    fn switch(&self) -> Result<bool, Self::Error>;
    fn text(&self) -> Result<String, Self::Error>;
    /// Takes one of `words`, and returns its index.
    fn one_of(&self, words: &[&str]) -> Result<usize, Self::Error>;
    fn names(&self) -> Result<Vec<String>, Self::Error>;
    fn point(&self) -> Result<[f64; 3], Self::Error>;
    /// Takes a box, given by its lowest and highest corners.
    fn faces(&self) -> Result<Faces, Self::Error>;
    /// Takes the coordinates of walls. Any side may be open.
    fn walls(&self) -> Result<Walls, Self::Error>;
    /// Takes conditions on particles.
    fn conditions(&self) -> Result<Where, Self::Error>;
    /// Whether the value is equal to this word.
    fn is_word(&self, word: &str) -> bool;
}

/// The value of a setting, taken from a [`Source`].
pub trait FromSource: Sized {
    /// Converts the value from `source`.
    ///
    /// # Errors
    /// The errors of the source.
    fn taken<S: Source>(source: &S) -> Result<Self, S::Error>;
}

impl<T: FromSource> FromSource for Option<T> {
    fn taken<S: Source>(source: &S) -> Result<Self, S::Error> {
        T::taken(source).map(Some)
    }
}

macro_rules! taken {
    ($($type:ty: $by:ident),*) => {
        $(impl FromSource for $type {
            fn taken<S: Source>(source: &S) -> Result<Self, S::Error> {
                source.$by()
            }
        })*
    };
}

taken!(f64: number, u32: count, bool: switch, String: text, Vec<String>: names, [f64; 3]: point, Faces: faces);

impl FromSource for Vec<Where> {
    fn taken<S: Source>(source: &S) -> Result<Self, S::Error> {
        Ok(vec![source.conditions()?])
    }
}

impl FromSource for Tank {
    fn taken<S: Source>(source: &S) -> Result<Self, S::Error> {
        if source.is_word("auto") { Ok(Self::Auto) } else { source.walls().map(Self::Walls) }
    }
}

impl FromSource for Iso {
    fn taken<S: Source>(source: &S) -> Result<Self, S::Error> {
        if source.is_word("auto") { Ok(Self::Auto) } else { source.number().map(Self::Value) }
    }
}

macro_rules! taken_by_name {
    ($($type:ty: $($name:literal => $value:ident),*;)*) => {
        $(impl FromSource for $type {
            fn taken<S: Source>(source: &S) -> Result<Self, S::Error> {
                // If the list lacks a variant, this match does not compile.
                let _all = |value: &Self| match value { $(Self::$value => ()),* };
                source.one_of(&[$($name),*]).map(|index| [$(Self::$value),*][index])
            }
        })*
    };
}

taken_by_name! {
    IndicatorKind: "cloud" => Cloud, "counting" => Counting, "symmetry" => Symmetry;
    MethodName: "dif" => Dif, "mueller" => Mueller, "zhu-bridson" => ZhuBridson, "yu-turk" => YuTurk;
    InputFormat: "bgeo" => Bgeo, "bi4" => Bi4, "csv" => Csv, "hdf5" => Hdf5, "json" => Json, "lammps" => Lammps, "npy" => Npy, "npz" => Npz, "ply" => Ply,
        "pvtp" => Pvtp, "tecplot" => Tecplot, "vtk" => Vtk, "vtp" => Vtp, "xyz" => Xyz;
    UpAxis: "y" => Y, "z" => Z;
    PeriodicMesh: "cut" => Cut, "overlap" => Overlap;
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::fmt::Debug;

    use super::*;

    /// A source that always chooses the word at this index, and records the words to choose from.
    struct IndexSource(usize, RefCell<Vec<String>>);

    impl Source for IndexSource {
        type Error = ();
        fn one_of(&self, words: &[&str]) -> Result<usize, ()> {
            *self.1.borrow_mut() = words.iter().map(|word| (*word).to_owned()).collect();
            Ok(self.0)
        }
        fn number(&self) -> Result<f64, ()> {
            Err(())
        }
        fn count<T: TryFrom<u64>>(&self) -> Result<T, ()> {
            Err(())
        }
        fn switch(&self) -> Result<bool, ()> {
            Err(())
        }
        fn text(&self) -> Result<String, ()> {
            Err(())
        }
        fn names(&self) -> Result<Vec<String>, ()> {
            Err(())
        }
        fn point(&self) -> Result<[f64; 3], ()> {
            Err(())
        }
        fn faces(&self) -> Result<Faces, ()> {
            Err(())
        }
        fn walls(&self) -> Result<Walls, ()> {
            Err(())
        }
        fn conditions(&self) -> Result<Where, ()> {
            Err(())
        }
        fn is_word(&self, _: &str) -> bool {
            false
        }
    }

    fn assert_same_names_as_in_files<T: FromSource + Serialize + Debug>(count: usize) {
        for index in 0..count {
            let source = IndexSource(index, RefCell::default());
            let value = T::taken(&source).unwrap();
            let words = source.1.into_inner();
            assert_eq!(words.len(), count);
            assert_eq!(serde_json::to_value(&value).unwrap(), words[index].as_str(), "{value:?}");
        }
    }

    #[test]
    fn value_names_are_the_same_for_callers_and_files() {
        assert_same_names_as_in_files::<IndicatorKind>(3);
        assert_same_names_as_in_files::<MethodName>(4);
        assert_same_names_as_in_files::<InputFormat>(14);
        assert_same_names_as_in_files::<UpAxis>(2);
        assert_same_names_as_in_files::<PeriodicMesh>(2);
    }
}
