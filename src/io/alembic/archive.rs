//! An archive in Ogawa (AbcCoreOgawa, file version 0) with time samplings, and a tree of objects
//! with properties.
//!
//! The children of the root group are the file version, the library version, the top object,
//! metadata, time samplings, and the list of metadata that headers refer to by index. An object is
//! a group that contains a compound property, the child objects, and a block with the headers of
//! the child objects and two hashes. A compound property is a group that contains properties, and a
//! block with the headers of these properties. A scalar property is a group with one block per
//! sample. An array property is a group with two children per sample: the block of the sample, and
//! the dimensions of the array if it has several. The block of a sample contains a digest of the
//! values, followed by the values.

use super::content_hash::{ContentHasher, Digest};
use super::ogawa::{OgawaBlocks, OgawaChild};

/// The version of the Alembic library that writes this format: 1.8.0.
const LIBRARY_VERSION: i32 = 1_08_00;
/// Value of the time per cycle that marks a sampling as acyclic. An acyclic sampling lists all of
/// its times.
const ACYCLIC: f64 = f64::MAX / 32.0;
/// Metadata index of a header that contains its own metadata instead of referring to the list.
const INLINE_METADATA: usize = 255;

/// A number type, with the code that Alembic assigns to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AbcPod {
    Bool = 0,
    U32 = 5,
    I32 = 6,
    F32 = 10,
    F64 = 11,
}

impl AbcPod {
    pub fn name(self) -> &'static str {
        match self {
            Self::Bool => "bool_t",
            Self::U32 => "uint32_t",
            Self::I32 => "int32_t",
            Self::F32 => "float32_t",
            Self::F64 => "float64_t",
        }
    }
}

/// The name and type of a property that has values.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AbcHeader {
    pub name: String,
    pub metadata: String,
    /// Whether a sample is a single element instead of an array.
    pub scalar: bool,
    pub pod: AbcPod,
    /// Number of values in an element.
    pub extent: u8,
}

/// The values of a property at one time.
#[derive(Debug, Clone, Copy)]
pub struct AbcSample {
    pub block: OgawaChild,
    pub digest: Digest,
    /// Number of elements in the array.
    pub elements: u64,
}

impl AbcSample {
    /// A sample with an empty array.
    pub fn empty() -> Self {
        Self { block: OgawaChild::NO_DATA, digest: ContentHasher::of(&[]), elements: 0 }
    }
}

/// A property of an object.
pub enum AbcProperty {
    Values {
        header: AbcHeader,
        samples: Vec<AbcSample>,
        /// The index of the time sampling.
        sampling: u32,
    },
    Compound {
        name: &'static str,
        metadata: String,
        properties: Vec<Self>,
    },
}

/// An object in the tree of an archive.
pub struct AbcObject {
    pub name: &'static str,
    pub metadata: String,
    pub properties: Vec<AbcProperty>,
    pub children: Vec<Self>,
}

/// The times of samples, in seconds.
pub struct TimeSampling {
    per_cycle: f64,
    times: Vec<f64>,
    /// The largest number of samples of any property with this sampling.
    samples: u32,
}

impl TimeSampling {
    /// The default time sampling, which has index 0: one sample per second from time 0.
    fn default_sampling() -> Self {
        Self { per_cycle: 1.0, times: vec![0.0], samples: 1 }
    }

    /// A time sampling at `times`, in seconds, which must be strictly increasing.
    pub fn at(times: &[f64]) -> Self {
        // Tolerance, in seconds, with which Alembic finds the sample for a time.
        const TOLERANCE: f64 = 1e-5;
        let samples = times.len() as u32;
        let per_cycle = match times {
            [first, .., last] => (last - first) / f64::from(samples - 1),
            _ => 1.0,
        };
        let first = times.first().copied().unwrap_or_default();
        let is_uniform = times.iter().enumerate().all(|(index, time)| {
            (first + per_cycle * index as f64 - time).abs() < TOLERANCE.min(per_cycle / 100.0)
        });
        if is_uniform {
            Self { per_cycle, times: vec![first], samples }
        } else {
            Self { per_cycle: ACYCLIC, times: times.to_vec(), samples }
        }
    }

