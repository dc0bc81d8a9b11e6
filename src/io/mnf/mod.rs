//! Packed frames: the DIF of one frame, with its bricks compressed page by page in Morton order
//! (.mnf).
//!
//! All numbers are little-endian. A page contains the bricks of one bin of 16^3 cells. The file is
//! written sequentially, so its summary is at the end.
//!
//! | part | bytes | content |
//! |---|---|---|
//! | header | 8 | `89 4D 4E 46 0D 0A 1A 0A`; a conversion of line ends changes these bytes, so readers detect it |
//! | | 4 | version: 2, or 3 for particles of several sizes |
//! | | 4 | edge of a brick in cells: 4, 8 or 16 |
//! | pages | | one zstd frame of samples per page, in key order and without gaps |
//! | footer | 3 x 8 | origin of the grid, f64 |
//! | | 8 | edge of a cell, f64 |
//! | | 4 | sum of flags: 1 for walls, 2 for a periodic box, 4 for particles of several sizes |
//! | | 4 | indicator: 0 symmetry, 1 counting, 2 cloud |
//! | | 6 x 8 | lower and upper corner of the walls, f64; -inf and inf for sides without a wall; 0 if there are no walls |
//! | | 8 | mu0, f64; 0 for symmetry and cloud |
//! | | 8 | spacing, f64; 0 if it is not known; the smallest size if there are several |
//! | | 4 x 8 | four numbers of particles: in cells, with positions that are not finite, too far from the grid's origin, outside the walls or the box |
//! | if periodic | 6 x 8 | lower and upper corner of the box, f64; -inf and inf along an open axis |
//! | | 4 | distance from the box, in cells, within which the pages include images of particles |
//! | | 4 | number of particles that were wrapped into the box, at most 2^32 - 1 |
//! | if several sizes | 8 | largest size, f64 |
//! | | 8 | share of space that the particles fill deep in the fluid: their total volume, divided by the volume of the space, f64; 0 if it is not known |
//! | footer | 8 | number of pages |
//! | index, per page | 8 | Morton key of its bin: 21 bits per axis, x lowest, each biased by 2^20 |
//! | | 8 | offset of the page in the file |
//! | | 8 | one bit for each stored brick, by its Morton index in the bin |
//! | | 4 | size of the compressed page, in bytes |
//! | | 4 | CRC-32 of the compressed page |
//! | | 4 | number of full cells |
//! | | 6 | tightest box around the full cells, in coordinates of the bin: lowest cell, and one past the highest cell |
//! | | 2 | number of the page's field, if the particles have several sizes, else 0 |
//! | tail | 8 | offset of the footer in the file |
//! | | 4 | CRC-32 of the header, the footer, the index and the offset of the footer |
//! | | 8 | `0A 1A 0A 0D 46 4E 4D 89` |
//!
//! A page contains the samples of its bricks in order, with x varying fastest within each brick.
//! The low bytes of all samples come first, then the high bytes.
//!
//! For symmetry, a sample is the DIF, from 0 to 65535. For counting, a sample is a number of
//! particles, at most 65535, and the DIF is theta(N) = min(N, mu0) / mu0 in 65535ths, rounded. For
//! cloud, a brick has a ghost layer of one cell on every side, and a sample is the amount that the
//! particles of the brick add to a cell. Each particle adds an
//! [`Amount`](crate::field::indicator::Amount) in total, which depends on the spacing in cells. The
//! value of a cell is the sum over all bricks, at most 65535. A cell is full if its value in its
//! own page is nonzero.
//!
//! If the particles have several sizes, the file has two fields for each octave of the sizes,
//! starting with the finest: the volume of the particles (field 2 k of octave k), and the volume
//! times the logarithm of the size in the octave (field 2 k + 1), as [`sizes`](crate::field::sizes)
//! defines them. The indicator is cloud. All pages of a field are consecutive, and their cells are
//! 2^k times as wide as the grid's.
//!
//! Version 1 differs only for the indicator cloud: in that version, the size of a cloud depends on
//! mu0. Frames of version 1 with the indicator cloud are rejected. Other frames of version 1 can be
//! read.
//!
//! The guide for users is `packed.md`.

mod read;
mod write;

use std::path::Path;

use crate::brick::{DifField, FrameFacts};
use crate::field::indicator::{Indicator, SampledDif};
use crate::field::sizes::SampledOctaves;

pub use read::{frame_from_file, open_frame};
pub use write::{FrameWriter, write_frame};

