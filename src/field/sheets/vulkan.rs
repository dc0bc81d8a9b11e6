//! See `mod.rs` of this folder for the formulas.

use std::sync::Arc;

use crate::brick::vulkan::{DeviceBlocks, mirror_planes};
use crate::grid::Mirror;
use crate::shaders::{BlendPush, LoosePush, SheetsPush};
use crate::vulkan::{Batch, ComputePipeline, View, VulkanError};

use super::SheetConstants;

/// Reduces clouds in the bulk, in place, and replaces `smooth` with the weights of the clouds: see
/// step 1 of [`sheets`](super). `scale` converts `smooth` to fractions of the plateau.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn loose(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    scale: u32,
    [clouds, smooth]: [&View; 2],
) -> Result<(), VulkanError> {
    let push = LoosePush { words: blocks.words, scale };
    let views = [clouds, smooth].map(Clone::clone);
    batch.dispatch(pipeline, &views, &push, blocks.flat_groups(pipeline))
}

/// Computes the shares and the certainty of sheets from the smoothed density.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn sheets(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    numbers: &SheetConstants,
    mirror: Option<Mirror>,
    [density, shares, certainty]: [&View; 3],
) -> Result<(), VulkanError> {
    let [mirror_lo, mirror_hi] = mirror_planes(mirror);
    let SheetConstants { torn, .. } = numbers;
    let push = SheetsPush {
        mirror_lo,
        step: numbers.step,
        mirror_hi,
        slope: numbers.slope,
        bend: numbers.bend,
        plateau: numbers.plateau,
        most_more: numbers.most_more,
        sheet_size: numbers.sizes[0],
        filament_size: numbers.sizes[1],
        drop_size: numbers.sizes[2],
        least_size: numbers.least_size,
        rim: numbers.rim,
        gradual: numbers.gradual,
        by_gradual: numbers.by_gradual,
        least: numbers.least,
        sheet_stretch: numbers.stretches[0],
        filament_stretch: numbers.stretches[1],
        share: numbers.share,
        by_directions: numbers.by_directions,
        by_size: numbers.by_size,
        by_distance: numbers.by_distance,
        torn_begin: torn.begin.into(),
        torn_range: torn.range.into(),
    };
    let views = [&blocks.blocks, density, shares, certainty].map(Clone::clone);
    batch.dispatch(pipeline, &views, &push, blocks.groups(pipeline))
}

/// Blends the shares of drops in place with the shares of sheets, weighted by the certainty of the
/// sheets.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn blend(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    [sheets, certainty, drops]: [&View; 3],
) -> Result<(), VulkanError> {
    let push = BlendPush { words: blocks.words };
    let views = [sheets, certainty, drops].map(Clone::clone);
    batch.dispatch(pipeline, &views, &push, blocks.flat_groups(pipeline))
}
