//! See the room's `mod.rs` for the formulas.

use std::sync::Arc;

use crate::brick::vulkan::{AxisPush, DeviceBlocks, Window, along_each_axis};
use crate::units::Isovalue;
use crate::vulkan::{Batch, Kernel, Program, View, VulkanError, push_block};

use super::fine_scale;

push_block! {
    /// Of [`OCCUPANCY`].
    struct OccupancyPush {
        words: u32,
        least: u32,
    }
}

push_block! {
    /// Of [`BLEND`].
    struct BlendPush {
        words: u32,
        threshold: u32,
        scale: u32,
    }
}

/// 1 in every full cell.
pub const OCCUPANCY: Program = Program {
    name: "occupancy",
    code: include_bytes!("../../../spirv/occupancy.spv"),
    buffers: &["field"],
    push: OccupancyPush::FIELDS,
    group: [256, 1, 1],
};

/// One axis of the greatest near by.
pub const SPREAD: Program = Program {
    name: "spread",
    code: include_bytes!("../../../spirv/spread.spv"),
    buffers: &["blocks", "samples", "greatest"],
    push: AxisPush::FIELDS,
    group: [256, 1, 1],
};

/// Of two fields as much as a third says.
pub const BLEND: Program = Program {
    name: "blend",
    code: include_bytes!("../../../spirv/blend.spv"),
    buffers: &["fine", "smoothed", "field"],
    push: BlendPush::FIELDS,
    group: [256, 1, 1],
};

/// Makes 1 of every full cell of `field`, whose theta is not less than `least`.
///
/// # Errors
/// Those of the device.
pub fn occupancy(
    batch: &mut Batch,
    kernel: &Arc<Kernel>,
    blocks: &DeviceBlocks,
    least: u16,
    field: &View,
) -> Result<(), VulkanError> {
    let push = OccupancyPush { words: blocks.words, least: least.into() };
    batch.dispatch(kernel, std::slice::from_ref(field), &push, blocks.flat_groups())
}

/// The greatest sample within the window along x, then y, then z: from `from` through `to` and `through` into `to`.
///
/// # Errors
/// Those of the device.
pub fn spread(
    batch: &mut Batch,
    kernel: &Arc<Kernel>,
    blocks: &DeviceBlocks,
    window: Window,
    views: [&View; 3],
) -> Result<(), VulkanError> {
    along_each_axis(batch, kernel, blocks, window, views, &[])
}

/// Makes the greatest samples near by, in `field`, the field itself; `fine` is the blurred occupancy.
///
/// # Errors
/// Those of the device.
pub fn blend(
    batch: &mut Batch,
    kernel: &Arc<Kernel>,
    blocks: &DeviceBlocks,
    iso: Isovalue,
    [fine, smooth, field]: [&View; 3],
) -> Result<(), VulkanError> {
    let push = BlendPush { words: blocks.words, threshold: iso.threshold().into(), scale: fine_scale(iso) };
    batch.dispatch(kernel, &[fine, smooth, field].map(Clone::clone), &push, blocks.flat_groups())
}