    fn put(&self, out: &mut Vec<u8>) {
        out.extend(self.samples.to_le_bytes());
        out.extend(self.per_cycle.to_le_bytes());
        out.extend((self.times.len() as u32).to_le_bytes());
        self.times.iter().for_each(|time| out.extend(time.to_le_bytes()));
    }
}

/// Encodes the groups and small data blocks of an archive, which start at byte `at` of the file,
/// after the arrays. Returns their bytes and the root group.
///
/// Properties refer to `sampling` by index 1, and to the default sampling by index 0.
pub fn archive(
    at: u64,
    sampling: &TimeSampling,
    objects: impl FnOnce(&mut OgawaBlocks) -> Vec<AbcObject>,
) -> (Vec<u8>, OgawaChild) {
    let mut blocks = OgawaBlocks::new(at);
    let children = objects(&mut blocks);
    let top = AbcObject { name: "ABC", metadata: String::new(), properties: Vec::new(), children };
    let mut metadata_list = MetadataList::default();
    let version = blocks.data(&0_i32.to_le_bytes());
    let library = blocks.data(&LIBRARY_VERSION.to_le_bytes());
    let (top, _) = top.put(&mut blocks, &mut metadata_list);
    const WRITER: &str = concat!("_ai_Application=meniscus ", env!("CARGO_PKG_VERSION"));
    let metadata = blocks.data(WRITER.as_bytes());
    let mut samplings = Vec::new();
    TimeSampling::default_sampling().put(&mut samplings);
    sampling.put(&mut samplings);
    let samplings = blocks.data(&samplings);
    let listed = blocks.data(&metadata_list.bytes());
    let root = blocks.group(&[version, library, top, metadata, samplings, listed]);
    (blocks.finish(), root)
}

impl AbcObject {
    /// Appends the object. Returns its group, and a hash of all data in it.
    fn put(&self, blocks: &mut OgawaBlocks, list: &mut MetadataList) -> (OgawaChild, Digest) {
        let (compound, properties_hash) = put_compound(&self.properties, blocks, list);
        let mut group = vec![compound];
        let (mut headers, mut children_hash) = (Vec::new(), ContentHasher::default());
        for child in &self.children {
            let (object, hash) = child.put(blocks, list);
            group.push(object);
            children_hash.update(&hash);
            headers.extend((child.name.len() as u32).to_le_bytes());
            headers.extend(child.name.as_bytes());
            let index = list.index(&child.metadata);
            headers.push(index as u8);
            if index == INLINE_METADATA {
                headers.extend((child.metadata.len() as u32).to_le_bytes());
                headers.extend(child.metadata.as_bytes());
            }
        }
        let children_hash = children_hash.finish();
        headers.extend(properties_hash);
        headers.extend(children_hash);
        group.push(blocks.data(&headers));
        let name = [self.name, &self.metadata].concat();
        let hash = [&properties_hash, &children_hash, name.as_bytes()].concat();
        (blocks.group(&group), ContentHasher::of(&hash))
    }
}

/// Appends the properties of an object or a compound property. Returns their group, and a hash of
/// all headers and samples.
fn put_compound(
    properties: &[AbcProperty],
    blocks: &mut OgawaBlocks,
    list: &mut MetadataList,
) -> (OgawaChild, Digest) {
    let (mut group, mut headers, mut hash) = (Vec::new(), Vec::new(), ContentHasher::default());
    for property in properties {
        match property {
            AbcProperty::Values { header, samples, sampling } => {
                let dimensions = (!header.scalar).then_some(OgawaChild::NO_DATA);
                let children = samples.iter().flat_map(|sample| [Some(sample.block), dimensions]);
                group.push(blocks.group(&children.flatten().collect::<Vec<_>>()));
                samples.iter().for_each(|sample| hash.update(&sample.digest));
                put_value_header(&mut headers, header, samples, *sampling, list);
            }
            AbcProperty::Compound { name, metadata, properties } => {
                let (compound, own) = put_compound(properties, blocks, list);
                group.push(compound);
                hash.update(&own);
                put_header(&mut headers, 0, &[], name, metadata, list);
            }
        }
    }
    hash.update(&headers);
    if !properties.is_empty() {
        group.push(blocks.data(&headers));
    }
    (blocks.group(&group), hash.finish())
}

