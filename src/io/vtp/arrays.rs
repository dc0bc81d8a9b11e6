//! The arrays of a mesh in VTK's formats: points, their attributes, and triangles. Triangles are
//! stored as an array of corners and an array that gives the end of each triangle's corners.

use std::io::{self, Write};

use crate::io::CoordinateWidth;
use crate::io::columns::Scalar;
use crate::io::encode::{
    put_position, write_attribute, write_floats, write_pieces, write_triangles, write_vertices,
};
use crate::io::names::unique_names;
use crate::particles::{AttributeInfo, AttributeKind};
use crate::surface::mesh::source::MeshSource;

use super::NORMALS;
use super::write::GLOBAL_IDS;

/// Number of triangles whose ends are encoded at once.
const ENDS: u64 = 1 << 14;

/// An array in the file.
pub(in crate::io) struct Array<'a> {
    pub name: String,
    pub components: usize,
    /// Number of values. A tuple counts as several values.
    pub length: u64,
    /// VTK's name for the purpose of the array, such as `Normals`.
    pub role: Option<&'static str>,
    numbers: ArraySource<'a>,
}

enum ArraySource<'a> {
    Normals,
    /// The attribute with this index, and its number type in the file.
    Attribute(usize, Scalar),
    Positions(CoordinateWidth),
    Corners(IndexWidth),
    /// The end of each triangle's corners: 3, 6, 9, ...
    Ends(IndexWidth),
    /// The indices that the vertices of a piece have in the whole mesh.
    Identifiers(&'a [u64]),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::io) enum IndexWidth {
    I32,
    I64,
}

/// The names of the arrays that store the attributes `infos`. They differ from the names of the
/// normals and of the identifiers.
pub(in crate::io) fn attribute_names(
    infos: &[AttributeInfo],
    has_normals: bool,
    spelled: impl Fn(&str) -> String,
) -> Vec<String> {
    let taken: &[&str] = if has_normals { &[GLOBAL_IDS, NORMALS] } else { &[GLOBAL_IDS] };
    unique_names(infos.iter().map(|info| &*info.name), taken, spelled)
}

/// The number type of an attribute in the file.
fn scalar(info: &AttributeInfo) -> Scalar {
    match info.kind {
        AttributeKind::Signed | AttributeKind::Wide => Scalar::I32,
        AttributeKind::Unsigned => Scalar::U32,
        kind if kind.is_colour() => Scalar::U8,
        _ => Scalar::F32,
    }
}

/// The arrays of normals, if there are any, and of all attributes. `spelled` converts the names of
/// attributes.
pub(in crate::io) fn point_data(
    mesh: &dyn MeshSource,
    spelled: impl Fn(&str) -> String,
) -> Vec<Array<'static>> {
    let array = |name: String, components: usize, role, numbers: ArraySource<'static>| {
        let length = mesh.vertex_count() * components as u64;
        Array { name, components, length, role, numbers }
    };
    let normals = || array(NORMALS.to_owned(), 3, Some("Normals"), ArraySource::Normals);
    let normals = mesh.has_normals().then(normals);
    let infos = mesh.attributes();
    let names = attribute_names(&infos, mesh.has_normals(), spelled);
    let attributes = names.into_iter().zip(&infos).enumerate();
    let attributes = attributes.map(|(index, (name, info))| {
        let role = info.is_velocity().then_some("Vectors");
        array(name, info.components, role, ArraySource::Attribute(index, scalar(info)))
    });
    normals.into_iter().chain(attributes).collect()
}

/// The array of positions.
pub(in crate::io) fn points(mesh: &dyn MeshSource, width: CoordinateWidth) -> Array<'static> {
    Array {
        name: "Points".to_owned(),
        components: 3,
        length: 3 * mesh.vertex_count(),
        role: None,
        numbers: ArraySource::Positions(width),
    }
}

