//! Helpers for readers of formats that contain either particles or a mesh. They convert columns of
//! vertices into particles or a mesh, and polygons into triangles.

use crate::particles::{AttributeInfo, Particles, velocity_attribute};
use crate::surface::mesh::{Mesh, VertexAttribute};

use super::bytes::{Bytes, PrivateBytes};
use super::columns::{Column, ColumnStore, Endian, ParticleRows, Scalar};
use super::{ParticleFile, ReadFault, malformed};

/// The vertices of a file, whose number has been checked against the file's size.
pub(super) struct FileVertices {
    /// The decoded data to which the columns refer. `None` if they refer to the file itself.
    pub decoded: Option<PrivateBytes>,
    pub count: usize,
    pub position: [Column; 3],
    pub attributes: Vec<(AttributeInfo, Vec<Column>)>,
    /// The index of the attribute with normals, which has three components.
    pub normals: Option<usize>,
}

impl FileVertices {
    /// Uses each vertex as a particle.
    pub fn into_particles(self, bytes: Bytes, format: &'static str) -> ParticleFile {
        let bytes = self.decoded.map_or(bytes, Bytes::Kept);
        let particles: ColumnStore =
            ColumnStore::new(bytes, ParticleRows::All(self.count), self.position, self.attributes);
        ParticleFile::new(particles, format)
    }

    /// Makes a mesh from the vertices and `triangles`.
    pub fn into_mesh(self, bytes: &[u8], triangles: Vec<[u32; 3]>) -> Mesh {
        let bytes = self.decoded.as_deref().unwrap_or(bytes);
        let normals = self.normals.map(|index| self.attributes[index].0.name.clone());
        let store: ColumnStore<&[u8]> =
            ColumnStore::new(bytes, ParticleRows::All(self.count), self.position, self.attributes);
        // The index of the normals may have changed, because the store leaves out an attribute
        // with the same name as an earlier attribute.
        let normals = normals.and_then(|name| normals_called(&name, &store));
        make_mesh(&store, normals, triangles)
    }
}

/// Makes a mesh. Attribute number `normals` becomes the normals of the vertices.
fn make_mesh(store: &dyn Particles, normals: Option<usize>, triangles: Vec<[u32; 3]>) -> Mesh {
    let count = store.len();
    let mut positions = vec![[0.0; 3]; count];
    store.positions(0, &mut positions);
    let attributes =
        store.attributes().iter().enumerate().filter(|(index, _)| Some(*index) != normals);
    let velocity = velocity_attribute(store.attributes());
    let attributes = attributes.map(|(index, info)| {
        let mut values = vec![0.0; count * info.components];
        store.attribute(index, 0, &mut values);
        let name = if Some(index) == velocity { "velocity".to_owned() } else { info.name.clone() };
        let mut whole = Vec::new();
        if info.kind.is_whole() {
            whole.resize(values.len(), 0);
            store.integers(index, 0, &mut whole);
        }
        let kind = info.kind.of_mesh();
        VertexAttribute { name, components: info.components, values, kind, whole }
    });
    let attributes = attributes.collect();
    let normals = normals.map(|index| {
        let mut normals = vec![[0.0; 3]; count];
        store.attribute(index, 0, normals.as_flattened_mut());
        normals
    });
    Mesh { positions, triangles, normals, attributes }
}

/// Makes a mesh from points and their attributes. The attribute `normals` becomes the normals.
pub(super) fn mesh_of(points: &dyn Particles, normals: &str, triangles: Vec<[u32; 3]>) -> Mesh {
    make_mesh(points, normals_called(normals, points), triangles)
}

/// The index of the attribute `name`, if it has three components, as normals must have.
fn normals_called(name: &str, points: &dyn Particles) -> Option<usize> {
    let is_normals = |info: &AttributeInfo| info.name == name && info.components == 3;
    points.attributes().iter().position(is_normals)
}

