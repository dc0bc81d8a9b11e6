//! Numbers of a grid as they stand in a file.

use std::io::{self, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;
use half::f16;

/// Marks nodes whose inactive values are all the background.
const OUTSIDE: u8 = 0;
/// Marks nodes whose inactive values are all the negated background.
const INSIDE: u8 = 1;
/// Marks nodes with a mask of the inactive values that are the background and not its negation.
const BOTH: u8 = 3;

/// The type of a grid's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Signed distances: the only kind with values inside other than the background.
    Distance {
        half: bool,
    },
    /// Numbers with this many components, 1 or 3.
    Real {
        components: usize,
        half: bool,
    },
    Whole,
}

impl Kind {
    /// The name of a tree with such values.
    pub fn tree(self) -> String {
        let value = match self {
            Self::Distance { .. } | Self::Real { components: 1, .. } => "float",
            Self::Real { .. } => "vec3s",
            Self::Whole => "int32",
        };
        let half = if self.is_half() { "_HalfFloat" } else { "" };
        format!("Tree_{value}_5_4_3{half}")
    }

    pub fn is_half(self) -> bool {
        matches!(self, Self::Distance { half: true } | Self::Real { half: true, .. })
    }

    /// One value whose components are all `number`; a number of half precision still has four bytes.
    pub fn value(self, number: f32) -> Vec<u8> {
        match self {
            Self::Distance { half: true } => f16::from_f32(number).to_f32().to_le_bytes().to_vec(),
            Self::Distance { half: false } => number.to_le_bytes().to_vec(),
            Self::Real { components, .. } => vec![0; 4 * components],
            Self::Whole => vec![0; 4],
        }
    }

    /// Appends numbers, those of a value together; integers as their 32 bits.
    pub fn put(self, out: &mut Vec<u8>, numbers: &[f32], zip: bool) {
        let mut bytes = Vec::with_capacity(4 * numbers.len());
        if self.is_half() {
            bytes.extend(numbers.iter().flat_map(|&number| f16::from_f32(number).to_le_bytes()));
        } else {
            bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        }
        if zip { put_zipped(out, &bytes) } else { out.extend(bytes) }
    }

    /// Appends the active values of a node that has none.
    pub fn put_none(self, out: &mut Vec<u8>, zip: bool) {
        if zip && !self.is_half() {
            out.extend(0i64.to_le_bytes());
        }
    }
}

/// Appends which inactive values of a node are inside: `inside` of `all`, and a mask of those that
/// are outside.
pub fn put_sides(out: &mut Vec<u8>, kind: Kind, [inside, all]: [usize; 2], outside: &[u64]) {
    let has_sides = matches!(kind, Kind::Distance { .. });
    match inside {
        _ if !has_sides => out.push(OUTSIDE),
        0 => out.push(OUTSIDE),
        _ if inside == all => out.push(INSIDE),
        _ => {
            out.push(BOTH);
            out.extend(outside.iter().flat_map(|word| word.to_le_bytes()));
        }
    }
}

/// Appends zlib's encoding after its length; or the bytes as they are, after their negated length,
/// unless that makes them shorter.
fn put_zipped(out: &mut Vec<u8>, bytes: &[u8]) {
    let zipped = || -> io::Result<Vec<u8>> {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(bytes)?;
        encoder.finish()
    };
    let zipped = zipped().expect("memory does not fail");
    if zipped.len() < bytes.len() {
        out.extend((zipped.len() as i64).to_le_bytes());
        out.extend(zipped);
    } else {
        out.extend((-(bytes.len() as i64)).to_le_bytes());
        out.extend(bytes);
    }
}
