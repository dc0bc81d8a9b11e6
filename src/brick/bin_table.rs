//! A table of the bins that a range of particles touches, indexed by the coordinates of the bins.
//!
//! Particles come in any order, so lookups in the table of a large frame are scattered. Bins are
//! grouped into cubes: a hash table finds a cube, a small cache holds the cubes of recent lookups,
//! and the counters of neighbouring bins share a cache line of the CPU.

use std::hash::BuildHasher;

use hashbrown::hash_table::Entry;
use hashbrown::{DefaultHashBuilder, HashTable};

use super::cubes::{BinCode, CUBE, CubeCache, bin_of_cube, in_cube};
use super::place::Address;
use super::slots::Record;

/// The rank of a particle's bin in the table of the particle's range, and the particle's record.
pub(super) type Placed = (u32, Record);

/// The rank of a particle that is skipped.
pub(super) const NOWHERE: u32 = u32::MAX;

/// The numbers of recently used cubes in one table.
pub(super) type LatestNumbers = CubeCache<u32>;

/// The bins that a range of particles touches, grouped into cubes.
#[derive(Default)]
pub(super) struct BinTable {
    /// The numbers of the cubes, hashed by their codes.
    cubes: HashTable<u32>,
    hasher: DefaultHashBuilder,
    /// The code of each cube.
    codes: Vec<BinCode>,
    /// The number of particles in each bin of each cube.
    counts: Vec<[u32; CUBE]>,
}

impl BinTable {
    /// The rank of a bin in this table; each cube has [`CUBE`] ranks. If the table lacks the bin's
    /// cube, the cube is added with counts of 0.
    #[inline(always)]
    fn rank(&mut self, bin: BinCode, latest: &mut LatestNumbers) -> u32 {
        let number = *latest.of_cube(bin, |cube| self.find_or_add_cube(cube));
        number << CUBE.ilog2() | in_cube(bin)
    }

    #[cold]
    fn find_or_add_cube(&mut self, cube: BinCode) -> u32 {
        let Self { cubes, hasher, codes, counts } = self;
        let code = |&number: &u32| codes[number as usize];
        match cubes.entry(
            hasher.hash_one(cube),
            |number| code(number) == cube,
            |n| hasher.hash_one(code(n)),
        ) {
            Entry::Occupied(found) => *found.get(),
            Entry::Vacant(free) => {
                let number = codes.len() as u32;
                free.insert(number);
                codes.push(cube);
                counts.push([0; CUBE]);
                number
            }
        }
    }

    /// Fills `placed` with the rank of each particle's bin and the particle's record. Many
    /// particles are placed in one call, so that the caller can access their bins in a short loop,
    /// in which the CPU waits for several cache lines at the same time.
    pub(super) fn place_all(
        &mut self,
        addresses: &[Address],
        latest: &mut LatestNumbers,
        placed: &mut Vec<Placed>,
    ) {
        placed.clear();
        placed.extend(addresses.iter().map(|address| match address.has_bin() {
            true => (self.rank(address.bin, latest), address.record),
            false => (NOWHERE, 0),
        }));
    }

    /// The number of ranks, including those of empty bins.
    pub(super) fn len(&self) -> usize {
        CUBE * self.codes.len()
    }

    /// The number of particles in each bin, indexed by rank.
    pub(super) fn counts(&self) -> &[u32] {
        self.counts.as_flattened()
    }

    /// Counts a particle in the bin with this rank, unless the rank is [`NOWHERE`].
    #[inline(always)]
    pub(super) fn add(&mut self, rank: u32) {
        if let Some(count) = self.counts.as_flattened_mut().get_mut(rank as usize) {
            *count += 1;
        }
    }

    /// The rank, the code and the number of particles of each bin that is not empty.
    pub(super) fn bins(&self) -> impl Iterator<Item = (usize, BinCode, usize)> + '_ {
        let cubes = self.codes.iter().zip(&self.counts).enumerate();
        cubes.flat_map(|(cube, (&code, counts))| {
            let full = counts.iter().enumerate().filter(|&(_, &count)| count > 0);
            full.map(move |(number, &count)| {
                (cube * CUBE + number, bin_of_cube(code, number), count as usize)
            })
        })
    }
}
