//! What is measured once for all frames, on the first that can tell.

use meniscus::error::{Cause, Error};
use meniscus::frame::{Frame, FrameError, Resources};
use meniscus::grid::Grid;
use meniscus::io::input::open_particles;
use meniscus::io::mnf::open_frame;
use meniscus::io::{ParticleFile, ReadError};
use meniscus::plateau::Plateau;
use meniscus::rivals::Spacing;
use meniscus::sequence::SequenceError;
use meniscus::sequence::frozen::{Frozen, Measured, Origin, Stamp, Trust, measure};
use meniscus::sequence::inputs::FrameFile;

use crate::reconstruct::is_frame;
use crate::run::{Notes, unpacking};

use super::watch::Watch;
use super::{POLL, Setup};

/// Frames that are looked at for one that is deep enough to measure.
const LOOKED_AT: usize = 64;

impl Setup<'_> {
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
        let mut current = frames.to_vec();
        loop {
            let ready = match &mut watch {
                None => std::mem::take(&mut current),
                Some(watch) => watch.ready(&current),
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
                        if best.as_ref().is_none_or(|(_, known)| *known < trust) {
                            best = Some((frozen, trust));
                        }
                    }
                    // What is too fine for one frame, by its mu0 or where its lattice lies, need not be for another.
                    Err(error)
                        if error.cause() == Cause::Input
                            || matches!(error, Error::Frame { fault: FrameError::TooFine(_), .. }) =>
                    {
                        if let Some(watch) = &mut watch {
                            watch.failed(frame.number);
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
        let in_file = |fault: FrameError| Error::Frame { path: path.clone(), fault };
        if is_frame(path) {
            self.options.validate_frame_input(path)?;
            let (facts, dif) = open_frame(path, resources.budget.0 / 4)?;
            let (grid, spacing) = (facts.grid, facts.spacing);
            let frame_of_file = Frame::from_parts(facts, dif, &self.surfacing, resources.clone());
            let (recipe, plateau) = frame_of_file.recipe(&self.surfacing).map_err(|e| in_file(e.into()))?;
            let trust = match plateau {
                Plateau::Interior { .. } => Trust::Sound,
                Plateau::Shallow { .. } => Trust::Shallow,
            };
            let mean = frame_of_file.mean_count();
            let measured = Measured { grid, mean, iso: recipe.iso, trust };
            return Ok((frozen(frame.number, input, spacing, None, measured), trust, None));
        }
        let file = open_particles(path, unpacking(resources))?;
        let cells = self.request.cells(path, &file)?;
        if let Some(spacing) = cells.spacing.filter(|_| self.request.rival().is_some()) {
            Spacing::new(spacing / cells.size).map_err(|e| in_file(e.into()))?;
            let grid = self.request.grid(cells.size)?;
            let frozen = for_kernels(frame.number, input, cells.spacing, cells.source, grid);
            return Ok((frozen, Trust::Sound, Some(file)));
        }
        let (grid, indicator) = match lattice {
            Some((frozen, _)) => (frozen.grid()?, frozen.indicator(self.request.indicator())?),
            None => (self.request.grid(cells.size)?, self.request.indicator()),
        };
        let sampling =
            self.request.sampling_on(grid, indicator, cells.spacing, Vec::new(), resources.clone())?;
        let settled = lattice.is_some() || self.options.sampling.origin_given();
        let origin = if settled { Origin::Given } else { Origin::Free };
        let measured = measure(&file.particles, &sampling, origin, &self.surfacing).map_err(in_file)?;
        let mut frozen = frozen(frame.number, input, cells.spacing, cells.source, measured);
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
    source: Option<String>,
    measured: Measured,
) -> Frozen {
    Frozen {
        mu0: measured.mean.map(|mean| mean.particles()),
        isovalue: Some(measured.iso.value()),
        ..for_kernels(frame, input, spacing, source, measured.grid)
    }
}

/// Kernels have neither mu0 nor an isovalue that is measured.
fn for_kernels(frame: u64, input: Stamp, spacing: Option<f64>, source: Option<String>, grid: Grid) -> Frozen {
    let (cell_size, origin) = (grid.cell_size(), grid.origin().to_array());
    Frozen { frame, input, spacing, spacing_source: source, cell_size, origin, mu0: None, isovalue: None }
}

pub fn describe(frozen: &Frozen) -> String {
    let Frozen { spacing, spacing_source, cell_size, origin: [x, y, z], mu0, isovalue, .. } = frozen;
    let spacing = match (spacing, spacing_source) {
        (Some(spacing), Some(source)) => format!("spacing {spacing:.6} ({source}), "),
        _ => String::new(),
    };
    let mu0 = mu0.map_or(String::new(), |mu0| format!(", mu0 {mu0:.4}"));
    let isovalue = isovalue.map_or(String::new(), |isovalue| format!(", isovalue {isovalue:.4}"));
    let origin =
        if [*x, *y, *z] == [0.0; 3] { String::new() } else { format!(", origin {x:.6},{y:.6},{z:.6}") };
    format!("{spacing}cell size {cell_size:.6}{origin}{mu0}{isovalue}")
}
