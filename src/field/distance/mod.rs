//! Signed distances from clouds: a calm surface of the bulk, and the drops that stand out of it.
//!
//! All lengths are in particle spacings d, so that what is drawn does not depend on the cells. The
//! surface of the bulk is made in [wide cells](super::indicator::WideCells) of 0.55 to 1.1 d, or
//! the grid's own where those are wider.
//!
//! 1. Depth. A half space smoothed by a Gaussian of standard deviation s is Phi(depth / s). Of the
//!    clouds' density under s, as a share theta of the plateau, D_s = s Phi^-1(theta) is therefore
//!    a depth, held within 2.5 d.
//! 2. Extrapolated. Curvature moves D_s by as much as s^2, so a line through two widths tells that
//!    of none: E(a, b) = D_a + (D_a - D_b) a^2 / (b^2 - a^2), and beyond it by an eighth of a
//!    squared wide cell, where cells are made of wide ones by splines. Of three widths, a = 5/8 S,
//!    S and 3/2 S with S of `--smooth`, there are a fine surface E(a, S) and a calm one E(S, 3/2
//!    S).
//! 3. Mixed. Their difference is averaged by a Gaussian of 9/16 S, in which noise cancels and shape
//!    stays: from 0.07 to 0.14 d the calm surface gives way to the fine one, but not from 0.3 to
//!    0.9 d below the calm surface on, where noise has bubbles.
//! 4. Drops. Normalised convolution: N = G * (rho / (G * rho)), rho being the clouds' density and G
//!    a Gaussian of 0.6 d. A particle alone peaks at 1 in cells of any size, and is a ball of the
//!    distance r - 0.6 sqrt(2 ln 1 / N). N is made in cells half as wide as wide ones, or in the
//!    grid's own where those are no finer.
//! 5. Joined. A particle whose centre lies outside of the calm surface stands out, by O = -E in its
//!    wide cell; the greatest O within a spacing makes drops of the bulk's surface from 0.4 to 1 d.
//!    Where no particle is near, there is no surface.
//!
//! Every blur is one of [`blur`](super::blur); wide cells become cells by quadratic B-splines;
//! ramps are 3 x^2 - 2 x^3. Distances are samples of 16 bits: 32768 + 8192 d.

mod cpu;
mod filters;
mod inside;
mod inverse_normal;
pub mod vulkan;

pub use cpu::{away, depths, joined, mixed, outlying, outlying_part, quotient, refined, spread};
pub use filters::{BULK_GAIN, DistanceFilters};
pub(in crate::field) use filters::{LEAST_VARIANCE, gaussian};
pub use inside::{BRICK, InsideBricks};
pub use inverse_normal::{AWAY, DEPTHS};

use crate::field::blur::Weights;
use crate::grid::CellBox;

/// Units of distance in a spacing.
pub const UNITS: f64 = 8192.0;
/// The sample of a distance of 0, less which is outside of the fluid.
pub const ZERO: i32 = 1 << 15;
/// The sample where no particle is near.
pub const NONE: u16 = 0;
/// The greatest distance that a width tells, in units: deep in the fluid noise under one width
/// would else be taken for shape, and far outside of it what is left of few particles.
pub const FARTHEST: i32 = 5 << 12;
/// The most that two surfaces of the bulk count as apart, in units.
pub const MOST_APART: i32 = UNITS as i32;

/// The wide cells, each 2^`level` cells along an axis, that decide a field of such at the middles
/// of `cells`.
pub fn wide_cells(level: u32, cells: CellBox) -> CellBox {
    if level == 0 {
        return cells;
    }
    CellBox { lo: (cells.lo >> level) - 1, hi: ((cells.hi - 1) >> level) + 2 }
}

/// Bits of what [`spline`] weights sum to.
pub fn spline_bits(level: u32) -> u32 {
    2 * level + 3
}

/// The quadratic B-spline at the middle of cell number `place` of the 2^`level` along a wide one:
/// the weights of the wide cell below, of its own, and of the one above, in 2^[`spline_bits`].
pub fn spline(level: u32, place: u32) -> [u32; 3] {
    let (edge, at) = (2 << level, 2 * place + 1);
    let [below, above] = [edge - at, at].map(|length: u32| length * length);
    [below, 2 * edge * edge - below - above, above]
}

/// A width under which clouds are smoothed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Width {
    /// The filter, in wide cells.
    pub weights: Weights,
    /// The standard deviation of what it makes of a particle, in 4096ths of a spacing.
    pub spacings: i32,
    /// The standard deviations of the greatest distance that it tells, in 32768ths.
    pub most: i32,
}

/// The surface of the bulk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bulk {
    /// Narrowest first.
    pub widths: [Width; 3],
    /// How far beyond the narrower of two widths that of 0 is, in 4096ths of what both differ by:
    /// of the first two, and of the last two.
    pub shares: [i32; 2],
    /// The factor from samples to shares of the plateau, in 16384ths of 32768ths.
    pub scale: u32,
    /// Averages by how much the two surfaces are apart.
    pub around: Weights,
    /// From where to where that makes the fine surface of the calm one, in units.
    pub apart: Ramp,
    /// From which sample of the calm surface to which it stays what it is.
    pub deep: Ramp,
}

/// Where one thing gives way to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ramp {
    /// Where the other begins.
    pub begin: u16,
    /// After how much more there is nothing but the other.
    pub range: u16,
    /// 2^28 over that range, rounded up: what is beyond the beginning is taken by this, which is no
    /// division.
    pub slope: u32,
}

impl Ramp {
    /// From `begin` on, and after `range` more there is nothing but the other.
    pub fn new(begin: u16, range: u16) -> Self {
        Self { begin, range, slope: (1_u32 << 28).div_ceil(range.into()) }
    }

    /// The other's share, 0 to 4096, as 3 x^2 - 2 x^3 rises from 0 to 1.
    #[inline(always)]
    pub fn of(self, value: u16) -> u32 {
        let x = (u32::from(value.saturating_sub(self.begin).min(self.range)) * self.slope) >> 16;
        (((x * x) >> 8) * (3 * 4096 - 2 * x)) >> 16
    }
}

/// Two surfaces of the bulk, as distances, and by how much the fine one lies farther out.
#[derive(Debug, Clone)]
pub struct Depths<T> {
    /// By the wider widths.
    pub calm: T,
    /// By the narrower ones.
    pub fine: T,
    /// The difference between the two surfaces, as a distance.
    pub apart: T,
}

/// The surface around particles alone or in small numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drops {
    /// Makes what is around a cloud.
    pub around: Weights,
    /// Spreads shares of it.
    pub spread: Weights,
    /// Fraction bits of a share, before it is spread.
    pub bits: u32,
    /// The radius of a particle alone, in units.
    pub radius: i32,
    /// The standard deviation, in units.
    pub width: i32,
}
