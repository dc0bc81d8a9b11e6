//! Writes .ply files.

use std::io::{self, Write};

use crate::io::CoordinateWidth;
use crate::io::encode::{put_position, write_triangles, write_vertices};
use crate::io::up::delimited_up_comment;
use crate::particles::kind::COMPONENT_NAMES;
use crate::particles::{AttributeInfo, AttributeKind, colour_attribute};
use crate::surface::mesh::source::MeshSource;

use super::{GROUPS, NORMAL};

/// Size, in bytes, of a face: one byte for the number of corners, and three vertex indices.
const FACE: usize = 1 + 3 * size_of::<u32>();

/// Writes `mesh` in little-endian binary.
///
/// Each vertex has x, y and z, as float or double according to `width`, then nx, ny and nz if the
/// mesh has normals, and vx, vy and vz for an attribute `velocity` of three components. The first
/// colour is written as bytes red, green, blue and optionally alpha. Other attributes are written
/// as the property `name`, or as `name_0`, `name_1` and so on. Faces are lists of three vertex
/// indices.
///
/// The format cannot store white space in a name, so underscores replace it. Underscores are
/// appended to a name that is empty or already used.
///
/// # Panics
/// Like [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
) -> io::Result<()> {
    out.write_all(header(mesh, width).as_bytes())?;
    let infos = mesh.attributes();
    write_vertices(out, mesh, |vertices, out| {
        out.reserve(vertices.positions.len() * 3 * size_of::<f64>());
        for (vertex, position) in vertices.positions.iter().enumerate() {
            put_position(out, *position, width);
            if let Some(normal) = vertices.normals.get(vertex) {
                out.extend(normal.map(f32::to_le_bytes).as_flattened());
            }
            for (values, info) in vertices.attributes.iter().zip(&infos) {
                let values = &values[vertex * info.components..][..info.components];
                if info.kind.is_colour() {
                    out.extend(values.iter().map(|&value| info.kind.byte(value)));
                } else {
                    values.iter().for_each(|value| out.extend(value.to_le_bytes()));
                }
            }
        }
    })?;
    write_triangles(out, mesh, |triangles, out| {
        let first = out.len();
        // Each face starts with its number of corners, 3. First, all bytes are set to 3. Then the
        // indices are written over them.
        out.resize(first + triangles.len() * FACE, 3);
        for (face, corners) in out[first..].as_chunks_mut::<FACE>().0.iter_mut().zip(triangles) {
            face[1..].copy_from_slice(
                corners.map(|corner| (corner as u32).to_le_bytes()).as_flattened(),
            );
        }
    })
}

fn header(mesh: &dyn MeshSource, width: CoordinateWidth) -> String {
    let coordinate = match width {
        CoordinateWidth::F32 => "float",
        CoordinateWidth::F64 => "double",
    };
    // Prefer int, which all programs support. Up to i32::MAX, int and uint have the same bytes.
    let index = if mesh.vertex_count() <= i32::MAX as u64 { "int" } else { "uint" };
    let infos = mesh.attributes();
    let normals = if mesh.has_normals() { 3 } else { 0 };
    let stored = |info: &AttributeInfo| match info.kind {
        AttributeKind::Signed | AttributeKind::Wide => "int",
        AttributeKind::Unsigned => "uint",
        kind if kind.is_colour() => "uchar",
        _ => "float",
    };
    let kinds = std::iter::repeat_n(coordinate, 3)
        .chain(std::iter::repeat_n("float", normals))
        .chain(infos.iter().flat_map(|info| std::iter::repeat_n(stored(info), info.components)));
    let lines: String = kinds
        .zip(property_names(mesh))
        .map(|(kind, name)| format!("property {kind} {name}\n"))
        .collect();
    format!(
        "ply\nformat binary_little_endian 1.0\n{}element vertex {}\n{lines}element face {}\n\
         property list uchar {index} vertex_indices\nend_header\n",
        delimited_up_comment(mesh, ["comment ", "\n"]),
        mesh.vertex_count(),
        mesh.triangle_count(),
    )
}

/// Names of the attributes, without suffixes for components.
pub(in crate::io) fn attribute_names(
    attributes: &[AttributeInfo],
    has_normals: bool,
) -> Vec<String> {
    named_properties(attributes, has_normals).into_iter().map(|(name, _)| name).collect()
}

/// Names of the properties of `vertex`. All of them are different.
fn property_names(mesh: &dyn MeshSource) -> Vec<String> {
    let properties = named_properties(&mesh.attributes(), mesh.has_normals())
        .into_iter()
        .flat_map(|(_, names)| names);
    fixed_properties(mesh.has_normals()).into_iter().chain(properties).collect()
}

fn group(name: &str) -> Option<Vec<String>> {
    let (_, members) = GROUPS.iter().find(|(group, _)| *group == name)?;
    Some(members.map(str::to_owned).to_vec())
}

/// The property names of positions and normals.
fn fixed_properties(has_normals: bool) -> Vec<String> {
    let normals = if has_normals { group(NORMAL) } else { None };
    ["x", "y", "z"].map(str::to_owned).into_iter().chain(normals.into_iter().flatten()).collect()
}

/// For each attribute, its name in the file and the names of its properties.
fn named_properties(attributes: &[AttributeInfo], has_normals: bool) -> Vec<(String, Vec<String>)> {
    let mut taken = fixed_properties(has_normals);
    let colour = colour_attribute(attributes);
    let shares =
        |components| COMPONENT_NAMES[..components].iter().map(ToString::to_string).collect();
    let name = |(index, info): (usize, &AttributeInfo)| {
        let AttributeInfo { name, components, .. } = info;
        let grouped = group(name).filter(|_| *components == 3);
        let grouped = if colour == Some(index) { Some(shares(*components)) } else { grouped };
        let mut base = name.replace(|c: char| c.is_whitespace() || c.is_control(), "_");
        let mut names = grouped.unwrap_or_else(|| numbered(&base, *components));
        while base.is_empty() || names.iter().any(|name| taken.contains(name)) {
            base.push('_');
            names = numbered(&base, *components);
        }
        taken.extend(names.clone());
        (base, names)
    };
    attributes.iter().enumerate().map(name).collect()
}

fn numbered(base: &str, components: usize) -> Vec<String> {
    match components {
        1 => vec![base.to_owned()],
        _ => (0..components).map(|i| format!("{base}_{i}")).collect(),
    }
}
