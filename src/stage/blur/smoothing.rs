//! Which filters make the smoothed DIF (section 4.2).

use crate::brick::Block;
use crate::grid::CellBox;
use crate::stage::indicator::Indicator;
use crate::units::Sigma;

use super::{Kernel, Sample, blur};

/// The smoothing of section 4.2: a Gaussian, and for counting a box after it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Smoothing {
    filters: Vec<Kernel>,
}

impl Smoothing {
    /// What the paper prescribes for an indicator.
    #[must_use]
    pub fn new(indicator: Indicator, sigma: Sigma) -> Self {
        let gaussian = Kernel::gaussian(sigma);
        let filters = match indicator {
            Indicator::Symmetry | Indicator::Cloud { .. } => vec![gaussian],
            Indicator::Counting { .. } => vec![gaussian, Kernel::box3()],
        };
        Self { filters }
    }

    /// The filters, in the order in which they are applied.
    #[must_use]
    pub fn filters(&self) -> &[Kernel] {
        &self.filters
    }

    /// How far the filters reach together, in cells.
    #[must_use]
    pub fn reach(&self) -> i32 {
        self.filters.iter().map(Kernel::reach).sum()
    }

    /// The standard deviation of what becomes of a particle of such an indicator, along an axis, in cells.
    #[must_use]
    pub fn width(&self, indicator: Indicator) -> f64 {
        (indicator.variance() + self.filters.iter().map(Kernel::variance).sum::<f64>()).sqrt()
    }

    /// Smooths a block; the result is smaller by [`reach`](Self::reach) on every side.
    #[must_use]
    pub fn apply<T: Sample>(&self, dif: Block<T>, walls: Option<CellBox>) -> Block<T> {
        self.filters.iter().fold(dif, |block, kernel| blur(block, kernel, walls))
    }
}
