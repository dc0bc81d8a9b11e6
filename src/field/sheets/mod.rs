//! Sheets and threads: thin fluid as the films and strings that its particles lie in.
//!
//! Particles of a splash lie in sheets and threads that stretch until drops around single particles
//! no longer touch. Their density alone tells where such a sheet runs, how thick it is, and whether
//! there is one.
//!
//! 1. Shape. Smoothed by a Gaussian of width s, the density rho has a logarithm L whose first and
//!    second derivatives are the moments of the particles under that Gaussian: s^2 grad L is their
//!    mean offset, and s^2 (I + s^2 Hess L) their covariance. With g = s grad L and B = -s^2 Hess L
//!    an eigenvalue of B is 1 across a sheet or a thread, where the particles have no width, and 0
//!    along it, where they look the same all the way.
//! 2. Distance. The middle of the sheet lies at s (2 B - B^2) g: along it this is 0, across it the
//!    mean offset. At a rim B is between, and so the distance to the middle grows smoothly there.
//! 3. Thickness. At the middle the density is rho e^E, E = 2 g.g - 3/2 g.Bg, which is g.g / 2
//!    across a sheet and makes up for what is missing beyond a rim. With T = tr B, the number of
//!    directions across, that is what a sheet (1), a thread (2) or a ball (3) of the particles'
//!    volume has under the Gaussian: its half thickness or radius R follows. Cells carry no less
//!    than `LEAST_CELLS`.
//! 4. Certainty. There is a sheet where neighbours are not stretched apart farther than is asked
//!    for, which the density at the middle tells, and where B is nearly a projection: the square of
//!    its distance from one, |B - B^2|^2, is at most 0.06 in sheets, threads and at their rims, and
//!    twice that in spray. Neither a thick body (T < 0.4) nor a drop of a few particles (T > 2.45)
//!    is one.
//! 5. Blended. The certainty is averaged under a Gaussian of 0.36 spacings, so that no crumbs of
//!    single cells remain at rims and in spray. By it shares of drops (see
//!    [`distance`](super::distance)) are blended with those of the sheet, which are as wide as cells
//!    can carry and cross the level of a drop's surface at R.
//!
//! Derivatives are differences of logarithms over about a spacing, which are exact for Gaussians.
//! All of it is integer arithmetic: numbers have 12 fraction bits unless something else is said,
//! and logarithms are to base 2. What can be negative is divided towards 0, so that a mirrored
//! frame has a mirrored surface.

mod cpu;
mod logarithm;
pub mod vulkan;

pub use cpu::{blend, holds_any, sheets};
pub use logarithm::{EXP2, LOG2};

use std::f64::consts::{LN_2, LOG2_E, PI, TAU};

use crate::field::blur::Weights;
use crate::field::distance::{LEAST_VARIANCE, Ramp, gaussian};
use crate::grid::units::SheetStretch;

/// Fraction bits.
pub const BITS: u32 = 12;
/// The logarithm of e.
pub const LOG2_OF_E: i32 = 5909;
/// 1.
pub const ONE: i32 = 1 << BITS;

/// The width under which the shape of the surroundings shows, in spacings.
const WIDTH: f64 = 1.5;
/// Where its Gaussian is cut off, in standard deviations.
const CUT: f64 = 2.6;
/// The standard deviation over which certainty is averaged, in spacings, and 1:2:1 at the least.
const AVERAGE: f64 = 0.36;
/// The width of a sheet's profile, in spacings, and at least so many of the cells that it is made
/// in.
const PROFILE: f64 = 0.45;
const PROFILE_CELLS: f64 = 0.9;
/// The least half thickness: so many cells of the mesh and so many spacings, and no more than so
/// many spacings however coarse cells are.
const LEAST_CELLS: f64 = 0.9;
const LEAST_MORE: f64 = 0.05;
const LEAST_MOST: f64 = 1.0;
/// A sheet that is stretched this much farther than is asked for is none.
const GONE: f64 = 1.12;
/// Threads hold when they are stretched so much farther than sheets: spray seldom looks like them.
const THREADS_FARTHER: f64 = 1.1;
/// From which to which square of B's distance from a projection a sheet gives way to drops.
const IMPURE: [f64; 2] = [0.06, 0.09];
/// From which to which number of directions across there are sheets, and from which to which no
/// more.
const THICK: [f64; 2] = [0.4, 0.7];
const ROUND: [f64; 2] = [2.2, 2.45];
/// From which to which it is so much more that the middle is not near.
const BEYOND: [f64; 2] = [0.6, 0.75];
/// The most that the density at the middle is more than it is here, as a logarithm to base e.
const MOST_MORE: f64 = 0.7;

/// How thin fluid is made of the density in the cells of drops.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sheets {
    /// Smooths the density.
    pub around: Weights,
    /// Fewer samples in total, in its whole surroundings, are no sheet.
    pub least: u32,
    /// Averages the certainty.
    pub average: Weights,
    /// The numbers of the formulas.
    pub numbers: SheetConstants,
}

/// Sheets in some cells.
#[derive(Debug, Clone)]
pub struct SheetFields<F> {
    /// Shares as those of drops, in 32768ths; 0 where there is no sheet.
    pub shares: F,
    /// How certain the sheets are, in 4096ths.
    pub certainty: F,
}

