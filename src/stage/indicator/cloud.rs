//! The DIF of clouds: see the room's `mod.rs` for the formula.

use std::hint::black_box;

use glam::IVec3;
use multiversion::multiversion;

use crate::brick::{BinContents, PageShape};
use crate::grid::{BIN, CellBox, FRACTION_BITS, FRACTIONS};
use crate::units::{FULL, MeanCount};

/// How far from its cell a cloud reaches, in cells.
pub const RIM: i32 = 1;
/// Bits of a share of a cloud: a power of two is the whole.
pub const SHARE_BITS: u32 = 16;
/// Bits that the square of a length has more than the share that is half of it: a length has one bit more than an offset.
pub const SQUARE_BITS: u32 = 2 * FRACTION_BITS + 3 - SHARE_BITS;
/// theta is 1 where so many mu0 lie in a cell.
const MEANS_A_CELL: f64 = 2.0;
/// Of less than this nothing might be left in a particle's own cell, where half of its cloud lies along each axis.
const LEAST_AMOUNT: u16 = 4;
/// Cells of a bin along an axis.
const ROW: usize = BIN as usize;

/// What a particle makes of the DIF, all around: a whole number, so that a mu0 of hundreds or more is rounded along.
#[must_use]
pub fn amount(mean: MeanCount) -> u16 {
    // At most FULL, for a cast saturates.
    ((f64::from(FULL) / (MEANS_A_CELL * mean.particles())).round() as u16).max(LEAST_AMOUNT)
}

/// Where clouds end along each axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Walls {
    /// A bin's lowest cell within the walls and its highest, counted in the bin; others, where they are in other bins.
    ends: [[i32; 2]; 3],
}

impl Walls {
    /// In a bin; `None` where it does not touch any.
    fn of(walls: CellBox, bin: IVec3) -> Option<Self> {
        let (lo, hi) = ((walls.lo - bin * BIN).to_array(), (walls.hi - 1 - bin * BIN).to_array());
        let touched = |cell: &i32| (0..BIN).contains(cell);
        (lo.iter().any(touched) || hi.iter().any(touched))
            .then(|| Self { ends: [0, 1, 2].map(|axis| [lo[axis], hi[axis]]) })
    }

    /// The shares of a cloud in such a cell: what would lie beyond a wall lies in the cell before it.
    #[inline(always)]
    fn fold(&self, axis: usize, cell: usize, [below, own, above]: [u32; 3]) -> [u32; 3] {
        let [at_lo, at_hi] = self.ends[axis].map(|end| end == cell as i32);
        let beyond = |at: bool, share: u32| if at { share } else { 0 };
        let (under, over) = (beyond(at_lo, below), beyond(at_hi, above));
        [below - under, own + under + over, above - over]
    }
}

/// The shares of a cloud in the cell below, the particle's own, and the one above, by its offset in its own.
#[inline(always)]
fn shares(offset: u32) -> [u32; 3] {
    let length = 2 * offset + 1;
    let half_square = |length: u32| (length * length) >> SQUARE_BITS;
    let (below, above) = (half_square(2 * FRACTIONS - length), half_square(length));
    [below, (1 << SHARE_BITS) - below - above, above]
}

/// A share of an amount, of 16 bits each, rounded.
#[inline(always)]
fn part_of(amount: u32, share: u32) -> u32 {
    (amount * share + (1 << (SHARE_BITS - 1))) >> SHARE_BITS
}

/// Makes the clouds of a bin's particles, of `amount` each.
pub(super) struct Clouds {
    amount: u16,
    walls: Option<CellBox>,
    /// Where a cloud's lowest sample lies: [`PageShape::firsts`].
    firsts: [[usize; ROW]; 3],
    edge: usize,
    /// All bricks of a bin with their rims, and what an empty share may be added to beyond them.
    samples: Vec<u16>,
}

impl Clouds {
    pub fn new(amount: u16, walls: Option<CellBox>, shape: PageShape) -> Self {
        let (edge, firsts) = (shape.edge() as usize, shape.firsts());
        Self { amount, walls, firsts, edge, samples: vec![0; shape.bin_samples() + 1] }
    }

