//! How finely a field of 16 bits tells where its surface is.
//!
//! A step of distances is 1 / 8192 of a spacing in cells of any size. Of the paper's indicators:
//!
//! In cells of h spacings a cell of deep fluid holds h^3 particles, and the plateau P is as small a
//! part of what a cell full of them would have. A flat surface is drawn through P Phi(x / s), x
//! being the depth and s the standard deviation of what a particle is smoothed into. One step of
//! the field therefore moves it by s / (P phi(z)), where Phi(z) = 0.47.

use std::fmt;

use thiserror::Error;

use crate::field::blur::Smoothing;
use crate::field::indicator::{Indicator, IndicatorKind, SampledDif};
use crate::grid::units::{MeanCount, Sigma, shown};

use super::Plateau;
use super::expected::expected;

/// phi(z), the density of the standard normal distribution where the surface is drawn.
const DENSITY: f64 = 0.3978;

/// The most that a step of the field may move a flat surface, in cells. From there on its steps can
/// be seen in the light.
pub const COARSEST_STEP: f64 = 0.125;

/// The cells that are just too fine for symmetry, in spacings. Seven of eight are empty deep in the
/// fluid, and where the others' particles happen to lie moves the surface.
pub const FINEST_OF_SYMMETRY: f64 = 0.5;

/// The finest cells in which distances from clouds are made, in spacings: drops of a particle alone
/// are twelve of them wide.
pub const FINEST: f64 = 0.1;

/// The least mean indicator of full cells in which particles lie as they may. By symmetry it is
/// 0.44 in disorder, where a cell holds one particle, and next to nothing of a lattice whose
/// particles lie on the corners of cells.
pub const ON_CORNERS: f64 = 0.2;

/// Cells in which it cannot be told finely enough where the surface is.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum TooFine {
    /// The field's steps are too large.
    #[error(
        "cells of {} are too fine for 16-bit samples: the field deep in the fluid is \
         {plateau:.1} of 65535, so one step moves the surface by {step_cells:.3} cells (at most \
         {COARSEST_STEP} are allowed); {remedy}",
        shown(*cell_size)
    )]
    Steps {
        /// Edge of a cell.
        cell_size: f64,
        /// The field deep in the fluid; a mean where it is expected, and not measured.
        plateau: f64,
        /// How far one step of the field moves a flat surface, in cells.
        step_cells: f64,
        /// How to make the field finer.
        remedy: Remedy,
    },
    /// Cells so fine that even drops need none finer.
    #[error(
        "cells of {} are smaller than {FINEST} spacings: use cells of {} or more",
        shown(*cell_size), shown(roundly_above(FINEST * spacing))
    )]
    Finest {
        /// Edge of a cell.
        cell_size: f64,
        /// The particles' spacing.
        spacing: f64,
    },
    /// Too many cells are empty to tell how particles lie in them.
    #[error(
        "cells of {} are too fine for symmetry, because at most one of eight contains a \
         particle: use cells of {} or more",
        shown(*cell_size), shown(roundly_above(FINEST_OF_SYMMETRY * spacing))
    )]
    Symmetry {
        /// Edge of a cell.
        cell_size: f64,
        /// The particles' spacing.
        spacing: f64,
    },
}

/// A way to make a field finer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Remedy {
    /// Cells of this edge.
    Cells(f64),
    /// A grid on which particles do not lie on the corners of cells, where symmetry sees next to
    /// nothing: one with this origin.
    Origin([f64; 3]),
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cells(size) => write!(f, "use cells of {} or more", shown(*size)),
            Self::Origin([x, y, z]) => write!(
                f,
                "the particles lie on corners of cells, where symmetry is almost 0: move the \
                 grid's origin to {x},{y},{z}"
            ),
        }
    }
}

/// How far one step of a field moves a flat surface, in cells, by its plateau and by the standard
/// deviation of what a particle is smoothed into.
fn step_cells(plateau: f64, width: f64) -> f64 {
    width / (DENSITY * plateau)
}

