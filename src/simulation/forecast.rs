//! Forecast of a conversion, found out on its largest frame.

use std::fmt;
use std::path::PathBuf;
use std::time::Instant;

use bytesize::ByteSize;
use rayon::prelude::*;

use crate::error::Error;
use crate::frame::{Counted, Engine};
use crate::io::bytes::Unpacking;
use crate::io::mnf::is_packed;
use crate::particles::Particles;
use crate::reconstruction::mesh_bytes;
use crate::surface::mesh::source::MeshSource;
use crate::system::timings::Timings;

use super::frame_file::FrameFile;
use super::frozen::Frozen;
use super::gaps::{Gaps, gaps};
use super::records::Records;
use super::setup::Setup;
use super::state::{State, Store};

/// A forecast of a conversion, which prints as some lines for people.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Forecast {
    /// The inputs, as they were asked for.
    pub inputs: String,
    /// Frames that there are.
    pub frames: usize,
    /// Frames that would be made.
    pub wanted: usize,
    /// Frames that are done already.
    pub done: usize,
    /// The mesh of the first frame.
    pub output: PathBuf,
    /// Numbers that are missing between others.
    pub missing: Gaps,
    /// The measurements that all frames would share.
    pub frozen: Frozen,
    /// The forecast of the largest frame; `None` where frames are packed.
    pub largest: Option<Largest>,
}

/// The largest frame of a conversion, and what it says of all.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Largest {
    /// The frame's number.
    pub frame: i64,
    /// Particles of it.
    pub particles: usize,
    /// Triangles of its mesh, before simplifying.
    pub triangles: u64,
    /// Bytes that it takes in memory.
    pub memory: u64,
    /// Bytes that may be used.
    pub budget: u64,
    /// Frames that would be made side by side.
    pub side_by_side: usize,
    /// Bytes that all meshes would take on disk, about.
    pub disk: u64,
    /// How long all frames would take in seconds, about.
    pub seconds: f64,
}

impl fmt::Display for Forecast {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { inputs, frames, wanted, done, output, missing, frozen, largest } = self;
        let output = output.display();
        write!(f, "would convert {wanted} of {frames} frames of {inputs} to {output}")?;
        if *done > 0 {
            write!(f, "; {done} are finished")?;
        }
        if missing.count() > 0 {
            write!(f, "\nmissing: {missing}")?;
        }
        write!(f, "\n{frozen}")?;
        let Some(largest) = largest else { return Ok(()) };
        write!(
            f,
            "\nlargest frame {}: {} particles, {} triangles, memory: {} of {}; {} frames in \
             parallel\ndisk: about {}\ntime: about {:.0} s",
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
    /// Finds out what a conversion would do and take.
    pub(super) fn forecast(
        &self,
        kept: Option<State>,
        store: &Store,
        frames: &[FrameFile],
        wanted: &[&FrameFile],
    ) -> Result<Forecast, Error> {
        let begun = Instant::now();
        let frozen = match &kept {
            Some(state) => state.frozen.clone(),
            None => self.freeze(frames, &self.checked.resources)?.0,
        };
        let records = Records::read(store.folder());
        let fingerprint = kept.as_ref().filter(|_| self.simulation.resume).map(State::fingerprint);
        let done = |frame: &&&FrameFile| {
            let output = self.output(frame);
            let current = |fingerprint| records.current(frame, &output, fingerprint);
            fingerprint.and_then(current).is_some_and(|record| record.is_whole(&output))
        };
        let done = wanted.par_iter().filter(done).count();
        Ok(Forecast {
            inputs: self.sequence.describe(),
            frames: frames.len(),
            wanted: wanted.len() - done,
            done,
            output: self.output(&frames[0]),
            missing: gaps(frames),
            largest: self.largest(&frozen, wanted, done, begun)?,
            frozen,
        })
    }

    /// Makes the largest frame: what the budget has to hold, and about what each frame takes.
    fn largest(
        &self,
        frozen: &Frozen,
        wanted: &[&FrameFile],
        done: usize,
        begun: Instant,
    ) -> Result<Option<Largest>, Error> {
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
        let carried =
            checked.settings.carried(file.particles.attributes(), Some(self.format(largest)?));
        let carried = carried.map_err(|error| error.of_file(path))?;
        let (sampling, _) = self.sampling(frozen, &file.particles, carried, resources.clone())?;
        let in_file = |fault| Error::from(fault).of_file(path);
        let mut timings = Timings::default();
        let counted = Counted::for_surface(&file.particles, &sampling, &checked.surfacing, None)
            .map_err(in_file)?;
        let (census, estimate) = (counted.census(), counted.estimate());
        let frame =
            Engine::sample_counted(counted, resources.budget, &mut timings).map_err(in_file)?;
        let drawn = frame.calibrate(&checked.surfacing, frozen.calibration.as_ref(), &mut timings);
        let mesh = drawn.and_then(|frame| frame.surface(&mut timings)).map_err(in_file)?;
        let bytes = mesh_bytes(mesh.vertex_count(), mesh.triangle_count());
        let share = largest.bytes().max(1) as f64;
        let scale =
            (wanted.len() - done) as f64 * total as f64 / wanted.len().max(1) as f64 / share;
        Ok(Some(Largest {
            frame: largest.number,
            particles: census.binned,
            triangles: mesh.triangle_count(),
            memory: estimate.in_core(),
            budget: resources.budget.0,
            side_by_side: self.division(wanted.len()).lanes,
            disk: (bytes as f64 * scale) as u64,
            seconds: (timings.total() * scale).max(begun.elapsed().as_secs_f64()).ceil(),
        }))
    }
}
