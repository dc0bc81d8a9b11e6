//! Makes a part: samples the bins that affect the part's blocks, and meshes these blocks.

use crate::error::{Error, PartsError};
use crate::field::indicator::IndicatorKind;
use crate::frame::{CountedFrame, Engine};
use crate::grid::stretch::WantedBins;
use crate::io::input::open_wanted;
use crate::io::wanted::{WantedParticles, WantedPieces};
use crate::io::whole::{Replace, WholeFile, sweep};
use crate::io::{ReadError, ReadFault};
use crate::particles::{AttributeInfo, Particles, carried_infos};
use crate::reconstruction::checked::{CheckedRequest, StartedRequest};
use crate::reconstruction::warning::Warning;
use crate::surface::dual_mc::Normals;
use crate::surface::mesh::spool::Spool;
use crate::system::control::Stage;
use crate::system::timings::Timings;

use super::chunks::PartInput;
use super::file::{PartFile, PartMark, PartResults};
use super::plan_file::SharedPlan;
use super::{PartDone, Parts, PartsRequest, part_in, plan_file};

/// The blocks of a part, with counts for the report.
struct MeshedPart {
    spool: Option<Spool>,
    made: PartResults<'static>,
    /// Number of particles that were read.
    read: usize,
    warnings: Vec<Warning>,
}

impl Parts {
    /// Makes a part, or reuses the part's file if it is complete and from the same plan. Any other
    /// file at this path is replaced. Parts are numbered from 0.
    ///
    /// # Errors
    /// [`Error::Parts`] if there is no plan for this request or no such part, or if the input has
    /// changed; [`Error::Read`] if the input cannot be read, or changes while the part is made;
    /// [`Error::Frame`] if the particles cannot be sampled or meshed; and [`Error::Write`] if the
    /// part's file cannot be written.
    pub fn part(&self, part: u32) -> Result<PartDone, Error> {
        let request = self.begin()?;
        if part >= self.count {
            return Err(PartsError::NoPart { part, of: self.count }.into());
        }
        let (plan, fingerprint) = self.planned(&request)?;
        let PartsRequest { checked, folder, indicator } = request;
        let path = part_in(&folder, part);
        let mark = mark(&plan, fingerprint, part, &checked);
        match PartFile::open(&path, mark, &components(&plan)) {
            Ok(Some(existing)) => return Ok(PartDone::of_file(path, &existing)),
            Err(fault @ PartsError::Io { .. }) => return Err(fault.into()),
            Ok(None) | Err(_) => {}
        }
        sweep(&folder);
        let started = checked.on_threads()?;
        let control = &started.checked.resources.control;
        let prepare = || WholeFile::prepare(&path, Replace::Allow);
        let (file, unfinished) = control
            .cancel
            .guard(prepare, |file| file.temporary().into_iter().map(Into::into).collect())?;
        let mut timings = Timings::default();
        let meshed = self
            .meshed(&started, &plan, indicator, mark, &mut timings)
            .map_err(|error| error.of_file(&self.input))?;
        let stamp = started.checked.settings.stamp(&self.input)?;
        if stamp != plan.input {
            return Err(ReadError::new(&self.input, ReadFault::Changed).into());
        }
        let MeshedPart { spool, made, read, warnings } = meshed;
        let made = PartResults { spool: spool.as_ref(), ..made };
        let write = || file.fill(|out| made.write(mark, out)).map_err(Error::from);
        let filled = started.threads.install(|| control.during(Stage::Writing, write))?;
        let bytes = filled.keep()?;
        drop(unfinished);
        timings.done("write");
        let (blocks, triangles) =
            spool.as_ref().map_or((0, 0), |spool| (spool.len(), spool.triangles()));
        Ok(PartDone { path, bytes, blocks, triangles, read, reused: false, warnings, timings })
    }