/// The numbers of the formulas, for cells of a size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SheetConstants {
    /// How many cells apart samples are whose differences are taken.
    pub step: i32,
    /// From differences of logarithms to g.
    pub slope: i32,
    /// From second differences of logarithms to B.
    pub bend: i32,
    /// The least logarithm of a sample that can belong to a sheet.
    pub least: i32,
    /// The most that second differences along the axes sum to in thick fluid.
    pub least_across: i32,
    /// The logarithm of a plateau's sample.
    pub plateau: i32,
    /// The most that the logarithm at the middle is greater.
    pub most_more: i32,
    /// log2 R^2 less 2, 1 and 2/3 of the density's logarithm: in sheets, threads and drops.
    pub sizes: [i32; 3],
    /// The logarithm of the least R^2.
    pub least_size: i32,
    /// The logarithm of the stretch, and half of the density's or all of it: in sheets and threads.
    pub stretches: [i32; 2],
    /// The logarithm of a share at R = 0, by its T, R^2 and squared distance from the middle.
    pub share: i32,
    /// By T.
    pub by_directions: i32,
    /// By R^2.
    pub by_size: i32,
    /// By the squared distance, in s.
    pub by_distance: i32,
    /// By the stretch's logarithm.
    pub torn: Ramp,
    /// By the squared distance from a projection.
    pub impure: Ramp,
    /// By T.
    pub thin: Ramp,
    /// By T.
    pub round: Ramp,
    /// By how much more the density's logarithm is at the middle.
    pub beyond: Ramp,
}

/// A number with the fraction bits of all.
fn fixed(value: f64) -> i32 {
    (value * f64::from(ONE)).round() as i32
}

fn ramp([begin, end]: [f64; 2]) -> Ramp {
    Ramp::new(fixed(begin).max(0) as u16, fixed(end - begin).max(1) as u16)
}

/// Drops as they are made in the same cells, as far as sheets have to know them.
#[derive(Debug, Clone, Copy)]
pub struct DropShape {
    /// The radius of a particle alone, in spacings.
    pub radius: f64,
    /// The standard deviation of a drop, in spacings.
    pub width: f64,
    /// The variance that shares gain until they are joined, in squared cells.
    pub spline: f64,
}

impl Sheets {
    /// For particles stretched apart to `stretch`, in cells of `cell` spacings that hold `amount`
    /// of a particle, for a mesh of `mesh_cell` spacings.
    pub fn new(
        stretch: SheetStretch,
        cell: f64,
        mesh_cell: f64,
        amount: u16,
        drops: DropShape,
    ) -> Option<Self> {
        let stretch = stretch.spacings()?;
        let (weights, width) = gaussian(WIDTH / cell, LEAST_VARIANCE, CUT);
        let width = width * cell;
        let plateau = f64::from(amount) * cell.powi(3);
        // A plateau three times as high still fits into a sample.
        let gain = (0..12)
            .take_while(|&bits| 3.0 * plateau * f64::from(2 << bits) <= 65536.0)
            .count() as u32;
        let plateau = plateau * f64::from(1_u32 << gain);
        let step = if cell < 0.55 - 1e-9 { 2 } else { 1 };
        let apart = width / (f64::from(step) * cell);
        let of_sheet = |thickness: f64| thickness / (TAU.sqrt() * width);
        let of_thread = |area: f64| area / (TAU * width * width);
        let of_drop = |volume: f64| volume / (TAU.sqrt() * width).powi(3);
        let profile = PROFILE.max(PROFILE_CELLS * cell);
        let profile_joined = profile * profile + drops.spline * cell * cell;
        let level = -(drops.radius / drops.width).powi(2) / 2.0;
        let least_size = (LEAST_CELLS * mesh_cell + LEAST_MORE).min(LEAST_MOST);
        let average = (AVERAGE / cell).powi(2).max(0.5);
        let stretches =
            [0.5 * of_sheet(1.0).log2(), of_thread(1.0).log2() - THREADS_FARTHER.log2()];
        let gone = (stretch * GONE).log2();
        // Of a sheet half of the density's logarithm, of a thread all of it, and between in between.
        let least_density = (2.0 * (stretches[0] - gone)).min(stretches[1] - gone);
        let numbers = SheetConstants {
            step,
            least: fixed(plateau.log2() + least_density - MOST_MORE * LOG2_E - 0.02),
            slope: fixed(LN_2 * apart / 2.0),
            bend: fixed(LN_2 * apart * apart),
            // Less by what rounding each axis takes.
            least_across: (THICK[0] * f64::from(ONE) / (LN_2 * apart * apart)) as i32 - 4,
            plateau: fixed(plateau.log2()),
            most_more: fixed(MOST_MORE),
            sizes: [
                fixed(2.0 * (0.5 / of_sheet(1.0)).log2()),
                fixed((1.0 / (PI * of_thread(1.0))).log2()),
                fixed(2.0 / 3.0 * (0.75 / (PI * of_drop(1.0))).log2()),
            ],
            least_size: fixed(2.0 * least_size.log2()),
            stretches: stretches.map(fixed),
            share: fixed(level * LOG2_E),
            by_directions: fixed(0.5 * (profile_joined / (profile * profile)).log2()),
            by_size: fixed(LOG2_E / (2.0 * profile_joined)),
            by_distance: fixed(LOG2_E / 2.0 * (width / profile).powi(2)),
            torn: ramp([stretch.log2(), gone]),
            impure: ramp(IMPURE),
            thin: ramp(THICK),
            round: ramp(ROUND),
            beyond: ramp(BEYOND),
        };
        Some(Self {
            around: weights.gaining(gain),
            least: 3 * u32::from(amount) / 2,
            average: Weights::of_variance(average, (2.0 * average.sqrt()).round() as i32),
            numbers,
        })
    }

    /// For densities of half the usual amounts.
    #[must_use]
    pub fn of_half_amounts(mut self) -> Self {
        self.least /= 2;
        self.numbers.least -= ONE;
        self.numbers.plateau -= ONE;
        self
    }

    /// How far beyond the cells that it is made in those decide a sheet.
    pub fn halo(&self) -> i32 {
        self.around.reach() + self.numbers.step + self.average.reach()
    }
}