fn put_value_header(
    out: &mut Vec<u8>,
    header: &AbcHeader,
    samples: &[AbcSample],
    sampling: u32,
    list: &mut MetadataList,
) {
    let kind = if header.scalar { 1 } else { 2 };
    let is_homogeneous = samples.iter().all(|sample| sample.elements == samples[0].elements);
    // Alembic can store the indices of the first and the last sample that changed. This writer
    // stores only a flag, which marks a property with fewer than two samples as constant.
    let is_constant = samples.len() < 2;
    let bits = kind
        | (header.pod as u32) << 4
        | u32::from(sampling != 0) << 8
        | u32::from(is_homogeneous) << 10
        | u32::from(is_constant) << 11
        | u32::from(header.extent) << 12;
    let numbers = [samples.len() as u32, sampling];
    let numbers = &numbers[..if sampling == 0 { 1 } else { 2 }];
    put_header(out, bits, numbers, &header.name, &header.metadata, list);
}

/// Appends the header of a property: its flags `bits`, numbers, name and metadata.
fn put_header(
    out: &mut Vec<u8>,
    bits: u32,
    numbers: &[u32],
    name: &str,
    metadata: &str,
    list: &mut MetadataList,
) {
    let sizes = [name.len() as u32, metadata.len() as u32];
    // All numbers of a property header are stored with the width that the largest number needs.
    let (code, width) = match numbers.iter().chain(&sizes).copied().fold(0, u32::max) {
        ..=0xff => (0, 1),
        0x100..=0xffff => (1, 2),
        _ => (2, 4),
    };
    let index = list.index(metadata);
    out.extend((bits | code << 2 | (index as u32) << 20).to_le_bytes());
    let mut put = |number: u32, text: &str| {
        out.extend(&number.to_le_bytes()[..width]);
        out.extend(text.as_bytes());
    };
    numbers.iter().for_each(|&number| put(number, ""));
    put(sizes[0], name);
    if index == INLINE_METADATA {
        put(sizes[1], metadata);
    }
}

/// The list of metadata that headers refer to by index.
#[derive(Default)]
struct MetadataList(Vec<String>);

impl MetadataList {
    /// The index of `metadata`. The index is 0 for empty metadata, and [`INLINE_METADATA`] if the
    /// metadata is longer than 255 bytes or the list is full.
    fn index(&mut self, metadata: &str) -> usize {
        if metadata.is_empty() {
            return 0;
        }
        if let Some(index) = self.0.iter().position(|listed| listed == metadata) {
            return index + 1;
        }
        if metadata.len() > 255 || self.0.len() + 1 == INLINE_METADATA {
            return INLINE_METADATA;
        }
        self.0.push(metadata.to_owned());
        self.0.len()
    }

    fn bytes(&self) -> Vec<u8> {
        let sized = |text: &String| [&[text.len() as u8], text.as_bytes()].concat();
        self.0.iter().flat_map(sized).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(times: &[f64]) -> (f64, Vec<f64>) {
        let sampling = TimeSampling::at(times);
        assert_eq!(sampling.samples as usize, times.len());
        (sampling.per_cycle, sampling.times)
    }

    #[test]
    fn uniform_times_are_stored_as_start_and_step_and_others_as_a_list() {
        assert_eq!(at(&[0.5, 0.75, 1.0, 1.25]), (0.25, vec![0.5]));
        let rounded: Vec<f64> = (1..=250).map(|frame| f64::from(frame) / 24.0).collect();
        let (per_cycle, first) = at(&rounded);
        assert!((per_cycle - 1.0 / 24.0).abs() < 1e-12 && first == [1.0 / 24.0]);
        assert_eq!(at(&[2.0]), (1.0, vec![2.0]));
        assert_eq!(at(&[0.0, 0.1, 0.3]), (ACYCLIC, vec![0.0, 0.1, 0.3]));
        // These times differ from uniform times by less than Alembic's tolerance, but by more than
        // a hundredth of a step, so they are stored as a list.
        assert_eq!(at(&[0.0, 1e-6, 3e-6]), (ACYCLIC, vec![0.0, 1e-6, 3e-6]));
    }
}
