//! Files that tell other programs of a sequence's frames: rewritten, whole or not at all, after each frame, so that
//! an unfinished sequence can be looked at and a killed one goes on.
//!
//! | meshes | files beside them |
//! |---|---|
//! | all | `STEM.frames.json`: each frame's file, time, counts and box |
//! | .vtp | `STEM.pvd` and `STEM.vtp.series` for ParaView |
//! | .vtk, .ply, .stl | `STEM.vtk.series` and the like for ParaView |
//! | .usdc | `STEM.usda`, a stage of value clips, and `STEM.manifest.usda`, what the clips hold |

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::mesh::source::MeshSource;
use crate::particles::AttributeInfo;

use super::output::MeshFormat;
use super::usd::stage::{Manifest, stage};
use super::vtp::escaped;
use super::whole::{Replace, WholeFile};
use super::{ReadError, ReadFault, UpAxis, WriteError, WriteFault};

/// Time codes closer to a whole one than this are that.
const WHOLE: f64 = 1e-6;

/// A frame whose mesh is written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeriesFrame {
    /// The mesh's file.
    pub file: PathBuf,
    /// In seconds.
    pub time: f64,
    /// Of the mesh.
    pub vertices: u64,
    /// Of the mesh.
    pub triangles: u64,
    /// The mesh's box, where it is known.
    pub bounds: Option<[[f64; 3]; 2]>,
    normals: bool,
    attributes: Vec<Attribute>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Attribute {
    name: String,
    components: usize,
}

impl SeriesFrame {
    /// Of `mesh`, which was written to `file`.
    #[must_use]
    pub fn new(file: PathBuf, time: f64, mesh: &dyn MeshSource, bounds: Option<[[f64; 3]; 2]>) -> Self {
        let attribute = |AttributeInfo { name, components }| Attribute { name, components };
        Self {
            file,
            time,
            vertices: mesh.vertex_count(),
            triangles: mesh.triangle_count(),
            bounds,
            normals: mesh.has_normals(),
            attributes: mesh.attributes().into_iter().map(attribute).collect(),
        }
    }
}

/// What holds for all frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeriesFacts {
    /// USD's time codes in a second.
    pub frames_per_second: f64,
    /// Of the positions as they are written.
    pub up: UpAxis,
}

/// The frames of a sequence so far, and the files that list them.
#[derive(Debug)]
pub struct Series {
    format: MeshFormat,
    /// What the files' names start with, folder included.
    stem: PathBuf,
    facts: SeriesFacts,
    /// By time.
    frames: Vec<SeriesFrame>,
}

#[derive(Serialize, Deserialize)]
struct Listing {
    frames_per_second: f64,
    up: String,
    frames: Vec<SeriesFrame>,
}

impl Series {
    /// None so far. Nothing is written before the first frame.
    #[must_use]
    pub fn new(format: MeshFormat, stem: &Path, facts: SeriesFacts) -> Self {
        Self { format, stem: stem.to_owned(), facts, frames: Vec::new() }
    }

    /// The frames so far, by time.
    #[must_use]
    pub fn frames(&self) -> &[SeriesFrame] {
        &self.frames
    }

    /// The files that [`tell`](Self::tell) writes; the first lists all that is known.
    #[must_use]
    pub fn files(&self) -> Vec<PathBuf> {
        let endings: &[&str] = match self.format {
            MeshFormat::Vtp => &["frames.json", "pvd", "vtp.series"],
            MeshFormat::Vtk => &["frames.json", "vtk.series"],
            MeshFormat::Ply => &["frames.json", "ply.series"],
            MeshFormat::Obj | MeshFormat::Glb(_) => &["frames.json"],
            MeshFormat::Stl => &["frames.json", "stl.series"],
            MeshFormat::Usdc => &["frames.json", "manifest.usda", "usda"],
        };
        endings.iter().map(|ending| self.file(ending)).collect()
    }

    fn file(&self, ending: &str) -> PathBuf {
        let mut name = self.stem.clone().into_os_string();
        name.push(".");
        name.push(ending);
        name.into()
    }

    /// Takes up the frames that an earlier run told of, as far as their files are still there.
    ///
    /// # Errors
    /// Where the listing cannot be read, or is none.
    pub fn resume(&mut self) -> Result<(), ReadError> {
        let path = self.file("frames.json");
        let fail = |fault| ReadError::new(&path, fault);
        let bytes = match fs::read(&path) {
            Err(fault) if fault.kind() == io::ErrorKind::NotFound => return Ok(()),
            bytes => bytes.map_err(|fault| fail(fault.into()))?,
        };
        let listing: Listing = serde_json::from_slice(&bytes).map_err(|fault| {
            let line = fault.line() as u64;
            fail(ReadFault::Line { line, what: format!("no listing of frames: {fault}") })
        })?;
        let folder = self.folder().to_owned();
        for mut frame in listing.frames {
            frame.file = folder.join(frame.file);
            if frame.file.exists() {
                self.insert(frame);
            }
        }
        Ok(())
    }

