//! Wide cells: the cells on which distances are computed from clouds. Their size in spacings is
//! similar for all meshes.

use super::Amount;

/// The minimum edge, in spacings, of the cells on which the calm surface is computed. Finer cells
/// are merged into wider cells first.
const LEAST_WIDE: f64 = 0.55;

/// The width of a frame's wide cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WideCells {
    /// A wide cell has 2^`level` cells along an axis.
    pub level: u32,
    /// Edge of a wide cell in spacings.
    pub edge: f64,
}

impl WideCells {
    /// The wide cells for particles `spacing` cells apart.
    pub fn of_spacing(spacing: f64) -> Self {
        let mut wide = Self { level: 0, edge: 1.0 / spacing };
        // The 1e-9 absorbs the rounding error of a quotient of decimals.
        while wide.edge < LEAST_WIDE - 1e-9 {
            wide = Self { level: wide.level + 1, edge: 2.0 * wide.edge };
        }
        wide
    }

    /// Returns the total that a particle adds to the wide cells around it.
    pub fn amount(self) -> Amount {
        Amount::of_spacing(1.0 / self.edge)
    }

    /// The sample deep in a fluid of one particle per cubed spacing, before the gain of filters.
    pub fn plateau(self) -> f64 {
        f64::from(self.amount().steps()) * self.edge * self.edge * self.edge
    }
}
