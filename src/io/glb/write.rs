//! Writing .glb files.

use std::io::{self, Write};

use meshopt::{
    EncodeExpMode, encode_filter_exp, encode_filter_oct, encode_index_buffer, encode_vertex_buffer_level,
};
use serde_json::{Value, json};

use crate::io::CoordinateWidth;
use crate::io::UpAxis;
use crate::io::encode::{in_order, write_triangles, write_vertices};
use crate::io::output::MeshFormat;
use crate::mesh::ordered::Ordered;
use crate::mesh::source::{MeshSource, Vertices};
use crate::particles::AttributeInfo;

use super::{Compression, Layout, grid_step};

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_SHORT: u32 = 5123;
const BYTE: u32 = 5120;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Bits of a compressed normal's components, and of the mantissas of other values.
const NORMAL_BITS: i32 = 8;
const MANTISSA_BITS: i32 = 15;
/// The vertex codec's version that the extension knows, and the best of its levels.
const CODEC: Option<i32> = Some(0);
const LEVEL: i32 = 2;

/// Writes `mesh` as `layout` says. Uncompressed it streams, but for 4 bytes a vertex; compressed it is held in memory.
///
/// Positions are f32; with [`CoordinateWidth::F64`] they are counted from the middle of the mesh's box, where the node
/// then is. Attributes are called by their names in upper case behind an underscore; those of more than four
/// components have no place.
///
/// # Errors
/// Those of `mesh` and `out`; before anything is written those of [`MeshFormat::check_counts`], and
/// [`io::ErrorKind::InvalidInput`] for more than 4 GiB.
///
/// # Panics
/// As [`MeshFormat::write`].
pub fn write_mesh(
    out: &mut dyn Write,
    mesh: &dyn MeshSource,
    width: CoordinateWidth,
    layout: Layout,
) -> io::Result<()> {
    MeshFormat::Glb(layout).check_counts(mesh.vertex_count(), mesh.triangle_count())?;
    if mesh.triangle_count() == 0 {
        return write_header(out, &empty_document(), 0);
    }
    let mesh = Ordered::new(mesh)?;
    let [lo, hi] = mesh.bounds().unwrap_or_default();
    let space = match (layout.compression, width) {
        (Compression::Meshopt, _) => {
            let step = grid_step((0..3).map(|axis| hi[axis] - lo[axis]).fold(0.0, f64::max));
            Space { origin: lo.map(|x| (x / step).floor() * step), step }
        }
        (Compression::None, CoordinateWidth::F32) => Space { origin: [0.0; 3], step: 1.0 },
        (Compression::None, CoordinateWidth::F64) => {
            Space { origin: std::array::from_fn(|axis| (lo[axis] + hi[axis]) / 2.0), step: 1.0 }
        }
    };
    let names = names(&mesh.attributes());
    let views = views(&mesh, layout.compression, &names);
    let encoded = match layout.compression {
        Compression::None => None,
        Compression::Meshopt => {
            Some(views.iter().map(|view| view.encoded(&mesh, space)).collect::<io::Result<Vec<Vec<u8>>>>()?)
        }
    };
    let document = document(&mesh, layout, space, [lo, hi], &views, encoded.as_deref());
    let stored: u64 = match &encoded {
        None => views.iter().map(View::bytes).sum(),
        Some(encoded) => encoded.iter().map(|bytes| aligned(bytes.len() as u64)).sum(),
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

/// Writes all that comes before so many bytes of numbers.
fn write_header(out: &mut dyn Write, document: &Value, stored: u64) -> io::Result<()> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let binary = if stored > 0 { 8 + stored } else { 0 };
    let total = 12 + 8 + json.len() as u64 + binary;
    let Ok(total) = u32::try_from(total) else {
        let what = format!("the mesh takes {total} bytes, a .glb file holds 4 GiB; write .ply, .obj or .vtp");
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

fn aligned(bytes: u64) -> u64 {
    bytes.next_multiple_of(4)
}

/// Positions are stored in steps from an origin.
#[derive(Clone, Copy)]
struct Space {
    origin: [f64; 3],
    step: f64,
}

impl Space {
    fn stored(&self, position: [f64; 3]) -> [f32; 3] {
        std::array::from_fn(|axis| ((position[axis] - self.origin[axis]) / self.step) as f32)
    }

    fn on_grid(&self, position: [f64; 3]) -> [u16; 3] {
        std::array::from_fn(|axis| ((position[axis] - self.origin[axis]) / self.step).round() as u16)
    }
}

/// A buffer view, and its accessor.
struct View {
    what: What,
    /// As the file calls it; indices have no name.
    name: String,
    components: usize,
    scalar: u32,
    count: u64,
    /// Bytes from one element to the next.
    stride: u64,
}

#[derive(Clone, Copy)]
enum What {
    Positions,
    Normals,
    Attribute(usize),
    Indices,
}

fn views(mesh: &Ordered, compression: Compression, names: &[Option<String>]) -> Vec<View> {
    let vertices = mesh.vertex_count();
    let view = |what, name: &str, components, scalar, stride| View {
        what,
        name: name.to_owned(),
        components,
        scalar,
        count: vertices,
        stride,
    };
    let mut views = vec![match compression {
        Compression::None => view(What::Positions, "POSITION", 3, FLOAT, 12),
        Compression::Meshopt => view(What::Positions, "POSITION", 3, UNSIGNED_SHORT, 8),
    }];
    if mesh.has_normals() {
        views.push(match compression {
            Compression::None => view(What::Normals, "NORMAL", 3, FLOAT, 12),
            Compression::Meshopt => view(What::Normals, "NORMAL", 3, BYTE, 4),
        });
    }
    for (index, (info, name)) in mesh.attributes().iter().zip(names).enumerate() {
        if let Some(name) = name {
            let stride = 4 * info.components as u64;
            views.push(view(What::Attribute(index), name, info.components, FLOAT, stride));
        }
    }
    views.push(View {
        what: What::Indices,
        name: String::new(),
        components: 1,
        scalar: UNSIGNED_INT,
        count: 3 * mesh.triangle_count(),
        stride: 4,
    });
    views
}

/// What attributes are called, no two alike; nothing for those that have no place.
fn names(attributes: &[AttributeInfo]) -> Vec<Option<String>> {
    let mut taken: Vec<String> = Vec::new();
    let name = |info: &AttributeInfo| {
        if !(1..=4).contains(&info.components) {
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

impl View {
    fn bytes(&self) -> u64 {
        self.count * self.stride
    }

    /// Writes its elements as they are.
    fn write(&self, out: &mut dyn Write, mesh: &Ordered, space: Space) -> io::Result<()> {
        match self.what {
            What::Indices => write_triangles(out, mesh, |triangles, out| {
                let corners = triangles.as_flattened().iter();
                corners.for_each(|&vertex| out.extend((vertex as u32).to_le_bytes()));
            }),
            what => write_vertices(out, mesh, |vertices, out| {
                let mut put = |value: &f32| out.extend(value.to_le_bytes());
                match what {
                    What::Normals => vertices.normals.as_flattened().iter().for_each(put),
                    What::Attribute(index) => vertices.attributes[index].iter().for_each(put),
                    _ => vertices.positions.iter().for_each(|&p| space.stored(p).iter().for_each(&mut put)),
                }
            }),
        }
    }

    /// Its elements, compressed.
    fn encoded(&self, mesh: &Ordered, space: Space) -> io::Result<Vec<u8>> {
        let encoded = match self.what {
            What::Positions => {
                let points = gathered(mesh, |vertices, out| {
                    out.extend(vertices.positions.iter().map(|&p| {
                        let [x, y, z] = space.on_grid(p);
                        [x, y, z, 0]
                    }));
                })?;
                encode_vertex_buffer_level(&points, LEVEL, CODEC)
            }
            What::Normals => {
                let normals = gathered(mesh, |vertices, out| {
                    out.extend(vertices.normals.iter().map(|&[x, y, z]| [x, y, z, 0.0]));
                })?;
                encode_vertex_buffer_level(&encode_filter_oct::<i8>(&normals, NORMAL_BITS), LEVEL, CODEC)
            }
            What::Attribute(index) => {
                let values = gathered(mesh, |vertices, out| {
                    // What is no number has no exponent.
                    let finite = |value: &f32| if value.is_finite() { *value } else { 0.0 };
                    out.extend(vertices.attributes[index].iter().map(finite));
                })?;
                match self.components {
                    1 => encode_values::<1>(&values),
                    2 => encode_values::<2>(&values),
                    3 => encode_values::<3>(&values),
                    _ => encode_values::<4>(&values),
                }
            }
            What::Indices => {
                let mut corners = Vec::with_capacity(self.count as usize);
                let make = |piece: usize, out: &mut Vec<u32>| {
                    out.extend(mesh.triangles(piece)?.as_flattened().iter().map(|&vertex| vertex as u32));
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

fn encode_values<const N: usize>(values: &[f32]) -> meshopt::Result<Vec<u8>> {
    let groups = values.as_chunks::<N>().0;
    let filtered = encode_filter_exp(groups, MANTISSA_BITS, EncodeExpMode::SharedVector);
    encode_vertex_buffer_level(&filtered, LEVEL, CODEC)
}

/// What `make` makes of the vertices, piece after piece.
fn gathered<T: Send + Clone>(
    mesh: &Ordered,
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

fn asset() -> Value {
    json!({ "version": "2.0", "generator": concat!("meniscus ", env!("CARGO_PKG_VERSION")) })
}

/// A scene without a mesh: accessors, views and buffers of nothing are not allowed.
fn empty_document() -> Value {
    json!({ "asset": asset(), "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{}] })
}

/// The file's JSON.
fn document(
    mesh: &Ordered,
    layout: Layout,
    space: Space,
    bounds: [[f64; 3]; 2],
    views: &[View],
    encoded: Option<&[Vec<u8>]>,
) -> Value {
    let mut attributes = serde_json::Map::new();
    let (mut accessors, mut buffer_views) = (Vec::new(), Vec::new());
    let (mut plain_end, mut encoded_end) = (0, 0);
    for (number, view) in views.iter().enumerate() {
        let is_indices = matches!(view.what, What::Indices);
        let mut buffer_view = json!({
            "buffer": u32::from(encoded.is_some()),
            "byteOffset": plain_end,
            "byteLength": view.bytes(),
            "target": if is_indices { ELEMENT_ARRAY_BUFFER } else { ARRAY_BUFFER },
        });
        plain_end += view.bytes();
        if !is_indices {
            buffer_view["byteStride"] = json!(view.stride);
            attributes.insert(view.name.clone(), json!(number));
        }
        if let Some(encoded) = encoded {
            let length = encoded[number].len() as u64;
            let mut compression = json!({
                "buffer": 0,
                "byteOffset": encoded_end,
                "byteLength": length,
                "byteStride": view.stride,
                "count": view.count,
                "mode": if is_indices { "TRIANGLES" } else { "ATTRIBUTES" },
            });
            match view.what {
                What::Normals => compression["filter"] = json!("OCTAHEDRAL"),
                What::Attribute(_) => compression["filter"] = json!("EXPONENTIAL"),
                What::Positions | What::Indices => {}
            }
            buffer_view["extensions"] = json!({ "EXT_meshopt_compression": compression });
            encoded_end += aligned(length);
        }
        buffer_views.push(buffer_view);
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][view.components - 1];
        let mut accessor = json!({
            "bufferView": number,
            "componentType": view.scalar,
            "count": view.count,
            "type": kind,
        });
        if matches!(view.what, What::Positions) {
            let [min, max] = match layout.compression {
                Compression::None => bounds.map(|corner| json!(space.stored(corner))),
                Compression::Meshopt => bounds.map(|corner| json!(space.on_grid(corner))),
            };
            (accessor["min"], accessor["max"]) = (min, max);
        }
        if view.scalar == BYTE {
            accessor["normalized"] = json!(true);
        }
        accessors.push(accessor);
    }
    let mut node = json!({ "mesh": 0 });
    let [x, y, z] = space.origin;
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let translation = match layout.up {
        UpAxis::Y => [x, y, z],
        UpAxis::Z => {
            // A quarter turn about x, from z to y.
            node["rotation"] = json!([-half, 0.0, 0.0, half]);
            [x, z, -y]
        }
    };
    if space.origin != [0.0; 3] {
        node["translation"] = json!(translation);
    }
    if space.step != 1.0 {
        let scale = [space.step; 3];
        node["scale"] = json!(scale);
    }
    let mut document = json!({
        "asset": asset(),
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": views.len() - 1 }] }],
        "accessors": accessors,
        "bufferViews": buffer_views,
        "buffers": [{ "byteLength": plain_end }],
    });
    if encoded.is_some() {
        let extensions = json!(["EXT_meshopt_compression", "KHR_mesh_quantization"]);
        document["extensionsUsed"] = extensions.clone();
        document["extensionsRequired"] = extensions;
        let fallback = json!({ "EXT_meshopt_compression": { "fallback": true } });
        document["buffers"] =
            json!([{ "byteLength": encoded_end }, { "byteLength": plain_end, "extensions": fallback }]);
        // Half a step along each axis.
        document["asset"]["extras"] = json!({ "positionError": space.step / 2.0 });
    }
    debug_assert_eq!(mesh.vertex_count(), views[0].count);
    document
}
