//! Files beside the outputs, in a folder named as the simulation with `.meniscus` appended: `state.json`, what
//! all frames have in common, and the [records](super::records) of those that are done.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::io::whole::{make_folder, replace_small};
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
    #[must_use]
    pub fn new(settings: Kept, frozen: Frozen) -> Self {
        Self { meniscus: env!("CARGO_PKG_VERSION").into(), settings, frozen }
    }

    /// A number that differs where anything does.
    #[must_use]
    pub fn fingerprint(&self) -> u32 {
        crc32fast::hash(&json(self))
    }

    /// The names of the settings that differ from `wanted`, for people; empty where none does.
    #[must_use]
    pub fn differing(&self, wanted: &Kept) -> String {
        differing(&self.meniscus, &self.settings, wanted)
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
    #[must_use]
    pub fn beside(simulation: &Path) -> Self {
        let mut name = simulation.as_os_str().to_owned();
        name.push(".meniscus");
        Self { log: Log::new(name.into()) }
    }

    /// Where it is.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.log.folder()
    }

    /// The state's file.
    #[must_use]
    pub fn state_path(&self) -> PathBuf {
        self.folder().join("state.json")
    }

    /// The state, if there is one.
    ///
    /// # Errors
    /// [`SimulationError::Io`] and [`SimulationError::State`] where it cannot be read.
    pub fn load(&self) -> Result<Option<State>, SimulationError> {
        let path = self.state_path();
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(fault) if fault.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(fault) if fault.kind() == io::ErrorKind::NotADirectory => {
                let file = path.ancestors().find(|place| place.is_file()).unwrap_or(&path);
                let fault = io::Error::new(fault.kind(), "is a file, and no folder");
                return Err(SimulationError::Io { path: file.to_owned(), fault });
            }
            Err(fault) => return Err(SimulationError::Io { path, fault }),
        };
        let state: State = serde_json::from_slice(&bytes)
            .map_err(|e| SimulationError::State { path: path.clone(), what: e.to_string() })?;
        match state.frozen.grid() {
            Ok(_) => Ok(Some(state)),
            Err(fault) => Err(SimulationError::State { path, what: fault.to_string() }),
        }
    }

    /// Keeps a state in place of any other.
    ///
    /// # Errors
    /// [`SimulationError::Io`].
    pub fn save(&self, state: &State) -> Result<(), SimulationError> {
        let folder = self.folder();
        make_folder(folder).map_err(|fault| SimulationError::Io { path: folder.to_owned(), fault })?;
        let path = self.state_path();
        replace_small(&path, &json(state)).map_err(|fault| SimulationError::Io { path, fault })
    }

    /// Keeps other processes that ask for the same from going on until this is dropped, where the file system has locks.
    #[must_use]
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
            for calibration in [Calibration::Indicator { mean, iso }, Calibration::Clouds { plateau: theta }]
            {
                let state = State::new(Kept::new(), frozen(calibration));
                store.save(&state).unwrap();
                let loaded = store.load().unwrap().unwrap();
                assert_eq!(loaded, state);
                assert_eq!(loaded.fingerprint(), state.fingerprint());
            }
        }
        fs::write(store.state_path(), "{").unwrap();
        assert!(matches!(store.load(), Err(SimulationError::State { .. })));
    }
}
