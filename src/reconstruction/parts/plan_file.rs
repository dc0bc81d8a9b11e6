//! The file `plan.json`: the measurements on the whole frame, and the blocks of each part.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::brick::{Census, FrameFacts};
use crate::error::{Error, PartsError};
use crate::field::calibration::{Calibration, MeasuredCalibration, Plateau};
use crate::field::indicator::{Indicator, IndicatorKind};
use crate::field::sizes::FinerBlocks;
use crate::frame::{CoincidentParticles, Sampling};
use crate::grid::stretch::Stretch;
use crate::grid::units::MeanCount;
use crate::grid::{Grid, MortonKey};
use crate::io::stamp::Stamp;
use crate::io::whole::{make_folder, replace_small};
use crate::particles::AttributeInfo;
use crate::reconstruction::checked::CheckedRequest;
use crate::reconstruction::{Cells, as_numbers};
use crate::settings::{StoredSettings, differing};

use super::chunks::BinnedChunk;

/// The plan, which all parts and the merge use.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct SharedPlan {
    /// The version of this library.
    pub(super) meniscus: String,
    /// The settings of the request, by the names of the options.
    pub(super) settings: StoredSettings,
    /// Whether the caller of the library gave a calibration.
    pub(super) calibrated: bool,
    /// The stamp of the particles' file and of the files of solids.
    pub(super) input: Stamp,
    /// Number of particles in the input.
    pub(super) particles: usize,
    /// Name of the file format.
    pub(super) format: String,
    /// Names of the particle types in the input, of which the first is read.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) particle_types: Vec<String>,
    /// The chosen cells.
    pub(super) cells: Cells,
    pub(super) origin: [f64; 3],
    /// Whether the grid was moved to suit a lattice.
    pub(super) moved: bool,
    pub(super) census: Census,
    /// mu0, for the indicator counting.
    pub(super) mean: Option<f64>,
    /// The calibration of the surface.
    #[serde(flatten, with = "as_numbers")]
    pub(super) calibration: Option<Calibration>,
    /// The values measured for the calibration, unless the caller supplied the calibration.
    pub(super) measured: Option<CalibrationMeasures>,
    /// Mean indicator of full cells, for symmetry.
    pub(super) mean_symmetry: Option<f64>,
    /// Particles that have the same position as other particles, if there are any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) coincident: Option<CoincidentParticles>,
    /// The blocks near finer particles, if the particles have several sizes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) finer_blocks: FinerBlocks,
    /// Attributes that go to the vertices.
    pub(super) attributes: Vec<AttributeInfo>,
    pub(super) parts: Vec<BlockShare>,
    /// Chunks of all particles of the input, in the input's order.
    pub(super) chunks: Vec<BinnedChunk>,
}

/// The values measured for a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct CalibrationMeasures {
    plateau: Plateau,
    step_cells: f64,
}

/// The blocks of a part, and the numbers of particles in them and around them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct BlockShare {
    /// The key of the part's first block. The part ends before the next part's first block.
    pub(super) first: u64,
    /// Number of particles in the part's blocks.
    pub(super) particles: u64,
    /// Number of particles that the part samples, in its blocks and around them.
    pub(super) counted: u64,
}

impl From<MeasuredCalibration> for CalibrationMeasures {
    fn from(MeasuredCalibration { plateau, step_cells, .. }: MeasuredCalibration) -> Self {
        Self { plateau, step_cells }
    }
}

/// The file of the plan in a folder of parts.
pub(super) fn path_in(folder: &Path) -> PathBuf {
    folder.join("plan.json")
}

