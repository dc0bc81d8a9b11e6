//! Distances that were computed before: the boxes of neighbouring blocks overlap, and the frames of
//! a simulation share a solid that does not move.
//!
//! Cubes of 4^3 cells are kept, in two generations. If the recent generation is full, the earlier
//! one is dropped, and the recent one takes its place. A cube that is used again becomes recent.

use std::collections::VecDeque;
use std::mem::take;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use glam::IVec3;
use hashbrown::HashMap;

use crate::grid::{Grid, Periodic, TILE};

/// Cells of a cube.
pub const CELLS: usize = (TILE * TILE * TILE) as usize;
/// Upper limit of the memory of a kept cube whose cells have the same distance, in bytes, including
/// its share of the hash table.
const SAME_BYTES: u64 = 96;
/// Upper limit of the memory of a kept cube with a distance for each cell, in bytes.
const EACH_BYTES: u64 = 256;
/// Maximum number of lattices.
const MOST_LATTICES: usize = 64;
const SHARDS: usize = 64;
/// Cubes along an edge of the larger cubes that are each in one shard.
const SHARD_EDGE: i32 = 8;

/// The cells and units of distances. Distances of different lattices differ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DistanceLattice {
    pub grid: Grid,
    pub periodic: Option<Periodic>,
    /// Cells are 2^`level` times as wide as the grid's cells.
    pub level: u32,
    /// The unit of a distance.
    pub step: f64,
    /// The largest distance.
    pub most: i16,
}

/// The distances of the cells of a cube, x fastest.
#[derive(Debug, Clone)]
pub enum CubeDistances {
    /// All cells have this distance.
    Same(i16),
    /// The distance of each cell.
    Each(Arc<[i16; CELLS]>),
}

impl CubeDistances {
    /// The distance of each cell.
    pub fn each(&self) -> [i16; CELLS] {
        match self {
            Self::Same(distance) => [*distance; CELLS],
            Self::Each(distances) => **distances,
        }
    }

    fn bytes(&self) -> u64 {
        match self {
            Self::Same(_) => SAME_BYTES,
            Self::Each(_) => EACH_BYTES,
        }
    }
}

/// The number of a lattice, and a cube of its cells.
type Key = (u64, IVec3);

/// Kept distances of a solid.
#[derive(Debug)]
pub struct DistanceCache {
    /// Maximum memory of the kept distances, in bytes.
    most_bytes: u64,
    lattices: Mutex<Lattices>,
    /// Threads that use different shards do not wait for each other.
    shards: [Mutex<Shard>; SHARDS],
}

/// The latest lattices with their numbers.
#[derive(Debug, Default)]
struct Lattices {
    known: VecDeque<(u64, DistanceLattice)>,
    next: u64,
}

/// A part of the kept distances.
#[derive(Debug, Default)]
struct Shard {
    /// Cubes that were used since `earlier` was replaced.
    recent: HashMap<Key, CubeDistances>,
    /// Memory of the recent cubes, in bytes.
    recent_bytes: u64,
    earlier: HashMap<Key, CubeDistances>,
}

impl DistanceCache {
    /// Makes an empty cache, which takes at most `most_bytes` bytes.
    pub fn new(most_bytes: u64) -> Self {
        let shards = std::array::from_fn(|_| Mutex::default());
        Self { most_bytes, lattices: Mutex::default(), shards }
    }

    /// Maximum memory of the kept distances, in bytes.
    pub fn most_bytes(&self) -> u64 {
        self.most_bytes
    }

    /// The number of a lattice, for [`get_or_make`](Self::get_or_make).
    pub fn number(&self, lattice: &DistanceLattice) -> u64 {
        let Lattices { known, next } = &mut *locked(&self.lattices);
        if let Some((number, _)) = known.iter().find(|(_, known)| known == lattice) {
            return *number;
        }
        if known.len() == MOST_LATTICES {
            known.pop_front();
        }
        known.push_back((*next, *lattice));
        *next += 1;
        *next - 1
    }

