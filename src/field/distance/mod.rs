//! Signed distances from clouds: a calm surface of the bulk, and the drops that stand out from it.
//!
//! All lengths are in particle spacings d, so the surface does not depend on the cell size. The
//! surface of the bulk is computed on [wide cells](super::indicator::WideCells) of 0.55 to 1.1 d,
//! or on the grid's own cells if those are wider.
//!
//! 1. Depth. A half space smoothed by a Gaussian of standard deviation s is Phi(depth / s). Where
//!    the clouds' density, smoothed in this way, is theta times the plateau, D_s = s Phi^-1(theta)
//!    is therefore the depth. D_s is limited to the range from -2.5 d to 2.5 d.
//! 2. Extrapolated. Curvature changes D_s in proportion to s^2, so a line through two widths gives
//!    the depth for width 0: E(a, b) = D_a + (D_a - D_b) a^2 / (b^2 - a^2). If splines interpolate
//!    wide cells, the extrapolation goes to a variance of -1/8 squared wide cells instead of 0,
//!    because splines blur. Three widths are used: 5/8 S, S and 3/2 S, where S is `--smooth`. They
//!    give a fine surface E(5/8 S, S) and a calm surface E(S, 3/2 S).
//! 3. Mixed. The difference between the two surfaces is averaged by a Gaussian of 9/16 S, which
//!    cancels noise and preserves shape. As this mean difference grows from 0.07 to 0.14 d, the
//!    fine surface replaces the calm surface. From 0.3 to 0.9 d below the calm surface, the fine
//!    surface fades out again, because noise would form bubbles in the fine surface at this depth.
//! 4. Drops. Normalised convolution: N = G * (rho / (G * rho)), where rho is the clouds' density
//!    and G a Gaussian of 0.6 d. N of a single particle peaks at 1 in cells of any size, and the
//!    particle's drop is a ball of radius r, with the signed distance r - 0.6 sqrt(2 ln(1 / N)). N
//!    is computed on cells half as wide as wide cells. If the wide cells are the grid's own cells,
//!    N is computed on these cells. Values of N are called shares, and are stored in 32768ths.
//! 5. Joined. A particle stands out if its centre lies outside the calm surface, by the distance O
//!    = -E(S, 3/2 S) of its wide cell. The degree to which drops replace the bulk's surface depends
//!    on the greatest O within a spacing. The degree is 0 up to 0.4 d, and 1 from 1 d on. Where the
//!    fine and the calm surface differ, [sheets](super::sheets) stand out up to 0.35 d earlier.
//!    Where no particle is near, there is no surface.
//!
//! All blurs use [`blur`](super::blur), quadratic B-splines interpolate wide cells, and ramps are 3
//! x^2 - 2 x^3. A distance of x spacings is stored as the 16-bit sample 32768 + 8192 x.

mod cpu;
mod filters;
mod inside;
mod inverse_normal;
pub mod vulkan;

pub use cpu::{
    away, depths, greatest_of, joined, mixed, outlying, outlying_part, quotient, refined, spread,
};
pub use filters::{BULK_GAIN, DistanceFilters, halo_in_cells};
pub(in crate::field) use filters::{LEAST_VARIANCE, SPLINE, gaussian};
pub use inside::{BRICK, InsideBricks};
pub use inverse_normal::{AWAY, DEPTHS};

use crate::field::blur::Weights;
use crate::grid::CellBox;

/// Number of units of distance per spacing.
pub const UNITS: f64 = 8192.0;
/// The sample of a distance of 0; samples outside the fluid are smaller.
pub const ZERO: i32 = 1 << 15;
/// The sample where no particle is near.
pub const NONE: u16 = 0;
/// The maximum distance, in units, that one smoothing width gives. Without this limit, noise deep
/// in the fluid and the blurred traces of a few particles far outside would count as shape.
pub const FARTHEST: i32 = 5 << 12;
/// The maximum difference, in units, between two surfaces of the bulk.
pub const MOST_APART: i32 = UNITS as i32;

/// The wide cells that affect a field that is interpolated at the middles of `cells`. A wide cell
/// has 2^`level` cells along each axis.
pub fn wide_cells(level: u32, cells: CellBox) -> CellBox {
    if level == 0 {
        return cells;
    }
    CellBox { lo: (cells.lo >> level) - 1, hi: ((cells.hi - 1) >> level) + 2 }
}

/// The binary logarithm of the sum of the [`spline`] weights.
pub fn spline_bits(level: u32) -> u32 {
    2 * level + 3
}

/// The weights of a quadratic B-spline at the middle of a cell. The cell is number `place` of the
/// 2^`level` cells along an axis of its wide cell. The weights are those of the wide cell below, of
/// the cell's own wide cell, and of the wide cell above; their sum is 2^[`spline_bits`].
pub fn spline(level: u32, place: u32) -> [u32; 3] {
    let (edge, at) = (2 << level, 2 * place + 1);
    let [below, above] = [edge - at, at].map(|length: u32| length * length);
    [below, 2 * edge * edge - below - above, above]
}

