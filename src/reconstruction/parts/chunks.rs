//! Chunks of the input with their bounding boxes. A part skips the chunks whose boxes contain none
//! of the bins that it samples.
//!
//! The benefit depends on the order of the input. If consecutive particles are near each other, a
//! part reads little more than its own particles. If the order is random, each chunk extends over
//! the whole fluid, and every part reads all chunks.

use std::fmt;
use std::ops::Range;

use glam::IVec3;
use serde::{Deserialize, Serialize};

use crate::brick::WithBoxes;
use crate::grid::stretch::WantedBins;
use crate::grid::{CellBox, Domain, Grid, Periodic};
use crate::io::{PieceChunk, Pieces};
use crate::particles::Particles;

/// Minimum number of particles in a chunk, except in the last chunk of a piece. Chunks of a large
/// input are larger, so that the list is not too long.
const FEWEST: usize = 1 << 12;
/// Maximum number of chunks in the list, not counting the last chunk of every piece.
const MOST: usize = 1 << 16;

/// Consecutive particles of a piece of the input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub(super) struct BinnedChunk {
    pub(super) particles: PieceChunk,
    /// The box of bins that contains the particles; `None` if no particle has a valid position.
    bins: Option<CellBox>,
}

/// Particles of the input that a part reads.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct PartInput {
    /// Numbers of the pieces that the part reads.
    pub(super) pieces: Vec<usize>,
    /// Number of particles in each of these pieces.
    counts: Vec<usize>,
    /// Ranges of the particles that the part reads. The particles of all these pieces are numbered
    /// consecutively.
    pub(super) ranges: Vec<Range<usize>>,
}

/// Cuts the particles of an input into a limited number of chunks.
pub(super) fn cut(particles: &Pieces) -> Vec<PieceChunk> {
    particles.chunks(particles.len().div_ceil(MOST).next_power_of_two().max(FEWEST))
}

/// Adds bounding boxes to chunks, after all particles have been read.
pub(super) fn boxed(
    chunks: &[PieceChunk],
    read: &WithBoxes<'_>,
    domain: Option<&Domain>,
) -> Vec<BinnedChunk> {
    let boxes = read.boxes(domain);
    chunks.iter().zip(boxes).map(|(&particles, bins)| BinnedChunk { particles, bins }).collect()
}

/// Records the bounding boxes of an input's chunks while its particles are read.
pub(super) fn with_boxes<'a>(
    particles: &'a Pieces,
    chunks: &[PieceChunk],
    grid: &Grid,
) -> WithBoxes<'a> {
    WithBoxes::new(particles, chunks.iter().map(|chunk| chunk.count), grid)
}

impl PartInput {
    /// The chunks of an input that may contain particles in the wanted bins or, in a periodic box,
    /// particles with images in these bins.
    pub(super) fn of(
        chunks: &[BinnedChunk],
        wanted: WantedBins,
        periodic: Option<&Periodic>,
    ) -> Self {
        let touches = |bins: CellBox| match periodic {
            None => wanted.overlaps(bins),
            Some(periodic) => periodic.with_images(bins).any(|bins| wanted.overlaps(bins)),
        };
        let mut reading = Self::default();
        let mut before = 0;
        for piece in chunks.chunk_by(|one, other| one.particles.piece == other.particles.piece) {
            let mut end = before;
            for BinnedChunk { particles, bins } in piece {
                let first = end;
                end += particles.count;
                match reading.ranges.last_mut() {
                    _ if !bins.is_some_and(touches) => {}
                    Some(range) if range.end == first => range.end = end,
                    _ => reading.ranges.push(first..end),
                }
            }
            if reading.ranges.last().is_some_and(|range| range.end > before) {
                reading.pieces.push(piece[0].particles.piece);
                reading.counts.push(end - before);
                before = end;
            }
        }
        reading
    }

    /// Whether the part reads no particles.
    pub(super) fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }

    /// The number of particles that the part reads.
    pub(super) fn count(&self) -> usize {
        self.ranges.iter().map(Range::len).sum()
    }

    /// Whether the opened pieces have the planned numbers of particles.
    pub(super) fn matches(&self, opened: &Pieces) -> bool {
        // `usize::MAX` does not limit the size of a chunk, so there is one chunk per piece.
        let found = opened.chunks(usize::MAX);
        let expected = self.pieces.iter().zip(&self.counts);
        found.into_iter().eq(expected.map(|(&piece, &count)| PieceChunk { piece, count }))
    }
}