/// The columns of a tuple of `components` adjacent numbers. The tuple of row 0 starts at byte
/// `offset`, and each row has `stride` bytes.
pub(super) fn columns(
    offset: usize,
    stride: usize,
    components: usize,
    scalar: Scalar,
    endian: Endian,
) -> Vec<Column> {
    (0..components)
        .map(|i| Column { offset: offset + i * scalar.size(), stride, scalar, endian })
        .collect()
}

/// Divides the polygons of a file into triangles, and collects them.
pub(super) struct Triangles {
    vertices: usize,
    pub triangles: Vec<[u32; 3]>,
}

impl Triangles {
    /// Creates an empty list of triangles for a mesh with `vertices` vertices.
    pub fn new(vertices: usize) -> Result<Self, ReadFault> {
        if u32::try_from(vertices).is_err() {
            return Err(ReadFault::Unsupported(format!(
                "the file has {vertices} vertices, but a mesh must have fewer than 2^32"
            )));
        }
        Ok(Self { vertices, triangles: Vec::new() })
    }

    /// Divides face number `face`, stored at byte `at`, into a fan of triangles around its first
    /// corner. Points and lines have no area and are ignored.
    pub fn polygon(&mut self, face: usize, at: usize, corners: &[i64]) -> Result<(), ReadFault> {
        self.check(face, at, corners)?;
        if let [apex, rim @ ..] = corners {
            self.triangles
                .extend(rim.windows(2).map(|edge| [*apex, edge[0], edge[1]].map(|i| i as u32)));
        }
        Ok(())
    }

    /// Adds the triangles of a strip. Every three consecutive corners form a triangle, and every
    /// second triangle is reversed.
    pub fn strip(&mut self, face: usize, at: usize, corners: &[i64]) -> Result<(), ReadFault> {
        self.check(face, at, corners)?;
        self.triangles.extend(corners.windows(3).enumerate().map(|(i, c)| {
            let [a, b] = if i % 2 == 0 { [c[0], c[1]] } else { [c[1], c[0]] };
            [a, b, c[2]].map(|i| i as u32)
        }));
        Ok(())
    }

    fn check(&self, face: usize, at: usize, corners: &[i64]) -> Result<(), ReadFault> {
        match corners.iter().find(|&&i| i < 0 || i as u64 >= self.vertices as u64) {
            Some(i) => Err(malformed(
                at,
                format!(
                    "face {face} refers to vertex {i}, but the file has {} vertices",
                    self.vertices
                ),
            )),
            None => Ok(()),
        }
    }
}

/// The integer in `bytes`. `None` for floating-point types.
pub(super) fn integer(scalar: Scalar, endian: Endian, bytes: &[u8]) -> Option<i64> {
    let chunk2 =
        || bytes.first_chunk().map(|&b| order(endian, b, u16::from_le_bytes, u16::from_be_bytes));
    let chunk4 =
        || bytes.first_chunk().map(|&b| order(endian, b, u32::from_le_bytes, u32::from_be_bytes));
    let chunk8 =
        || bytes.first_chunk().map(|&b| order(endian, b, u64::from_le_bytes, u64::from_be_bytes));
    match scalar {
        Scalar::I8 => bytes.first().map(|&value| i64::from(value as i8)),
        Scalar::U8 => bytes.first().map(|&value| i64::from(value)),
        Scalar::I16 => chunk2().map(|value| i64::from(value as i16)),
        Scalar::U16 => chunk2().map(i64::from),
        Scalar::I32 => chunk4().map(|value| i64::from(value as i32)),
        Scalar::U32 => chunk4().map(i64::from),
        Scalar::I64 => chunk8().map(|value| value as i64),
        // Counts and indices beyond i64 are invalid. The result is -1, which is also invalid as a
        // count or an index.
        Scalar::U64 => chunk8().map(|value| i64::try_from(value).unwrap_or(-1)),
        Scalar::F16 | Scalar::F32 | Scalar::F64 => None,
    }
}

fn order<B, V>(endian: Endian, bytes: B, little: fn(B) -> V, big: fn(B) -> V) -> V {
    match endian {
        Endian::Little => little(bytes),
        Endian::Big => big(bytes),
    }
}
