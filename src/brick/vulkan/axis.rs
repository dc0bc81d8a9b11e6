//! Separable operations on padded blocks, one axis after the other. The counterpart on the CPU is
//! [`Block::along_each_axis`](crate::brick::Block::along_each_axis).

use std::sync::Arc;

use crate::grid::Mirror;
use crate::shaders::AxisPush;
use crate::vulkan::{Batch, ComputePipeline, View, VulkanError};

use super::{DeviceBlocks, mirror_planes};

/// The cells that an operation reads.
#[derive(Debug, Clone, Copy)]
pub struct TapWindow {
    /// The reach of the operation's taps along the axis, in cells.
    pub reach: i32,
    /// The mirror at walls, if there are any.
    pub mirror: Option<Mirror>,
    /// Samples within this distance, in cells, of a block's faces are unknown. After the operation,
    /// the distance is larger by the reach.
    pub margin: i32,
}

/// Runs a shader that includes `axis.wgsl` along x, then y, then z. Samples go from `from` to `to`,
/// then to `through`, and finally back to `to`. The shader's buffers are the blocks, the input, the
/// output, and then `further`. Sums along axis number `axis` are shifted right by `shift(axis)`
/// bits.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn along_each_axis(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    blocks: &DeviceBlocks,
    TapWindow { reach, mirror, margin }: TapWindow,
    [from, through, to]: [&View; 3],
    further: &[View],
    shift: impl Fn(usize) -> u32,
) -> Result<(), VulkanError> {
    let [mirror_lo, mirror_hi] = mirror_planes(mirror);
    let reach = reach as u32;
    let mut push =
        AxisPush { mirror_lo, axis: 0, mirror_hi, reach, margin: [margin as u32; 3], shift: 0 };
    for (axis, [from, to]) in (0_usize..).zip([[from, to], [to, through], [through, to]]) {
        push.axis = axis as u32;
        push.shift = shift(axis);
        push.margin[axis] += reach;
        let buffers: Vec<View> =
            [&blocks.blocks, from, to].into_iter().chain(further).cloned().collect();
        batch.dispatch(pipeline, &buffers, &push, blocks.run_groups(pipeline))?;
    }
    Ok(())
}
