//! Boxes and points as text: numbers separated by commas or whitespace.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::grid::Walls;

/// A box: its two ends along each axis. An open axis is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(into = "[Option<f64>; 6]", try_from = "[Option<f64>; 6]")]
pub struct Faces(pub [Option<[f64; 2]>; 3]);

impl Faces {
    /// Makes a box from its lowest and highest corner. An axis from -inf to inf is open.
    #[must_use]
    pub fn from_corners([lowest, highest]: [[f64; 3]; 2]) -> Self {
        let is_open = |ends: &[f64; 2]| *ends == [f64::NEG_INFINITY, f64::INFINITY];
        Self(
            [0, 1, 2].map(|axis| Some([lowest[axis], highest[axis]]).filter(|ends| !is_open(ends))),
        )
    }
}

impl From<Faces> for [Option<f64>; 6] {
    fn from(faces: Faces) -> Self {
        let [x, y, z] = faces.0;
        let end = |ends: Option<[f64; 2]>, end: usize| ends.map(|ends| ends[end]);
        [end(x, 0), end(y, 0), end(z, 0), end(x, 1), end(y, 1), end(z, 1)]
    }
}

impl TryFrom<[Option<f64>; 6]> for Faces {
    type Error = String;

    fn try_from([x0, y0, z0, x1, y1, z1]: [Option<f64>; 6]) -> Result<Self, String> {
        let axis = |(name, ends)| match ends {
            (Some(lo), Some(hi)) => Ok(Some([lo, hi])),
            (None, None) => Ok(None),
            _ => Err(format!(
                "only one end of {name} is open: give both ends a coordinate, or mark both ends as \
                 open"
            )),
        };
        Ok(Self([axis(("x", (x0, x1)))?, axis(("y", (y0, y1)))?, axis(("z", (z0, z1)))?]))
    }
}

impl FromStr for Faces {
    type Err = String;

    /// Reads six numbers. Both ends of an open axis are written as `-`.
    fn from_str(text: &str) -> Result<Self, String> {
        ends(text)?.try_into().map_err(|what| format!("{what} with -"))
    }
}

/// A requested tank.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Tank {
    /// Walls that meniscus finds from the scene file and the particles.
    Auto,
    /// Walls at these coordinates.
    #[serde(untagged)]
    Walls(Walls),
}

impl FromStr for Tank {
    type Err = String;

    /// Reads `auto`, or six numbers. A `-` in place of a number means an open side.
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            _ => ends(text).map(|ends| Self::Walls(ends.into())),
        }
    }
}

/// Reads six numbers. A `-` in place of a number becomes `None`.
pub(super) fn ends(text: &str) -> Result<[Option<f64>; 6], String> {
    let end = |part: &str| match part {
        "-" => Ok(None),
        number => number.parse().map(Some).map_err(|e| format!("{number:?}: {e}")),
    };
    let ends: Vec<Option<f64>> = parts(text).map(end).collect::<Result<_, String>>()?;
    let count = ends.len();
    ends.try_into().map_err(|_| format!("expected 6 numbers separated by commas, got {count}"))
}

/// Reads three numbers.
pub(super) fn point(text: &str) -> Result<[f64; 3], String> {
    let values: Result<Vec<f64>, _> = parts(text).map(str::parse).collect();
    let values = values.map_err(|e| e.to_string())?;
    values
        .try_into()
        .map_err(|v: Vec<f64>| format!("expected 3 numbers separated by commas, got {}", v.len()))
}

/// Splits a list at its commas or, if it has none, at whitespace.
fn parts(text: &str) -> impl Iterator<Item = &str> {
    let by_commas = text.contains(',');
    text.split(move |c: char| if by_commas { c == ',' } else { c.is_whitespace() })
        .map(str::trim)
        .filter(move |part| by_commas || !part.is_empty())
}
