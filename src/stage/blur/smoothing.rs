//! Which filters make the smoothed DIF (section 4.2).

use crate::brick::Block;
use crate::grid::CellBox;
use crate::stage::indicator::Indicator;
use crate::units::Sigma;

use super::{Kernel, Sample, blur_while};

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

    /// Smooths a block; the result is smaller by [`reach`](Self::reach) on every side.
    #[must_use]
    pub fn apply<T: Sample>(&self, dif: Block<T>, walls: Option<CellBox>) -> Block<T> {
        let filter = |block, kernel| filter_while(block, kernel, walls, |_| true).expect("nothing stops it");
        self.filters.iter().fold(dif, filter)
    }
}

/// One filter, as long as what it comes to along each axis goes on; at a wall it sees the edge cells repeated, and so will
/// the next.
pub fn filter_while<T: Sample>(
    block: Block<T>,
    kernel: &Kernel,
    walls: Option<CellBox>,
    goes_on: impl Fn(&Block<T>) -> bool,
) -> Option<Block<T>> {
    let mut out = blur_while(block, kernel, goes_on)?;
    if let Some(walls) = walls {
        out.repeat_edges(walls);
    }
    Some(out)
}
