//! Writing .ply files.

use std::io::{self, Write};

use crate::io::CoordinateWidth;
use crate::io::encode::write_chunks;
use crate::io::vertices::assert_complete;
use crate::mesh::Mesh;

use super::{GROUPS, NORMAL};

/// Writes `mesh` in little-endian binary: x, y, z as float or double by `width`; nx, ny, nz, and vx, vy, vz for
/// an attribute `velocity` of three components; further attributes as `name`, or `name_0`, `name_1`, ...;
/// and faces as lists of three.
///
/// A name that the format has no room for (white space, or one that is taken) is altered by underscores.
///
/// # Errors
/// Those of `out`.
///
/// # Panics
/// If normals or an attribute are not of the vertices' number.
pub fn write_mesh(out: &mut dyn Write, mesh: &Mesh, width: CoordinateWidth) -> io::Result<()> {
    assert_complete(mesh);
    out.write_all(header(mesh, width).as_bytes())?;
    write_chunks(out, mesh.positions.len(), |range, out| {
        for vertex in range {
            let position = mesh.positions[vertex];
            match width {
                CoordinateWidth::F32 => out.extend(position.map(|c| (c as f32).to_le_bytes()).as_flattened()),
                CoordinateWidth::F64 => out.extend(position.map(f64::to_le_bytes).as_flattened()),
            }
            if let Some(normals) = &mesh.normals {
                out.extend(normals[vertex].map(f32::to_le_bytes).as_flattened());
            }
            for attribute in &mesh.attributes {
                let values = &attribute.values[vertex * attribute.components..][..attribute.components];
                values.iter().for_each(|value| out.extend(value.to_le_bytes()));
            }
        }
    })?;
    write_chunks(out, mesh.triangles.len(), |range, out| {
        for corners in &mesh.triangles[range] {
            let mut face = [3; 13];
            face[1..].copy_from_slice(corners.map(u32::to_le_bytes).as_flattened());
            out.extend_from_slice(&face);
        }
    })
}

fn header(mesh: &Mesh, width: CoordinateWidth) -> String {
    let coordinate = match width {
        CoordinateWidth::F32 => "float",
        CoordinateWidth::F64 => "double",
    };
    // The same bytes, as long as no index is beyond i32; and int is what every program reads.
    let index = if mesh.positions.len() <= i32::MAX as usize { "int" } else { "uint" };
    let names = property_names(mesh);
    let kinds = std::iter::repeat_n(coordinate, 3).chain(std::iter::repeat("float"));
    let lines: String = kinds.zip(names).map(|(kind, name)| format!("property {kind} {name}\n")).collect();
    format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n{lines}element face {}\n\
         property list uchar {index} vertex_indices\nend_header\n",
        mesh.positions.len(),
        mesh.triangles.len(),
    )
}

/// What the columns of `vertex` are called, no two alike.
fn property_names(mesh: &Mesh) -> Vec<String> {
    let group = |name: &str| GROUPS.iter().find(|(group, _)| *group == name).map(|(_, members)| members);
    let owned = |members: &[&str; 3]| members.map(str::to_owned).to_vec();
    let mut taken = owned(&["x", "y", "z"]);
    taken.extend(mesh.normals.iter().filter_map(|_| group(NORMAL)).flat_map(owned));
    for attribute in &mesh.attributes {
        let grouped = group(&attribute.name).filter(|_| attribute.components == 3).map(owned);
        let mut base = attribute.name.replace(|c: char| c.is_whitespace() || c.is_control(), "_");
        let mut names = grouped.unwrap_or_else(|| numbered(&base, attribute.components));
        while base.is_empty() || names.iter().any(|name| taken.contains(name)) {
            base.push('_');
            names = numbered(&base, attribute.components);
        }
        taken.extend(names);
    }
    taken
}

fn numbered(base: &str, components: usize) -> Vec<String> {
    match components {
        1 => vec![base.to_owned()],
        _ => (0..components).map(|i| format!("{base}_{i}")).collect(),
    }
}
