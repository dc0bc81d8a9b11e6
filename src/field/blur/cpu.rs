//! See `mod.rs` of this folder for the formula.

use glam::IVec3;
use multiversion::multiversion;

use crate::brick::Block;
use crate::grid::{CellBox, Mirror};

use super::{UNIT, Weights};

/// A number that can be blurred.
pub trait BlurSample: Copy + Default + PartialEq {
    /// Fills `to[i]` with the weighted sum of the taps `taps[i]`, `taps[i + step]`, ..., one tap
    /// per weight. `axis` is the axis along which the samples are blurred.
    fn blur_row(to: &mut [Self], taps: &[Self], step: usize, weights: &Weights, axis: usize);
}

/// Blurs `block` with `weights` along x, then y, then z. Beyond walls, the input must contain the
/// mirror images that `mirror` makes. The result also contains them, for the next filter.
///
/// The result is smaller than the input by the weights' reach on every side: it has exactly the
/// cells whose whole neighbourhood is in the input.
///
/// # Panics
/// If the block is too small for one cell to remain, which is a bug in the recipe or in the
/// gathering of blocks.
pub fn blur<T: BlurSample>(block: Block<T>, weights: &Weights, mirror: Option<Mirror>) -> Block<T> {
    blur_while(block, weights, mirror, |_| true).expect("`goes_on` is always true")
}

/// Blurs like [`blur`], but passes the block to `goes_on` after each axis, and returns `None` as
/// soon as `goes_on` returns false. The block that `goes_on` receives is not mirrored yet.
///
/// # Panics
/// If the block is too small for one cell to remain.
pub fn blur_while<T: BlurSample>(
    mut block: Block<T>,
    weights: &Weights,
    mirror: Option<Mirror>,
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
    block.mirror(mirror);
    Some(block)
}

/// Blurs a block whose nonzero samples are all in the cells `full`, which are sorted with x
/// fastest. The result covers `cells`. The function is fast if `full` has few cells, because it
/// skips all rows without full cells.
///
/// # Panics
/// If the block does not contain the neighbourhood of each of the `cells`.
pub fn blur_of_few(
    block: &Block,
    full: &[IVec3],
    weights: &Weights,
    cells: CellBox,
    mirror: Option<Mirror>,
) -> Block {
    let mut blurred = blurred_part(block, full, weights, cells);
    blurred.mirror(mirror);
    blurred
}

/// Blurs like [`blur_of_few`], but does not mirror the result. Computes only the cells within reach
/// of nonzero samples; all other cells are 0.
fn blurred_part(block: &Block, full: &[IVec3], weights: &Weights, cells: CellBox) -> Block {
    let reach = weights.reach();
    let near = cells.grown(reach, reach);
    let full: Vec<_> = full.iter().copied().filter(|&cell| near.contains(cell)).collect();
    let Some(&first) = full.first() else { return Block::zero(cells) };
    let (lo, hi) = full.iter().fold((first, first), |(lo, hi), &cell| (lo.min(cell), hi.max(cell)));
    let reached = CellBox { lo, hi: hi + 1 }.grown(reach, reach).intersection(&cells);
    let input = reached.grown(reach, reach);
    let [width, height, _] = reached.size().as_usizevec3().to_array();
    let [_, rows, layers] = input.size().as_usizevec3().to_array();
    let mut along_x = vec![0; width * rows];
    let mut along_y = vec![0; width * height * layers];
    let mut sums = vec![0; width];
    let half = weights.half();
    let all: Vec<u32> = half[1..].iter().rev().chain(half).copied().collect();
    for layer in full.chunk_by(|a, b| a.z == b.z) {
        along_x.fill(0);
        for full in layer.chunk_by(|a, b| a.y == b.y) {
            let row = block.index(full[0].with_x(input.lo.x));
            let first = (full[0].y - input.lo.y) as usize * width;
            let to = &mut along_x[first..first + width];
            blur_few(to, &block.samples()[row..], (input.lo.x, full), &all, &mut sums);
        }
        let first = (layer[0].z - input.lo.z) as usize * width * height;
        let to = &mut along_y[first..first + width * height];
        u16::blur_row(to, &along_x, width, weights, 1);
    }
    let mut part = Block::zero(reached);
    u16::blur_row(part.samples_mut(), &along_y, width * height, weights, 2);
    if reached == cells {
        return part;
    }
    let mut blurred = Block::zero(cells);
    blurred.put(&part);
    blurred
}

