//! A cache of computed distances, in cubes of 4^3 cells. Distances are needed repeatedly, because
//! the boxes of neighbouring blocks overlap, and because the frames of a simulation share a solid
//! that does not move.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::{Arc, Mutex, PoisonError};

use glam::IVec3;
use quick_cache::sync::Cache;
use quick_cache::{OptionsBuilder, Weighter};

use crate::grid::{Grid, Periodic, TILE};

/// Number of cells in a cube.
pub const CELLS: usize = (TILE * TILE * TILE) as usize;
/// Upper limit, in bytes, on the memory of a cached cube, including its share of the cache's
/// tables, but without individual distances of its cells.
const CUBE_BYTES: u64 = 208;
/// Upper limit, in bytes, on the memory of individual distances of all cells in a cube.
const EACH_BYTES: u64 = 160;
/// Maximum number of lattices whose numbers are remembered.
const MOST_LATTICES: usize = 64;

/// The cells for which distances are computed, and the unit of the distances. Each lattice has its
/// own distances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DistanceLattice {
    pub grid: Grid,
    pub periodic: Option<Periodic>,
    /// Cells are 2^`level` times as wide as the grid's cells.
    pub level: u32,
    /// The unit of distances, in the grid's unit of length.
    pub step: f64,
    /// The largest distance, in steps.
    pub most: i16,
}

/// The distances of the cells in a cube, with x varying fastest.
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
}

/// The number of a lattice, and a cube of its cells.
type Key = (u64, IVec3);

/// Weighs cubes by their memory.
#[derive(Debug, Clone)]
struct CubeWeighter;

impl Weighter<Key, CubeDistances> for CubeWeighter {
    fn weight(&self, _: &Key, distances: &CubeDistances) -> u64 {
        match distances {
            CubeDistances::Same(_) => CUBE_BYTES,
            CubeDistances::Each(_) => CUBE_BYTES + EACH_BYTES,
        }
    }
}

/// A cache of a solid's distances.
#[derive(Debug)]
pub struct DistanceCache {
    lattices: Mutex<Lattices>,
    cubes: Cache<Key, CubeDistances, CubeWeighter>,
}

/// The latest lattices, with their numbers.
#[derive(Debug, Default)]
struct Lattices {
    known: VecDeque<(u64, DistanceLattice)>,
    next: u64,
}

impl DistanceCache {
    /// Makes an empty cache, which takes at most `most_bytes` bytes.
    pub fn new(most_bytes: u64) -> Self {
        let options = OptionsBuilder::new()
            .estimated_items_capacity((most_bytes / CUBE_BYTES) as usize)
            .weight_capacity(most_bytes)
            .build()
            .expect("all options without a default are set");
        let cubes =
            Cache::with_options(options, CubeWeighter, Default::default(), Default::default());
        Self { lattices: Mutex::default(), cubes }
    }

    /// Maximum memory of the cached distances, in bytes.
    pub fn most_bytes(&self) -> u64 {
        self.cubes.capacity()
    }

    /// The number of a lattice, for [`get_or_make`](Self::get_or_make).
    pub fn number(&self, lattice: &DistanceLattice) -> u64 {
        let mut lattices = self.lattices.lock().unwrap_or_else(PoisonError::into_inner);
        let Lattices { known, next } = &mut *lattices;
        if let Some((number, _)) = known.iter().find(|(_, known)| known == lattice) {
            return *number;
        }
        if known.len() == MOST_LATTICES {
            known.pop_front();
        }
        // A number is never reused, because cubes of its lattice may still be in the cache.
        known.push_back((*next, *lattice));
        *next += 1;
        *next - 1
    }

    /// The distances of a cube of the lattice that has this number, from the cache or from `make`.
    pub fn get_or_make(
        &self,
        number: u64,
        cube: IVec3,
        make: impl FnOnce() -> CubeDistances,
    ) -> CubeDistances {
        let Ok(distances) =
            self.cubes.get_or_insert_with(&(number, cube), || Ok::<_, Infallible>(make()));
        distances
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
    fn each_cube_is_computed_once_per_lattice_until_it_is_evicted() {
        const MOST_BYTES: u64 = 1 << 20;
        let cache = DistanceCache::new(MOST_BYTES);
        let new = RefCell::new(Vec::new());
        // The cubes whose distances had to be computed.
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
        // A cube that is used repeatedly stays in the cache while other cubes are evicted.
        for first in (10..30_000).step_by(500) {
            of(0, &(first..first + 500).collect::<Vec<_>>());
            assert!(of(0, &[1]).is_empty());
            assert!((1..=MOST_BYTES).contains(&cache.cubes.weight()));
        }
        assert_eq!(cache.most_bytes(), MOST_BYTES);
        assert!(cache.cubes.len() < 30_000 / 4);
        assert!(of(0, &(10..30_000).collect::<Vec<_>>()).len() > 20_000);
    }

    #[test]
    fn a_cache_without_memory_keeps_nothing() {
        let cache = DistanceCache::new(0);
        for _ in 0..2 {
            let number = cache.number(&lattice(0));
            let found = cache.get_or_make(number, IVec3::ONE, || CubeDistances::Same(7));
            assert_eq!(found.each(), [7; CELLS]);
            assert!(cache.cubes.is_empty());
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
