//! Thin sheets and filaments: a body through their particles instead of single drops.
//!
//! The particles of a splash lie in sheets and filaments, which stretch until the drops around
//! single particles no longer touch. The density alone shows whether there is such a sheet, where
//! it lies, and how thick it is.
//!
//! 1. Loose. A sheet can rise from the bulk, and the density of the bulk would hide the lower end
//!    of the sheet. Therefore, clouds in the bulk have the weight 0. The density under a Gaussian
//!    that is cut off early shows whether a cell is in the bulk, because this density is lower in
//!    free sheets of one or two layers. The density of sheets is the smoothed product of clouds and
//!    weights, divided by the smoothed weights. A sheet therefore continues into the bulk, instead
//!    of having a rim there.
//! 2. Shape. Let rho be this density, smoothed by a Gaussian of width s in wide cells and
//!    interpolated by splines, and let L be the logarithm of rho. The first and second derivatives
//!    of L are the moments of the particles under that Gaussian: s^2 grad L is their mean offset,
//!    and s^2 (I + s^2 Hess L) their covariance. Let g = s grad L and B = -s^2 Hess L. The
//!    eigenvalues of B are 1 in directions across a sheet or a filament, because the particles have
//!    no width there. They are 0 in directions along the sheet or the filament, because the density
//!    does not change there. s is the width of the Gaussian before it is cut off, because the cut
//!    changes only its tails.
//! 3. Distance. The middle of the sheet lies at the offset s (2 B - B^2) g from the cell. Along the
//!    sheet this offset is 0, and across it, it is the mean offset. At a rim, the eigenvalues of B
//!    are in between, so the distance to the middle grows smoothly there.
//! 4. Thickness. At the middle, the density is rho e^E with E = 2 g.g - 3/2 g.Bg. Across a sheet, E
//!    is g.g / 2; beyond a rim, E compensates for the missing particles. T = tr B is the number of
//!    directions across: 1 for a sheet, 2 for a filament, 3 for a ball. T and the density at the
//!    middle give the half thickness or radius R at which such a body has the volume of its
//!    particles. R has a minimum, which depends on the mesh's cells: `LEAST_CELLS`, or
//!    `LEAST_RIM_CELLS` in filaments and at rims, which would fray otherwise. R approaches the
//!    minimum gradually: with a = log2 R^2, b = log2 of the squared minimum and w = `GRADUAL`
//!    divided by the mesh's cell, the result is max(a, b) + max(w - |a - b|, 0)^2 / 4w. The volume
//!    of a stretching sheet then changes slowly.
//! 5. Certainty. There is a sheet under three conditions: neighbours are no farther apart than
//!    requested, according to the density at the middle; the middle is near; and B is nearly a
//!    projection. The squared distance |B - B^2|^2 is at most 0.06 in sheets, in filaments and at
//!    their rims, and often twice as large in spray. At the corners of a sheet, this distance is as
//!    large as in spray, and the middle seems far away. But at corners, det(I - B), the product of
//!    the particles' variances, shows that the particles lie in a plane, so the limits for the
//!    distance from a projection and for the middle are wider there. A thick body (T < 0.4), its
//!    surface (det(I - B) > 0.35) and a drop of a few particles (T > 2.6) are not sheets.
//! 6. Blended. The certainty is averaged under a Gaussian of 0.55 spacings, so that no isolated
//!    single cells remain at rims and in spray. The average is the weight with which the shares of
//!    the sheet replace the shares of drops (see [`distance`](super::distance)). Across the sheet,
//!    its shares have a Gaussian profile of the width `PROFILE` or, in coarse cells,
//!    `PROFILE_CELLS`. At the distance R from the middle, they have the value of the shares on a
//!    drop's surface. In the middle of a body, shares may be above 1, up to 2; if they were
//!    limited to 1, interpolation by splines would lower them at the surface.
//! 7. Joined. A sheet replaces the bulk's surface earlier than drops do, by `STANDS_OUT_EARLIER`
//!    times its certainty, because the surface of the bulk vanishes from a sheet before the sheet's
//!    particles stand out.
//!
//! Derivatives are differences of logarithms over about a spacing, which are exact for Gaussians.
//! All arithmetic uses integers. Numbers have 12 fraction bits unless stated otherwise, and
//! logarithms are binary. Signed numbers are divided towards 0, so that a mirrored frame has a
//! mirrored surface.

mod cpu;
mod logarithm;
pub mod vulkan;

pub use cpu::{blend, holds_any, loose, sheets};
pub use logarithm::{EXP2, LOG2};

use std::f64::consts::{LN_2, LOG2_E, PI, TAU};

use libm::log2;

use crate::field::blur::Weights;
use crate::field::distance::{BULK_GAIN, LEAST_VARIANCE, Ramp, SPLINE, gaussian};
use crate::field::indicator::WideCells;
use crate::grid::units::SheetStretch;

