//! A forecast for one frame: memory and disk space from its counted particles, and time from a
//! sample of its blocks.

use std::path::PathBuf;
use std::time::Instant;

use crate::brick::Census;
use crate::error::Error;
use crate::frame::estimate::MemoryEstimate;
use crate::frame::{CountedFrame, Engine, FrameError, Sampling};
use crate::grid::stretch::{Stretch, WantedBins};
use crate::grid::{MortonKey, block_of_bin};
use crate::io::ParticleFile;
use crate::io::output::MeshFormat;
use crate::io::vdb;
use crate::particles::Particles;
use crate::surface::simplify::BYTES_PER_THREAD;
use crate::system::timings::Timings;

use super::checked::{CheckedRequest, StartedRequest};
use super::opened::{Input, OpenedFrame};

/// Minimum number of particles in the sample. A frame with up to twice as many particles is sampled
/// and meshed completely.
const SAMPLE: usize = 200_000;

/// Resources that a frame needs, estimated before sampling.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Needs {
    /// Counts of particles that would be used and skipped.
    pub census: Census,
    /// Edge of a cell.
    pub cell_size: f64,
    /// Memory limit, in bytes.
    pub budget: u64,
    /// Peak memory, in bytes, of the frame and its solids within the limit.
    pub memory: u64,
    /// Peak memory, in bytes, without scratch files.
    pub in_core: u64,
    /// Upper bound of the size, in bytes, of scratch files.
    pub scratch: u64,
    /// Folder of the scratch files.
    pub scratch_folder: PathBuf,
    /// Additional bytes for simplifying, if it is requested: first the bytes that must be in
    /// memory, then the bytes that can be in memory or in scratch files.
    pub simplifying: Option<[u64; 2]>,
    /// The memory, in bytes, that the writer needs in addition to the memory limit; `None` if the
    /// limit includes it.
    pub writing: Option<u64>,
    /// Approximate number of triangles before simplifying: exact for a small frame, estimated from
    /// the counted particles for a large one.
    pub triangles: u64,
    /// Approximate size, in bytes, of the mesh on disk.
    pub disk: u64,
    /// Approximate time, in seconds, of the reconstruction without writing the mesh. `None` if a
    /// sample cannot be measured: for large frames with kernel methods, or if the sample has no
    /// surface.
    pub seconds: Option<f64>,
}

/// Approximate size, in bytes, of a mesh on disk: 24 bytes per vertex with its velocity, and 13 per
/// triangle, as in `.ply`, without further attributes and before simplifying.
pub(crate) fn mesh_bytes(vertices: u64, triangles: u64) -> u64 {
    24 * vertices + 13 * triangles
}

/// Result of making some or all blocks of a frame.
struct TrialResult {
    /// Number of particles that were binned.
    particles: usize,
    triangles: u64,
    /// Times, in seconds, for sampling the particles and for meshing their surface.
    seconds: [f64; 2],
}

impl OpenedFrame {
    /// Counts the particles, and estimates the resources that their surface needs; `None` for a
    /// packed frame. To measure the time, samples and meshes a part of the frame, or the whole
    /// frame if it is small.
    ///
    /// # Errors
    /// [`Error::Frame`] for invalid particles, or too little memory, and [`Error::Cancelled`].
    pub fn needs(&self, format: MeshFormat) -> Result<Option<Needs>, Error> {
        let Input::Particles { file, chosen } = &self.input else { return Ok(None) };
        let StartedRequest { checked, threads } = &self.request;
        let (start, sampling) = (Instant::now(), &chosen.sampling);
        let counted = threads.install(|| {
            let counted =
                CountedFrame::for_surface(&file.particles, sampling, &checked.surfacing, None)?;
            let (census, estimate) = (counted.census(), counted.estimate());
            let before = self.timings.total() + start.elapsed().as_secs_f64();
            Ok((census, estimate, forecast(checked, file, sampling, counted, before)?))
        });
        let (census, estimate, (triangles, seconds)): (Census, MemoryEstimate, _) =
            counted.map_err(|fault| self.in_file(fault))?;
        let resources = &checked.resources;
        let plan = estimate.plan(resources.budget);
        let solids = checked.surfacing.solid_bytes();
        // Each of the two passes of simplifying holds every remaining triangle as three 64-bit
        // numbers.
        let simplified = [BYTES_PER_THREAD * checked.threads as u64, 3 * estimate.surface];
        let [writing, writing_scratch] = match format {
            MeshFormat::Vdb { .. } => {
                let is_whole = !checked.reduction.is_none();
                let in_files = (!is_whole).then(|| estimate.has_surface_in_files(plan));
                let attributes = file.particles.attributes();
                let of = |&index: &usize| attributes[index].components as u64;
                let components = sampling.carried.iter().map(of).sum();
                vdb::writing_bytes(estimate.in_finest_cells, components, in_files)
            }
            _ if checked.settings.holds_whole_mesh(format) => [3 * estimate.surface, 0],
            _ => [0, 0],
        };
        Ok(Some(Needs {
            census,
            cell_size: sampling.grid.cell_size(),
            budget: resources.budget.0 + solids,
            memory: estimate.peak(plan) + solids,
            in_core: estimate.in_core() + solids,
            scratch: file.particles.scratch_bytes() + estimate.scratch(plan) + writing_scratch,
            scratch_folder: resources.scratch.clone(),
            simplifying: checked.reduction.tolerance.map(|_| simplified),
            writing: (writing > 0).then_some(writing),
            triangles,
            disk: mesh_bytes(triangles / 2, triangles),
            seconds,
        }))
    }
}

