//! Forecasts the resources of a conversion by making its largest frame.

use std::fmt;
use std::path::PathBuf;
use std::time::Instant;

use bytesize::ByteSize;
use rayon::prelude::*;

use crate::error::Error;
use crate::frame::{CountedFrame, Engine};
use crate::io::bytes::Unpacking;
use crate::io::mnf::is_packed;
use crate::reconstruction::mesh_bytes;
use crate::surface::mesh::source::MeshSource;
use crate::system::timings::Timings;

use super::frame_file::FrameFile;
use super::gaps::{Gaps, gaps};
use super::setup::Setup;
use super::shared_calibration::SharedCalibration;
use super::state::{State, StateFolder};

/// A forecast of a conversion. `Display` prints it as several lines of text.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Forecast {
    /// The inputs of the request.
    pub inputs: String,
    /// Number of existing frames.
    pub frames: usize,
    /// Number of selected frames that are not finished yet.
    pub wanted: usize,
    /// Number of selected frames that are already finished, and would be kept.
    pub done: usize,
    /// The file that would contain the mesh of the first frame.
    pub output: PathBuf,
    /// Numbers of the frames that are missing between existing frames.
    pub missing: Gaps,
    /// The calibration that all frames share.
    pub shared: SharedCalibration,
    /// The forecast for the largest frame; `None` if it is a packed frame, or if no frame is
    /// selected.
    pub largest: Option<LargestFrame>,
}

/// The largest frame of a conversion, and estimates for the whole conversion.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct LargestFrame {
    /// The frame's number.
    pub frame: i64,
    /// The number of particles in the frame.
    pub particles: usize,
    /// Number of triangles in the frame's mesh, before simplifying.
    pub triangles: u64,
    /// Estimated peak memory, in bytes, of the frame if it needs no scratch files.
    pub memory: u64,
    /// Memory limit, in bytes.
    pub budget: u64,
    /// Number of frames that would be made in parallel.
    pub side_by_side: usize,
    /// Approximate size on disk, in bytes, of all meshes that would be made.
    pub disk: u64,
    /// Approximate time, in seconds, to make all these meshes.
    pub seconds: f64,
}

impl fmt::Display for Forecast {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { inputs, frames, wanted, done, output, missing, shared, largest } = self;
        let output = output.display();
        write!(f, "would convert {wanted} of {frames} frames of {inputs} to {output}")?;
        if *done > 0 {
            write!(f, "; {done} frames are already finished")?;
        }
        if missing.count() > 0 {
            write!(f, "\nmissing frames: {missing}")?;
        }
        write!(f, "\n{shared}")?;
        let Some(largest) = largest else { return Ok(()) };
        write!(
            f,
            "\nlargest frame {}: {} particles, {} triangles, memory: {} of the {} limit; {} frames \
             in parallel\ndisk: about {}\ntime: about {:.0} s",
            largest.frame,
            largest.particles,
            largest.triangles,
            ByteSize(largest.memory),
            ByteSize(largest.budget),
            largest.side_by_side,
            ByteSize(largest.disk),
            largest.seconds,
        )
    }
}

impl Setup<'_> {
    /// Estimates the resources that a conversion needs.
    pub(super) fn forecast(
        &self,
        known: Option<State>,
        store: &StateFolder,
        frames: &[FrameFile],
        wanted: &[&FrameFile],
    ) -> Result<Forecast, Error> {
        let start = Instant::now();
        let shared = match &known {
            Some(state) => state.shared.clone(),
            None => self.calibrate(frames, &self.checked.resources)?.0,
        };
        let meshes = self.existing_meshes(store);
        let format = self.format(&frames[0])?;
        let known = known.as_ref().filter(|_| self.simulation.resume);
        let fingerprint = known.map(|state| state.fingerprint(format));
        let done = |frame: &&&FrameFile| {
            let output = self.output(frame);
            let current = |fingerprint| meshes.current(frame, &output, fingerprint);
            fingerprint.and_then(current).is_some_and(|record| meshes.is_whole(record, &output))
        };
        let done = wanted.par_iter().filter(done).count();
        Ok(Forecast {
            inputs: self.sequence.describe(),
            frames: frames.len(),
            wanted: wanted.len() - done,
            done,
            output: self.shown_output(&frames[0]),
            missing: gaps(frames),
            largest: self.largest(&shared, wanted, done, start)?,
            shared,
        })
    }

    /// Makes the largest frame, to measure the memory and the time that frames need.
    fn largest(
        &self,
        shared: &SharedCalibration,
        wanted: &[&FrameFile],
        done: usize,
        start: Instant,
    ) -> Result<Option<LargestFrame>, Error> {
        let (checked, total) =
            (self.checked, wanted.iter().map(|frame| frame.bytes()).sum::<u64>());
        let largest =
            wanted.iter().max_by_key(|frame| frame.bytes()).filter(|f| !is_packed(&f.path));
        let Some(largest) = largest else { return Ok(None) };
        let path = &largest.path;
        let resources = &checked.resources;
        let unpacking = Unpacking {
            in_memory: resources.budget.0 / 8,
            scratch: &resources.scratch,
            control: Some(&resources.control),
        };
        let file = largest.open(checked.wanted(), unpacking)?;
        let carried = checked.settings.carried(&file.particles, Some(self.format(largest)?));
        let carried =
            carried.map_err(|error| error.of_file(path).with_skipped_part(&file.left_out))?;
        let (sampling, _) = self.sampling(shared, &file.particles, carried, resources.clone())?;
        let in_file = |fault| Error::from(fault).of_file(path);
        let mut timings = Timings::default();
        let counted =
            CountedFrame::for_surface(&file.particles, &sampling, &checked.surfacing, None)
                .map_err(in_file)?;
        let (census, estimate) = (counted.census(), counted.estimate());
        let frame =
            Engine::sample_counted(counted, resources.budget, &mut timings).map_err(in_file)?;
        let extracted =
            frame.calibrate(&checked.surfacing, shared.calibration.as_ref(), &mut timings);
        let mesh = extracted.and_then(|frame| frame.surface(&mut timings)).map_err(in_file)?;
        let bytes = mesh_bytes(mesh.vertex_count(), mesh.triangle_count());
        let largest_bytes = largest.bytes().max(1) as f64;
        let scale = (wanted.len() - done) as f64 * total as f64
            / wanted.len().max(1) as f64
            / largest_bytes;
        Ok(Some(LargestFrame {
            frame: largest.number,
            particles: census.binned,
            triangles: mesh.triangle_count(),
            memory: estimate.in_core(),
            budget: resources.budget.0,
            side_by_side: self.division(wanted.len()).lanes,
            disk: (bytes as f64 * scale) as u64,
            seconds: (timings.total() * scale).max(start.elapsed().as_secs_f64()).ceil(),
        }))
    }
}
