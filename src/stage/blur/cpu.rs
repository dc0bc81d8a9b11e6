//! See the room's `mod.rs` for the formula.

use multiversion::multiversion;

use crate::brick::Block;

use super::{Kernel, UNIT};

/// A number that can be blurred.
pub trait Sample: Copy + Default {
    /// Fills `to[i]` from `taps[i]`, `taps[i + step]`, ..., one tap for each of the kernel's weights.
    fn blur_row(to: &mut [Self], taps: &[Self], step: usize, kernel: &Kernel);
}

/// Blurs `block` with `kernel` along x, then y, then z.
///
/// The result is smaller by the kernel's reach on every side: exactly the cells whose whole
/// neighbourhood was given.
///
/// # Panics
/// If the block is too small for one cell to remain: recipe and gather disagree, which is our bug.
#[must_use]
pub fn blur<T: Sample>(mut block: Block<T>, kernel: &Kernel) -> Block<T> {
    let mut spare = Vec::new();
    (0..3).for_each(|axis| blur_along(&mut block, axis, kernel, &mut spare));
    block
}

/// The same along one axis, in a spare buffer whose contents do not matter.
///
/// # Panics
/// As [`blur`].
pub fn blur_along<T: Sample>(block: &mut Block<T>, axis: usize, kernel: &Kernel, spare: &mut Vec<T>) {
    let fill = |to: &mut [T], taps: &[T], step| T::blur_row(to, taps, step, kernel);
    block.along(axis, kernel.reach(), spare, &fill);
}

/// Integers of the DIF, by the formula of `mod.rs`.
impl Sample for u16 {
    fn blur_row(to: &mut [Self], taps: &[Self], step: usize, kernel: &Kernel) {
        match kernel.half() {
            &[w0, w1] => blur_narrow(to, taps, step, &[w0, w1]),
            &[w0, w1, w2] => blur_narrow(to, taps, step, &[w0, w1, w2]),
            &[w0, w1, w2, w3] => blur_narrow(to, taps, step, &[w0, w1, w2, w3]),
            &[w0, w1, w2, w3, w4] => blur_narrow(to, taps, step, &[w0, w1, w2, w3, w4]),
            &[w0, w1, w2, w3, w4, w5] => blur_narrow(to, taps, step, &[w0, w1, w2, w3, w4, w5]),
            half => blur_wide(to, taps, step, half),
        }
    }
}

/// Sums of attributes: the same weights as fractions of 1, taps added in order.
impl Sample for f64 {
    fn blur_row(to: &mut [Self], taps: &[Self], step: usize, kernel: &Kernel) {
        blur_float(to, taps, step, kernel.half());
    }
}

/// For kernels narrow enough to stay in registers.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn blur_narrow<const HALF: usize>(to: &mut [u16], taps: &[u16], step: usize, half: &[u32; HALF]) {
    let len = to.len();
    let tap = |k: usize| &taps[k * step..k * step + len];
    let centre = tap(HALF - 1);
    let pairs: [(&[u16], &[u16]); HALF] = std::array::from_fn(|k| (tap(HALF - 1 - k), tap(HALF - 1 + k)));
    for i in 0..len {
        let mut sum = half[0] * u32::from(centre[i]) + (1 << 15);
        for k in 1..HALF {
            sum += half[k] * (u32::from(pairs[k].0[i]) + u32::from(pairs[k].1[i]));
        }
        to[i] = (sum >> 16) as u16;
    }
}

/// For kernels of any width, one tap after the other.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn blur_wide(to: &mut [u16], taps: &[u16], step: usize, half: &[u32]) {
    let reach = half.len() - 1;
    let mut sums = vec![1_u32 << 15; to.len()];
    for k in 0..=2 * reach {
        let weight = half[k.abs_diff(reach)];
        for (sum, &sample) in sums.iter_mut().zip(&taps[k * step..]) {
            *sum += weight * u32::from(sample);
        }
    }
    for (to, sum) in to.iter_mut().zip(sums) {
        *to = (sum >> 16) as u16;
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
