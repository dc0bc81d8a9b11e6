//! Particles in order of their bins, and padded blocks, on a device. A batch of blocks shares one
//! field of 16-bit samples, two to a word.

mod axis;
mod bin;
mod grid;
mod pages;

pub use axis::{TapWindow, along_each_axis};
pub use bin::{
    BinPipelines, BinRun, Coordinate, DeviceBinError, DeviceBins, DevicePositions, ELSEWHERE,
    NO_BIN, PROBES, SETTLED, bin,
};
pub use grid::{DeviceGrid, reciprocal};
pub use pages::{DeviceFullCells, full_cells, halve};

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::IVec3;

use super::PageShape;
use crate::grid::{BIN, CellBox};
use crate::shaders::GatherPush;
use crate::vulkan::{ALIGNMENT, Batch, ComputePipeline, View, VulkanError};

/// Words of a page without ghost layers on the device: all cells of a bin, x fastest, two samples
/// to a word.
pub const PAGE_WORDS: u32 = (BIN * BIN * BIN) as u32 / 2;
/// Words of a page on the device: its samples, dense, two to a word, up to where a part of a buffer
/// may begin.
pub fn page_words(shape: PageShape) -> u32 {
    (shape.bin_samples() as u32 / 2).next_multiple_of(ALIGNMENT as u32 / 4)
}

/// Work groups of a row that every device allows.
pub const GROUP_ROW: u32 = 1 << 15;
/// Words along an axis that a thread of a separable operation makes.
pub const RUN: u32 = 4;

/// A padded block, as `block.wgsl` has it.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct DeviceBlock {
    /// The lowest cell; x is even.
    pub lo: [i32; 3],
    /// The block's first word in the field.
    pub field: u32,
    /// The edges of the block in cells; x is even.
    pub size: [u32; 3],
    /// The block's first entry in the table of pages.
    pub table: u32,
    /// The lowest cell of the tiles to be meshed.
    pub tiles_lo: [i32; 3],
    /// The block's first word among the bits of bricks of all blocks, where there are any.
    pub marks: u32,
    /// The edges of the part that is cut into tiles, in cells.
    pub tiles_size: [u32; 3],
    spare: u32,
}

impl DeviceBlock {
    /// For the samples of `cells`, of which the tiles of `region` are to be meshed. Rows become
    /// whole words.
    pub fn new(cells: CellBox, region: CellBox) -> Self {
        let CellBox { mut lo, mut hi } = cells;
        lo.x &= !1;
        hi.x = (hi.x + 1) & !1;
        Self {
            lo: lo.to_array(),
            field: 0,
            size: (hi - lo).as_uvec3().to_array(),
            table: 0,
            tiles_lo: region.lo.to_array(),
            marks: 0,
            tiles_size: region.size().as_uvec3().to_array(),
            spare: 0,
        }
    }

    /// Returns the cells of the block.
    pub fn cells(&self) -> CellBox {
        let lo = IVec3::from(self.lo);
        CellBox { lo, hi: lo + IVec3::from(self.size.map(|n| n as i32)) }
    }

    /// The bins whose bricks with their ghost layers it touches, in the order of its table.
    pub fn bins(&self, ghost_layer: i32) -> impl Iterator<Item = IVec3> + use<> {
        self.cells().grown(ghost_layer, ghost_layer).cubes(BIN)
    }

    /// Words of its samples.
    pub fn words(&self) -> u32 {
        self.size.iter().product::<u32>() / 2
    }

    /// Runs of words along an axis that it is cut into, along whichever these are most.
    fn runs(&self) -> u32 {
        let [x, y, z] = [self.size[0] / 2, self.size[1], self.size[2]];
        let along = |axis: u32, others: u32| axis.div_ceil(RUN) * others;
        along(x, y * z).max(along(y, x * z)).max(along(z, x * y))
    }
}

/// The blocks of a batch.
#[derive(Debug, Clone)]
pub struct DeviceBlocks {
    /// A [`DeviceBlock`] each.
    pub blocks: View,
    /// The number of blocks.
    pub count: u32,
    /// Words of the largest.
    pub largest: u32,
    /// Threads that make all of a block along any axis, at the most.
    pub runs: u32,
    /// Words of all together.
    pub words: u32,
}

