//! The cell size of a frame. It follows from the first known spacing in this order: the spacing
//! that the caller gave, the spacing in the file, the spacing in a scene file next to it, an
//! estimate.

use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::field::indicator::IndicatorKind;
use crate::field::spacing::Plane;
use crate::field::walls::GapAtWall;
use crate::frame::Method;
use crate::grid::Walls;
use crate::grid::units::shown;
use crate::particles::sizes::Sizes;
use crate::particles::{Particles, finite_chunks};

use super::spacing::{SpacingSource, SpacingWarning};

/// Requested edge of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CellSize {
    /// A length in the unit of the positions.
    Length(f64),
    /// A multiple of the particles' spacing.
    Spacings(f64),
}

impl CellSize {
    /// The default: half a spacing for clouds and kernel methods, two thirds of a spacing for
    /// counting and symmetry.
    ///
    /// In cells of two thirds of a spacing, single drops are angular, and their volume depends on
    /// their position. Cells of half a spacing take hardly more time, because the surface of the
    /// bulk is computed on the same wide cells. Renders of single drops need cells of a quarter of
    /// a spacing. The indicators counting and symmetry use two thirds of a spacing, because
    /// symmetry fails in cells of half a spacing.
    pub fn usual(method: Method) -> Self {
        match method.indicator() {
            Some(IndicatorKind::Cloud) | None => Self::Spacings(0.5),
            Some(IndicatorKind::Counting | IndicatorKind::Symmetry) => Self::Spacings(2.0 / 3.0),
        }
    }
}

/// Where the spacing of particles can come from, if the caller does not set it.
#[derive(Debug, Clone, Copy, Default)]
pub struct SpacingHints<'a> {
    /// The file; a scene file may be next to it.
    pub path: Option<&'a Path>,
    /// The spacing in the file.
    pub spacing: Option<f64>,
}

/// Cell size of a frame, and the spacing from which it follows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Cells {
    /// Edge of a cell.
    pub size: f64,
    /// Distance between neighbouring particles, if known, with its source.
    pub spacing: Option<(f64, SpacingSource)>,
    /// The grid's origin, if it was moved because the particles are far from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin: Option<[f64; 3]>,
    /// The slab around particles of a two-dimensional simulation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slab: Option<Slab>,
    /// The particles' sizes, if they have several sizes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sizes: Option<Sizes>,
    /// Walls that the scene file and the particles indicate, if requested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub walls: Option<FoundWalls>,
    /// Reasons why the spacing may be wrong.
    pub warnings: Vec<SpacingWarning>,
}

/// Tank walls that meniscus found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct FoundWalls {
    /// The walls.
    pub walls: Walls,
    /// The scene file with the walls; without one, the walls are planes at which the particles end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<PathBuf>,
    /// The spacing at the lower and the upper side along each axis; `None` if every side has the
    /// spacing of the smallest particles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spacings: Option<[[f64; 2]; 3]>,
}

/// Distances, in spacings, between the end of the fluid and a wall that make the surface at the
/// wall ragged. At these distances, the fluid is too far from the wall to reach it, and too near to
/// have a surface of its own.
const RAGGED_GAP_SPACINGS: Range<f64> = 0.35..1.0;

impl FoundWalls {
    /// The sides of `walls` that the fluid almost reaches. `spacing` is used at every side if
    /// `self.spacings` is `None`.
    pub(super) fn gaps(&self, walls: [DVec3; 2], spacing: f64) -> Vec<GapAtWall> {
        let gap = |axis: usize, side: usize| {
            let (end, wall) = (self.walls.0[axis][side]?, walls[side][axis]);
            let outwards = if side == 0 { end - wall } else { wall - end };
            let spacing = self.spacings.map_or(spacing, |spacings| spacings[axis][side]);
            let axis = ['x', 'y', 'z'][axis];
            RAGGED_GAP_SPACINGS.contains(&(outwards / spacing)).then_some(GapAtWall {
                axis,
                wall,
                end,
            })
        };
        (0..3)
            .flat_map(|axis| [0, 1].map(|side| (axis, side)))
            .filter_map(|(a, s)| gap(a, s))
            .collect()
    }
}

impl fmt::Display for FoundWalls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.scene, self.walls.is_open()) {
            (_, true) => f.write_str("no walls were found"),
            (Some(scene), false) => {
                write!(f, "walls {} (from {} and the particles)", self.walls, scene.display())
            }
            (None, false) => {
                write!(f, "walls {} (planes at which the particles end)", self.walls)
            }
        }
    }
}

/// A slab across an axis, one spacing thick.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Slab {
    /// 0, 1 or 2 for x, y or z.
    pub axis: usize,
    /// The faces' coordinates along that axis.
    pub faces: [f64; 2],
}

impl Slab {
    /// The slab around a plane of particles.
    #[must_use]
    pub fn around(plane: Plane, spacing: f64) -> Self {
        Self { axis: plane.axis, faces: [plane.at - spacing / 2.0, plane.at + spacing / 2.0] }
    }
}

impl Slab {
    /// Whether all `particles` lie in the slab's plane, like the particles for which the slab was
    /// found.
    #[must_use]
    pub fn holds(&self, particles: &dyn Particles) -> bool {
        let Self { axis, faces: [lo, hi] } = *self;
        /// The maximum distance of particles from the slab's plane, as a fraction of the slab's
        /// thickness.
        const NEAR: f64 = 0.05;
        let (at, near) = (lo + (hi - lo) / 2.0, NEAR * (hi - lo));
        axis < 3
            && finite_chunks(particles)
                .all(|chunk| chunk.iter().all(|p| (p[axis] - at).abs() <= near))
    }
}

impl fmt::Display for Slab {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let axis = ["x", "y", "z"].get(self.axis).copied().unwrap_or_default();
        let [lo, hi] = self.faces.map(shown);
        let at = shown((self.faces[0] + self.faces[1]) / 2.0);
        write!(
            f,
            "all particles lie in the plane {axis} = {at}: meshing a slab from {lo} to {hi}, \
             one spacing thick"
        )
    }
}

impl Cells {
    /// The walls that were found, if requested.
    #[must_use]
    pub fn found(&self) -> Option<&Walls> {
        self.walls.as_ref().map(|found| &found.walls)
    }

    /// The spacing and the sizes, if known.
    #[must_use]
    pub fn lengths(&self) -> (Option<f64>, Option<&Sizes>) {
        (self.spacing(), self.sizes.as_ref())
    }

    /// The spacing, if known.
    #[must_use]
    pub fn spacing(&self) -> Option<f64> {
        self.spacing.as_ref().map(|(spacing, _)| *spacing)
    }
}

impl fmt::Display for Cells {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = shown(self.size);
        match &self.spacing {
            Some((spacing, source)) => {
                write!(f, "spacing {} ({source}), cell size {size}", shown(*spacing))
            }
            None => write!(f, "spacing unknown, assumed to be the cell size; cell size {size}"),
        }?;
        if let Some(sizes) = &self.sizes {
            write!(f, ", sizes up to {}", shown(sizes.coarsest))?;
        }
        match self.origin {
            Some(origin) => write!(f, ", origin {}", origin.map(shown).join(",")),
            None => Ok(()),
        }
    }
}
