//! Writing legacy .vtk files.

use std::io::{self, Write};

use crate::io::CoordinateWidth;
use crate::io::encode::write_chunks;
use crate::io::vertices::assert_complete;
use crate::mesh::{Mesh, VertexAttribute};

/// Writes `mesh` as binary POLYDATA of version 3.0: POINTS of float or double by `width`, POLYGONS, and under
/// POINT_DATA the normals as NORMALS, an attribute `velocity` of three components as VECTORS, and all others
/// as FIELD, as programs show but the first of several SCALARS.
///
/// # Errors
/// Those of `out`, and `InvalidInput`, before anything is written, for a mesh whose counts exceed the
/// format's 32 bits.
///
/// # Panics
/// If normals or an attribute are not of the vertices' number.
pub fn write_mesh(out: &mut dyn Write, mesh: &Mesh, width: CoordinateWidth) -> io::Result<()> {
    assert_complete(mesh);
    check_counts(mesh.positions.len(), mesh.triangles.len())?;
    write_points(out, &mesh.positions, width)?;
    write_polygons(out, &mesh.triangles)?;
    if mesh.normals.is_none() && mesh.attributes.is_empty() {
        return Ok(());
    }
    writeln!(out, "POINT_DATA {}", mesh.positions.len())?;
    if let Some(normals) = &mesh.normals {
        writeln!(out, "NORMALS Normals float")?;
        write_floats(out, normals.as_flattened())?;
    }
    let is_velocity =
        |attribute: &&VertexAttribute| attribute.name == "velocity" && attribute.components == 3;
    let velocity = mesh.attributes.iter().find(is_velocity);
    if let Some(velocity) = velocity {
        writeln!(out, "VECTORS velocity float")?;
        write_floats(out, &velocity.values)?;
    }
    let is_other =
        |attribute: &&VertexAttribute| velocity.is_none_or(|velocity| !std::ptr::eq(*attribute, velocity));
    let others: Vec<_> = mesh.attributes.iter().filter(is_other).collect();
    if !others.is_empty() {
        writeln!(out, "FIELD FieldData {}", others.len())?;
    }
    for VertexAttribute { name, components, values } in others {
        writeln!(out, "{} {components} {} float", encoded(name), mesh.positions.len())?;
        write_floats(out, values)?;
    }
    Ok(())
}

/// Every polygon takes four of the numbers that the format counts in an i32.
fn check_counts(points: usize, triangles: usize) -> io::Result<()> {
    const MOST: usize = i32::MAX as usize;
    if points <= MOST && triangles <= MOST / 4 {
        return Ok(());
    }
    let (most_triangles, what) = (MOST / 4, "the mesh is too large for a legacy .vtk file");
    let what =
        format!("{what}: {points} vertices of {MOST}, {triangles} triangles of {most_triangles}; write .vtp");
    Err(io::Error::new(io::ErrorKind::InvalidInput, what))
}

fn write_points(out: &mut dyn Write, positions: &[[f64; 3]], width: CoordinateWidth) -> io::Result<()> {
    let scalar = match width {
        CoordinateWidth::F32 => "float",
        CoordinateWidth::F64 => "double",
    };
    writeln!(out, "# vtk DataFile Version 3.0\nmeniscus surface\nBINARY\nDATASET POLYDATA")?;
    writeln!(out, "POINTS {} {scalar}", positions.len())?;
    write_chunks(out, positions.len(), |range, out| {
        for position in &positions[range] {
            match width {
                CoordinateWidth::F32 => out.extend(position.map(|c| (c as f32).to_be_bytes()).as_flattened()),
                CoordinateWidth::F64 => out.extend(position.map(f64::to_be_bytes).as_flattened()),
            }
        }
    })?;
    writeln!(out)
}

/// POLYGONS, but none where there are none: the toolkit's own reader complains of an empty section.
fn write_polygons(out: &mut dyn Write, triangles: &[[u32; 3]]) -> io::Result<()> {
    if triangles.is_empty() {
        return Ok(());
    }
    writeln!(out, "POLYGONS {} {}", triangles.len(), 4 * triangles.len())?;
    write_chunks(out, triangles.len(), |range, out| {
        for &[a, b, c] in &triangles[range] {
            out.extend([3, a, b, c].map(u32::to_be_bytes).as_flattened());
        }
    })?;
    writeln!(out)
}

fn write_floats(out: &mut dyn Write, values: &[f32]) -> io::Result<()> {
    write_chunks(out, values.len(), |range, out| {
        for value in &values[range] {
            out.extend(value.to_be_bytes());
        }
    })?;
    writeln!(out)
}

/// A name as the format spells it: one word, whatever it holds.
fn encoded(name: &str) -> String {
    let name = if name.is_empty() { "_" } else { name };
    let plain = |byte: &u8| byte.is_ascii_graphic() && !matches!(byte, b'%' | b'"');
    name.bytes().map(|b| if plain(&b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}

#[cfg(test)]
mod tests {
    use super::check_counts;

    #[test]
    fn a_mesh_beyond_the_format_is_refused_and_the_largest_within_is_not() {
        check_counts(0x7fff_ffff, 0x1fff_ffff).unwrap();
        for (points, triangles) in [(0x8000_0000, 0), (0, 0x2000_0000), (usize::MAX, usize::MAX)] {
            let fault = check_counts(points, triangles).unwrap_err();
            assert_eq!(
                fault.kind(),
                std::io::ErrorKind::InvalidInput,
                "{points} points, {triangles} triangles"
            );
        }
    }
}
