//! The state folder of a simulation, which is next to the outputs and has the simulation's name
//! with `.meniscus` appended. It contains `state.json` with the shared calibration, and the
//! [records](super::records) of finished frames.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::io::output::MeshFormat;
use crate::io::whole::{make_folder, replace_small};
use crate::settings::{StoredSettings, differing};

use super::records::Log;
use super::shared_calibration::SharedCalibration;
use crate::error::{FPS, SimulationError};

/// Name of the frame rate among the settings of a state.
const FRAME_RATE: &str = "fps";

/// Adds a frame rate, in frames per second, to the settings of a state.
pub fn with_frame_rate(mut settings: StoredSettings, fps: Option<f64>) -> StoredSettings {
    settings.extend(fps.map(|fps| (FRAME_RATE.to_owned(), fps.into())));
    settings
}

/// The state of a simulation: everything that its frames share.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The version of the library that wrote the state.
    pub meniscus: String,
    /// The settings of the request, with its frame rate.
    pub settings: StoredSettings,
    /// The shared calibration.
    pub shared: SharedCalibration,
    /// The [location](super::inputs::Sequence::location) of the inputs, if they have one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inputs: Option<String>,
}

impl State {
    /// Makes a state of this version.
    pub fn new(
        settings: StoredSettings,
        shared: SharedCalibration,
        inputs: Option<String>,
    ) -> Self {
        Self { meniscus: env!("CARGO_PKG_VERSION").into(), settings, shared, inputs }
    }

    /// The frame rate of the conversion, in frames per second, if one was given.
    pub fn fps(&self) -> Option<f64> {
        let fps = self.settings.get(FRAME_RATE)?.as_f64()?;
        FPS.contains(&fps).then_some(fps)
    }

    /// A hash of all values of the state on which meshes in this format depend. Only archives
    /// (.abc) depend on the frame rate.
    pub fn fingerprint(&self, format: MeshFormat) -> u32 {
        // The folder of the inputs is left out, because the inputs may have been moved.
        let mut state = Self { inputs: None, ..self.clone() };
        if !matches!(format, MeshFormat::Abc(_)) {
            state.settings.remove(FRAME_RATE);
        }
        crc32fast::hash(&json(&state))
    }

    /// Returns the names of the settings that differ from `wanted`, as text. The text is empty if
    /// no setting differs.
    pub fn differing(&self, wanted: &StoredSettings) -> String {
        differing(&self.meniscus, &self.settings, wanted)
    }
}

/// The result of a search for a state.
#[derive(Debug)]
pub enum StateLookup {
    /// No state.
    Nothing,
    /// A state of this request, and the bytes of its file.
    Kept(Box<State>, Vec<u8>),
    /// A state that will be replaced.
    Stale {
        /// The bytes of the state's file.
        text: Vec<u8>,
        /// Whether the state has other settings or is damaged. False if only the calibration frame
        /// has changed, or if the run makes all frames again with the same settings.
        has_other_settings_or_damage: bool,
    },
}

impl StateLookup {
    /// Returns the state if it belongs to this request.
    #[must_use]
    pub fn kept(self) -> Option<State> {
        match self {
            Self::Kept(state, _) => Some(*state),
            Self::Nothing | Self::Stale { .. } => None,
        }
    }
}

/// The folder of the state and the records.
#[derive(Debug)]
pub struct StateFolder {
    /// The records of this process.
    pub log: Log,
    /// The fields of [`StateLookup::Stale`], if a stale state was found.
    stale: Option<(Vec<u8>, bool)>,
    /// Whether this process makes frames.
    makes_frames: bool,
}

impl StateFolder {
    /// The state folder next to the outputs of `simulation`. Does not create the folder.
    pub fn beside(simulation: &Path) -> Self {
        let mut name = simulation.as_os_str().to_owned();
        name.push(".meniscus");
        Self { log: Log::new(name.into()), stale: None, makes_frames: false }
    }

    /// The folder of the state and the records.
    pub fn folder(&self) -> &Path {
        self.log.folder()
    }

    /// The state's file.
    pub fn state_path(&self) -> PathBuf {
        self.folder().join("state.json")
    }

    /// Reads the state, if there is one.
    ///
    /// # Errors
    /// [`SimulationError::Io`] if the file cannot be read, and [`SimulationError::State`] if it is
    /// damaged.
    pub fn load(&self) -> Result<Option<State>, SimulationError> {
        self.text()?.map(|text| self.parsed(&text)).transpose()
    }

