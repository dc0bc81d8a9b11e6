//! Sparse storage: particles sorted into bins, the DIF in bricks, and padded blocks cut out of it.

mod bin;
mod bin_table;
mod bins;
mod block;
mod boxes;
mod coarse;
mod cubes;
mod elias_fano;
mod facts;
mod field;
mod images;
mod page;
mod place;
mod runs;
mod samples;
mod shape;
mod slabs;
mod slots;
mod spill;
mod store;
mod sums;
pub mod vulkan;

use std::sync::atomic;

use crate::system::memory::zeroed_in_huge_pages;

pub use bin::{BinError, BinPlan, Census, CountingRoom, InvalidParticles};
pub use bins::{AXIS_BITS, BinContents, Bins, RECORD_BITS, coarsened, equal_steps, unpack};
pub use block::{Block, runs};
pub use boxes::WithBoxes;
pub use coarse::{HALVED, HALVED_BITS, halved_from, halved_from_box};
pub use cubes::COORD_BITS;
pub use facts::FrameFacts;
pub use field::DifField;
pub use field::{Factor, RemotePages};
pub use images::WithImages;
pub use page::{PageInfo, Pages, full_bits, fullness};
pub use samples::PageSamples;
pub use shape::{BrickSide, PageShape};
pub use spill::BinnedParticles;
pub use spill::{SortedStore, SpilledBins};
pub use store::PageSource;
pub use sums::CellSums;
