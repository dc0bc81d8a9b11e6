//! See the room's `mod.rs` for the formulas.

use multiversion::multiversion;

use crate::brick::Block;
use crate::units::{FULL, Isovalue};

use super::{FINE_BITS, fine_scale};

/// 1 in every full cell, whose theta is not less than `least`.
#[must_use]
pub fn occupancy(mut dif: Block, least: u16) -> Block {
    dif.samples_mut().iter_mut().for_each(|theta| *theta = if *theta >= least { FULL } else { 0 });
    dif
}

/// The greatest sample within `reach` cells along each axis; the result is smaller by as much on every side.
///
/// # Panics
/// If the block is too small for one cell to remain.
#[must_use]
pub fn spread(block: Block, reach: i32) -> Block {
    block.along_each_axis(reach, |to, taps, step| greatest(to, taps, step, 2 * reach as usize + 1))
}

/// Fills `to[i]` with the greatest of so many taps, `step` apart.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn greatest(to: &mut [u16], taps: &[u16], step: usize, count: usize) {
    to.copy_from_slice(&taps[..to.len()]);
    for k in 1..count {
        for (to, &sample) in to.iter_mut().zip(&taps[k * step..]) {
            *to = (*to).max(sample);
        }
    }
}

/// The field on the cells of `near`, where `fine` is the blurred occupancy.
///
/// # Panics
/// If `fine` or `smooth` does not cover `near`.
#[must_use]
pub fn blend(fine: &Block, smooth: &Block, mut near: Block, iso: Isovalue) -> Block {
    let cells = near.cells();
    let width = cells.size().x as usize;
    let rows = fine.rows(cells).zip(smooth.rows(cells));
    for (near, ((_, fine), (_, smooth))) in near.samples_mut().chunks_exact_mut(width).zip(rows) {
        blend_row(near, fine, smooth, iso.threshold(), fine_scale(iso));
    }
    near
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn blend_row(near: &mut [u16], fine: &[u16], smooth: &[u16], threshold: u16, scale: u32) {
    let whole = u32::from(threshold) + 1;
    for ((near, &fine), &smooth) in near.iter_mut().zip(fine).zip(smooth) {
        let share = (2 * u32::from(near.saturating_sub(threshold))).min(whole);
        let smooth = u32::from(smooth);
        let fine = ((u32::from(fine) * scale) >> FINE_BITS).min(FULL.into()).max(smooth);
        let sum = (whole - share) * fine + share * smooth;
        *near = ((sum + whole / 2) / whole) as u16;
    }
}
