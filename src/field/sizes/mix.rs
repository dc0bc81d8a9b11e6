//! Distances of several octaves, mixed by the sizes of nearby particles, and the drops of each
//! octave.

use glam::IVec3;

use crate::brick::Block;
use crate::field::distance::{Drops, NONE, StandsOut, ZERO, away, greatest_of};
use crate::field::sheets::{BITS, ONE};

/// A share of 1.
pub const WHOLE: u32 = 1 << 15;

/// The quotient `part` / `all` of two smoothed densities, in 32768ths; `of_none` where `all` is 0.
///
/// # Panics
/// If the densities are on different cells.
#[must_use]
pub fn share(part: &Block, all: &Block, of_none: u32) -> Block {
    assert!(part.cells() == all.cells(), "both densities are on the same cells");
    let mut shares = Block::zero(all.cells());
    let taps = part.samples().iter().zip(all.samples());
    for (to, (&part, &all)) in shares.samples_mut().iter_mut().zip(taps) {
        let whole = u32::from(part) * WHOLE + u32::from(all) / 2;
        *to = whole.checked_div(all.into()).map_or(of_none, |share| share.min(WHOLE)) as u16;
    }
    shares
}

/// Mixes the distances of an octave with the distances of the next coarser octave, weighted by the
/// `shares` of the coarser octave. Both distances are in spacings of the finer octave. Where the
/// share is 0, the result is the sample of `fine`. Elsewhere, if only one of the two fields has a
/// particle nearby, the result is the sample of that field.
///
/// # Panics
/// If the fields are on different cells.
#[must_use]
pub fn mixed(mut fine: Block, coarse: &Block, shares: &Block) -> Block {
    assert!(fine.cells() == coarse.cells() && fine.cells() == shares.cells(), "the same cells");
    let taps = coarse.samples().iter().zip(shares.samples());
    for (fine, (&coarse, &share)) in fine.samples_mut().iter_mut().zip(taps) {
        let share = i64::from(share);
        *fine = if share == 0 || coarse == NONE {
            *fine
        } else if share == i64::from(WHOLE) || *fine == NONE {
            coarse
        } else {
            // The division rounds towards 0, so that a mirrored frame has a mirrored field.
            let more = (i64::from(coarse) - i64::from(*fine)) * share / i64::from(WHOLE);
            (i64::from(*fine) + more) as u16
        };
    }
    fine
}

/// Converts a field of distances to spacings that are half as long.
#[must_use]
pub fn finer_spacings(mut field: Block) -> Block {
    field.samples_mut().iter_mut().for_each(|to| *to = in_finer_spacings(*to));
    field
}

/// Converts a distance to spacings that are half as long.
#[must_use]
pub fn in_finer_spacings(sample: u16) -> u16 {
    if sample == NONE {
        return NONE;
    }
    let distance = 2 * (i64::from(sample) - i64::from(ZERO));
    (distance + i64::from(ZERO)).clamp(i64::from(NONE) + 1, u16::MAX.into()) as u16
}

/// The drops of an octave, on some of the finest cells.
#[derive(Debug)]
pub struct OctaveDrops<'a> {
    /// The octave.
    pub octave: u32,
    /// The distance, in spacings of the octave, by which nearby particles lie outside the surface.
    pub near: &'a Block,
    /// The shares of drops.
    pub shares: &'a Block,
    /// The certainty of sheets, if there are any.
    pub certainty: Option<&'a Block>,
    /// The mean logarithm of the particles' sizes in the octave, in 32768ths.
    pub sizes: Option<&'a Block>,
    /// The radius and the width of the smallest drops.
    pub drops: &'a Drops,
    /// The growth of the radius from a size to twice that size, in units.
    pub growth: i32,
    /// The distances from the surface at which drops and sheets fade in.
    pub stands_out: &'a StandsOut,
}

