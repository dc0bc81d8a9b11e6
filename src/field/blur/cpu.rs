//! See `mod.rs` of this folder for the formula.

use multiversion::multiversion;

use crate::brick::Block;
use crate::grid::CellBox;

use super::{UNIT, Weights};

/// A number that can be blurred.
pub trait Sample: Copy + Default + PartialEq {
    /// Fills `to[i]` from `taps[i]`, `taps[i + step]`, ..., one tap for each of the weights's
    /// weights, along an axis.
    fn blur_row(to: &mut [Self], taps: &[Self], step: usize, weights: &Weights, axis: usize);
}

/// Blurs `block` with `weights` along x, then y, then z. The edge cells before `walls` are repeated
/// beyond them in what is given, and so they are in the result, for the next filter.
///
/// The result is smaller by the weights's reach on every side: exactly the cells whose whole
/// neighbourhood was given.
///
/// # Panics
/// If the block is too small for one cell to remain: recipe and gather disagree, which is our bug.
pub fn blur<T: Sample>(block: Block<T>, weights: &Weights, walls: Option<CellBox>) -> Block<T> {
    blur_while(block, weights, walls, |_| true).expect("nothing stops it")
}

/// Blurs as [`blur`] does, as long as `goes_on` holds of the block after each axis; `None` once it
/// does not. In what `goes_on` is shown nothing is repeated yet.
///
/// # Panics
/// As [`blur`].
pub fn blur_while<T: Sample>(
    mut block: Block<T>,
    weights: &Weights,
    walls: Option<CellBox>,
    goes_on: impl Fn(&Block<T>) -> bool,
) -> Option<Block<T>> {
    let mut spare = Vec::new();
    for axis in 0..3 {
        let fill = |to: &mut [T], taps: &[T], step| T::blur_row(to, taps, step, weights, axis);
        block.along(axis, weights.reach(), &mut spare, &fill);
        if !goes_on(&block) {
            return None;
        }
    }
    if let Some(walls) = walls {
        block.repeat_edges(walls);
    }
    Some(block)
}

/// Blurs a block that is 0 but for a small box: what nothing reaches is 0 without a look.
///
/// # Panics
/// As [`blur`].
pub fn blur_of_few<T: Sample>(
    block: &Block<T>,
    weights: &Weights,
    walls: Option<CellBox>,
) -> Block<T> {
    let full = block.box_of(|sample| sample != T::default());
    let mut blurred = blurred_part(block, full, weights);
    if let Some(walls) = walls {
        blurred.repeat_edges(walls);
    }
    blurred
}

/// Blurs a block that is 0 but for the box `full`.
fn blurred_part<T: Sample>(block: &Block<T>, full: CellBox, weights: &Weights) -> Block<T> {
    let (cells, reach) = (block.cells(), weights.reach());
    let mut blurred = Block::zero(cells.grown(-reach, -reach));
    let reached = full.grown(reach, reach).intersection(&blurred.cells());
    if full.is_empty() || reached.is_empty() {
        return blurred;
    }
    let mut spare = Vec::new();
    let mut part = block.part(full);
    for axis in 0..3 {
        let mut from = part.cells();
        (from.lo[axis], from.hi[axis]) = (reached.lo[axis] - reach, reached.hi[axis] + reach);
        let mut taps = Block::zero(from);
        let there = from.intersection(&part.cells());
        taps.put_part(there, part.cells(), part.samples(), |_, sample| sample);
        let fill = |to: &mut [T], taps: &[T], step| T::blur_row(to, taps, step, weights, axis);
        taps.along(axis, reach, &mut spare, &fill);
        part = taps;
    }
    blurred.put_part(reached, reached, part.samples(), |_, sample| sample);
    blurred
}

