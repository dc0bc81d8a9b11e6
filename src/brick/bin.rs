//! Binning: a counting sort of the particles by their bin of 16^3 cells.
//!
//! Positions are read twice: once to count the particles of each bin, and once to put each
//! particle, packed into 51 bits, into its bin's slots in memory, or into its run of bins (`runs`).
//! If memory allows, the first reading keeps the bin and the packed position of each particle, so
//! that they need not be computed again. The order of the particles inside a bin is arbitrary. The
//! order does not affect sums of integers; for sums of floating-point numbers, [`Bins::sorted`]
//! gives a fixed order.

use std::convert::Infallible;
use std::fmt;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use hashbrown::HashMap;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::grid::stretch::WantedBins;
use crate::grid::{Domain, Grid, MortonKey, PlacementError};
use crate::particles::{AttributeKind, Particles, RereadError};
use crate::system::memory::empty_in_huge_pages;

use super::bin_table::{BinTable, LatestNumbers, NOWHERE, Placed};
use super::bins::{Bins, FREE_BITS, RECORD_BITS};
use super::cubes::{BinCode, CUBE, bin_coord};
use super::place::{BinSieve, CHUNK, Placer};
use super::slots::{Record, Slots};

/// Maximum number of bins that a range of particles may touch if the places of its particles are
/// kept. A place is one word: the packed position of a particle and, in the otherwise free bits,
/// the rank of the particle's bin. The greatest rank marks a particle without a bin.
const KEPT_BINS: usize = (1 << FREE_BITS) - 1;

/// The memory limits of counting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CountingRoom {
    /// Maximum number of bins.
    pub bins: usize,
    /// Maximum number of particles for which places are kept. No places are kept for a larger
    /// frame. A place consists of the rank of a bin and a packed position, and takes
    /// [`Self::PLACE`] bytes. If places are kept, the second reading does not read the positions
    /// again.
    pub places: usize,
}

/// Maximum bytes of places that are kept between the two readings. A higher limit would rarely
/// help, because larger frames usually touch more bins than the free bits of a place can
/// distinguish.
const MOST_PLACES: u64 = 64 << 20;

impl CountingRoom {
    /// Bytes of a kept place.
    pub const PLACE: u64 = size_of::<Record>() as u64;

    /// The limits for a budget in bytes: half of it for tables, and at most an eighth for places.
    pub fn within(budget: u64) -> Self {
        let number = |bytes: u64| usize::try_from(bytes).unwrap_or(usize::MAX);
        let places = (budget / 8).min(MOST_PLACES) / Self::PLACE;
        Self { bins: number(budget / 2 / Bins::TABLE_BYTES), places: number(places) }
    }

    /// No limit on bins, and no kept places.
    pub const BINS: Self = Self { bins: usize::MAX, places: 0 };
}

/// The treatment of particles whose position is not finite, too far from the grid's origin, or far
/// outside the periodic box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InvalidParticles {
    /// Return an error that names the first invalid particle.
    Refuse,
    /// Skip and count invalid particles.
    Skip,
}

/// An error of binning.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum BinError {
    /// A coordinate is NaN or infinite.
    #[error(
        "particle {index} has a coordinate that is not finite: ({}, {}, {}); repair the input, or \
         skip such particles",
        position[0], position[1], position[2]
    )]
    NotFinite {
        /// The particle's index in the file, from 0.
        index: usize,
        /// The particle's position.
        position: [f64; 3],
    },
    /// The particles are spread over too many bins.
    #[error("the particles are spread over more than {limit} bins of 16^3 cells; use larger cells")]
    TooManyBins {
        /// Maximum number of bins.
        limit: usize,
    },
    /// A particle is too far outside the periodic box to be wrapped into it.
    #[error(
        "particle {index} at ({}, {}, {}) is more than {} outside the periodic box along {axis}; \
         use the box of the simulation, wrap the positions into it (LAMMPS: dump_modify ID pbc \
         yes), or skip such particles",
        position[0], position[1], position[2], crate::grid::units::shown(*farthest)
    )]
    OutsideBox {
        /// The particle's index in the file, from 0.
        index: usize,
        /// The particle's position.
        position: [f64; 3],
        /// The axis along which the particle is outside: x, y or z.
        axis: char,
        /// A particle is wrapped into the box if it is at most this far outside, in the particles'
        /// unit of length.
        farthest: f64,
    },
    /// A particle is too far from the grid's origin.
    #[error(
        "particle {index} at ({}, {}, {}) is more than {} cells of size {} from the origin of the \
         grid; use larger cells, or an origin near the particles",
        position[0], position[1], position[2], crate::grid::CELL_LIMIT, crate::grid::units::shown(*cell_size)
    )]
    TooFar {
        /// The particle's index in the file, from 0.
        index: usize,
        /// The particle's position.
        position: [f64; 3],
        /// Edge of a cell.
        cell_size: f64,
    },
}

