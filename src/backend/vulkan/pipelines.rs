//! The shaders from particles to surfaces, and the size of a page on the device.

use std::sync::Arc;

use crate::brick::PageShape;
use crate::brick::vulkan::page_words;
use crate::field::distance::vulkan::DistancePipelines;
use crate::field::indicator::vulkan::IndicatorPipelines;
use crate::shaders::{
    BASES, BLEND, BLUR, CLOUDS, DEPTHS_OF, EMIT, FULL_BRICKS, FULL_CELLS, GATHER, GREATER, HALVE,
    INDICATE, JOIN, LOOSE, LOST, MIX_BOTH, OUTLYING, PROBE, QUOTIENT, REFINE, SHEETS, SIGNS,
    SPREAD, TILES,
};
use crate::surface::dual_mc::vulkan::DualMcPipelines;
use crate::vulkan::{ComputePipeline, Device, VulkanError};

/// All compute pipelines.
#[derive(Debug)]
pub(super) struct Pipelines {
    pub(super) indicate: IndicatorPipelines,
    pub(super) full_cells: Arc<ComputePipeline>,
    pub(super) halve: Arc<ComputePipeline>,
    pub(super) gather: Arc<ComputePipeline>,
    pub(super) blur: Arc<ComputePipeline>,
    pub(super) lost: Arc<ComputePipeline>,
    pub(super) greater: Arc<ComputePipeline>,
    pub(super) distance: DistancePipelines,
    pub(super) loose: Arc<ComputePipeline>,
    pub(super) sheets: Arc<ComputePipeline>,
    pub(super) blend: Arc<ComputePipeline>,
    pub(super) dual_mc: DualMcPipelines,
}

impl Pipelines {
    /// Compiles the shaders for a device.
    pub(super) fn new(device: &Device) -> Result<Self, VulkanError> {
        #[rustfmt::skip]
        let [
            indicate, clouds, full_cells, halve, full_bricks, gather, blur, lost, greater,
            depths, mix, outlying, spread, probe, refine, quotient, loose, sheets, blend, join,
            signs, tiles, bases, emit,
        ] = device.pipelines([
            &INDICATE, &CLOUDS, &FULL_CELLS, &HALVE, &FULL_BRICKS, &GATHER, &BLUR, &LOST, &GREATER,
            &DEPTHS_OF, &MIX_BOTH, &OUTLYING, &SPREAD, &PROBE, &REFINE, &QUOTIENT, &LOOSE, &SHEETS,
            &BLEND, &JOIN,
            &SIGNS, &TILES, &BASES, &EMIT,
        ])?;
        Ok(Self {
            indicate: IndicatorPipelines { indicate, clouds },
            full_cells,
            halve,
            gather,
            blur,
            lost,
            greater,
            distance: DistancePipelines {
                depths,
                mix,
                outlying,
                spread,
                probe,
                refine,
                quotient,
                join,
                full_bricks,
            },
            loose,
            sheets,
            blend,
            dual_mc: DualMcPipelines { signs, tiles, bases, emit },
        })
    }
}

/// Bytes of a page on the device.
pub(super) fn page_bytes(shape: PageShape) -> u64 {
    4 * u64::from(page_words(shape))
}
