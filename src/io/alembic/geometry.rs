//! A polygon mesh (schema AbcGeom_PolyMesh_v1): its arrays, and the objects that hold them.

use std::collections::HashSet;

use crate::particles::{AttributeInfo, AttributeKind};
use crate::surface::mesh::source::Outline;

use super::archive::{Object, Pod, Property, Sample, ValueHeader};
use super::content_hash::ContentHasher;
use super::ogawa::Blocks;

/// The number of the time sampling of the mesh.
const OF_FRAMES: u32 = 1;

/// An array of a mesh, or its bounding box.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MeshArray {
    pub header: ValueHeader,
    /// Whether the schema does not define it: it is in `.arbGeomParams`.
    pub is_arbitrary: bool,
    pub elements: u64,
    pub source: ArraySource,
}

/// The source of an array's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ArraySource {
    Positions,
    /// The box of the positions, which are written before.
    Bounds,
    Corners,
    CornerCounts,
    Normals,
    /// The attribute with this number.
    Attribute(usize),
    /// The attribute with this number, from 0 to 1.
    Colour(usize),
}

impl MeshArray {
    /// Bytes of the values.
    pub fn bytes(&self) -> u64 {
        let width = match self.header.pod {
            Pod::Bool => 1,
            Pod::U32 | Pod::I32 | Pod::F32 => 4,
            Pod::F64 => 8,
        };
        self.elements * u64::from(self.header.extent) * width
    }
}

/// The arrays of a mesh, in the order of the file.
pub fn arrays(mesh: &Outline) -> Vec<MeshArray> {
    let vertices = mesh.vertices;
    let array = |name: &str, metadata: &str, pod, extent, elements, source| MeshArray {
        header: ValueHeader {
            name: name.to_owned(),
            metadata: metadata.to_owned(),
            scalar: source == ArraySource::Bounds,
            pod,
            extent,
        },
        is_arbitrary: false,
        elements,
        source,
    };
    let mut all = vec![
        array(
            "P",
            "geoScope=vtx;interpretation=point",
            Pod::F32,
            3,
            vertices,
            ArraySource::Positions,
        ),
        array(".selfBnds", "interpretation=box", Pod::F64, 6, 1, ArraySource::Bounds),
        array(".faceIndices", "", Pod::I32, 1, 3 * mesh.triangles, ArraySource::Corners),
        array(".faceCounts", "", Pod::I32, 1, mesh.triangles, ArraySource::CornerCounts),
    ];
    if mesh.normals {
        let metadata = parameter(Pod::F32, 3, 1, "normal");
        all.push(array("N", &metadata, Pod::F32, 3, vertices, ArraySource::Normals));
    }
    let names = attribute_names(&mesh.attributes, mesh.normals);
    for (index, (info, name)) in mesh.attributes.iter().zip(names).enumerate() {
        let source = ArraySource::Attribute(index);
        if is_velocity(info) {
            let metadata = "interpretation=vector";
            all.push(array(".velocities", metadata, Pod::F32, 3, vertices, source));
            continue;
        }
        let pod = match info.kind {
            AttributeKind::Signed | AttributeKind::Wide => Pod::I32,
            AttributeKind::Unsigned => Pod::U32,
            _ => Pod::F32,
        };
        let is_colour = info.kind.is_colour();
        let meaning = match info.components {
            3 if is_colour => "rgb",
            4 if is_colour => "rgba",
            2 | 3 if pod == Pod::F32 => "vector",
            _ => "",
        };
        // Other values of several numbers are several elements.
        let (extent, times) = match info.components {
            components if meaning.is_empty() => (1, components),
            components => (components as u8, 1),
        };
        let metadata = parameter(pod, extent, times, meaning);
        let source = if is_colour { ArraySource::Colour(index) } else { source };
        let array = array(&name, &metadata, pod, extent, vertices * times as u64, source);
        all.push(MeshArray { is_arbitrary: true, ..array });
    }
    all
}

