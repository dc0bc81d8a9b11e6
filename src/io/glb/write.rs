//! Writes .glb files.

use std::io::{self, Write};

use serde_json::Value;

use crate::io::CoordinateWidth;
use crate::surface::mesh::ordered::OrderedMesh;
use crate::surface::mesh::source::MeshSource;

use super::document::{aligned, document, empty_document};
use super::view::{GlbView, Space, views};
use super::{GlbCompression, GlbLayout, grid_step};

/// Writes `mesh` with `layout`. Without compression, the data is streamed, and the writer needs 4
/// bytes of memory per vertex. With compression, all data is held in memory.
///
/// Positions are f32. With [`CoordinateWidth::F64`], they are relative to the centre of the mesh's
/// bounding box, and the node moves the mesh to this centre. Colours are written as COLOR_0,
/// COLOR_1 and so on, with values from 0 to 1 and without conversion of the colour space. Other
/// attributes are named in upper case with a leading underscore. Attributes with more than four
/// components are left out.
///
/// # Errors
/// The errors of `mesh` and `out`. [`io::ErrorKind::InvalidInput`], before anything is written, if
/// the file would take 4 GiB or more.
///
/// # Panics
/// Like [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
    layout: GlbLayout,
) -> io::Result<()> {
    if mesh.triangle_count() == 0 {
        return write_header(out, &empty_document(), 0);
    }
    let mesh = OrderedMesh::new(mesh)?;
    let [lo, hi] = mesh.bounds().unwrap_or_default();
    let space = match (layout.compression, width) {
        (GlbCompression::Meshopt, _) => {
            let step = grid_step((0..3).map(|axis| hi[axis] - lo[axis]).fold(0.0, f64::max));
            Space { origin: lo.map(|x| (x / step).floor() * step), step }
        }
        (GlbCompression::None, CoordinateWidth::F32) => Space { origin: [0.0; 3], step: 1.0 },
        (GlbCompression::None, CoordinateWidth::F64) => {
            Space { origin: std::array::from_fn(|axis| (lo[axis] + hi[axis]) / 2.0), step: 1.0 }
        }
    };
    let views = views(&mesh, layout.compression);
    let encoded = match layout.compression {
        GlbCompression::None => None,
        GlbCompression::Meshopt => Some(
            views
                .iter()
                .map(|view| view.encoded(&mesh, space))
                .collect::<io::Result<Vec<Vec<u8>>>>()?,
        ),
    };
    let lengths: Option<Vec<u64>> =
        encoded.as_ref().map(|all| all.iter().map(|bytes| bytes.len() as u64).collect());
    let document = document(layout, space, [lo, hi], &views, lengths.as_deref());
    let stored = match lengths {
        None => views.iter().map(GlbView::bytes).sum(),
        Some(lengths) => lengths.into_iter().map(aligned).sum(),
    };
    write_header(out, &document, stored)?;
    match encoded {
        None => views.iter().try_for_each(|view| view.write(out, &mesh, space)),
        Some(encoded) => encoded.iter().try_for_each(|bytes| {
            out.write_all(bytes)?;
            out.write_all(&[0; 3][..(aligned(bytes.len() as u64) - bytes.len() as u64) as usize])
        }),
    }
}

/// Writes the header and the JSON `document`, which precede the `stored` bytes of data.
fn write_header(out: &mut dyn Write, document: &Value, stored: u64) -> io::Result<()> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let binary = if stored > 0 { 8 + stored } else { 0 };
    let total = 12 + 8 + json.len() as u64 + binary;
    let Ok(total) = u32::try_from(total) else {
        let what = format!(
            "the mesh needs {total} bytes, but a .glb file stores at most 4 GiB; write .ply, \
             .obj or .vtp"
        );
        return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
    };
    out.write_all(b"glTF")?;
    for word in [2, total, json.len() as u32] {
        out.write_all(&word.to_le_bytes())?;
    }
    out.write_all(b"JSON")?;
    out.write_all(&json)?;
    if stored > 0 {
        out.write_all(&(stored as u32).to_le_bytes())?;
        out.write_all(b"BIN\0")?;
    }
    Ok(())
}