impl OctaveDrops<'_> {
    /// Joins the drops to `field`, whose distances are in the finest spacings. Changes only the
    /// cells of the shares.
    ///
    /// # Panics
    /// If the fields of `self` are not all on the same cells, or if `field` does not cover these
    /// cells.
    #[must_use]
    pub fn joined(&self, mut field: Block) -> Block {
        let Self { octave, near, shares, certainty, sizes, drops, growth, stands_out } = *self;
        let cells = shares.cells();
        let mut others = [Some(near), certainty, sizes].into_iter().flatten();
        assert!(others.all(|other| other.cells() == cells), "all fields are on the same cells");
        let width = cells.size().x as usize;
        for (row, ([y, z], near)) in near.rows(cells).enumerate() {
            if greatest_of(near) <= stands_out.begin() {
                continue;
            }
            let first = field.index(IVec3::new(cells.lo.x, y, z));
            let to = &mut field.samples_mut()[first..first + width];
            for ((at, to), &near) in (row * width..).zip(to).zip(near) {
                let certain = certainty.map_or(0, |certainty| certainty.samples()[at]);
                let weight = stands_out.ramp.of(stands_out.of_sheet(near, certain));
                if weight == 0 {
                    continue;
                }
                let size = sizes.map_or(0, |sizes| sizes.samples()[at]);
                // The share of a sheet already depends on its amount of fluid, so only the radius
                // of drops grows with the size.
                let of_drops = i64::from(ONE - i32::from(certain));
                let more = (i64::from(growth) * i64::from(exp2(size) - WHOLE)) >> 15;
                let more = (more * of_drops) >> BITS;
                let radius = drops.radius + more as i32;
                let distance = (radius - away(shares.samples()[at], drops.width)) << octave;
                let bulk = i32::from(*to) - ZERO;
                let out = (distance - bulk).max(0);
                let joined = bulk + ((i64::from(out) * i64::from(weight) + 2048) >> 12) as i32;
                *to = (joined + ZERO).clamp(i32::from(NONE) + 1, u16::MAX.into()) as u16;
            }
        }
        field
    }
}

/// 2 to the power of a number from 0 to 1, both in 32768ths. The error is at most 0.4 %.
fn exp2(power: u16) -> u32 {
    let power = u32::from(power).min(WHOLE);
    WHOLE + ((power * (21_512 + ((11_256 * power) >> 15))) >> 15)
}

#[cfg(test)]
mod tests {
    use glam::IVec3;

    use super::*;
    use crate::grid::CellBox;

    fn block(samples: [u16; 4]) -> Block {
        let mut block = Block::zero(CellBox { lo: IVec3::ZERO, hi: IVec3::new(4, 1, 1) });
        block.samples_mut().copy_from_slice(&samples);
        block
    }

    #[test]
    fn mixed_distances_are_in_units_of_the_finer_spacing() {
        let [zero, one] = [32768, 40960];
        let fine = block([one, one, NONE, one]);
        let coarse = finer_spacings(block([one, one, one, NONE]));
        let found = mixed(fine, &coarse, &block([0, 16384, 100, 100]));
        assert_eq!(found.samples(), [one, one + 4096, one + 8192, one]);
        assert_eq!(in_finer_spacings(zero), zero);
        assert_eq!(in_finer_spacings(10000), NONE + 1);
    }

    #[test]
    fn the_fine_share_is_1_where_both_densities_are_0() {
        let found = share(&block([0, 5, 7, 0]), &block([0, 10, 7, 3]), WHOLE);
        assert_eq!(found.samples(), [32768, 16384, 32768, 0]);
    }

    #[test]
    fn integer_exp2_is_accurate_to_0_4_percent() {
        for power in (0..=32768_u16).step_by(1024) {
            let exact = 32768.0 * (f64::from(power) / 32768.0).exp2();
            assert!((f64::from(exp2(power)) / exact - 1.0).abs() < 0.004, "{power}");
        }
    }
}