/// The metadata of values of the vertices: `times` elements of `extent` numbers each.
fn parameter(pod: Pod, extent: u8, times: usize, meaning: &str) -> String {
    let interpretation =
        if meaning.is_empty() { String::new() } else { format!("interpretation={meaning};") };
    // Readers take other pairs of numbers for texture coordinates.
    let not_uv = if extent == 2 { "notUV=1;" } else { "" };
    format!(
        "arrayExtent={times};geoScope=vtx;{interpretation}isGeomParam=true;{not_uv}\
         podExtent={extent};podName={}",
        pod.name()
    )
}

/// Whether an attribute is the schema's `.velocities`.
fn is_velocity(info: &AttributeInfo) -> bool {
    info.is_velocity() && !info.kind.is_whole()
}

/// The unique names of attributes in the file: letters, digits and underscores, as Maya and Houdini
/// require.
pub fn attribute_names(attributes: &[AttributeInfo], has_normals: bool) -> Vec<String> {
    let mut taken = HashSet::from(["P".to_owned()]);
    taken.extend(has_normals.then(|| "N".to_owned()));
    let name = |info: &AttributeInfo| {
        if is_velocity(info) {
            return info.name.clone();
        }
        let mut name = info.name.replace(|c: char| !c.is_ascii_alphanumeric() && c != '_', "_");
        if !name.starts_with(|c: char| !c.is_ascii_digit()) {
            name.insert(0, '_');
        }
        while !taken.insert(name.clone()) {
            name.push('_');
        }
        name
    };
    attributes.iter().map(name).collect()
}

/// The objects of an archive with the arrays of each frame. An array that a frame lacks is empty
/// there.
pub fn objects(frames: &[Vec<(MeshArray, Sample)>], blocks: &mut Blocks) -> Vec<Object> {
    let (mut own, mut arbitrary) = (Vec::new(), Vec::new());
    let mut seen = HashSet::new();
    for (array, _) in frames.iter().flatten() {
        let key = (&array.header.name, array.is_arbitrary);
        if !seen.insert(key) {
            continue;
        }
        let of_frame = |frame: &Vec<(MeshArray, Sample)>| {
            let same = |(other, _): &&(MeshArray, Sample)| {
                other.header == array.header && other.is_arbitrary == array.is_arbitrary
            };
            frame.iter().find(same).map_or_else(Sample::empty, |(_, sample)| *sample)
        };
        let samples = frames.iter().map(of_frame).collect();
        let values =
            Property::Values { header: array.header.clone(), samples, sampling: OF_FRAMES };
        if array.is_arbitrary { &mut arbitrary } else { &mut own }.push(values);
    }
    if !arbitrary.is_empty() {
        own.push(compound(".arbGeomParams", "", arbitrary));
    }
    const MESH: &str = "schema=AbcGeom_PolyMesh_v1;schemaBaseType=AbcGeom_GeomBase_v1";
    let mesh = Object {
        name: "fluidShape",
        metadata: format!("{MESH};schemaObjTitle=AbcGeom_PolyMesh_v1:.geom"),
        properties: vec![compound(".geom", MESH, own)],
        children: Vec::new(),
    };
    // The identity, which the transform of a parent applies to.
    let digest = ContentHasher::of(&[1]);
    let block = blocks.data(&[&digest[..], &[1]].concat());
    let inherits = Property::Values {
        header: ValueHeader {
            name: ".inherits".into(),
            metadata: String::new(),
            scalar: true,
            pod: Pod::Bool,
            extent: 1,
        },
        samples: vec![Sample { block, digest, elements: 1 }],
        sampling: 0,
    };
    const TRANSFORM: &str = "schema=AbcGeom_Xform_v3";
    vec![Object {
        name: "fluid",
        metadata: format!("{TRANSFORM};schemaObjTitle=AbcGeom_Xform_v3:.xform"),
        properties: vec![compound(".xform", TRANSFORM, vec![inherits])],
        children: vec![mesh],
    }]
}

fn compound(name: &'static str, metadata: &str, properties: Vec<Property>) -> Property {
    Property::Compound { name, metadata: metadata.to_owned(), properties }
}