/// One of the Gaussians that smooth clouds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Width {
    /// The filter, in wide cells.
    pub weights: Weights,
    /// The standard deviation of a smoothed particle, in 4096ths of a spacing.
    pub spacings: i32,
    /// The maximum distance that this Gaussian gives, in 32768ths of its standard deviation.
    pub most: i32,
}

/// The parameters of the bulk's surface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bulk {
    /// The three widths, narrowest first.
    pub widths: [Width; 3],
    /// Two factors, in 4096ths. A width of smoothing gives a distance. The distance for width 0 is
    /// extrapolated from two widths. It is the distance for the narrower width, plus a factor times
    /// the difference between the distances for the narrower and the wider width. The first factor
    /// is for the two narrowest widths, and the second is for the two widest widths.
    pub shares: [i32; 2],
    /// The factor that converts samples to fractions of the plateau: sample * factor / 16384 is the
    /// fraction in 32768ths.
    pub scale: u32,
    /// The filter that averages the difference between the fine and the calm surface.
    pub around: Weights,
    /// The range of the mean difference, in units, in which the fine surface replaces the calm
    /// surface.
    pub apart: Ramp,
    /// The range of the calm surface's samples in which the fine surface fades out.
    pub deep: Ramp,
}

/// A smooth transition from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ramp {
    /// The value where the ramp begins to rise.
    pub begin: u16,
    /// The distance from `begin` to the value where the ramp reaches 1.
    pub range: u16,
    /// 2^28 / `range`, rounded up, with which `of` avoids a division.
    pub slope: u32,
}

impl Ramp {
    /// Makes a ramp that rises from `begin` to `begin + range`.
    pub const fn new(begin: u16, range: u16) -> Self {
        Self { begin, range, slope: (1_u32 << 28).div_ceil(range as u32) }
    }

    /// Makes a ramp between two fractions of the plateau, for values in 32768ths of the plateau.
    pub(in crate::field) const fn in_plateaus([begin, end]: [f64; 2]) -> Self {
        let range = ((end - begin) * 32768.0).round();
        Self::new((begin * 32768.0).round() as u16, range as u16)
    }

    /// The height of the ramp at `value`, from 0 to 4096: 3 x^2 - 2 x^3, where x rises from 0 to 1
    /// over the range of the ramp.
    #[inline(always)]
    pub fn of(self, value: u16) -> u32 {
        let x = (u32::from(value.saturating_sub(self.begin).min(self.range)) * self.slope) >> 16;
        (((x * x) >> 8) * (3 * 4096 - 2 * x)) >> 16
    }
}

/// The distances outside the calm surface at which drops and sheets replace the bulk's surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StandsOut {
    /// The range of the distance outside the calm surface in which drops replace the bulk's
    /// surface.
    pub ramp: Ramp,
    /// The distance, in units of the field, by which a sheet of full certainty stands out earlier
    /// than drops.
    pub earlier: u16,
    /// The range of differences between the fine and the calm surface over which `earlier` takes
    /// effect: not at its start, and fully at its end. In the bulk, the two surfaces agree.
    pub apart: Ramp,
}

impl StandsOut {
    /// The greatest distance at which neither drops nor sheets stand out.
    pub fn begin(&self) -> u16 {
        self.ramp.begin - self.earlier
    }

    /// Returns `distance`, the distance of a particle outside the calm surface, or a smaller
    /// distance. `apart` is the difference between the fine and the calm surface. Where `apart` is
    /// small, as in the bulk, a distance at which no drop stands out is reduced, so that no drop
    /// has to be computed.
    #[inline(always)]
    pub fn of_particle(&self, distance: u16, apart: u16) -> u16 {
        let earlier = (u32::from(self.earlier) * self.apart.of(apart)) >> 12;
        let most = self.begin() + earlier as u16;
        if distance > self.ramp.begin { distance } else { distance.min(most) }
    }

    /// Returns `distance`, the distance of particles outside the calm surface, increased by
    /// `earlier` times the certainty of their sheet, so that the sheet stands out earlier than
    /// drops do. `certainty` is in 4096ths.
    #[inline(always)]
    pub fn of_sheet(&self, distance: u16, certainty: u16) -> u16 {
        let earlier = (u32::from(certainty) * u32::from(self.earlier)) >> 12;
        distance.saturating_add(earlier as u16)
    }
}

/// Two surfaces of the bulk, as distances, and the distance by which the fine surface lies farther
/// out than the calm surface.
#[derive(Debug, Clone)]
pub struct Depths<T> {
    /// The calm surface, from the two wider widths.
    pub calm: T,
    /// The fine surface, from the two narrower widths.
    pub fine: T,
    /// The difference between the two surfaces, as a distance.
    pub apart: T,
}

/// The parameters of the surface around single particles and small groups.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drops {
    /// The filter that sums the clouds around each cell.
    pub around: Weights,
    /// The filter that smooths the quotients rho / (G * rho) of step 4 in
    /// [`distance`](crate::field::distance).
    pub spread: Weights,
    /// Number of fraction bits of a quotient, before it is smoothed.
    pub bits: u32,
    /// The radius of a single particle's drop, in units.
    pub radius: i32,
    /// The standard deviation of a drop, in units.
    pub width: i32,
}
