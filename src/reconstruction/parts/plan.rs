//! Plans parts: samples the frame once to measure it, and divides its blocks.

use rayon::prelude::*;

use crate::error::{Error, PartsError};
use crate::field::indicator::IndicatorKind;
use crate::frame::estimate::MemoryEstimate;
use crate::frame::{CountedFrame, Engine, FrameError, Sampling};
use crate::grid::stretch::{DecidingCells, Stretch};
use crate::grid::units::MemoryBudget;
use crate::grid::{MortonKey, block_of_bin};
use crate::io::input::open_wanted;
use crate::io::output::MeshFormat;
use crate::io::stamp::Stamp;
use crate::io::whole::sweep;
use crate::io::{ParticleFile, ReadError, ReadFault, UnreadPart};
use crate::particles::Particles;
use crate::particles::kind::settled;
use crate::reconstruction::checked::{CheckedRequest, StartedRequest};
use crate::reconstruction::warning::mean_symmetry;
use crate::reconstruction::{ChosenSampling, SpacingHints};
use crate::system::control::Stage;
use crate::system::timings::Timings;

use super::plan_file::{BlockShare, SharedPlan, path_in};
use super::{ExistingPlan, PartNeeds, PartShare, Parts, PartsPlan, PartsRequest, chunks};

/// Number of cells near the surface for which computing the field and the mesh takes as long as
/// binning and sampling one particle.
const CELLS_A_PARTICLE: u64 = 4;

/// The plan of a frame, the needs of each part, and the parts of the input that were not read.
type MeasuredFrame = (SharedPlan, Vec<PartNeeds>, Vec<UnreadPart>);

impl Parts {
    /// Measures the frame and divides its blocks, or reuses an existing plan of the same request.
    ///
    /// # Errors
    /// [`Error::Parts`] for a plan of another request, [`Error::SettingConflict`] for kernel
    /// methods and packed frames, which do not support parts, [`Error::Read`], and [`Error::Frame`]
    /// for particles that cannot be sampled.
    pub fn plan(&self) -> Result<PartsPlan, Error> {
        let request = self.begin()?;
        let found =
            SharedPlan::load(&request.folder).map_err(Error::from).and_then(|found| match found {
                Some((plan, _)) => plan
                    .check_request(&request.folder, &request.checked, &self.input, self.count)
                    .map(|()| Some(plan)),
                None => Ok(None),
            });
        match (found, self.existing) {
            (Ok(Some(plan)), ExistingPlan::Refuse | ExistingPlan::ReplaceDiffering) => {
                return self.describe(plan, None, Vec::new(), &request, Timings::default());
            }
            (Err(fault), ExistingPlan::Refuse) => return Err(fault),
            _ => {}
        }
        let PartsRequest { checked, folder, indicator } = request;
        let started = checked.clone().on_threads()?;
        let mut timings = Timings::default();
        let (plan, needs, left_out) = self.measured(&started, indicator, &mut timings)?;
        let save = || {
            plan.save(&folder)?;
            sweep(&folder);
            Ok::<_, PartsError>(())
        };
        checked.resources.control.cancel.undisturbed(save)?;
        let request = PartsRequest { checked, folder, indicator };
        self.describe(plan, Some(needs), left_out, &request, timings)
    }

    fn describe(
        &self,
        plan: SharedPlan,
        needs: Option<Vec<PartNeeds>>,
        left_out: Vec<UnreadPart>,
        request: &PartsRequest,
        timings: Timings,
    ) -> Result<PartsPlan, Error> {
        let path = path_in(&request.folder);
        let no_calibration =
            || PartsError::Plan { path: path.clone(), what: "it has no calibration".into() };
        let calibration = plan.calibration.ok_or_else(no_calibration)?;
        let share = |(part, share): (usize, &BlockShare)| PartShare {
            particles: share.particles,
            kept: share.counted,
            needs: needs.as_ref().map(|needs| needs[part]),
        };
        Ok(PartsPlan {
            parts: plan.parts.iter().enumerate().map(share).collect(),
            particles: plan.particles,
            moved_to: plan.moved.then_some(plan.origin),
            format: plan.format,
            particle_types: plan.particle_types,
            left_out,
            cells: plan.cells,
            indicator: request.indicator,
            census: plan.census,
            calibration,
            budget: request.checked.resources.budget.0 + request.checked.surfacing.solid_bytes(),
            scratch_folder: request.checked.resources.scratch.clone(),
            timings,
            path,
        })
    }

