//! One frame's mesh, made in parts by separate processes on any machines, and merged into the same
//! bytes as in a single run.
//!
//! `plan.json` and the parts' files are in a folder next to the output, which has the output's name
//! with `.meniscus-parts` appended. The plan samples the whole frame once, makes the same
//! measurements as a single run, and cuts the Morton curve of blocks into stretches of about equal
//! work. A part samples all bins that can affect the meshes of its blocks
//! ([`DecidingCells`](crate::grid::stretch::DecidingCells)), and then meshes its blocks. The plan
//! lists all chunks of the input with their bounding boxes, so a part reads only the chunks that
//! can contain particles of these bins. The merge puts the blocks of all parts in order, as in the
//! scratch file of a single run, and continues like a single run. Vertices of neighbouring blocks
//! are joined by the edges on which they lie, not by their positions, so the mesh does not depend
//! on the cuts.
//!
//! The guide for users is `parts.md`.

mod chunks;
mod file;
mod make;
mod merge;
mod plan;
mod plan_file;

use std::path::{Path, PathBuf};

use crate::brick::Census;
use crate::error::{Conflict, Error, PartsError, Setting, SettingConflict};
use crate::field::calibration::Calibration;
use crate::field::indicator::IndicatorKind;
use crate::frame::Method;
use crate::io::UnreadPart;
use crate::io::input::file_and_step;
use crate::io::mnf::is_packed;
use crate::system::timings::Timings;

use super::Cells;
use super::builder::Reconstruction;
use super::checked::CheckedRequest;
use super::output::refuse_same_file;
use super::warning::Warning;

use plan_file::SharedPlan;

/// Maximum number of parts. With more parts, each part would sample far more particles around its
/// blocks than inside them.
const MOST_PARTS: u32 = 1000;

/// A request for the mesh of one particle file in parts. Each part can be made by its own process,
/// on any machine.
///
/// First call [`plan`](Self::plan) once, then [`part`](Self::part) for each part, in any order or
/// in parallel; parts are independent and can be repeated. Finally call [`merge`](Self::merge). All
/// calls need the same request.
///
/// ```no_run
/// use meniscus::Reconstruction;
///
/// let parts = Reconstruction::new().parts("frame.bgeo", "mesh.ply", 8);
/// parts.plan()?;
/// for part in 0..8 {
///     parts.part(part)?; // in any process, on any machine
/// }
/// parts.merge()?.write("mesh.ply")?;
/// # Ok::<(), meniscus::Error>(())
/// ```
#[derive(Debug, Clone)]
#[must_use]
pub struct Parts {
    request: Reconstruction,
    input: PathBuf,
    output: PathBuf,
    count: u32,
    existing: ExistingPlan,
}

/// The treatment of an existing plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ExistingPlan {
    /// Keep the plan if its request is the same, otherwise fail.
    Refuse,
    /// Keep the plan if its request is the same, otherwise replace it.
    ReplaceDiffering,
    /// Always replace the plan.
    Replace,
}

/// A plan that was made or already existed.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PartsPlan {
    /// The plan's file.
    pub path: PathBuf,
    /// Number of particles in the file.
    pub particles: usize,
    /// Name of the file format.
    pub format: String,
    /// Names of the particle types in the file. The first is the type that is read. Empty if the
    /// file has a single type without a name.
    pub particle_types: Vec<String>,
    /// Parts of the input that were not read; empty if the plan already existed.
    pub left_out: Vec<UnreadPart>,
    /// The chosen cells.
    pub cells: Cells,
    /// The origin to which the grid was moved because all particles are on a lattice.
    pub moved_to: Option<[f64; 3]>,
    /// The indicator.
    pub indicator: IndicatorKind,
    /// Counts of used and skipped particles.
    pub census: Census,
    /// The calibration of the surface.
    pub calibration: Calibration,
    /// The parts, in order.
    pub parts: Vec<PartShare>,
    /// Memory limit, in bytes.
    pub budget: u64,
    /// The folder of scratch files.
    pub scratch_folder: PathBuf,
    /// Time of each stage; empty if the plan already existed.
    pub timings: Timings,
}

