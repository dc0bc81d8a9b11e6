//! Solids: clouds are continued into solids before the surface of the bulk is computed, and solids
//! cut the field afterwards.
//!
//! Let rho be a cell's density, and w the share of the cell's cloud that lies outside the solid. w
//! is computed as if the solid were bounded by a plane at the solid's distance from the cell's
//! centre. Where w is less than 1, the density of the nearby fluid is blended in, with a weight
//! that grows from 0 to 1 as w falls from 1 to 0.9. The density that is blended in is the value, at
//! the cell, of the linear function that best fits rho / w under a Gaussian of 1 d (moving least
//! squares, Lancaster and Salkauskas 1981). Over the same range of w, the weights of the fit fall
//! from 1 to 0. At a sloping solid, a mean would bend the level surface of the fluid, and a fit to
//! cells that are mostly solid would bend it as well. Where too little fluid is within reach of the
//! fit, for example deep in a solid or in a narrow channel, (1 - w) times the mean of rho under a
//! Gaussian of 2.5 d is added to rho (normalised convolution). Therefore, the bulk does not end at
//! a solid. Its surface continues straight into the solid. Afterwards, the field is limited to the
//! distance from the solid minus the solid's offset.
//!
//! Only thick fluid is continued. If a thin film on a solid were continued, it would look like the
//! surface of a half space, and the level of this surface would change with the film's density.
//! Without a continuation, the film is a sheet (see [`sheets`](super::sheets)), and stays whole
//! when it stretches. Fluid is thick if the density under a Gaussian of 1.45 d exceeds 0.4 to 0.55
//! of the plateau anywhere within 2 d, or if the mean under the Gaussian of 2.5 d exceeds 0.65 to
//! 0.85 of the plateau.
//!
//! Each cell has its own sums, whose terms are always added in the same order, so the result does
//! not depend on the block in which it is computed.

mod fit;

use glam::IVec3;

use crate::brick::Block;
use crate::field::blur::{Weights, blur};
use crate::field::distance::{NONE, Ramp, ZERO, spread};
use crate::field::sheets::{BULK_CUT, BULK_WIDTH};
use crate::grid::{CellBox, Mirror};

use fit::LinearFit;

/// A cell's density is used only if more than this share of its cloud lies outside the solid.
const USABLE: u16 = WHOLE / 10 * 9;
/// The standard deviation of the Gaussian for the linear fit, in spacings.
const FIT: f64 = 1.0;
/// The cut-off of the Gaussian for the linear fit, in standard deviations.
const FIT_CUT: f64 = 2.5;
/// The standard deviation of the Gaussian for means, in spacings.
const MEAN: f64 = 2.5;
/// The cut-off of the Gaussian for means, in standard deviations.
const MEAN_CUT: f64 = 2.2;
/// The gain, in bits, of the smoothed density. It equals the bulk's gain.
const GAIN: u32 = 2;
/// The share of a cell whose cloud lies completely outside the solid.
pub const WHOLE: u16 = 1 << 15;
/// The distance, in spacings, within which the maximum density shows whether the fluid around a
/// cell is thick.
const THICK_NEAR: f64 = 2.0;
/// The range of the density under a Gaussian of [`BULK_WIDTH`] in which fluid begins to count as
/// thick.
const IS_THICK: Ramp = Ramp::in_plateaus([0.4, 0.55]);
/// The range of the mean density under the Gaussian of [`MEAN`] in which fluid begins to count as
/// thick, even around cells that are deep in a solid.
const IS_THICK_IN_MEAN: Ramp = Ramp::in_plateaus([0.65, 0.85]);
/// The minimum share of a mean's Gaussian that lies outside the solid. If less lies outside, the
/// mean is 0.
const MEAN_LEAST: u16 = WHOLE >> 7;
/// Number of fixed-point steps per cell edge of the distances from which shares are computed.
pub const STEPS: f64 = 4096.0;
/// The reach of a cell's cloud from the cell's centre, in units of 1 / [`STEPS`] of an edge.
pub const FARTHEST: i16 = 3 * 2048;

