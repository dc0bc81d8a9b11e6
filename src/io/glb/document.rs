//! The JSON document of a .glb file.

use serde_json::{Map, Value, json};

use crate::io::UpAxis;

use super::view::{BYTE, GlbView, Space, ViewContent};
use super::{GlbCompression, GlbLayout};

const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

fn asset() -> Value {
    json!({ "version": "2.0", "generator": concat!("meniscus ", env!("CARGO_PKG_VERSION")) })
}

/// The document for a mesh without triangles. It contains no mesh, because glTF does not allow
/// empty accessors, views and buffers.
pub fn empty_document() -> Value {
    json!({ "asset": asset(), "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{}] })
}

/// The document for a mesh with triangles. `encoded` contains the size, in bytes, of each
/// compressed view, and is `None` without compression. `bounds` are the lower and upper corner of
/// the positions' bounding box.
pub fn document(
    layout: GlbLayout,
    space: Space,
    bounds: [[f64; 3]; 2],
    views: &[GlbView],
    encoded: Option<&[u64]>,
) -> Value {
    let mut attributes = Map::new();
    let (mut accessors, mut buffer_views) = (Vec::new(), Vec::new());
    let (mut plain_end, mut encoded_end) = (0, 0);
    for (number, view) in views.iter().enumerate() {
        let mut buffer_view = buffer_view(view, plain_end);
        plain_end += view.bytes();
        if let Some(encoded) = encoded {
            buffer_view["buffer"] = json!(1);
            let compression = compression(view, encoded_end, encoded[number]);
            buffer_view["extensions"] = json!({ "EXT_meshopt_compression": compression });
            encoded_end += aligned(encoded[number]);
        }
        buffer_views.push(buffer_view);
        accessors.push(accessor(view, number, layout.compression, space, bounds));
        if !view.is_indices() {
            attributes.insert(view.name.clone(), json!(number));
        }
    }
    let mut document = json!({
        "asset": asset(),
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node(layout.up, space)],
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
        document["buffers"] = json!([{ "byteLength": encoded_end }, { "byteLength": plain_end, "extensions": fallback }]);
        // `positionError` is the maximum error of a position along each axis: half a grid step.
        document["asset"]["extras"] = json!({ "positionError": space.step / 2.0 });
    }
    document
}

/// The JSON of a view of uncompressed elements.
fn buffer_view(view: &GlbView, offset: u64) -> Value {
    let mut buffer_view = json!({
        "buffer": 0,
        "byteOffset": offset,
        "byteLength": view.bytes(),
        "target": if view.is_indices() { ELEMENT_ARRAY_BUFFER } else { ARRAY_BUFFER },
    });
    if !view.is_indices() {
        buffer_view["byteStride"] = json!(view.stride);
    }
    buffer_view
}

/// The extension object of a view with compressed elements.
fn compression(view: &GlbView, offset: u64, length: u64) -> Value {
    let mut compression = json!({
        "buffer": 0,
        "byteOffset": offset,
        "byteLength": length,
        "byteStride": view.stride,
        "count": view.count,
        "mode": if view.is_indices() { "TRIANGLES" } else { "ATTRIBUTES" },
    });
    match view.content {
        ViewContent::Normals => compression["filter"] = json!("OCTAHEDRAL"),
        ViewContent::Attribute(..) => compression["filter"] = json!("EXPONENTIAL"),
        ViewContent::Positions | ViewContent::Indices => {}
    }
    compression
}

/// The accessor of a view, with the type, number and bounds of its elements.
fn accessor(
    view: &GlbView,
    number: usize,
    compression: GlbCompression,
    space: Space,
    bounds: [[f64; 3]; 2],
) -> Value {
    let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][view.components - 1];
    let mut accessor = json!({
        "bufferView": number,
        "componentType": view.scalar,
        "count": view.count,
        "type": kind,
    });
    if matches!(view.content, ViewContent::Positions) {
        let [min, max] = match compression {
            GlbCompression::None => bounds.map(|corner| json!(space.stored(corner))),
            GlbCompression::Meshopt => bounds.map(|corner| json!(space.on_grid(corner))),
        };
        (accessor["min"], accessor["max"]) = (min, max);
    }
    if view.scalar == BYTE {
        accessor["normalized"] = json!(true);
    }
    accessor
}

/// The node of the mesh, with its translation, rotation and scale.
fn node(up: UpAxis, space: Space) -> Value {
    let mut node = json!({ "mesh": 0 });
    if up == UpAxis::Z {
        // A rotation by a quarter turn about x, which turns z to y.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        node["rotation"] = json!([-half, 0.0, 0.0, half]);
    }
    if space.origin != [0.0; 3] {
        let [x, y, z] = space.origin;
        node["translation"] = match up {
            UpAxis::Y => json!([x, y, z]),
            UpAxis::Z => json!([x, z, -y]),
        };
    }
    if space.step != 1.0 {
        let scale = [space.step; 3];
        node["scale"] = json!(scale);
    }
    node
}

/// The smallest multiple of 4 that is at least `bytes`.
pub fn aligned(bytes: u64) -> u64 {
    bytes.next_multiple_of(4)
}
