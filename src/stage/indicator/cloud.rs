//! The DIF of clouds: see the room's `mod.rs` for the formula.

use glam::IVec3;
use multiversion::multiversion;

use crate::brick::{Block, DifField};
use crate::grid::{CellBox, FRACTION_BITS, FRACTIONS};
use crate::units::{FULL, MeanCount};

/// What is kept of a cell: the particles' number, and their centroid's place along x, y and z.
pub const CHANNELS: usize = 4;
/// Bits of a share of a cloud: a power of two is the whole.
pub const SHARE_BITS: u32 = 16;
/// Bits that the square of a length has more than the share that is half of it: a length has one bit more than a place.
pub const SQUARE_BITS: u32 = 2 * FRACTION_BITS + 3 - SHARE_BITS;
/// theta is 1 where so many mu0 lie in a cell.
const MEANS_A_CELL: f64 = 2.0;

/// What a particle makes of the DIF, all around: a whole number, so that a mu0 of hundreds or more is rounded along.
#[must_use]
pub fn amount(mean: MeanCount) -> u16 {
    // At most FULL, for a cast saturates.
    ((f64::from(FULL) / (MEANS_A_CELL * mean.particles())).round() as u16).max(1)
}

/// The place of a centroid in its cell along an axis, of N particles whose offsets sum to S: the step that it lies in, as
/// an offset, which stands for the step's middle.
#[must_use]
#[inline(always)]
pub(super) fn place(n: f64, s: f64) -> f64 {
    ((2.0 * s + n) / (2.0 * n)).floor()
}

/// What so many particles make of it, as far as 16 bits hold it.
#[inline(always)]
fn cloud_of(n: u16, amount: u16) -> u32 {
    (u32::from(n) * u32::from(amount)).min(FULL.into())
}

/// The shares of a cloud in the cell below, the centroid's own, and the one above.
#[inline(always)]
fn shares(place: u16) -> [u32; 3] {
    let length = 2 * (u32::from(place) & (FRACTIONS - 1)) + 1;
    let half_square = |length: u32| (length * length) >> SQUARE_BITS;
    let (below, above) = (half_square(2 * FRACTIONS - length), half_square(length));
    [below, (1 << SHARE_BITS) - below - above, above]
}

/// A share of an amount, of 16 bits each, rounded.
#[inline(always)]
fn part_of(amount: u32, share: u32) -> u32 {
    (amount * share + (1 << (SHARE_BITS - 1))) >> SHARE_BITS
}

/// The DIF of `cells`: what clouds leave in each, where a particle's makes `amount`. What would lie beyond a wall lies in
/// the cell before it.
#[must_use]
pub fn clouds(dif: &DifField, amount: u16, cells: CellBox, walls: Option<CellBox>) -> Block {
    // Around the cells whose clouds reach `cells`, and as wide along x as four cells are added at once.
    let mut sums = Block::<u32>::zero(CellBox { lo: cells.lo - 2, hi: cells.hi + IVec3::new(3, 2, 2) });
    let [_, row, slab] = sums.strides();
    dif.each_brick(cells.grown(1, 1), |part, brick, samples| {
        let lowest = sums.index(part.lo - 1);
        add_clouds(part, brick, samples, amount, [row, slab], &mut sums.samples_mut()[lowest..]);
    });
    if let Some(walls) = walls {
        fold(&mut sums, walls);
    }
    let mut block = Block::zero(cells);
    let width = cells.size().x as usize;
    for (to, (_, sums)) in block.samples_mut().chunks_exact_mut(width).zip(sums.rows(cells)) {
        to.iter_mut().zip(sums).for_each(|(to, &sum)| *to = sum.min(FULL.into()) as u16);
    }
    block
}

/// Adds the clouds of the cells `part` of a brick to sums, which begin with the lowest that they reach and have so many from
/// one row to the next and from one slab.
#[multiversion(targets("x86_64+avx2+bmi1", "x86_64+sse4.1"))]
fn add_clouds(
    part: CellBox,
    brick: CellBox,
    samples: &[u16],
    amount: u16,
    [row, slab]: [usize; 2],
    sums: &mut [u32],
) {
    let edge = brick.size().x as usize;
    let (local, size) = ((part.lo - brick.lo).as_usizevec3(), part.size().as_usizevec3());
    let (counts, places) = samples.split_at(edge.pow(3));
    let (x_places, places) = places.split_at(edge.pow(3));
    let (y_places, z_places) = places.split_at(edge.pow(3));
    for z in 0..size.z {
        for y in 0..size.y {
            let first = local.x + edge * (local.y + y + edge * (local.z + z));
            let mut full = full_cells(&counts[first..first + size.x]);
            // Bit by bit: which cells are full nobody can foresee.
            while full != 0 {
                let x = full.trailing_zeros() as usize;
                full &= full - 1;
                let from = first + x;
                let [below, own, above] = shares(x_places[from]);
                let x_shares = [below, own, above, 0];
                let (y_shares, z_shares) = (shares(y_places[from]), shares(z_places[from]));
                let cloud = cloud_of(counts[from], amount);
                for (z_share, slab_to) in z_shares.into_iter().zip((x + y * row + z * slab..).step_by(slab)) {
                    let in_slab = part_of(cloud, z_share);
                    for (y_share, to) in y_shares.into_iter().zip((slab_to..).step_by(row)) {
                        let in_row = part_of(in_slab, y_share);
                        let sums = &mut sums[to..to + 4];
                        sums.iter_mut()
                            .zip(x_shares)
                            .for_each(|(sum, x_share)| *sum += part_of(in_row, x_share));
                    }
                }
            }
        }
    }
}

/// A bit for each of up to 16 cells that holds particles.
#[inline(always)]
fn full_cells(counts: &[u16]) -> u32 {
    if let Ok(&[a, b, c, d, e, f, g, h]) = <&[u16; 8]>::try_from(counts) {
        let bytes = [a > 0, b > 0, c > 0, d > 0, e > 0, f > 0, g > 0, h > 0].map(u8::from);
        // Gathers the lowest bits of eight bytes in the highest.
        return (u64::from_le_bytes(bytes).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u32;
    }
    counts.iter().rev().fold(0, |full, &count| full << 1 | u32::from(count > 0))
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
        let whole = 65536.0;
        for place in 0..FRACTIONS as u16 {
            let shares = shares(place).map(|share| f64::from(share) / whole);
            assert_eq!(shares.iter().sum::<f64>(), 1.0);
            let offset = (f64::from(place) + 0.5) / f64::from(FRACTIONS) - 0.5;
            let moment = |power: i32| (-1.0_f64).powi(power) * shares[0] + shares[2];
            assert!((moment(1) - offset).abs() <= 1.0 / whole, "{place}");
            assert!((moment(2) - offset * offset - 0.25).abs() <= 2.0 / whole, "{place}");
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
    fn clouds_of_a_cell_are_its_particles_as_far_as_16_bits_hold() {
        for mean in [1e-9, 0.01, 1.0, 2.5, 1000.0, MeanCount::MAX] {
            let amount = amount(MeanCount::new(mean).unwrap());
            assert!(amount > 0);
            for n in [0, 1, 2, 31, 32, 33, 1000, u16::MAX] {
                let expected = (u64::from(n) * u64::from(amount)).min(FULL.into());
                assert_eq!(u64::from(cloud_of(n, amount)), expected, "{n} particles, mean {mean}");
            }
        }
    }
}
