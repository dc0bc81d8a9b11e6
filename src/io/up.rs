//! Records which axis points up, in the comment or title of a file whose format cannot store the
//! axis.
//!
//! The comment is written only if z points up. Without a record of the axis, y points up, as most
//! programs expect. `.ply`, `.obj`, `.vtk`, `.vtp`, `.pvtp`, `.stl` and `.bgeo.sc` have comments or
//! titles. For all formats, the .json list of a simulation's frames also records the axis.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::surface::mesh::source::MeshSource;

use super::bytes::open_bytes;
use super::input_format::InputFormat;
use super::{UpAxis, houdini, series};

/// The text of the comment, without the delimiters of a format.
const NOTE: &str = "meniscus: z points up";
/// Number of bytes at the start of a file that are searched for the comment.
const SEARCHED: usize = 512;

/// The comment for the file of `mesh`, if its up axis is z.
pub(super) fn up_comment(mesh: &dyn MeshSource) -> Option<&'static str> {
    (mesh.up() == UpAxis::Z).then_some(NOTE)
}

/// The comment for the file of `mesh` with a format's delimiters, or an empty string if y is up.
pub(super) fn delimited_up_comment(mesh: &dyn MeshSource, [before, after]: [&str; 2]) -> String {
    up_comment(mesh).map_or(String::new(), |note| format!("{before}{note}{after}"))
}

/// The up axis that is recorded in a mesh's file or, if not there, in a list next to the file.
/// `None` if neither the file nor a list records the axis.
#[must_use]
pub fn recorded_up(mesh: &Path) -> Option<UpAxis> {
    let recorded_in_file = || {
        let begins = match InputFormat::of(mesh) {
            Some(InputFormat::Bgeo) => {
                houdini::first_bytes(open_bytes(mesh).ok()?.view(), SEARCHED)
            }
            _ => {
                let mut begins = Vec::new();
                File::open(mesh).ok()?.take(SEARCHED as u64).read_to_end(&mut begins).ok()?;
                begins
            }
        };
        let mut places = begins.windows(NOTE.len());
        places.any(|place| place == NOTE.as_bytes()).then_some(UpAxis::Z)
    };
    // Read only regular files, because reading a pipe would consume its data.
    mesh.is_file().then(|| recorded_in_file().or_else(|| series::listed_up(mesh))).flatten()
}