/// Numbers of binned, skipped and wrapped particles.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Census {
    /// Number of particles in bins, which contribute to the field.
    pub binned: usize,
    /// Number of particles that are skipped because a coordinate is not finite.
    pub not_finite: usize,
    /// Number of particles that are skipped because they are too far from the grid's origin.
    pub too_far: usize,
    /// Number of particles that are skipped because they are outside the domain's walls, or too far
    /// outside a periodic box.
    pub outside: usize,
    /// Number of binned particles that were wrapped into a periodic box: they were slightly
    /// outside, and were moved by one period.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub wrapped: usize,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// The result of the first of two readings: the number of particles in each bin.
pub struct BinPlan {
    pub(super) placer: Placer,
    census: Census,
    pub(super) keys: Vec<MortonKey>,
    /// The index of each bin's first particle; the last entry is the number of particles.
    pub(super) first: Vec<usize>,
    pub(super) ranges: Vec<RangePlan>,
}

/// A range of particles, and the bins that it touches.
pub(super) struct RangePlan {
    pub(super) range: Range<usize>,
    pub(super) table: BinTable,
    /// For each bin in the table, its rank among all bins; [`NOWHERE`] for bins without particles.
    pub(super) ranks: Vec<u32>,
    /// For each particle, the rank of its bin in the table and its record, packed into one word;
    /// empty if places are not kept.
    pub(super) places: Vec<Record>,
}

/// Packs a place into one word. The rank must be less than [`KEPT_BINS`], or be [`NOWHERE`].
#[inline(always)]
fn pack_place((rank, record): Placed) -> Record {
    u64::from(rank) << RECORD_BITS | record
}

#[inline(always)]
fn unpack_place(place: Record) -> Placed {
    let rank = (place >> RECORD_BITS) as u32;
    (if rank as usize == KEPT_BINS { NOWHERE } else { rank }, place & ((1 << RECORD_BITS) - 1))
}

impl fmt::Debug for BinPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("BinPlan")
            .field("placer", &self.placer)
            .field("census", &self.census)
            .finish_non_exhaustive()
    }
}

impl BinPlan {
    /// Counts `particles` by bin, unless they touch too many bins.
    ///
    /// # Errors
    /// [`BinError::TooManyBins`] if the particles touch more bins than `room` allows. Unless
    /// invalid particles are skipped, the error of the first invalid particle.
    pub fn count(
        particles: &dyn Particles,
        grid: &Grid,
        domain: Option<&Domain>,
        invalid: InvalidParticles,
        room: CountingRoom,
    ) -> Result<Self, BinError> {
        Self::count_while(particles, grid, domain, invalid, room, |_| ())
    }

    /// Counts `particles`, and calls `visit` with batches of the positions, in any order. Each
    /// particle is passed at most once. If there are too many bins, some particles are not passed.
    pub fn count_while(
        particles: &dyn Particles,
        grid: &Grid,
        domain: Option<&Domain>,
        invalid: InvalidParticles,
        room: CountingRoom,
        visit: impl Fn(&[[f64; 3]]) + Sync,
    ) -> Result<Self, BinError> {
        let placer = Placer { grid: *grid, domain: domain.copied(), wanted: None };
        Self::of_placed(particles, placer, invalid, room, visit)
    }

    /// Counts only the particles of the `wanted` bins, and ignores all other particles. Invalid
    /// particles are skipped here, because an earlier call has checked all particles.
    pub fn count_wanted(
        particles: &dyn Particles,
        grid: &Grid,
        domain: Option<&Domain>,
        wanted: WantedBins,
        room: CountingRoom,
    ) -> Result<Self, BinError> {
        Self::of_placed(
            particles,
            Placer { grid: *grid, domain: domain.copied(), wanted: Some(wanted) },
            InvalidParticles::Skip,
            room,
            |_| (),
        )
    }

