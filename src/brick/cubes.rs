//! Codes of bins, cubes of bins, and a small cache for data about cubes.

use glam::IVec3;

/// Number of bits for each coordinate of a bin.
pub const COORD_BITS: u32 = 21;

/// The three coordinates of a bin, packed with [`COORD_BITS`] bits each. This code is cheaper to
/// compute than a Morton key.
pub(super) type BinCode = u64;

/// Unpacks the coordinates of a bin, in bins.
pub(super) fn bin_coord(bin: BinCode) -> IVec3 {
    let unused = i32::BITS - COORD_BITS;
    let axis = |shift: u32| ((bin >> shift) as i32) << unused >> unused;
    IVec3::new(axis(0), axis(COORD_BITS), axis(2 * COORD_BITS))
}

/// The binary logarithm of a cube's edge, in bins. The counters of a cube's bins take 32 bytes,
/// which is half a cache line on most CPUs.
const CUBE_BITS: u32 = 1;
/// Number of bins in a cube.
pub(super) const CUBE: usize = 1 << (3 * CUBE_BITS);
/// The bits of a bin's code that are the same for all bins of a cube.
const CUBE_MASK: BinCode = {
    let axis = (1 << CUBE_BITS) - 1;
    !(axis | axis << COORD_BITS | axis << (2 * COORD_BITS))
};

/// The number of a bin within its cube.
#[inline(always)]
pub(super) fn in_cube(bin: BinCode) -> u32 {
    let axis = |a: u32| (bin >> (a * COORD_BITS)) as u32 & ((1 << CUBE_BITS) - 1);
    axis(0) | axis(1) << CUBE_BITS | axis(2) << (2 * CUBE_BITS)
}

/// The code of a bin, given its cube and its number in the cube.
pub(super) fn bin_of_cube(cube: BinCode, number: usize) -> BinCode {
    let axis = |a: u32| {
        (number as BinCode >> (a * CUBE_BITS) & ((1 << CUBE_BITS) - 1)) << (a * COORD_BITS)
    };
    cube | axis(0) | axis(1) | axis(2)
}

/// A direct-mapped cache for cubes. Of all cubes that share a slot, it stores the most recently
/// used one.
pub(super) struct CubeCache<T> {
    /// The number of low bits that each coordinate of a cube contributes to the index of the cube's
    /// slot.
    bits: u32,
    cubes: Vec<(BinCode, T)>,
}

impl<T: Copy + Default> CubeCache<T> {
    /// A cache for `particles` particles in any order. Along each axis, the number of slots is
    /// about the number of cubes along the edge of a pool with this number of particles.
    pub(super) fn of(particles: usize) -> Self {
        let bits = Self::bits(particles);
        Self { bits, cubes: vec![(BinCode::MAX, T::default()); 1 << (3 * bits)] }
    }

    fn bits(particles: usize) -> u32 {
        let doublings = particles.next_power_of_two().ilog2().saturating_sub(20);
        3 + (doublings / 3).min(4)
    }

    /// Bytes of a cache for `particles` particles.
    pub(super) fn bytes(particles: usize) -> u64 {
        (size_of::<(BinCode, T)>() as u64) << (3 * Self::bits(particles))
    }

    /// The entry of a bin's cube; `found` computes the entry if the slot holds another cube.
    #[inline(always)]
    pub(super) fn of_cube(&mut self, bin: BinCode, found: impl FnOnce(BinCode) -> T) -> &mut T {
        let axis = |a: u32| (bin >> (a * COORD_BITS + CUBE_BITS)) as usize & ((1 << self.bits) - 1);
        let latest = &mut self.cubes[axis(0) | axis(1) << self.bits | axis(2) << (2 * self.bits)];
        let cube = bin & CUBE_MASK;
        if latest.0 != cube {
            *latest = (cube, found(cube));
        }
        &mut latest.1
    }
}
