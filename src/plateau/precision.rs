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

/// The finest cells for symmetry, in spacings. In finer ones more than seven of eight cells are empty deep in the fluid, and
/// where the others' particles happen to lie moves the surface.
pub const FINEST_OF_SYMMETRY: f64 = 0.5;

/// Cells in which it cannot be told finely enough where the surface is.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum TooFine {
    /// The field's steps are too large.
    #[error(
        "cells of {cell_size:.6} are too fine for a field of 16 bits: deep in the fluid it is {plateau} of 65535, a step of \
         which moves the surface by {step_cells:.3} cells, where {COARSEST_STEP} are allowed; {remedy}"
    )]
    Steps {
        /// Edge of a cell.
        cell_size: f64,
        /// Of the field.
        plateau: u16,
        /// How far one step of the field moves a flat surface, in cells.
        step_cells: f64,
        /// What to do about it.
        remedy: Remedy,
    },
    /// Too many cells are empty to tell how particles lie in them.
    #[error(
        "cells of {cell_size:.6} are too fine for symmetry, which sees particles in one of eight of them at the most: use cells \
         of {:.6} or more, or another --indicator",
        FINEST_OF_SYMMETRY * spacing
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
    /// Cells of about this edge, by a Gaussian as wide as it is.
    Cells(f64),
    /// A grid on which particles do not lie on the corners of cells, where symmetry sees next to nothing.
    Origin,
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cells(size) => write!(f, "use cells of {size:.6} or more"),
            Self::Origin => {
                write!(
                    f,
                    "its particles lie on corners of cells, where symmetry sees next to nothing: move the --origin"
                )
            }
        }
    }
}

/// How far one step of a field moves a flat surface, in cells, by its plateau and by the standard deviation of what a
/// particle is smoothed into.
#[must_use]
pub fn step_cells(plateau: u16, width: f64) -> f64 {
    width / (DENSITY * f64::from(plateau.max(1)))
}

/// Refuses a field whose steps are too large.
///
/// # Errors
/// [`TooFine::Steps`], with larger cells for a remedy.
pub fn refuse_too_fine(plateau: u16, width: f64, cell_size: f64) -> Result<(), TooFine> {
    let step_cells = step_cells(plateau, width);
    if step_cells <= COARSEST_STEP {
        return Ok(());
    }
    // The plateau grows with the cell's volume, and the width in cells shrinks with its edge.
    let remedy = Remedy::Cells(cell_size * (step_cells / COARSEST_STEP).powf(0.25));
    Err(TooFine::Steps { cell_size, plateau, step_cells, remedy })
}

/// Refuses cells that are too fine for symmetry, by their particles' spacing in cells.
///
/// # Errors
/// [`TooFine::Symmetry`].
pub fn refuse_symmetry(spacing: f64, cell_size: f64) -> Result<(), TooFine> {
    // A quotient of decimals is off by a rounding.
    if spacing * FINEST_OF_SYMMETRY <= 1.0 + 1e-9 {
        return Ok(());
    }
    Err(TooFine::Symmetry { cell_size, spacing: spacing * cell_size })
}
