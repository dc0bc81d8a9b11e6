//! Writes lists of a simulation's frames for other programs.
//!
//! The lists are replaced atomically as frames are finished, so that a viewer can show the frames
//! before the conversion ends. For frames `pool_1.vtp`, `pool_2.vtp` and so on:
//!
//! | meshes | files next to them |
//! |---|---|
//! | all | `pool.vtp.json`: each frame's file, time, counts and box |
//! | .vtp, .pvtp | `pool.pvd` and `pool.vtp.series` for ParaView |
//! | .vtk, .vtkhdf, .ply, .stl | `pool.vtk.series` and the like for ParaView |
//! | .usdc | `pool.usda`, a stage of value clips, and `pool.manifest.usda`, which declares the attributes of the clips |
//!
//! The times are the inputs' times in seconds, if these are strictly increasing. Otherwise, they
//! are the frame numbers divided by the frame rate. Without a frame rate, they are the frame
//! numbers. `time_codes.rs` converts times to the time codes of a stage.

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::particles::AttributeInfo;
use crate::surface::mesh::source::Corners;

use super::output::MeshFormat;
use super::time_codes::{FrameTime, Timeline, UnusedTimes};
use super::usd::stage::{Manifest, path_fault, stage};
use super::vtp::escaped;
use super::whole::replace_small;
use super::{UpAxis, WriteError};

/// A frame that has a mesh, as a list describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeriesFrame {
    /// The frame's number.
    pub frame: i64,
    /// The time in seconds, if the input has it.
    pub time: Option<f64>,
    /// Name of the mesh's file, in the folder of the lists.
    pub file: String,
    /// Size of the mesh's file in bytes.
    pub bytes: u64,
    /// Number of particles that were used for the mesh.
    pub particles: u64,
    /// Number of vertices of the mesh.
    pub vertices: u64,
    /// Number of triangles of the mesh.
    pub triangles: u64,
    /// The mesh's bounding box as a viewer shows it, after any rotation that the mesh's file
    /// specifies. `None` for an empty mesh.
    pub bounds: Option<Corners>,
    /// Whether the vertices have normals.
    pub normals: bool,
    /// Attributes of the vertices, besides normals.
    pub attributes: Vec<AttributeInfo>,
}

/// The lists of the frames of a simulation.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Format of the meshes, with the up axis if the format stores it.
    pub format: MeshFormat,
    /// Path of the frames without their numbers, such as `mesh/pool.vtp`.
    pub simulation: PathBuf,
    /// Frames per second, if the frame rate is given.
    pub fps: Option<f64>,
    /// The axis that points up in a viewer, after any rotation that the meshes' files specify.
    pub up: UpAxis,
}

/// A frame in a .json list of frames.
#[derive(Serialize)]
struct ListedFrame {
    #[serde(flatten)]
    frame: SeriesFrame,
    /// Time code at which a stage shows the frame, if the simulation has a stage.
    #[serde(skip_serializing_if = "Option::is_none")]
    time_code: Option<f64>,
}

/// The up axis and the file names in a .json list of frames.
#[derive(Deserialize)]
struct Listing {
    up: String,
    frames: Vec<ListedFile>,
}

#[derive(Deserialize)]
struct ListedFile {
    frame: i64,
    file: String,
}

/// Suffix of the name of a .json list.
const LIST: &str = ".json";
/// Maximum size, in bytes, of a .json list that is read. It allows about 200,000 frames.
const LARGEST_LISTING: u64 = 64 << 20;

/// The numbers and the file names of the frames in the .json list of a simulation. `simulation` is
/// the path of its meshes without their numbers. Empty if there is no such list.
#[must_use]
pub fn listed_meshes(simulation: &Path) -> Vec<(i64, String)> {
    let text = fs::read(appended(simulation, LIST)).unwrap_or_default();
    let listing = serde_json::from_slice(&text).ok();
    let frames = listing.map_or(Vec::new(), |listing: Listing| listing.frames);
    frames.into_iter().map(|listed| (listed.frame, listed.file)).collect()
}