/// A frame from a packed file.
#[derive(Debug)]
pub enum PackedFrame {
    /// Particles of one size.
    Dif(SampledDif),
    /// Particles of several sizes.
    Octaves(SampledOctaves),
}

/// The samples of a frame, which a packed file can store.
#[derive(Debug, Clone, Copy)]
pub enum PackableFrame<'a> {
    /// Particles of one size.
    Dif(&'a SampledDif),
    /// Particles of several sizes.
    Octaves(&'a SampledOctaves),
}

impl PackedFrame {
    /// The samples.
    #[must_use]
    pub fn samples(&self) -> PackableFrame<'_> {
        match self {
            Self::Dif(sampled) => PackableFrame::Dif(sampled),
            Self::Octaves(sampled) => PackableFrame::Octaves(sampled),
        }
    }

    /// Facts of the frame.
    #[must_use]
    pub fn facts(&self) -> &FrameFacts {
        self.samples().facts()
    }

    /// The indicator, with mu0 for counting.
    #[must_use]
    pub fn indicator(&self) -> Indicator {
        self.samples().indicator()
    }
}

impl<'a> PackableFrame<'a> {
    /// Facts of the frame.
    #[must_use]
    pub fn facts(self) -> &'a FrameFacts {
        match self {
            Self::Dif(sampled) => &sampled.facts,
            Self::Octaves(sampled) => &sampled.facts,
        }
    }

    /// The indicator, with mu0 for counting.
    #[must_use]
    pub fn indicator(self) -> Indicator {
        match self {
            Self::Dif(sampled) => sampled.indicator,
            Self::Octaves(_) => Indicator::Cloud,
        }
    }

    /// The fields, each with the octave of its cells.
    #[must_use]
    pub fn fields(self) -> Vec<(u32, &'a DifField)> {
        match self {
            Self::Dif(sampled) => vec![(0, &*sampled.dif)],
            Self::Octaves(sampled) => {
                (0..).zip(sampled.clouds.fields()).map(|(at, field)| (at / 2, field)).collect()
            }
        }
    }

    /// The fields that together contain each particle once, each with the octave of its cells: the
    /// only field, or the volume field of each octave.
    #[must_use]
    pub fn volumes(self) -> Vec<(u32, &'a DifField)> {
        let step = match self {
            Self::Dif(_) => 1,
            Self::Octaves(_) => 2,
        };
        self.fields().into_iter().step_by(step).collect()
    }

    /// The largest size, if the particles have several sizes.
    #[must_use]
    pub fn coarsest(self) -> Option<f64> {
        match self {
            Self::Dif(_) => None,
            Self::Octaves(sampled) => Some(sampled.coarsest),
        }
    }
}

/// Whether `path` has the extension of a packed frame.
#[must_use]
pub fn is_packed(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mnf"))
}

const MAGIC: [u8; 8] = *b"\x89MNF\r\n\x1a\n";
const END_MAGIC: [u8; 8] = *b"\n\x1a\n\rFNM\x89";
/// The version of files with particles of one size.
const VERSION: u32 = 2;
/// The version of files with particles of several sizes.
const SIZES_VERSION: u32 = 3;
/// The first version of the format. Its frames can be read, except those with the indicator cloud.
const FIRST_VERSION: u32 = 1;

/// Flag in the footer: there are walls.
const WALLS: u32 = 1;
/// Flag in the footer: the box is periodic.
const PERIODIC: u32 = 2;
/// Flag in the footer: the particles have several sizes.
const SIZES: u32 = 4;

/// Size, in bytes, of the header.
const HEADER: usize = 16;
/// Size, in bytes, of the footer without the parts for a periodic box and for several sizes.
const FACTS: usize = 144;
/// Size, in bytes, of a page's entry in the index.
const ENTRY: usize = 44;
/// Size, in bytes, of the tail.
const TAIL: usize = 20;

/// Returns the low bytes of all samples, followed by the high bytes. This order compresses better,
/// and does not depend on the machine's byte order.
fn planes_from_samples(samples: &[u16]) -> Vec<u8> {
    let bytes = |byte: usize| samples.iter().map(move |sample| sample.to_le_bytes()[byte]);
    bytes(0).chain(bytes(1)).collect()
}

/// Joins the low and high bytes of samples, the inverse of [`planes_from_samples`].
fn samples_from_planes(planes: &[u8]) -> Vec<u16> {
    let (low, high) = planes.split_at(planes.len() / 2);
    low.iter().zip(high).map(|(&low, &high)| u16::from_le_bytes([low, high])).collect()
}
