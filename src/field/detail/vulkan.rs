//! See `mod.rs` of this folder for the formula.

use std::sync::Arc;

use crate::brick::vulkan::DeviceBlocks;
use crate::grid::units::Isovalue;
use crate::vulkan::{Batch, ComputePipeline, Shader, View, VulkanError, push_block};

push_block! {
    /// Push block of [`LOST`].
    struct LostPush {
        words: u32,
        threshold: u32,
    }
}

push_block! {
    /// Push block of [`GREATER`].
    struct GreaterPush {
        words: u32,
    }
}

/// theta_bar.
pub const LOST: Shader = Shader {
    name: "lost",
    code: include_bytes!("../../../spirv/lost.spv"),
    buffers: &["dif", "smoothed", "kept"],
    push: LostPush::FIELDS,
    group: [256, 1, 1],
};

/// The greater of two fields.
pub const GREATER: Shader = Shader {
    name: "greater",
    code: include_bytes!("../../../spirv/greater.spv"),
    buffers: &["other", "field"],
    push: GreaterPush::FIELDS,
    group: [256, 1, 1],
};

/// Writes into `kept` what smoothing lost of the DIF.
///
/// # Errors
/// Those of the device.
pub fn lost(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    iso: Isovalue,
    [dif, smooth, kept]: [&View; 3],
) -> Result<(), VulkanError> {
    let push = LostPush { words: blocks.words, threshold: iso.threshold().into() };
    batch.dispatch(pipeline, &[dif, smooth, kept].map(Clone::clone), &push, blocks.flat_groups())
}

/// Raises `field` to `other`.
///
/// # Errors
/// Those of the device.
pub fn raise(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    other: &View,
    field: &View,
) -> Result<(), VulkanError> {
    let push = GreaterPush { words: blocks.words };
    batch.dispatch(pipeline, &[other, field].map(Clone::clone), &push, blocks.flat_groups())
}