    fn of_placed(
        particles: &dyn Particles,
        placer: Placer,
        invalid: InvalidParticles,
        room: CountingRoom,
        visit: impl Fn(&[[f64; 3]]) + Sync,
    ) -> Result<Self, BinError> {
        let (limit, grid) = (room.bins, placer.grid);
        let ranges = ranges(particles.len());
        let counter = Counter { placer, room, stop: AtomicBool::new(false) };
        let counts: Vec<RangeCount> = ranges
            .par_iter()
            .map(|range| counter.count(particles, range.clone(), &visit))
            .collect();
        if counter.stop.into_inner() {
            return Err(BinError::TooManyBins { limit });
        }
        if invalid == InvalidParticles::Refuse
            && let Some((index, position, fault)) = counts.iter().find_map(|c| c.first_invalid)
        {
            return Err(match fault {
                PlacementError::NotFinite => BinError::NotFinite { index, position },
                PlacementError::TooFar => {
                    BinError::TooFar { index, position, cell_size: grid.cell_size() }
                }
            });
        }
        let mut census = Census::default();
        for count in &counts {
            census.binned += count.census.binned;
            census.not_finite += count.census.not_finite;
            census.too_far += count.census.too_far;
            census.outside += count.census.outside;
        }
        let bins = all_bins(&counts);
        if bins.len() > limit {
            return Err(BinError::TooManyBins { limit });
        }
        let rank: HashMap<BinCode, u32> =
            bins.iter().zip(0..).map(|(&(_, bin), i)| (bin, i)).collect();
        let mut first = vec![0; bins.len() + 1];
        let ranges = ranges
            .into_iter()
            .zip(counts)
            .map(|(range, RangeCount { table, places, .. })| {
                let mut ranks = vec![NOWHERE; table.len()];
                for (at, bin, count) in table.bins() {
                    ranks[at] = rank[&bin];
                    first[ranks[at] as usize + 1] += count;
                }
                RangePlan { range, table, ranks, places }
            })
            .collect();
        for i in 0..bins.len() {
            first[i + 1] += first[i];
        }
        Ok(Self {
            placer,
            census,
            keys: bins.into_iter().map(|(key, _)| key).collect(),
            first,
            ranges,
        })
    }

    /// Returns the number of binned particles, and the numbers of skipped particles by reason.
    pub fn census(&self) -> Census {
        self.census
    }

    /// The bins with particles, in Morton order.
    pub fn keys(&self) -> &[MortonKey] {
        &self.keys
    }

    /// The number of particles in each bin, in the order of [`keys`](Self::keys).
    pub fn counts(&self) -> impl Iterator<Item = usize> + Clone + '_ {
        self.first.windows(2).map(|w| w[1] - w[0])
    }

    /// Bytes that each thread needs to look up the bins of `particles` particles. `wanted` is true
    /// if only some bins are counted.
    pub fn lookup_bytes(particles: usize, wanted: bool) -> u64 {
        LatestNumbers::bytes(particles) + if wanted { BinSieve::bytes(particles) } else { 0 }
    }

    /// Bytes of the kept places.
    pub fn places_bytes(&self) -> u64 {
        self.ranges.iter().map(|range| CountingRoom::PLACE * range.places.len() as u64).sum()
    }

    /// The second reading, into memory: sorts the same `particles` into their bins, with the
    /// attributes whose indices are in `carried`.
    ///
    /// # Errors
    /// [`RereadError::Changed`] if particles moved since they were counted.
    pub fn fill(self, particles: &dyn Particles, carried: &[usize]) -> Result<Bins, RereadError> {
        let Self { placer, census, keys, first, ranges } = self;
        let components = components(particles, carried);
        let slots = Slots::new(census.binned, &components);
        let (binned, mut next) = (census.binned, first.clone());
        // `cursors` has the next free slot of each bin in each range. For a bin without particles,
        // the entry is the number of all slots.
        let cursors: Vec<Vec<usize>> = ranges
            .iter()
            .map(|RangePlan { table, ranks, .. }| {
                let mut cursors = vec![binned; ranks.len()];
                for (at, _, count) in table.bins() {
                    let next = &mut next[ranks[at] as usize];
                    cursors[at] = *next;
                    *next += count;
                }
                cursors
            })
            .collect();
        let as_counted = ranges.into_par_iter().zip(cursors).map(|(plan, mut cursors)| {
            let RangePlan { range, mut table, places, .. } = plan;
            let ends = cursors.iter().zip(table.counts());
            let ends: Vec<usize> = ends.map(|(&first, &count)| first + count as usize).collect();
            let mut placed = Vec::with_capacity(CHUNK);
            let mut put = |first: usize, placed: &[Placed]| {
                let slot =
                    |&(rank, _): &Placed| advance(&mut cursors, rank).filter(|&slot| slot < binned);
                let to: Vec<Option<usize>> = placed.iter().map(slot).collect();
                for (slot, &(_, record)) in to.iter().zip(placed) {
                    if let &Some(slot) = slot {
                        slots.put(slot, record);
                    }
                }
                if !carried.is_empty() {
                    let attributes =
                        Tuples::read(particles, carried, &components, first, placed.len());
                    for (i, slot) in to.iter().enumerate() {
                        if let &Some(slot) = slot {
                            slots.put_attributes(slot, attributes.tuple(i));
                        }
                    }
                }
            };
            if places.len() == range.len() {
                for (first, places) in range.clone().step_by(CHUNK).zip(places.chunks(CHUNK)) {
                    placed.clear();
                    placed.extend(places.iter().map(|&place| unpack_place(place)));
                    put(first, &placed);
                }
                particles.release(range);
            } else {
                let mut latest = LatestNumbers::of(particles.len());
                let Ok(()) = placer.for_each_chunk(particles, range, |first, _, addresses| {
                    table.place_all(addresses, &mut latest, &mut placed);
                    put(first, &placed);
                    Ok::<_, Infallible>(())
                });
            }
            // If the particles have changed, the second reading can find a cube of bins that the
            // first reading did not. This cube has counters in the table, but no cursors, so the
            // lengths differ.
            cursors == ends && table.len() == ends.len()
        });
        if as_counted.reduce(|| true, |one, other| one & other) {
            Ok(Bins::of_slots(slots, keys, first, components))
        } else {
            Err(RereadError::Changed)
        }
    }
}