/// Refuses cells that are too fine for particles of a known spacing, before there is a DIF, by a
/// Gaussian that may depend on their size; those that are found to be so only once mu0 is known are
/// refused by [`calibrate`](super::calibrate).
pub fn refuse_too_fine_for(
    kind: IndicatorKind,
    mean: Option<MeanCount>,
    spacing: f64,
    cell_size: f64,
    sigma: impl Fn(f64) -> Sigma,
) -> Result<(), TooFine> {
    let by = match kind {
        IndicatorKind::Cloud => return refuse_finest(Some(spacing / cell_size), cell_size),
        // The fewer particles there are in full cells, the more each of them makes of its own, and
        // there is one at least.
        IndicatorKind::Counting => Indicator::Counting(
            mean.unwrap_or_else(|| MeanCount::new(1.0).expect("a number within the bounds")),
        ),
        IndicatorKind::Symmetry => Indicator::Symmetry,
    };
    refuse_symmetry(kind, Some(spacing / cell_size), cell_size)?;
    let plateau = |size: f64| expected(by, spacing / size, None);
    let width = |size: f64| Smoothing::new(kind, sigma(size)).width();
    let larger =
        |_| Remedy::Cells(fitting(cell_size, |size| step_cells(plateau(size), width(size))));
    refuse_steps(plateau(cell_size), width(cell_size), cell_size, larger).map(drop)
}

/// Refuses a frame whose field tells too coarsely where its surface is; returns how far one step
/// moves that, in cells.
pub fn refuse_too_fine(
    frame: &SampledDif,
    smoothing: &Smoothing,
    plateau: Plateau,
) -> Result<f64, TooFine> {
    let (kind, cell_size) = (frame.indicator.kind(), frame.facts.grid.cell_size());
    refuse_steps(f64::from(plateau.value().max(1)), smoothing.width(), cell_size, |step_cells| {
        if kind == IndicatorKind::Symmetry && frame.dif.mean_of_full() < ON_CORNERS {
            let grid = frame.facts.grid;
            return Remedy::Origin((grid.origin() + grid.cell_size() / 2.0).to_array());
        }
        // The plateau grows with the cell's volume.
        Remedy::Cells(roundly_above(cell_size * (step_cells / COARSEST_STEP).cbrt()))
    })
}

/// Refuses a field whose steps are too large; returns how far one moves a flat surface, in cells.
fn refuse_steps(
    plateau: f64,
    width: f64,
    cell_size: f64,
    remedy: impl FnOnce(f64) -> Remedy,
) -> Result<f64, TooFine> {
    let step_cells = step_cells(plateau, width);
    if step_cells <= COARSEST_STEP {
        return Ok(step_cells);
    }
    Err(TooFine::Steps { cell_size, plateau, step_cells, remedy: remedy(step_cells) })
}

/// Refuses cells that are too fine for symmetry, if that is the indicator, by their particles'
/// spacing in cells.
pub fn refuse_symmetry(
    kind: IndicatorKind,
    spacing: Option<f64>,
    cell_size: f64,
) -> Result<(), TooFine> {
    // A quotient of decimals is off by a rounding.
    match spacing.filter(|spacing| spacing * FINEST_OF_SYMMETRY >= 1.0 - 1e-9) {
        Some(spacing) if kind == IndicatorKind::Symmetry => {
            Err(TooFine::Symmetry { cell_size, spacing: spacing * cell_size })
        }
        _ => Ok(()),
    }
}

/// Refuses cells that are finer than distances from clouds need, by their particles' spacing in
/// cells.
pub fn refuse_finest(spacing: Option<f64>, cell_size: f64) -> Result<(), TooFine> {
    // A quotient of decimals is off by a rounding.
    match spacing.filter(|spacing| spacing * FINEST > 1.0 + 1e-9) {
        Some(spacing) => Err(TooFine::Finest { cell_size, spacing: spacing * cell_size }),
        None => Ok(()),
    }
}

/// The least size at which steps are small enough, as they are from there on; larger than `from`,
/// at which they are not.
fn fitting(from: f64, step_cells: impl Fn(f64) -> f64) -> f64 {
    let fits = |size: f64| step_cells(size) <= COARSEST_STEP;
    let mut above = 2.0 * from;
    while !fits(above) && above.is_finite() {
        above *= 2.0;
    }
    let mut below = above / 2.0;
    while above / below > 1.001 {
        let middle = (above * below).sqrt();
        *(if fits(middle) { &mut above } else { &mut below }) = middle;
    }
    roundly_above(above)
}

/// A length of three digits that is a little more.
fn roundly_above(length: f64) -> f64 {
    format!("{:.2e}", 1.01 * length).parse().expect("a number")
}
