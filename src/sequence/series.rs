//! Files that list the frames of a sequence for other programs, rewritten whole as frames are done.

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::io::WriteError;
use crate::io::whole::replace_small;

use super::state::Record;

/// A frame that can be loaded.
#[derive(Debug, Clone, PartialEq)]
pub struct Listed {
    /// Its number.
    pub frame: u64,
    /// In seconds, or the number where nothing tells.
    pub time: f64,
    /// Name of its mesh, in the folder of the series.
    pub file: String,
    /// Size of the file.
    pub bytes: u64,
    /// Particles that were used.
    pub particles: u64,
    /// Of the mesh.
    pub vertices: u64,
    /// Of the mesh.
    pub triangles: u64,
}

impl Listed {
    /// A frame at the time that its file says, else at its number over `fps`, else at its number.
    #[must_use]
    pub fn of(record: &Record, fps: Option<f64>) -> Self {
        let number = record.frame as f64;
        Self {
            frame: record.frame,
            time: record.time.unwrap_or_else(|| fps.map_or(number, |fps| number / fps)),
            file: record.file.clone(),
            bytes: record.bytes,
            particles: record.particles,
            vertices: record.vertices,
            triangles: record.triangles,
        }
    }
}

/// A list of frames in a format of its own.
pub trait Series: Send {
    /// Writes the list of all frames that are done so far, in order, in place of the one before.
    ///
    /// # Errors
    /// Where the system refuses.
    fn write(&self, frames: &[Listed]) -> Result<(), WriteError>;
}

/// A list in JSON, for programs that know no other.
#[derive(Debug)]
pub struct Manifest {
    /// The file.
    pub path: PathBuf,
    /// Frames a second, where it was given.
    pub fps: Option<f64>,
}

impl Manifest {
    /// Beside the outputs of a sequence.
    #[must_use]
    pub fn beside(sequence: &Path, fps: Option<f64>) -> Self {
        let mut path = sequence.as_os_str().to_owned();
        path.push(".json");
        Self { path: path.into(), fps }
    }
}

impl Series for Manifest {
    fn write(&self, frames: &[Listed]) -> Result<(), WriteError> {
        let frames: Vec<_> = frames
            .iter()
            .map(|listed| {
                let Listed { frame, time, file, bytes, particles, vertices, triangles } = listed;
                json!({
                    "frame": frame,
                    "time": time,
                    "file": file,
                    "bytes": bytes,
                    "particles": particles,
                    "vertices": vertices,
                    "triangles": triangles,
                })
            })
            .collect();
        let manifest = json!({ "fps": self.fps, "frames": frames });
        let text = serde_json::to_vec_pretty(&manifest).expect("string keys and finite depth");
        replace_small(&self.path, &text).map_err(|fault| WriteError::new(&self.path, fault))
    }
}
