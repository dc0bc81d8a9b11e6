//! See `mod.rs` of this folder for the formula.

use std::sync::Arc;

use crate::brick::vulkan::{DeviceBlocks, TapWindow, along_each_axis};
use crate::grid::Mirror;
use crate::vulkan::{Batch, ComputePipeline, View, VulkanError};

use super::Weights;

/// Blurs all blocks along x, then y, then z. `views` are the input, a spare view and the output.
/// The samples go from the input to the output, then to the spare view, and finally back to the
/// output.
///
/// In the input, the samples within `margin` cells of a block's faces are unknown; in the result,
/// they are unknown within `margin` plus the filter's reach.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn blur(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    (weights, uploaded): (&Weights, &View),
    mirror: Option<Mirror>,
    margin: i32,
    views: [&View; 3],
) -> Result<(), VulkanError> {
    let window = TapWindow { reach: weights.reach(), mirror, margin };
    let further = std::slice::from_ref(uploaded);
    along_each_axis(batch, pipeline, blocks, window, views, further, |axis| weights.shift(axis))
}