/// Increments the entry of `numbers` for a bin's rank, and returns its previous value; `None` if
/// the rank is [`NOWHERE`] or beyond the end of `numbers`.
#[inline(always)]
fn advance(numbers: &mut [usize], rank: u32) -> Option<usize> {
    let number = numbers.get_mut(rank as usize)?;
    *number += 1;
    Some(*number - 1)
}

/// The carried attributes of consecutive particles.
pub(super) struct Tuples<'a> {
    values: Vec<Vec<f32>>,
    components: &'a [usize],
}

impl<'a> Tuples<'a> {
    pub(super) fn read(
        particles: &dyn Particles,
        carried: &[usize],
        components: &'a [usize],
        first: usize,
        count: usize,
    ) -> Self {
        let read = |(&index, n): (&usize, &usize)| {
            let mut values = vec![0.0; count * n];
            if particles.attributes()[index].kind.is_whole() {
                let mut whole = vec![0; count * n];
                particles.integers(index, first, &mut whole);
                values.iter_mut().zip(whole).for_each(|(to, x)| *to = AttributeKind::word(x));
            } else {
                particles.attribute(index, first, &mut values);
            }
            values
        };
        Self { values: carried.iter().zip(components).map(read).collect(), components }
    }

    /// All components of all attributes of particle `i`.
    pub(super) fn tuple(&self, i: usize) -> impl Iterator<Item = f32> + '_ {
        let all = self.values.iter().zip(self.components);
        all.flat_map(move |(values, n)| values[i * n..(i + 1) * n].iter().copied())
    }
}

pub(super) fn components(particles: &dyn Particles, carried: &[usize]) -> Vec<usize> {
    carried.iter().map(|&index| particles.attributes()[index].components).collect()
}

/// Maximum number of particles in a range, so that a bin's counter can count them all.
const MOST_COUNTED: usize = u32::MAX as usize;

/// Splits the particles into a few ranges per thread. The results of binning do not depend on the
/// number of ranges.
fn ranges(len: usize) -> Vec<Range<usize>> {
    let count = (rayon::current_num_threads() * 2)
        .min(len.div_ceil(1 << 16))
        .max(len.div_ceil(MOST_COUNTED));
    let count = count.max(1);
    (0..count).map(|i| len * i / count..len * (i + 1) / count).collect()
}

/// The counts of a range of particles: its bins, census, first invalid particle, and kept places.
struct RangeCount {
    table: BinTable,
    census: Census,
    first_invalid: Option<(usize, [f64; 3], PlacementError)>,
    /// The packed place of each particle; empty if places are not kept.
    places: Vec<Record>,
}