/// Integers of the DIF, by the formula of `mod.rs`.
impl Sample for u16 {
    fn blur_row(to: &mut [Self], taps: &[Self], step: usize, weights: &Weights, axis: usize) {
        let shift = weights.shift(axis);
        match weights.half() {
            half if shift < UNIT.ilog2() => blur_wide(to, taps, step, half, shift),
            &[w0, w1] => blur_narrow(to, taps, step, &[w0, w1]),
            &[w0, w1, w2] => blur_narrow(to, taps, step, &[w0, w1, w2]),
            &[w0, w1, w2, w3] => blur_narrow(to, taps, step, &[w0, w1, w2, w3]),
            &[w0, w1, w2, w3, w4] => blur_narrow(to, taps, step, &[w0, w1, w2, w3, w4]),
            &[w0, w1, w2, w3, w4, w5] => blur_narrow(to, taps, step, &[w0, w1, w2, w3, w4, w5]),
            half => blur_wide(to, taps, step, half, shift),
        }
    }
}

/// Sums of attributes: the same weights as fractions of 1, taps added in order.
impl Sample for f64 {
    fn blur_row(to: &mut [Self], taps: &[Self], step: usize, weights: &Weights, _: usize) {
        blur_float(to, taps, step, weights.half());
    }
}

/// For weights narrow enough to stay in registers.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn blur_narrow<const HALF: usize>(to: &mut [u16], taps: &[u16], step: usize, half: &[u32; HALF]) {
    let len = to.len();
    let tap = |k: usize| &taps[k * step..k * step + len];
    let centre = tap(HALF - 1);
    let pairs: [(&[u16], &[u16]); HALF] =
        std::array::from_fn(|k| (tap(HALF - 1 - k), tap(HALF - 1 + k)));
    for i in 0..len {
        let mut sum = half[0] * u32::from(centre[i]) + (1 << 15);
        for k in 1..HALF {
            sum += half[k] * (u32::from(pairs[k].0[i]) + u32::from(pairs[k].1[i]));
        }
        to[i] = (sum >> 16) as u16;
    }
}

/// For weights of any width and gain.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn blur_wide(to: &mut [u16], taps: &[u16], step: usize, half: &[u32], shift: u32) {
    // This many sums stay in registers.
    const LANES: usize = 32;
    let (centre, pairs) = half.split_first().expect("a weights has a centre");
    let reach = pairs.len();
    let (many, rest) = to.as_chunks_mut::<LANES>();
    let done = many.len() * LANES;
    for (first, to) in (0..).step_by(LANES).zip(many) {
        let taps = |k: usize| {
            taps[first + k * step..].first_chunk::<LANES>().expect("taps for every sample")
        };
        let own = taps(reach);
        // Plain loops: a closure would be compiled for any machine, and called for each sample.
        let mut sums = [1_u32 << (shift - 1); LANES];
        for i in 0..LANES {
            sums[i] += centre * u32::from(own[i]);
        }
        for (k, weight) in (1..).zip(pairs) {
            let (below, above) = (taps(reach - k), taps(reach + k));
            for i in 0..LANES {
                sums[i] += weight * (u32::from(below[i]) + u32::from(above[i]));
            }
        }
        for i in 0..LANES {
            to[i] = (sums[i] >> shift).min(u16::MAX.into()) as u16;
        }
    }
    for (first, to) in (done..).zip(rest) {
        let tap = |k: usize| u32::from(taps[first + k * step]);
        let of_pairs =
            (1..).zip(pairs).map(|(k, weight)| weight * (tap(reach - k) + tap(reach + k)));
        let sum = centre * tap(reach) + (1 << (shift - 1)) + of_pairs.sum::<u32>();
        *to = (sum >> shift).min(u16::MAX.into()) as u16;
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn blur_float(to: &mut [f64], taps: &[f64], step: usize, half: &[u32]) {
    let reach = half.len() - 1;
    to.fill(0.0);
    for k in 0..=2 * reach {
        let weight = f64::from(half[k.abs_diff(reach)]) / f64::from(UNIT);
        for (to, &sample) in to.iter_mut().zip(&taps[k * step..]) {
            *to += weight * sample;
        }
    }
}
