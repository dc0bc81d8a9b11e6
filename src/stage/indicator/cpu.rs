//! See the room's `mod.rs` for the formulas.

use std::io;
use std::ops::Range;

use rayon::prelude::*;

use crate::brick::{Bins, BrickSide, CellSums, PageInfo};
use crate::grid::{BIN, FRACTIONS};
use crate::units::{FULL, MeanCount};

use super::Indicator;

/// Steps of the rounded centroid distance per axis: 4 F, so that three squares fit 32 bits.
pub const DISTANCE_SCALE: u64 = 4;
/// 65535 / (sqrt(3) 4 F), with 15 fraction bits.
pub const THETA_PER_DISTANCE: u32 = 37837;

/// Eq. 7 for `n` particles whose offsets sum to `s`; 0 for none.
///
/// |D| / N is rounded to a quarter of a step along each axis, its length to the nearest integer.
#[must_use]
pub fn symmetry(n: u64, s: [u64; 3]) -> u16 {
    if n == 0 {
        return 0;
    }
    let squares = s.map(|s| {
        let d = (2 * s + n).abs_diff(n * u64::from(FRACTIONS));
        let rounded =
            if n == 1 { DISTANCE_SCALE * d } else { divide(2 * DISTANCE_SCALE * d + n, 2 * n) } as u32;
        rounded * rounded
    });
    let distance = nearest_root(squares[0] + squares[1] + squares[2]);
    FULL - ((distance * THETA_PER_DISTANCE + (1 << 14)) >> 15) as u16
}

/// floor(a / b), exact while a < 2^52: the quotient's distance from the next integer is at least 1 / b,
/// far more than a double's rounding.
fn divide(a: u64, b: u64) -> u64 {
    debug_assert!(a < 1 << 52);
    (a as f64 / b as f64) as u64
}

/// The integer nearest to the square root.
fn nearest_root(square: u32) -> u32 {
    let root = f64::from(square).sqrt() as u32;
    root + u32::from(square - root * root > root)
}

/// Eq. 6: theta by the number of particles, up to `mean`; beyond, it is 1.
#[must_use]
pub fn count_table(mean: MeanCount) -> Vec<u16> {
    let mean = mean.particles();
    (0..=mean.floor() as u32).map(|n| (f64::from(n) / mean * f64::from(FULL)).round() as u16).collect()
}

/// The pages of a range of bins: theta by symmetry; the numbers of particles for counting, whose mu0 is known
/// when all bins are done, and turns them into theta by [`count_table`].
///
/// # Errors
/// Where particles are in a scratch file that cannot be read.
pub fn indicate(
    bins: &Bins,
    range: Range<usize>,
    indicator: Indicator,
    side: BrickSide,
) -> io::Result<Vec<(PageInfo, Box<[u16]>)>> {
    let value = |(n, s): (u64, [u64; 3])| match indicator {
        Indicator::Symmetry => symmetry(n, s),
        Indicator::Counting { .. } => n.min(FULL.into()) as u16,
    };
    range
        .into_par_iter()
        .map_init(
            || (CellSums::default(), vec![0; BIN.pow(3) as usize]),
            |(sums, dense): &mut (CellSums, Vec<u16>), bin| {
                sums.accumulate(bins.contents(bin)?.particles());
                dense.iter_mut().zip(sums.iter()).for_each(|(to, cell)| *to = value(cell));
                let page = PageInfo::from_dense(bins.keys()[bin].coord(), dense, side);
                Ok(page.expect("a bin holds particles"))
            },
        )
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_factor_is_what_its_name_says() {
        let exact = f64::from(FULL) / (3f64.sqrt() * (DISTANCE_SCALE * u64::from(FRACTIONS)) as f64);
        assert_eq!(THETA_PER_DISTANCE, (exact * f64::from(1 << 15)).round() as u32);
    }

    #[test]
    fn a_full_cell_is_never_zero_and_an_empty_one_always() {
        let last = u64::from(FRACTIONS - 1);
        for n in [1, 2, 7, 1_000_000] {
            for corner in [[0; 3], [last; 3], [0, last, 0]] {
                assert!(symmetry(n, corner.map(|s| s * n)) > 0);
            }
        }
        assert_eq!(symmetry(0, [0; 3]), 0);
        assert_eq!(symmetry(2, [last; 3]), FULL);
    }

    #[test]
    fn roots_round_to_the_nearest_integer() {
        for root in [0_u32, 1, 2, 255, 4096, 56_748] {
            assert_eq!(nearest_root(root * root), root);
            assert_eq!(nearest_root(root * root + root), root);
            assert_eq!(nearest_root(root * root + root + 1), root + 1);
        }
    }
}
