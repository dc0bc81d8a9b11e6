//! See `mod.rs` of this folder for the formulas.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use crate::brick::vulkan::{page_words, wall_bounds};
use crate::shaders::{CloudsPush, IndicatePush};
use crate::vulkan::{Batch, ComputePipeline, View, VulkanError};

use super::{Amount, GAIN_BITS, IndicatorKind, PageRule};

/// Edge, in cells, of the cube that one work group sums. Its sums fit into the shared memory of
/// every device.
pub const OCTANT: u32 = 8;
/// Maximum number of cloud samples per work group; these samples also fit into the shared memory of
/// every device.
pub const CLOUD_SAMPLES: u32 = 1728;

/// A bin with its range of particles in a batch, laid out as in `binned.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct BinEntry {
    /// The index of the bin's first particle.
    pub first: u32,
    /// The number of the bin's particles.
    pub count: u32,
    /// Coordinates of the bin, in bins.
    pub coord: [i32; 3],
}

/// Shaders that make pages.
#[derive(Debug)]
pub struct IndicatorPipelines {
    /// Computes cell sums and the indicator. Each work group handles one octant of a bin.
    pub indicate: Arc<ComputePipeline>,
    /// Computes clouds. Each work group handles one part of a bin's samples.
    pub clouds: Arc<ComputePipeline>,
}

/// Writes the dense pages of `count` bins.
///
/// # Errors
/// If a view is larger than the storage range of the device, or if the driver fails.
pub fn indicate(
    batch: &mut Batch,
    pipelines: &IndicatorPipelines,
    count: u32,
    rule: &PageRule,
    views: [&View; 3],
) -> Result<(), VulkanError> {
    let views = views.map(Clone::clone);
    let sums = |batch: &mut Batch, counting: bool| {
        let push = IndicatePush { counting: counting.into() };
        batch.dispatch(&pipelines.indicate, &views, &push, [8, count, 1])
    };
    match rule.indicator {
        IndicatorKind::Symmetry => sums(batch, false),
        IndicatorKind::Counting => sums(batch, true),
        IndicatorKind::Cloud => clouds(batch, &pipelines.clouds, count, rule, &views),
    }
}

/// Writes the clouds of the particles of `count` bins.
fn clouds(
    batch: &mut Batch,
    pipeline: &Arc<ComputePipeline>,
    count: u32,
    rule: &PageRule,
    views: &[View; 3],
) -> Result<(), VulkanError> {
    let samples = rule.shape().bin_samples() as u32;
    let groups = samples.div_ceil(CLOUD_SAMPLES).next_power_of_two();
    let [walls_lo, walls_hi] = wall_bounds(rule.walls.map(|walls| walls.cells));
    let [gains_lo, gains_hi] = rule.walls.map_or([[1 << GAIN_BITS; 3]; 2], |walls| walls.gains);
    let push = CloudsPush {
        walls_lo,
        amount: Amount::of_spacing(rule.spacing_cells).steps().into(),
        walls_hi,
        brick_bits: rule.side.cells().ilog2(),
        gains_lo,
        group_samples: samples / groups,
        gains_hi,
        page_words: page_words(rule.shape()),
    };
    batch.dispatch(pipeline, views, &push, [groups, count, 1])
}
