//! Prepares a conversion before any frame is read, and rejects requests that cannot work.

use std::collections::{BTreeSet, HashMap};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::error::{Error, SimulationError};
use crate::frame::{Method, Resources, Sampling};
use crate::io::alembic::frame_archive::{ArchivedFrames, FrameArchive};
use crate::io::frame_files::files_of;
use crate::io::input::file_and_step;
use crate::io::joined::check_distinct_files;
use crate::io::mnf::is_packed;
use crate::io::output::MeshFormat;
use crate::io::series::{Series, SeriesFrame};
use crate::io::stamp::Identity;
use crate::io::{WriteError, WriteFault};
use crate::particles::Particles;
use crate::reconstruction::{CheckedRequest, Warning};
use crate::settings::StoredSettings;
use crate::surface::simplify::BYTES_PER_THREAD;

use super::builder::Simulation;
use super::event::Event;
use super::event::EventSender;
use super::frame_file::FrameFile;
use super::inputs::Sequence;
use super::lanes::Division;
use super::pattern::Pattern;
use super::records::{Record, Records};
use super::shared_calibration::SharedCalibration;
use super::solids::SolidNames;
use super::state::{State, StateFolder, StateLookup, with_frame_rate};

/// Time between two checks of a running simulation for new frames.
pub(super) const POLL: Duration = Duration::from_millis(250);

/// The request for one simulation and the names of its files, before any frame is read.
pub(super) struct Setup<'a> {
    pub(super) simulation: &'a Simulation,
    pub(super) sequence: &'a Sequence,
    /// The names of the meshes.
    pub(super) outputs: Pattern,
    /// The archive to which meshes are moved, if the output is an archive.
    pub(super) archive: Option<FrameArchive>,
    pub(super) checked: &'a CheckedRequest,
    pub(super) events: &'a EventSender,
}

/// The existing meshes, in files or in an archive, with their records.
pub(super) struct ExistingMeshes {
    records: Records,
    archived: ArchivedFrames,
}

impl ExistingMeshes {
    /// Returns the existing meshes in `folder` that were made with the state that has this
    /// fingerprint. Leaves out frames whose numbers are in `known`.
    pub(super) fn of_other_frames(
        &self,
        known: &BTreeSet<i64>,
        folder: &Path,
        fingerprint: u32,
    ) -> impl Iterator<Item = &SeriesFrame> {
        let others = self.records.all().filter(move |record| record.fingerprint == fingerprint);
        let others = others.map(|record| (record, &record.mesh));
        let others = others.filter(|(_, mesh)| !known.contains(&mesh.frame));
        let exists = |(record, mesh): &(&Record, &SeriesFrame)| {
            record.is_at(&folder.join(&mesh.file)) || self.archived.holds(mesh)
        };
        others.filter(exists).map(|(_, mesh)| mesh)
    }

    /// Returns the existing files in `folder` with earlier meshes of frames for whose numbers
    /// `includes` returns true. Leaves out frames whose numbers are in `listed`.
    pub(super) fn stale(
        &self,
        listed: &BTreeSet<i64>,
        folder: &Path,
        includes: impl Fn(i64) -> bool,
    ) -> Vec<PathBuf> {
        let others = self.records.all().map(|record| &record.mesh);
        let others = others.filter(|mesh| !listed.contains(&mesh.frame) && includes(mesh.frame));
        let files = others.map(|mesh| folder.join(&mesh.file));
        files.filter(|file| file.is_file()).collect()
    }

    /// Returns the record of a frame if its mesh exists, and its input and the state are unchanged.
    pub(super) fn current(
        &self,
        frame: &FrameFile,
        output: &Path,
        fingerprint: u32,
    ) -> Option<&Record> {
        let record = self.records.of(frame, output, fingerprint)?;
        (record.is_at(output) || self.archived.holds(&record.mesh)).then_some(record)
    }

    /// Whether a mesh still has the recorded bytes. Reads the whole mesh.
    pub(super) fn is_whole(&self, record: &Record, output: &Path) -> bool {
        record.is_whole(output) || self.archived.crc(record.mesh.frame) == Some(record.crc)
    }
}

