//! The shaders from particles to surfaces, and what they take a page to be.

use std::sync::Arc;

use crate::brick::PageShape;
use crate::brick::vulkan::{FULL_CELLS, GATHER, HALVE, page_words};
use crate::field::blur::vulkan::BLUR;
use crate::field::detail::vulkan::{GREATER, LOST};
use crate::field::distance::vulkan::{
    DEPTHS_OF, FULL_BRICKS, JOIN, LOOK, MIX, OUTLYING, Pipelines as Distance, QUOTIENT, REFINE, SPREAD,
};
use crate::field::indicator::vulkan::{CLOUDS, INDICATE, Pipelines as Indicators};
use crate::surface::dual_mc::vulkan::{BASES, EMIT, Pipelines as DualMc, SIGNS, TILES};
use crate::vulkan::{ComputePipeline, Device, VulkanError};

/// All of them.
#[derive(Debug)]
pub(super) struct Pipelines {
    pub(super) indicate: Indicators,
    pub(super) full_cells: Arc<ComputePipeline>,
    pub(super) halve: Arc<ComputePipeline>,
    pub(super) gather: Arc<ComputePipeline>,
    pub(super) blur: Arc<ComputePipeline>,
    pub(super) lost: Arc<ComputePipeline>,
    pub(super) greater: Arc<ComputePipeline>,
    pub(super) distance: Distance,
    pub(super) dual_mc: DualMc,
}

impl Pipelines {
    /// Compiles them for a device.
    pub(super) fn new(device: &Device) -> Result<Self, VulkanError> {
        #[rustfmt::skip]
        let [
            indicate, clouds, full_cells, halve, full_bricks, gather, blur, lost, greater,
            depths, mix, outlying, spread, look, refine, quotient, join,
            signs, tiles, bases, emit,
        ] = device.pipelines([
            &INDICATE, &CLOUDS, &FULL_CELLS, &HALVE, &FULL_BRICKS, &GATHER, &BLUR, &LOST, &GREATER,
            &DEPTHS_OF, &MIX, &OUTLYING, &SPREAD, &LOOK, &REFINE, &QUOTIENT, &JOIN,
            &SIGNS, &TILES, &BASES, &EMIT,
        ])?;
        Ok(Self {
            indicate: Indicators { indicate, clouds },
            full_cells,
            halve,
            gather,
            blur,
            lost,
            greater,
            distance: Distance { depths, mix, outlying, spread, look, refine, quotient, join, full_bricks },
            dual_mc: DualMc { signs, tiles, bases, emit },
        })
    }
}

/// Bytes of a page on the device.
pub(super) fn page_bytes(shape: PageShape) -> u64 {
    4 * u64::from(page_words(shape))
}