/// All bins of all ranges with their keys, in Morton order.
fn all_bins(counts: &[RangeCount]) -> Vec<(MortonKey, BinCode)> {
    let touched = counts.iter().flat_map(|c| c.table.bins());
    let mut bins: Vec<_> =
        touched.map(|(_, bin, _)| (MortonKey::of(bin_coord(bin)), bin)).collect();
    bins.par_sort_unstable();
    bins.dedup();
    bins
}

/// Counts particles, and stops as soon as they touch too many bins.
struct Counter {
    placer: Placer,
    room: CountingRoom,
    stop: AtomicBool,
}

impl Counter {
    fn count(
        &self,
        particles: &dyn Particles,
        range: Range<usize>,
        visit: impl Fn(&[[f64; 3]]),
    ) -> RangeCount {
        let mut table = BinTable::default();
        let mut latest = LatestNumbers::of(particles.len());
        let mut census = Census::default();
        let mut first_invalid = None;
        let mut kept = particles.len() <= self.room.places;
        let mut places = empty_in_huge_pages(if kept { range.len() } else { 0 });
        let mut placed = Vec::with_capacity(CHUNK);
        // A thread that finds too many bins makes the whole count fail, so it also stops the other
        // threads.
        let _ = self.placer.for_each_chunk(particles, range, |first, positions, addresses| {
            visit(positions);
            table.place_all(addresses, &mut latest, &mut placed);
            placed.iter().for_each(|&(rank, _)| table.add(rank));
            if kept {
                places.extend(placed.iter().copied().map(pack_place));
            }
            let nowhere = placed.iter().enumerate().filter(|&(_, &(rank, _))| rank == NOWHERE);
            for (i, _) in nowhere.filter(|_| self.placer.wanted.is_none()) {
                if let Err(fault) = self.placer.place(positions[i]) {
                    match fault {
                        PlacementError::NotFinite => census.not_finite += 1,
                        PlacementError::TooFar => census.too_far += 1,
                    }
                    first_invalid.get_or_insert((first + i, positions[i], fault));
                } else {
                    census.outside += 1;
                }
            }
            if kept && table.len() > KEPT_BINS {
                (kept, places) = (false, Vec::new());
            }
            if table.len() / CUBE > self.room.bins {
                self.stop.store(true, Ordering::Relaxed);
            }
            if self.stop.load(Ordering::Relaxed) { Err(()) } else { Ok(()) }
        });
        census.binned = table.bins().map(|(.., count)| count).sum();
        RangeCount { table, census, first_invalid, places }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    /// Each bin with the sorted records of its particles.
    fn binned(plan: BinPlan, particles: &[[f64; 3]]) -> Vec<(MortonKey, Vec<Record>)> {
        let bins = plan.fill(&particles, &[]).unwrap();
        let sorted = |bin: usize| {
            let mut records = bins.contents(bin).unwrap().packed().to_vec();
            records.sort_unstable();
            (bins.keys()[bin], records)
        };
        (0..bins.keys().len()).map(sorted).collect()
    }

    #[test]
    fn kept_places_equal_the_places_of_a_second_pass() {
        let grid = Grid::new(DVec3::ZERO, 1.0).unwrap();
        let walls = Domain::new(&grid, DVec3::ZERO, DVec3::splat(1000.0)).unwrap();
        let kept = CountingRoom { places: usize::MAX, ..CountingRoom::BINS };
        // `bins` is the number of bins along each axis. With 25, the ranks of the bins are too
        // large for kept places.
        for bins in [5, 25] {
            let coordinate =
                |i: usize, a: usize| ((i * [7919, 6761, 5879][a]) % 40_009) as f64 / 40_009.0;
            let place =
                |i: usize| std::array::from_fn(|a| f64::from(16 * bins) * coordinate(i, a) - 5.0);
            let mut particles: Vec<[f64; 3]> = (0..30_000).map(place).collect();
            particles[12_345][1] = f64::NAN;
            for domain in [None, Some(&walls)] {
                let [with, without] = [kept, CountingRoom::BINS].map(|room| {
                    BinPlan::count(&particles, &grid, domain, InvalidParticles::Skip, room).unwrap()
                });
                let all_kept = with.places_bytes() == CountingRoom::PLACE * particles.len() as u64;
                assert_eq!(all_kept, bins == 5);
                assert_eq!(without.places_bytes(), 0);
                assert_eq!(with.census(), without.census());
                assert!(
                    binned(with, &particles) == binned(without, &particles),
                    "{bins} bins per axis"
                );
            }
        }
    }
}
