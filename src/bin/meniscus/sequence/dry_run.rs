//! What a conversion would do and take, without doing it.

use std::fmt::Write;
use std::time::Instant;

use bytesize::ByteSize;
use meniscus::error::Error;
use meniscus::frame::{Counted, Frame};
use meniscus::io::input::open_particles;
use meniscus::simulation::frozen::Stamp;
use meniscus::simulation::inputs::{FrameFile, gaps};
use meniscus::simulation::records::Records;
use meniscus::simulation::state::{State, Store};
use meniscus::surface::mesh::source::MeshSource;
use meniscus::system::timings::Timings;
use rayon::prelude::*;

use crate::outcome::Verdict;
use crate::run::unpacking;
use meniscus::io::mnf::is_packed;

use super::freeze::describe;
use super::setup::Setup;

impl Setup<'_> {
    pub(super) fn dry_run(
        &self,
        kept: Option<State>,
        store: &Store,
        frames: &[FrameFile],
        wanted: &[&FrameFile],
    ) -> Result<Verdict, Error> {
        let begun = Instant::now();
        let frozen = match &kept {
            Some(state) => state.frozen.clone(),
            None => self.freeze(frames, &self.resources, &self.notes)?.0,
        };
        let records = Records::read(store.folder());
        let fingerprint =
            kept.as_ref().filter(|_| self.options.sequence.resume).map(|state| state.fingerprint());
        let done = |frame: &&&FrameFile| {
            let output = self.naming.path(frame);
            let current = |fingerprint| records.current(frame.number, &frame.path, &output, fingerprint);
            fingerprint.and_then(current).is_some_and(|record| record.is_whole(&output))
        };
        let skipped = wanted.par_iter().filter(done).count();
        let mut text = format!(
            "would convert {} of {} frames of {} to {}",
            wanted.len() - skipped,
            frames.len(),
            self.inputs.describe(),
            self.naming.path(&frames[0]).display(),
        );
        if skipped > 0 {
            let _ = write!(text, "; {skipped} are done");
        }
        let missing = gaps(frames);
        if missing.count() > 0 {
            let _ = write!(text, "\nmissing: {missing}");
        }
        let _ = write!(text, "\n{}", describe(&frozen));
        // The largest file tells what the budget has to hold, and about what each frame takes.
        let size = |frame: &FrameFile| Stamp::of(&frame.path).map_or(0, |stamp| stamp.bytes);
        let total: u64 = wanted.iter().map(|frame| size(frame)).sum();
        if let Some(largest) = wanted.iter().max_by_key(|frame| size(frame)).filter(|f| !is_packed(&f.path)) {
            let file = open_particles(&largest.path, unpacking(&self.resources))?;
            let carried = self.options.carried(&largest.path, &file, self.format(largest)?)?;
            let sampling = self.sampling(&frozen, carried, self.resources.clone())?;
            let in_file = |fault| Error::Frame { path: Some(largest.path.clone()), fault };
            let mut timings = Timings::default();
            let counted =
                Counted::for_surface(&file.particles, &sampling, &self.surfacing).map_err(in_file)?;
            let (census, estimate) = (counted.census(), counted.estimate());
            let frame =
                Frame::sample_counted(counted, self.resources.budget, &mut timings).map_err(in_file)?;
            let drawn = frame.calibrate(&self.surfacing, frozen.calibration.as_ref(), &mut timings);
            let mesh = drawn.and_then(|frame| frame.surface(&mut timings)).map_err(in_file)?;
            let division = self.division(wanted.len());
            // 12 bytes a vertex and 13 a triangle, as .ply has it; attributes come on top, and simplifying takes away.
            let bytes = 24 * mesh.vertex_count() + 13 * mesh.triangle_count();
            let share = size(largest).max(1) as f64;
            let scale = (wanted.len() - skipped) as f64 * total as f64 / wanted.len().max(1) as f64 / share;
            let _ = write!(
                text,
                "\nlargest frame {}: {} particles, {} triangles, {} in memory of {}; {} side by side\n\
                 disk: about {}\ntime: about {:.0} s",
                largest.number,
                census.binned,
                mesh.triangle_count(),
                ByteSize(estimate.in_core()),
                ByteSize(self.resources.budget.0),
                division.lanes,
                ByteSize((bytes as f64 * scale) as u64),
                (timings.total() * scale).max(begun.elapsed().as_secs_f64()).ceil(),
            );
        }
        crate::outcome::print(&text)?;
        Ok(Verdict::Good)
    }
}
