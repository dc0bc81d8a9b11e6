//! Finds the bin and the record (the packed position) of each particle, chunk by chunk.

use std::ops::Range;

use multiversion::multiversion;

use crate::grid::stretch::WantedBins;
use crate::grid::{Domain, FRACTIONS, Grid, PlacementError, STEP_LIMIT};
use crate::particles::Particles;

use super::bins::{AXIS_BITS, pack};
use super::cubes::{BinCode, COORD_BITS, CUBE, CubeCache, bin_coord, in_cube};
use super::slots::Record;

/// Number of particles per chunk. The positions and addresses of a chunk fit into the first-level
/// cache.
pub(super) const CHUNK: usize = 512;
/// Number of particles after which the pages of a mapped file are released; a multiple of
/// [`CHUNK`].
const RELEASE: usize = CHUNK << 3;
/// Number of positions that are processed together: a multiple of the number of lanes of every
/// vector width.
const LANES: usize = 8;

/// The bin and the record of a particle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Address {
    pub bin: BinCode,
    pub record: Record,
}

impl Address {
    /// The address of a particle without a bin. Its code differs from the codes of all bins, which
    /// do not use the highest bit.
    const NOWHERE: Self = Self { bin: BinCode::MAX, record: 0 };

    #[inline(always)]
    fn of(steps: [i64; 3]) -> Self {
        let [x, y, z] = steps.map(|s| (s >> AXIS_BITS) as u64 & ((1 << COORD_BITS) - 1));
        Self { bin: x | y << COORD_BITS | z << (2 * COORD_BITS), record: pack(steps) }
    }

    /// Whether the particle has a bin.
    pub fn has_bin(self) -> bool {
        self.bin != Self::NOWHERE.bin
    }
}

/// Places particles in the grid and the domain.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placer {
    pub grid: Grid,
    pub domain: Option<Domain>,
    /// The bins to keep; particles in other bins get no address. `None` for all bins.
    pub wanted: Option<WantedBins>,
}

/// Skips particles in bins that are not wanted.
pub(super) struct BinSieve {
    wanted: WantedBins,
    cache: CubeCache<KnownBins>,
}

/// Two bits for each bin of a cube: whether the bin has been looked up, and whether it is wanted.
#[derive(Debug, Clone, Copy, Default)]
struct KnownBins {
    looked_up: u8,
    wanted: u8,
}
const _: () = assert!(CUBE <= u8::BITS as usize);

impl BinSieve {
    /// A sieve whose cache has a suitable size for `particles` particles.
    fn new(wanted: WantedBins, particles: usize) -> Self {
        Self { wanted, cache: CubeCache::of(particles) }
    }

    /// Bytes of a sieve for `particles` particles.
    pub(super) fn bytes(particles: usize) -> u64 {
        CubeCache::<KnownBins>::bytes(particles)
    }

    #[inline(always)]
    fn contains(&mut self, bin: BinCode) -> bool {
        let (known, bit) = (self.cache.of_cube(bin, |_| KnownBins::default()), 1 << in_cube(bin));
        if known.looked_up & bit == 0 {
            known.looked_up |= bit;
            known.wanted |= if self.wanted.contains(bin_coord(bin)) { bit } else { 0 };
        }
        known.wanted & bit != 0
    }

    fn filter(&mut self, addresses: &mut [Address]) {
        for address in addresses {
            if address.has_bin() && !self.contains(address.bin) {
                *address = Address::NOWHERE;
            }
        }
    }
}

impl Placer {
    /// The position in steps, as [`Grid::place`] computes it, clamped to the steps of the domain;
    /// `None` outside the domain.
    pub fn place(&self, position: [f64; 3]) -> Result<Option<[i64; 3]>, PlacementError> {
        match (self.grid.place(position), &self.domain) {
            (Ok(steps), None) => Ok(Some(steps)),
            (Ok(steps), Some(domain)) => {
                let [first, last] = domain.step_range();
                let clamped = || std::array::from_fn(|a| steps[a].clamp(first[a], last[a]));
                Ok(domain.contains(position).then(clamped))
            }
            // A position outside the domain gets no bin, so it may exceed the grid's limits.
            (Err(PlacementError::TooFar), Some(domain)) if !domain.contains(position) => Ok(None),
            (Err(fault), _) => Err(fault),
        }
    }

