//! Tests of glTF files, plain and compressed: a separate reader finds the mesh, and a mesh that is
//! too large gives an error.

use std::io;

use meniscus::internals::io::CoordinateWidth;
use meniscus::internals::io::UpAxis;
use meniscus::internals::io::glb::{GlbCompression, GlbLayout, grid_step};
use meniscus::internals::io::output::MeshFormat;
use meniscus::internals::particles::AttributeKind;
use meniscus::internals::surface::mesh::source::{MeshSource, Outline, Vertices};
use meniscus::internals::surface::mesh::{Mesh, VertexAttribute};
use serde_json::Value;

use crate::common::shapes::{moved, sphere, with_attributes};

fn written(mesh: &Mesh, width: CoordinateWidth, layout: GlbLayout) -> (Value, Vec<u8>) {
    let mut bytes = Vec::new();
    MeshFormat::Glb(layout).write(&mut bytes, mesh, width).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
    let json = word(12);
    assert_eq!((&bytes[16..20], json % 4), (&b"JSON"[..], 0));
    assert_eq!(
        (&bytes[24 + json..28 + json], word(20 + json)),
        (&b"BIN\0"[..], bytes.len() - 28 - json)
    );
    (serde_json::from_slice(&bytes[20..20 + json]).unwrap(), bytes[28 + json..].to_vec())
}

fn meshopt(up: UpAxis) -> GlbLayout {
    GlbLayout { up, compression: GlbCompression::Meshopt }
}

fn number(value: &Value) -> usize {
    value.as_u64().unwrap() as usize
}

/// The uncompressed bytes of an accessor's elements.
fn elements(json: &Value, binary: &[u8], accessor: usize) -> Vec<u8> {
    let accessor = &json["accessors"][accessor];
    let view = &json["bufferViews"][number(&accessor["bufferView"])];
    let packed = &view["extensions"]["EXT_meshopt_compression"];
    if packed.is_null() {
        return binary[number(&view["byteOffset"])..][..number(&view["byteLength"])].to_vec();
    }
    let bytes = &binary[number(&packed["byteOffset"])..][..number(&packed["byteLength"])];
    let count = number(&packed["count"]);
    match (packed["mode"].as_str().unwrap(), number(&packed["byteStride"])) {
        ("TRIANGLES", 4) => {
            let corners: Vec<u32> = meshopt::decode_index_buffer(bytes, count).unwrap();
            bytemuck::cast_slice(&corners).to_vec()
        }
        ("ATTRIBUTES", 8) => {
            let points: Vec<[u16; 4]> = meshopt::decode_vertex_buffer(bytes, count).unwrap();
            bytemuck::cast_slice(&points).to_vec()
        }
        other => panic!("{other:?}"),
    }
}

fn floats(bytes: &[u8]) -> Vec<[f32; 3]> {
    let words = bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap()));
    words.collect::<Vec<_>>().chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
}

fn triangles(json: &Value, binary: &[u8]) -> Vec<[u32; 3]> {
    let indices = number(&json["meshes"][0]["primitives"][0]["indices"]);
    let bytes = elements(json, binary, indices);
    let words: Vec<u32> =
        bytes.chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap())).collect();
    words.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
}

/// The corner positions of all triangles. Each triangle begins with its lowest corner, and
/// triangles are sorted.
fn soup<T: PartialOrd + Copy>(positions: &[[T; 3]], triangles: &[[u32; 3]]) -> Vec<[[T; 3]; 3]> {
    let mut soup: Vec<[[T; 3]; 3]> = triangles
        .iter()
        .map(|t| {
            let mut corners = t.map(|v| positions[v as usize]);
            let least =
                (0..3).min_by(|&a, &b| corners[a].partial_cmp(&corners[b]).unwrap()).unwrap();
            corners.rotate_left(least);
            corners
        })
        .collect();
    soup.sort_by(|a, b| a.partial_cmp(b).unwrap());
    soup
}

