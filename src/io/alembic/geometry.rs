//! A polygon mesh (schema AbcGeom_PolyMesh_v1): its arrays, and the objects that contain them.

use std::collections::HashSet;

use crate::particles::{AttributeInfo, AttributeKind};
use crate::surface::mesh::source::Outline;

use super::archive::{AbcHeader, AbcObject, AbcPod, AbcProperty, AbcSample};
use super::content_hash::{ContentHasher, Digest};
use super::ogawa::{HEADER, LENGTH, OgawaBlocks, OgawaChild};

/// The index of the time sampling of the mesh.
const FRAME_SAMPLING: u32 = 1;

/// An array of a mesh, or the bounding box of the mesh.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AbcArray {
    pub header: AbcHeader,
    /// Whether the array is stored in `.arbGeomParams`, the compound property for arrays that the
    /// schema does not define.
    pub is_arbitrary: bool,
    pub elements: u64,
    pub source: AbcSource,
}

/// The source of an array's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AbcSource {
    Positions,
    /// The bounding box of the positions. The positions must be written before the box.
    Bounds,
    Corners,
    CornerCounts,
    Normals,
    /// The attribute with this index.
    Attribute(usize),
    /// The colour attribute with this index. Its values are converted to the range from 0 to 1.
    Colour(usize),
}

impl AbcArray {
    /// Size of the values in bytes.
    pub fn bytes(&self) -> u64 {
        let width = match self.header.pod {
            AbcPod::Bool => 1,
            AbcPod::U32 | AbcPod::I32 | AbcPod::F32 => 4,
            AbcPod::F64 => 8,
        };
        self.elements * u64::from(self.header.extent) * width
    }

    /// Size of the values and their digest in bytes.
    pub fn block_length(&self) -> u64 {
        size_of::<Digest>() as u64 + self.bytes()
    }

    /// The sample whose block is at byte `at`. An empty array has no block.
    pub fn sample(&self, at: u64, digest: Digest) -> AbcSample {
        let block = if self.bytes() == 0 { OgawaChild::NO_DATA } else { OgawaChild::data(at) };
        AbcSample { block, digest, elements: self.elements }
    }
}

/// The arrays of `mesh`, in the order in which the file stores them.
pub fn arrays(mesh: &Outline) -> Vec<AbcArray> {
    let vertices = mesh.vertices;
    let array = |name: &str, metadata: &str, pod, extent, elements, source| AbcArray {
        header: AbcHeader {
            name: name.to_owned(),
            metadata: metadata.to_owned(),
            scalar: source == AbcSource::Bounds,
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
            AbcPod::F32,
            3,
            vertices,
            AbcSource::Positions,
        ),
        array(".selfBnds", "interpretation=box", AbcPod::F64, 6, 1, AbcSource::Bounds),
        array(".faceIndices", "", AbcPod::I32, 1, 3 * mesh.triangles, AbcSource::Corners),
        array(".faceCounts", "", AbcPod::I32, 1, mesh.triangles, AbcSource::CornerCounts),
    ];
    if mesh.normals {
        let metadata = parameter(AbcPod::F32, 3, 1, "normal");
        all.push(array("N", &metadata, AbcPod::F32, 3, vertices, AbcSource::Normals));
    }
    let names = attribute_names(&mesh.attributes, mesh.normals);
    for (index, (info, name)) in mesh.attributes.iter().zip(names).enumerate() {
        let source = AbcSource::Attribute(index);
        if is_velocity(info) {
            let metadata = "interpretation=vector";
            all.push(array(".velocities", metadata, AbcPod::F32, 3, vertices, source));
            continue;
        }
        let pod = match info.kind {
            AttributeKind::Signed | AttributeKind::Wide => AbcPod::I32,
            AttributeKind::Unsigned => AbcPod::U32,
            _ => AbcPod::F32,
        };
        let is_colour = info.kind.is_colour();
        let meaning = match info.components {
            3 if is_colour => "rgb",
            4 if is_colour => "rgba",
            2 | 3 if pod == AbcPod::F32 => "vector",
            _ => "",
        };
        // If Alembic has no type for an attribute, each vertex has one element per component.
        let (extent, times) = match info.components {
            components if meaning.is_empty() => (1, components),
            components => (components as u8, 1),
        };
        let metadata = parameter(pod, extent, times, meaning);
        let source = if is_colour { AbcSource::Colour(index) } else { source };
        let array = array(&name, &metadata, pod, extent, vertices * times as u64, source);
        all.push(AbcArray { is_arbitrary: true, ..array });
    }
    all
}

