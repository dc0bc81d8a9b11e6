//! Coincident particles: duplicates, and unused particles that a simulator parks at one position.

use glam::{DVec3, IVec3};
use serde::{Deserialize, Serialize};

use crate::brick::unpack;
use crate::grid::{BIN, FRACTIONS, Grid};

/// Particles that share their position with another particle, after rounding to 1 / [`FRACTIONS`]
/// of a cell.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct CoincidentParticles {
    /// The number of coincident particles, not counting the first particle at each position.
    pub particles: u64,
    /// The maximum number of particles at one position.
    pub most: u64,
    /// The position with the most particles.
    pub at: [f64; 3],
    /// Whether the bin of that position, and all adjacent bins, contain no other particle.
    pub alone: bool,
}

/// Counts of coincident particles, added up bin by bin.
#[derive(Debug, Clone, Copy, Default)]
pub struct CoincidentCounts {
    particles: u64,
    most: u64,
    bin: IVec3,
    record: u64,
}

/// Number of bits of the hash that finds records (packed particles) which may occur twice.
const BITS: u32 = 13;
/// Maximum number of records in a bin for which the hash is used. In a bin with more records, too
/// many different records have equal hashes.
const MOST_HASHED: usize = 1 << (BITS - 1);

impl CoincidentCounts {
    /// Counts the coincident particles of a bin. `records` has the packed particles of the bin.
    #[must_use]
    pub fn among(bin: IVec3, records: &[u64]) -> Self {
        let mut candidates = if records.len() <= MOST_HASHED {
            possible_duplicates(records)
        } else {
            records.to_vec()
        };
        candidates.sort_unstable();
        let mut found = Self { bin, ..Self::default() };
        for same in candidates.chunk_by(|a, b| a == b).filter(|same| same.len() > 1) {
            let count = same.len() as u64;
            found.particles += count - 1;
            if count > found.most {
                (found.most, found.record) = (count, same[0]);
            }
        }
        found
    }

    /// Adds the counts of another bin. If two positions have the same number of particles, the
    /// position whose bin and record come first is kept.
    pub fn add(&mut self, other: &Self) {
        let rank = |of: &Self| {
            (of.most, std::cmp::Reverse(of.bin.to_array()), std::cmp::Reverse(of.record))
        };
        let particles = self.particles + other.particles;
        if rank(other) > rank(self) {
            *self = *other;
        }
        self.particles = particles;
    }

    /// A report, if there are coincident particles. `bins` lists the number of particles in each
    /// bin.
    #[must_use]
    pub fn report(
        &self,
        grid: &Grid,
        bins: impl Iterator<Item = (IVec3, u64)>,
    ) -> Option<CoincidentParticles> {
        let (cell, offset) = unpack(self.record);
        let cell = self.bin * BIN + IVec3::from(cell.map(|c| c as i32));
        let offset = DVec3::from(offset.map(f64::from)) / f64::from(FRACTIONS);
        let near = |(bin, _): &(IVec3, u64)| (*bin - self.bin).abs().max_element() <= 1;
        let around: u64 = bins.filter(near).map(|(_, particles)| particles).sum();
        (self.particles > 0).then(|| CoincidentParticles {
            particles: self.particles,
            most: self.most,
            at: grid.world_from_cells(cell.as_dvec3() + offset).to_array(),
            alone: around == self.most,
        })
    }
}

/// Returns all records that occur more than once, and the records whose hash equals the hash of a
/// different record.
fn possible_duplicates(records: &[u64]) -> Vec<u64> {
    // For each hash, a bit in `seen[0]` is set if the hash occurs at least once, and a bit in
    // `seen[1]` if it occurs at least twice.
    let mut seen = [[0_u64; 1 << (BITS - 6)]; 2];
    // Multiplying by the golden ratio spreads a difference in any bit to the high bits.
    let bit = |record: u64| {
        let number = record.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - BITS);
        ((number >> 6) as usize, 1 << (number & 63))
    };
    for &record in records {
        let (word, bit) = bit(record);
        seen[1][word] |= seen[0][word] & bit;
        seen[0][word] |= bit;
    }
    let is_repeated = |record: &u64| {
        let (word, bit) = bit(*record);
        seen[1][word] & bit != 0
    };
    records.iter().copied().filter(is_repeated).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coincident_records_are_counted_in_sparse_and_crowded_bins() {
        for all in [100_u64, 2000, 10_000] {
            let mut records: Vec<u64> = (0..all).map(|i| i * 7_919_317 % (1 << 51)).collect();
            assert_eq!(CoincidentCounts::among(IVec3::ONE, &records).particles, 0, "{all}");
            let (pair, clump) = (records[3], records[50]);
            records.push(pair);
            records.extend([clump; 4]);
            let found = CoincidentCounts::among(IVec3::ONE, &records);
            assert_eq!((found.particles, found.most, found.record), (5, 5, clump), "{all}");
        }
    }

    #[test]
    fn a_clump_is_alone_if_the_surrounding_bins_are_empty() {
        let grid = Grid::new(DVec3::ZERO, 0.5).unwrap();
        // The record of a particle in the middle of cell (1, 0, 0) of its bin.
        let record = (1 << 13) | (1 << 12) | (1 << 12) << 17 | (1 << 12) << 34;
        let mut all = CoincidentCounts::among(IVec3::new(2, 0, 0), &[7, 7]);
        all.add(&CoincidentCounts::among(IVec3::new(-2, 0, 0), &[record; 3]));
        let report = |other: i32| {
            all.report(&grid, [(IVec3::new(-2, 0, 0), 3), (IVec3::new(other, 0, 0), 9)].into_iter())
        };
        let found = report(0).unwrap();
        assert_eq!((found.particles, found.most, found.alone), (3, 3, true));
        assert_eq!(found.at, [-15.25, 0.25, 0.25]);
        assert!(!report(-1).unwrap().alone);
    }
}
