//! Files beside the outputs, in a folder named as the simulation with `.meniscus` appended:
//! `state.json`, what all frames have in common, and the [records](super::records) of those that
//! are done.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::io::whole::{Replace, WholeFile, make_folder};
use crate::io::{WriteError, WriteFault};
use crate::settings::{Kept, differing};

use super::frozen::Frozen;
use super::records::Log;
use crate::error::SimulationError;

/// The state of a simulation: all that its frames have in common.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The version of this library.
    pub meniscus: String,
    /// The settings of the request.
    pub settings: Kept,
    /// The measurements.
    pub frozen: Frozen,
}

impl State {
    /// By this version.
    pub fn new(settings: Kept, frozen: Frozen) -> Self {
        Self { meniscus: env!("CARGO_PKG_VERSION").into(), settings, frozen }
    }

    /// A number that differs where anything does.
    pub fn fingerprint(&self) -> u32 {
        crc32fast::hash(&json(self))
    }

    /// The names of the settings that differ from `wanted`, for people; empty where none does.
    pub fn differing(&self, wanted: &Kept) -> String {
        differing(&self.meniscus, &self.settings, wanted)
    }
}

/// A state that was looked for.
#[derive(Debug)]
pub enum Found {
    /// No state.
    Nothing,
    /// A state that holds for what is asked for.
    Kept(Box<State>),
    /// A state that is to be made anew.
    Stale {
        /// The bytes of its file.
        text: Vec<u8>,
        /// Whether it is of other settings, or cannot be read.
        of_others: bool,
    },
}

impl Found {
    /// The state, if it holds.
    #[must_use]
    pub fn kept(self) -> Option<State> {
        match self {
            Self::Kept(state) => Some(*state),
            Self::Nothing | Self::Stale { .. } => None,
        }
    }
}

/// The folder that holds all this.
#[derive(Debug)]
pub struct Store {
    /// Where this process keeps its records.
    pub log: Log,
}

impl Store {
    /// Beside the outputs of a simulation; nothing is created yet.
    pub fn beside(simulation: &Path) -> Self {
        let mut name = simulation.as_os_str().to_owned();
        name.push(".meniscus");
        Self { log: Log::new(name.into()) }
    }

    /// Where it is.
    pub fn folder(&self) -> &Path {
        self.log.folder()
    }

    /// The state's file.
    pub fn state_path(&self) -> PathBuf {
        self.folder().join("state.json")
    }

    /// The state, if there is one.
    ///
    /// # Errors
    /// [`SimulationError::Io`] and [`SimulationError::State`] where it cannot be read.
    pub fn load(&self) -> Result<Option<State>, SimulationError> {
        self.text()?.map(|text| self.parsed(&text)).transpose()
    }

    /// The bytes of the state's file, if there is one.
    pub fn text(&self) -> Result<Option<Vec<u8>>, SimulationError> {
        let path = self.state_path();
        match fs::read(&path) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(fault) if fault.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(fault) if fault.kind() == io::ErrorKind::NotADirectory => {
                let file = path.ancestors().find(|place| place.is_file()).unwrap_or(&path);
                let fault = io::Error::new(fault.kind(), "is a file, and no folder");
                Err(SimulationError::Io { path: file.to_owned(), fault })
            }
            Err(fault) => Err(SimulationError::Io { path, fault }),
        }
    }

    /// The state that some bytes of its file hold.
    pub fn parsed(&self, text: &[u8]) -> Result<State, SimulationError> {
        let path = self.state_path();
        let state: State = serde_json::from_slice(text)
            .map_err(|e| SimulationError::State { path: path.clone(), what: e.to_string() })?;
        match state.frozen.grid() {
            Ok(_) => Ok(state),
            Err(fault) => Err(SimulationError::State { path, what: fault.to_string() }),
        }
    }

    /// Begins a conversion by the state that was found, which is returned if it is kept. A stale
    /// one is removed, unless another process is at work by its settings, or has made it anew
    /// meanwhile.
    pub fn begin(&self, found: Found) -> Result<Option<State>, SimulationError> {
        let (text, of_others) = match found {
            Found::Nothing => return Ok(None),
            Found::Kept(state) => return Ok(Some(*state)),
            Found::Stale { text, of_others } => (text, of_others),
        };
        let path = self.state_path();
        let _alone = self.locked();
        if self.text()? != Some(text) {
            return Ok(None);
        }
        if of_others && self.log.others_are_open() {
            return Err(SimulationError::Busy(path));
        }
        match fs::remove_file(&path) {
            Err(fault) if fault.kind() != io::ErrorKind::NotFound => {
                Err(SimulationError::Io { path, fault })
            }
            _ => Ok(None),
        }
    }

    /// Keeps a state, unless another process has kept one meanwhile: then returns that, if it is of
    /// the same settings.
    pub fn add(&self, state: &State) -> Result<State, SimulationError> {
        let (folder, path) = (self.folder(), self.state_path());
        make_folder(folder)
            .map_err(|fault| SimulationError::Io { path: folder.to_owned(), fault })?;
        let added = WholeFile::prepare(&path, Replace::Refuse)
            .and_then(|file| file.write(|out| out.write_all(&json(state))));
        match added {
            Ok(_) => Ok(state.clone()),
            Err(WriteError { fault: WriteFault::Exists, .. }) => {
                let there = self.load()?.ok_or_else(|| {
                    let fault = io::ErrorKind::NotFound.into();
                    SimulationError::Io { path: path.clone(), fault }
                })?;
                let differing = there.differing(&state.settings);
                if differing.is_empty() {
                    Ok(there)
                } else {
                    Err(SimulationError::Settings { path, differing })
                }
            }
            Err(WriteError { fault: WriteFault::Io(fault), .. }) => {
                Err(SimulationError::Io { path, fault })
            }
            Err(error) => Err(SimulationError::Io { path, fault: io::Error::other(error) }),
        }
    }

    /// Keeps other processes that ask for the same from going on until this is dropped, where the
    /// file system has locks.
    pub fn locked(&self) -> Option<File> {
        let file = File::open(self.state_path()).ok()?;
        file.lock().ok()?;
        Some(file)
    }
}

