//! See the room's `mod.rs` for the formulas.

use std::sync::Arc;

use crate::brick::vulkan::{DeviceBlocks, DevicePages, wall_bounds};
use crate::grid::CellBox;
use crate::vulkan::{Batch, Kernel, Program, View, VulkanError, push_block};

use super::Indicator;

/// Edge of the part of a bin that a work group sums up: its sums fit the shared memory of every device.
pub const OCTANT: u32 = 8;

push_block! {
    /// Of [`INDICATE`].
    struct Push {
        channels: u32,
        counting: u32,
    }
}

push_block! {
    /// Of [`CLOUDS`].
    struct CloudsPush {
        walls_lo: [i32; 3],
        amount: u32,
        walls_hi: [i32; 3],
    }
}

/// Cell sums and the indicator, octant by octant of a bin.
pub const INDICATE: Program = Program {
    name: "indicate",
    code: include_bytes!("../../../spirv/indicate.spv"),
    buffers: &["bins", "records", "pages"],
    push: Push::FIELDS,
    group: [256, 1, 1],
};

/// Cuts blocks out of pages of particles' numbers and centroids: the twin of [`clouds`](super::clouds).
pub const CLOUDS: Program = Program {
    name: "clouds",
    code: include_bytes!("../../../spirv/clouds.spv"),
    buffers: &["blocks", "tables", "pages", "field"],
    push: CloudsPush::FIELDS,
    group: [256, 1, 1],
};

/// Writes the pages of `count` bins, dense: theta by symmetry; the numbers of particles for counting, and their centroids'
/// places too for clouds.
///
/// # Errors
/// Those of the device.
pub fn indicate(
    batch: &mut Batch,
    kernel: &Arc<Kernel>,
    count: u32,
    indicator: Indicator,
    [bins, records, pages]: [&View; 3],
) -> Result<(), VulkanError> {
    let push = Push { channels: indicator.channels() as u32, counting: indicator.counts().into() };
    batch.dispatch(kernel, &[bins, records, pages].map(Clone::clone), &push, [8, count, 1])
}

/// Fills `field` with the DIF of all blocks, where a particle's cloud makes `amount`. At the blocks' faces clouds of cells
/// beyond them are missing.
///
/// # Errors
/// Those of the device.
pub fn clouds(
    batch: &mut Batch,
    kernel: &Arc<Kernel>,
    blocks: &DeviceBlocks,
    pages: &DevicePages,
    amount: u16,
    walls: Option<CellBox>,
    field: &View,
) -> Result<(), VulkanError> {
    let [walls_lo, walls_hi] = wall_bounds(walls);
    let push = CloudsPush { walls_lo, amount: amount.into(), walls_hi };
    let buffers = [&blocks.blocks, &pages.tables, &pages.pages, field].map(Clone::clone);
    batch.dispatch(kernel, &buffers, &push, blocks.groups())
}
