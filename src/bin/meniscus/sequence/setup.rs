//! What is known before any frame of a simulation is read, and what is refused by it.

use std::collections::HashMap;
use std::fmt::Write;
use std::path::Path;
use std::sync::OnceLock;
use std::time::Duration;

use meniscus::error::Error;
use meniscus::error::SequenceError;
use meniscus::field::calibration::Calibration;
use meniscus::field::indicator::IndicatorKind;
use meniscus::frame::{Resources, Sampling, Surfacing};
use meniscus::io::input::file_and_step;
use meniscus::io::output::MeshFormat;
use meniscus::io::series::Series;
use meniscus::io::{WriteError, WriteFault};
use meniscus::reconstruction::SamplingRequest;
use meniscus::simulation::frozen::{Frozen, Stamp};
use meniscus::simulation::inputs::{FrameFile, Inputs};
use meniscus::simulation::naming::Naming;
use meniscus::simulation::state::{State, Store};
use meniscus::surface::simplify::{BYTES_A_THREAD, Reduction};

use crate::identity::{Identity, two_purposes};
use crate::lanes::Division;
use crate::options::Options;
use crate::run::Notes;
use meniscus::io::mnf::is_packed;

/// Between two looks at a simulation that runs.
pub const POLL: Duration = Duration::from_millis(250);

/// What is known before any frame is read.
pub struct Setup<'a> {
    pub options: &'a Options,
    pub inputs: &'a Inputs,
    pub naming: &'a Naming,
    pub request: SamplingRequest,
    pub surfacing: Surfacing,
    pub reduction: Reduction,
    pub resources: Resources,
    pub notes: Notes,
    /// The inputs as they are from the first frame on: what else comes is none.
    pub begun: OnceLock<Inputs>,
}

impl Setup<'_> {
    /// All frames that are there now.
    pub fn all_frames(&self) -> Result<Vec<FrameFile>, Error> {
        let frames = self.begun.get().unwrap_or(self.inputs).list()?;
        if let Some(first) = frames.first() {
            self.begun.get_or_init(|| self.inputs.like(first));
        }
        Ok(frames)
    }

    /// The frames of the sequence that are there now.
    pub fn frames(&self) -> Result<Vec<FrameFile>, Error> {
        Ok(self.options.sequence.selection().of(self.all_frames()?))
    }

    /// How a frame is sampled by what all have in common.
    pub fn sampling(
        &self,
        frozen: &Frozen,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<Sampling, Error> {
        let field = frozen.field(self.request.field);
        self.request.sampling_on(frozen.grid()?, field, frozen.spacing, carried, resources)
    }

    /// How the machine is divided among so many frames.
    pub fn division(&self, frames: usize) -> Division {
        let frames = if self.resources.backend.divides() { frames } else { frames.min(2) };
        let chunk = self.reduction.tolerance.map_or(0, |_| BYTES_A_THREAD);
        Division::of(frames, rayon::current_num_threads(), self.resources.budget, chunk)
    }

    /// What the outputs' names say, able to hold what is asked for.
    pub fn format(&self, first: &FrameFile) -> Result<MeshFormat, Error> {
        let path = self.naming.path(first);
        let unknown = || WriteError::new(&path, WriteFault::UnknownExtension { known: MeshFormat::KNOWN });
        let format = MeshFormat::of(&path).ok_or_else(unknown)?;
        self.options.validate_format(format)?;
        Ok(format)
    }

    /// Refuses outputs that are inputs, by whatever name, or would be taken for some.
    pub fn refuse_own_inputs(
        &self,
        frames: &[FrameFile],
        series: &Series,
        store: &Store,
    ) -> Result<(), Error> {
        let inputs: HashMap<Identity, &Path> =
            frames.iter().map(|frame| (Identity::of(file_and_step(&frame.path).0), &*frame.path)).collect();
        let begun = self.begun.get().unwrap_or(self.inputs);
        for frame in frames {
            let output = self.naming.path(frame);
            if let Some(input) = inputs.get(&Identity::of(&output)) {
                return Err(two_purposes(&output, input));
            }
            if begun.takes(&output) {
                return Err(Error::Request(format!(
                    "{}: would be taken for a frame of {}; name the meshes otherwise, or write them into another folder",
                    output.display(),
                    self.inputs.describe()
                )));
            }
        }
        let Some(stats) = &self.options.stats else { return Ok(()) };
        let own = Identity::of(stats);
        let outputs = frames.iter().map(|frame| self.naming.path(frame));
        let others = outputs.chain(series.files()).chain([store.state_path()]);
        let taken = inputs.get(&own).map(|input| input.to_path_buf());
        match taken.or_else(|| others.into_iter().find(|other| Identity::of(other) == own)) {
            None => Ok(()),
            Some(other) => Err(two_purposes(stats, &other)),
        }
    }

    /// The state that is there, if it is of these settings and of these inputs.
    pub fn kept_state(&self, store: &Store, frames: &[FrameFile]) -> Result<Option<State>, Error> {
        let anew = self.options.run.overwrite;
        let state = match store.load() {
            Err(_) if anew => return Ok(None),
            found => found?,
        };
        let Some(state) = state else { return Ok(None) };
        let mut differing = state.differing(&self.options.settings());
        let measured_on = frames.iter().find(|frame| frame.number == state.frozen.frame);
        if measured_on.and_then(|frame| Stamp::of(&frame.path).ok()).is_some_and(|s| s != state.frozen.input)
        {
            let comma = if differing.is_empty() { "" } else { ", " };
            let _ = write!(differing, "{comma}input frame {}", state.frozen.frame);
        }
        if differing.is_empty() {
            if self.is_calibrated(&state, frames) {
                return Ok(Some(state));
            }
            let what = "what was measured is missing, or of another surface".into();
            let damaged = SequenceError::State { path: store.state_path(), what };
            return if anew { Ok(None) } else { Err(damaged.into()) };
        }
        if anew || self.options.sequence.resume {
            self.notes
                .say(format!("{}: of other settings ({differing}), made anew", store.state_path().display()));
            return Ok(None);
        }
        Err(SequenceError::Settings { path: store.state_path(), differing }.into())
    }

    /// Whether a state has all that frames are sampled and drawn by. Packed frames have a mu0 of their own.
    pub fn is_calibrated(&self, state: &State, frames: &[FrameFile]) -> bool {
        match (self.request.field.indicator(), &state.frozen.calibration) {
            (None, _) => true,
            (Some(_), None) => false,
            (Some(asked), Some(known)) => {
                let packed = || frames.iter().all(|frame| is_packed(&frame.path));
                match asked.kind {
                    _ if packed() => true,
                    IndicatorKind::Cloud => matches!(known, Calibration::Clouds { .. }),
                    IndicatorKind::Counting => known.mean().is_some(),
                    IndicatorKind::Symmetry => known.iso().is_some(),
                }
            }
        }
    }
}