/// Number of fraction bits of fixed-point numbers.
pub const BITS: u32 = 12;
/// The binary logarithm of e.
pub const LOG2_OF_E: i32 = 5909;
/// The number 1 in fixed point.
pub const ONE: i32 = 1 << BITS;

/// The width of the Gaussian that reveals the shape of the surroundings, in spacings.
const WIDTH: f64 = 1.5;
/// The cut-off of the Gaussian that reveals the shape, in standard deviations.
const CUT: f64 = 2.6;
/// The standard deviation, in spacings, of the Gaussian that averages certainty. The narrowest
/// filter has the weights 1:2:1.
const AVERAGE: f64 = 0.55;
/// The width of a sheet's profile, in spacings.
const PROFILE: f64 = 0.45;
/// The minimum width of a sheet's profile, in cells of the sheet.
const PROFILE_CELLS: f64 = 0.9;
/// The minimum half thickness of sheets, in cells of the mesh.
const LEAST_CELLS: f64 = 0.66;
/// The minimum half thickness of rims and filaments, in cells of the mesh.
const LEAST_RIM_CELLS: f64 = 0.85;
/// The length, in spacings, that is added to both minimum half thicknesses.
const LEAST_HALF_THICKNESS_OFFSET: f64 = 0.05;
/// The upper limit, in spacings, of each minimum half thickness, including
/// [`LEAST_HALF_THICKNESS_OFFSET`]. It matters only in coarse cells.
const LEAST_HALF_THICKNESS_LIMIT: f64 = 1.0;
/// A thickness is increased if its log2 R^2 differs from that of the minimum by less than this
/// number divided by the mesh's cell in spacings.
const GRADUAL: f64 = 0.55;
/// The maximum of the quotient of [`GRADUAL`] and the mesh's cell in spacings. It applies in fine
/// cells.
const MOST_GRADUAL: f64 = 4.0;
/// Sheets have faded out completely where their stretch is this factor times the requested maximum.
const FADED_OUT_STRETCH: f64 = 1.12;
/// The factor by which filaments may be stretched farther than sheets, because spray seldom looks
/// like filaments.
const FILAMENTS_FARTHER: f64 = 1.08;
/// The width of the Gaussian that shows the bulk, in spacings.
pub(in crate::field) const BULK_WIDTH: f64 = 1.45;
/// The cut-off of the Gaussian that shows the bulk, in standard deviations. The cut keeps the reach
/// of sheets short, and hardly matters for the density of the bulk.
pub(in crate::field) const BULK_CUT: f64 = 1.5;
/// The range of the density under the Gaussian that shows the bulk, in 32768ths of the plateau.
/// Over this range, the weight of clouds falls to 0.
pub const IN_BULK: Ramp = Ramp::in_plateaus([0.34, 0.4]);
/// Number of fraction bits of the weights by which a density is divided.
pub const WEIGHT_BITS: u32 = 15;
/// The minimum of the weights by which a density is divided, in 4096ths. Smaller weights are raised
/// to this value before they are smoothed.
pub const LEAST_WEIGHT: u32 = 128;
/// The range of the squared distance of B from a projection in which drops replace sheets.
pub const IMPURE: Ramp = ramp([0.06, 0.09]);
/// The factor that converts the squared distance of B from a projection to the degree to which a
/// cell is part of a rim. The degree is 1 if the squared distance is at least 1 / 16.
pub const BY_RIM: i32 = 16;
/// The range of det(I - B) in which `IMPURE_IF_FLAT` and `BEYOND_IF_FLAT` fade out, because the
/// particles no longer lie in a plane.
pub const FLAT: Ramp = ramp([0.005, 0.03]);
/// The range of det(I - B) in which sheets fade out at the surface of a thick body.
pub const THICK: Ramp = ramp([0.2, 0.35]);
/// The increase of both limits of [`IMPURE`] where particles lie in a plane.
pub const IMPURE_IF_FLAT: i32 = fixed(0.08);
/// The increase of both limits of [`BEYOND`] where particles lie in a plane.
pub const BEYOND_IF_FLAT: i32 = fixed(0.45);
/// The value of T, the number of directions across, at which sheets begin to fade in.
const LEAST_ACROSS: f64 = 0.4;
/// The range of T in which sheets fade in.
pub const THIN: Ramp = ramp([LEAST_ACROSS, 0.7]);
/// The range of T in which sheets fade out again, because the body is round.
pub const ROUND: Ramp = ramp([2.3, 2.6]);
/// Sheets fade out over this range of the difference between the density's natural logarithms at
/// the middle and at the cell, because the middle is then too far away.
pub const BEYOND: Ramp = ramp([0.6, 0.75]);
/// The distance, in spacings, by which sheets stand out earlier than drops.
pub(in crate::field) const STANDS_OUT_EARLIER: f64 = 0.35;
/// The maximum difference between the density's natural logarithms at the middle and at the cell.
const MAX_LOG_INCREASE: f64 = 0.7;

