//! A frame's particles on the host, before their pages are made.

use std::sync::Arc;

use crate::backend::Stages;
use crate::brick::{BinPlan, BinnedParticles, Bins};
use crate::field::calibration::{BinnedFrame, Fullness};
use crate::field::indicator::PageRule;
use crate::frame::estimate::MemoryPlan;
use crate::particles::Particles;
use crate::system::control::Meter;

use super::lost::OccupiedTiles;
use super::sink::FieldSink;
use super::{FrameError, Resources};

/// Sorts counted particles according to `bin_plan`, with the attributes whose indices are in
/// `carried`.
pub(super) fn sorted(
    bin_plan: BinPlan,
    particles: &dyn Particles,
    carried: &[usize],
    plan: MemoryPlan,
    resources: &Resources,
) -> Result<BinnedParticles, FrameError> {
    let MemoryPlan::OutOfCore(shares) = plan else {
        return Ok(BinnedParticles::InMemory(bin_plan.fill(particles, carried)?));
    };
    let runs = bin_plan.runs(particles, carried, shares.particles);
    // No run is being sorted yet, so the memory for sorted particles is free for buffers.
    let buffers = shares.particles as usize;
    let spilled =
        bin_plan.spill(particles, carried, runs, &resources.scratch, buffers, shares.coded);
    Ok(BinnedParticles::Spilled(spilled.map_err(resources.scratch_error())??))
}

/// Binned particles whose pages go into a sink.
pub(super) struct HostBins<'a> {
    pub(super) binned: BinnedParticles,
    pub(super) stages: &'a dyn Stages,
    pub(super) sink: FieldSink,
    pub(super) occupied: OccupiedTiles,
    pub(super) resources: &'a Resources,
    /// Whether the bins are still needed for their attributes after the pages are made.
    pub(super) keep: bool,
    /// Counts the bins whose pages were made.
    pub(super) meter: Meter<'a>,
}

impl BinnedFrame for HostBins<'_> {
    type Made = (FieldSink, OccupiedTiles, Option<Arc<Bins>>);
    type Error = FrameError;

    fn make_pages(self, rule: &PageRule) -> Result<(Fullness, Self::Made), FrameError> {
        let Self { binned, stages, mut sink, mut occupied, resources, keep, meter } = self;
        let take = |bins: &Bins| {
            occupied.add(bins)?;
            sink.take(stages, bins, rule, &meter)?;
            Ok(sink.bytes_in_memory())
        };
        let kept = match binned {
            BinnedParticles::InMemory(bins) => {
                let bins = Arc::new(bins);
                let taken =
                    occupied.add(&bins).and_then(|()| sink.take_whole(stages, &bins, rule, &meter));
                taken.map(|()| keep.then_some(bins))
            }
            spilled if keep => {
                spilled.visit_and_keep(&resources.scratch, take).map(|bins| Some(Arc::new(bins)))
            }
            spilled => spilled.visit(take).map(|()| None),
        };
        let kept = kept.map_err(resources.scratch_error())?;
        let full = occupied.fullness(sink.full_cells());
        Ok((full, (sink, occupied, kept)))
    }
}
