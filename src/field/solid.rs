//! Solids: clouds are continued into them before the surface of the bulk is made, and the field is
//! cut by them after.
//!
//! Of a cell's cloud density rho a share w lies outside of the solid, that of a plane as far from
//! the cell's centre as the solid is. What a solid takes away is filled with the density of the
//! fluid beside it, by normalised convolution: rho + (1 - w) (G * rho) / (G * w), with a Gaussian G
//! of 1 d, and of 2.5 d where that finds nothing. So the bulk does not end at a solid, and its
//! surface meets the solid as it would go on. The field is then the smaller one of its distance and
//! that of the solid.

use crate::brick::Block;
use crate::field::blur::{Weights, blur};
use crate::field::distance::{NONE, ZERO};
use crate::grid::CellBox;

/// The standard deviations of the Gaussians, in spacings, and where they are cut off, in those.
const WIDTHS: [f64; 2] = [1.0, 2.5];
const CUT: f64 = 2.2;
/// Bits that the smoothed density gains: as many as that of the bulk does.
const GAIN: u32 = 2;
/// The share of a cell that is all outside.
pub const WHOLE: u16 = 1 << 15;
/// The least share of a Gaussian that has to be outside to tell the density, for each width.
const LEAST: [u16; 2] = [WHOLE >> 5, WHOLE >> 7];
/// Steps of a distance in a cell's edge, for shares.
pub const STEPS: f64 = 4096.0;
/// How far outside a cell's cloud reaches, in such steps.
pub const FARTHEST: i16 = 3 * 2048;

/// The filters that continue clouds into solids.
#[derive(Debug, Clone, PartialEq)]
pub struct Fill {
    widths: [Weights; 2],
}

impl Fill {
    /// In cells of `edge` spacings.
    #[must_use]
    pub fn new(edge: f64) -> Self {
        let gaussian = |width: f64| {
            let variance = (width / edge).powi(2).max(0.35);
            let reach = (CUT * variance.sqrt()).round().max(1.0) as i32;
            Weights::of_variance(variance, reach)
        };
        Self { widths: WIDTHS.map(gaussian) }
    }

    /// How far from a cell others decide its density, in cells.
    #[must_use]
    pub fn reach(&self) -> i32 {
        self.widths.iter().map(Weights::reach).max().unwrap_or(0)
    }

    /// The samples of `cells`, continued into a solid, of which the shares outside are known.
    ///
    /// # Panics
    /// If `clouds` and `outside` do not cover the cells and as many around them as the
    /// [reach](Self::reach).
    #[must_use]
    pub fn filled(
        &self,
        clouds: &Block,
        outside: &Block,
        cells: CellBox,
        walls: Option<CellBox>,
    ) -> Block {
        let mut filled = clouds.part(cells);
        let part = outside.part(cells).box_of(|share| share < WHOLE);
        if part.is_empty() {
            return filled;
        }
        let smooth = |block: &Block, weights: &Weights| {
            let around = part.grown(weights.reach(), weights.reach());
            blur(block.part(around), weights, None)
        };
        let [near, far] = &self.widths;
        let [near, far] = [near, far].map(|weights| {
            [smooth(clouds, &weights.clone().gaining(GAIN)), smooth(outside, weights)]
        });
        for z in part.lo.z..part.hi.z {
            for y in part.lo.y..part.hi.y {
                for x in part.lo.x..part.hi.x {
                    let cell = glam::IVec3::new(x, y, z);
                    let missing = WHOLE - outside.at(cell);
                    let told = |[density, share]: &[Block; 2], least: u16| {
                        let share = share.at(cell);
                        (share >= least).then(|| {
                            (u64::from(density.at(cell)) << (15 - GAIN)) / u64::from(share)
                        })
                    };
                    let density = told(&near, LEAST[0]).or_else(|| told(&far, LEAST[1]));
                    let added = (density.unwrap_or(0) * u64::from(missing)) >> 15;
                    let index = filled.index(cell);
                    let sample = u64::from(filled.samples()[index]) + added;
                    filled.samples_mut()[index] = sample.min(u16::MAX.into()) as u16;
                }
            }
        }
        walls.into_iter().for_each(|walls| filled.repeat_edges(walls));
        filled
    }
}