/// The array of the triangles' corners, and the array with the end of each triangle's corners.
pub(in crate::io) fn polygons(mesh: &dyn MeshSource) -> [Array<'static>; 2] {
    let triangles = mesh.triangle_count();
    let width = IndexWidth::for_max_index(mesh.vertex_count().max(3 * triangles));
    let array = |name: &str, length, numbers| Array {
        name: name.to_owned(),
        components: 1,
        length,
        role: None,
        numbers,
    };
    [
        array("connectivity", 3 * triangles, ArraySource::Corners(width)),
        array("offsets", triangles, ArraySource::Ends(width)),
    ]
}

/// The array of the indices that a piece's vertices have in the whole mesh.
pub(super) fn identifiers<'a>(name: &str, numbers: &'a [u64]) -> Array<'a> {
    let length = numbers.len() as u64;
    Array {
        name: name.to_owned(),
        components: 1,
        length,
        role: Some("GlobalIds"),
        numbers: ArraySource::Identifiers(numbers),
    }
}

impl Array<'_> {
    /// The number type of the array.
    pub fn scalar(&self) -> Scalar {
        match self.numbers {
            ArraySource::Normals | ArraySource::Positions(CoordinateWidth::F32) => Scalar::F32,
            ArraySource::Attribute(_, scalar) => scalar,
            ArraySource::Positions(CoordinateWidth::F64) => Scalar::F64,
            ArraySource::Corners(IndexWidth::I32) | ArraySource::Ends(IndexWidth::I32) => {
                Scalar::I32
            }
            ArraySource::Corners(IndexWidth::I64)
            | ArraySource::Ends(IndexWidth::I64)
            | ArraySource::Identifiers(_) => Scalar::I64,
        }
    }

    pub fn bytes(&self) -> u64 {
        self.length * self.scalar().size() as u64
    }

    /// Writes all values of the array, little-endian.
    pub fn write(&self, out: &mut dyn Write, mesh: &dyn MeshSource) -> io::Result<()> {
        match self.numbers {
            ArraySource::Normals => {
                write_floats(out, mesh, |vertices| vertices.normals.as_flattened())
            }
            ArraySource::Attribute(index, _) => write_attribute(out, mesh, index),
            ArraySource::Positions(width) => write_vertices(out, mesh, |vertices, out| {
                vertices.positions.iter().for_each(|&position| put_position(out, position, width));
            }),
            ArraySource::Corners(width) => write_triangles(out, mesh, |triangles, out| {
                triangles.as_flattened().iter().for_each(|&corner| width.put(out, corner));
            }),
            ArraySource::Ends(width) => {
                write_pieces(out, self.length.div_ceil(ENDS) as usize, |piece, out| {
                    let first = piece as u64 * ENDS;
                    let ends = first + 1..=(first + ENDS).min(self.length);
                    ends.for_each(|triangles| width.put(out, 3 * triangles));
                    Ok(())
                })
            }
            ArraySource::Identifiers(numbers) => {
                let all: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
                out.write_all(&all)
            }
        }
    }
}

impl IndexWidth {
    fn for_max_index(greatest: u64) -> Self {
        if i32::try_from(greatest).is_ok() { Self::I32 } else { Self::I64 }
    }

    fn put(self, out: &mut Vec<u8>, index: u64) {
        match self {
            Self::I32 => out.extend((index as u32).to_le_bytes()),
            Self::I64 => out.extend(index.to_le_bytes()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::IndexWidth;

    #[test]
    fn the_index_width_fits_the_greatest_index() {
        for (greatest, width, bytes) in
            [(0x7fff_ffff, IndexWidth::I32, 4), (0x8000_0000, IndexWidth::I64, 8)]
        {
            assert_eq!(IndexWidth::for_max_index(greatest), width);
            let mut out = Vec::new();
            width.put(&mut out, greatest);
            assert_eq!(out, u64::to_le_bytes(greatest)[..bytes]);
        }
    }
}
