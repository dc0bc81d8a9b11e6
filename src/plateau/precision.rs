//! How finely a field of 16 bits tells where its surface is.
//!
//! In cells of h spacings a cell of deep fluid holds h^3 particles, and the plateau P is as small a part of what a cell full
//! of them would have. A flat surface is drawn through P Phi(x / s), x being the depth and s the standard deviation of
//! what a particle is smoothed into. One step of the field therefore moves it by s / (P phi(z)), where Phi(z) = 0.47.

use std::fmt;

use thiserror::Error;

/// phi(z), the density of the standard normal distribution where the surface is drawn.
const DENSITY: f64 = 0.3978;

/// The most that a step of the field may move a flat surface, in cells. From there on its steps can be seen in the light.
pub const COARSEST_STEP: f64 = 0.125;

/// The cells that are just too fine for symmetry, in spacings. Seven of eight are empty deep in the fluid, and where the others'
/// particles happen to lie moves the surface.
pub const FINEST_OF_SYMMETRY: f64 = 0.5;

/// The least mean indicator of full cells in which particles lie as they may. By symmetry it is 0.44 in disorder, where a cell
/// holds one particle, and next to nothing of a lattice whose particles lie on the corners of cells.
pub const ON_CORNERS: f64 = 0.2;

/// Cells in which it cannot be told finely enough where the surface is.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum TooFine {
    /// The field's steps are too large.
    #[error(
        "cells of {} are too fine for a field of 16 bits: deep in the fluid it is {plateau:.1} of 65535, a step of which moves the \
         surface by {step_cells:.3} cells, where {COARSEST_STEP} are allowed; {remedy}",
        digits(*cell_size)
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
    /// Too many cells are empty to tell how particles lie in them.
    #[error(
        "cells of {} are too fine for symmetry, which sees particles in one of eight of them at the most: use cells of {} or \
         more, or another --indicator",
        digits(*cell_size), roundly_above(FINEST_OF_SYMMETRY * spacing)
    )]
    Symmetry {
        /// Edge of a cell.
        cell_size: f64,
        /// Of the particles.
        spacing: f64,
    },
}

/// What makes a field finer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Remedy {
    /// Cells of this edge.
    Cells(f64),
    /// A grid on which particles do not lie on the corners of cells, where symmetry sees next to nothing.
    Origin,
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cells(size) => write!(f, "use cells of {size} or more"),
            Self::Origin => write!(
                f,
                "its particles lie on corners of cells, where symmetry sees next to nothing: move the --origin"
            ),
        }
    }
}

/// How far one step of a field moves a flat surface, in cells, by its plateau and by the standard deviation of what a
/// particle is smoothed into.
#[must_use]
pub fn step_cells(plateau: f64, width: f64) -> f64 {
    width / (DENSITY * plateau)
}

/// Refuses a field whose steps are too large.
///
/// # Errors
/// [`TooFine::Steps`].
pub fn refuse_too_fine(
    plateau: f64,
    width: f64,
    cell_size: f64,
    remedy: impl FnOnce(f64) -> Remedy,
) -> Result<(), TooFine> {
    let step_cells = step_cells(plateau, width);
    if step_cells <= COARSEST_STEP {
        return Ok(());
    }
    Err(TooFine::Steps { cell_size, plateau, step_cells, remedy: remedy(step_cells) })
}

/// Refuses cells that are too fine for symmetry, by their particles' spacing in cells.
///
/// # Errors
/// [`TooFine::Symmetry`].
pub fn refuse_symmetry(spacing: f64, cell_size: f64) -> Result<(), TooFine> {
    // A quotient of decimals is off by a rounding.
    if spacing * FINEST_OF_SYMMETRY < 1.0 - 1e-9 {
        return Ok(());
    }
    Err(TooFine::Symmetry { cell_size, spacing: spacing * cell_size })
}

/// The least size at which steps are small enough, as they are from there on; larger than `from`, at which they are not.
pub fn fitting(from: f64, step_cells: impl Fn(f64) -> f64) -> f64 {
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
pub fn roundly_above(length: f64) -> f64 {
    rounded(format!("{:.2e}", 1.01 * length))
}

/// A length with as many digits as tell something.
fn digits(length: f64) -> f64 {
    rounded(format!("{length:.4e}"))
}

fn rounded(text: String) -> f64 {
    text.parse().expect("a number")
}