impl Setup<'_> {
    /// The existing meshes of the simulation.
    pub(super) fn existing_meshes(&self, store: &StateFolder) -> ExistingMeshes {
        let archived = self.archive.as_ref().map(FrameArchive::frames).unwrap_or_default();
        ExistingMeshes { records: Records::read(store.folder()), archived }
    }

    /// The file that contains a frame's mesh: a file of its own, or the archive.
    pub(super) fn shown_output(&self, frame: &FrameFile) -> PathBuf {
        match &self.archive {
            Some(archive) => archive.path().to_owned(),
            None => self.output(frame),
        }
    }

    /// Sends an event to the caller.
    pub(super) fn send(&self, event: Event) {
        self.events.send(event);
    }

    /// Returns an error if the work was cancelled.
    pub(super) fn check_cancelled(&self) -> Result<(), Error> {
        self.checked.check_cancelled()
    }

    /// All existing frames.
    pub(super) fn all_frames(&self) -> Result<Vec<FrameFile>, Error> {
        let solids = SolidNames::of(&self.checked.settings)?;
        Ok(solids.with_files(self.sequence.list()?))
    }

    /// The mesh file of a frame. The number in its name has the same digits as in the input's name,
    /// unless the output pattern has a width.
    pub(super) fn output(&self, frame: &FrameFile) -> PathBuf {
        self.outputs.path(frame.number, &frame.digits)
    }

    /// The existing selected frames.
    pub(super) fn frames(&self) -> Result<Vec<FrameFile>, Error> {
        Ok(self.simulation.selection.of(self.all_frames()?))
    }

    /// Returns the sampling of a frame with the shared calibration. Walls that particles of the
    /// frame have passed are moved or removed for this frame, and a warning is returned for each of
    /// them. The slab is used only if all particles of the frame lie in its plane. For example, the
    /// first layer of particles from an emitter lies in one plane, but two layers do not.
    pub(super) fn sampling(
        &self,
        shared: &SharedCalibration,
        particles: &dyn Particles,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<(Sampling, Vec<Warning>), Error> {
        let (request, grid) = (&self.checked.sampling, shared.grid()?);
        let walls = shared.walls.as_ref();
        let (request, crossed) = request.in_walls_around(walls, particles, shared.spacing, &grid);
        let method = request.method.calibrated(shared.calibration.as_ref());
        let slab = shared.slab.filter(|slab| slab.holds(particles));
        let request = request.in_slab(slab);
        let sampling = request.sampling_on(
            grid,
            method,
            (shared.spacing, shared.sizes.as_ref()),
            carried,
            resources,
        )?;
        let sampling =
            sampling.sized(shared.sizes.as_ref().filter(|_| !particles.is_empty()), particles)?;
        let sampling = Sampling { kinds: shared.kinds.clone(), ..sampling };
        Ok((sampling, crossed.into_iter().map(Warning::BeyondWall).collect()))
    }

    /// Divides the threads and the memory among `frames` frames.
    pub(super) fn division(&self, frames: usize) -> Division {
        let CheckedRequest { resources, reduction, threads, .. } = self.checked;
        let frames = if resources.backend.executor().divides() { frames } else { frames.min(2) };
        let chunk = reduction.tolerance.map_or(0, |_| BYTES_PER_THREAD);
        Division::of(frames, *threads, resources.budget, chunk)
    }

    /// Returns the first existing output of these frames: the archive, a mesh or a list.
    pub(super) fn existing(&self, frames: &[FrameFile], series: &Series) -> Option<PathBuf> {
        let archive = self.archive.iter().map(|archive| archive.path().to_owned());
        let meshes = frames.iter().map(|frame| self.output(frame));
        archive.chain(meshes).chain(series.files()).find(|path| path.exists())
    }

    /// Returns the format of the outputs. Fails if the format cannot store what the settings
    /// request.
    pub(super) fn format(&self, first: &FrameFile) -> Result<MeshFormat, Error> {
        let path = self.output(first);
        let unknown =
            || WriteError::new(&path, WriteFault::UnknownExtension { known: MeshFormat::KNOWN });
        let format = MeshFormat::of(&path).ok_or_else(unknown)?;
        self.checked.settings.check_format(&self.simulation.output, format)?;
        Ok(format)
    }

    /// Rejects an output that is also an input, even under another name, or that would become an
    /// input. Also rejects an input that occurs twice in one frame.
    pub(super) fn reject_outputs_among_inputs(
        &self,
        frames: &[FrameFile],
        series: &Series,
        store: &StateFolder,
    ) -> Result<(), Error> {
        let same_file = |path: &Path, other: &Path| Error::SameFile {
            path: path.to_owned(),
            other: other.to_owned(),
        };
        let inputs: HashMap<Identity, &Path> = frames
            .iter()
            .flat_map(FrameFile::paths)
            .flat_map(|path| {
                let listed =
                    if file_and_step(path).1.is_some() { files_of(path) } else { Vec::new() };
                let own = [file_and_step(path).0.to_owned()].into_iter().chain(listed);
                own.map(move |file| (Identity::of(&file), path))
            })
            .collect();
        for frame in frames {
            if !frame.others.is_empty() {
                check_distinct_files(frame.paths())?;
            }
            let output = self.output(frame);
            if let Some(input) = inputs.get(&Identity::of(&output)) {
                return Err(same_file(&output, input));
            }
            if self.sequence.would_include(&output) {
                return Err(Error::Request(format!(
                    "{}: this mesh would look like an input frame of {}; choose another name or \
                     folder for the meshes",
                    output.display(),
                    self.sequence.describe()
                )));
            }
        }
        for written in &self.simulation.also_written {
            let own = Identity::of(written);
            let outputs = frames.iter().map(|frame| self.output(frame));
            let archive = self.archive.iter().map(|archive| archive.path().to_owned());
            let others = outputs.chain(series.files()).chain([store.state_path()]).chain(archive);
            let taken = inputs.get(&own).map(|input| input.to_path_buf());
            if let Some(other) =
                taken.or_else(|| others.into_iter().find(|other| Identity::of(other) == own))
            {
                return Err(same_file(written, &other));
            }
        }
        Ok(())
    }

    /// The settings of the request as a state stores them. A request without a frame rate takes the
    /// rate of `known`, the state of earlier frames, unless the request replaces these frames.
    pub(super) fn settings_to_store(&self, known: Option<&State>) -> StoredSettings {
        let Simulation { fps, resume, overwrite, .. } = *self.simulation;
        let continues = resume || !overwrite;
        let recorded = || known.filter(|_| continues).and_then(State::fps);
        with_frame_rate(self.checked.settings.kept(), fps.or_else(recorded))
    }

    /// Looks for a state with these settings and these inputs. A state that differs is stale if
    /// outputs may be replaced, or if the conversion is resumed and only the calibration frame has
    /// changed. Otherwise, a difference is an error. A state is also stale if this process alone
    /// makes all frames again, because another frame may be better for the calibration by now.
    pub(super) fn find_state(
        &self,
        store: &StateFolder,
        frames: &[FrameFile],
    ) -> Result<StateLookup, Error> {
        let Some(text) = store.text()? else { return Ok(StateLookup::Nothing) };
        let overwrite = self.simulation.overwrite;
        let state = match store.parsed(&text) {
            Err(_) if overwrite => {
                return Ok(StateLookup::Stale { text, has_other_settings_or_damage: true });
            }
            found => found?,
        };
        if !overwrite {
            self.refuse_other_inputs(store, &state, frames)?;
        }
        let mut differing = state.differing(&self.settings_to_store(Some(&state)));
        let has_other_settings = !differing.is_empty();
        if state.shared.changed_in(frames).is_some() {
            let comma = if differing.is_empty() { "" } else { ", " };
            let _ = write!(differing, "{comma}the input of frame {}", state.shared.frame);
        }
        let is_alone = self.simulation.makes_all_again() && !store.log.others_are_open();
        if differing.is_empty() && is_alone {
            return Ok(StateLookup::Stale { text, has_other_settings_or_damage: false });
        }
        if differing.is_empty() {
            if self.is_calibrated(&state, frames) {
                return Ok(StateLookup::Kept(Box::new(state), text));
            }
            let what = "the calibration is missing, incomplete, or for another indicator".into();
            let damaged = SimulationError::State { path: store.state_path(), what };
            return if overwrite {
                Ok(StateLookup::Stale { text, has_other_settings_or_damage: true })
            } else {
                Err(damaged.into())
            };
        }
        if overwrite || self.simulation.resume && !has_other_settings {
            self.send(Event::Restarted { state: store.state_path(), differing });
            return Ok(StateLookup::Stale {
                text,
                has_other_settings_or_damage: has_other_settings,
            });
        }
        Err(SimulationError::Settings { path: store.state_path(), differing }.into())
    }

    /// Rejects inputs in another folder or file than the inputs of the existing meshes, unless the
    /// inputs of all frames that have a mesh are unchanged. In this case, the inputs may have been
    /// moved.
    fn refuse_other_inputs(
        &self,
        store: &StateFolder,
        state: &State,
        frames: &[FrameFile],
    ) -> Result<(), Error> {
        let (Some(recorded), Some(inputs)) = (state.inputs.clone(), self.sequence.location())
        else {
            return Ok(());
        };
        if recorded == inputs {
            return Ok(());
        }
        let records = Records::read(store.folder());
        let differs = |frame: &&FrameFile| {
            records.has_other_input(frame, &self.output(frame)) && self.shown_output(frame).exists()
        };
        match frames.iter().find(differs) {
            None => Ok(()),
            Some(&FrameFile { number: frame, .. }) => {
                let path = store.state_path();
                Err(SimulationError::OtherInputs { path, recorded, inputs, frame }.into())
            }
        }
    }

    /// Whether a state has a complete calibration. Packed frames do not need one, because they
    /// store their own mu0.
    fn is_calibrated(&self, state: &State, frames: &[FrameFile]) -> bool {
        let Method::Indicator { kind, .. } = self.checked.sampling.method else { return true };
        let Some(known) = &state.shared.calibration else { return false };
        let is_known = known.suits(kind) && (known.mean().is_some() || !kind.counts());
        is_known || frames.iter().all(|frame| is_packed(&frame.path))
    }
}
