//! See the room's `mod.rs` for the formula.

use std::sync::Arc;

use crate::brick::vulkan::{DeviceBlocks, wall_bounds};
use crate::grid::CellBox;
use crate::vulkan::{Batch, Kernel as Pipeline, Program, View, VulkanError, push_block};

use super::Kernel;

push_block! {
    /// Of [`BLUR`].
    struct Push {
        walls_lo: [i32; 3],
        axis: u32,
        walls_hi: [i32; 3],
        reach: u32,
        margin: [u32; 3],
    }
}

/// One axis of a filter.
pub const BLUR: Program = Program {
    name: "blur",
    code: include_bytes!("../../../spirv/blur.spv"),
    buffers: &["blocks", "half_kernel", "samples", "blurred"],
    push: Push::FIELDS,
    group: [256, 1, 1],
};

/// Blurs all blocks along x, then y, then z: from `from` through `by` and `from` into `by`.
///
/// Samples within `margin` of a block's faces are unknown, and within `margin` plus the filter's reach when it
/// is done.
///
/// # Errors
/// Those of the device.
#[allow(clippy::too_many_arguments, reason = "two buffers, and what the twin takes")]
pub fn blur(
    batch: &mut Batch,
    pipeline: &Arc<Pipeline>,
    blocks: &DeviceBlocks,
    (kernel, weights): (&Kernel, &View),
    walls: Option<CellBox>,
    margin: i32,
    [from, through, to]: [&View; 3],
) -> Result<(), VulkanError> {
    let [walls_lo, walls_hi] = wall_bounds(walls);
    let reach = kernel.reach() as u32;
    let mut push = Push { walls_lo, axis: 0, walls_hi, reach, margin: [margin as u32; 3] };
    for (axis, [from, to]) in (0..).zip([[from, to], [to, through], [through, to]]) {
        push.axis = axis;
        push.margin[axis as usize] += reach;
        let buffers = [&blocks.blocks, weights, from, to].map(Clone::clone);
        batch.dispatch(pipeline, &buffers, &push, blocks.groups())?;
    }
    Ok(())
}
