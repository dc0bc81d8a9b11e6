//! See `mod.rs` of this folder for the formulas.

use glam::IVec3;
use multiversion::multiversion;

use crate::brick::{Block, runs};
use crate::grid::CellBox;

use super::inverse_normal::{AWAY, DEPTHS};
use super::{
    Bulk, Depths, Drops, MOST_APART, NONE, Ramp, StandsOut, ZERO, spline, spline_bits, wide_cells,
};

/// The number of low bits of a share that give its position between two entries of a table with
/// 1024 steps. The other bits are the index of the lower entry.
const BETWEEN_BITS: u32 = 5;

/// The share 1: a share is a fraction, in 32768ths.
const WHOLE: u32 = 1 << 15;

/// For each step of a table, its entry and the difference to the next entry. The array is as long
/// as the range of a masked index, so that indexing needs no bounds checks.
type Steps = [[i16; 2]; 2048];

const fn steps(table: &[i16; 1026]) -> Steps {
    let mut steps = [[0; 2]; 2048];
    let mut at = 0;
    while at + 1 < table.len() {
        steps[at] = [table[at], table[at + 1] - table[at]];
        at += 1;
    }
    steps
}

static DEPTH_STEPS: Steps = steps(&DEPTHS);
static AWAY_STEPS: Steps = steps(&AWAY);

/// The entry of a table for a share from 0 to 32768, the difference to the next entry, and the
/// position of the share between them.
#[inline(always)]
fn entry(steps: &Steps, share: u32) -> (i32, i32, i32) {
    let [low, more] = steps[(share >> BETWEEN_BITS) as usize % steps.len()];
    (low.into(), more.into(), (share & ((1 << BETWEEN_BITS) - 1)) as i32)
}

/// The depth for a sample: the tabulated depth for the sample divided by the plateau, times the
/// standard deviation of the smoothing.
#[inline(always)]
fn depth(sample: u16, scale: u32, spacings: i32, most: i32) -> i32 {
    let (low, more, between) = entry(&DEPTH_STEPS, ((u32::from(sample) * scale) >> 14).min(WHOLE));
    let deviations = 4 * low + ((more * between) >> 3);
    (deviations.clamp(-most, most) * spacings) >> 14
}

/// Converts a distance to a sample.
#[inline(always)]
fn sample(distance: i32) -> u16 {
    (distance + ZERO).clamp(i32::from(NONE) + 1, i32::from(u16::MAX)) as u16
}

/// Computes distances from `shares`, the samples smoothed with each width, narrowest first. The
/// result has the cells of the last block.
///
/// # Panics
/// If a block does not cover the last one.
pub fn depths(bulk: &Bulk, shares: [&Block; 3]) -> Depths<Block> {
    let cells = shares[2].cells();
    let (length, runs) = runs(cells, &shares.map(Block::cells));
    let [mut calm, mut fine, mut apart] = [(); 3].map(|()| Block::zero(cells));
    let to = calm
        .samples_mut()
        .chunks_exact_mut(length)
        .zip(fine.samples_mut().chunks_exact_mut(length))
        .zip(apart.samples_mut().chunks_exact_mut(length));
    for (((calm, fine), apart), first) in to.zip(runs) {
        depths_row([calm, fine, apart], shares.map(|shares| shares.run(first, length)), bulk);
    }
    Depths { calm, fine, apart }
}

/// Computes a run of samples of the calm surface, of the fine surface, and of their difference.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn depths_row(
    [calm, fine, apart]: [&mut [u16]; 3],
    [narrow, middle, wide]: [&[u16]; 3],
    bulk: &Bulk,
) {
    let [a, b, c] = &bulk.widths;
    let (a, b, c) = ((a.spacings, a.most), (b.spacings, b.most), (c.spacings, c.most));
    let ([fine_share, calm_share], scale) = (bulk.shares, bulk.scale);
    let to = calm.iter_mut().zip(fine).zip(apart);
    for (((calm, fine), apart), ((&narrow, &middle), &wide)) in
        to.zip(narrow.iter().zip(middle).zip(wide))
    {
        let a = depth(narrow, scale, a.0, a.1);
        let b = depth(middle, scale, b.0, b.1);
        let c = depth(wide, scale, c.0, c.1);
        *fine = sample(a + (((a - b) * fine_share + 2048) >> 12));
        *calm = sample(b + (((b - c) * calm_share + 2048) >> 12));
        let by = (i32::from(*fine) - i32::from(*calm)).clamp(-MOST_APART, MOST_APART);
        *apart = (by + ZERO) as u16;
    }
}