    /// Measures the frame, divides its blocks, and estimates the resources of each part.
    fn measured(
        &self,
        started: &StartedRequest,
        indicator: IndicatorKind,
        timings: &mut Timings,
    ) -> Result<MeasuredFrame, Error> {
        let (StartedRequest { checked, threads }, input) = (started, &self.input);
        let stamp = || checked.settings.stamp(input);
        let before = stamp()?;
        let measured = threads.install(|| {
            let open = || {
                let file = open_wanted(input, checked.wanted(), checked.unpacking())?;
                let file = file.require_selected().map_err(|fault| ReadError::new(input, fault))?;
                timings.done("open");
                let source = SpacingHints { path: Some(input), spacing: file.spacing };
                let chosen = checked.choose(&file.particles, source);
                let chosen = chosen.map_err(|error| error.with_skipped_part(&file.left_out))?;
                Ok::<_, Error>((file, chosen))
            };
            let (file, chosen) = checked.resources.control.during(Stage::Reading, open)?;
            timings.done("spacing");
            self.sampled(checked, indicator, file, chosen, before, timings)
        });
        let measured = measured.map_err(|error| error.of_file(input))?;
        if stamp()? != before {
            return Err(ReadError::new(input, ReadFault::Changed).into());
        }
        Ok(measured)
    }

    fn sampled(
        &self,
        checked: &CheckedRequest,
        indicator: IndicatorKind,
        file: ParticleFile,
        chosen: ChosenSampling,
        stamp: Stamp,
        timings: &mut Timings,
    ) -> Result<MeasuredFrame, Error> {
        let ChosenSampling { sampling, cells, moved, .. } = chosen;
        let (surfacing, particles) = (&checked.surfacing, &file.particles);
        let control = &checked.resources.control;
        // Planning needs no attributes.
        let without_attributes = Sampling { carried: Vec::new(), ..sampling.clone() };
        let cut = chunks::cut(particles);
        let with_boxes = chunks::with_boxes(particles, &cut, &sampling.grid);
        let count = || CountedFrame::for_surface(&with_boxes, &without_attributes, surfacing, None);
        let counted = control.during(Stage::Counting, count)?;
        let chunks = chunks::boxed(&cut, &with_boxes, sampling.domain.as_ref());
        let (census, bins) = (counted.census(), counted.bins().collect::<Vec<_>>());
        timings.done("count");
        let engine = Engine::sample_counted(counted, without_attributes.resources.budget, timings)?;
        let calibrated = engine.calibrate(surfacing, checked.calibration.as_ref(), timings)?;
        let measured = calibrated.measured();
        let calibration = checked.calibration.or(measured.map(|measured| measured.calibration));
        let cuts = cuts(&work(&bins, calibrated.passed()), self.count);
        drop(calibrated);
        let sampled = engine.dif();
        let (mean, mean_symmetry) =
            (sampled.and_then(|sampled| sampled.indicator.mean()), sampled.and_then(mean_symmetry));
        let coincident = engine.coincident();
        let finer_blocks = engine.finer_blocks().cloned().unwrap_or_default();
        drop(engine);
        let deciding = sampling.deciding_cells(indicator, surfacing, sampling.coarsest());
        let sampled_bins = sampled_bins(&bins, &cuts, deciding);
        let parts = shares(&bins, &cuts, &sampled_bins);
        let plan = SharedPlan {
            meniscus: env!("CARGO_PKG_VERSION").into(),
            settings: checked.settings.kept(),
            calibrated: checked.calibration.is_some(),
            input: stamp,
            particles: particles.len(),
            format: file.format.to_owned(),
            particle_types: file.particle_types.clone(),
            cells,
            origin: sampling.grid.origin().to_array(),
            moved,
            census,
            mean: mean.map(|mean| mean.particles()),
            calibration,
            measured: measured.map(Into::into),
            mean_symmetry,
            coincident,
            finer_blocks,
            attributes: settled(particles, &sampling.carried, &[])
                .map_err(|fault| Error::from(FrameError::from(fault)).of_file(&self.input))?,
            parts,
            chunks,
        };
        if let Some(format) = MeshFormat::of(&self.output) {
            let attributes = || Ok(plan.attributes.clone());
            checked.settings.check_attributes(&self.output, format, attributes)?;
        }
        let needs = (0..).zip(&sampled_bins).map(|(part, known)| {
            let bins = known.iter().map(|&bin| bins[bin as usize]);
            let estimate = sampling.estimate(particles, surfacing, bins, plan.stretch(part));
            let needs =
                PartNeeds::of(&estimate, sampling.resources.budget, particles.scratch_bytes());
            needs.with(surfacing.solid_bytes())
        });
        let needs = needs.collect();
        timings.done("divide");
        Ok((plan, needs, file.left_out))
    }
}

/// The block of a bin.
fn block_of(bin: MortonKey) -> MortonKey {
    MortonKey::of(block_of_bin(bin.coord()))
}

/// Estimated work for each block that contains particles, or through which a surface can pass, in
/// Morton order. The unit is the work for one cell near the surface.
fn work(
    bins: &[(MortonKey, usize)],
    passed: impl Iterator<Item = (MortonKey, usize)>,
) -> Vec<(MortonKey, u64)> {
    let of_particles =
        bins.iter().map(|&(bin, count)| (block_of(bin), CELLS_A_PARTICLE * count as u64));
    let mut work: Vec<_> =
        of_particles.chain(passed.map(|(block, cells)| (block, cells as u64))).collect();
    work.sort_unstable_by_key(|&(block, _)| block);
    work.dedup_by(|other, one| {
        let same = other.0 == one.0;
        if same {
            one.1 += other.1;
        }
        same
    });
    work
}