/// The filters that continue clouds into solids.
#[derive(Debug, Clone, PartialEq)]
pub struct SolidFill {
    fit: Weights,
    mean: Weights,
    thick: Weights,
    /// `THICK_NEAR`, in cells.
    near: i32,
}

impl SolidFill {
    /// Makes the filters for cells of `edge` spacings.
    #[must_use]
    pub fn new(edge: f64) -> Self {
        let gaussian = |width: f64, cut: f64| {
            let variance = (width / edge).powi(2).max(0.35);
            Weights::of_variance(variance, (cut * variance.sqrt()).round().max(1.0) as i32)
        };
        Self {
            fit: gaussian(FIT, FIT_CUT),
            mean: gaussian(MEAN, MEAN_CUT).gaining(GAIN),
            thick: gaussian(BULK_WIDTH, BULK_CUT).gaining(GAIN),
            near: (THICK_NEAR / edge).round().max(1.0) as i32,
        }
    }

    /// The distance, in cells, within which other cells affect a cell's density.
    #[must_use]
    pub fn reach(&self) -> i32 {
        self.fit.reach().max(self.mean.reach()).max(self.thick.reach() + self.near)
    }

    /// Memory, in bytes, that is needed to continue clouds into solids on `cells`, which include
    /// the halo.
    #[must_use]
    pub fn bytes(&self, cells: CellBox) -> u64 {
        // The blocks that exist at once: clouds, two blocks of distances, shares, the usable cells,
        // their density and a copy of it for its maximum, the density that shows thick fluid, two
        // means with a buffer each for smoothing, and the result.
        let blocks = 14 * cells.volume() * size_of::<u16>();
        let size = cells.size().max(IVec3::ZERO).as_uvec3();
        (blocks + LinearFit::bytes(&self.fit, (size.x * size.y) as usize)) as u64
    }

    /// Returns the samples of `cells`, continued into a solid. `scale` converts smoothed clouds to
    /// fractions of the plateau, as in [`Bulk`](super::distance::Bulk). `outside` holds the share
    /// of each cell's cloud that lies outside the solid.
    ///
    /// # Panics
    /// If `clouds` or `outside` does not cover `cells` with a halo of [reach](Self::reach).
    #[must_use]
    pub fn filled(
        &self,
        (clouds, scale): (&Block, u32),
        outside: &Block,
        cells: CellBox,
        mirror: Option<Mirror>,
    ) -> Block {
        let mut filled = clouds.part(cells);
        let part = outside.part(cells).box_of(|share| share < WHOLE);
        if part.is_empty() {
            return filled;
        }
        let around = part.grown(self.mean.reach(), self.mean.reach());
        let around_fit = part.grown(self.fit.reach(), self.fit.reach());
        let (mut usable, mut dense) = (outside.part(around_fit), clouds.part(around_fit));
        for (share, cloud) in usable.samples_mut().iter_mut().zip(dense.samples_mut()) {
            *cloud = (u32::from(*cloud) * u32::from(WHOLE) / u32::from((*share).max(USABLE)))
                .min(u16::MAX.into()) as u16;
            let beyond = u32::from(share.saturating_sub(USABLE));
            *share = (beyond * u32::from(WHOLE) / u32::from(WHOLE - USABLE)) as u16;
        }
        let mut fit = LinearFit::new(&self.fit, &dense, &usable, part);
        let thick_reach = self.thick.reach() + self.near;
        let thick = spread(
            blur(clouds.part(part.grown(thick_reach, thick_reach)), &self.thick, None),
            self.near,
        );
        let density = blur(clouds.part(around), &self.mean, None);
        let share = blur(outside.part(around), &self.mean.clone().gaining(0), None);
        for cell in places(part) {
            let missing = WHOLE - outside.at(cell);
            if missing == 0 {
                continue;
            }
            let index = filled.index(cell);
            let own = u64::from(filled.samples()[index]);
            let fraction =
                |smooth: u64| ((smooth * u64::from(scale)) >> 14).min(u16::MAX.into()) as u16;
            let share = u64::from(share.at(cell));
            let density = u64::from(density.at(cell)) << (15 - GAIN);
            let mean = if share < u64::from(MEAN_LEAST) { 0 } else { density / share };
            let is_thick = IS_THICK.of(fraction(thick.at(cell).into()));
            let in_mean = IS_THICK_IN_MEAN.of(fraction(mean << GAIN));
            let weight = u64::from(is_thick.max(in_mean));
            if weight == 0 {
                continue;
            }
            let sample = match fit.at(cell) {
                Some(fitted) => {
                    let usable = u64::from(usable.at(cell));
                    (own * usable + fitted * (u64::from(WHOLE) - usable)) >> 15
                }
                None => own + ((mean * u64::from(missing)) >> 15),
            };
            let sample = (own * (4096 - weight) + sample.min(u16::MAX.into()) * weight) >> 12;
            filled.samples_mut()[index] = sample as u16;
        }
        filled.mirror(mirror);
        filled
    }
}

