//! See `mod.rs` of this folder for the formulas.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::{IVec3, UVec3};

use crate::brick::vulkan::{DeviceBlocks, TapWindow, along_each_axis, mirror_planes};
use crate::grid::units::Isovalue;
use crate::grid::{BIN, CellBox, Mirror};
use crate::shaders::{
    DepthsOfPush, FullBricksPush, JoinPush, MixBothPush, OutlyingPush, ProbePush, QuotientPush,
    RefinePush,
};
use crate::vulkan::{Batch, ComputePipeline, View, VulkanError};

use super::inside::PART;
use super::{AWAY, Bulk, DEPTHS, Drops, StandsOut};

/// Edge, in parts of [`PART`] wide cells, of the largest cubes that the shader of [`full_bricks`]
/// supports.
const WIDEST_CUBE: u32 = 4;
/// Number of parts along the edge of a bin.
const BIN_PARTS: u32 = (BIN / PART) as u32;
const MOST_PARTS: u32 = BIN_PARTS + 2 * (WIDEST_CUBE - 1);
/// Number of parts that a work group sums.
pub const CUBE_PARTS: u32 = MOST_PARTS.pow(3);
/// Number of words that hold one bit for each cube within these parts.
pub const CUBE_WORDS: u32 = (MOST_PARTS + 1 - WIDEST_CUBE).pow(3).div_ceil(u32::BITS);

/// Shaders that compute distances.
#[derive(Debug)]
pub struct DistancePipelines {
    /// Computes the calm and the fine surface of the bulk, and the difference between them.
    pub depths: Arc<ComputePipeline>,
    /// Blends the calm and the fine surface to the surface of the bulk.
    pub mix: Arc<ComputePipeline>,
    /// Computes the distance by which particles lie outside the calm surface.
    pub outlying: Arc<ComputePipeline>,
    /// Finds the greatest nearby sample along one axis.
    pub spread: Arc<ComputePipeline>,
    /// Interpolates wide cells.
    pub refine: Arc<ComputePipeline>,
    /// Searches wide cells for a surface, and for particles that stand out.
    pub probe: Arc<ComputePipeline>,
    /// Divides the density of clouds by the smoothed density.
    pub quotient: Arc<ComputePipeline>,
    /// Blends the surface of the bulk with drops.
    pub join: Arc<ComputePipeline>,
    /// Finds the full bricks, which determine the deep inside.
    pub full_bricks: Arc<ComputePipeline>,
}

/// The wide cells in and around a bin that [`full_bricks`] reads; `None` if cubes of `width` parts
/// are too wide for its shader.
pub fn full_bricks_of(bin: IVec3, width: u32) -> Option<CellBox> {
    let margin = PART * (width as i32 - 1);
    (width <= WIDEST_CUBE).then(|| CellBox::cube(bin, BIN).grown(margin, margin))
}

/// Finds the full bricks of bins, and writes two words per bin to `bricks`. `blocks` are the
/// [cells](full_bricks_of) in and around each bin.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn full_bricks(
    batch: &mut Batch,
    pipelines: &DistancePipelines,
    blocks: &DeviceBlocks,
    (width, least): (u32, u32),
    [field, bricks]: [&View; 2],
) -> Result<(), VulkanError> {
    let views = [&blocks.blocks, field, bricks].map(Clone::clone);
    batch.dispatch(
        &pipelines.full_bricks,
        &views,
        &FullBricksPush { width, least },
        [1, blocks.count, 1],
    )
}

/// The tables of functions in the shaders' layout: depths, and distances for shares.
pub fn tables() -> [Vec<i32>; 2] {
    [DEPTHS.map(i32::from).to_vec(), AWAY.map(i32::from).to_vec()]
}

/// Computes distances from the samples smoothed with each width, narrowest first. The results
/// replace the samples: the fine surface in `narrow`, the difference between the surfaces in
/// `middle`, and the calm surface in `wide`. `table` holds the depths for shares.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn depths(
    batch: &mut Batch,
    pipelines: &DistancePipelines,
    blocks: &DeviceBlocks,
    by: &Bulk,
    table: &View,
    [narrow, middle, wide]: [&View; 3],
) -> Result<(), VulkanError> {
    let Bulk { widths, shares, scale, .. } = by;
    let push = DepthsOfPush {
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
    batch.dispatch(&pipelines.depths, &views, &push, blocks.flat_groups(&pipelines.depths))
}

/// Replaces the calm surface with the surface of the bulk, or with 0 where no particle is near.
/// `marks` holds the inside bricks of each block.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn mixed(
    batch: &mut Batch,
    pipelines: &DistancePipelines,
    blocks: &DeviceBlocks,
    by: &Bulk,
    marks: &View,
    [calm, fine, apart, near]: [&View; 4],
) -> Result<(), VulkanError> {
    let push = MixBothPush {
        apart_begin: by.apart.begin.into(),
        apart_range: by.apart.range.into(),
        apart_slope: by.apart.slope,
        deep_begin: by.deep.begin.into(),
        deep_range: by.deep.range.into(),
        deep_slope: by.deep.slope,
    };
    let views = [&blocks.blocks, calm, fine, apart, near, marks].map(Clone::clone);
    batch.dispatch(&pipelines.mix, &views, &push, blocks.groups(&pipelines.mix))
}