fn appended(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// The up axis that a .json list next to a mesh records. `None` without such a list.
pub(super) fn listed_up(mesh: &Path) -> Option<UpAxis> {
    let folder = mesh.parent()?;
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let ending = format!(".{}.json", mesh.extension()?.to_str()?);
    let name = mesh.file_name()?.to_str()?;
    let is_listing = |path: &PathBuf| {
        path.to_str().is_some_and(|path| path.ends_with(&ending))
            && path.metadata().is_ok_and(|m| m.is_file() && m.len() <= LARGEST_LISTING)
    };
    let paths = fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    let mut listings: Vec<PathBuf> = paths.filter(is_listing).collect();
    listings.sort();
    listings.into_iter().find_map(|path| {
        let listing: Listing = serde_json::from_slice(&fs::read(path).ok()?).ok()?;
        let axis = [UpAxis::Y, UpAxis::Z].into_iter().find(|axis| axis.to_string() == listing.up);
        axis.filter(|_| listing.frames.iter().any(|frame| frame.file == name))
    })
}

impl Series {
    /// Paths of the lists that [`write`](Self::write) writes. The first list contains all data.
    pub fn files(&self) -> Vec<PathBuf> {
        let list = self.appended(LIST);
        match self.format {
            MeshFormat::Vtp | MeshFormat::Pvtp => {
                vec![list, self.simulation.with_extension("pvd"), self.appended(".series")]
            }
            MeshFormat::Vtk | MeshFormat::VtkHdf | MeshFormat::Ply | MeshFormat::Stl => {
                vec![list, self.appended(".series")]
            }
            MeshFormat::Obj
            | MeshFormat::Glb(_)
            | MeshFormat::BgeoSc
            | MeshFormat::Abc(_)
            | MeshFormat::Vdb { .. } => {
                vec![list]
            }
            // The stage comes last, because it refers to the manifest.
            MeshFormat::Usdc(_) => vec![list, self.manifest_path(), self.stage_path()],
        }
    }

    fn appended(&self, ending: &str) -> PathBuf {
        appended(&self.simulation, ending)
    }

    /// The path of the manifest, a USD layer that declares the attributes of the clips.
    fn manifest_path(&self) -> PathBuf {
        self.simulation.with_extension("manifest.usda")
    }

    fn stage_path(&self) -> PathBuf {
        self.simulation.with_extension("usda")
    }

    /// The reason why other programs could not play the lists if the lists were written to this
    /// path. `None` if other programs could play them.
    #[must_use]
    pub fn path_fault(&self) -> Option<String> {
        let MeshFormat::Usdc(_) = self.format else { return None };
        let path = self.stage_path();
        path_fault(&path).map(|fault| format!("{}: {fault}", path.display()))
    }

    /// Writes the files that list `frames` (such as `.json` and `.pvd`), and replaces earlier ones.
    /// The frames must be sorted by number.
    ///
    /// # Errors
    /// If a file cannot be written or replaced.
    pub fn write(&self, frames: &[SeriesFrame]) -> Result<(), WriteError> {
        let Timeline { codes_per_second, frames: times } = Timeline::of(frames, self.fps);
        let shown: Vec<(&SeriesFrame, FrameTime)> = frames.iter().zip(times).collect();
        for path in self.files() {
            let text = self.text(&path, &shown, codes_per_second);
            replace_small(&path, text.as_bytes()).map_err(|fault| WriteError::new(&path, fault))?;
        }
        Ok(())
    }

    /// The times, in seconds, that an Alembic archive stores for `frames`. `frames` must be sorted
    /// by number.
    ///
    /// If the frame rate is given, or implied by the times of the frames, a time that is close to a
    /// whole number of frames is rounded to this number of frames. If neither the times nor the
    /// frame rate are known, there are 24 frames per second.
    #[must_use]
    pub fn times(&self, frames: &[SeriesFrame]) -> Vec<f64> {
        Timeline::of(frames, self.fps).frames.into_iter().map(|frame| frame.seconds).collect()
    }

    /// The reason why the lists ignore the times of `frames`. `None` if the lists use the times, or
    /// if the frames have no times. The frames must be sorted by number.
    #[must_use]
    pub fn unused_times(&self, frames: &[SeriesFrame]) -> Option<UnusedTimes> {
        Timeline::unused_times(frames, self.fps)
    }

    fn text(
        &self,
        path: &Path,
        shown: &[(&SeriesFrame, FrameTime)],
        codes_per_second: f64,
    ) -> String {
        let extension =
            path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        match extension {
            "json" => self.listing(shown),
            "pvd" => pvd(shown),
            "series" => file_series(shown),
            _ if path == self.manifest_path() => self.manifest(shown).text(),
            _ => self.stage(shown, codes_per_second),
        }
    }

    fn listing(&self, shown: &[(&SeriesFrame, FrameTime)]) -> String {
        let has_stage = matches!(self.format, MeshFormat::Usdc(_));
        let listed = |&(frame, FrameTime { time, code, .. }): &(&SeriesFrame, FrameTime)| {
            let frame = SeriesFrame { time: Some(time), ..frame.clone() };
            ListedFrame { frame, time_code: has_stage.then_some(code) }
        };
        let frames: Vec<ListedFrame> = shown.iter().map(listed).collect();
        format!("{:#}\n", json!({ "fps": self.fps, "up": self.up.to_string(), "frames": frames }))
    }

    fn stage(&self, shown: &[(&SeriesFrame, FrameTime)], codes_per_second: f64) -> String {
        let clips: Vec<_> =
            shown.iter().map(|(frame, time)| (time.code, frame.file.clone())).collect();
        stage(&clips, &self.manifest(shown), codes_per_second, self.up)
    }

    fn manifest(&self, shown: &[(&SeriesFrame, FrameTime)]) -> Manifest {
        let mut attributes: Vec<AttributeInfo> = Vec::new();
        for attribute in shown.iter().flat_map(|(frame, _)| &frame.attributes) {
            if attributes.iter().all(|known| known.name != attribute.name) {
                attributes.push(attribute.clone());
            }
        }
        let path = self.manifest_path();
        Manifest {
            path: path
                .file_name()
                .map(|name| name.to_string_lossy().into_owned())
                .unwrap_or_default(),
            normals: shown.iter().any(|(frame, _)| frame.normals),
            attributes,
        }
    }
}

fn pvd(shown: &[(&SeriesFrame, FrameTime)]) -> String {
    let data_set = |(frame, FrameTime { time, .. }): &(&SeriesFrame, FrameTime)| {
        format!("<DataSet timestep=\"{time}\" part=\"0\" file=\"{}\"/>\n", escaped(&frame.file))
    };
    let all: String = shown.iter().map(data_set).collect();
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\">\n<Collection>\n{all}\
         </Collection>\n</VTKFile>\n"
    )
}

fn file_series(shown: &[(&SeriesFrame, FrameTime)]) -> String {
    let file = |(frame, FrameTime { time, .. }): &(&SeriesFrame, FrameTime)| json!({ "name": frame.file, "time": time });
    let files: Vec<_> = shown.iter().map(file).collect();
    format!("{:#}\n", json!({ "file-series-version": "1.0", "files": files }))
}