/// The bulk's surface: the calm surface, blended with the fine surface where their mean difference
/// is large, except deep in the fluid; [`NONE`] where no particle is near. The result has the cells
/// that `apart` and `near` share.
///
/// # Panics
/// If `apart` and `near` share no cell, or if `calm` or `fine` does not cover the shared cells.
pub fn mixed(
    bulk: &Bulk,
    Depths { calm, fine, apart }: &Depths<impl AsRef<Block>>,
    near: &Block,
) -> Block {
    let cells = apart.as_ref().cells().intersection(&near.cells());
    let from = [calm.as_ref(), fine.as_ref(), apart.as_ref(), near];
    let (length, runs) = runs(cells, &from.map(Block::cells));
    let mut field = Block::zero(cells);
    for (to, first) in field.samples_mut().chunks_exact_mut(length).zip(runs) {
        mixed_row(to, from.map(|block| block.run(first, length)), bulk);
    }
    field
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn mixed_row(to: &mut [u16], [calm, fine, apart, near]: [&[u16]; 4], bulk: &Bulk) {
    let (apart_ramp, deep) = (bulk.apart, bulk.deep);
    let taps = calm.iter().zip(fine).zip(apart.iter().zip(near));
    for (to, ((&calm, &fine), (&apart, &near))) in to.iter_mut().zip(taps) {
        let shape = apart_ramp.of((i32::from(apart) - ZERO).unsigned_abs() as u16);
        let shallow = 4096 - deep.of(calm);
        let share = (shape * shallow) >> 12;
        let (calm, fine) = (i32::from(calm), i32::from(fine));
        let blended = (calm + (((fine - calm) * share as i32 + 2048) >> 12)) as u16;
        *to = if near == NONE { NONE } else { blended };
    }
}

/// The distance by which each cell with a particle lies outside the calm surface; [`NONE`] for
/// cells without particles. Small distances are reduced where the fine surface agrees with the calm
/// surface.
///
/// # Panics
/// If `fine` or `clouds` does not cover `calm`.
pub fn outlying(
    [calm, fine]: [&Block; 2],
    clouds: &Block,
    (least, stands_out): (u16, &StandsOut),
) -> Block {
    let cells = calm.cells();
    let from = [calm, fine, clouds];
    let (length, runs) = runs(cells, &from.map(Block::cells));
    let mut field = Block::zero(cells);
    for (to, first) in field.samples_mut().chunks_exact_mut(length).zip(runs) {
        let [calm, fine, clouds] = from.map(|block| block.run(first, length));
        outlying_row(to, calm, clouds, least);
        // Distances up to `begin` stay unchanged, so a run without larger distances is skipped.
        if greatest_of(to) > stands_out.begin() {
            reduced_in_bulk(to, [calm, fine], stands_out);
        }
    }
    field
}

/// Reduces distances as in [`StandsOut::of_particle`].
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn reduced_in_bulk(to: &mut [u16], [calm, fine]: [&[u16]; 2], stands_out: &StandsOut) {
    for ((to, &calm), &fine) in to.iter_mut().zip(calm).zip(fine) {
        *to = stands_out.of_particle(*to, fine.saturating_sub(calm));
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn outlying_row(to: &mut [u16], bulk: &[u16], clouds: &[u16], least: u16) {
    for ((to, &bulk), &clouds) in to.iter_mut().zip(bulk).zip(clouds) {
        *to = if clouds >= least { (u16::MAX - bulk).max(NONE + 1) } else { NONE };
    }
}

/// The greatest sample within `reach` cells along each axis; the result is smaller by `reach` on
/// every side.
///
/// # Panics
/// If the block is too small for one cell to remain.
pub fn spread(block: Block, reach: i32) -> Block {
    block.along_each_axis(reach, |to, taps, step| greatest(to, taps, step, 2 * reach as usize + 1))
}

/// Fills `to[i]` with the greatest of `count` taps: `taps[i]`, `taps[i + step]`, ...
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn greatest(to: &mut [u16], taps: &[u16], step: usize, count: usize) {
    to.copy_from_slice(&taps[..to.len()]);
    for k in 1..count {
        for (to, &sample) in to.iter_mut().zip(&taps[k * step..]) {
            *to = (*to).max(sample);
        }
    }
}

/// Interpolates `wide`, a field of cells 2^`level` times as wide, at the middles of `cells`. The
/// samples of `wide` are the control points of a quadratic B-spline. At level 0, the samples of
/// `wide` are returned unchanged.
///
/// # Panics
/// If `wide` does not cover the [wide cells](super::wide_cells) of `cells`.
pub fn refined(wide: &Block, level: u32, cells: CellBox) -> Block {
    if level == 0 {
        return wide.part(cells);
    }
    let weights: Vec<[u32; 3]> = (0..1 << level).map(|place| spline(level, place)).collect();
    let along_x = refined_along_x(&wide.part(wide_cells(level, cells)), level, cells, &weights);
    let along_y = refined_along(&along_x, 1, level, cells, &weights);
    refined_along(&along_y, 2, level, cells, &weights)
}

/// Refines a field along x. Each call of [`means`] computes, for all wide cells, the sample at one
/// position within the wide cell.
fn refined_along_x(wide: &Block, level: u32, cells: CellBox, weights: &[[u32; 3]]) -> Block {
    let mut to = wide.cells();
    (to.lo.x, to.hi.x) = (cells.lo.x, cells.hi.x);
    let mut field = Block::zero(to);
    let samples = wide.samples();
    let inner = samples.len() - 2;
    let (from_width, width) = (wide.cells().size().x as usize, to.size().x as usize);
    let mut of_place = vec![0; inner];
    for (place, &weights) in (0..).zip(weights) {
        let first = to.lo.x + ((place - to.lo.x) & ((1 << level) - 1));
        if first >= to.hi.x {
            continue;
        }
        // Means are computed for all samples except the first and the last of the field. Means that
        // mix two rows are never read.
        means(
            &mut of_place,
            weights,
            [0, 1, 2].map(|at| &samples[at..][..inner]),
            spline_bits(level),
        );
        let own = ((first >> level) - wide.cells().lo.x - 1) as usize;
        let rows = field.samples_mut().chunks_exact_mut(width).zip((own..).step_by(from_width));
        for (row, from) in rows {
            let row = row[(first - to.lo.x) as usize..].iter_mut().step_by(1 << level);
            row.zip(&of_place[from..]).for_each(|(to, &mean)| *to = mean);
        }
    }
    field
}

/// Refines a field along y or z. Each call of [`means`] computes a row of cells along x if the axis
/// is y, and a layer of cells perpendicular to z if the axis is z.
fn refined_along(
    wide: &Block,
    axis: usize,
    level: u32,
    cells: CellBox,
    weights: &[[u32; 3]],
) -> Block {
    let mut to = wide.cells();
    (to.lo[axis], to.hi[axis]) = (cells.lo[axis], cells.hi[axis]);
    let mut field = Block::zero(to);
    let step = wide.strides()[axis];
    let (from_run, run) =
        (step * wide.cells().size()[axis] as usize, step * to.size()[axis] as usize);
    let runs = field.samples_mut().chunks_exact_mut(run).zip(wide.samples().chunks_exact(from_run));
    for (to_run, from) in runs {
        for (cell, to) in (to.lo[axis]..).zip(to_run.chunks_exact_mut(step)) {
            let below = ((cell >> level) - wide.cells().lo[axis] - 1) as usize * step;
            let taps = [below, below + step, below + 2 * step].map(|at| &from[at..][..step]);
            means(to, weights[(cell & ((1 << level) - 1)) as usize], taps, spline_bits(level));
        }
    }
    field
}

#[inline(always)]
fn mean(weights: [u32; 3], taps: [u16; 3], shift: u32) -> u16 {
    let sum = weights[0] * u32::from(taps[0])
        + weights[1] * u32::from(taps[1])
        + weights[2] * u32::from(taps[2])
        + (1 << (shift - 1));
    (sum >> shift) as u16
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn means(to: &mut [u16], weights: [u32; 3], [below, own, above]: [&[u16]; 3], shift: u32) {
    if shift >= u16::BITS {
        return wide_means(to, weights, [below, own, above], shift);
    }
    for (((to, &below), &own), &above) in to.iter_mut().zip(below).zip(own).zip(above) {
        *to = mean(weights, [below, own, above], shift);
    }
}

/// Fills `to` with weighted means. The sums have 64 bits, because with some weights they exceed 32
/// bits.
fn wide_means(to: &mut [u16], weights: [u32; 3], [below, own, above]: [&[u16]; 3], shift: u32) {
    let product = |weight: u32, tap: u16| u64::from(weight) * u64::from(tap);
    for (((to, &below), &own), &above) in to.iter_mut().zip(below).zip(own).zip(above) {
        let [a, b, c] = weights;
        let sum = product(a, below) + product(b, own) + product(c, above) + (1 << (shift - 1));
        *to = (sum >> shift) as u16;
    }
}

/// The density of clouds, divided by the smoothed density `around`, in units of 1 / 2^`bits`, on
/// the cells of `around`.
///
/// # Panics
/// If `clouds` does not cover `around`.
pub fn quotient(clouds: &Block, around: &Block, bits: u32) -> Block {
    let cells = around.cells();
    let (length, runs) = runs(cells, &[clouds.cells()]);
    let mut field = Block::zero(cells);
    for (to, first) in field.samples_mut().chunks_exact_mut(length).zip(runs) {
        let [clouds, around] = [clouds, around].map(|block| block.run(first, length));
        if greatest_of(clouds) == 0 {
            continue;
        }
        quotient_row(to, clouds, around, bits);
    }
    field
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn quotient_row(to: &mut [u16], clouds: &[u16], around: &[u16], bits: u32) {
    // A quotient, in units of 1 / 2^`bits`, is either an integer, or below the next integer by more
    // than the rounding error of f64. So f64 divisions, which can be vectorized, give the correct
    // integer part. Subtracting just under a half and adding `WHOLE_NUMBERS`, whose last bit counts
    // for 1, rounds the quotient down.
    const WHOLE_NUMBERS: f64 = 3.0 * (1_u64 << 51) as f64;
    const JUST_UNDER_HALF: f64 = 0.5 - 1.0 / (1 << 18) as f64;
    for ((to, &clouds), &around) in to.iter_mut().zip(clouds).zip(around) {
        let quotient = f64::from(i32::from(clouds) << bits) / f64::from(i32::from(around.max(1)));
        let quotient = quotient.min(f64::from(u16::MAX));
        *to = (quotient - JUST_UNDER_HALF + WHOLE_NUMBERS).to_bits() as u16;
    }
}

/// The greatest of `samples`; 0 if there are none.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
pub fn greatest_of(samples: &[u16]) -> u16 {
    let mut greatest = 0;
    for &sample in samples {
        greatest = greatest.max(sample);
    }
    greatest
}

/// The smallest box around those of the `cells` whose sample in `near` exceeds `begin`. Near these
/// cells, a particle lies more than `begin` outside the calm surface.
///
/// # Panics
/// If `near` does not cover `cells`.
pub fn outlying_part(near: &Block, cells: CellBox, begin: u16) -> CellBox {
    let mut part = CellBox::EMPTY;
    for ([y, z], row) in near.rows(cells) {
        if greatest_of(row) <= begin {
            continue;
        }
        let stands_out = |near: &u16| *near > begin;
        let first = row.iter().position(stands_out).unwrap_or(0) as i32;
        let last = row.iter().rposition(stands_out).unwrap_or(0) as i32;
        let lo = IVec3::new(cells.lo.x + first, y, z);
        part = part.union(&CellBox { lo, hi: IVec3::new(cells.lo.x + last, y, z) + 1 });
    }
    part
}

/// The distance from a drop's middle at which the drop's Gaussian is `share` times its maximum. The
/// standard deviation of the Gaussian is `width`, and the result is in the same unit.
#[inline(always)]
pub fn away(share: u16, width: i32) -> i32 {
    let (low, more, between) = entry(&AWAY_STEPS, u32::from(share).min(WHOLE));
    ((low + ((more * between) >> BETWEEN_BITS)) * width) >> 12
}

/// Blends the surface of the bulk with drops. Drops get more weight the farther nearby particles
/// lie outside the calm surface. Sheets get weight at smaller distances, according to their
/// certainty. Only the cells of `shares` can have drops; in all other cells, the result is `bulk`.
///
/// # Panics
/// If `bulk`, `near` or `certainty` does not cover `shares`.
pub fn joined(
    mut bulk: Block,
    near: &Block,
    shares: &Block,
    certainty: Option<&Block>,
    drops: &Drops,
    stands_out: &StandsOut,
) -> Block {
    let part = shares.cells();
    let certain = certainty.map_or(part, Block::cells);
    let (length, runs) = runs(part, &[bulk.cells(), near.cells(), certain]);
    let mut distances = vec![0; length];
    for first in runs {
        let [near, shares] = [near, shares].map(|block| block.run(first, length));
        if greatest_of(near) <= stands_out.begin() {
            continue;
        }
        let near = match certainty {
            Some(certainty) => {
                let certainty = certainty.run(first, length);
                standing_out(&mut distances, near, certainty, stands_out);
                &distances[..]
            }
            None => near,
        };
        let first = bulk.index(first);
        let bulk = &mut bulk.samples_mut()[first..first + length];
        joined_row(bulk, near, shares, drops, &stands_out.ramp);
    }
    bulk
}

/// The distances by which particles stand out, increased for sheets according to their certainty.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn standing_out(to: &mut [u16], near: &[u16], certainty: &[u16], stands_out: &StandsOut) {
    for ((to, &near), &certain) in to.iter_mut().zip(near).zip(certainty) {
        *to = stands_out.of_sheet(near, certain);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn joined_row(bulk: &mut [u16], near: &[u16], shares: &[u16], drops: &Drops, ramp: &Ramp) {
    let (radius, width, ramp) = (drops.radius, drops.width, *ramp);
    for ((bulk, &near), &share) in bulk.iter_mut().zip(near).zip(shares) {
        let weight = ramp.of(near);
        let distance = radius - away(share, width);
        let out = (distance + ZERO - i32::from(*bulk)).max(0);
        let with_drops = sample(i32::from(*bulk) - ZERO + ((out * weight as i32 + 2048) >> 12));
        *bulk = if weight == 0 { *bulk } else { with_drops };
    }
}