/// Replaces each cloud sample with the distance by which the cell lies outside the calm surface, or
/// with 0 if the cell contains no particle. A cell contains a particle if its cloud sample is at
/// least `least`.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn outlying(
    batch: &mut Batch,
    pipelines: &DistancePipelines,
    blocks: &DeviceBlocks,
    (least, stands_out): (u16, &StandsOut),
    [calm, fine, clouds]: [&View; 3],
) -> Result<(), VulkanError> {
    let push = OutlyingPush {
        words: blocks.words,
        least: least.into(),
        begin: stands_out.ramp.begin.into(),
        begin_of_sheets: stands_out.begin().into(),
        apart_begin: stands_out.apart.begin.into(),
        apart_range: stands_out.apart.range.into(),
        apart_slope: stands_out.apart.slope,
    };
    batch.dispatch(
        &pipelines.outlying,
        &[calm, fine, clouds].map(Clone::clone),
        &push,
        blocks.flat_groups(&pipelines.outlying),
    )
}

/// Replaces each sample with the greatest sample within the window, along x, then y, then z.
/// `views` are the input, a spare view and the output. The samples go from the input to the output,
/// then to the spare view, and finally back to the output.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn spread(
    batch: &mut Batch,
    pipelines: &DistancePipelines,
    blocks: &DeviceBlocks,
    window: TapWindow,
    views: [&View; 3],
) -> Result<(), VulkanError> {
    along_each_axis(batch, &pipelines.spread, blocks, window, views, &[], |_| 0)
}

/// The wide cells around a region, laid out as in `probe.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct RegionProbe {
    lo: [i32; 3],
    block: u32,
    size: [u32; 3],
    spare: u32,
}

impl RegionProbe {
    /// Makes the probe of `cells` in block number `block`.
    pub fn new(cells: CellBox, block: u32) -> Self {
        Self { lo: cells.lo.to_array(), block, size: cells.size().as_uvec3().to_array(), spare: 0 }
    }

    /// The box around the cells near which particles stand out; `None` if there are no such cells.
    pub fn outlying(&self, result: &ProbeResult) -> Option<CellBox> {
        let at = |place: [u32; 3]| IVec3::from(self.lo) + UVec3::from(place).as_ivec3();
        (result.lo[0] <= result.hi[0]).then(|| CellBox { lo: at(result.lo), hi: at(result.hi) + 1 })
    }
}

/// The result of a [`RegionProbe`]: whether wide cells are inside or outside, and where particles
/// stand out.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct ProbeResult {
    /// Whether any cell is inside.
    pub above: u32,
    /// Whether any cell is outside.
    pub below: u32,
    lo: [u32; 3],
    hi: [u32; 3],
}

/// Probes `count` regions of wide `blocks`, and writes `results`: whether a region has cells inside
/// and cells outside the surface, and where particles lie more than `begin` outside the calm
/// surface.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn probe(
    batch: &mut Batch,
    pipelines: &DistancePipelines,
    blocks: &DeviceBlocks,
    count: u32,
    (iso, begin): (Isovalue, u16),
    [probes, bulk, outlying, results]: [&View; 4],
) -> Result<(), VulkanError> {
    let push = ProbePush { threshold: iso.threshold().into(), begin: begin.into() };
    let views = [&blocks.blocks, probes, bulk, outlying, results].map(Clone::clone);
    batch.dispatch(&pipelines.probe, &views, &push, [1, count, 1])
}

/// Interpolates `wide` blocks at the middles of the cells of `blocks`. For each block, `within`
/// holds the number of the wide block that contains it.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn refine(
    batch: &mut Batch,
    pipelines: &DistancePipelines,
    [wide, blocks]: [&DeviceBlocks; 2],
    within: &View,
    level: u32,
    mirror: Option<Mirror>,
    [from, to]: [&View; 2],
) -> Result<(), VulkanError> {
    let [mirror_lo, mirror_hi] = mirror_planes(mirror);
    let push = RefinePush { mirror_lo, level, mirror_hi };
    let views = [&blocks.blocks, &wide.blocks, within, from, to].map(Clone::clone);
    batch.dispatch(&pipelines.refine, &views, &push, blocks.run_groups(&pipelines.refine))
}

/// Divides the density of clouds by the smoothed density `around`.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn quotient(
    batch: &mut Batch,
    pipelines: &DistancePipelines,
    blocks: &DeviceBlocks,
    bits: u32,
    [clouds, around]: [&View; 2],
) -> Result<(), VulkanError> {
    let push = QuotientPush { words: blocks.words, bits };
    batch.dispatch(
        &pipelines.quotient,
        &[around, clouds].map(Clone::clone),
        &push,
        blocks.flat_groups(&pipelines.quotient),
    )
}

/// Replaces the bulk's surface with the field in `parts` of `blocks`. `homes` holds the number of
/// each part's block, and `table` holds the distances for shares. `near`, `shares` and `certainty`
/// cover the cells of the parts. Without `certainty`, there are no sheets.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn join(
    batch: &mut Batch,
    pipelines: &DistancePipelines,
    [parts, blocks]: [&DeviceBlocks; 2],
    (drops, StandsOut { ramp, earlier, .. }): (&Drops, &StandsOut),
    [homes, table]: [&View; 2],
    [bulk, near, shares]: [&View; 3],
    certainty: Option<&View>,
) -> Result<(), VulkanError> {
    let push = JoinPush {
        begin: ramp.begin.into(),
        range: ramp.range.into(),
        slope: ramp.slope,
        radius: drops.radius,
        width: drops.width,
        earlier: certainty.map_or(0, |_| u32::from(*earlier)),
    };
    let certainty = certainty.unwrap_or(shares);
    let views = [&parts.blocks, &blocks.blocks, homes, near, shares, table, certainty, bulk]
        .map(Clone::clone);
    batch.dispatch(&pipelines.join, &views, &push, parts.groups(&pipelines.join))
}
