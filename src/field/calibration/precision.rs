//! The precision with which a 16-bit field locates its surface.
//!
//! For clouds, the field is a distance, whose step is 1 / 8192 of a spacing for cells of any size.
//! For the paper's indicators, the step depends on the cells:
//!
//! In cells of h spacings, a cell deep in the fluid holds h^3 particles on average. In small cells,
//! the plateau P is about h^3 times the value of a full cell. The field at a flat surface is P
//! Phi(x / s), where x is the depth and s the standard deviation of a smoothed particle. One step
//! of the field therefore moves the surface by s / (P phi(z)), where Phi(z) = 0.47.

use std::fmt;

use thiserror::Error;

use crate::field::blur::Smoothing;
use crate::field::indicator::{Indicator, IndicatorKind, SampledDif};
use crate::grid::units::{MeanCount, Sigma, shown};

use super::Plateau;
use super::expected::expected;

/// phi(z), the density of the standard normal distribution at the surface.
const DENSITY: f64 = 0.3978;

/// The maximum distance, in cells, by which a flat surface may move if a value of the field changes
/// by its smallest step. Larger steps are visible in the shading.
pub const COARSEST_STEP: f64 = 0.125;

/// The largest cell size, in spacings, at which the symmetry indicator fails. At this size, seven
/// of eight cells deep in the fluid are empty, and the surface depends on where in the remaining
/// cells the particles lie.
pub const FINEST_OF_SYMMETRY: f64 = 0.5;

/// The minimum cell size for distances from clouds, in spacings. At this size, the drop of a single
/// particle is twelve cells wide.
pub const FINEST: f64 = 0.1;

/// The minimum mean of the symmetry indicator over full cells. A lower mean shows that particles
/// lie on the corners of cells: the mean is almost 0 for a lattice of such particles, but 0.44 for
/// disordered particles, one per cell.
pub const ON_CORNERS: f64 = 0.2;

/// An error: the cells are too small to locate the surface precisely.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum TooFine {
    /// The field's steps are too large.
    #[error(
        "with a cell size of {}, the surface would be inaccurate by up to {step_cells:.3} cells \
         (the limit is {COARSEST_STEP}), because {remedy}",
        shown(*cell_size)
    )]
    Steps {
        /// Edge of a cell.
        cell_size: f64,
        /// The field deep in the fluid; if the fluid is too shallow to measure, the expected mean.
        plateau: f64,
        /// The distance, in cells, by which one step of the field moves a flat surface.
        step_cells: f64,
        /// A way to get a finer field.
        remedy: Remedy,
    },
    /// The cells are smaller than the limit for the surface of drops.
    #[error(
        "the cell size {} is less than {FINEST} spacings; use a cell size of {} or more",
        shown(*cell_size), shown(roundly_above(FINEST * spacing))
    )]
    Finest {
        /// Edge of a cell.
        cell_size: f64,
        /// The particles' spacing.
        spacing: f64,
    },
    /// The surface depends on where particles lie in their cells, because too many cells are empty.
    #[error(
        "the cell size {} is too small for the symmetry indicator: at most one cell in eight would \
         contain a particle; use a cell size of {} or more",
        shown(*cell_size), shown(roundly_above(FINEST_OF_SYMMETRY * spacing))
    )]
    Symmetry {
        /// Edge of a cell.
        cell_size: f64,
        /// The particles' spacing.
        spacing: f64,
    },
}

/// A way to get a finer field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Remedy {
    /// Use cells with this edge.
    Cells(f64),
    /// Move the grid's origin to this position, so that particles do not lie on the corners of
    /// cells, where the symmetry indicator is almost 0.
    Origin([f64; 3]),
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cells(size) => write!(
                f,
                "the cells contain too few particles; use a cell size of {} or more",
                shown(*size)
            ),
            Self::Origin([x, y, z]) => write!(
                f,
                "the particles lie on the corners of cells, where the symmetry indicator is almost \
                 0; move the grid's origin to {x},{y},{z}"
            ),
        }
    }
}

/// The distance, in cells, by which one step of a field moves a flat surface, computed from the
/// plateau and the standard deviation of a smoothed particle.
fn step_cells(plateau: f64, width: f64) -> f64 {
    width / (DENSITY * plateau)
}

