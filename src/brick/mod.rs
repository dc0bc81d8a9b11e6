//! Sparse storage: particles sorted into bins, the DIF in bricks, and padded blocks cut out of it.

mod bin;
mod block;
mod field;
mod page;
mod store;
mod sums;

pub use bin::{BinError, BinPlan, Bins, Census, InvalidParticles};
pub use block::Block;
pub use field::DifField;
pub use page::{BrickSide, PageInfo};
pub use store::{PageSource, Samples};
pub use sums::CellSums;
