//! Writes legacy .vtk files.

use std::io::{self, Write};

use crate::io::CoordinateWidth;
use crate::io::encode::{write_attribute, write_triangles, write_vertices};
use crate::io::names::unique_names;
use crate::io::up::up_comment;
use crate::particles::{AttributeInfo, AttributeKind};
use crate::surface::mesh::source::{MeshSource, Vertices};

/// Writes `mesh` as binary POLYDATA of version 3.0.
///
/// The file contains POINTS of type float or double, according to `width`, and POLYGONS. POINT_DATA
/// contains normals as NORMALS, an attribute `velocity` of three components as VECTORS, and all
/// other attributes as FIELD, because programs show only the first of several SCALARS. Colours are
/// unsigned_char.
///
/// # Panics
/// Like [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
) -> io::Result<()> {
    write_points(out, mesh, width)?;
    write_polygons(out, mesh)?;
    let attributes = mesh.attributes();
    if !mesh.has_normals() && attributes.is_empty() {
        return Ok(());
    }
    writeln!(out, "POINT_DATA {}", mesh.vertex_count())?;
    if mesh.has_normals() {
        writeln!(out, "NORMALS Normals float")?;
        write_floats(out, mesh, |vertices| vertices.normals.as_flattened())?;
    }
    let velocity = attributes.iter().position(AttributeInfo::is_velocity);
    if let Some(velocity) = velocity {
        writeln!(out, "VECTORS velocity float")?;
        write_floats(out, mesh, |vertices| &vertices.attributes[velocity])?;
    }
    let others = attributes.len() - usize::from(velocity.is_some());
    if others > 0 {
        writeln!(out, "FIELD FieldData {others}")?;
    }
    let names = attribute_names(&attributes, mesh.has_normals());
    for (index, (name, info)) in names.iter().zip(&attributes).enumerate() {
        if Some(index) == velocity {
            continue;
        }
        let scalar = match info.kind {
            AttributeKind::Signed | AttributeKind::Wide => "int",
            AttributeKind::Unsigned => "unsigned_int",
            kind if kind.is_colour() => "unsigned_char",
            _ => "float",
        };
        let (name, components) = (encoded(name), info.components);
        writeln!(out, "{name} {components} {} {scalar}", mesh.vertex_count())?;
        if info.kind.is_colour() {
            write_attribute(out, mesh, index)?;
            writeln!(out)?;
        } else {
            write_floats(out, mesh, |vertices| &vertices.attributes[index])?;
        }
    }
    Ok(())
}

fn write_points(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
) -> io::Result<()> {
    let scalar = match width {
        CoordinateWidth::F32 => "float",
        CoordinateWidth::F64 => "double",
    };
    let title = up_comment(mesh).unwrap_or("meniscus surface");
    writeln!(out, "# vtk DataFile Version 3.0\n{title}\nBINARY\nDATASET POLYDATA")?;
    writeln!(out, "POINTS {} {scalar}", mesh.vertex_count())?;
    write_vertices(out, mesh, |vertices, out| {
        for position in &*vertices.positions {
            match width {
                CoordinateWidth::F32 => {
                    out.extend(position.map(|c| (c as f32).to_be_bytes()).as_flattened())
                }
                CoordinateWidth::F64 => out.extend(position.map(f64::to_be_bytes).as_flattened()),
            }
        }
    })?;
    writeln!(out)
}

/// Writes POLYGONS if there are triangles. VTK's reader rejects an empty section.
fn write_polygons(out: &mut dyn Write, mesh: &dyn MeshSource) -> io::Result<()> {
    let triangles = mesh.triangle_count();
    if triangles == 0 {
        return Ok(());
    }
    writeln!(out, "POLYGONS {triangles} {}", 4 * triangles)?;
    write_triangles(out, mesh, |triangles, out| {
        for &[a, b, c] in triangles {
            out.extend([3, a as u32, b as u32, c as u32].map(u32::to_be_bytes).as_flattened());
        }
    })?;
    writeln!(out)
}

fn write_floats(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    values: impl for<'a> Fn(&'a Vertices) -> &'a [f32] + Sync,
) -> io::Result<()> {
    write_vertices(out, mesh, |vertices, out| {
        for value in values(vertices) {
            out.extend(value.to_be_bytes());
        }
    })?;
    writeln!(out)
}

/// Names of the attributes in the file. The name of the normals is not used for attributes.
pub(in crate::io) fn attribute_names(
    attributes: &[AttributeInfo],
    has_normals: bool,
) -> Vec<String> {
    let taken: &[&str] = if has_normals { &["Normals"] } else { &[] };
    // A name in the file must be a word, so it must not be empty.
    let spelled = |name: &str| if name.is_empty() { "_".into() } else { name.to_owned() };
    unique_names(attributes.iter().map(|info| &*info.name), taken, spelled)
}

/// Encodes a name as one word, with percent codes.
fn encoded(name: &str) -> String {
    let name = if name.is_empty() { "_" } else { name };
    let plain = |byte: &u8| byte.is_ascii_graphic() && !matches!(byte, b'%' | b'"');
    name.bytes()
        .map(|b| if plain(&b) { char::from(b).to_string() } else { format!("%{b:02X}") })
        .collect()
}
