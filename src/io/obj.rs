//! Reads and writes Wavefront .obj, a text format with one line for each vertex (`v`), normal
//! (`vn`) and face (`f`). Vertices and normals are numbered from 1.
//!
//! Many programs write and read a colour from 0 to 1 after a vertex's position. The format has no
//! other attributes. A normal belongs to a corner of a face, not to a vertex. [`write_mesh`] gives
//! each normal the same number as its vertex, and [`read_mesh`] keeps normals only if each has the
//! same number as its vertex.

use std::fmt;
use std::io::{self, Write};

use crate::particles::{AttributeInfo, colour_attribute};
use crate::surface::mesh::Mesh;
use crate::surface::mesh::source::MeshSource;

use super::encode::{write_triangles, write_vertices};
use super::number::ParseNumber;
use super::scan::Scanner;
use super::up::delimited_up_comment;
use super::{CoordinateWidth, ReadFault};

/// First words of lines that are ignored, because they do not affect the shape of the surface.
const IGNORED: [&[u8]; 14] = [
    b"vt", b"vp", b"p", b"l", b"o", b"g", b"s", b"mg", b"mtllib", b"usemtl", b"usemap", b"maplib",
    b"lod", b"bevel",
];

/// Writes vertices with the first colour attribute, normals and triangles. Numbers have enough
/// digits to be read back exactly as f32 or f64.
///
/// # Panics
/// Like [`MeshFormat::write`](crate::io::output::MeshFormat::write).
pub fn write_mesh(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
) -> io::Result<()> {
    out.write_all(delimited_up_comment(mesh, ["# ", "\n"]).as_bytes())?;
    if mesh.vertex_count() == 0 {
        // Write a line, because an empty file could be mistaken for an incomplete one.
        writeln!(out, "# no vertices")?;
    }
    let infos = mesh.attributes();
    let colour = colour_attribute(&infos);
    write_vertices(out, mesh, |vertices, out| {
        for (vertex, &[x, y, z]) in vertices.positions.iter().enumerate() {
            match width {
                CoordinateWidth::F32 => {
                    put(out, format_args!("v {} {} {}", x as f32, y as f32, z as f32));
                }
                CoordinateWidth::F64 => put(out, format_args!("v {x} {y} {z}")),
            }
            if let Some(index) = colour {
                let AttributeInfo { components, kind, .. } = infos[index];
                let shares = &vertices.attributes[index][vertex * components..][..3];
                shares.iter().for_each(|&share| put(out, format_args!(" {}", kind.share(share))));
            }
            out.push(b'\n');
        }
    })?;
    let has_normals = mesh.has_normals();
    if has_normals {
        write_vertices(out, mesh, |vertices, out| {
            for [x, y, z] in &*vertices.normals {
                put(out, format_args!("vn {x} {y} {z}\n"));
            }
        })?;
    }
    write_triangles(out, mesh, |triangles, out| {
        for triangle in triangles {
            let [a, b, c] = triangle.map(|vertex| vertex + 1);
            if has_normals {
                put(out, format_args!("f {a}//{a} {b}//{b} {c}//{c}\n"));
            } else {
                put(out, format_args!("f {a} {b} {c}\n"));
            }
        }
    })
}

fn put(out: &mut Vec<u8>, line: fmt::Arguments) {
    out.write_fmt(line).expect("writing to a `Vec` does not fail");
}

