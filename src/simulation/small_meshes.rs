//! Small meshes next to the state: coarse copies of meshes whose format this library cannot read,
//! for the contact sheet.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::io::output::MeshFormat;
use crate::io::whole::{make_folder, replace_small, sweep};
use crate::io::{CoordinateWidth, WriteError};
use crate::surface::mesh::Mesh;
use crate::surface::mesh::clustered::{BYTES_PER_VERTEX, clustered};
use crate::surface::mesh::source::{Corners, MeshSource};

/// Number of cells along the longest edge of a mesh's bounding box: about one cell per two pixels
/// of a picture on a sheet.
const CELLS: u32 = 160;

/// The folder with one `.ply` file for each frame.
#[derive(Debug)]
pub(super) struct SmallMeshes(PathBuf);

impl SmallMeshes {
    /// The small meshes in `state`, which is the folder of a simulation's state. Does not create
    /// their folder.
    pub(super) fn beside(state: &Path) -> Self {
        Self(state.join("small"))
    }

    /// The file of a frame's small mesh, which may not exist.
    pub(super) fn path(&self, frame: i64) -> PathBuf {
        self.0.join(format!("{frame}.ply"))
    }

    /// Removes the temporary files that killed processes left.
    pub(super) fn sweep(&self) {
        sweep(&self.0);
    }

    /// Makes a small copy of `mesh`, whose bounding box is `bounds`, and returns the bytes of its
    /// file. Returns `None` if this would need more than `memory` bytes.
    ///
    /// # Errors
    /// If the mesh cannot be read from its scratch file.
    pub(super) fn of(
        mesh: &dyn MeshSource,
        bounds: Option<Corners>,
        memory: u64,
    ) -> std::io::Result<Option<Vec<u8>>> {
        let small = match bounds {
            None => Mesh::default(),
            Some(_) if mesh.vertex_count().saturating_mul(BYTES_PER_VERTEX) > memory => {
                return Ok(None);
            }
            Some(bounds) => clustered(mesh, bounds, CELLS)?,
        };
        let mut file = Vec::new();
        MeshFormat::Ply.write(&mut file, &small, CoordinateWidth::F64)?;
        Ok(Some(file))
    }

    /// Stores `file`, the bytes of a frame's small mesh, and replaces an earlier file. If `file` is
    /// `None`, removes the earlier file, because it shows an older mesh.
    ///
    /// # Errors
    /// If the file cannot be written or removed.
    pub(super) fn store(&self, frame: i64, file: Option<&[u8]>) -> Result<(), WriteError> {
        let path = self.path(frame);
        let stored = match file {
            Some(file) => make_folder(&self.0).and_then(|()| replace_small(&path, file)),
            None => fs::remove_file(&path).or_else(|fault| match fault.kind() {
                ErrorKind::NotFound | ErrorKind::NotADirectory => Ok(()),
                _ => Err(fault),
            }),
        };
        stored.map_err(|fault| WriteError::new(&path, fault))
    }
}