/// The parameters for computing sheets. The density is computed on wide cells and interpolated on
/// the narrower cells of drops.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sheets {
    /// The filter that shows the bulk, in wide cells, with the gain of the bulk's own filters.
    pub bulk: Weights,
    /// The filter that smooths the density in wide cells.
    pub around: Weights,
    /// The filter that smooths the weights of clouds: `around` without its gain.
    pub around_weights: Weights,
    /// The minimum sum of samples in the surroundings of a sheet.
    pub least: u32,
    /// The filter that averages the certainty.
    pub average: Weights,
    /// The constants of the formulas.
    pub numbers: SheetConstants,
}

/// Clouds, reduced in the bulk.
#[derive(Debug, Clone)]
pub struct Loose<F> {
    /// The products of clouds and weights.
    pub clouds: F,
    /// The weights, in 32768ths, and at least [`LEAST_WEIGHT`] / 4096; `None` if all are 1.
    pub weights: Option<F>,
}

/// The sheets in some cells.
#[derive(Debug, Clone)]
pub struct SheetFields<F> {
    /// Shares of sheets, in 32768ths, comparable with the shares of drops. The shares are valid
    /// near cells of nonzero certainty, within the reach of the averaging filter.
    pub shares: F,
    /// The certainty of the sheets, in 4096ths.
    pub certainty: F,
}

/// The constants of the formulas, for a cell size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SheetConstants {
    /// The distance from a cell to the samples from which its differences are computed, in cells.
    pub step: i32,
    /// The factor that converts differences of logarithms to g.
    pub slope: i32,
    /// The factor that converts second differences of logarithms to B.
    pub bend: i32,
    /// The minimum logarithm of a sample that can belong to a sheet.
    pub least: i32,
    /// The maximum sum of the second differences along the axes in thick fluid.
    pub least_across: i32,
    /// The logarithm of the plateau's sample.
    pub plateau: i32,
    /// The maximum increase of the density's natural logarithm from a cell to the middle.
    pub most_more: i32,
    /// Three values of log2 R^2 minus a multiple of the density's logarithm. The multiple is 2 for
    /// sheets, 1 for filaments and 2/3 for drops.
    pub sizes: [i32; 3],
    /// The logarithm of the minimum R^2.
    pub least_size: i32,
    /// The increase of `least_size` at rims and in filaments.
    pub rim: i32,
    /// The difference between log2 R^2 and its minimum within which the thickness approaches the
    /// minimum.
    pub gradual: i32,
    /// 1 / (4 `gradual`).
    pub by_gradual: i32,
    /// The logarithm of the stretch, plus half of the density's logarithm for sheets, or plus the
    /// whole logarithm for filaments.
    pub stretches: [i32; 2],
    /// The constant term of the logarithm of a share: log2 share = `share` + `by_directions` T +
    /// `by_size` R^2 - `by_distance` a^2, where a is the distance from the middle in units of s
    /// (for T, R and s, see the top of this file).
    pub share: i32,
    /// The factor of T in the logarithm of a share.
    pub by_directions: i32,
    /// The factor of R^2 in the logarithm of a share.
    pub by_size: i32,
    /// The factor of a^2 in the logarithm of a share.
    pub by_distance: i32,
    /// The range of the stretch's logarithm in which sheets fade out: from the requested maximum to
    /// `FADED_OUT_STRETCH` times this maximum.
    pub torn: Ramp,
}

/// Converts a number to fixed point.
const fn fixed(value: f64) -> i32 {
    (value * ONE as f64).round() as i32
}

const fn ramp([begin, end]: [f64; 2]) -> Ramp {
    Ramp::new(fixed(begin) as u16, fixed(end - begin) as u16)
}

/// Properties of the drops that sheets depend on. Drops and sheets are computed on the same cells.
#[derive(Debug, Clone, Copy)]
pub struct DropShape {
    /// The radius of the drop of a single particle, in spacings.
    pub radius: f64,
    /// The standard deviation of a drop, in spacings.
    pub width: f64,
    /// The variance, in squared cells, that interpolation by splines adds to shares before they are
    /// joined with the bulk.
    pub spline: f64,
}

