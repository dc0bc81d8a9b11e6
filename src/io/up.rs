//! The axis that points up, in files whose format cannot store it: in a comment or a title.
//!
//! Only z is recorded; without a record y points up, as most programs expect. `.ply`, `.obj`,
//! `.vtk`, `.vtp`, `.pvtp` and `.stl` have comments or titles; the listing of a simulation records
//! it for all formats.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::surface::mesh::source::MeshSource;

use super::{UpAxis, series};

/// The text of the comment, without the delimiters of a format.
const NOTE: &str = "meniscus: z points up";
/// Bytes at the start of a file in which the comment is searched.
const SEARCHED: u64 = 512;

/// The comment for a mesh, if it needs one.
pub(super) fn note(mesh: &dyn MeshSource) -> Option<&'static str> {
    (mesh.up() == UpAxis::Z).then_some(NOTE)
}

/// The comment for a mesh with the delimiters of a format, or nothing.
pub(super) fn noted(mesh: &dyn MeshSource, [before, after]: [&str; 2]) -> String {
    note(mesh).map_or(String::new(), |note| format!("{before}{note}{after}"))
}

/// The up axis in a mesh's file or in a list next to it; `None` if neither has it.
#[must_use]
pub fn up_said(mesh: &Path) -> Option<UpAxis> {
    let noted = || {
        let mut begins = Vec::new();
        File::open(mesh).ok()?.take(SEARCHED).read_to_end(&mut begins).ok()?;
        let mut places = begins.windows(NOTE.len());
        places.any(|place| place == NOTE.as_bytes()).then_some(UpAxis::Z)
    };
    // Reading a pipe would consume its data.
    mesh.is_file().then(|| noted().or_else(|| series::listed_up(mesh))).flatten()
}
