//! State that all lanes of a conversion share.

use std::path::PathBuf;
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

use crate::io::output::MeshFormat;
use crate::system::cancel::Cancel;

use super::inputs::FrameFile;
use super::records::{Record, Records};
use super::state::{State, Store};

use super::gate::Gate;
use super::lanes::Division;
use super::setup::Setup;

/// State that all lanes share.
pub(super) struct Conversion<'a> {
    pub(super) setup: &'a Setup<'a>,
    pub(super) format: MeshFormat,
    pub(super) store: Store,
    /// `None` where it cannot be known.
    pub(super) settled: OnceLock<Option<Settled>>,
    pub(super) division: Division,
    pub(super) gate: Gate,
    pub(super) stop: AtomicBool,
    /// Whether the spacing is of a state that was kept, and no frame was looked at for doubts about it yet.
    pub(super) unchecked: AtomicBool,
}

/// Measurements that all frames share.
pub(super) struct Settled {
    pub(super) state: State,
    pub(super) fingerprint: u32,
}

impl<'a> Conversion<'a> {
    pub(super) fn new(setup: &'a Setup<'a>, format: MeshFormat, store: Store, frames: usize) -> Self {
        let division = setup.division(frames);
        let (settled, gate) = (OnceLock::new(), Gate::new(division.lanes, setup.checked.threads));
        let [stop, unchecked] = [(); 2].map(|()| AtomicBool::new(false));
        Self { setup, format, store, settled, division, gate, stop, unchecked }
    }

    /// The caller's handle to end the work early.
    pub(super) fn cancel(&self) -> &Cancel {
        &self.setup.checked.resources.control.cancel
    }

    /// The mesh's file of a frame.
    pub(super) fn output(&self, frame: &FrameFile) -> PathBuf {
        self.setup.output(frame)
    }

    /// The record of a frame that need not be made again, as far as is known.
    pub(super) fn current<'r>(&self, records: &'r Records, frame: &FrameFile) -> Option<&'r Record> {
        let settled = self.settled.get()?.as_ref()?;
        records.current(frame.number, &frame.path, &self.output(frame), settled.fingerprint)
    }
}
