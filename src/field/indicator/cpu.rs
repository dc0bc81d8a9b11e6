//! See `mod.rs` of this folder for the formulas.

use std::io;
use std::ops::Range;

use multiversion::multiversion;
use rayon::prelude::*;

use crate::brick::{Bins, CellSums, PageInfo, Pages};
use crate::grid::units::FULL;
use crate::grid::{BIN, FRACTIONS};

use super::{Amount, Clouds, IndicatorKind, PageRule};

/// The number of parts into which a step of h / F (see `mod.rs`) is divided. A centroid's distance
/// along each axis is rounded to a whole number of such parts. A rounded distance is then at most 4
/// F, so the sum of three squares fits into 32 bits.
pub const DISTANCE_SCALE: u64 = 4;
/// 65535 / (sqrt(3) 4 F), with 15 fraction bits.
pub const THETA_PER_DISTANCE: u32 = 37837;

/// Eq. 7 for N particles whose offsets sum to S; 0 if there are no particles. N and S are integers.
///
/// |D| / N is rounded to a quarter of a step along each axis, and its length to the nearest
/// integer. f64 is exact for every integer here, and a quotient is farther from the next rounding
/// boundary than the rounding error of f64.
#[inline(always)]
pub fn symmetry([n, x, y, z]: [f64; 4]) -> u16 {
    let scale = DISTANCE_SCALE as f64;
    let square = |s: f64| {
        let d = (2.0 * s + n - n * f64::from(FRACTIONS)).abs();
        let rounded = ((2.0 * scale * d + n) / (2.0 * n)).floor();
        rounded * rounded
    };
    let square = square(x) + square(y) + square(z);
    let root = square.sqrt().floor();
    let distance = if square - root * root > root { root + 1.0 } else { root };
    let theta = FULL
        - ((distance as i32 as u32).wrapping_mul(THETA_PER_DISTANCE).wrapping_add(1 << 14) >> 15)
            as u16;
    if n > 0.0 { theta } else { 0 }
}

/// Number of cells of a bin along x.
const ROW: usize = BIN as usize;

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512vl+avx512dq",
    "x86_64+avx2",
    "x86_64+sse4.1"
))]
fn symmetry_all(sums: &CellSums, theta: &mut [u16]) {
    theta.fill(0);
    let (theta, _) = theta.as_chunks_mut::<ROW>();
    for (row, cells) in sums.rows() {
        theta[row].iter_mut().zip(cells).for_each(|(theta, &cell)| *theta = symmetry(cell));
    }
}

fn counts(sums: &CellSums, counts: &mut [u16]) {
    counts.fill(0);
    let (counts, _) = counts.as_chunks_mut::<ROW>();
    for (row, cells) in sums.rows() {
        counts[row]
            .iter_mut()
            .zip(cells)
            .for_each(|(count, &[n, ..])| *count = n.min(FULL.into()) as u16);
    }
}

/// The pages of a range of bins: theta for symmetry, sums of clouds for clouds, and numbers of
/// particles for counting. [`Indicator::decode`](super::Indicator::decode) converts these numbers
/// to theta when all bins are done and mu0 is known.
///
/// # Errors
/// If particles are in a scratch file that cannot be read.
pub fn indicate(bins: &Bins, range: Range<usize>, rule: &PageRule) -> io::Result<Pages> {
    let shape = rule.shape();
    let values = match rule.indicator {
        IndicatorKind::Symmetry => symmetry_all,
        IndicatorKind::Counting => counts,
        IndicatorKind::Cloud => {
            let amount = Amount::of_spacing(rule.spacing_cells);
            let clouds = Clouds::new(amount, rule.walls, shape);
            let page = |room: &mut Vec<u16>, bin: usize| {
                Ok(clouds.page(room, bins.keys()[bin].coord(), &bins.contents(bin)?))
            };
            return range.into_par_iter().map_init(|| clouds.room(), page).collect();
        }
    };
    let start = || (CellSums::default(), vec![0; shape.bin_samples()]);
    let sums_page = |(sums, dense): &mut (CellSums, Vec<u16>), bin: usize| {
        sums.accumulate(bins.contents(bin)?.particles());
        values(sums, dense);
        let coord = bins.keys()[bin].coord();
        Ok(PageInfo::from_dense(coord, dense, shape).expect("a bin holds particles"))
    };
    range.into_par_iter().map_init(start, sums_page).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_factor_matches_its_formula() {
        let exact =
            f64::from(FULL) / (3f64.sqrt() * (DISTANCE_SCALE * u64::from(FRACTIONS)) as f64);
        assert_eq!(THETA_PER_DISTANCE, (exact * f64::from(1 << 15)).round() as u32);
    }

    #[test]
    fn symmetry_is_zero_only_in_empty_cells() {
        let last = f64::from(FRACTIONS - 1);
        for n in [1.0, 2.0, 7.0, 1e6] {
            for [x, y, z] in [[0.0; 3], [last; 3], [0.0, last, 0.0]] {
                assert!(symmetry([n, x * n, y * n, z * n]) > 0);
            }
        }
        assert_eq!(symmetry([0.0; 4]), 0);
        assert_eq!(symmetry([2.0, last, last, last]), FULL);
    }

    #[test]
    fn theta_matches_exact_integer_arithmetic() {
        let mut random = 1_u64;
        let mut next = |below: u64| {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (random >> 16) % below
        };
        for i in 0..100_000 {
            let n = 1 + next([1, 3, 100, 1 << 36][i % 4]);
            let s = [(); 3].map(|()| next(n * u64::from(FRACTIONS - 1) + 1));
            let squares = s.map(|s| {
                let d = u128::from((2 * s + n).abs_diff(n * u64::from(FRACTIONS)));
                ((u128::from(2 * DISTANCE_SCALE) * d + u128::from(n)) / u128::from(2 * n)).pow(2)
            });
            let square = squares.iter().sum::<u128>();
            let root = square.isqrt();
            let distance = (root + u128::from(square - root * root > root)) as u32;
            let theta = FULL - ((distance * THETA_PER_DISTANCE + (1 << 14)) >> 15) as u16;
            assert_eq!(symmetry([n, s[0], s[1], s[2]].map(|x| x as f64)), theta);
        }
    }
}
