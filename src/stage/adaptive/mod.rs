//! A blur that knows details: the standard deviation varies with the field (the paper's future work, section 6.3).
//!
//! In the bulk and on its surface the field is theta_smooth of section 4.2. On drops, ligaments and thin sheets, which
//! that would take below the isovalue c, it is theta_fine = max(min(3 c B, 1), theta_smooth), where B is the occupancy, 1
//! in full cells and 0 in others, blurred by a Gaussian of min(sigma / 2, 1 / 2). A particle alone keeps 1.4 c, so none
//! is lost; its indicator is left out, which by symmetry tells of a lone particle only where the grid happens to lie.
//!
//! Which of both holds is told by theta_near, the greatest theta_smooth within 1 + ceil(sigma) cells along each axis:
//!
//! w = min(max((theta_near - c) / (c / 2), 0), 1), and the field is (1 - w) theta_fine + w theta_smooth.
//!
//! By a flat surface theta_near is about 2 c, so it is as smooth as without. In integers, with T the isovalue's
//! threshold, W = T + 1 and B of 0 to 65535: theta_fine = max(min(B S >> 14, 65535), theta_smooth), S = (3 T + 2) / 4,
//! w = min(max(2 (theta_near - T), 0), W), and the field is ((W - w) theta_fine + w theta_smooth + W / 2) / W. Quotients
//! are rounded down.

mod cpu;
pub mod vulkan;

pub use cpu::{blend, occupancy, spread};

use crate::stage::blur::{FieldCount, Filter, Kernel};
use crate::units::{Isovalue, Sigma};

/// The widest Gaussian on details, in cells.
const WIDEST_FINE: f64 = 0.5;

/// The filters beside those of the smoothing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Adaptive {
    /// For the occupancy.
    pub fine: Kernel,
    /// From a cell to those that tell whether there is bulk, along each axis.
    pub near: i32,
}

impl Adaptive {
    /// Beside a Gaussian of `sigma`.
    #[must_use]
    pub fn new(sigma: Sigma) -> Self {
        let fine = sigma.half().cells().min(WIDEST_FINE);
        let fine = Sigma::new(fine).expect("less than a sigma, and more than 0");
        Self { fine: Kernel::gaussian(fine), near: 1 + sigma.cells().ceil() as i32 }
    }
}

impl Filter for Adaptive {
    /// The occupancy's Gaussian reaches less far than the cells that tell of bulk.
    fn halo(&self) -> i32 {
        self.near
    }

    fn reach(&self) -> i32 {
        self.fine.reach()
    }

    fn kernels(&self) -> &[Kernel] {
        std::slice::from_ref(&self.fine)
    }

    /// The smoothed DIF, the occupancy that is blurred, and the greatest near by, through one more.
    fn fields(&self) -> FieldCount {
        FieldCount { host: 4, device: 4 }
    }
}

/// Bits that theta_fine is shifted by.
pub const FINE_BITS: u32 = 14;

/// S: a quarter of 3 c, so that its product with a sample has 32 bits.
fn fine_scale(iso: Isovalue) -> u32 {
    (3 * u32::from(iso.threshold()) + 2) / 4
}