impl SharedPlan {
    /// Loads the plan of a folder, with its fingerprint; `None` if there is no plan.
    pub(super) fn load(folder: &Path) -> Result<Option<(Self, u32)>, PartsError> {
        let path = path_in(folder);
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(fault) if fault.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(fault) => return Err(PartsError::Io { path, fault }),
        };
        let damaged = |what: String| PartsError::Plan { path: path.clone(), what };
        let file: PlanFile =
            serde_json::from_slice(&bytes).map_err(|fault| damaged(fault.to_string()))?;
        if file.to_text() != bytes || file.plan.fingerprint() != file.fingerprint {
            return Err(damaged("it was modified after it was written".into()));
        }
        let PlanFile { plan, fingerprint } = file;
        plan.validate().map_err(damaged)?;
        Ok(Some((plan, fingerprint)))
    }

    /// Writes the plan into a folder, and replaces any existing plan.
    pub(super) fn save(&self, folder: &Path) -> Result<u32, PartsError> {
        make_folder(folder).map_err(|fault| PartsError::Io { path: folder.to_owned(), fault })?;
        let path = path_in(folder);
        let file = PlanFile { fingerprint: self.fingerprint(), plan: self.clone() };
        replace_small(&path, &file.to_text()).map_err(|fault| PartsError::Io { path, fault })?;
        Ok(file.fingerprint)
    }

    /// A checksum of all values in the plan.
    fn fingerprint(&self) -> u32 {
        crc32fast::hash(&serde_json::to_vec(self).expect("string keys and finite depth"))
    }

    /// Rejects invalid or inconsistent values.
    fn validate(&self) -> Result<(), String> {
        self.grid().map_err(|fault| fault.to_string())?;
        let first = self.parts.first().ok_or("it has no parts")?;
        if first.first != 0 || !self.parts.is_sorted_by_key(|share| share.first) {
            return Err("its parts are not in order".into());
        }
        if self.calibration.is_none() {
            return Err("it has no calibration".into());
        }
        let listed = self
            .chunks
            .iter()
            .try_fold(0, |all: usize, chunk| all.checked_add(chunk.particles.count));
        if listed != Some(self.particles) {
            return Err("its chunks do not contain all particles".into());
        }
        Ok(())
    }

    /// Rejects a plan that was made for another request, or whose input has changed.
    pub(super) fn check_request(
        &self,
        folder: &Path,
        checked: &CheckedRequest,
        input: &Path,
        count: u32,
    ) -> Result<(), Error> {
        let path = path_in(folder);
        let mut differing = differing(&self.meniscus, &self.settings, &checked.settings.kept());
        let mut differs = |name: &str| {
            differing += if differing.is_empty() { "" } else { ", " };
            differing += name;
        };
        if self.count() != count {
            differs("parts");
        }
        let same = match checked.calibration {
            None => !self.calibrated,
            Some(by) => self.calibrated && self.calibration == Some(by),
        };
        if !same {
            differs("calibration");
        }
        if !differing.is_empty() {
            return Err(PartsError::Settings { path, differing }.into());
        }
        let stamp = checked.settings.stamp(input)?;
        if stamp != self.input {
            return Err(PartsError::Changed { input: input.to_owned(), plan: path }.into());
        }
        Ok(())
    }

    pub(super) fn count(&self) -> u32 {
        self.parts.len() as u32
    }

    pub(super) fn stretch(&self, part: u32) -> Stretch {
        let key = |part: usize| {
            self.parts.get(part).map_or(Stretch::ALL.end, |share| MortonKey(share.first))
        };
        Stretch { first: key(part as usize), end: key(part as usize + 1) }
    }

    pub(super) fn grid(&self) -> Result<Grid, crate::grid::units::UnitError> {
        Grid::new(self.origin.into(), self.cells.size)
    }

    /// The sampling of parts: the sampling of the whole frame, with the measured mu0.
    pub(super) fn sampling(
        &self,
        checked: &CheckedRequest,
        carried: Vec<usize>,
    ) -> Result<Sampling, Error> {
        let mean = self.mean.map(MeanCount::new).transpose()?;
        let method = checked.sampling.method.with_mean(mean);
        let resources = checked.resources.clone();
        let request = checked.sampling.in_walls(self.cells.found()).in_slab(self.cells.slab);
        request.sampling_on(self.grid()?, method, self.cells.lengths(), carried, resources)
    }

    /// The facts of the whole frame.
    pub(super) fn facts(&self, sampling: &Sampling) -> FrameFacts {
        let Sampling { grid, domain, periodic, spacing, .. } = *sampling;
        FrameFacts { grid, domain, periodic, census: self.census, spacing }
    }

    /// The indicator of the whole frame, with the measured mu0 for counting.
    pub(super) fn indicator(&self, kind: IndicatorKind) -> Result<Indicator, Error> {
        Ok(kind.with_mean(|| MeanCount::new(self.mean.unwrap_or_default()))?)
    }

    /// The measured calibration, unless the calibration was given.
    pub(super) fn calibrated(&self) -> Option<MeasuredCalibration> {
        let (calibration, CalibrationMeasures { plateau, step_cells }) =
            (self.calibration?, self.measured?);
        Some(MeasuredCalibration { calibration, plateau, step_cells })
    }
}

/// The content of the file.
#[derive(Serialize, Deserialize)]
struct PlanFile {
    /// CRC-32 of the plan, which detects changed values.
    fingerprint: u32,
    #[serde(flatten)]
    plan: SharedPlan,
}

impl PlanFile {
    fn to_text(&self) -> Vec<u8> {
        let mut text = serde_json::to_vec_pretty(self).expect("string keys and finite depth");
        text.push(b'\n');
        text
    }
}
