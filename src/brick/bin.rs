//! Binning: a counting sort of the particles by the bin of 16^3 cells that holds them.
//!
//! Positions are read twice and never kept: once to count, once to drop each particle, packed into 51
//! bits, into its bin's place. The order inside a bin is arbitrary; whoever reads a bin adds integers.

use std::ops::Range;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use bytemuck::allocation::zeroed_vec;
use glam::IVec3;
use hashbrown::HashMap;
use multiversion::multiversion;
use rayon::prelude::*;
use thiserror::Error;

use crate::grid::{BIN, Domain, FRACTION_BITS, Grid, MortonKey, Placed, Unplaced};
use crate::particles::Particles;

/// Particles decoded at once: small enough to stay in the first-level cache.
const CHUNK: usize = 512;
/// Bits per axis of a packed particle: its offset in the cell, and the cell in the bin.
const AXIS_BITS: u32 = FRACTION_BITS + BIN.ilog2();

/// What to do with particles that are not finite, or beyond the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InvalidParticles {
    /// Stop and name the first.
    Refuse,
    /// Leave them out and count them.
    Skip,
}

/// Particles that cannot be binned.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum BinError {
    /// A coordinate is NaN or infinite.
    #[error(
        "particle {index} has a coordinate that is not finite: ({}, {}, {}); --skip-invalid drops such particles",
        position[0], position[1], position[2]
    )]
    NotFinite {
        /// Counted from 0 in the order of the file.
        index: usize,
        /// Its position.
        position: [f64; 3],
    },
    /// A coordinate is beyond the addressable grid.
    #[error(
        "particle {index} at ({}, {}, {}) is more than {} cells of {cell_size} from the origin; \
         use a larger cell size, move --origin, or drop such particles with --skip-invalid",
        position[0], position[1], position[2], crate::grid::CELL_LIMIT
    )]
    TooFar {
        /// Counted from 0 in the order of the file.
        index: usize,
        /// Its position.
        position: [f64; 3],
        /// Edge of a cell.
        cell_size: f64,
    },
}

/// How many particles went where.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Census {
    /// In a bin.
    pub binned: usize,
    /// Not finite; dropped.
    pub not_finite: usize,
    /// Beyond the addressable grid; dropped.
    pub too_far: usize,
    /// Outside of the domain's walls; not counted by the method.
    pub outside: usize,
}

/// Particles in order of their bins.
#[derive(Debug)]
pub struct Bins {
    keys: Vec<MortonKey>,
    /// Where each bin's particles begin in `records`, and where the last one's end.
    first: Vec<usize>,
    records: Vec<u64>,
    attributes: Vec<BinnedAttribute>,
    census: Census,
}

/// An attribute's values in the order of the records.
#[derive(Debug)]
struct BinnedAttribute {
    components: usize,
    values: Vec<f32>,
}

impl Bins {
    /// The bins that hold particles, in Morton order.
    #[must_use]
    pub fn keys(&self) -> &[MortonKey] {
        &self.keys
    }

    /// What became of the particles.
    #[must_use]
    pub fn census(&self) -> Census {
        self.census
    }

    /// The particles of bin number `bin`: cell in the bin (x fastest), and offset in the cell.
    pub fn particles(&self, bin: usize) -> impl Iterator<Item = (usize, [u32; 3])> + '_ {
        self.records[self.first[bin]..self.first[bin + 1]].iter().map(|&record| unpack(record))
    }

    /// Attribute number `attribute` of the same particles, in the same order.
    pub fn attribute(&self, attribute: usize, bin: usize) -> impl Iterator<Item = &[f32]> + '_ {
        let BinnedAttribute { components, values } = &self.attributes[attribute];
        values[self.first[bin] * components..self.first[bin + 1] * components].chunks_exact(*components)
    }
}

/// The first of two readings: how many particles each bin will hold.
pub struct BinPlan<'a> {
    placer: Placer<'a>,
    census: Census,
    keys: Vec<MortonKey>,
    first: Vec<usize>,
    /// For every range of particles, where in the records its part of each bin begins.
    ranges: Vec<(Range<usize>, BinTable)>,
}

impl<'a> BinPlan<'a> {
    /// Counts `particles` by bin.
    ///
    /// # Errors
    /// [`BinError`], naming the first invalid particle, unless they are skipped.
    pub fn count(
        particles: &(impl Particles + ?Sized),
        grid: &'a Grid,
        domain: Option<&'a Domain>,
        invalid: InvalidParticles,
    ) -> Result<Self, BinError> {
        let placer = Placer { grid, domain };
        let ranges = ranges(particles.len());
        let counts: Vec<RangeCount> =
            ranges.par_iter().map(|range| placer.count(particles, range.clone())).collect();
        if invalid == InvalidParticles::Refuse
            && let Some((index, position, fault)) = counts.iter().find_map(|c| c.first_invalid)
        {
            return Err(match fault {
                Unplaced::NotFinite => BinError::NotFinite { index, position },
                Unplaced::TooFar => BinError::TooFar { index, position, cell_size: grid.cell_size() },
            });
        }
        let mut census = Census::default();
        for count in &counts {
            census.binned += count.census.binned;
            census.not_finite += count.census.not_finite;
            census.too_far += count.census.too_far;
            census.outside += count.census.outside;
        }
        let (keys, first, cursors) = lay_out(counts);
        Ok(Self { placer, census, keys, first, ranges: ranges.into_iter().zip(cursors).collect() })
    }