/// Byte offsets of the arrays' blocks in a file with one mesh, and the end of the last block.
pub fn positions(arrays: &[AbcArray]) -> (Vec<u64>, u64) {
    let mut end = HEADER;
    let mut place = |array: &AbcArray| {
        let at = end;
        end += if array.bytes() == 0 { 0 } else { LENGTH + array.block_length() };
        at
    };
    let positions = arrays.iter().map(&mut place).collect();
    (positions, end)
}

/// The metadata of an array of values at vertices. Each vertex has `times` elements of `extent`
/// numbers.
fn parameter(pod: AbcPod, extent: u8, times: usize, meaning: &str) -> String {
    let interpretation =
        if meaning.is_empty() { String::new() } else { format!("interpretation={meaning};") };
    // Without `notUV`, readers interpret pairs of numbers as texture coordinates.
    let not_uv = if extent == 2 { "notUV=1;" } else { "" };
    format!(
        "arrayExtent={times};geoScope=vtx;{interpretation}isGeomParam=true;{not_uv}\
         podExtent={extent};podName={}",
        pod.name()
    )
}

/// Whether an attribute is stored as the schema's `.velocities`.
fn is_velocity(info: &AttributeInfo) -> bool {
    info.is_velocity() && !info.kind.is_whole()
}

/// The unique names under which the file stores `attributes`. They contain only letters, digits and
/// underscores, as Maya and Houdini require. For a velocity, which the file stores as
/// `.velocities`, this function returns the original name.
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

/// The objects of an archive. `frames` contains the arrays of each frame. An array that a frame
/// lacks is stored as empty for this frame.
pub fn objects(frames: &[Vec<(AbcArray, AbcSample)>], blocks: &mut OgawaBlocks) -> Vec<AbcObject> {
    let (mut own, mut arbitrary) = (Vec::new(), Vec::new());
    let mut seen = HashSet::new();
    for (array, _) in frames.iter().flatten() {
        let key = (&array.header.name, array.is_arbitrary);
        if !seen.insert(key) {
            continue;
        }
        let sample_in_frame = |frame: &Vec<(AbcArray, AbcSample)>| {
            let is_same_array = |(other, _): &&(AbcArray, AbcSample)| {
                other.header == array.header && other.is_arbitrary == array.is_arbitrary
            };
            frame.iter().find(is_same_array).map_or_else(AbcSample::empty, |(_, sample)| *sample)
        };
        let samples = frames.iter().map(sample_in_frame).collect();
        let values =
            AbcProperty::Values { header: array.header.clone(), samples, sampling: FRAME_SAMPLING };
        if array.is_arbitrary { &mut arbitrary } else { &mut own }.push(values);
    }
    if !arbitrary.is_empty() {
        own.push(compound(".arbGeomParams", "", arbitrary));
    }
    const MESH: &str = "schema=AbcGeom_PolyMesh_v1;schemaBaseType=AbcGeom_GeomBase_v1";
    let mesh = AbcObject {
        name: "fluidShape",
        metadata: format!("{MESH};schemaObjTitle=AbcGeom_PolyMesh_v1:.geom"),
        properties: vec![compound(".geom", MESH, own)],
        children: Vec::new(),
    };
    // The transform is the identity, relative to its parent.
    let digest = ContentHasher::of(&[1]);
    let block = blocks.data(&[&digest[..], &[1]].concat());
    let inherits = AbcProperty::Values {
        header: AbcHeader {
            name: ".inherits".into(),
            metadata: String::new(),
            scalar: true,
            pod: AbcPod::Bool,
            extent: 1,
        },
        samples: vec![AbcSample { block, digest, elements: 1 }],
        sampling: 0,
    };
    const TRANSFORM: &str = "schema=AbcGeom_Xform_v3";
    vec![AbcObject {
        name: "fluid",
        metadata: format!("{TRANSFORM};schemaObjTitle=AbcGeom_Xform_v3:.xform"),
        properties: vec![compound(".xform", TRANSFORM, vec![inherits])],
        children: vec![mesh],
    }]
}

fn compound(name: &'static str, metadata: &str, properties: Vec<AbcProperty>) -> AbcProperty {
    AbcProperty::Compound { name, metadata: metadata.to_owned(), properties }
}
