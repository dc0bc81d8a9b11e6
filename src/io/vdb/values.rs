//! Encodes the numbers of a grid for a file.

use std::io::{self, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;
use half::f16;
use half::slice::HalfFloatSliceExt;

/// Marks a node whose inactive values are all the background value.
const OUTSIDE: u8 = 0;
/// Marks a node whose inactive values are all the negated background value.
const INSIDE: u8 = 1;
/// Marks a node with both kinds of inactive values. A mask follows, in which a set bit means the
/// background value.
const BOTH: u8 = 3;

/// Suffix of the type of a tree that is stored in half precision.
pub const HALF: &str = "_HalfFloat";

/// The type of a grid's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Signed distances. In this kind, inactive voxels inside the surface have the negated
    /// background value. In other kinds, all inactive voxels have the background value.
    Distance {
        half: bool,
    },
    /// Floating-point values with this number of components, 1 or 3.
    Real {
        components: usize,
        half: bool,
    },
    Int32,
    Int64,
}

impl Kind {
    /// The type name of a tree with values of this kind.
    pub fn tree(self) -> String {
        let value = match self {
            Self::Distance { .. } | Self::Real { components: 1, .. } => "float",
            Self::Real { .. } => "vec3s",
            Self::Int32 => "int32",
            Self::Int64 => "int64",
        };
        let half = if self.is_half() { HALF } else { "" };
        format!("Tree_{value}_5_4_3{half}")
    }

    pub fn is_half(self) -> bool {
        matches!(self, Self::Distance { half: true } | Self::Real { half: true, .. })
    }

    /// Size of an active voxel's value in bytes.
    pub fn bytes(self) -> usize {
        let number = if self.is_half() { 2 } else { 4 };
        match self {
            Self::Distance { .. } | Self::Int32 => number,
            Self::Real { components, .. } => components * number,
            Self::Int64 => 8,
        }
    }

    /// The background value. It is `number` in a grid of distances, and 0 in other grids. Floats
    /// take four bytes, even in grids of half precision.
    pub fn background(self, number: f32) -> Vec<u8> {
        match self {
            Self::Distance { half: true } => f16::from_f32(number).to_f32().to_le_bytes().to_vec(),
            Self::Distance { half: false } => number.to_le_bytes().to_vec(),
            Self::Real { components, .. } => vec![0; 4 * components],
            Self::Int32 => vec![0; 4],
            Self::Int64 => vec![0; 8],
        }
    }

    /// Appends a number. For the integer kinds, the bits of `number` are those of a 32-bit integer.
    fn put(self, out: &mut Vec<u8>, number: f32) {
        match self {
            _ if self.is_half() => out.extend(f16::from_f32(number).to_le_bytes()),
            Self::Distance { .. } | Self::Real { .. } | Self::Int32 => {
                out.extend(number.to_le_bytes());
            }
            Self::Int64 => out.extend(i64::from(number.to_bits()).to_le_bytes()),
        }
    }

    /// Appends numbers as [`put`](Self::put) does, but faster.
    pub fn put_all(self, out: &mut Vec<u8>, numbers: &[f32]) {
        if self.is_half() {
            let mut halves = vec![f16::ZERO; numbers.len()];
            halves.convert_from_f32_slice(numbers);
            out.extend(halves.iter().flat_map(|half| half.to_le_bytes()));
        } else {
            numbers.iter().for_each(|&number| self.put(out, number));
        }
    }

    /// Appends an empty list of active values, for a node that has none.
    pub fn put_no_values(self, out: &mut Vec<u8>, zip: bool) {
        if zip && !self.is_half() {
            out.extend(0i64.to_le_bytes());
        }
    }

    fn has_sides(self) -> bool {
        matches!(self, Self::Distance { .. })
    }
}

/// Appends a record that says which inactive values of a node are inside the surface.
///
/// `all` is the number of inactive values, and `inside` is the number of those that are inside. The
/// mask `outside` has a set bit for each value outside, and is appended if there are values on both
/// sides.
pub fn put_inactive_record(
    out: &mut Vec<u8>,
    kind: Kind,
    [inside, all]: [usize; 2],
    outside: &[u64],
) {
    match inside {
        _ if !kind.has_sides() => out.push(OUTSIDE),
        0 => out.push(OUTSIDE),
        _ if inside == all => out.push(INSIDE),
        _ => {
            out.push(BOTH);
            out.extend(outside.iter().flat_map(|word| word.to_le_bytes()));
        }
    }
}

/// The number of bytes that [`put_inactive_record`] appends if its mask has `mask` bytes.
pub fn inactive_record_bytes(kind: Kind, [inside, all]: [usize; 2], mask: u64) -> u64 {
    if kind.has_sides() && inside > 0 && inside < all { 1 + mask } else { 1 }
}

/// Appends `bytes` compressed by zlib, after their compressed size. If compression does not make
/// them shorter, appends the original bytes after their negated size.
pub fn put_zipped(out: &mut Vec<u8>, bytes: &[u8]) {
    let zipped = || -> io::Result<Vec<u8>> {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(bytes)?;
        encoder.finish()
    };
    let zipped = zipped().expect("writing to a `Vec` does not fail");
    if zipped.len() < bytes.len() {
        out.extend((zipped.len() as i64).to_le_bytes());
        out.extend(zipped);
    } else {
        out.extend((-(bytes.len() as i64)).to_le_bytes());
        out.extend(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn put_all_appends_the_same_bytes_as_repeated_put() {
        let numbers: Vec<f32> = (-300..300).map(|i| (i as f32 * 0.1).powi(5) * 1e-4).collect();
        for kind in [Kind::Distance { half: true }, Kind::Distance { half: false }, Kind::Int64] {
            let (mut all_at_once, mut one_by_one) = (vec![7], vec![7]);
            kind.put_all(&mut all_at_once, &numbers);
            numbers.iter().for_each(|&number| kind.put(&mut one_by_one, number));
            assert_eq!(all_at_once, one_by_one, "{kind:?}");
        }
    }
}