    /// What became of the particles.
    #[must_use]
    pub fn census(&self) -> Census {
        self.census
    }

    /// The bins that hold particles, in Morton order, and how many each.
    pub fn counts(&self) -> impl Iterator<Item = (MortonKey, usize)> + '_ {
        self.keys.iter().copied().zip(self.first.windows(2).map(|w| w[1] - w[0]))
    }

    /// The second reading: sorts the same `particles` into their bins, and with them the attributes whose
    /// numbers are in `carried`.
    #[must_use]
    pub fn fill(self, particles: &(impl Particles + ?Sized), carried: &[usize]) -> Bins {
        let Self { placer, census, keys, first, ranges } = self;
        let components: Vec<usize> =
            carried.iter().map(|&index| particles.attributes()[index].components).collect();
        // Every slot is written once, by whichever thread holds its particle.
        let records: Vec<AtomicU64> = zeroed_vec(census.binned);
        let values: Vec<Vec<AtomicU32>> =
            components.iter().map(|components| zeroed_vec(census.binned * components)).collect();
        ranges.into_par_iter().for_each(|(range, mut cursors)| {
            placer.for_each_chunk(particles, range, |first, _, places| {
                let mut slots = [None; CHUNK];
                for (slot, place) in slots.iter_mut().zip(places) {
                    if let Ok(Some(placed)) = place {
                        let at = cursors.advance(bin_of(placed.cell));
                        records[at].store(pack(placed), Ordering::Relaxed);
                        *slot = Some(at);
                    }
                }
                for ((&components, values), &index) in components.iter().zip(&values).zip(carried) {
                    let mut tuples = vec![0.0; places.len() * components];
                    particles.attribute(index, first, &mut tuples);
                    for (slot, tuple) in slots.iter().zip(tuples.chunks_exact(components)) {
                        let Some(slot) = slot else { continue };
                        let to = &values[slot * components..];
                        to.iter().zip(tuple).for_each(|(to, x)| to.store(x.to_bits(), Ordering::Relaxed));
                    }
                }
            });
        });
        let records = records.into_iter().map(AtomicU64::into_inner).collect();
        let attributes = components
            .into_iter()
            .zip(values)
            .map(|(components, values)| BinnedAttribute {
                components,
                values: values.into_iter().map(|bits| f32::from_bits(bits.into_inner())).collect(),
            })
            .collect();
        Bins { keys, first, records, attributes, census }
    }
}

/// A few ranges of particles a thread. What is computed does not depend on how many there are.
fn ranges(len: usize) -> Vec<Range<usize>> {
    let count = (rayon::current_num_threads() * 2).min(len.div_ceil(1 << 16)).max(1);
    (0..count).map(|i| len * i / count..len * (i + 1) / count).collect()
}

/// What a range of particles holds.
struct RangeCount {
    table: BinTable,
    census: Census,
    first_invalid: Option<(usize, [f64; 3], Unplaced)>,
}

/// A number for each bin that a range of particles touches: first its count, then its next free record.
#[derive(Default)]
struct BinTable {
    rank: HashMap<u64, u32>,
    numbers: Vec<usize>,
    /// Neighbours in the file are often neighbours in space.
    last: Option<(u64, u32)>,
}

impl BinTable {
    /// Adds one to a bin's number, and returns what it was.
    fn advance(&mut self, bin: u64) -> usize {
        let rank = match self.last {
            Some((last, rank)) if last == bin => rank,
            _ => {
                let next = self.numbers.len() as u32;
                let rank = *self.rank.entry(bin).or_insert(next);
                if rank == next {
                    self.numbers.push(0);
                }
                self.last = Some((bin, rank));
                rank
            }
        };
        let number = &mut self.numbers[rank as usize];
        *number += 1;
        *number - 1
    }
}

/// Gives every bin its stretch of the records, and every range its part of each stretch.
fn lay_out(counts: Vec<RangeCount>) -> (Vec<MortonKey>, Vec<usize>, Vec<BinTable>) {
    let mut bins: Vec<(MortonKey, u64)> = counts
        .iter()
        .flat_map(|c| c.table.rank.keys())
        .map(|&bin| (MortonKey::of(unpack_bin(bin)), bin))
        .collect();
    bins.par_sort_unstable();
    bins.dedup();
    let rank: HashMap<u64, usize> = bins.iter().enumerate().map(|(i, &(_, bin))| (bin, i)).collect();

    let mut first = vec![0; bins.len() + 1];
    for table in counts.iter().map(|c| &c.table) {
        table.rank.iter().for_each(|(bin, &local)| first[rank[bin] + 1] += table.numbers[local as usize]);
    }
    for i in 0..bins.len() {
        first[i + 1] += first[i];
    }
    let mut next = first.clone();
    let cursors = counts
        .into_iter()
        .map(|RangeCount { mut table, .. }| {
            for (bin, &local) in &table.rank {
                let next = &mut next[rank[bin]];
                let begin = *next;
                *next += table.numbers[local as usize];
                table.numbers[local as usize] = begin;
            }
            table
        })
        .collect();
    (bins.into_iter().map(|(key, _)| key).collect(), first, cursors)
}

