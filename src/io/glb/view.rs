//! The buffer views of a .glb file, and the encoding of their numbers.

use std::io::{self, Write};

use meshopt::{
    EncodeExpMode, encode_filter_exp, encode_filter_oct, encode_index_buffer,
    encode_vertex_buffer_level,
};

use crate::io::encode::{in_order, write_triangles, write_vertices};
use crate::particles::{AttributeInfo, AttributeKind};
use crate::surface::mesh::ordered::OrderedMesh;
use crate::surface::mesh::source::{MeshSource, Vertices};

use super::GlbCompression;

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_SHORT: u32 = 5123;
pub const BYTE: u32 = 5120;

/// Number of bits per component of a compressed normal.
const NORMAL_BITS: i32 = 8;
/// Number of mantissa bits of a compressed attribute value.
const MANTISSA_BITS: i32 = 15;
/// The version of meshoptimizer's vertex codec that the extension requires.
const CODEC: Option<i32> = Some(0);
/// The compression level at which this codec compresses best.
const LEVEL: i32 = 2;

/// The origin and the grid step of stored positions.
#[derive(Clone, Copy)]
pub struct Space {
    pub origin: [f64; 3],
    pub step: f64,
}

impl Space {
    pub fn stored(&self, position: [f64; 3]) -> [f32; 3] {
        std::array::from_fn(|axis| ((position[axis] - self.origin[axis]) / self.step) as f32)
    }

    pub fn on_grid(&self, position: [f64; 3]) -> [u16; 3] {
        std::array::from_fn(|axis| {
            ((position[axis] - self.origin[axis]) / self.step).round() as u16
        })
    }
}

/// A buffer view with its accessor.
pub struct GlbView {
    pub content: ViewContent,
    /// The name of the attribute in the file. Empty for indices.
    pub name: String,
    pub components: usize,
    pub scalar: u32,
    pub count: u64,
    /// Number of bytes from one element to the next.
    pub stride: u64,
}

#[derive(Clone, Copy)]
pub enum ViewContent {
    Positions,
    Normals,
    /// The attribute with this index, and its kind.
    Attribute(usize, AttributeKind),
    Indices,
}

/// The views of all data of a mesh. The last view contains the indices.
pub fn views(mesh: &OrderedMesh, compression: GlbCompression) -> Vec<GlbView> {
    let vertices = mesh.vertex_count();
    let view = |content, name: &str, components, scalar, stride| GlbView {
        content,
        name: name.to_owned(),
        components,
        scalar,
        count: vertices,
        stride,
    };
    let mut views = vec![match compression {
        GlbCompression::None => view(ViewContent::Positions, "POSITION", 3, FLOAT, 12),
        GlbCompression::Meshopt => view(ViewContent::Positions, "POSITION", 3, UNSIGNED_SHORT, 8),
    }];
    if mesh.has_normals() {
        views.push(match compression {
            GlbCompression::None => view(ViewContent::Normals, "NORMAL", 3, FLOAT, 12),
            GlbCompression::Meshopt => view(ViewContent::Normals, "NORMAL", 3, BYTE, 4),
        });
    }
    let attributes = mesh.attributes();
    for (index, (info, name)) in attributes.iter().zip(names(&attributes)).enumerate() {
        if let Some(name) = name {
            let stride = 4 * info.components as u64;
            let content = ViewContent::Attribute(index, info.kind);
            views.push(view(content, &name, info.components, FLOAT, stride));
        }
    }
    views.push(GlbView {
        content: ViewContent::Indices,
        name: String::new(),
        components: 1,
        scalar: UNSIGNED_INT,
        count: 3 * mesh.triangle_count(),
        stride: 4,
    });
    views
}

/// Whether the format can store an attribute.
pub fn can_store(info: &AttributeInfo) -> bool {
    info.kind.is_colour() || (1..=4).contains(&info.components)
}

/// The name of each attribute in the file. `None` for an attribute that the format cannot store.
fn names(attributes: &[AttributeInfo]) -> Vec<Option<String>> {
    let mut taken: Vec<String> = Vec::new();
    let mut colours = (0..).map(|number| format!("COLOR_{number}"));
    let name = |info: &AttributeInfo| {
        if info.kind.is_colour() {
            return colours.next();
        }
        if !can_store(info) {
            return None;
        }
        let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' };
        let mut name: String = "_".chars().chain(info.name.chars().map(plain)).collect();
        while taken.contains(&name) {
            name.push('_');
        }
        taken.push(name.clone());
        Some(name)
    };
    attributes.iter().map(name).collect()
}

/// The attributes that the file renames, each with its original name and its name in the file. An
/// attribute does not count as renamed if its name in the file is an underscore followed by its
/// original name in capitals. Colours are left out, because they always have glTF's names.
pub fn renamed(attributes: &[AttributeInfo]) -> Vec<[String; 2]> {
    let attributes = attributes.iter().zip(names(attributes));
    let plain = attributes.filter(|(info, _)| !info.kind.is_colour());
    let differs = |(info, name): (&AttributeInfo, Option<String>)| {
        let name = name.filter(|name| *name != format!("_{}", info.name.to_ascii_uppercase()))?;
        Some([info.name.clone(), name])
    };
    plain.filter_map(differs).collect()
}