    /// Adds a frame, in place of one with the same file, and rewrites every file. Frames may come in any order.
    ///
    /// # Errors
    /// What [`WholeFile`] refuses, and [`WriteFault::Unsupported`] for a time that is no number or a file's name that
    /// is no text; the frame is kept then, and written with the next.
    pub fn tell(&mut self, frame: SeriesFrame) -> Result<(), WriteError> {
        if !frame.time.is_finite() {
            let fault = WriteFault::Unsupported(format!("a frame at the time {}", frame.time));
            return Err(WriteError::new(&frame.file, fault));
        }
        self.insert(frame);
        let names = self.names()?;
        for path in self.files() {
            let text = self.text(&path, &names);
            WholeFile::prepare(&path, Replace::Allow)?.write(|out| out.write_all(text.as_bytes()))?;
        }
        Ok(())
    }

    fn insert(&mut self, frame: SeriesFrame) {
        self.frames.retain(|other| other.file != frame.file);
        let before = |other: &SeriesFrame| (other.time, &other.file) < (frame.time, &frame.file);
        self.frames.insert(self.frames.partition_point(before), frame);
    }

    fn folder(&self) -> &Path {
        self.stem.parent().unwrap_or(Path::new(""))
    }

    /// The frames' files as the listings name them: relative to their folder, with slashes.
    fn names(&self) -> Result<Vec<String>, WriteError> {
        let name = |frame: &SeriesFrame| {
            let file = frame.file.strip_prefix(self.folder()).unwrap_or(&frame.file);
            let text = file.to_str().map(|text| text.replace(std::path::MAIN_SEPARATOR, "/"));
            let fault = || WriteFault::Unsupported("a name that is no text cannot be listed".to_owned());
            text.ok_or_else(|| WriteError::new(&frame.file, fault()))
        };
        self.frames.iter().map(name).collect()
    }

    fn text(&self, path: &Path, names: &[String]) -> String {
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        match extension {
            "json" => self.listing(names),
            "pvd" => self.pvd(names),
            "series" => self.file_series(names),
            _ if path == self.file("usda") => self.stage(names),
            _ => self.manifest().text(),
        }
    }

    fn listing(&self, names: &[String]) -> String {
        let named = self.frames.iter().zip(names);
        let listing = Listing {
            frames_per_second: self.facts.frames_per_second,
            up: format!("{:?}", self.facts.up),
            frames: named.map(|(frame, name)| SeriesFrame { file: name.into(), ..frame.clone() }).collect(),
        };
        serde_json::to_string_pretty(&listing).expect("text and finite numbers") + "\n"
    }

    fn pvd(&self, names: &[String]) -> String {
        let data_set = |(frame, name): (&SeriesFrame, &String)| {
            format!("<DataSet timestep=\"{}\" part=\"0\" file=\"{}\"/>\n", frame.time, escaped(name))
        };
        let all: String = self.frames.iter().zip(names).map(data_set).collect();
        format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\">\n<Collection>\n{all}\
             </Collection>\n</VTKFile>\n"
        )
    }

    fn file_series(&self, names: &[String]) -> String {
        let file =
            |(frame, name): (&SeriesFrame, &String)| serde_json::json!({ "name": name, "time": frame.time });
        let files: Vec<_> = self.frames.iter().zip(names).map(file).collect();
        format!("{:#}\n", serde_json::json!({ "file-series-version": "1.0", "files": files }))
    }

    fn stage(&self, names: &[String]) -> String {
        let code = |time: f64| {
            let code = time * self.facts.frames_per_second;
            if (code - code.round()).abs() < WHOLE { code.round() } else { code }
        };
        let clips = self.frames.iter().zip(names).map(|(frame, name)| (code(frame.time), name.clone()));
        stage(&clips.collect::<Vec<_>>(), &self.manifest(), self.facts.frames_per_second, self.facts.up)
    }

    fn manifest(&self) -> Manifest {
        let mut attributes: Vec<AttributeInfo> = Vec::new();
        for Attribute { name, components } in self.frames.iter().flat_map(|frame| &frame.attributes) {
            if attributes.iter().all(|known| known.name != *name) {
                attributes.push(AttributeInfo { name: name.clone(), components: *components });
            }
        }
        let path = self.file("manifest.usda");
        Manifest {
            path: path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
            normals: self.frames.iter().any(|frame| frame.normals),
            attributes,
        }
    }
}
