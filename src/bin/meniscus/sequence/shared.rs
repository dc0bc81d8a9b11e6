//! What all lanes of a conversion share.

use std::path::PathBuf;
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

use meniscus::io::output::MeshFormat;
use meniscus::simulation::inputs::FrameFile;
use meniscus::simulation::records::{Record, Records};
use meniscus::simulation::state::{State, Store};

use crate::lanes::{Division, Gate};

use super::setup::Setup;

/// What all lanes share.
pub struct Conversion<'a> {
    pub setup: &'a Setup<'a>,
    pub format: MeshFormat,
    pub store: Store,
    /// `None` where it cannot be known.
    pub settled: OnceLock<Option<Settled>>,
    pub division: Division,
    pub gate: Gate,
    pub stop: AtomicBool,
}

/// What all frames have in common.
pub struct Settled {
    pub state: State,
    pub fingerprint: u32,
}

impl<'a> Conversion<'a> {
    pub fn new(setup: &'a Setup<'a>, format: MeshFormat, store: Store, frames: usize) -> Self {
        let division = setup.division(frames);
        let (settled, gate) = (OnceLock::new(), Gate::new(division.lanes, rayon::current_num_threads()));
        Self { setup, format, store, settled, division, gate, stop: AtomicBool::new(false) }
    }

    pub fn output(&self, frame: &FrameFile) -> PathBuf {
        self.setup.naming.path(frame)
    }

    /// The record of a frame that need not be made again, as far as is known.
    pub fn current<'r>(&self, records: &'r Records, frame: &FrameFile) -> Option<&'r Record> {
        let settled = self.settled.get()?.as_ref()?;
        records.current(frame.number, &frame.path, &self.output(frame), settled.fingerprint)
    }
}