fn json(value: &impl Serialize) -> Vec<u8> {
    let mut text = serde_json::to_vec_pretty(value).expect("string keys and finite depth");
    text.push(b'\n');
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::calibration::Calibration;
    use crate::grid::units::{Isovalue, MeanCount};
    use crate::simulation::frozen::Stamp;

    fn frozen(calibration: Calibration) -> Frozen {
        Frozen {
            frame: 1,
            input: Stamp { bytes: 1, modified: u64::MAX, files: 3 },
            spacing: Some(0.1 + 0.2),
            spacing_source: Some("a test".into()),
            cell_size: 0.1 + 0.7,
            slab: None,
            origin: [1e-17, -0.1, 1.0 / 3.0],
            calibration: Some(calibration),
        }
    }

    #[test]
    fn a_state_comes_back_to_the_last_bit() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::beside(&folder.path().join("fluid.ply"));
        assert_eq!(store.load().unwrap(), None);
        for theta in [2, 3, 7, 12_345, 32_767, 65_533] {
            let (mean, iso) = (MeanCount::new(7.0 / 3.0).ok(), Isovalue::of_plateau(theta));
            for calibration in
                [Calibration::Indicator { mean, iso }, Calibration::Clouds { plateau: theta }]
            {
                let state = State::new(Kept::new(), frozen(calibration));
                assert_eq!(store.add(&state).unwrap(), state);
                let loaded = store.load().unwrap().unwrap();
                assert_eq!(loaded, state);
                assert_eq!(loaded.fingerprint(), state.fingerprint());
                // Whoever measures at the same time goes by the state that is there.
                let late =
                    State { frozen: Frozen { frame: 7, ..state.frozen.clone() }, ..state.clone() };
                assert_eq!(store.add(&late).unwrap(), state);
                let other =
                    State { settings: Kept::from_iter([("cell".to_owned(), 1.into())]), ..late };
                assert!(matches!(store.add(&other), Err(SimulationError::Settings { .. })));
                assert_eq!(store.load().unwrap(), Some(state));
                // Another state replaces it only while nobody is at work.
                let busy = Store::beside(&folder.path().join("fluid.ply"));
                busy.log.open().unwrap();
                let stale =
                    || Found::Stale { text: store.text().unwrap().unwrap(), of_others: true };
                assert!(matches!(store.begin(stale()), Err(SimulationError::Busy(_))));
                drop(busy);
                let outdated = Found::Stale { text: b"{}".to_vec(), of_others: true };
                assert_eq!(store.begin(outdated).unwrap(), None);
                assert!(store.load().unwrap().is_some(), "made anew by another meanwhile");
                assert_eq!(store.begin(stale()).unwrap(), None);
                assert_eq!(store.load().unwrap(), None);
            }
        }
        fs::write(store.state_path(), "{").unwrap();
        assert!(matches!(store.load(), Err(SimulationError::State { .. })));
    }
}
