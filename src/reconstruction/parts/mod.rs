//! One frame's mesh in parts, each made by its own process on any machine, and merged to the bytes
//! of a single run.
//!
//! `plan.json` and the parts' files are in a folder beside the output, with `.meniscus-parts`
//! appended to its name. The plan samples the whole frame once, measures what a single run would,
//! and cuts the Morton curve of blocks into stretches of about equal work. A part samples the bins
//! that decide its blocks' meshes ([`Sight`](crate::grid::stretch::Sight): what filters reach, by
//! the recipe), and meshes those blocks. It reads the chunks of the input that can contain
//! particles of these bins: the plan lists all chunks with their bounding boxes. Merging lists the
//! blocks of all parts in order, like the scratch file of a single run, and continues like a single
//! run. Vertices are stitched by identity, so the cuts leave no trace.
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
use crate::error::{Conflict, Error, PartsError, Setting, Unfit};
use crate::field::calibration::Calibration;
use crate::field::indicator::IndicatorKind;
use crate::frame::Method;
use crate::io::input::file_and_step;
use crate::io::mnf::is_packed;
use crate::particles::sizes::SizeChoice;
use crate::system::timings::Timings;

use super::Cells;
use super::builder::Reconstruction;
use super::checked::Checked;
use super::output::refuse_same_file;
use super::warning::Warning;

use plan_file::Plan;

/// Parts of a mesh, at the most: of more, each would sample far more around its blocks than in
/// them.
const MOST_PARTS: u32 = 1000;

/// A request for the mesh of one file of particles in parts, each to be made by a process of its
/// own, on any machine.
///
/// First [`plan`](Self::plan), once. Then every [`part`](Self::part), in any order, as often as one
/// likes, beside one another: none needs another. At last [`merge`](Self::merge). All have to ask
/// for the same.
///
/// ```no_run
/// use meniscus::Reconstruction;
///
/// let parts = Reconstruction::new().parts("frame.bgeo", "mesh.ply", 8);
/// parts.plan()?;
/// for part in 0..8 {
///     parts.part(part)?; // elsewhere
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
    again: Again,
}

/// Treatment of a plan that is there already.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Again {
    /// Kept if it is what would be made again, and refused else.
    Refuse,
    /// Kept if it is what would be made again, and replaced else.
    Differing,
    /// Replaced.
    Always,
}

/// A plan that was made, or was there.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Planned {
    /// The plan's file.
    pub path: PathBuf,
    /// The particles in the file.
    pub particles: usize,
    /// The kind of file, in the words that people use for it.
    pub format: String,
    /// The cells that were chosen.
    pub cells: Cells,
    /// The origin that the grid was moved to, where all particles stand on a lattice that it has to
    /// suit.
    pub moved_to: Option<[f64; 3]>,
    /// The indicator that makes the field.
    pub indicator: IndicatorKind,
    /// Counts of particles, by what becomes of them.
    pub census: Census,
    /// By what the surface will be drawn.
    pub calibration: Calibration,
    /// The parts, in order.
    pub parts: Vec<PartShare>,
    /// Bytes of memory that may be used, and the folder for what exceeds them.
    pub budget: u64,
    /// The folder of scratch files.
    pub scratch_folder: PathBuf,
    /// How long each stage took: nothing where the plan was there.
    pub timings: Timings,
}

/// The share of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct PartShare {
    /// Particles in its blocks, with their images in a periodic box: all parts' together are all of
    /// the frame.
    pub particles: u64,
    /// Particles that it keeps: those, and what decides their blocks from around.
    pub kept: u64,
    /// Needs of a machine that is like this; `None` where the plan was there.
    pub takes: Option<PartTakes>,
}

/// Bytes that a part takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct PartTakes {
    /// Memory within the budget, at the peak.
    pub memory: u64,
    /// Memory that it would take if there were enough.
    pub in_core: u64,
    /// Scratch files, at the most.
    pub scratch: u64,
}

/// A part that was made, or was there.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PartMade {
    /// The part's file.
    pub path: PathBuf,
    /// The file's size.
    pub bytes: u64,
    /// Blocks that the surface passes through.
    pub blocks: usize,
    /// Triangles of all blocks.
    pub triangles: u64,
    /// Particles that were read of the input: none where it was there.
    pub read: usize,
    /// Whether it was there already, whole, and made by the same plan.
    pub was_there: bool,
    /// Failures of the backend that were made good.
    pub warnings: Vec<Warning>,
    /// How long each stage took: nothing where it was there.
    pub timings: Timings,
}

impl Reconstruction {
    /// A request for the mesh of a particle file in `count` parts, which are in a folder beside the
    /// output until they are merged.
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
            again: Again::Refuse,
        }
    }
}

/// All that every step begins with.
struct Begun {
    checked: Checked,
    folder: PathBuf,
    /// The indicator that makes the field: parts are not for kernels.
    indicator: IndicatorKind,
}

impl Parts {
    /// Replaces a plan that was made for something else.
    pub fn resume(mut self) -> Self {
        self.again = Again::Differing;
        self
    }

    /// Plans anew, whatever is there.
    pub fn overwrite(mut self) -> Self {
        self.again = Again::Always;
        self
    }

    /// The folder of the plan and the parts: all of it can go when the mesh is there.
    #[must_use]
    pub fn folder(&self) -> PathBuf {
        let mut name = self.output.as_os_str().to_owned();
        name.push(".meniscus-parts");
        name.into()
    }

    /// Checks what can be checked without a plan.
    fn begin(&self) -> Result<Begun, Error> {
        let mut checked = self.request.checked()?;
        if checked.settings.asks_for_sizes() {
            let with = Conflict::Setting(Setting::named("parts"));
            return Err(Unfit { setting: Setting::named("size"), with }.into());
        }
        checked.sampling.size = SizeChoice::Ignored;
        if !(1..=MOST_PARTS).contains(&self.count) {
            return Err(PartsError::Count { asked: self.count, most: MOST_PARTS }.into());
        }
        if is_packed(&self.input) {
            let with = Conflict::Packed(self.input.clone());
            return Err(Unfit { setting: Setting::named("parts"), with }.into());
        }
        let indicator = match checked.sampling.method {
            Method::Indicator { kind, .. } => kind,
            Method::Kernels(kernels) => {
                let with = Conflict::Method(kernels);
                return Err(Unfit { setting: Setting::named("parts"), with }.into());
            }
        };
        checked.refuse_of_indicator()?;
        refuse_same_file(&self.output, file_and_step(&self.input).0)?;
        for solid in checked.settings.solid_files() {
            refuse_same_file(&self.output, Path::new(solid))?;
        }
        if self.output.metadata().is_ok_and(|found| !found.is_file()) {
            return Err(PartsError::NoFile(self.output.clone()).into());
        }
        Ok(Begun { checked, folder: self.folder(), indicator })
    }

    /// The plan that was made for what is asked for, and its fingerprint.
    fn planned(&self, begun: &Begun) -> Result<(Plan, u32), Error> {
        let Begun { checked, folder, .. } = begun;
        let Some(found) = Plan::load(folder)? else {
            return Err(PartsError::NoPlan(plan_file::path_in(folder)).into());
        };
        found.0.refuse_other(folder, checked, &self.input, self.count)?;
        Ok(found)
    }
}

/// The file of a part in a folder of parts.
fn part_in(folder: &Path, part: u32) -> PathBuf {
    folder.join(format!("part_{part}"))
}