/// Checks the cell size against a known spacing before there is a DIF. `sigma` gives the standard
/// deviation of the Gaussian for a cell size. [`calibrate`](super::calibrate) makes the checks that
/// need a measured mu0.
pub fn check_cell_size_for(
    kind: IndicatorKind,
    mean: Option<MeanCount>,
    spacing: f64,
    cell_size: f64,
    sigma: impl Fn(f64) -> Sigma,
) -> Result<(), TooFine> {
    let by = match kind {
        IndicatorKind::Cloud => return check_finest(Some(spacing / cell_size), cell_size),
        // If mu0 is not known, it is assumed to be 1, the minimum for any frame, because each
        // particle then contributes most to the field.
        IndicatorKind::Counting => Indicator::Counting(
            mean.unwrap_or_else(|| MeanCount::new(1.0).expect("a number within the bounds")),
        ),
        IndicatorKind::Symmetry => Indicator::Symmetry,
    };
    check_symmetry(kind, Some(spacing / cell_size), cell_size)?;
    let plateau = |size: f64| expected(by, spacing / size, None);
    let width = |size: f64| Smoothing::new(kind, sigma(size)).width();
    let larger =
        |_| Remedy::Cells(fitting(cell_size, |size| step_cells(plateau(size), width(size))));
    check_steps(plateau(cell_size), width(cell_size), cell_size, larger).map(drop)
}

/// Returns an error if the field of a frame does not locate the surface precisely enough.
/// Otherwise, returns the distance, in cells, by which one step of the field moves the surface.
pub fn check_cell_size(
    frame: &SampledDif,
    smoothing: &Smoothing,
    plateau: Plateau,
) -> Result<f64, TooFine> {
    let (kind, cell_size) = (frame.indicator.kind(), frame.facts.grid.cell_size());
    check_steps(f64::from(plateau.value().max(1)), smoothing.width(), cell_size, |step_cells| {
        if kind == IndicatorKind::Symmetry && frame.dif.mean_of_full() < ON_CORNERS {
            let grid = frame.facts.grid;
            return Remedy::Origin((grid.origin() + grid.cell_size() / 2.0).to_array());
        }
        // The plateau is proportional to the cell's volume, so the step in cells is inversely
        // proportional to that volume.
        Remedy::Cells(roundly_above(cell_size * libm::cbrt(step_cells / COARSEST_STEP)))
    })
}

/// Returns an error if the steps of a field are too large. Otherwise, returns the distance, in
/// cells, by which one step moves a flat surface.
fn check_steps(
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

/// Returns an error if the indicator is symmetry and the cells are too small for it. `spacing` is
/// the particles' spacing in cells.
pub fn check_symmetry(
    kind: IndicatorKind,
    spacing: Option<f64>,
    cell_size: f64,
) -> Result<(), TooFine> {
    // The 1e-9 absorbs the rounding error of a quotient of decimals.
    match spacing.filter(|spacing| spacing * FINEST_OF_SYMMETRY >= 1.0 - 1e-9) {
        Some(spacing) if kind == IndicatorKind::Symmetry => {
            Err(TooFine::Symmetry { cell_size, spacing: spacing * cell_size })
        }
        _ => Ok(()),
    }
}

/// Returns an error if the cells are smaller than the limit for distances from clouds. `spacing` is
/// the particles' spacing in cells.
pub fn check_finest(spacing: Option<f64>, cell_size: f64) -> Result<(), TooFine> {
    // The 1e-9 absorbs the rounding error of a quotient of decimals.
    match spacing.filter(|spacing| spacing * FINEST > 1.0 + 1e-9) {
        Some(spacing) => Err(TooFine::Finest { cell_size, spacing: spacing * cell_size }),
        None => Ok(()),
    }
}

/// The minimum cell size at which the steps of a field are small enough. It is larger than `from`,
/// a cell size at which the steps are too large.
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

/// Increases a length by 1 % and rounds it to three digits; the result is never less than the
/// length.
fn roundly_above(length: f64) -> f64 {
    format!("{:.2e}", 1.01 * length).parse().expect("a number")
}
