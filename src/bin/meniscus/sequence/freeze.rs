//! What is measured once for all frames, on the first that can tell.

use meniscus::error::SequenceError;
use meniscus::error::{Cause, Error};
use meniscus::field::calibration::{Calibration, Plateau};
use meniscus::frame::{FrameError, Resources};
use meniscus::grid::units::shown;
use meniscus::io::input::open_particles;
use meniscus::io::mnf::open_frame;
use meniscus::io::{ParticleFile, ReadError};
use meniscus::simulation::frozen::{Frozen, Measured, Origin, Stamp, Trust, measure, measure_sampled};
use meniscus::simulation::inputs::FrameFile;
use meniscus::simulation::state::{State, Store};

use crate::interrupt;
use crate::run::{Notes, unpacking};
use crate::sampling::{origin, say_doubt};
use meniscus::io::mnf::is_packed;

use super::setup::{POLL, Setup};
use super::watch::Watch;

/// Frames that are looked at for one that is deep enough to measure: of those that are there the first, and some from all over the rest.
const LOOKED_AT: usize = 64;

impl Setup<'_> {
    /// Measures what all frames have in common, and keeps it; the frame that it was measured on may still be open.
    pub fn state(
        &self,
        store: &Store,
        frames: &[FrameFile],
        resources: &Resources,
        notes: &Notes,
    ) -> Result<(State, Option<ParticleFile>), Error> {
        let (frozen, file) = self.freeze(frames, resources, notes)?;
        let state = State::new(self.options.settings(), frozen);
        interrupt::undisturbed(|| store.save(&state))?;
        Ok((state, file))
    }

    /// Measures what holds for all frames on the first that can tell, whose particles may still be open.
    pub(super) fn freeze(
        &self,
        frames: &[FrameFile],
        resources: &Resources,
        notes: &Notes,
    ) -> Result<(Frozen, Option<ParticleFile>), Error> {
        let idle = self.options.sequence.watch;
        let mut watch = idle.map(|idle| Watch::new(idle, self.options.sequence.selection()));
        let mut best: Option<(Frozen, Trust)> = None;
        let mut first_error = None;
        let mut looked_at = 0;
        let (first, rest) = frames.split_at(frames.len().min(LOOKED_AT / 2));
        let step = rest.len().div_ceil(LOOKED_AT / 2).max(1);
        let mut current: Vec<_> = first.iter().chain(rest.iter().step_by(step)).cloned().collect();
        loop {
            let ready = match &mut watch {
                None => std::mem::take(&mut current),
                Some(watch) => watch.ready(&current).into_iter().map(|ready| ready.frame).collect(),
            };
            for frame in ready {
                if looked_at == LOOKED_AT {
                    break;
                }
                looked_at += 1;
                let lattice = best.as_ref().filter(|(_, trust)| *trust == Trust::Lattice);
                match self.measure_on(&frame, lattice, resources) {
                    Ok((frozen, Trust::Sound, file)) => {
                        let path = frame.path.display();
                        notes.say(format!("measured on {path}: {}", describe(&frozen)));
                        return Ok((frozen, file));
                    }
                    Ok((frozen, trust, _)) => {
                        // Spray is farther apart than fluid, whose spacing would be estimated too large by it.
                        let is_better = |(known, by): &(Frozen, Trust)| {
                            *by < trust || *by == trust && known.spacing > frozen.spacing
                        };
                        if best.as_ref().is_none_or(is_better) {
                            best = Some((frozen, trust));
                        }
                    }
                    // What is too fine for one frame, by its mu0 or where its lattice lies, need not be for another.
                    Err(error)
                        if error.cause() == Cause::Input
                            || matches!(error, Error::Frame { fault: FrameError::TooFine(_), .. }) =>
                    {
                        if let Some(watch) = &mut watch {
                            watch.done(frame.number);
                        }
                        first_error = first_error.or(Some(error));
                    }
                    Err(error) => return Err(error),
                }
            }
            match &mut watch {
                Some(watch) if looked_at < LOOKED_AT && !watch.is_over() => {
                    std::thread::sleep(POLL);
                    current = self.frames()?;
                }
                _ => break,
            }
        }
        match (best, first_error) {
            (Some((frozen, trust)), _) => {
                let what = match trust {
                    Trust::Shallow => "next to no fluid is deeper than the filters reach",
                    Trust::Lattice | Trust::Sound => "all particles stand on a lattice",
                };
                notes.say(format!(
                    "warning: {what}; measured on frame {}: {}",
                    frozen.frame,
                    describe(&frozen)
                ));
                Ok((frozen, None))
            }
            (None, Some(error)) => Err(error),
            (None, None) => Err(SequenceError::NoFrames(self.inputs.describe()).into()),
        }
    }

    /// What one frame says of all. The grid and mu0 are those of a lattice that came before, if one did.
    fn measure_on(
        &self,
        frame: &FrameFile,
        lattice: Option<&(Frozen, Trust)>,
        resources: &Resources,
    ) -> Result<(Frozen, Trust, Option<ParticleFile>), Error> {
        let path = &frame.path;
        let input = Stamp::of(path).map_err(|e| ReadError::new(path, e.into()))?;
        let in_file = |fault: FrameError| Error::Frame { path: Some(path.clone()), fault };
        if is_packed(path) {
            self.options.validate_frame_input(path)?;
            let sampled = open_frame(path, resources.budget.0 / 4)?;
            self.options.refuse_of_others(sampled.indicator.kind())?;
            let measured = measure_sampled(&sampled, &self.surfacing, false);
            let measured = measured.map_err(|e| in_file(e.into()))?;
            let frozen = frozen(frame.number, input, sampled.facts.spacing, None, measured);
            return Ok((frozen, measured.trust, None));
        }
        let file = open_particles(path, unpacking(resources))?;
        let cells = self.request.cells(&file.particles, origin(path, &file))?;
        say_doubt(&cells, &self.notes);
        let (grid, field) = match lattice {
            Some((frozen, _)) => (frozen.grid()?, frozen.field(self.request.field)),
            None => (self.request.grid(cells.size)?, self.request.field),
        };
        let sampling =
            self.request.sampling_on(grid, field, cells.spacing(), Vec::new(), resources.clone())?;
        let settled = lattice.is_some() || self.options.sampling.origin_given();
        let stays = if settled { Origin::Given } else { Origin::Free };
        let measured = measure(&file.particles, &sampling, stays, &self.surfacing).map_err(in_file)?;
        let source = cells.spacing.as_ref().map(|(_, source)| source.to_string());
        let mut frozen = frozen(frame.number, input, cells.spacing(), source, measured);
        if let Some((first, _)) = lattice {
            (frozen.spacing, frozen.spacing_source) = (first.spacing, first.spacing_source.clone());
        }
        Ok((frozen, measured.trust, Some(file)))
    }
}

