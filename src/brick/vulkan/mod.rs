//! Particles in bin order, and padded blocks, on a device. The blocks of a batch share one field of
//! 16-bit samples, two per word.

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
use crate::grid::{BIN, CellBox, Mirror};
use crate::shaders::GatherPush;
use crate::vulkan::{ALIGNMENT, Batch, ComputePipeline, View, VulkanError};

/// Number of words of a page without ghost layers on the device: all cells of a bin, x fastest, two
/// samples per word.
pub const PAGE_WORDS: u32 = (BIN * BIN * BIN) as u32 / 2;
/// Number of words of a page on the device: its dense samples, two per word, rounded up to the
/// alignment of buffer views.
pub fn page_words(shape: PageShape) -> u32 {
    (shape.bin_samples() as u32 / 2).next_multiple_of(ALIGNMENT as u32 / 4)
}

/// Maximum number of work groups in a row. Every device supports this number.
pub const GROUP_ROW: u32 = 1 << 15;
/// Number of 32-bit words along an axis that one thread of a separable operation computes.
pub const RUN: u32 = 4;

/// A padded block, laid out as in `block.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct DeviceBlock {
    /// The lowest cell; x is even.
    pub lo: [i32; 3],
    /// The index of the block's first word in the field.
    pub field: u32,
    /// The edges of the block, in cells; the edge along x is even.
    pub size: [u32; 3],
    /// The index of the block's first entry in the table of pages.
    pub table: u32,
    /// The lowest cell of the tiles to mesh.
    pub tiles_lo: [i32; 3],
    /// The index of the block's first word in a buffer that has one bit for each brick of every
    /// block: 1 if the brick is inside the fluid. It is unused if there is no such buffer.
    pub marks: u32,
    /// The edges, in cells, of the part of the block that is divided into tiles.
    pub tiles_size: [u32; 3],
    spare: u32,
}

impl DeviceBlock {
    /// A block with the samples of `cells`, whose tiles in `region` will be meshed. Rows are
    /// extended to whole words.
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

    /// The bins whose bricks, with their ghost layers, overlap the block, in the order of the
    /// block's table.
    pub fn bins(&self, ghost_layer: i32) -> impl Iterator<Item = IVec3> + use<> {
        self.cells().grown(ghost_layer, ghost_layer).cubes(BIN)
    }

    /// Number of words of the block's samples.
    pub fn words(&self) -> u32 {
        self.size.iter().product::<u32>() / 2
    }

    /// The number of runs of up to `RUN` words into which the block is divided along the axis that
    /// gives the most runs.
    fn runs(&self) -> u32 {
        let [x, y, z] = [self.size[0] / 2, self.size[1], self.size[2]];
        let along = |axis: u32, others: u32| axis.div_ceil(RUN) * others;
        along(x, y * z).max(along(y, x * z)).max(along(z, x * y))
    }
}

/// The blocks of a batch.
#[derive(Debug, Clone)]
pub struct DeviceBlocks {
    /// One [`DeviceBlock`] per block.
    pub blocks: View,
    /// The number of blocks.
    pub count: u32,
    /// Number of words of the largest block.
    pub largest: u32,
    /// Maximum number of threads that a separable operation along any axis needs for a block.
    pub runs: u32,
    /// Number of words of all blocks together.
    pub words: u32,
}

impl DeviceBlocks {
    /// Describes blocks that are stored at `view` on the device.
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

    /// The numbers of work groups along x, y and z for one thread per run: y is the block, and x
    /// covers the runs of the block with the most runs.
    pub fn run_groups(&self, pipeline: &ComputePipeline) -> [u32; 3] {
        [pipeline.groups(self.runs), self.count, 1]
    }

    /// The numbers of work groups along x, y and z for one thread per word: y is the block, and x
    /// covers the words of the largest block.
    pub fn groups(&self, pipeline: &ComputePipeline) -> [u32; 3] {
        [pipeline.groups(self.largest), self.count, 1]
    }

    /// The numbers of work groups along x, y and z for one thread per word of all blocks together.
    /// A row along x has at most [`GROUP_ROW`] work groups, which every device supports.
    pub fn flat_groups(&self, pipeline: &ComputePipeline) -> [u32; 3] {
        flat_groups(self.words, pipeline)
    }
}

/// The numbers of work groups along x, y and z for `threads` threads. A row along x has at most
/// [`GROUP_ROW`] work groups, which every device supports.
fn flat_groups(threads: u32, pipeline: &ComputePipeline) -> [u32; 3] {
    let groups = pipeline.groups(threads);
    let width = groups.clamp(1, GROUP_ROW);
    [width, groups.div_ceil(width), 1]
}

/// The pages from which blocks are cut.
#[derive(Debug, Clone)]
pub struct DevicePages {
    /// For every bin of every block, the number of the bin's page plus 1, or 0 if the bin has no
    /// page.
    pub tables: View,
    /// The pages, of [`page_words`] words each.
    pub pages: View,
    /// The arrangement of the samples in pages.
    pub shape: PageShape,
    /// The sample of a cell for each number of particles. The last entry, which represents 1, also
    /// applies to all larger numbers. This table is used only if pages contain numbers of
    /// particles.
    pub theta: View,
    /// The number of entries of `theta`; 0 if pages contain the DIF.
    pub decode: u32,
}

/// Fills `field` with the samples of all blocks.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn gather(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    pages: &DevicePages,
    field: &View,
) -> Result<(), VulkanError> {
    let &DevicePages { shape, decode, .. } = pages;
    // On the device, a bin without ghost layers is stored as one brick.
    let brick = if shape.ghost_layer == 0 { BIN } else { shape.side.cells() };
    let (ghost_layer, page_words) = (shape.ghost_layer as u32, page_words(shape));
    let push = GatherPush { decode, brick_bits: brick.ilog2(), ghost_layer, page_words };
    let DevicePages { tables, pages, theta, .. } = pages;
    let buffers = [&blocks.blocks, tables, pages, theta, field].map(Clone::clone);
    batch.dispatch(pipeline, &buffers, &push, blocks.run_groups(pipeline))
}

/// The lowest and the highest cell within walls, for shaders. Without walls, both are farther away
/// than any cell of a grid.
pub fn wall_bounds(walls: Option<CellBox>) -> [[i32; 3]; 2] {
    const BEYOND_GRID: i32 = 1 << 24;
    walls.map_or([[-BEYOND_GRID; 3], [BEYOND_GRID; 3]], |walls| {
        [walls.lo.to_array(), (walls.hi - 1).to_array()]
    })
}

/// The lower and the upper planes of a mirror, in halves of a cell, for shaders. Without a mirror,
/// they are farther away than any cell of a grid.
pub fn mirror_planes(mirror: Option<Mirror>) -> [[i32; 3]; 2] {
    const BEYOND_GRID: i32 = 1 << 25;
    mirror.map_or([[-BEYOND_GRID; 3], [BEYOND_GRID; 3]], |mirror| {
        mirror.planes().map(|at| at.to_array())
    })
}

#[cfg(test)]
mod tests {
    use crate::brick::BrickSide;

    use super::*;

    #[test]
    fn pages_are_aligned_for_buffer_views() {
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