/// Blurs a row along x. The first tap belongs to the cell at x = `lowest`. Only the taps of the
/// cells `full` are above 0, so only these taps are multiplied by weights. `sums` is scratch memory
/// of the same length as `to`.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn blur_few(
    to: &mut [u16],
    taps: &[u16],
    (lowest, full): (i32, &[IVec3]),
    weights: &[u32],
    sums: &mut [u32],
) {
    sums.fill(UNIT / 2);
    for cell in full {
        let at = (cell.x - lowest) as usize;
        let tap = u32::from(taps[at]);
        let first = (at + 1).saturating_sub(weights.len());
        let end = sums.len().min(at + 1);
        let weights = &weights[first + weights.len() - 1 - at..];
        for (sum, weight) in sums[first..end].iter_mut().zip(weights) {
            *sum += weight * tap;
        }
    }
    for (to, &sum) in to.iter_mut().zip(&*sums) {
        *to = (sum / UNIT) as u16;
    }
}

/// Samples of the DIF, blurred by the formula in `mod.rs`.
impl BlurSample for u16 {
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

/// Blurs sums of attributes in f64. Each weight is an integer, divided by the sum of all weights.
/// For each sum, the weighted taps are added in the order of their positions.
impl BlurSample for f64 {
    fn blur_row(to: &mut [Self], taps: &[Self], step: usize, weights: &Weights, _: usize) {
        blur_float(to, taps, step, weights.half());
    }
}

/// Blurs a row with weights that are narrow enough to stay in registers.
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

/// Blurs a row with weights of any width and gain.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn blur_wide(to: &mut [u16], taps: &[u16], step: usize, half: &[u32], shift: u32) {
    // The number of sums that stay in registers.
    const LANES: usize = 32;
    let (centre, pairs) = half.split_first().expect("weights have a centre");
    let reach = pairs.len();
    let (many, rest) = to.as_chunks_mut::<LANES>();
    let done = many.len() * LANES;
    for (first, to) in (0..).step_by(LANES).zip(many) {
        let taps = |k: usize| {
            taps[first + k * step..].first_chunk::<LANES>().expect("taps for every sample")
        };
        let own = taps(reach);
        // These are plain loops, because a closure would not be compiled for the selected CPU
        // features, and would be called for each sample.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sparse_block_is_blurred_like_a_dense_one() {
        let cells = CellBox { lo: IVec3::new(-3, 5, 0), hi: IVec3::new(30, 41, 29) };
        let full = [[-3, 5, 0], [8, 20, 10], [9, 20, 10], [12, 20, 10], [29, 40, 28], [15, 6, 27]];
        for weights in
            [Weights::box3(), Weights::of_variance(2.0, 4), Weights::of_variance(9.0, 8).gaining(4)]
        {
            for count in 0..full.len() {
                let mut block = Block::zero(cells);
                for (number, &cell) in full[..count].iter().enumerate() {
                    let index = block.index(IVec3::from(cell));
                    block.samples_mut()[index] = 9973 * (number as u16 + 1);
                }
                let cells_of_few = block.full_cells(count).expect("at most `count` cells are full");
                let mirror = Some(Mirror::new(CellBox { lo: cells.lo + 9, hi: cells.hi }));
                let inner = cells.grown(-weights.reach(), -weights.reach());
                let few = |cells| blur_of_few(&block, &cells_of_few, &weights, cells, mirror);
                assert_eq!(block.full_cells(count.saturating_sub(1)).is_none(), count > 0);
                let (all, part) = (few(inner), few(inner.grown(-3, -5)));
                let dense = blur(block.clone(), &weights, mirror);
                assert_eq!(part, dense.part(part.cells()), "{count} samples");
                assert_eq!(all, dense, "{count} samples");
            }
        }
    }
}
