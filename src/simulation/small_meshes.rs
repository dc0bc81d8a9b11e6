//! Small meshes beside the state: coarse copies of frames in a format that is not read again, which
//! a sheet of all frames is drawn of.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::io::output::MeshFormat;
use crate::io::whole::{make_folder, replace_small, sweep};
use crate::io::{CoordinateWidth, WriteError};
use crate::surface::mesh::Mesh;
use crate::surface::mesh::clustered::{BYTES_A_VERTEX, clustered};
use crate::surface::mesh::source::{Bounds, MeshSource};

/// Cells along the longest edge of a mesh: about one for every other pixel of a picture on a sheet.
const CELLS: u32 = 160;

/// The folder that holds them, a .ply of each frame.
#[derive(Debug)]
pub(super) struct SmallMeshes(PathBuf);

impl SmallMeshes {
    /// In the folder of a simulation's state; nothing is created yet.
    pub(super) fn beside(state: &Path) -> Self {
        Self(state.join("small"))
    }

    /// The small mesh of a frame, which may not be there.
    pub(super) fn path(&self, frame: i64) -> PathBuf {
        self.0.join(format!("{frame}.ply"))
    }

    /// Removes what killed processes have left half-written.
    pub(super) fn sweep(&self) {
        sweep(&self.0);
    }

    /// Makes the small mesh of a mesh in `bounds`; `None` where that takes more than `memory` bytes.
    ///
    /// # Errors
    /// Where the mesh cannot be read from where it is kept.
    pub(super) fn of(
        mesh: &dyn MeshSource,
        bounds: Option<Bounds>,
        memory: u64,
    ) -> std::io::Result<Option<Mesh>> {
        match bounds {
            None => Ok(Some(Mesh::default())),
            Some(_) if mesh.vertex_count().saturating_mul(BYTES_A_VERTEX) > memory => Ok(None),
            Some(bounds) => clustered(mesh, bounds, CELLS).map(Some),
        }
    }

    /// Keeps the small mesh of a frame in place of an earlier one; removes that where there is no
    /// other, for it is of another mesh.
    ///
    /// # Errors
    /// Those of the system.
    pub(super) fn keep(&self, frame: i64, mesh: Option<&Mesh>) -> Result<(), WriteError> {
        let path = self.path(frame);
        let kept = match mesh {
            Some(mesh) => {
                let mut bytes = Vec::new();
                make_folder(&self.0)
                    .and_then(|()| MeshFormat::Ply.write(&mut bytes, mesh, CoordinateWidth::F64))
                    .and_then(|()| replace_small(&path, &bytes))
            }
            None => fs::remove_file(&path).or_else(|fault| match fault.kind() {
                ErrorKind::NotFound | ErrorKind::NotADirectory => Ok(()),
                _ => Err(fault),
            }),
        };
        kept.map_err(|fault| WriteError::new(&path, fault))
    }
}