/// The share of each cell's cloud that lies outside of a solid, in units of 1 / [`WHOLE`], by the
/// distance of its centre in 1 / [`STEPS`] of its edge.
#[must_use]
pub fn outside(distances: &Block<i16>) -> Block {
    let mut shares = Block::zero(distances.cells());
    for (share, &distance) in shares.samples_mut().iter_mut().zip(distances.samples()) {
        // The integral of the quadratic B-spline.
        let at = f64::from(distance) / STEPS;
        let beyond = (1.5 - at.abs()).max(0.0);
        let farther = if at.abs() < 0.5 {
            0.5 - at.abs() * (0.75 - at * at / 3.0)
        } else {
            beyond * beyond * beyond / 6.0
        };
        let outside = if at > 0.0 { 1.0 - farther } else { farther };
        *share = (outside * f64::from(WHOLE)).round() as u16;
    }
    shares
}

/// Cuts a field by a solid's distances, in its units; less than `most`, the solid is told to be as
/// far as it is.
///
/// # Panics
/// Unless both are of the same cells.
pub fn cut(field: &mut Block, distances: &Block<i16>, offset: i32, most: i16) {
    assert_eq!(field.cells(), distances.cells(), "a field is cut on all of its cells");
    for (sample, &distance) in field.samples_mut().iter_mut().zip(distances.samples()) {
        if distance < most {
            let to_solid = ZERO + i32::from(distance) - offset;
            let to_solid = to_solid.clamp(i32::from(NONE) + 1, i32::from(u16::MAX)) as u16;
            *sample = (*sample).min(to_solid);
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::IVec3;

    use super::*;

    #[test]
    fn shares_outside_rise_from_none_to_all_and_sum_to_one_on_both_sides() {
        let cells = CellBox { lo: IVec3::ZERO, hi: IVec3::new(101, 1, 1) };
        let mut distances = Block::zero(cells);
        for (to, at) in distances.samples_mut().iter_mut().zip(-50..) {
            *to = at * (FARTHEST / 50 + 1);
        }
        let shares = outside(&distances);
        assert!(shares.samples().is_sorted());
        assert_eq!([shares.samples()[0], shares.samples()[100]], [0, WHOLE]);
        for (a, b) in shares.samples().iter().zip(shares.samples().iter().rev()) {
            assert!((i32::from(a + b) - i32::from(WHOLE)).abs() <= 1);
        }
    }

    #[test]
    fn a_fluid_of_even_density_goes_on_into_a_solid_and_air_stays_empty() {
        let fill = Fill::new(0.7);
        let cells = CellBox { lo: IVec3::splat(-4), hi: IVec3::splat(5) };
        let around = cells.grown(fill.reach(), fill.reach());
        let mut distances = Block::zero(around);
        for z in around.lo.z..around.hi.z {
            for y in around.lo.y..around.hi.y {
                for x in around.lo.x..around.hi.x {
                    let index = distances.index(IVec3::new(x, y, z));
                    let steps = f64::from(x) * STEPS;
                    distances.samples_mut()[index] =
                        steps.clamp(f64::from(-FARTHEST), f64::from(FARTHEST)) as i16;
                }
            }
        }
        let outside = outside(&distances);
        let mut clouds = Block::zero(around);
        for (cloud, share) in clouds.samples_mut().iter_mut().zip(outside.samples()) {
            *cloud = (u32::from(*share) * 4096 / u32::from(WHOLE)) as u16;
        }
        let filled = fill.filled(&clouds, &outside, cells, None);
        assert!(filled.samples().iter().all(|sample| sample.abs_diff(4096) < 16));
        let empty = fill.filled(&Block::zero(around), &outside, cells, None);
        assert!(empty.samples().iter().all(|&sample| sample == 0));
    }
}