#[test]
fn a_plain_glb_preserves_the_mesh_and_its_velocity_in_f32() {
    let mesh = with_attributes(moved(&sphere(0.7, 4), [1e-3, -3.0, 1.0 / 3.0]));
    let (json, binary) = written(&mesh, CoordinateWidth::F32, GlbLayout::PLAIN);
    let attributes = &json["meshes"][0]["primitives"][0]["attributes"];
    let named = |name: &str| floats(&elements(&json, &binary, number(&attributes[name])));
    let narrow: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.map(|x| x as f32)).collect();
    let positions = named("POSITION");
    assert_eq!(soup(&positions, &triangles(&json, &binary)), soup(&narrow, &mesh.triangles));
    // The writer may reorder vertices, but each vertex must keep its normal and its velocity.
    let velocity = mesh.attributes.iter().find(|a| a.name == "velocity").unwrap();
    let of = |i: usize| -> [f32; 3] { velocity.values[3 * i..][..3].try_into().unwrap() };
    let whole = |p: &[f32; 3], n: &[f32; 3], v: &[f32; 3]| [p.as_slice(), n, v].concat();
    let mut found: Vec<_> =
        positions.iter().zip(named("NORMAL")).zip(named("_VELOCITY")).collect::<Vec<_>>();
    found.sort_by(|a, b| a.partial_cmp(b).unwrap());
    let found: Vec<_> = found.iter().map(|((p, n), v)| whole(p, n, v)).collect();
    let normals = mesh.normals.as_ref().unwrap();
    let mut expected: Vec<_> =
        (0..narrow.len()).map(|i| whole(&narrow[i], &normals[i], &of(i))).collect();
    expected.sort_by(|a, b| a.partial_cmp(b).unwrap());
    assert_eq!(found, expected);
    // The listed bounds must be the bounds of the stored values.
    let accessor = &json["accessors"][number(&attributes["POSITION"])];
    for (bound, pick) in [("min", f32::min as fn(f32, f32) -> f32), ("max", f32::max)] {
        let listed: Vec<f32> = accessor[bound]
            .as_array()
            .unwrap()
            .iter()
            .map(|x| x.as_f64().unwrap() as f32)
            .collect();
        let stored =
            positions.iter().copied().reduce(|a, b| [0, 1, 2].map(|axis| pick(a[axis], b[axis])));
        assert_eq!(listed, stored.unwrap(), "{bound}");
    }
    assert!(json["nodes"][0]["translation"].is_null() && json["extensionsRequired"].is_null());
}

#[test]
fn byte_colours_are_written_as_fractions_from_0_to_1() {
    let mut mesh = sphere(0.5, 1);
    let values: Vec<f32> = (0..3 * mesh.positions.len()).map(|i| (i % 256) as f32).collect();
    let kind = AttributeKind::ByteColour;
    mesh.attributes = vec![VertexAttribute { kind, ..VertexAttribute::new("rgb", 3, values) }];
    for layout in [GlbLayout::PLAIN, meshopt(UpAxis::Y)] {
        let (json, binary) = written(&mesh, CoordinateWidth::F32, layout);
        let accessor = number(&json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]);
        assert_eq!(json["accessors"][accessor]["type"], "VEC3");
        if layout == GlbLayout::PLAIN {
            let shares = floats(&elements(&json, &binary, accessor));
            let sum: f32 = shares.iter().flatten().sum();
            let stored: f32 = mesh.attributes[0].values.iter().sum();
            assert!((sum * 255.0 / stored - 1.0).abs() < 1e-5, "{sum} of {stored}");
        }
    }
}

#[test]
fn glb_vertices_are_in_the_order_of_their_first_use() {
    let (json, binary) = written(&sphere(1.0, 5), CoordinateWidth::F32, GlbLayout::PLAIN);
    let mut next = 0;
    for &vertex in triangles(&json, &binary).as_flattened() {
        assert!(vertex <= next, "{vertex} is used before {next}");
        next = next.max(vertex + 1);
    }
    assert_eq!(next as usize, sphere(1.0, 5).positions.len(), "some vertices are unused");
}

#[test]
fn a_compressed_glb_is_accurate_to_half_a_quantization_step() {
    let mesh = with_attributes(moved(&sphere(0.7, 4), [-5.0, 2.0, 1.0 / 3.0]));
    let (json, binary) = written(&mesh, CoordinateWidth::F32, meshopt(UpAxis::Y));
    for list in ["extensionsUsed", "extensionsRequired"] {
        assert_eq!(
            json[list],
            serde_json::json!(["EXT_meshopt_compression", "KHR_mesh_quantization"])
        );
    }
    let step = grid_step(1.4);
    let node = &json["nodes"][0];
    assert_eq!(node["scale"], serde_json::json!([step, step, step]));
    assert_eq!(json["asset"]["extras"]["positionError"], serde_json::json!(step / 2.0));
    let (plain_json, plain_binary) = written(&mesh, CoordinateWidth::F32, GlbLayout::PLAIN);
    // Compression keeps the order of vertices and triangles, but the codec rotates the corners of
    // triangles.
    let positions = floats(&elements(&plain_json, &plain_binary, 0));
    let packed: Vec<u16> = elements(&json, &binary, 0)
        .chunks_exact(2)
        .map(|b| u16::from_le_bytes(b.try_into().unwrap()))
        .collect();
    assert_eq!(packed.len(), 4 * mesh.positions.len());
    for (position, packed) in positions.iter().zip(packed.chunks_exact(4)) {
        for axis in 0..3 {
            let origin = node["translation"][axis].as_f64().unwrap();
            let off = origin + step * f64::from(packed[axis]) - f64::from(position[axis]);
            assert!(off.abs() <= step / 2.0 + 1e-6, "{off} of {step}");
        }
    }
    let corners = |(json, binary): (&Value, &[u8])| soup(&positions, &triangles(json, binary));
    assert_eq!(corners((&json, &binary)), corners((&plain_json, &plain_binary)));
    assert!(binary.len() * 3 < plain_binary.len());
}

