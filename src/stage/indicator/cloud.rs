//! The DIF of clouds: see the room's `mod.rs` for the formula.

use glam::IVec3;
use multiversion::multiversion;

use crate::brick::{Block, DifField};
use crate::grid::{CellBox, FRACTION_BITS, FRACTIONS};
use crate::units::{FULL, MeanCount};

/// What is kept of a cell: the particles' number, and their centroid's place along x, y and z.
pub const CHANNELS: usize = 4;
/// Bits of a share of a cloud: a power of two is the whole.
pub const SHARE_BITS: u32 = 12;
/// Bits that a square of twice a place has more.
pub const SQUARE_BITS: u32 = 2 * FRACTION_BITS + 3 - SHARE_BITS;
/// Bits of what a cell's particles make of the DIF, all around: a product with a share fits 32 bits.
pub const AMOUNT_BITS: u32 = 32 - SHARE_BITS;
/// Bits of it below the unit of theta.
pub const AMOUNT_FINE_BITS: u32 = 4;
/// theta is 1 where so many mu0 lie in a cell.
const MEANS_A_CELL: f64 = 2.0;

/// What a particle makes of the DIF, all around.
#[must_use]
pub fn amount(mean: MeanCount) -> u32 {
    let whole = f64::from(u32::from(FULL) << AMOUNT_FINE_BITS);
    ((whole / (MEANS_A_CELL * mean.particles())).round() as u32).clamp(1, MOST)
}

/// What a cell's particles make of the DIF at the most.
pub const MOST: u32 = (1 << AMOUNT_BITS) - 1;

/// What so many particles make of it.
#[inline(always)]
fn amount_of(n: u16, amount: u32) -> u32 {
    if u32::from(n) > MOST / amount { MOST } else { u32::from(n) * amount }
}

/// The place of a centroid in its cell along an axis, of N particles whose offsets sum to S: the step that it lies in, as
/// an offset, which stands for the step's middle.
#[must_use]
#[inline(always)]
pub(super) fn place(n: f64, s: f64) -> f64 {
    ((2.0 * s + n) / (2.0 * n)).floor()
}

/// The shares of a cloud in the cell below, the centroid's own, and the one above.
#[inline(always)]
fn shares(place: u16) -> [u32; 3] {
    let twice = 2 * (u32::from(place) & (FRACTIONS - 1)) + 1;
    let half_square = |length: u32| (length * length + (1 << (SQUARE_BITS - 1))) >> SQUARE_BITS;
    let (below, above) = (half_square(2 * FRACTIONS - twice), half_square(twice));
    [below, (1 << SHARE_BITS) - below - above, above]
}

/// The DIF of `cells`: what clouds leave in each, where a particle's makes `amount`. What would lie beyond a wall lies in
/// the cell before it.
#[must_use]
pub fn clouds(dif: &DifField, amount: u32, cells: CellBox, walls: Option<CellBox>) -> Block {
    // Around the cells whose clouds reach `cells`, and as wide along x as four cells are added at once.
    let mut sums = Block::<u32>::zero(CellBox { lo: cells.lo - 2, hi: cells.hi + IVec3::new(3, 2, 2) });
    let mut full = Vec::new();
    dif.each_full_cell(cells.grown(1, 1), |cell, samples| {
        full.push((sums.index(cell - 1), samples));
    });
    let [_, row, slab] = sums.strides();
    add_clouds(&full, amount, row, slab, sums.samples_mut());
    if let Some(walls) = walls {
        fold(&mut sums, walls);
    }
    let mut block = Block::zero(cells);
    let width = cells.size().x as usize;
    for (to, (_, sums)) in block.samples_mut().chunks_exact_mut(width).zip(sums.rows(cells)) {
        let theta =
            |&sum: &u32| ((sum + (1 << (AMOUNT_FINE_BITS - 1))) >> AMOUNT_FINE_BITS).min(FULL.into()) as u16;
        to.iter_mut().zip(sums).for_each(|(to, sum)| *to = theta(sum));
    }
    block
}

/// Adds clouds to cells: for each the lowest cell that it reaches, the number of particles, and the centroid's place.
#[multiversion(targets("x86_64+avx2", "x86_64+sse4.1"))]
fn add_clouds(clouds: &[(usize, [u16; CHANNELS])], amount: u32, row: usize, slab: usize, sums: &mut [u32]) {
    for &(lowest, [n, x, y, z]) in clouds {
        let cloud = amount_of(n, amount);
        let [x, y, z] = [x, y, z].map(shares);
        let x = [x[0], x[1], x[2], 0];
        for (first, z) in (lowest..).step_by(slab).zip(z) {
            let slab = (cloud * z) >> SHARE_BITS;
            for (first, y) in (first..).step_by(row).zip(y) {
                let row = (slab * y) >> SHARE_BITS;
                if let Some(to) = sums[first..].first_chunk_mut::<4>() {
                    to.iter_mut().zip(x).for_each(|(to, x)| *to += (row * x) >> SHARE_BITS);
                }
            }
        }
    }
}

/// Adds what lies beyond the walls to the cells before them.
fn fold(sums: &mut Block<u32>, walls: CellBox) {
    let cells = sums.cells();
    for axis in 0..3 {
        for (beyond, before) in [(walls.lo[axis] - 1, walls.lo[axis]), (walls.hi[axis], walls.hi[axis] - 1)] {
            let mut plane = cells;
            plane.lo[axis] = beyond;
            plane.hi[axis] = beyond + 1;
            if !cells.covers(&plane) || before < cells.lo[axis] || before >= cells.hi[axis] {
                continue;
            }
            for from in plane.cubes(1) {
                let mut to = from;
                to[axis] = before;
                let [from, to] = [from, to].map(|cell| sums.index(cell));
                let sums = sums.samples_mut();
                sums[to] += std::mem::take(&mut sums[from]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_whole_and_hold_the_place_and_its_square() {
        let whole = f64::from(1 << SHARE_BITS);
        for place in 0..FRACTIONS as u16 {
            let shares = shares(place).map(|share| f64::from(share) / whole);
            assert_eq!(shares.iter().sum::<f64>(), 1.0);
            let offset = (f64::from(place) + 0.5) / f64::from(FRACTIONS) - 0.5;
            let moment = |power: i32| (-1.0_f64).powi(power) * shares[0] + shares[2];
            assert!((moment(1) - offset).abs() <= 1.0 / whole, "{place}");
            assert!((moment(2) - offset * offset - 0.25).abs() <= 1.0 / whole, "{place}");
        }
    }

    #[test]
    fn a_place_is_what_integers_say() {
        let mut random = 1_u64;
        let mut next = |below: u64| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 16) % below
        };
        for i in 0..100_000 {
            let n = 1 + next([1, 3, 100, 1 << 36][i % 4]);
            let s = next(n * 8191 + 1);
            let expected = (2 * u128::from(s) + u128::from(n)) / (2 * u128::from(n));
            assert_eq!(place(n as f64, s as f64), expected as f64);
            assert!(expected < FRACTIONS.into());
        }
    }

    #[test]
    fn the_most_that_particles_make_is_what_integers_hold() {
        for mean in [1e-9, 0.01, 1.0, 2.5, 1000.0, MeanCount::MAX] {
            let amount = amount(MeanCount::new(mean).unwrap());
            for n in [0, 1, 2, 31, 32, 33, 1000, u16::MAX] {
                let expected = (u64::from(n) * u64::from(amount)).min(MOST.into());
                assert_eq!(u64::from(amount_of(n, amount)), expected, "{n} particles, mean {mean}");
            }
        }
    }
}