    /// Calls `each` for each chunk of `range`, with the index of the chunk's first particle, the
    /// positions and their addresses. Stops if `each` returns an error.
    pub fn for_each_chunk<E>(
        &self,
        particles: &dyn Particles,
        range: Range<usize>,
        mut each: impl FnMut(usize, &[[f64; 3]], &[Address]) -> Result<(), E>,
    ) -> Result<(), E> {
        let bounds = LaneBounds::of(self);
        let mut positions = vec![[0.0; 3]; CHUNK];
        let mut addresses = vec![Address::NOWHERE; CHUNK];
        let mut sieve = self.wanted.map(|wanted| BinSieve::new(wanted, particles.len()));
        for first in range.clone().step_by(CHUNK) {
            let count = CHUNK.min(range.end - first);
            particles.positions(first, &mut positions[..count]);
            // The unused entries repeat a position of the chunk, so they do not change the result
            // of `place_all`.
            let rest = positions[0];
            positions[count..].fill(rest);
            if !place_all(&bounds, &positions, &mut addresses) {
                for (address, &position) in addresses.iter_mut().zip(&positions[..count]) {
                    *address =
                        self.place(position).ok().flatten().map_or(Address::NOWHERE, Address::of);
                }
            }
            if let Some(sieve) = &mut sieve {
                sieve.filter(&mut addresses[..count]);
            }
            each(first, &positions[..count], &addresses[..count])?;
            let done = first + count;
            if done == range.end || (done - range.start).is_multiple_of(RELEASE) {
                let begin = range.start + (done - range.start - 1) / RELEASE * RELEASE;
                particles.release(begin..done);
            }
        }
        Ok(())
    }
}

/// The bounds with which [`Placer::place`] compares positions, repeated for [`LANES`] consecutive
/// positions.
struct LaneBounds {
    origin: [f64; 3 * LANES],
    cell: f64,
    /// The walls, in world coordinates.
    walls: [[f64; 3 * LANES]; 2],
    /// The domain's first and last step.
    steps: [[f64; 3 * LANES]; 2],
}

impl LaneBounds {
    fn of(placer: &Placer) -> Self {
        let repeated = |xyz: [f64; 3]| std::array::from_fn(|i| xyz[i % 3]);
        let unbounded = [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]];
        let domain = placer.domain.as_ref();
        let walls = domain.map_or(unbounded, |domain| domain.walls().map(|wall| wall.to_array()));
        let steps = domain.map_or(unbounded, |domain| {
            domain.step_range().map(|steps| steps.map(|step| step as f64))
        });
        Self {
            origin: repeated(placer.grid.origin().to_array()),
            cell: placer.grid.cell_size(),
            walls: walls.map(repeated),
            steps: steps.map(repeated),
        }
    }
}