impl DeviceBlocks {
    /// Describes blocks that lie at `view` on the device.
    pub fn new(view: View, blocks: &[DeviceBlock]) -> Self {
        let most = |of: fn(&DeviceBlock) -> u32| blocks.iter().map(of).max().unwrap_or(0);
        Self {
            blocks: view,
            count: blocks.len() as u32,
            largest: most(DeviceBlock::words),
            runs: most(DeviceBlock::runs),
            words: blocks.iter().map(DeviceBlock::words).sum(),
        }
    }

    /// Work groups for a thread a run of every block.
    pub fn run_groups(&self, pipeline: &ComputePipeline) -> [u32; 3] {
        [pipeline.groups(self.runs), self.count, 1]
    }

    /// Work groups for a thread a word of every block.
    pub fn groups(&self, pipeline: &ComputePipeline) -> [u32; 3] {
        [pipeline.groups(self.largest), self.count, 1]
    }

    /// Work groups for a thread a word of the field, in rows that every device allows.
    pub fn flat_groups(&self, pipeline: &ComputePipeline) -> [u32; 3] {
        flat_groups(self.words, pipeline)
    }
}

/// Work groups for `threads`, in rows that every device allows.
fn flat_groups(threads: u32, pipeline: &ComputePipeline) -> [u32; 3] {
    let groups = pipeline.groups(threads);
    let width = groups.clamp(1, GROUP_ROW);
    [width, groups.div_ceil(width), 1]
}

/// Where blocks are cut out of.
#[derive(Debug, Clone)]
pub struct DevicePages {
    /// For every bin of every block one more than its page's number, or 0.
    pub tables: View,
    /// [`page_words`] each.
    pub pages: View,
    /// How their samples lie.
    pub shape: PageShape,
    /// theta by number of particles, and 1 for all beyond, where pages hold numbers.
    pub theta: View,
    /// How many entries that has; 0 where pages hold theta.
    pub decode: u32,
}

/// Fills `field` with the samples of all blocks.
///
/// # Errors
/// Those of the device.
pub fn gather(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    pages: &DevicePages,
    field: &View,
) -> Result<(), VulkanError> {
    let &DevicePages { shape, decode, .. } = pages;
    // Without ghost layers a bin is one brick.
    let brick = if shape.ghost_layer == 0 { BIN } else { shape.side.cells() };
    let (ghost_layer, page_words) = (shape.ghost_layer as u32, page_words(shape));
    let push = GatherPush { decode, brick_bits: brick.ilog2(), ghost_layer, page_words };
    let DevicePages { tables, pages, theta, .. } = pages;
    let buffers = [&blocks.blocks, tables, pages, theta, field].map(Clone::clone);
    batch.dispatch(pipeline, &buffers, &push, blocks.run_groups(pipeline))
}

/// The cells within walls as shaders take them: the lowest and the highest; without walls, farther
/// than any cell.
pub fn wall_bounds(walls: Option<CellBox>) -> [[i32; 3]; 2] {
    const NOWHERE: i32 = 1 << 24;
    walls.map_or([[-NOWHERE; 3], [NOWHERE; 3]], |walls| {
        [walls.lo.to_array(), (walls.hi - 1).to_array()]
    })
}

#[cfg(test)]
mod tests {
    use crate::brick::BrickSide;

    use super::*;

    #[test]
    fn every_page_begins_where_a_part_of_a_buffer_may() {
        for side in [BrickSide::Four, BrickSide::Eight, BrickSide::Sixteen] {
            for ghost_layer in [0, 1] {
                let shape = PageShape { side, ghost_layer };
                let bytes = 4 * u64::from(page_words(shape));
                assert!(bytes.is_multiple_of(ALIGNMENT), "{shape:?}: {bytes}");
                assert!(bytes >= 2 * shape.bin_samples() as u64, "{shape:?}: {bytes}");
            }
        }
        assert_eq!(page_words(BrickSide::Eight.into()), PAGE_WORDS);
    }
}