fn frozen(
    frame: u64,
    input: Stamp,
    spacing: Option<f64>,
    spacing_source: Option<String>,
    Measured { grid, calibration, .. }: Measured,
) -> Frozen {
    let (cell_size, origin) = (grid.cell_size(), grid.origin().to_array());
    Frozen { frame, input, spacing, spacing_source, cell_size, origin, calibration }
}

pub fn describe(frozen: &Frozen) -> String {
    let Frozen { spacing, spacing_source, cell_size, origin: [x, y, z], calibration, .. } = frozen;
    let spacing_cells = spacing.map_or(1.0, |spacing| spacing / cell_size);
    let spacing = match (spacing, spacing_source) {
        (Some(spacing), Some(source)) => format!("spacing {} ({source}), ", shown(spacing.to_owned())),
        _ => String::new(),
    };
    let mean = calibration.and_then(|known| known.mean());
    let mu0 = mean.map_or(String::new(), |mean| format!(", mu0 {:.4}", mean.particles()));
    let isovalue = match calibration {
        Some(Calibration::Indicator { iso, .. }) => format!(", isovalue {:.4}", iso.value()),
        Some(Calibration::Clouds { plateau }) => {
            let nominal = Plateau::nominal(spacing_cells);
            format!(", {:.4} particles in a cubed spacing", f64::from(*plateau) / nominal)
        }
        None => String::new(),
    };
    let origin = if [*x, *y, *z] == [0.0; 3] {
        String::new()
    } else {
        format!(", origin {}", [*x, *y, *z].map(shown).join(","))
    };
    format!("{spacing}cell size {}{origin}{mu0}{isovalue}", shown(*cell_size))
}
