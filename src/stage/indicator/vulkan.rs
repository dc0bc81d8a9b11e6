//! See the room's `mod.rs` for the formulas.

use std::sync::Arc;

use crate::vulkan::{Batch, Kernel, Program, View, VulkanError, push_block};

use super::Indicator;

/// Edge of the part of a bin that a work group sums up: its sums fit the shared memory of every device.
pub const OCTANT: u32 = 8;

push_block! {
    /// Of [`INDICATE`].
    struct Push {
        counting: u32,
    }
}

/// Cell sums and the indicator, octant by octant of a bin.
pub const INDICATE: Program = Program {
    name: "indicate",
    code: include_bytes!("../../../spirv/indicate.spv"),
    buffers: &["bins", "records", "pages"],
    push: Push::FIELDS,
    group: [256, 1, 1],
};

/// Writes the pages of `count` bins, dense: theta by symmetry; the numbers of particles for counting.
///
/// # Errors
/// Those of the device.
pub fn indicate(
    batch: &mut Batch,
    kernel: &Arc<Kernel>,
    count: u32,
    indicator: Indicator,
    [bins, records, pages]: [&View; 3],
) -> Result<(), VulkanError> {
    let push = Push { counting: matches!(indicator, Indicator::Counting { .. }).into() };
    batch.dispatch(kernel, &[bins, records, pages].map(Clone::clone), &push, [8, count, 1])
}
