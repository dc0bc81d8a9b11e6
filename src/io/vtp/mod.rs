//! .vtp: PolyData in VTK's XML, the numbers behind it as they are ("appended raw").
//!
//! Each array is named in the XML with its type and where it lies; after `<AppendedData encoding="raw">` and an
//! underscore come its length in bytes and its numbers. What other programs write is read as far as it is
//! appended raw or text; compressed and base64 data are refused by name.

mod read;
mod write;

pub use read::read_mesh;
pub use write::write_mesh;

/// What the array of normals is called.
const NORMALS: &str = "Normals";
