//! Shaders for pages in device memory: they find the full cells of each page, and make pages of
//! cells twice as wide.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use crate::brick::{Factor, PageInfo, PageShape};
use crate::grid::{BIN, Mirror, MortonKey};
use crate::shaders::{FullCellsPush, HalvePush};
use crate::vulkan::{Batch, ComputePipeline, View, VulkanError};

use super::{DeviceBlocks, PAGE_WORDS, mirror_planes, page_words};

/// The full cells of a page, laid out as in `full_cells.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct DeviceFullCells {
    layers: [u32; 3],
    count: u32,
    bricks: [u32; 2],
}

impl DeviceFullCells {
    /// The page of a bin; `None` if it has no full cells.
    pub fn info(&self, key: MortonKey) -> Option<PageInfo> {
        let bricks = u64::from(self.bricks[0]) | u64::from(self.bricks[1]) << 32;
        (bricks != 0).then(|| {
            PageInfo::of_layers(key, bricks, self.layers.map(|bits| bits as u16), self.count)
        })
    }
}

/// Finds the full cells of pages.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn full_cells(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    count: u32,
    shape: PageShape,
    [pages, found]: [&View; 2],
) -> Result<(), VulkanError> {
    let brick = shape.side.cells();
    // On the device, a bin without ghost layers is stored contiguously.
    let piece = if shape.ghost_layer == 0 { BIN } else { brick };
    let push = FullCellsPush {
        piece_bits: piece.ilog2(),
        ghost_layer: shape.ghost_layer as u32,
        brick_bits: brick.ilog2(),
        page_words: page_words(shape),
    };
    batch.dispatch(pipeline, &[pages.clone(), found.clone()], &push, [1, count, 1])
}

/// Makes pages of cells twice as wide from `field`. The counterpart on the CPU is
/// [`DifField::halved`](crate::brick::DifField::halved). Each block must contain the [finer
/// cells](crate::brick::halved_from) from which a bin is computed.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn halve(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    (mirror, factor): (Option<Mirror>, Factor),
    [field, pages]: [&View; 2],
) -> Result<(), VulkanError> {
    let [mirror_lo, mirror_hi] = mirror_planes(mirror);
    let push = HalvePush { mirror_lo, factor: factor.steps(), mirror_hi };
    let views = [&blocks.blocks, field, pages].map(Clone::clone);
    batch.dispatch(pipeline, &views, &push, [pipeline.groups(PAGE_WORDS), blocks.count, 1])
}