    /// The distances of a cube of the lattice with this number, from the cache or from `make`.
    pub fn get_or_make(
        &self,
        number: u64,
        cube: IVec3,
        make: impl FnOnce() -> CubeDistances,
    ) -> CubeDistances {
        let key = (number, cube);
        let most_recent_bytes = self.most_bytes / (2 * SHARDS as u64);
        // Cubes of a block are in few shards.
        let place = cube.div_euclid(IVec3::splat(SHARD_EDGE)) * IVec3::new(1, 3, 9);
        let shard = &self.shards[place.element_sum().rem_euclid(SHARDS as i32) as usize];
        if let Some(found) = locked(shard).get(key, most_recent_bytes) {
            return found;
        }
        // Other threads use the shard meanwhile.
        let made = make();
        locked(shard).put(key, made.clone(), most_recent_bytes);
        made
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shard {
    fn get(&mut self, key: Key, most_recent_bytes: u64) -> Option<CubeDistances> {
        if let Some(found) = self.recent.get(&key) {
            return Some(found.clone());
        }
        let found = self.earlier.remove(&key)?;
        self.put(key, found.clone(), most_recent_bytes);
        Some(found)
    }

    fn put(&mut self, key: Key, distances: CubeDistances, most_recent_bytes: u64) {
        let bytes = distances.bytes();
        if self.recent_bytes + bytes > most_recent_bytes {
            self.earlier = take(&mut self.recent);
            self.recent_bytes = 0;
        }
        if bytes <= most_recent_bytes {
            let replaced = self.recent.insert(key, distances);
            self.recent_bytes += bytes;
            self.recent_bytes -= replaced.map_or(0, |replaced| replaced.bytes());
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use glam::DVec3;

    use super::*;

    fn lattice(level: u32) -> DistanceLattice {
        let grid = Grid::new(DVec3::ZERO, 0.5).unwrap();
        DistanceLattice { grid, periodic: None, level, step: 1e-3, most: 900 }
    }

    fn made(x: i32) -> CubeDistances {
        match x % 2 {
            0 => CubeDistances::Same(x as i16),
            _ => CubeDistances::Each(Arc::new([x as i16; CELLS])),
        }
    }

    #[test]
    fn each_cube_is_computed_once_per_lattice_and_forgotten_when_too_many_are_kept() {
        const MOST_BYTES: u64 = 1 << 20;
        let cache = DistanceCache::new(MOST_BYTES);
        let new = RefCell::new(Vec::new());
        // The cubes that had to be made.
        let of = |level: u32, cubes: &[i32]| {
            new.borrow_mut().clear();
            let number = cache.number(&lattice(level));
            for &x in cubes {
                let found = cache.get_or_make(number, IVec3::new(x, 0, 0), || {
                    new.borrow_mut().push(x);
                    made(x)
                });
                assert_eq!(found.each(), [x as i16; CELLS]);
            }
            new.borrow().clone()
        };
        assert_eq!(of(0, &[1, 2, 3]), [1, 2, 3]);
        assert_eq!(of(0, &[3, 4, 1]), [4]);
        assert_eq!(of(1, &[3]), [3]);
        assert!(of(0, &[1, 2, 3, 4]).is_empty());
        // A cube that is used again and again stays while others fill both generations.
        for first in (10..30_000).step_by(500) {
            of(0, &(first..first + 500).collect::<Vec<_>>());
            assert!(of(0, &[1]).is_empty());
        }
        assert_eq!(of(0, &[2]), [2]);
        for shard in &cache.shards {
            let shard = locked(shard);
            let bytes = |map: &HashMap<Key, CubeDistances>| -> u64 {
                map.values().map(CubeDistances::bytes).sum()
            };
            assert_eq!(bytes(&shard.recent), shard.recent_bytes);
            let most = MOST_BYTES / (2 * SHARDS as u64);
            assert!(bytes(&shard.recent) <= most && bytes(&shard.earlier) <= most);
        }
    }

    #[test]
    fn a_cache_without_memory_keeps_nothing() {
        let cache = DistanceCache::new(0);
        for _ in 0..2 {
            let number = cache.number(&lattice(0));
            let found = cache.get_or_make(number, IVec3::ONE, || CubeDistances::Same(7));
            assert_eq!(found.each(), [7; CELLS]);
            assert!(cache.shards.iter().all(|shard| locked(shard).recent.is_empty()));
        }
    }

    #[test]
    fn a_lattice_keeps_its_number_until_too_many_others_are_used() {
        let cache = DistanceCache::new(0);
        let number = |level| cache.number(&lattice(level));
        let numbers: Vec<u64> = (0..MOST_LATTICES as u32).map(number).collect();
        assert!((0..MOST_LATTICES as u32).map(number).eq(numbers.iter().copied()));
        let new = number(MOST_LATTICES as u32);
        assert!(!numbers.contains(&new));
        assert!(![numbers[0], new].contains(&number(0)));
    }
}
