//! How wide cells are, by a spacing that is given, in the file, in a scene beside it, or estimated: in this order.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize, Serializer};

use crate::field::indicator::IndicatorKind;
use crate::field::spacing::Spacings;
use crate::frame::FieldRequest;
use crate::grid::units::shown;

/// Edge of a cell, as it is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CellSize {
    /// A length in the unit of the positions.
    Length(f64),
    /// Times the particles' spacing.
    Spacings(f64),
}

impl CellSize {
    /// The default: half a spacing. In cells of two thirds single drops are angular and hold more or less by where they lie; these
    /// take hardly longer, for the surface is made in the same wide cells. Renders of single drops want half as much. The
    /// paper's indicators take two thirds, for symmetry does not bear half a spacing.
    #[must_use]
    pub fn usual(field: FieldRequest) -> Self {
        match field.indicator().map(|asked| asked.kind) {
            Some(IndicatorKind::Cloud) | None => Self::Spacings(0.5),
            Some(IndicatorKind::Counting | IndicatorKind::Symmetry) => Self::Spacings(2.0 / 3.0),
        }
    }
}

/// Where particles come from, as far as it says something of their spacing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Source<'a> {
    /// The file, beside which there may be a scene.
    pub path: Option<&'a Path>,
    /// The spacing that the file says.
    pub spacing: Option<f64>,
}

/// Writes a path down as it is shown: not every one is text.
fn as_text<S: Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
    to.collect_str(&path.display())
}

/// Where a spacing comes from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum SpacingSource {
    /// The caller.
    Given,
    /// The particles' file.
    File,
    /// A scene beside it.
    Scene(#[serde(serialize_with = "as_text")] PathBuf),
    /// The particles themselves.
    Estimated,
}

impl fmt::Display for SpacingSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Given => f.write_str("as given"),
            Self::File => f.write_str("from the file"),
            Self::Scene(path) => write!(f, "from {}", path.display()),
            Self::Estimated => f.write_str("estimated from the particles"),
        }
    }
}

/// Why a spacing may not be that of the particles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Doubt {
    /// The particles are of two resolutions.
    TwoResolutions {
        /// How far most are apart, and how far the others.
        spacings: [f64; 2],
        /// The spacing that all are taken to have.
        taken: f64,
    },
    /// The scene that lies beside them need not be theirs.
    OtherScene {
        /// The scene's file.
        #[serde(serialize_with = "as_text")]
        path: PathBuf,
        /// The spacing that it says.
        said: f64,
        /// The spacing by the particles' density.
        found: f64,
    },
}

impl Doubt {
    /// By how much the spacing of a scene may differ from what its particles look like.
    const SCENE: f64 = 2.0;

    pub(super) fn of(taken: f64, scene: Option<&Path>, found: Spacings) -> Option<Self> {
        if let Some(spacings) = found.two {
            return Some(Self::TwoResolutions { spacings, taken });
        }
        let agree = 1.0 / Self::SCENE..=Self::SCENE;
        let path = scene.filter(|_| !agree.contains(&(taken / found.mean)))?.to_owned();
        Some(Self::OtherScene { path, said: taken, found: found.mean })
    }
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TwoResolutions { spacings: [one, other], taken } => write!(
                f,
                "the particles are of two resolutions, {} and {} apart, and all are taken to be {} apart",
                shown(*one),
                shown(*other),
                shown(*taken)
            ),
            Self::OtherScene { path, said, found } => write!(
                f,
                "{} says that particles are {} apart, by their density they are {}",
                path.display(),
                shown(*said),
                shown(*found)
            ),
        }
    }
}

/// Edge of the cells of a frame, and the spacing that it was taken from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Cells {
    /// Edge of a cell.
    pub size: f64,
    /// Distance between neighbouring particles, where it is known, and where it is known from.
    pub spacing: Option<(f64, SpacingSource)>,
    /// Why the spacing may be wrong.
    pub doubt: Option<Doubt>,
}

impl Cells {
    /// The spacing, where it is known.
    #[must_use]
    pub fn spacing(&self) -> Option<f64> {
        self.spacing.as_ref().map(|(spacing, _)| *spacing)
    }
}

impl fmt::Display for Cells {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = shown(self.size);
        match &self.spacing {
            Some((spacing, source)) => write!(f, "spacing {} ({source}), cell size {size}", shown(*spacing)),
            None => write!(f, "spacing not known, taken to be the cell size; cell size {size}"),
        }
    }
}