/// The cells of a box, x fastest.
fn places(cells: CellBox) -> impl Iterator<Item = IVec3> {
    let CellBox { lo, hi } = cells;
    let rows = (lo.z..hi.z).flat_map(move |z| (lo.y..hi.y).map(move |y| (y, z)));
    rows.flat_map(move |(y, z)| (lo.x..hi.x).map(move |x| IVec3::new(x, y, z)))
}

/// The share of each cell's cloud that lies outside a solid, in units of 1 / [`WHOLE`]. `distances`
/// are the distances of the cells' centres, in units of 1 / [`STEPS`] of a cell's edge.
#[must_use]
pub fn outside(distances: &Block<i16>) -> Block {
    let mut shares = Block::zero(distances.cells());
    for (share, &distance) in shares.samples_mut().iter_mut().zip(distances.samples()) {
        *share = if distance.abs() < FARTHEST {
            share_outside(distance)
        } else {
            WHOLE * u16::from(distance > 0)
        };
    }
    shares
}

/// The share of a cloud outside a plane at this distance from the cell's centre.
fn share_outside(distance: i16) -> u16 {
    // The integral of the quadratic B-spline.
    let at = f64::from(distance) / STEPS;
    let beyond = 1.5 - at.abs();
    let farther = if at.abs() < 0.5 {
        0.5 - at.abs() * (0.75 - at * at / 3.0)
    } else {
        beyond * beyond * beyond / 6.0
    };
    let outside = if at > 0.0 { 1.0 - farther } else { farther };
    // Rounds to the nearest integer.
    (outside * f64::from(WHOLE) + 0.5) as u16
}

/// Limits the distances of a field to the distances from a solid minus `offset`, all in the same
/// units. Distances from the solid of `most` or more are not exact, and are ignored.
///
/// # Panics
/// If the field and the distances are on different cells.
pub fn cut(field: &mut Block, distances: &Block<i16>, offset: i32, most: i16) {
    assert_eq!(field.cells(), distances.cells(), "the distances are on the cells of the field");
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
    use super::*;

    /// The factor for a plateau of 4096.
    const SCALE: u32 = (1 << 29) / (4096 << GAIN);

    #[test]
    fn the_share_outside_a_solid_rises_symmetrically_from_0_to_1() {
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
    fn an_even_fluid_continues_into_a_solid_and_air_stays_empty() {
        let fill = SolidFill::new(0.7);
        let cells = CellBox { lo: IVec3::splat(-4), hi: IVec3::splat(5) };
        let around = cells.grown(fill.reach(), fill.reach());
        let mut distances = Block::zero(around);
        for cell in places(around) {
            let index = distances.index(cell);
            let steps = f64::from(cell.x) * STEPS;
            distances.samples_mut()[index] =
                steps.clamp(f64::from(-FARTHEST), f64::from(FARTHEST)) as i16;
        }
        let outside = outside(&distances);
        let mut clouds = Block::zero(around);
        for (cloud, share) in clouds.samples_mut().iter_mut().zip(outside.samples()) {
            *cloud = (u32::from(*share) * 4096 / u32::from(WHOLE)) as u16;
        }
        let filled = fill.filled((&clouds, SCALE), &outside, cells, None);
        assert!(filled.samples().iter().all(|sample| sample.abs_diff(4096) < 80));
        let empty = fill.filled((&Block::zero(around), SCALE), &outside, cells, None);
        assert!(empty.samples().iter().all(|&sample| sample == 0));
    }
}