    /// The DIF that a bin's particles make, dense.
    pub fn of(&mut self, bin: IVec3, particles: &BinContents<'_>) -> &[u16] {
        self.samples.fill(0);
        let walls = self.walls.and_then(|walls| Walls::of(walls, bin));
        add_clouds(self, particles, walls);
        &self.samples[..self.samples.len() - 1]
    }
}

/// Adds the clouds of particles, row by row of four samples, the last of which stays as it was.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl+avx512dq", "x86_64+avx2+bmi1", "x86_64+sse4.1"))]
fn add_clouds(to: &mut Clouds, particles: &BinContents<'_>, walls: Option<Walls>) {
    let Clouds { amount, firsts, edge, samples, .. } = to;
    let (row, slab) = (*edge, *edge * *edge);
    // If the compiler knew, it would add to three samples one by one.
    let nothing = black_box(0);
    for (cell, [x, y, z]) in particles.particles() {
        let cell = [cell % ROW, cell / ROW % ROW, cell / (ROW * ROW) % ROW];
        let mut shares = [shares(x), shares(y), shares(z)];
        if let Some(walls) = walls {
            for (axis, shares) in shares.iter_mut().enumerate() {
                *shares = walls.fold(axis, cell[axis], *shares);
            }
        }
        let [[below, own, above], y_shares, z_shares] = shares;
        let x_shares = [below, own, above, nothing];
        let first = firsts[0][cell[0]] + firsts[1][cell[1]] + firsts[2][cell[2]];
        for (z_share, to) in z_shares.into_iter().zip((first..).step_by(slab)) {
            let in_slab = part_of((*amount).into(), z_share);
            for (y_share, to) in y_shares.into_iter().zip((to..).step_by(row)) {
                let in_row = part_of(in_slab, y_share);
                for (sample, x_share) in samples[to..to + 4].iter_mut().zip(x_shares) {
                    *sample = sample.saturating_add(part_of(in_row, x_share) as u16);
                }
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
        for offset in 0..FRACTIONS {
            let shares = shares(offset).map(|share| f64::from(share) / whole);
            assert_eq!(shares.iter().sum::<f64>(), 1.0);
            let offset = (f64::from(offset) + 0.5) / f64::from(FRACTIONS) - 0.5;
            let moment = |power: i32| (-1.0_f64).powi(power) * shares[0] + shares[2];
            assert!((moment(1) - offset).abs() <= 1.0 / whole, "{offset}");
            assert!((moment(2) - offset * offset - 0.25).abs() <= 2.0 / whole, "{offset}");
        }
    }

    #[test]
    fn of_the_least_amount_something_is_left_in_a_particles_own_cell() {
        assert_eq!(amount(MeanCount::new(MeanCount::MAX).unwrap()), LEAST_AMOUNT);
        for offset in [0, FRACTIONS / 2, FRACTIONS - 1] {
            let [_, own, _] = shares(offset);
            assert!(part_of(part_of(part_of(LEAST_AMOUNT.into(), own), own), own) > 0, "{offset}");
        }
    }

    #[test]
    fn what_would_lie_beyond_walls_lies_before_them() {
        let tank = CellBox { lo: IVec3::new(16, -40, 3), hi: IVec3::new(17, 40, 32) };
        let walls = Walls::of(tank, IVec3::new(1, 0, 0)).unwrap();
        assert_eq!(walls.fold(0, 0, [1, 20, 300]), [0, 321, 0], "one cell between two walls");
        assert_eq!(walls.fold(1, 0, [1, 20, 300]), [1, 20, 300], "far from both");
        assert_eq!(walls.fold(2, 3, [1, 20, 300]), [0, 21, 300], "at the lower one");
        assert_eq!(walls.fold(2, 4, [1, 20, 300]), [1, 20, 300]);
        assert_eq!(
            Walls::of(tank, IVec3::new(0, 0, 1)).map(|walls| walls.fold(2, 15, [1, 20, 300])),
            Some([1, 320, 0])
        );
        assert_eq!(Walls::of(CellBox::cube(IVec3::ZERO, 64), IVec3::ONE), None, "a bin in the middle");
    }
}
