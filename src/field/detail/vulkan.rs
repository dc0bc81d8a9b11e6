//! See `mod.rs` of this folder for the formula.

use std::sync::Arc;

use crate::brick::vulkan::DeviceBlocks;
use crate::grid::units::Isovalue;
use crate::shaders::{GreaterPush, LostPush};
use crate::vulkan::{Batch, ComputePipeline, View, VulkanError};

/// Writes theta_bar (section 6.2) to the view `theta_bar`.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn lost(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    iso: Isovalue,
    [dif, smooth, theta_bar]: [&View; 3],
) -> Result<(), VulkanError> {
    let push = LostPush { words: blocks.words, threshold: iso.threshold().into() };
    batch.dispatch(
        pipeline,
        &[dif, smooth, theta_bar].map(Clone::clone),
        &push,
        blocks.flat_groups(pipeline),
    )
}

/// Sets `field` to the maximum of `field` and `other`.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn raise(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    other: &View,
    field: &View,
) -> Result<(), VulkanError> {
    let push = GreaterPush { words: blocks.words };
    batch.dispatch(pipeline, &[other, field].map(Clone::clone), &push, blocks.flat_groups(pipeline))
}