/// Places particles in the grid and the domain.
#[derive(Clone, Copy)]
struct Placer<'a> {
    grid: &'a Grid,
    domain: Option<&'a Domain>,
}

/// Where a particle is; `None` outside of the domain.
type Place = Result<Option<Placed>, Unplaced>;

impl Placer<'_> {
    fn count(&self, particles: &(impl Particles + ?Sized), range: Range<usize>) -> RangeCount {
        let mut table = BinTable::default();
        let mut census = Census::default();
        let mut first_invalid = None;
        self.for_each_chunk(particles, range, |first, positions, places| {
            for (i, place) in places.iter().enumerate() {
                match place {
                    Ok(Some(placed)) => {
                        census.binned += 1;
                        table.advance(bin_of(placed.cell));
                    }
                    Ok(None) => census.outside += 1,
                    Err(fault) => {
                        match fault {
                            Unplaced::NotFinite => census.not_finite += 1,
                            Unplaced::TooFar => census.too_far += 1,
                        }
                        first_invalid.get_or_insert((first + i, positions[i], *fault));
                    }
                }
            }
        });
        RangeCount { table, census, first_invalid }
    }

    /// Calls `each` with the number of a chunk's first particle, their positions and their places.
    fn for_each_chunk(
        &self,
        particles: &(impl Particles + ?Sized),
        range: Range<usize>,
        mut each: impl FnMut(usize, &[[f64; 3]], &[Place]),
    ) {
        let mut positions = vec![[0.0; 3]; CHUNK];
        let mut places: Vec<Place> = vec![Ok(None); CHUNK];
        for first in range.clone().step_by(CHUNK) {
            let count = CHUNK.min(range.end - first);
            let (positions, places) = (&mut positions[..count], &mut places[..count]);
            particles.positions(first, positions);
            place_all(self.grid, self.domain, positions, places);
            each(first, positions, places);
        }
    }
}

#[multiversion(targets("x86_64+avx2+fma+bmi1+bmi2", "x86_64+sse4.1"))]
fn place_all(grid: &Grid, domain: Option<&Domain>, positions: &[[f64; 3]], places: &mut [Place]) {
    for (place, &position) in places.iter_mut().zip(positions) {
        *place = match (grid.place(position), domain) {
            (Ok(placed), None) => Ok(Some(placed)),
            (Ok(placed), Some(domain)) => Ok(domain.contains(position).then(|| domain.clamp(placed))),
            // What lies outside of the domain is no concern of the grid.
            (Err(Unplaced::TooFar), Some(_)) => Ok(None),
            (Err(fault), _) => Err(fault),
        };
    }
}

/// The bin that holds a cell, as three biased coordinates of 21 bits: cheaper than its Morton key.
fn bin_of(cell: IVec3) -> u64 {
    let axis = |c: i32| u64::from((c >> BIN.ilog2()) as u32 & 0x1f_ffff);
    axis(cell.x) | axis(cell.y) << 21 | axis(cell.z) << 42
}

fn unpack_bin(bin: u64) -> IVec3 {
    let axis = |shift: u32| ((bin >> shift) as i32) << 11 >> 11;
    IVec3::new(axis(0), axis(21), axis(42))
}

fn pack(placed: &Placed) -> u64 {
    let axis = |a: usize| {
        let local = (placed.cell[a] & (BIN - 1)) as u64;
        local << FRACTION_BITS | u64::from(placed.offset[a])
    };
    axis(0) | axis(1) << AXIS_BITS | axis(2) << (2 * AXIS_BITS)
}

#[inline(always)]
fn unpack(record: u64) -> (usize, [u32; 3]) {
    let axis = [0, 1, 2].map(|a| (record >> (a * AXIS_BITS)) as u32 & ((1 << AXIS_BITS) - 1));
    let [x, y, z] = axis.map(|bits| (bits >> FRACTION_BITS) as usize);
    let bin = BIN as usize;
    (x + bin * (y + bin * z), axis.map(|bits| bits & ((1 << FRACTION_BITS) - 1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packing_keeps_cell_and_offset_at_both_ends_of_a_bin() {
        for (cell, offset) in [(IVec3::ZERO, [0; 3]), (IVec3::new(-1, 31, -16), [8191, 1, 4096])] {
            let (local, offsets) = unpack(pack(&Placed { cell, offset }));
            let wrapped = cell & 15;
            assert_eq!(local, (wrapped.x + 16 * wrapped.y + 256 * wrapped.z) as usize);
            assert_eq!(offsets, offset.map(u32::from));
            assert_eq!(unpack_bin(bin_of(cell)), cell >> 4);
        }
    }
}