/// Computes [`Placer::place`] for a chunk. Returns whether all particles have an address; if not,
/// the contents of `addresses` are invalid.
#[multiversion(targets("x86_64+avx512f+avx512dq", "x86_64+avx2", "x86_64+sse4.1"))]
fn place_all(bounds: &LaneBounds, positions: &[[f64; 3]], addresses: &mut [Address]) -> bool {
    /// When an integer with a magnitude below 2^51 is added to this number, the lower bits of the
    /// sum contain the integer.
    const INTEGER: f64 = 1.5 * (1_u64 << 52) as f64;
    let mut unplaced = 0;
    let (positions, _) = positions.as_chunks::<LANES>();
    let (addresses, _) = addresses.as_chunks_mut::<LANES>();
    for (positions, addresses) in positions.iter().zip(addresses) {
        let positions = positions.as_flattened();
        let mut steps = [0_i64; 3 * LANES];
        for i in 0..3 * LANES {
            let world = positions[i];
            let step = ((world - bounds.origin[i]) / bounds.cell * f64::from(FRACTIONS)).floor();
            // These comparisons are false for NaN, so NaN coordinates are not placed.
            let on_grid = (-STEP_LIMIT..STEP_LIMIT).contains(&step);
            let within = (world >= bounds.walls[0][i]) & (world <= bounds.walls[1][i]);
            unplaced |= u64::from(!(on_grid & within));
            let least = if step < bounds.steps[0][i] { bounds.steps[0][i] } else { step };
            let clamped = if least > bounds.steps[1][i] { bounds.steps[1][i] } else { least };
            steps[i] = (clamped + INTEGER).to_bits().wrapping_sub(INTEGER.to_bits()) as i64;
        }
        for (address, &steps) in addresses.iter_mut().zip(steps.as_chunks::<3>().0) {
            *address = Address::of(steps);
        }
    }
    unplaced == 0
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, IVec3};

    use crate::grid::stretch::{DecidingCells, Stretch};
    use crate::grid::{BIN, BLOCK, CellBox, MortonKey};

    use super::*;

    #[test]
    fn the_coordinates_of_a_bin_survive_packing() {
        for bin in [
            IVec3::ZERO,
            IVec3::new(-1, 1, -2),
            IVec3::splat(-(1 << 18)),
            IVec3::splat((1 << 18) - 1),
        ] {
            let steps = bin.to_array().map(|c| i64::from(c * BIN + 3) * i64::from(FRACTIONS) + 5);
            assert_eq!(bin_coord(Address::of(steps).bin), bin);
        }
    }

    #[test]
    fn particles_in_unwanted_bins_are_skipped_in_any_order_of_lookups() {
        let deciding = DecidingCells::new(CellBox::cube(IVec3::ZERO, BLOCK).grown(17, 20));
        let stretch = Stretch {
            first: MortonKey::of(IVec3::splat(-9)),
            end: MortonKey::of(IVec3::new(7, -3, 2)),
        };
        let wanted = WantedBins { stretch, deciding };
        // There are more bins along each axis than the sieve's cache can hold, and each bin is
        // looked up several times.
        let (edge, mut sieve) = (41_i64, BinSieve::new(wanted, 1));
        let address = |i: i64| {
            let at = i * 7919 % edge.pow(3);
            let bin = [at, at / edge, at / edge.pow(2)].map(|c| c % edge - edge / 2);
            Address::of(bin.map(|c| c * i64::from(BIN) * i64::from(FRACTIONS)))
        };
        let addresses: Vec<Address> =
            (0..3 * edge.pow(3)).map(address).chain([Address::NOWHERE]).collect();
        let mut kept = addresses.clone();
        sieve.filter(&mut kept);
        let expected = addresses.iter().map(|&address| {
            let is_wanted = address.has_bin() && wanted.contains(bin_coord(address.bin));
            if is_wanted { address } else { Address::NOWHERE }
        });
        assert!(kept.iter().copied().eq(expected));
        let remaining = kept.iter().filter(|address| address.has_bin()).count();
        assert!(remaining > 1000 && remaining + 1000 < kept.len(), "{remaining} of {}", kept.len());
    }

    #[test]
    fn a_chunk_is_placed_like_its_single_particles() {
        let grid = Grid::new(DVec3::new(0.3, -7.0, 1e-3), 0.37).unwrap();
        let walls = Domain::new(&grid, DVec3::splat(-3.1), DVec3::new(40.0, 50.0, 60.7)).unwrap();
        // Each coordinate is a multiple of a step, or the floating-point number just below or above
        // it.
        let world = |i: i64, axis: usize| {
            let step = (i * 7919) % 1_600_000 - 300_000 * axis as i64;
            let at = grid.origin()[axis] + grid.cell_size() * step as f64 / f64::from(FRACTIONS);
            [at.next_down(), at, at.next_up()][i as usize % 3]
        };
        let mut positions: Vec<[f64; 3]> =
            (0..CHUNK as i64).map(|i| std::array::from_fn(|axis| world(i, axis))).collect();
        for domain in [None, Some(walls)] {
            let placer = Placer { grid, domain, wanted: None };
            if domain.is_some() {
                positions.iter_mut().for_each(|p| *p = p.map(|x| x.clamp(-3.1, 40.0)));
            }
            let mut all = vec![Address::NOWHERE; CHUNK];
            assert!(place_all(&LaneBounds::of(&placer), &positions, &mut all));
            for (position, address) in positions.iter().zip(all) {
                assert_eq!(
                    placer.place(*position).map(|steps| steps.map(Address::of)),
                    Ok(Some(address))
                );
            }
            for invalid in [f64::NAN, f64::INFINITY, 1e9, -1e9] {
                let mut one = positions.clone();
                one[77][1] = invalid;
                assert!(!place_all(
                    &LaneBounds::of(&placer),
                    &one,
                    &mut vec![Address::NOWHERE; CHUNK]
                ));
            }
        }
    }
}