/// Reads vertices, normals and faces. Each polygon becomes a fan of triangles around its first
/// corner.
///
/// Normals are kept only if each has the same number as its vertex.
///
/// Texture coordinates, groups, materials, points and lines are ignored.
///
/// # Errors
/// [`ReadFault::Line`] for an invalid line and for a face with fewer than three corners or an
/// undefined vertex, and [`ReadFault::Unsupported`] for more vertices than a mesh can have.
pub fn read_mesh(bytes: &[u8]) -> Result<Mesh, ReadFault> {
    let mut scan = Scanner::new(bytes, 0);
    let mut reading = ObjMesh { normals_match: true, ..ObjMesh::default() };
    loop {
        scan.skip_blanks();
        let at = scan.at();
        match scan.word() {
            b"v" => reading.positions.push(vector(&mut scan)?),
            b"vn" => reading.normals.push(vector(&mut scan)?),
            b"f" => reading.face(&mut scan, at)?,
            word if word.is_empty() || word[0] == b'#' || IGNORED.contains(&word) => {}
            word => {
                let shown = String::from_utf8_lossy(&word[..word.len().min(40)]);
                return Err(scan.fault(at, format!("{shown:?} does not begin a valid .obj line")));
            }
        }
        if !scan.skip_line() {
            return Ok(reading.into_mesh());
        }
    }
}

/// Parses three numbers from the rest of the line.
pub(super) fn vector<T: ParseNumber>(scan: &mut Scanner) -> Result<[T; 3], ReadFault> {
    let mut next = || {
        scan.skip_blanks();
        scan.number()
    };
    Ok([next()?, next()?, next()?])
}

#[derive(Default)]
struct ObjMesh {
    positions: Vec<[f64; 3]>,
    normals: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Whether the normal of every corner so far has the same number as the corner's vertex.
    normals_match: bool,
    corners: Vec<u32>,
}

impl ObjMesh {
    fn face(&mut self, scan: &mut Scanner, line: usize) -> Result<(), ReadFault> {
        self.corners.clear();
        loop {
            scan.skip_blanks();
            let at = scan.at();
            let word = scan.word();
            if word.is_empty() || word[0] == b'#' {
                break;
            }
            let corner = self.corner(word).map_err(|what| scan.fault(at, what))?;
            let corner = u32::try_from(corner).map_err(|_| {
                ReadFault::Unsupported(format!(
                    "a face refers to vertex {corner}, but a mesh must have fewer than 2^32 \
                     vertices"
                ))
            })?;
            self.corners.push(corner);
        }
        match &self.corners[..] {
            [apex, rim @ ..] if rim.len() > 1 => {
                self.triangles.extend(rim.windows(2).map(|edge| [*apex, edge[0], edge[1]]));
                Ok(())
            }
            few => {
                Err(scan
                    .fault(line, format!("a face has {} corners, expected 3 or more", few.len())))
            }
        }
    }

    /// The vertex index of a corner, which has the form `vertex`, `vertex/texture`,
    /// `vertex//normal` or `vertex/texture/normal`.
    fn corner(&mut self, word: &[u8]) -> Result<usize, String> {
        let mut parts = word.split(|&byte| byte == b'/');
        let vertex = resolve(parts.next().unwrap_or_default(), "vertex", self.positions.len())?;
        let normal =
            parts.nth(1).map(|part| resolve(part, "normal", self.normals.len())).transpose()?;
        self.normals_match &= normal == Some(vertex);
        Ok(vertex)
    }

    fn into_mesh(self) -> Mesh {
        let has_normals = self.normals_match
            && !self.normals.is_empty()
            && self.normals.len() == self.positions.len();
        Mesh {
            positions: self.positions,
            triangles: self.triangles,
            normals: has_normals.then_some(self.normals),
            attributes: Vec::new(),
        }
    }
}

/// Converts a number to an index below `count`. Positive numbers count from 1, negative ones from
/// the end.
fn resolve(number: &[u8], what: &str, count: usize) -> Result<usize, String> {
    let shown = || String::from_utf8_lossy(&number[..number.len().min(40)]).into_owned();
    let parsed: Option<i64> =
        std::str::from_utf8(number).ok().and_then(|number| number.parse().ok());
    let parsed = parsed.ok_or_else(|| format!("{:?} is not the number of a {what}", shown()))?;
    let distance = usize::try_from(parsed.unsigned_abs()).unwrap_or(usize::MAX);
    let index = if parsed < 0 { count.checked_sub(distance) } else { distance.checked_sub(1) };
    index
        .filter(|&index| index < count)
        .ok_or_else(|| format!("{what} {parsed} is not defined: only {count} are defined so far"))
}