/// The approximate number of triangles of a frame, and its time in seconds: the time `before`,
/// including the count, plus the time for sampling and meshing. The time for sampling and meshing
/// is measured on the whole frame, or extrapolated from a sample of its blocks.
fn forecast(
    checked: &CheckedRequest,
    file: &ParticleFile,
    sampling: &Sampling,
    counted: CountedFrame<'_>,
    before: f64,
) -> Result<(u64, Option<f64>), FrameError> {
    let particles = counted.census().binned;
    // A closed surface has about twice as many triangles as vertices.
    let expected = 2 * counted.estimate().vertices;
    if particles <= 2 * SAMPLE {
        let whole = run_trial(checked, counted, Stretch::ALL);
        return Ok(match trial_or_none(whole)? {
            Some(TrialResult { triangles, seconds: [sampling, meshing], .. }) => {
                (triangles, Some(before + sampling + meshing))
            }
            None => (expected, None),
        });
    }
    // Kernel methods have no indicator, so `deciding_cells` cannot determine which particles affect
    // a sample of the blocks, and no sample is measured.
    let Some(kind) = sampling.method.indicator() else { return Ok((expected, None)) };
    let stretch = sample(counted.bins());
    drop(counted);
    let wanted = WantedBins {
        stretch,
        deciding: sampling.deciding_cells(kind, &checked.surfacing, sampling.coarsest()),
    };
    let counted = CountedFrame::of_wanted(&file.particles, sampling, &checked.surfacing, wanted)?;
    let Some(part) = trial_or_none(run_trial(checked, counted, stretch))? else {
        return Ok((expected, None));
    };
    let [of_sampling, of_meshing] = part.seconds;
    let times = |whole: f64, part: f64| if part > 0.0 { whole / part } else { 0.0 };
    let seconds = before
        + of_sampling * times(particles as f64, part.particles as f64)
        + of_meshing * times(expected as f64, part.triangles as f64);
    Ok((expected, (part.triangles > 0).then_some(seconds)))
}

/// Returns `None` for a trial that failed, for example because there is no surface. Only
/// cancellation gives an error.
fn trial_or_none(
    trial: Result<TrialResult, FrameError>,
) -> Result<Option<TrialResult>, FrameError> {
    match trial {
        Err(FrameError::Cancelled) => Err(FrameError::Cancelled),
        trial => Ok(trial.ok()),
    }
}

/// Makes the blocks of `stretch`, and measures the time.
fn run_trial(
    checked: &CheckedRequest,
    counted: CountedFrame<'_>,
    stretch: Stretch,
) -> Result<TrialResult, FrameError> {
    let (start, particles) = (Instant::now(), counted.census().binned);
    let mut timings = Timings::default();
    let engine = Engine::sample_counted(counted, checked.resources.budget, &mut timings)?;
    let calibrated =
        engine.calibrate(&checked.surfacing, checked.calibration.as_ref(), &mut timings)?;
    let sampled = start.elapsed();
    let spool = calibrated.within(stretch).blocks(&mut timings)?;
    let seconds = [sampled, start.elapsed() - sampled].map(|time| time.as_secs_f64());
    Ok(TrialResult { particles, triangles: spool.triangles(), seconds })
}

/// Consecutive blocks that contain at least [`SAMPLE`] particles, beginning with the block that
/// contains the middle particle.
fn sample(bins: impl Iterator<Item = (MortonKey, usize)> + Clone) -> Stretch {
    let block = |bin: MortonKey| MortonKey::of(block_of_bin(bin.coord()));
    let all: usize = bins.clone().map(|(_, count)| count).sum();
    let mut before = 0;
    let mut from_the_middle = bins.skip_while(|&(_, count)| {
        before += count;
        2 * before < all
    });
    let Some((bin, count)) = from_the_middle.next() else { return Stretch::ALL };
    let (first, mut particles) = (block(bin), count);
    for (bin, count) in from_the_middle {
        if particles >= SAMPLE && block(bin) > first {
            return Stretch { first, end: block(bin) };
        }
        particles += count;
    }
    Stretch { first, end: Stretch::ALL.end }
}