    /// Reads the bytes of the state's file, if there is one.
    pub fn text(&self) -> Result<Option<Vec<u8>>, SimulationError> {
        let path = self.state_path();
        match fs::read(&path) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(fault) if fault.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(fault) if fault.kind() == io::ErrorKind::NotADirectory => {
                let file = path.ancestors().find(|place| place.is_file()).unwrap_or(&path);
                let fault = io::Error::new(fault.kind(), "is a file, not a folder");
                Err(SimulationError::Io { path: file.to_owned(), fault })
            }
            Err(fault) => Err(SimulationError::Io { path, fault }),
        }
    }

    /// Parses the bytes of the state's file.
    pub fn parsed(&self, text: &[u8]) -> Result<State, SimulationError> {
        let path = self.state_path();
        let state: State = serde_json::from_slice(text)
            .map_err(|e| SimulationError::State { path: path.clone(), what: e.to_string() })?;
        match state.shared.grid() {
            Ok(_) => Ok(state),
            Err(fault) => Err(SimulationError::State { path, what: fault.to_string() }),
        }
    }

    /// Begins a run with `found`, the result of the search for a state, and returns the state if it
    /// belongs to the request. A stale state stays until [`add`](Self::add) replaces it.
    /// `makes_frames` says whether this process makes frames. A process that makes frames opens its
    /// log as soon as there is a valid state, so that other processes can see that it is running.
    ///
    /// # Errors
    /// [`SimulationError::Busy`] if another process has meanwhile removed the state or stored one
    /// with other settings, [`SimulationError::Io`] if the log cannot be created, and the errors of
    /// [`load`](Self::load).
    pub fn begin(
        &mut self,
        found: StateLookup,
        makes_frames: bool,
    ) -> Result<Option<State>, SimulationError> {
        self.makes_frames = makes_frames;
        match found {
            StateLookup::Nothing => Ok(None),
            StateLookup::Stale { text, has_other_settings_or_damage } => {
                self.stale = Some((text, has_other_settings_or_damage));
                Ok(None)
            }
            StateLookup::Kept(state, text) => {
                let settings = state.settings.clone();
                let _lock = self.locked();
                let state = if self.text()? == Some(text) { Some(*state) } else { self.load()? };
                let state = state.filter(|existing| existing.settings == settings);
                let state = state.ok_or_else(|| SimulationError::Busy(self.state_path()))?;
                self.open_log()?;
                Ok(Some(state))
            }
        }
    }

    /// The state that will be replaced, if there is one that can be parsed.
    pub fn stale(&self) -> Option<State> {
        let (text, _) = self.stale.as_ref()?;
        self.parsed(text).ok()
    }

    fn open_log(&self) -> Result<(), SimulationError> {
        if self.makes_frames { self.log.open() } else { Ok(()) }
    }

    /// Stores a state, replacing a stale one. If another process has meanwhile stored a state with
    /// the same settings, returns that state instead.
    ///
    /// # Errors
    /// [`SimulationError::Settings`] if another process has meanwhile stored a state with other
    /// settings, [`SimulationError::Busy`] if another process still works with the settings of the
    /// stale state, [`SimulationError::Io`] if the state cannot be written, and the errors of
    /// [`load`](Self::load).
    pub fn add(&self, state: &State) -> Result<State, SimulationError> {
        let (folder, path) = (self.folder(), self.state_path());
        let fail = |fault| SimulationError::Io { path: path.clone(), fault };
        make_folder(folder)
            .map_err(|fault| SimulationError::Io { path: folder.to_owned(), fault })?;
        let _lock = self.locked();
        let existing = self.text()?;
        let stored = match (existing, &self.stale) {
            (Some(existing), Some((stale, has_other_settings_or_damage))) if existing == *stale => {
                if *has_other_settings_or_damage && self.log.others_are_open() {
                    return Err(SimulationError::Busy(path));
                }
                replace_small(&path, &json(state)).map_err(fail)?;
                state.clone()
            }
            (Some(existing), _) => {
                let existing = self.parsed(&existing)?;
                let differing = existing.differing(&state.settings);
                if !differing.is_empty() {
                    return Err(SimulationError::Settings { path, differing });
                }
                existing
            }
            (None, _) => {
                replace_small(&path, &json(state)).map_err(fail)?;
                state.clone()
            }
        };
        self.open_log()?;
        Ok(stored)
    }

    /// Locks the state against other processes until the result is dropped, if the file system has
    /// locks.
    pub fn locked(&self) -> Option<File> {
        let folder = File::open(self.folder()).ok()?;
        folder.lock().ok()?;
        Some(folder)
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
    use crate::particles::AttributeInfo;
    use crate::particles::kind::{AttributeKind, SettledKind};
    use crate::particles::sizes::{Meaning, Sizes};
    use crate::simulation::shared_calibration::Stamp;

    fn shared(calibration: Calibration) -> SharedCalibration {
        SharedCalibration {
            frame: 1,
            input: Stamp { bytes: 1, modified: u64::MAX, files: 3 },
            spacing: Some(0.1 + 0.2),
            spacing_source: Some("a test".into()),
            cell_size: 0.1 + 0.7,
            slab: None,
            walls: None,
            sizes: Some(Sizes {
                attribute: "pscale".into(),
                meaning: Meaning::Radius,
                scale: 1.0 / 3.0,
                finest: 0.1,
                coarsest: 0.7,
                usual: 0.2,
                density: Some(1.0 / 1.1),
                invalid: 3,
                larger: 1,
            }),
            origin: [1e-17, -0.1, 1.0 / 3.0],
            calibration: Some(calibration),
            kinds: vec![SettledKind {
                stored: AttributeInfo::new("Cd", 3),
                kind: AttributeKind::ByteColour,
                is_evident: true,
            }],
        }
    }

    #[test]
    fn a_stored_state_is_loaded_exactly_and_shared_between_processes() {
        let folder = tempfile::tempdir().unwrap();
        let store = StateFolder::beside(&folder.path().join("fluid.ply"));
        assert_eq!(store.load().unwrap(), None);
        for theta in [2, 3, 7, 12_345, 32_767, 65_533] {
            let (mean, iso) = (MeanCount::new(7.0 / 3.0).ok(), Isovalue::of_plateau(theta));
            for calibration in
                [Calibration::Indicator { mean, iso }, Calibration::Clouds { plateau: theta }]
            {
                let state = State::new(StoredSettings::new(), shared(calibration), None);
                assert_eq!(store.add(&state).unwrap(), state);
                let loaded = store.load().unwrap().unwrap();
                assert_eq!(loaded, state);
                let [of_loaded, of_stored] =
                    [&loaded, &state].map(|state| state.fingerprint(MeshFormat::Ply));
                assert_eq!(of_loaded, of_stored);
                // Another process that measures at the same time uses the state that was stored
                // first.
                let late = State {
                    shared: SharedCalibration { frame: 7, ..state.shared.clone() },
                    ..state.clone()
                };
                assert_eq!(store.add(&late).unwrap(), state);
                let other = State {
                    settings: StoredSettings::from_iter([("cell".to_owned(), 1.into())]),
                    ..late.clone()
                };
                assert!(matches!(store.add(&other), Err(SimulationError::Settings { .. })));
                assert_eq!(store.load().unwrap(), Some(state));
                // A stale state can be replaced if no process works with its settings.
                let busy = StateFolder::beside(&folder.path().join("fluid.ply"));
                busy.log.open().unwrap();
                let text = store.text().unwrap().unwrap();
                let mut replacing = StateFolder::beside(&folder.path().join("fluid.ply"));
                let stale = |has_other_settings_or_damage| StateLookup::Stale {
                    text: text.clone(),
                    has_other_settings_or_damage,
                };
                assert_eq!(replacing.begin(stale(true), false).unwrap(), None);
                assert_eq!(replacing.load().unwrap(), store.load().unwrap(), "the old state stays");
                assert!(matches!(replacing.add(&other), Err(SimulationError::Busy(_))));
                drop(busy);
                assert_eq!(replacing.add(&other).unwrap(), other);
                // The stored state is no longer the stale one, and has other settings than `late`.
                assert!(matches!(replacing.add(&late), Err(SimulationError::Settings { .. })));
                fs::remove_file(store.state_path()).unwrap();
            }
        }
        fs::write(store.state_path(), "{").unwrap();
        assert!(matches!(store.load(), Err(SimulationError::State { .. })));
    }
}
