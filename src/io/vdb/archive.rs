//! The parts of a file outside its trees: the header, and the names, metadata and transform of each
//! grid.

use glam::IVec3;

use crate::surface::mesh::source::Lattice;

use super::values::Kind;

pub const MAGIC: i64 = 0x5644_4220;
/// The first version of the format that has all features that this writer uses.
pub const VERSION: u32 = 224;
/// A version of the OpenVDB library that writes this version of the format.
const LIBRARY: [u32; 2] = [10, 0];

/// Compression flag of a grid: zlib compresses the values.
const ZIP: u32 = 1;
/// Compression flag of a grid: only the values of active voxels are stored.
const ACTIVE_VALUES: u32 = 2;

/// OpenVDB's name for vectors that do not change when a program transforms their grid, such as
/// colours.
pub const INVARIANT: &str = "invariant";
/// OpenVDB's name for vectors that a program rotates and scales together with their grid, such as
/// velocities.
pub const CONTRAVARIANT_RELATIVE: &str = "contravariant relative";

/// The data of a grid except its tree.
#[derive(Debug, Clone)]
pub struct GridHead {
    pub name: String,
    pub kind: Kind,
    /// For a grid of vectors, [`INVARIANT`] or [`CONTRAVARIANT_RELATIVE`].
    pub vector_type: Option<&'static str>,
    pub lattice: Lattice,
    pub zip: bool,
    /// The number of active voxels.
    pub voxels: u64,
    /// The least and the greatest coordinates of the active voxels along each axis.
    pub bounds: [IVec3; 2],
}

/// The header of a file with the identifier `id` and `grids` grids.
pub fn header(id: [u32; 4], grids: usize) -> Vec<u8> {
    let mut out = MAGIC.to_le_bytes().to_vec();
    out.extend([VERSION, LIBRARY[0], LIBRARY[1]].map(u32::to_le_bytes).as_flattened());
    // 1 means that the file stores the offsets of each grid.
    out.push(1);
    let [a, b, c, d] = id;
    let id = format!(
        "{a:08x}-{:04x}-{:04x}-{:04x}-{:04x}{d:08x}",
        b >> 16,
        b & 0xffff,
        c >> 16,
        c & 0xffff
    );
    out.extend(id.as_bytes());
    // The file has no metadata of its own.
    out.extend(0u32.to_le_bytes());
    out.extend((grids as u32).to_le_bytes());
    out
}

impl GridHead {
    /// Encodes the part of the grid that precedes its tree and starts at byte `at` of the file. The
    /// tree consists of `topology` bytes, followed by `leaves` bytes with the values of its leaves.
    pub fn bytes(&self, at: u64, topology: u64, leaves: u64) -> Vec<u8> {
        let mut out = Vec::new();
        put_text(&mut out, &self.name);
        put_text(&mut out, &self.kind.tree());
        // An empty parent name means that this grid has its own tree.
        put_text(&mut out, "");
        let details = self.details();
        let begin = at + out.len() as u64 + 3 * size_of::<i64>() as u64;
        let blocks = begin + details.len() as u64 + topology;
        out.extend([begin, blocks, blocks + leaves].map(u64::to_le_bytes).as_flattened());
        out.extend(details);
        out
    }

    /// The grid's compression, metadata and transform.
    fn details(&self) -> Vec<u8> {
        let zip = if self.zip { ZIP } else { 0 };
        let mut out = (ACTIVE_VALUES | zip).to_le_bytes().to_vec();
        let text = |text: &str| ("string", text.as_bytes().to_vec());
        let place =
            |at: IVec3| ("vec3i", at.to_array().map(i32::to_le_bytes).as_flattened().to_vec());
        let is_level_set = matches!(self.kind, Kind::Distance { .. });
        let mut metadata = vec![
            ("class", text(if is_level_set { "level set" } else { "unknown" })),
            ("creator", text(concat!("meniscus ", env!("CARGO_PKG_VERSION")))),
            ("file_bbox_max", place(self.bounds[1])),
            ("file_bbox_min", place(self.bounds[0])),
            ("file_voxel_count", ("int64", self.voxels.to_le_bytes().to_vec())),
            ("is_saved_as_half_float", ("bool", vec![u8::from(self.kind.is_half())])),
            ("name", text(&self.name)),
        ];
        metadata.extend(self.vector_type.map(|name| ("vector_type", text(name))));
        out.extend((metadata.len() as u32).to_le_bytes());
        for (name, (kind, value)) in metadata {
            put_text(&mut out, name);
            put_text(&mut out, kind);
            out.extend((value.len() as u32).to_le_bytes());
            out.extend(value);
        }
        put_text(&mut out, "UniformScaleTranslateMap");
        let Lattice { origin, step: size } = self.lattice;
        let scales = [size, size, size.recip(), (size * size).recip(), (2.0 * size).recip()];
        out.extend(origin.map(f64::to_le_bytes).as_flattened());
        for scale in scales {
            out.extend([scale; 3].map(f64::to_le_bytes).as_flattened());
        }
        out
    }
}

fn put_text(out: &mut Vec<u8>, text: &str) {
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(text.as_bytes());
}
