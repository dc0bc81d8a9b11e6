//! Calibrates all frames on the first suitable frame.

use super::frame_file::FrameFile;
use super::shared_calibration::{
    FrameMeasurements, SharedCalibration, Stamp, Trust, measure_in, measure_packed,
};
use super::state::{State, StateFolder};
use crate::error::{Cause, Error};
use crate::field::walls::Ends;
use crate::frame::{FrameError, Resources};
use crate::io::ParticleFile;
use crate::io::ReadError;
use crate::io::bytes::Unpacking;
use crate::io::mnf::{is_packed, open_frame};
use crate::particles::kind::{SettledKind, determine, settled_for_all};
use crate::particles::{AttributeInfo, Particles};
use crate::reconstruction::{self, FoundWalls, NoVelocity, Slab, SpacingWarning, WallSearch};

use super::event::Event;
use super::setup::{POLL, Setup};
use super::watch::Watch;

/// Maximum number of frames that are examined for the calibration. Half of them are the first
/// existing frames, and the other half are spread evenly over the later frames.
const MOST_EXAMINED: usize = 64;

/// Number of frames that are examined for walls, spread evenly from the first frame to the last.
const EXAMINED_FOR_WALLS: usize = 7;

/// Measurements on one frame.
struct MeasuredFrame {
    shared: SharedCalibration,
    trust: Trust,
    /// Warnings about the frame's spacing.
    warnings: Vec<SpacingWarning>,
    no_velocity: Option<NoVelocity>,
}

