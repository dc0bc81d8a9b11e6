//! Converts the values of keywords. Errors name the keyword.

use std::path::PathBuf;

use bytesize::ByteSize;
use meniscus::{Faces, Source, Walls, Where};
use pyo3::exceptions::{PyOverflowError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::PyString;

use crate::errors::InputError;

/// A keyword with its value.
pub struct Keyword<'a, 'py> {
    pub name: &'a str,
    pub value: &'a Bound<'py, PyAny>,
}

impl<'py> Keyword<'_, 'py> {
    /// The exception for a value of the wrong type; `what` describes the expected type.
    fn type_error(&self, what: &str) -> PyErr {
        let kind =
            self.value.get_type().name().map_or_else(|_| "that".into(), |name| name.to_string());
        PyTypeError::new_err(format!("{}: must be {what}, not {kind}", self.name))
    }

    /// Takes a non-negative integer.
    pub fn whole<T: TryFrom<u64>>(&self) -> PyResult<T> {
        let number: i128 = self.value.extract().map_err(|_| self.type_error("a whole number"))?;
        let count = u64::try_from(number).ok().and_then(|number| T::try_from(number).ok());
        count.ok_or_else(|| InputError::new_err(format!("{}: {number} is out of range", self.name)))
    }

    /// Takes a frame number, which may be negative.
    pub fn frame(&self) -> PyResult<i64> {
        self.value.extract().map_err(|fault: PyErr| {
            if fault.is_instance_of::<PyOverflowError>(self.value.py()) {
                InputError::new_err(format!("{}: {} is out of range", self.name, self.value))
            } else {
                self.type_error("a whole number")
            }
        })
    }

    /// Takes a text, or an integer, which is converted to its digits.
    pub fn text_or_number(&self) -> PyResult<String> {
        match self.value.extract::<u32>() {
            Ok(number) => Ok(number.to_string()),
            Err(_) => self.value.extract().map_err(|_| self.type_error("a str or a whole number")),
        }
    }

    pub fn path(&self) -> PyResult<PathBuf> {
        self.value.extract().map_err(|_| self.type_error("a str or a path"))
    }

    /// Takes numbers and `None` from a sequence, or from a sequence of sequences.
    fn ends(&self) -> PyResult<Vec<Option<f64>>> {
        let not_numbers = |_| self.type_error("a sequence of numbers");
        let mut ends = Vec::new();
        for item in self.value.try_iter().map_err(not_numbers)? {
            let item = item?;
            if let Ok(end) = item.extract::<Option<f64>>() {
                ends.push(end);
                continue;
            }
            for end in item.try_iter().map_err(not_numbers)? {
                ends.push(end?.extract().map_err(not_numbers)?);
            }
        }
        Ok(ends)
    }

    /// Takes six numbers, or two corners of three numbers each.
    fn six_ends(&self) -> PyResult<[Option<f64>; 6]> {
        self.ends()?.try_into().map_err(|_| {
            let what = "must be six numbers: x0, y0, z0, x1, y1, z1";
            InputError::new_err(format!("{}: {what}", self.name))
        })
    }

    /// Takes a number of bytes, or a size such as `"512MiB"`.
    pub fn bytes(&self) -> PyResult<u64> {
        if self.value.is_instance_of::<PyString>() {
            let text = self.text()?;
            let size: Result<ByteSize, _> = text.parse();
            return size.map(|size| size.as_u64()).map_err(|_| {
                InputError::new_err(format!(
                    "{}: {text:?} is not a size such as \"512MiB\"",
                    self.name
                ))
            });
        }
        self.whole()
    }
}

impl<'py> Source for Keyword<'_, 'py> {
    type Error = PyErr;

    fn number(&self) -> PyResult<f64> {
        self.value.extract().map_err(|_| self.type_error("a number"))
    }

    fn count<T: TryFrom<u64>>(&self) -> PyResult<T> {
        self.whole()
    }

    fn switch(&self) -> PyResult<bool> {
        // `extract::<bool>` also accepts a numpy.bool.
        let is_bool = self.value.extract::<bool>();
        is_bool.map_err(|_| self.type_error("True or False"))
    }

    fn text(&self) -> PyResult<String> {
        self.value.extract().map_err(|_| self.type_error("a str"))
    }

    fn one_of(&self, words: &[&str]) -> PyResult<usize> {
        let word = self.text()?;
        words.iter().position(|known| *known == word).ok_or_else(|| {
            let known = words.join(", ");
            InputError::new_err(format!("{}: {word:?} is not one of {known}", self.name))
        })
    }

    /// Takes a list of names or paths. A single string is an error, because Python would treat it
    /// as a list of letters.
    fn names(&self) -> PyResult<Vec<String>> {
        if self.value.is_instance_of::<PyString>() {
            return Err(self.type_error("a list of names or paths"));
        }
        let name = |name: PyResult<Bound<'py, PyAny>>| {
            let name = name?;
            let path = || {
                name.extract::<PathBuf>()?.into_os_string().into_string().map_err(|_| {
                    InputError::new_err(format!("{}: {name} is not valid Unicode", self.name))
                })
            };
            name.extract().or_else(|_| path())
        };
        let names = self.value.try_iter().and_then(|names| names.map(name).collect());
        names.map_err(|error: PyErr| match error.is_instance_of::<InputError>(self.value.py()) {
            true => error,
            false => self.type_error("a list of names or paths"),
        })
    }

    fn point(&self) -> PyResult<[f64; 3]> {
        let ends = self.ends()?;
        let numbers: Option<Vec<f64>> = ends.into_iter().collect();
        numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(|| {
            InputError::new_err(format!("{}: must be three numbers: x, y, z", self.name))
        })
    }

    /// Takes six numbers, or two corners of three numbers each. `None` at both ends opens an axis.
    fn faces(&self) -> PyResult<Faces> {
        let invalid =
            |what: String| InputError::new_err(format!("{}: {what} with None", self.name));
        self.six_ends()?.try_into().map_err(invalid)
    }

    /// Takes six numbers, or two corners of three numbers each. `None` opens a side.
    fn walls(&self) -> PyResult<Walls> {
        self.six_ends().map(Walls::from)
    }

    /// Takes conditions as a string, or as a list of strings that must all hold.
    fn conditions(&self) -> PyResult<Where> {
        let text = match self.text() {
            Ok(text) => text,
            Err(_) => {
                self.names().map_err(|_| self.type_error("a str or a list of str"))?.join(" and ")
            }
        };
        text.parse().map_err(|what| InputError::new_err(format!("{}: {what}", self.name)))
    }

    fn is_word(&self, word: &str) -> bool {
        self.text().is_ok_and(|text| text == word)
    }
}