#[test]
fn the_quantization_step_is_a_power_of_two_that_spans_the_mesh() {
    for extent in [1e-9, 0.3, 1.0, 65_533.9, 65_534.0, 65_534.1, 7e12] {
        let step = grid_step(extent);
        assert_eq!(step.log2().fract(), 0.0);
        assert!(step * 65_534.0 >= extent && step * 65_534.0 < 2.0 * extent, "{extent}: {step}");
    }
}

#[test]
fn the_glb_node_rotates_z_up_to_y_up_and_holds_large_offsets() {
    let mesh = moved(&sphere(1.0, 2), [1e6, 2e6, 3e6]);
    let layout = GlbLayout { up: UpAxis::Z, ..GlbLayout::PLAIN };
    let (json, binary) = written(&mesh, CoordinateWidth::F64, layout);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    assert_eq!(json["nodes"][0]["rotation"], serde_json::json!([-half, 0.0, 0.0, half]));
    let translation: Vec<f64> = json["nodes"][0]["translation"]
        .as_array()
        .unwrap()
        .iter()
        .map(|x| x.as_f64().unwrap())
        .collect();
    // In the file, y points up. The z axis of the mesh becomes y, and its y axis becomes -z.
    assert_eq!(translation.len(), 3);
    for (found, expected) in translation.iter().zip([1e6, 3e6, -2e6]) {
        assert!((found - expected).abs() < 1e-3, "{translation:?}");
    }
    let near = floats(&elements(&json, &binary, 0));
    assert_eq!(near.len(), mesh.positions.len());
    assert!(near.iter().flatten().all(|x| x.abs() <= 1.01));
}

/// A mesh that has only numbers of vertices and triangles, and no data.
struct Huge(u64);

impl MeshSource for Huge {
    fn outline(&self) -> Outline {
        Outline {
            vertices: self.0,
            triangles: 2 * self.0,
            normals: false,
            attributes: Vec::new(),
            pieces: 1,
            lattice: None,
        }
    }

    fn vertices(&self, _: usize) -> io::Result<Vertices<'_>> {
        panic!("the writer must not read vertices")
    }
    fn triangles(&self, _: usize) -> io::Result<Vec<[u64; 3]>> {
        panic!("the writer must not read triangles")
    }
}

#[test]
fn a_glb_over_4_gib_is_refused_before_reading_or_writing() {
    for layout in [GlbLayout::PLAIN, meshopt(UpAxis::Y)] {
        let mut out = Vec::new();
        let fault = MeshFormat::Glb(layout)
            .write(&mut out, &Huge(1 << 29), CoordinateWidth::F32)
            .unwrap_err();
        assert_eq!((fault.kind(), out.len()), (io::ErrorKind::InvalidInput, 0));
        assert!(fault.to_string().contains("write .ply"), "{fault}");
    }
}

#[test]
fn an_empty_mesh_becomes_a_glb_scene_without_a_mesh() {
    for layout in [GlbLayout::PLAIN, meshopt(UpAxis::Z)] {
        let empty = Mesh { normals: Some(Vec::new()), ..Mesh::default() };
        let mut bytes = Vec::new();
        MeshFormat::Glb(layout).write(&mut bytes, &empty, CoordinateWidth::F32).unwrap();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(
            (&bytes[..4], word(4), word(8), word(12)),
            (&b"glTF"[..], 2, bytes.len(), bytes.len() - 20)
        );
        let json: Value = serde_json::from_slice(&bytes[20..]).unwrap();
        assert_eq!(json["scenes"][0]["nodes"], serde_json::json!([0]));
        assert_eq!(json["nodes"], serde_json::json!([{}]));
        for absent in ["meshes", "accessors", "bufferViews", "buffers", "extensionsRequired"] {
            assert!(json[absent].is_null(), "{json}");
        }
    }
}

#[test]
fn attributes_that_glb_cannot_store_are_reported() {
    let mut mesh = sphere(1.0, 0);
    let count = mesh.positions.len();
    let attributes = [("one", 1), ("four", 4), ("five", 5), ("stress", 9), ("colour", 3)];
    mesh.attributes = attributes
        .map(|(name, components)| {
            VertexAttribute::new(name, components, vec![0.5; components * count])
        })
        .into();
    let infos: Vec<_> = mesh.attributes.iter().map(VertexAttribute::info).collect();
    let left_out = MeshFormat::Glb(GlbLayout::PLAIN).not_stored(&infos);
    let names: Vec<&str> = left_out.iter().map(|info| &*info.name).collect();
    assert_eq!(names, ["five", "stress"]);
    assert_eq!(MeshFormat::Ply.not_stored(&infos), []);
    let (json, _) = written(&mesh, CoordinateWidth::F32, GlbLayout::PLAIN);
    let stored = json["meshes"][0]["primitives"][0]["attributes"].as_object().unwrap().len();
    assert_eq!(stored, 1 + attributes.len() - left_out.len(), "positions and attributes");
}