impl Setup<'_> {
    /// Measures the calibration that all frames share, and stores it. Also returns the particles of
    /// the calibration frame if its file is still open.
    pub(super) fn state(
        &self,
        store: &StateFolder,
        frames: &[FrameFile],
        resources: &Resources,
    ) -> Result<(State, Option<ParticleFile>), Error> {
        let (mut shared, file) = self.calibrate(frames, resources)?;
        self.settle_kinds(&mut shared, frames, resources)?;
        self.check_attributes(&shared, frames)?;
        let settings = self.settings_to_store(store.stale().as_ref());
        let measured = State::new(settings, shared, self.sequence.location());
        // If several jobs measure at the same time, all of them use the state that is stored first.
        let state = self.checked.resources.control.cancel.undisturbed(|| store.add(&measured))?;
        let file = file.filter(|_| state.shared.frame == measured.shared.frame);
        Ok((state, file))
    }

    /// Calibrates all frames on the first suitable frame, and returns its particles if its file is
    /// still open. If requested, also finds walls, in several frames.
    pub(super) fn calibrate(
        &self,
        frames: &[FrameFile],
        resources: &Resources,
    ) -> Result<(SharedCalibration, Option<ParticleFile>), Error> {
        let (frame, mut measured, file) = self.measure_calibration_frame(frames, resources)?;
        if self.checked.sampling.search == WallSearch::Walls && self.simulation.watch.is_none() {
            measured.shared.walls = self.common_walls(frames, &measured.shared, resources)?;
        }
        self.report_measured(&frame, &measured);
        Ok((measured.shared, file))
    }

    /// Returns the walls that a few frames, spread over the simulation, have in common. Frames that
    /// cannot be read are ignored here, and fail when they are converted.
    fn common_walls(
        &self,
        frames: &[FrameFile],
        shared: &SharedCalibration,
        resources: &Resources,
    ) -> Result<Option<FoundWalls>, Error> {
        let Some(spacing) = shared.spacing else { return Ok(None) };
        let (grid, flat) = (shared.grid()?, shared.slab.map(|slab| slab.axis));
        let numbers = (0..EXAMINED_FOR_WALLS as u128).map(|number| {
            let last = frames.len().saturating_sub(1) as u128;
            (number * last / (EXAMINED_FOR_WALLS as u128 - 1)) as usize
        });
        let mut numbers: Vec<usize> = numbers.collect();
        numbers.dedup();
        let mut ends = Vec::new();
        for frame in numbers.into_iter().filter_map(|number| frames.get(number)) {
            self.check_cancelled()?;
            let Ok(file) = self.open_particles(frame, resources) else { continue };
            let lengths = (spacing, shared.sizes.as_ref());
            ends.extend(Ends::of(&file.particles, None, lengths, flat, &grid));
        }
        self.check_cancelled()?;
        let path = frames.first().map(|frame| &*frame.path);
        Ok(Some(self.checked.sampling.walls_of(&ends, path)))
    }

    /// Examines frames until one is suitable for the calibration. Returns this frame or, if no
    /// frame is suitable, the best examined frame. Also returns the frame's measurements, and its
    /// particles if its file is still open.
    fn measure_calibration_frame(
        &self,
        frames: &[FrameFile],
        resources: &Resources,
    ) -> Result<(FrameFile, MeasuredFrame, Option<ParticleFile>), Error> {
        let idle = self.simulation.watch;
        let mut watch = idle.map(|idle| Watch::new(idle, self.simulation.selection));
        let mut best: Option<(FrameFile, MeasuredFrame)> = None;
        let mut first_error = None;
        let (mut examined, mut is_reported) = (0, false);
        let (first, rest) = frames.split_at(frames.len().min(MOST_EXAMINED / 2));
        let step = rest.len().div_ceil(MOST_EXAMINED / 2).max(1);
        let mut current: Vec<_> = first.iter().chain(rest.iter().step_by(step)).cloned().collect();
        loop {
            let ready = match &mut watch {
                None => std::mem::take(&mut current),
                Some(watch) => watch.ready(&current).into_iter().map(|ready| ready.frame).collect(),
            };
            for frame in ready {
                if examined == MOST_EXAMINED {
                    break;
                }
                examined += 1;
                self.check_cancelled()?;
                let lattice = best.as_ref().filter(|(_, known)| known.trust == Trust::Lattice);
                let lattice = lattice.map(|(_, known)| &known.shared);
                let measured = self.measure_on(&frame, lattice, resources);
                // If the file of this frame changes later, the frame is measured again.
                if let Some(watch) = &mut watch {
                    watch.done(frame.number);
                }
                match measured {
                    Ok((found, file)) if found.trust == Trust::Sound => {
                        return Ok((frame, found, file));
                    }
                    Ok((found, _)) => {
                        // Of two equally trusted frames, the frame with the smaller spacing is
                        // better. Particles of spray are farther apart than those of the bulk, so a
                        // spacing estimated from spray is too large.
                        let is_better = |(_, known): &(FrameFile, MeasuredFrame)| {
                            known.trust < found.trust
                                || known.trust == found.trust
                                    && known.shared.spacing > found.shared.spacing
                        };
                        if best.as_ref().is_none_or(is_better) {
                            best = Some((frame, found));
                        }
                    }
                    // Cells that are too fine for one frame, because of its mu0 or its lattice, may
                    // suit another frame.
                    Err(error)
                        if error.cause() == Cause::Input
                            || matches!(
                                error,
                                Error::Frame { fault: FrameError::TooFine(_), .. }
                            ) =>
                    {
                        first_error = first_error.or(Some(error));
                    }
                    Err(error) => return Err(error),
                }
            }
            match &mut watch {
                Some(watch) if examined < MOST_EXAMINED && !watch.is_over() => {
                    self.check_cancelled()?;
                    if examined > 0 && !is_reported {
                        let inputs = self.sequence.describe();
                        self.send(Event::Waiting { inputs, unsuitable: examined });
                        is_reported = true;
                    }
                    std::thread::sleep(POLL);
                    current = self.frames()?;
                }
                _ => break,
            }
        }
        match (best, first_error) {
            (Some((frame, found)), _) => Ok((frame, found, None)),
            (None, Some(error)) => Err(error),
            (None, None) => Err(self.sequence.no_frames().into()),
        }
    }

    /// Determines kinds of attributes from other frames if the calibration frame does not reveal
    /// them, for example because all its particles are black, or because a temperature is the
    /// integer 0 at first.
    fn settle_kinds(
        &self,
        shared: &mut SharedCalibration,
        frames: &[FrameFile],
        resources: &Resources,
    ) -> Result<(), Error> {
        // If the calibration frame lacks a requested attribute, `shared.kinds` is empty. In this
        // case, another frame determines the kinds of all attributes.
        let names = self.checked.settings.attribute_names();
        let names_attributes = names.is_some_and(|names| !names.is_empty());
        let lacks_some = |shared: &SharedCalibration| names_attributes && shared.kinds.is_empty();
        let last = frames.len().saturating_sub(1);
        for index in [last, last / 2, last / 4, last - last / 4] {
            let is_settled =
                !lacks_some(shared) && shared.kinds.iter().all(|known| known.is_evident);
            let Some(frame) = frames.get(index).filter(|_| !is_settled) else { break };
            self.check_cancelled()?;
            // Ignore a frame that cannot be read, because its conversion will report the error.
            let Ok(file) = self.open_particles(frame, resources) else { continue };
            if file.particles.is_empty() {
                continue;
            }
            let carried = self.checked.settings.carried(&file.particles, self.format(frame).ok());
            let found = settled_for_all(&file.particles, &carried.unwrap_or_default());
            if lacks_some(shared) {
                shared.kinds = found;
            } else {
                determine(&mut shared.kinds, found);
            }
        }
        Ok(())
    }

    /// Rejects named attributes that the format of the meshes cannot store in any frame.
    fn check_attributes(
        &self,
        shared: &SharedCalibration,
        frames: &[FrameFile],
    ) -> Result<(), Error> {
        let Some(first) = frames.first() else { return Ok(()) };
        let info = |known: &SettledKind| AttributeInfo { kind: known.kind, ..known.stored.clone() };
        let format = self.format(first)?;
        self.checked.settings.check_attributes(&self.simulation.output, format, || {
            Ok(shared.kinds.iter().map(info).collect())
        })
    }

    /// Opens the particles of a frame for a measurement.
    fn open_particles(
        &self,
        frame: &FrameFile,
        resources: &Resources,
    ) -> Result<ParticleFile, ReadError> {
        let unpacking = Unpacking {
            in_memory: resources.budget.0 / 8,
            scratch: &resources.scratch,
            control: Some(&resources.control),
        };
        frame.open(self.checked.wanted(), unpacking)
    }

    /// Reports the calibration and the frame on which it was measured, and warnings about the
    /// frame's spacing.
    fn report_measured(&self, frame: &FrameFile, found: &MeasuredFrame) {
        found
            .warnings
            .iter()
            .for_each(|warning| self.send(Event::SpacingWarning(Box::new(warning.clone()))));
        if let Some(found) = found.no_velocity.clone() {
            self.send(Event::NoVelocity { path: frame.path.clone(), found });
        }
        let shared = Box::new(found.shared.clone());
        self.send(Event::Measured { path: frame.path.clone(), shared, trust: found.trust });
    }

    /// Measures a frame, to calibrate all frames on it. `lattice` is the calibration of an earlier
    /// frame whose particles form a lattice. If `lattice` is given, its grid, mu0 and spacing are
    /// used for this frame.
    fn measure_on(
        &self,
        frame: &FrameFile,
        lattice: Option<&SharedCalibration>,
        resources: &Resources,
    ) -> Result<(MeasuredFrame, Option<ParticleFile>), Error> {
        let path = &frame.path;
        let input = frame.stamp()?;
        let in_file = |fault: FrameError| Error::from(fault).of_file(path);
        if is_packed(path) {
            self.checked.settings.check_packed(path)?;
            let packed = open_frame(path, resources.budget.0 / 4, Some(&resources.scratch))?;
            self.checked.settings.check_indicator_settings(packed.indicator().kind())?;
            let measured = measure_packed(&packed, &self.checked.surfacing);
            let measured = measured.map_err(|e| in_file(e.into()))?;
            let spacing = packed.facts().spacing;
            let shared = shared(frame.number, input, spacing, None, (None, None), measured);
            let (trust, warnings) = (measured.trust, Vec::new());
            return Ok((MeasuredFrame { shared, trust, warnings, no_velocity: None }, None));
        }
        let file = self.open_particles(frame, resources)?;
        let file = file.require_selected().map_err(|fault| ReadError::new(path, fault))?;
        let request = &self.checked.sampling;
        let source = reconstruction::SpacingHints { path: Some(path), spacing: file.spacing };
        let cells = request.cells(&file.particles, source)?;
        let method = request.method;
        let known = lattice.map(|first| {
            Ok::<_, Error>((first.grid()?, method.calibrated(first.calibration.as_ref())))
        });
        let measured = measure_in(
            &cells,
            known.transpose()?,
            &file.particles,
            self.checked,
            resources.clone(),
        );
        let measured = measured.map_err(|error| error.of_file(path))?;
        let source = cells.spacing.as_ref().map(|(_, source)| source.to_string());
        let tank = (cells.slab, cells.walls.clone());
        let mut shared = shared(frame.number, input, cells.spacing(), source, tank, measured);
        shared.sizes = cells.sizes.clone();
        // A frame that lacks a requested attribute fails when it is converted, not here.
        let (settings, format) = (&self.checked.settings, self.format(frame).ok());
        let carried = settings.carried(&file.particles, format).unwrap_or_default();
        shared.kinds = settled_for_all(&file.particles, &carried);
        if let Some(first) = lattice {
            (shared.spacing, shared.spacing_source) = (first.spacing, first.spacing_source.clone());
        }
        let no_velocity = settings.no_velocity(&file, format);
        let (trust, warnings) = (measured.trust, cells.warnings);
        Ok((MeasuredFrame { shared, trust, warnings, no_velocity }, Some(file)))
    }
}

fn shared(
    frame: i64,
    input: Stamp,
    spacing: Option<f64>,
    spacing_source: Option<String>,
    (slab, walls): (Option<Slab>, Option<FoundWalls>),
    FrameMeasurements { grid, calibration, .. }: FrameMeasurements,
) -> SharedCalibration {
    let (cell_size, origin) = (grid.cell_size(), grid.origin().to_array());
    SharedCalibration {
        frame,
        input,
        spacing,
        spacing_source,
        cell_size,
        origin,
        slab,
        walls,
        sizes: None,
        calibration,
        kinds: Vec::new(),
    }
}
