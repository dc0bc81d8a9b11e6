//! See the room's `mod.rs` for the formulas.

use std::sync::Arc;

use crate::brick::vulkan::{AxisPush, DeviceBlocks, Window, along_each_axis, wall_bounds};
use crate::grid::CellBox;
use crate::vulkan::{Batch, Kernel, Program, View, VulkanError, push_block};

use super::{AWAY, Bulk, DEPTHS, Drops, Gate};

push_block! {
    /// Of [`DEPTHS_OF`].
    struct DepthsPush {
        words: u32,
        scale: u32,
        narrow_width: i32,
        middle_width: i32,
        wide_width: i32,
        narrow_most: i32,
        middle_most: i32,
        wide_most: i32,
        fine_share: i32,
        calm_share: i32,
    }
}

push_block! {
    /// Of [`MIX`].
    struct MixPush {
        apart_begin: u32,
        apart_range: u32,
        apart_slope: u32,
        deep_begin: u32,
        deep_range: u32,
        deep_slope: u32,
    }
}

push_block! {
    /// Of [`OUTLYING`].
    struct OutlyingPush {
        words: u32,
        least: u32,
    }
}

push_block! {
    /// Of [`REFINE`].
    struct RefinePush {
        walls_lo: [i32; 3],
        level: u32,
        walls_hi: [i32; 3],
        margin: u32,
    }
}

push_block! {
    /// Of [`QUOTIENT`].
    struct QuotientPush {
        words: u32,
        bits: u32,
    }
}

push_block! {
    /// Of [`JOIN`].
    struct JoinPush {
        words: u32,
        begin: u32,
        range: u32,
        slope: u32,
        radius: i32,
        width: i32,
    }
}

/// The calm surface and the fine one.
pub const DEPTHS_OF: Program = Program {
    name: "depths_of",
    code: include_bytes!("../../../spirv/depths_of.spv"),
    buffers: &["narrow", "middle", "wide", "depths"],
    push: DepthsPush::FIELDS,
    group: [256, 1, 1],
};

/// The one that is drawn of both.
pub const MIX: Program = Program {
    name: "mix_both",
    code: include_bytes!("../../../spirv/mix_both.spv"),
    buffers: &["blocks", "calm", "fine", "apart", "near", "marks"],
    push: MixPush::FIELDS,
    group: [256, 1, 1],
};

