//! Records which axis points up, in the comment or title of a file whose format cannot store the
//! axis.
//!
//! Only z is recorded. Without a record, y points up, as most programs expect. `.ply`, `.obj`,
//! `.vtk`, `.vtp`, `.pvtp` and `.stl` have comments or titles. For all formats, the .json list of a
//! simulation's frames also records the axis.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::surface::mesh::source::MeshSource;

use super::{UpAxis, series};

/// The text of the comment, without the delimiters of a format.
const NOTE: &str = "meniscus: z points up";
/// Number of bytes at the start of a file that are searched for the comment.
const SEARCHED: u64 = 512;

/// The comment for the file of `mesh`, if its up axis is z.
pub(super) fn note(mesh: &dyn MeshSource) -> Option<&'static str> {
    (mesh.up() == UpAxis::Z).then_some(NOTE)
}

/// The comment for the file of `mesh` with a format's delimiters, or an empty string if y is up.
pub(super) fn noted(mesh: &dyn MeshSource, [before, after]: [&str; 2]) -> String {
    note(mesh).map_or(String::new(), |note| format!("{before}{note}{after}"))
}

/// The up axis that a mesh's file, or else a list next to it, records. `None` if neither records
/// it.
#[must_use]
pub fn recorded_up(mesh: &Path) -> Option<UpAxis> {
    let noted = || {
        let mut begins = Vec::new();
        File::open(mesh).ok()?.take(SEARCHED).read_to_end(&mut begins).ok()?;
        let mut places = begins.windows(NOTE.len());
        places.any(|place| place == NOTE.as_bytes()).then_some(UpAxis::Z)
    };
    // Reading a pipe would consume its data.
    mesh.is_file().then(|| noted().or_else(|| series::listed_up(mesh))).flatten()
}