impl GlbView {
    pub fn is_indices(&self) -> bool {
        matches!(self.content, ViewContent::Indices)
    }

    pub fn bytes(&self) -> u64 {
        self.count * self.stride
    }

    /// Writes the elements without compression.
    pub fn write(&self, out: &mut dyn Write, mesh: &OrderedMesh, space: Space) -> io::Result<()> {
        match self.content {
            ViewContent::Indices => write_triangles(out, mesh, |triangles, out| {
                let corners = triangles.as_flattened().iter();
                corners.for_each(|&vertex| out.extend((vertex as u32).to_le_bytes()));
            }),
            content => write_vertices(out, mesh, |vertices, out| {
                let mut put = |value: &f32| out.extend(value.to_le_bytes());
                match content {
                    ViewContent::Normals => vertices.normals.as_flattened().iter().for_each(put),
                    ViewContent::Attribute(index, kind) => {
                        vertices.attributes[index].iter().for_each(|&x| put(&stored(kind, x)));
                    }
                    _ => vertices
                        .positions
                        .iter()
                        .for_each(|&p| space.stored(p).iter().for_each(&mut put)),
                }
            }),
        }
    }

    /// Returns the compressed elements.
    pub fn encoded(&self, mesh: &OrderedMesh, space: Space) -> io::Result<Vec<u8>> {
        let encoded = match self.content {
            ViewContent::Positions => {
                let points = gathered(mesh, |vertices, out| {
                    out.extend(vertices.positions.iter().map(|&p| {
                        let [x, y, z] = space.on_grid(p);
                        [x, y, z, 0]
                    }));
                })?;
                encode_vertex_buffer_level(&points, LEVEL, CODEC)
            }
            ViewContent::Normals => {
                let normals = gathered(mesh, |vertices, out| {
                    out.extend(vertices.normals.iter().map(|&[x, y, z]| [x, y, z, 0.0]));
                })?;
                encode_vertex_buffer_level(
                    &encode_filter_oct::<i8>(&normals, NORMAL_BITS),
                    LEVEL,
                    CODEC,
                )
            }
            ViewContent::Attribute(index, kind) => {
                let stored = |&value: &f32| match stored(kind, value) {
                    value if value.is_finite() => value,
                    // NaN and infinity have no exponent to encode, so store 0.
                    _ => 0.0,
                };
                let values = gathered(mesh, |vertices, out| {
                    out.extend(vertices.attributes[index].iter().map(stored));
                })?;
                match self.components {
                    1 => encode_values::<1>(&values),
                    2 => encode_values::<2>(&values),
                    3 => encode_values::<3>(&values),
                    _ => encode_values::<4>(&values),
                }
            }
            ViewContent::Indices => {
                let mut corners = Vec::with_capacity(self.count as usize);
                let make = |piece: usize, out: &mut Vec<u32>| {
                    out.extend(
                        mesh.triangles(piece)?.as_flattened().iter().map(|&vertex| vertex as u32),
                    );
                    Ok(())
                };
                in_order(mesh.pieces(), make, |corners_of_piece| {
                    corners.extend_from_slice(corners_of_piece);
                    Ok(())
                })?;
                encode_index_buffer(&corners, mesh.vertex_count() as usize)
            }
        };
        encoded.map_err(io::Error::other)
    }
}

/// Converts a value for the file, which stores attributes as f32. Colours become numbers from 0 to
/// 1, and integers are rounded to f32.
fn stored(kind: AttributeKind, value: f32) -> f32 {
    if kind.is_colour() { kind.share(value) } else { kind.number(value) }
}

fn encode_values<const N: usize>(values: &[f32]) -> meshopt::Result<Vec<u8>> {
    let groups = values.as_chunks::<N>().0;
    let filtered = encode_filter_exp(groups, MANTISSA_BITS, EncodeExpMode::SharedVector);
    encode_vertex_buffer_level(&filtered, LEVEL, CODEC)
}

/// Collects the values that `make` appends for the vertices, piece by piece.
fn gathered<T: Send + Clone>(
    mesh: &OrderedMesh,
    make: impl Fn(&Vertices, &mut Vec<T>) + Sync,
) -> io::Result<Vec<T>> {
    let mut all = Vec::with_capacity(mesh.vertex_count() as usize);
    let of_piece = |piece: usize, out: &mut Vec<T>| {
        make(&mesh.vertices(piece)?, out);
        Ok(())
    };
    in_order(mesh.pieces(), of_piece, |values| {
        all.extend_from_slice(values);
        Ok(())
    })?;
    Ok(all)
}