/// By how much particles lie outside of it.
pub const OUTLYING: Program = Program {
    name: "outlying",
    code: include_bytes!("../../../spirv/outlying.spv"),
    buffers: &["calm", "field"],
    push: OutlyingPush::FIELDS,
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

/// Wide cells to cells.
pub const REFINE: Program = Program {
    name: "refine",
    code: include_bytes!("../../../spirv/refine.spv"),
    buffers: &["blocks", "wide_blocks", "wide", "field"],
    push: RefinePush::FIELDS,
    group: [256, 1, 1],
};

/// Shares of clouds in what is around them.
pub const QUOTIENT: Program = Program {
    name: "quotient",
    code: include_bytes!("../../../spirv/quotient.spv"),
    buffers: &["around", "field"],
    push: QuotientPush::FIELDS,
    group: [256, 1, 1],
};

/// The calm surface and drops.
pub const JOIN: Program = Program {
    name: "join",
    code: include_bytes!("../../../spirv/join.spv"),
    buffers: &["near", "shares", "away", "field"],
    push: JoinPush::FIELDS,
    group: [256, 1, 1],
};

/// Kernels that make distances.
#[derive(Debug)]
pub struct Kernels {
    /// Two surfaces of the bulk: [`DEPTHS_OF`].
    pub depths: Arc<Kernel>,
    /// The one that is drawn: [`MIX`].
    pub mix: Arc<Kernel>,
    /// What lies outside of it: [`OUTLYING`].
    pub outlying: Arc<Kernel>,
    /// The greatest near by: [`SPREAD`].
    pub spread: Arc<Kernel>,
    /// Wide cells to cells: [`REFINE`].
    pub refine: Arc<Kernel>,
    /// Shares: [`QUOTIENT`].
    pub quotient: Arc<Kernel>,
    /// Both surfaces: [`JOIN`].
    pub join: Arc<Kernel>,
}

/// The committed tables as kernels take them: of depths, and of how far away shares are.
#[must_use]
pub fn tables() -> [Vec<i32>; 2] {
    [DEPTHS.map(i32::from).to_vec(), AWAY.map(i32::from).to_vec()]
}

/// Makes distances of what is smoothed under each width, narrowest first: the fine surface in place of the first, what both are
/// apart by in place of the second, and the calm surface in place of the last; `table` is of depths.
///
/// # Errors
/// Those of the device.
pub fn depths(
    batch: &mut Batch,
    kernels: &Kernels,
    blocks: &DeviceBlocks,
    by: &Bulk,
    table: &View,
    [narrow, middle, wide]: [&View; 3],
) -> Result<(), VulkanError> {
    let Bulk { widths, shares, scale, .. } = by;
    let push = DepthsPush {
        words: blocks.words,
        scale: *scale,
        narrow_width: widths[0].spacings,
        middle_width: widths[1].spacings,
        wide_width: widths[2].spacings,
        narrow_most: widths[0].most,
        middle_most: widths[1].most,
        wide_most: widths[2].most,
        fine_share: shares[0],
        calm_share: shares[1],
    };
    let views = [narrow, middle, wide, table].map(Clone::clone);
    batch.dispatch(&kernels.depths, &views, &push, blocks.flat_groups())
}

/// Makes the surface of the bulk in place of the calm one, where anything is near; `marks` are the bricks that are inside, by block.
///
/// # Errors
/// Those of the device.
pub fn mixed(
    batch: &mut Batch,
    kernels: &Kernels,
    blocks: &DeviceBlocks,
    by: &Bulk,
    marks: &View,
    [calm, fine, apart, near]: [&View; 4],
) -> Result<(), VulkanError> {
    let push = MixPush {
        apart_begin: by.apart.begin.into(),
        apart_range: by.apart.range.into(),
        apart_slope: by.apart.slope,
        deep_begin: by.deep.begin.into(),
        deep_range: by.deep.range.into(),
        deep_slope: by.deep.slope,
    };
    let views = [&blocks.blocks, calm, fine, apart, near, marks].map(Clone::clone);
    batch.dispatch(&kernels.mix, &views, &push, blocks.groups())
}

/// Makes of clouds by how much those that hold a particle lie outside of the calm surface.
///
/// # Errors
/// Those of the device.
pub fn outlying(
    batch: &mut Batch,
    kernels: &Kernels,
    blocks: &DeviceBlocks,
    least: u16,
    [calm, clouds]: [&View; 2],
) -> Result<(), VulkanError> {
    let push = OutlyingPush { words: blocks.words, least: least.into() };
    batch.dispatch(&kernels.outlying, &[calm, clouds].map(Clone::clone), &push, blocks.flat_groups())
}

/// The greatest sample within the window along x, then y, then z: from `from` through `to` and `through` into `to`.
///
/// # Errors
/// Those of the device.
pub fn spread(
    batch: &mut Batch,
    kernels: &Kernels,
    blocks: &DeviceBlocks,
    window: Window,
    views: [&View; 3],
) -> Result<(), VulkanError> {
    along_each_axis(batch, &kernels.spread, blocks, window, views, &[], |_| 0)
}

/// The samples of `wide` blocks at the middles of cells of as many `blocks`, but for a margin.
///
/// # Errors
/// Those of the device.
pub fn refine(
    batch: &mut Batch,
    kernels: &Kernels,
    [wide, blocks]: [&DeviceBlocks; 2],
    level: u32,
    (walls, margin): (Option<CellBox>, i32),
    [from, to]: [&View; 2],
) -> Result<(), VulkanError> {
    let [walls_lo, walls_hi] = wall_bounds(walls);
    let push = RefinePush { walls_lo, level, walls_hi, margin: margin as u32 };
    let views = [&blocks.blocks, &wide.blocks, from, to].map(Clone::clone);
    batch.dispatch(&kernels.refine, &views, &push, blocks.groups())
}

/// Makes shares of clouds in what is around them.
///
/// # Errors
/// Those of the device.
pub fn quotient(
    batch: &mut Batch,
    kernels: &Kernels,
    blocks: &DeviceBlocks,
    bits: u32,
    [clouds, around]: [&View; 2],
) -> Result<(), VulkanError> {
    let push = QuotientPush { words: blocks.words, bits };
    batch.dispatch(&kernels.quotient, &[around, clouds].map(Clone::clone), &push, blocks.flat_groups())
}

/// Makes the field of the bulk's surface, in its place; `table` is of how far away shares are.
///
/// # Errors
/// Those of the device.
pub fn join(
    batch: &mut Batch,
    kernels: &Kernels,
    blocks: &DeviceBlocks,
    (drops, gate): (&Drops, &Gate),
    table: &View,
    [bulk, near, shares]: [&View; 3],
) -> Result<(), VulkanError> {
    let push = JoinPush {
        words: blocks.words,
        begin: gate.begin.into(),
        range: gate.range.into(),
        slope: gate.slope,
        radius: drops.radius,
        width: drops.width,
    };
    let views = [near, shares, table, bulk].map(Clone::clone);
    batch.dispatch(&kernels.join, &views, &push, blocks.flat_groups())
}