/// Displays the number of the piece, the number of particles, and the lowest and highest bin.
impl fmt::Display for BinnedChunk {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { particles: PieceChunk { piece, count }, bins } = self;
        write!(f, "{piece} {count}")?;
        let Some(CellBox { lo, hi }) = bins else { return Ok(()) };
        let hi = *hi - 1;
        write!(f, " {} {} {} {} {} {}", lo.x, lo.y, lo.z, hi.x, hi.y, hi.z)
    }
}

impl From<BinnedChunk> for String {
    fn from(chunk: BinnedChunk) -> Self {
        chunk.to_string()
    }
}

impl TryFrom<String> for BinnedChunk {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let invalid_chunk = || format!("invalid chunk of the input: {text:?}");
        let words: Vec<&str> = text.split(' ').collect();
        let number = |word: &str| word.parse().map_err(|_| invalid_chunk());
        let coordinate = |word: &&str| word.parse::<i32>().map_err(|_| invalid_chunk());
        let [piece, count, corners @ ..] = &words[..] else { return Err(invalid_chunk()) };
        let particles = PieceChunk { piece: number(piece)?, count: number(count)? };
        let corners = corners.iter().map(coordinate).collect::<Result<Vec<_>, _>>()?;
        let bins = match corners[..] {
            [] => None,
            [x, y, z, a, b, c] => {
                Some(CellBox { lo: IVec3::new(x, y, z), hi: IVec3::new(a, b, c) + 1 })
            }
            _ => return Err(invalid_chunk()),
        };
        Ok(Self { particles, bins })
    }
}

#[cfg(test)]
mod tests {
    use crate::grid::BLOCK;
    use crate::grid::MortonKey;
    use crate::grid::stretch::{DecidingCells, Stretch};

    use super::*;

    fn chunk(piece: usize, count: usize, at: i32) -> BinnedChunk {
        let lo = IVec3::splat(at);
        BinnedChunk {
            particles: PieceChunk { piece, count },
            bins: Some(CellBox { lo, hi: lo + 2 }),
        }
    }

    #[test]
    fn chunks_round_trip_through_text_and_invalid_text_is_refused() {
        let without_bins = BinnedChunk { bins: None, ..chunk(3, 5, 0) };
        for chunk in [chunk(0, 4096, -3), chunk(7, 1, 2), without_bins] {
            assert_eq!(BinnedChunk::try_from(chunk.to_string()), Ok(chunk));
        }
        assert_eq!(chunk(0, 4096, -3).to_string(), "0 4096 -3 -3 -3 -2 -2 -2");
        for text in ["", "1", "1 2 3", "1 2 3 4 5 6 7", "1 -2", "1 2 a b c d e f", "1  2"] {
            assert!(BinnedChunk::try_from(text.to_owned()).is_err(), "{text:?}");
        }
    }

    #[test]
    fn only_chunks_that_touch_the_part_and_their_pieces_are_read() {
        let first = MortonKey::of(IVec3::ZERO);
        let stretch = Stretch { first, end: MortonKey(first.0 + 1) };
        let wanted =
            WantedBins { stretch, deciding: DecidingCells::new(CellBox::cube(IVec3::ZERO, BLOCK)) };
        let (near, far) = (0, 9);
        let chunks = [
            chunk(0, 10, far),
            chunk(0, 10, near),
            chunk(0, 5, near),
            chunk(2, 10, far),
            chunk(2, 3, far),
            chunk(3, 10, near),
            chunk(3, 10, far),
            chunk(3, 1, near),
        ];
        let reading = PartInput::of(&chunks, wanted, None);
        assert_eq!(reading.pieces, [0, 3]);
        assert_eq!(reading.counts, [25, 21]);
        // Consecutive ranges of the opened pieces are joined.
        assert_eq!(reading.ranges, [10..35, 45..46]);
        assert_eq!(reading.count(), 26);
        assert!(PartInput::of(&chunks[3..5], wanted, None).is_empty());
    }
}