/// The first block of each part, for `parts` parts with about equal work. The first part begins at
/// the first block of the whole curve.
fn cuts(work: &[(MortonKey, u64)], parts: u32) -> Vec<MortonKey> {
    let all: u128 = work.iter().map(|&(_, work)| u128::from(work)).sum();
    let (mut cuts, mut before) = (vec![Stretch::ALL.first], 0);
    for &(block, work) in work {
        // A block belongs to the part that contains the middle of the block's work.
        let middle = 2 * before + u128::from(work);
        while (cuts.len() as u128) < u128::from(parts)
            && middle * u128::from(parts) >= 2 * all * cuts.len() as u128
        {
            cuts.push(block);
        }
        before += u128::from(work);
    }
    cuts.resize(parts as usize, Stretch::ALL.end);
    cuts
}

fn part_of(cuts: &[MortonKey], block: MortonKey) -> usize {
    cuts.partition_point(|&first| first <= block) - 1
}

/// For each part, the indices in `bins` of the bins that the part samples.
fn sampled_bins(
    bins: &[(MortonKey, usize)],
    cuts: &[MortonKey],
    deciding: DecidingCells,
) -> Vec<Vec<u32>> {
    let sampling_parts = |&(bin, _): &(MortonKey, usize)| {
        let mut parts: Vec<usize> =
            deciding.blocks(bin.coord()).map(|block| part_of(cuts, MortonKey::of(block))).collect();
        parts.sort_unstable();
        parts.dedup();
        parts
    };
    let sampling_parts: Vec<Vec<usize>> = bins.par_iter().map(sampling_parts).collect();
    let mut sampled_bins = vec![Vec::new(); cuts.len()];
    for (bin, parts) in (0..).zip(sampling_parts) {
        parts.into_iter().for_each(|part| sampled_bins[part].push(bin));
    }
    sampled_bins
}

fn shares(
    bins: &[(MortonKey, usize)],
    cuts: &[MortonKey],
    sampled_bins: &[Vec<u32>],
) -> Vec<BlockShare> {
    let mut own = vec![0; cuts.len()];
    bins.iter().for_each(|&(bin, count)| own[part_of(cuts, block_of(bin))] += count as u64);
    let counted = |bins_of: &Vec<u32>| bins_of.iter().map(|&bin| bins[bin as usize].1 as u64).sum();
    let parts = cuts.iter().zip(own).zip(sampled_bins.iter().map(counted));
    parts
        .map(|((first, particles), counted)| BlockShare { first: first.0, particles, counted })
        .collect()
}

impl PartNeeds {
    fn of(estimate: &MemoryEstimate, budget: MemoryBudget, input_scratch: u64) -> Self {
        let plan = estimate.plan(budget);
        Self {
            memory: estimate.peak(plan),
            in_core: estimate.in_core(),
            scratch: input_scratch + estimate.scratch(plan),
        }
    }

    /// Adds `bytes` to both amounts of memory.
    fn with(self, bytes: u64) -> Self {
        Self { memory: self.memory + bytes, in_core: self.in_core + bytes, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_divided_into_parts_of_about_equal_work() {
        let keys = [3, 4, 9, 12, 13, 20_u64];
        let work: Vec<_> =
            keys.into_iter().zip([1, 1, 1, 1, 1, 1]).map(|(k, w)| (MortonKey(k), w)).collect();
        let first = |parts: u32| cuts(&work, parts).iter().map(|key| key.0).collect::<Vec<_>>();
        assert_eq!(first(1), [0]);
        assert_eq!(first(2), [0, 12]);
        assert_eq!(first(3), [0, 9, 13]);
        assert_eq!(first(6), [0, 4, 9, 12, 13, 20]);
        // With more parts than blocks, some parts are empty, and every block is in one part.
        let many = cuts(&work, 20);
        assert_eq!(many.len(), 20);
        assert!(many.is_sorted() && many[0].0 == 0);
        let parts: Vec<usize> = work.iter().map(|&(block, _)| part_of(&many, block)).collect();
        assert!(parts.is_sorted_by(|a, b| a < b), "{parts:?}");
        // A block with more work than all others is alone in its part.
        let heavy: Vec<_> =
            keys.into_iter().zip([1, 1, 100, 1, 1, 1]).map(|(k, w)| (MortonKey(k), w)).collect();
        assert_eq!(cuts(&heavy, 3).iter().map(|key| key.0).collect::<Vec<_>>(), [0, 9, 12]);
        assert_eq!(cuts(&[], 3), [Stretch::ALL.first, Stretch::ALL.end, Stretch::ALL.end]);
    }
}