impl Sheets {
    /// Makes the parameters of sheets that are stretched up to `stretch`. The mesh has cells of
    /// `mesh_cell` spacings. Sheets are computed on cells of `cell` spacings, from a density that
    /// is interpolated from `wide` cells. Returns `None` if `stretch` turns sheets off.
    pub fn new(
        stretch: SheetStretch,
        [mesh_cell, cell]: [f64; 2],
        wide: WideCells,
        drops: DropShape,
    ) -> Option<Self> {
        let stretch = stretch.spacings()?;
        let spline = if wide.level > 0 { SPLINE } else { 0.0 };
        let (weights, _) =
            gaussian(((WIDTH / wide.edge).powi(2) - spline).sqrt(), LEAST_VARIANCE, CUT);
        // Near a sheet, the cut does not change the shape of the density, only its height.
        let (variance, higher) = weights.before_cut();
        let width = (variance + 0.25 + spline).sqrt() * wide.edge;
        let peak = higher / (TAU.sqrt() * width);
        let plateau = wide.plateau();
        // A plateau three times as high must still fit into a sample.
        let gain = (0..12)
            .take_while(|&bits| 3.0 * plateau * f64::from(2 << bits) <= 65536.0)
            .count() as u32;
        let plateau = plateau * f64::from(1_u32 << gain);
        let step = if cell < 0.55 - 1e-9 { 2 } else { 1 };
        let apart = width / (f64::from(step) * cell);
        let of_sheet = |thickness: f64| thickness * peak;
        let of_filament = |area: f64| area * peak.powi(2);
        let of_drop = |volume: f64| volume * peak.powi(3);
        let profile = PROFILE.max(PROFILE_CELLS * cell);
        let profile_joined = profile * profile + drops.spline * cell * cell;
        let level = -(drops.radius / drops.width).powi(2) / 2.0;
        let [least_size, least_rim] = [LEAST_CELLS, LEAST_RIM_CELLS].map(|cells| {
            2.0 * log2(
                (cells * mesh_cell + LEAST_HALF_THICKNESS_OFFSET).min(LEAST_HALF_THICKNESS_LIMIT),
            )
        });
        let gradual = (GRADUAL / mesh_cell).min(MOST_GRADUAL);
        let average = (AVERAGE / cell).powi(2).max(0.5);
        let stretches =
            [0.5 * log2(of_sheet(1.0)), log2(of_filament(1.0)) - log2(FILAMENTS_FARTHER)];
        let gone = log2(stretch * FADED_OUT_STRETCH);
        // The stretch of a sheet depends on half of the density's logarithm, the stretch of a
        // filament on all of it. In between, the dependence is interpolated.
        let least_density = (2.0 * (stretches[0] - gone)).min(stretches[1] - gone);
        let numbers = SheetConstants {
            step,
            least: fixed(log2(plateau) + least_density - MAX_LOG_INCREASE * LOG2_E - 0.02),
            slope: fixed(LN_2 * apart / 2.0),
            bend: fixed(LN_2 * apart * apart),
            // The 4 allows for the rounding errors of the axes.
            least_across: (LEAST_ACROSS * f64::from(ONE) / (LN_2 * apart * apart)) as i32 - 4,
            plateau: fixed(log2(plateau)),
            most_more: fixed(MAX_LOG_INCREASE),
            sizes: [
                fixed(2.0 * log2(0.5 / of_sheet(1.0))),
                fixed(log2(1.0 / (PI * of_filament(1.0)))),
                fixed(2.0 / 3.0 * log2(0.75 / (PI * of_drop(1.0)))),
            ],
            least_size: fixed(least_size),
            rim: fixed(least_rim - least_size),
            gradual: fixed(gradual),
            by_gradual: fixed(0.25 / gradual),
            stretches: stretches.map(fixed),
            share: fixed(level * LOG2_E),
            by_directions: fixed(0.5 * log2(profile_joined / (profile * profile))),
            by_size: fixed(LOG2_E / (2.0 * profile_joined)),
            by_distance: fixed(LOG2_E / 2.0 * (width / profile).powi(2)),
            torn: ramp([log2(stretch), gone]),
        };
        let (bulk, _) = gaussian(BULK_WIDTH / wide.edge, LEAST_VARIANCE, BULK_CUT);
        Some(Self {
            bulk: bulk.gaining(BULK_GAIN),
            around: weights.clone().gaining(gain),
            around_weights: weights,
            least: 3 * u32::from(wide.amount().steps()) / 2,
            average: Weights::of_variance(average, (2.0 * average.sqrt()).round() as i32),
            numbers,
        })
    }

    /// Halves the densities in the parameters, for clouds to which each particle adds half the
    /// usual amount.
    #[must_use]
    pub fn of_half_amounts(mut self) -> Self {
        self.least /= 2;
        self.numbers.least -= ONE;
        self.numbers.plateau -= ONE;
        self
    }

    /// The minimum sample of a density that can belong to a sheet, within the error of its
    /// logarithm.
    pub fn least_density(&self) -> u16 {
        libm::exp2(f64::from(self.numbers.least - 2) / f64::from(ONE)) as u16
    }

    /// The distance, in the cells of sheets, within which the smoothed density affects a sheet.
    pub fn halo(&self) -> i32 {
        self.numbers.step + self.average.reach()
    }
}
