//! The DIF of a frame, with all that a surface through it has to know of the particles.

use crate::brick::{Census, DifField};
use crate::grid::{CellBox, Domain, Grid};

use super::Indicator;

/// Facts of a frame, whatever its field is made by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameFacts {
    /// Where the cells are.
    pub grid: Grid,
    /// Walls, if the fluid is in a tank.
    pub domain: Option<Domain>,
    /// What became of the particles.
    pub census: Census,
    /// The particles' spacing in the unit of the grid, where it is known.
    pub spacing: Option<f64>,
}

/// A frame whose DIF is known: what a packed frame holds.
#[derive(Debug)]
pub struct SampledDif {
    /// Facts of the frame.
    pub facts: FrameFacts,
    /// The indicator that made it, with its mu0 where it counts.
    pub indicator: Indicator,
    /// The samples.
    pub dif: DifField,
}

impl FrameFacts {
    /// The cells within the walls, if there are any.
    #[must_use]
    pub fn walls(&self) -> Option<CellBox> {
        self.domain.as_ref().map(Domain::cells)
    }

    /// The particles' spacing in cells, where it is known.
    #[must_use]
    pub fn spacing_cells(&self) -> Option<f64> {
        self.spacing.map(|spacing| spacing / self.grid.cell_size())
    }
}

impl SampledDif {
    /// Makes the DIF of what was stored by an indicator.
    #[must_use]
    pub fn new(facts: FrameFacts, indicator: Indicator, stored: DifField) -> Self {
        Self { facts, indicator, dif: indicator.decode(stored) }
    }
}