/// The number of particles of one part, and the resources that it needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct PartShare {
    /// Number of particles in the part's blocks, including the images in a periodic box. The sum
    /// over all parts is the number for the whole frame.
    pub particles: u64,
    /// Number of particles that the part keeps in memory: the particles in its blocks, and the
    /// particles around its blocks that affect their meshes.
    pub kept: u64,
    /// Estimated resources on a machine like this one; `None` if the plan already existed.
    pub needs: Option<PartNeeds>,
}

/// Resources of a part, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct PartNeeds {
    /// Peak memory within the limit.
    pub memory: u64,
    /// Peak memory without scratch files.
    pub in_core: u64,
    /// Upper bound of the size of the scratch files.
    pub scratch: u64,
}

/// A part that was made or already existed.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PartDone {
    /// The part's file.
    pub path: PathBuf,
    /// The file's size, in bytes.
    pub bytes: u64,
    /// Number of blocks through which the surface passes.
    pub blocks: usize,
    /// Number of triangles.
    pub triangles: u64,
    /// Number of particles that were read from the input; 0 if the part already existed.
    pub read: usize,
    /// Whether a complete file of the same plan already existed.
    pub reused: bool,
    /// Warnings that the backend failed and the CPU did its work.
    pub warnings: Vec<Warning>,
    /// Time of each stage; empty if the part already existed.
    pub timings: Timings,
}

impl Reconstruction {
    /// A request for the mesh of a particle file in `count` parts. The plan and the parts are
    /// stored in a folder next to the output.
    pub fn parts(
        &self,
        input: impl Into<PathBuf>,
        output: impl Into<PathBuf>,
        count: u32,
    ) -> Parts {
        Parts {
            request: self.clone(),
            input: input.into(),
            output: output.into(),
            count,
            existing: ExistingPlan::Refuse,
        }
    }
}

/// A checked request, with which every step begins.
struct PartsRequest {
    checked: CheckedRequest,
    folder: PathBuf,
    /// The indicator; kernel methods do not support parts.
    indicator: IndicatorKind,
}

impl Parts {
    /// Replaces an existing plan if it was made for a different request.
    pub fn resume(mut self) -> Self {
        self.existing = ExistingPlan::ReplaceDiffering;
        self
    }

    /// Makes a new plan even if one exists.
    pub fn overwrite(mut self) -> Self {
        self.existing = ExistingPlan::Replace;
        self
    }

    /// The folder of the plan and the parts. The folder can be deleted once the mesh is written.
    #[must_use]
    pub fn folder(&self) -> PathBuf {
        let mut name = self.output.as_os_str().to_owned();
        name.push(".meniscus-parts");
        name.into()
    }

    /// Checks everything in the request that can be checked without a plan.
    fn begin(&self) -> Result<PartsRequest, Error> {
        let checked = self.request.checked()?;
        if !(1..=MOST_PARTS).contains(&self.count) {
            return Err(PartsError::Count { asked: self.count, most: MOST_PARTS }.into());
        }
        if is_packed(&self.input) {
            let with = Conflict::Packed(self.input.clone());
            return Err(SettingConflict { setting: Setting::named("parts"), with }.into());
        }
        let indicator = match checked.sampling.method {
            Method::Indicator { kind, .. } => kind,
            Method::Kernels(kernels) => {
                let with = Conflict::Method(kernels);
                return Err(SettingConflict { setting: Setting::named("parts"), with }.into());
            }
        };
        checked.check_indicator()?;
        refuse_same_file(&self.output, file_and_step(&self.input).0)?;
        for solid in checked.settings.solid_files() {
            refuse_same_file(&self.output, Path::new(solid))?;
        }
        if self.output.metadata().is_ok_and(|found| !found.is_file()) {
            return Err(PartsError::NoFile(self.output.clone()).into());
        }
        Ok(PartsRequest { checked, folder: self.folder(), indicator })
    }

    /// Loads the plan with its fingerprint. Returns an error if the plan does not exist or was made
    /// for another request.
    fn planned(&self, request: &PartsRequest) -> Result<(SharedPlan, u32), Error> {
        let PartsRequest { checked, folder, .. } = request;
        let Some(found) = SharedPlan::load(folder)? else {
            return Err(PartsError::NoPlan(plan_file::path_in(folder)).into());
        };
        found.0.check_request(folder, checked, &self.input, self.count)?;
        Ok(found)
    }
}

fn part_in(folder: &Path, part: u32) -> PathBuf {
    folder.join(format!("part_{part}"))
}