    fn meshed(
        &self,
        started: &StartedRequest,
        plan: &SharedPlan,
        indicator: IndicatorKind,
        mark: PartMark,
        timings: &mut Timings,
    ) -> Result<MeshedPart, Error> {
        let StartedRequest { checked, threads } = started;
        let control = &checked.resources.control;
        threads.install(|| {
            let wanted = |carried: Vec<usize>| {
                let sampling = plan.sampling(checked, carried)?;
                let coarsest = plan.cells.sizes.as_ref().map(|sizes| sizes.coarsest);
                let deciding = sampling.deciding_cells(indicator, &checked.surfacing, coarsest);
                Ok::<_, Error>((sampling, WantedBins { stretch: mark.stretch, deciding }))
            };
            // The wanted bins depend on whether there are attributes, but not on which attributes
            // these are, so the indices here are arbitrary.
            let (sampling, bins) = wanted((0..plan.attributes.len()).collect())?;
            let reading = PartInput::of(&plan.chunks, bins, sampling.periodic.as_ref());
            if reading.is_empty() {
                return Ok(MeshedPart::without_blocks(plan, 0));
            }
            let changed = || {
                let (input, plan) = (self.input.clone(), plan_file::path_in(&self.folder()));
                PartsError::Changed { input, plan }
            };
            let pieces = WantedPieces::Numbered(&reading.pieces);
            let wanted_of_input = WantedParticles { pieces, ..checked.wanted() };
            let open =
                || Ok::<_, Error>(open_wanted(&self.input, wanted_of_input, checked.unpacking())?);
            let mut file = control.during(Stage::Reading, open)?;
            timings.done("open");
            let attributes = file.particles.attributes();
            let carried = checked.settings.carried(&file.particles, None)?;
            if !reading.matches(&file.particles)
                || !are_compatible(&carried_infos(attributes, &carried), &plan.attributes)
            {
                return Err(changed().into());
            }
            file.particles.keep(reading.ranges.iter().cloned());
            let (sampling, bins) = wanted(carried)?;
            let sampling = sampling.sized(plan.cells.sizes.as_ref(), &file.particles)?;
            let sampling = sampling.with_finer(&plan.finer_blocks);
            let count =
                || CountedFrame::of_wanted(&file.particles, &sampling, &checked.surfacing, bins);
            let counted = control.during(Stage::Counting, count)?;
            timings.done("count");
            let share = plan.parts[mark.part as usize];
            if counted.census().binned as u64 != share.counted {
                return Err(changed().into());
            }
            if share.counted == 0 {
                return Ok(MeshedPart::without_blocks(plan, reading.count()));
            }
            let engine = Engine::sample_counted(counted, sampling.resources.budget, timings)?;
            drop(file);
            let known = plan.calibration.as_ref();
            let mesh = || {
                let calibrated = engine.calibrate(&checked.surfacing, known, timings)?;
                calibrated.within(mark.stretch).blocks(timings)
            };
            let spool = control.during(Stage::Meshing, mesh)?;
            let occupied = engine.occupied().within(mark.stretch).collect();
            let made = PartResults {
                spool: None,
                occupied,
                lacking: engine.lacking_within(mark.stretch)?,
            };
            let warnings = engine.warnings().into_iter().map(Warning::DeviceFallback).collect();
            Ok(MeshedPart { spool: Some(spool), made, read: reading.count(), warnings })
        })
    }
}

impl MeshedPart {
    /// A part without blocks, after reading `read` particles.
    fn without_blocks(plan: &SharedPlan, read: usize) -> Self {
        let made = PartResults {
            spool: None,
            occupied: Vec::new(),
            lacking: vec![0; plan.attributes.len()],
        };
        Self { spool: None, made, read, warnings: Vec::new() }
    }
}

/// The mark of a part's file.
pub(super) fn mark(
    plan: &SharedPlan,
    fingerprint: u32,
    part: u32,
    checked: &CheckedRequest,
) -> PartMark {
    let normals = checked.surfacing.normals == Normals::Gradient;
    PartMark { plan: fingerprint, part, of: plan.count(), stretch: plan.stretch(part), normals }
}

/// Number of components of each vertex attribute.
pub(super) fn components(plan: &SharedPlan) -> Vec<usize> {
    plan.attributes.iter().map(|info| info.components).collect()
}

impl PartDone {
    fn of_file(path: std::path::PathBuf, file: &PartFile) -> Self {
        let blocks = &file.meshes.blocks;
        Self {
            path,
            bytes: file.bytes,
            blocks: blocks.len(),
            triangles: blocks.iter().map(|block| u64::from(block.triangles)).sum(),
            read: 0,
            reused: true,
            warnings: Vec::new(),
            timings: Timings::default(),
        }
    }
}

/// Whether attributes have the same names and numbers of components, and are integers in both lists
/// or in neither. Kinds may differ in other ways, because the plan's kinds come from all particles,
/// and a part reads only some particles.
fn are_compatible(own: &[AttributeInfo], planned: &[AttributeInfo]) -> bool {
    let same = |(a, b): (&AttributeInfo, &AttributeInfo)| {
        (&a.name, a.components, a.kind.is_whole()) == (&b.name, b.components, b.kind.is_whole())
    };
    own.len() == planned.len() && own.iter().zip(planned).all(same)
}
