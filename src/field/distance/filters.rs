//! The filters that compute a frame's distances, for the particles' spacing in cells.

use std::sync::Arc;

use glam::IVec3;

use crate::brick::halved_from_box;
use crate::field::blur::Weights;
use crate::field::indicator::{Amount, GHOST_LAYER, WideCells};
use crate::field::sheets::{DropShape, STANDS_OUT_EARLIER, Sheets};
use crate::grid::units::{SheetStretch, Smooth};
use crate::grid::{BLOCK, CellBox};

use super::{
    Bulk, Drops, FARTHEST, InsideBricks, Ramp, StandsOut, UNITS, Width, ZERO, away, wide_cells,
};

/// The widths of the Gaussians that smooth clouds, relative to the width that `--smooth` requests.
/// The first two give the fine surface, the last two the calm surface.
const WIDTHS: [f64; 3] = [0.625, 1.0, 1.5];
/// The cut-off of the Gaussians of these widths, in standard deviations.
const CUT: f64 = 2.2;
/// The standard deviation of the Gaussian that averages the difference between the fine and the
/// calm surface, as a multiple of the requested width.
const DIFFERENCE_WIDTH: f64 = 0.5625;
/// The cut-off of the Gaussian that averages the difference, in standard deviations.
const DIFFERENCE_CUT: f64 = 1.7;
/// Limits, in spacings, of the mean difference between the fine and the calm surface. A difference
/// up to the first limit is noise, and from the second limit on it is shape.
const APART: [f64; 2] = [0.07, 0.14];
/// The depths, in spacings, between which the fine surface fades out. Deeper in the fluid, noise
/// would form bubbles in the fine surface.
const DEEP: [f64; 2] = [0.3, 0.9];
/// The minimum variance of a filter, in squared cells: a narrower filter would have almost no
/// weight beyond its centre.
pub(in crate::field) const LEAST_VARIANCE: f64 = 0.35;
/// The minimum variances, in squared cells, of the filters of the three widths. They make the
/// filters differ even in coarse cells.
const LEAST_VARIANCES: [f64; 3] = [LEAST_VARIANCE, 0.85, 1.75];
/// The maximum standard deviation of drops, in spacings. It limits the width of drops in coarse
/// cells.
const WIDEST_DROP: f64 = 8.0;
/// The distance from a particle, in spacings, within which the bulk has a surface, and within which
/// the particle's drop is computed if the particle stands out.
const NEAR: f64 = 1.0;
/// The distances, in spacings, of a particle's centre outside the calm surface. At the first
/// distance, the particle begins to stand out; from the second on, it stands out completely.
const STANDS_OUT: [f64; 2] = [0.4, 1.0];
/// The range, in spacings, of the difference between the fine and the calm surface in which sheets
/// begin to stand out earlier than drops. In the bulk, the two surfaces agree.
const SHEETS_APART: [f64; 2] = [0.35, 0.45];
/// The standard deviation, in spacings, of the Gaussian that forms the drop of a single particle.
const DROP_WIDTH: f64 = 0.6;
/// The radius, in spacings, of a single particle's drop in fine cells.
const DROP_RADIUS: f64 = 0.55;
/// The drop radius, in spacings, decreases by one of these numbers times the squared edge of a cell
/// in spacings. The first number is for drops without refinement by splines, and the second is for
/// drops with refinement. This decrease corrects for the wider clouds in coarse cells, and for the
/// splines. The drop of one particle then has a volume of 0.99 cubed spacings in cells of 1/8 of a
/// spacing, and of 0.94 in cells of 1/4. In cells of 1/3 to 2/3 of a spacing, the volume is about
/// 0.8 and depends on the particle's position.
const LESS_RADIUS: [f64; 2] = [0.29, 0.41];
/// The minimum drop radius, in spacings, for cells that hardly resolve a single particle.
const LEAST_DROP_RADIUS: f64 = 0.38;
/// The cut-off of a drop's Gaussian, in standard deviations.
const DROP_CUT: f64 = 2.6;

/// The variance, in squared wide cells, of the spline that interpolates wide cells.
pub(in crate::field) const SPLINE: f64 = 0.25;

/// All parameters of distances from clouds. The plateau is nominal unless `with_plateau` sets a
/// measured plateau.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DistanceFilters {
    /// The calm surface is computed on wide cells. Each has 2^`level` cells along an axis.
    pub level: u32,
    /// The parameters of the bulk's surface.
    pub bulk: Bulk,
    /// The maximum distance, in wide cells along each axis, from a surface to the nearest particle.
    pub near: i32,
    /// The minimum sample of a wide cell that contains a particle's centre.
    pub least: u16,
    /// The distances from the calm surface at which drops and sheets fade in.
    pub stands_out: StandsOut,
    /// Drops are computed on cells 2^`drops_level` times as wide as the grid's cells. These cells
    /// are half as wide as wide cells. If the wide cells are the grid's own cells, drops are
    /// computed on the grid's cells.
    pub drops_level: u32,
    /// The parameters of drops.
    pub drops: Drops,
    /// The parameters of sheets and filaments, which replace drops in the same cells; `None` if
    /// sheets are off.
    pub sheets: Option<Sheets>,
    /// The distance, in wide cells, within which cells affect whether a brick is inside.
    pub inside_reach: i32,
    /// The bricks deep inside the fluid, in which no samples are computed.
    pub inside: Arc<InsideBricks>,
}

/// The gain of the calm surface's blurs, in bits. A plateau of 4096 becomes a quarter of the
/// maximum sample, so a fluid is still measured correctly if it is up to four times denser than the
/// given spacing implies, for example because the given spacing is 1.5 times the true one.
pub const BULK_GAIN: u32 = 2;

/// A Gaussian filter, and the standard deviation, in cells, of a cloud after smoothing by this
/// filter. The variance of a smoothed cloud is the filter's variance plus the cloud's own variance,
/// a quarter of a squared cell. The standard deviation is `cells`, unless the filter's variance
/// would then be less than `least`.
pub(in crate::field) fn gaussian(cells: f64, least: f64, cut: f64) -> (Weights, f64) {
    let variance = (cells * cells - 0.25).max(least);
    let weights = Weights::of_variance(variance, (cut * variance.sqrt()).round().max(1.0) as i32);
    let width = (weights.variance() + 0.25).sqrt();
    (weights, width)
}

/// A ramp between two distances in spacings, for samples in which `zero` means a distance of 0.
fn ramp([begin, end]: [f64; 2], zero: i32) -> Ramp {
    let units = |spacings: f64| (spacings * UNITS).round() as i32;
    Ramp::new((zero + units(begin)) as u16, (units(end) - units(begin)) as u16)
}

impl DistanceFilters {
    /// Makes the filters for particles `spacing` cells apart.
    #[must_use]
    pub fn new(smooth: Smooth, sheets: SheetStretch, spacing: f64) -> Self {
        let wide = WideCells::of_spacing(spacing);
        let widths = [0, 1, 2].map(|i: usize| {
            let cells = WIDTHS[i] * smooth.spacings() / wide.edge;
            let (weights, width) = gaussian(cells, LEAST_VARIANCES[i], CUT);
            let spacings = (width * wide.edge * 4096.0).round() as i32;
            Width {
                weights: weights.gaining(BULK_GAIN),
                spacings,
                most: (FARTHEST << 14) / spacings,
            }
        });
        // The surface is extrapolated to a negative variance: minus half of the variance that the
        // spline adds. An extrapolation by the full variance would overshoot for small
        // balls.
        let spline = if wide.level > 0 { SPLINE / 2.0 * (wide.edge * 4096.0).powi(2) } else { 0.0 };
        let share = |narrow: usize| {
            let [a, b] = [narrow, narrow + 1].map(|i| f64::from(widths[i].spacings).powi(2));
            ((a + spline) / (b - a) * 4096.0).round() as i32
        };
        let around = (DIFFERENCE_WIDTH * smooth.spacings() / wide.edge).powi(2).max(LEAST_VARIANCE);
        let around =
            Weights::of_variance(around, (DIFFERENCE_CUT * around.sqrt()).round().max(1.0) as i32);
        let amount = f64::from(wide.amount().steps());
        let bulk = Bulk {
            shares: [share(0), share(1)],
            scale: scale(wide.plateau() * f64::from(1 << BULK_GAIN)),
            widths,
            around,
            apart: ramp(APART, 0),
            deep: ramp(DEEP, ZERO),
        };
        let drops_level = wide.level.saturating_sub(1);
        let (drops, sheets) = thin_fluid(sheets, spacing, drops_level > 0);
        Self {
            level: wide.level,
            bulk,
            near: (NEAR / wide.edge).round().max(1.0) as i32,
            least: ((amount / 9.0) as u16).max(1),
            stands_out: StandsOut {
                ramp: ramp(STANDS_OUT, ZERO),
                earlier: sheets.as_ref().map_or(0, |_| (STANDS_OUT_EARLIER * UNITS).round() as u16),
                apart: ramp(SHEETS_APART, 0),
            },
            drops_level,
            drops,
            sheets,
            inside_reach: InsideBricks::reach(wide.edge),
            inside: Arc::default(),
        }
    }

    /// Sets a measured plateau: the sample deep in the fluid, smoothed with the narrowest width.
    #[must_use]
    pub fn with_plateau(mut self, plateau: u16) -> Self {
        self.bulk.scale = scale(plateau.into());
        self
    }

    /// Replaces the filters of drops and sheets by filters for particles that are `spacing` cells
    /// apart. Callers need these filters if they use splines to interpolate drops and sheets on a
    /// finer mesh.
    #[must_use]
    pub fn refining(self, sheets: SheetStretch, spacing: f64) -> Self {
        let (drops, sheets) = thin_fluid(sheets, spacing, true);
        Self { drops, sheets, ..self }
    }

    /// Halves the densities in the filters, for clouds to which each particle adds half the usual
    /// [`Amount`].
    #[must_use]
    pub fn of_half_amounts(self) -> Self {
        let least = (self.least / 2).max(1);
        Self { least, sheets: self.sheets.map(Sheets::of_half_amounts), ..self }
    }

    /// Makes the filters skip the bricks in `inside`: no samples are computed there.
    #[must_use]
    pub fn skipping(self, inside: InsideBricks) -> Self {
        Self { inside: Arc::new(inside), ..self }
    }

    /// The part of `cells` that can be the lowest corners of dual cells with a surface. A dual cell
    /// whose corners are all inside has no surface.
    #[must_use]
    pub fn not_inside(&self, cells: CellBox) -> CellBox {
        let rest = self.inside.rest(self.wide_cells(cells.grown(0, 1)));
        if rest.is_empty() {
            return rest;
        }
        let further = i32::from(self.level > 0);
        let rest = rest.grown(further, further);
        let near = CellBox { lo: rest.lo << self.level, hi: rest.hi << self.level };
        near.grown(1, 0).intersection(&cells)
    }

    /// The wide cells on which the calm surface is needed for a field on `cells`.
    #[must_use]
    pub fn wide_cells(&self, cells: CellBox) -> CellBox {
        wide_cells(self.level, cells)
    }

    /// The halo that the calm surface needs around [`wide_cells`](Self::wide_cells), in wide cells.
    #[must_use]
    pub fn wide_halo(&self) -> i32 {
        self.bulk.reach() + self.near.max(self.bulk.around.reach())
    }

    /// The halo, in wide cells, of the density from which sheets are computed.
    #[must_use]
    pub fn sheets_halo(&self) -> i32 {
        let further = |sheets: &Sheets| {
            // The halo of sheets is in the cells of drops, which are half as wide as wide cells.
            let halo =
                if self.level > self.drops_level { sheets.halo() / 2 + 1 } else { sheets.halo() };
            sheets.bulk.reach() + sheets.around.reach() + halo
        };
        self.sheets.as_ref().map_or(0, further)
    }

    /// The largest halo, in wide cells, that the calm surface or sheets need.
    #[must_use]
    pub fn widest_halo(&self) -> i32 {
        self.wide_halo().max(self.sheets_halo())
    }

    /// The halo of drops and sheets, in the cells on which they are computed.
    #[must_use]
    pub fn drops_halo(&self) -> i32 {
        self.sheets.as_ref().map_or(0, Sheets::halo).max(self.drops.halo())
    }

    /// The distance, in cells, within which particles affect the field of a cell. It includes the
    /// reach of the clouds, of the wide cells computed from them, and of the spline that
    /// interpolates wide cells.
    #[must_use]
    pub fn halo(&self) -> i32 {
        let in_wide = |level: u32, halo: i32| {
            let spline = i32::from(level > 0);
            halo_in_cells(level, halo + spline)
        };
        let wide = in_wide(self.level, self.widest_halo());
        wide.max(in_wide(self.drops_level, self.drops_halo())) + GHOST_LAYER
    }

    /// The cells whose samples affect the field on `cells`, including the samples that decide which
    /// cells are inside.
    #[must_use]
    pub fn input_cells(&self, cells: CellBox) -> CellBox {
        let wide = self.wide_cells(cells);
        let halo = self.widest_halo();
        let bulk = wide.grown(halo, halo);
        let inside = InsideBricks::bricks_around(wide).grown(self.inside_reach, self.inside_reach);
        let drops = wide_cells(self.drops_level, cells).grown(self.drops_halo(), self.drops_halo());
        halved_from_all(self.level, bulk.union(&inside))
            .union(&halved_from_all(self.drops_level, drops))
    }

    /// The maximum distance, in cells, from a surface to the nearest full cell.
    #[must_use]
    pub fn reach(&self) -> i32 {
        (self.near + 2) << self.level
    }

    /// The weights of all filters.
    pub fn weights(&self) -> impl Iterator<Item = &Weights> {
        let widths = self.bulk.widths.iter().map(|width| &width.weights);
        let sheets = self.sheets.iter().flat_map(|sheets| {
            [&sheets.bulk, &sheets.around, &sheets.around_weights, &sheets.average]
        });
        widths.chain([&self.bulk.around, &self.drops.around, &self.drops.spread]).chain(sheets)
    }

    /// Memory, in bytes, that is needed to compute the surface of the bulk on the wide cells
    /// `wide`.
    #[must_use]
    pub fn bulk_bytes(&self, wide: CellBox) -> u64 {
        let halo = self.wide_halo();
        6 * volume_bytes(wide.grown(halo, halo))
    }

    /// Maximum memory, in bytes, that is needed to compute the field of a block. It also suffices
    /// for the bulk's surface on a box of 2 x 2 x 2 blocks.
    #[must_use]
    pub fn block_bytes(&self) -> u64 {
        let cells = |edge: i32| CellBox { lo: IVec3::NEG_ONE, hi: IVec3::splat(edge + 2) };
        let around = |cells: CellBox, halo: i32| volume_bytes(cells.grown(halo, halo));
        let drops = around(wide_cells(self.drops_level, cells(BLOCK)), self.drops_halo());
        let sheets = around(self.wide_cells(cells(BLOCK)), self.sheets_halo());
        let all = self.wide_cells(cells(2 * BLOCK));
        let thin = 8 * drops + 4 * sheets + 4 * volume_bytes(cells(BLOCK));
        self.bulk_bytes(all).max(thin + 2 * volume_bytes(all))
    }
}

/// Makes the parameters of drops and sheets for particles `spacing` cells apart. Drops and sheets
/// are computed on cells half as wide as wide cells. If wide cells are the grid's own cells, drops
/// and sheets are computed on these cells. `is_refined` says whether splines interpolate drops and
/// sheets on the mesh.
fn thin_fluid(sheets: SheetStretch, spacing: f64, is_refined: bool) -> (Drops, Option<Sheets>) {
    let wide = WideCells::of_spacing(spacing);
    let in_drops = spacing / f64::from(1 << wide.level.saturating_sub(1));
    let (drops, shape) = Drops::new(in_drops, is_refined);
    (drops, Sheets::new(sheets, [1.0 / spacing, 1.0 / in_drops], wide, shape))
}

/// The cells from which `wide` is computed. `wide` is a box of cells that are 2^`level` times as
/// wide.
fn halved_from_all(level: u32, wide: CellBox) -> CellBox {
    (0..level).fold(wide, |wide, _| halved_from_box(wide))
}

/// Converts a halo from cells that are 2^`level` times as wide to narrow cells. The result
/// includes the distance from a cell to the far end of its wide cell, and the cells beyond the halo
/// that contribute to wide cells.
#[must_use]
pub fn halo_in_cells(level: u32, halo: i32) -> i32 {
    (halo << level) + 2 * ((1 << level) - 1)
}

/// Memory, in bytes, of the samples of `cells`.
fn volume_bytes(cells: CellBox) -> u64 {
    cells.volume() as u64 * size_of::<u16>() as u64
}

/// The factor that converts samples to fractions of `plateau`: sample * factor / 16384 is the
/// fraction in 32768ths.
fn scale(plateau: f64) -> u32 {
    ((f64::from(1_u32 << 29) / plateau.max(1.0)).round() as u32).min(u16::MAX.into())
}

impl Bulk {
    /// Reach of the widest filter, in wide cells.
    #[must_use]
    pub fn reach(&self) -> i32 {
        self.widths.iter().map(|width| width.weights.reach()).max().unwrap_or(0)
    }
}

impl Drops {
    /// The halo of drops, in the cells on which they are computed.
    #[must_use]
    pub fn halo(&self) -> i32 {
        self.around.reach() + self.spread.reach()
    }

    /// The smallest share N (step 4 in `mod.rs`) on the surface of a drop or inside it.
    #[must_use]
    pub fn least_share(&self) -> u16 {
        let (mut outside, mut inside) = (0, u16::MAX);
        while inside - outside > 1 {
            let middle = outside.midpoint(inside);
            let is_inside = away(middle, self.width) <= self.radius;
            *(if is_inside { &mut inside } else { &mut outside }) = middle;
        }
        inside
    }

    /// Makes drops for particles `spacing` cells apart. `is_refined` says whether splines
    /// interpolate drops in finer cells.
    fn new(spacing: f64, is_refined: bool) -> (Self, DropShape) {
        let cells = DROP_WIDTH * spacing;
        let (weights, width) = gaussian(cells, LEAST_VARIANCE, DROP_CUT);
        let spline = if is_refined { SPLINE } else { 0.0 };
        let (spread, _) = gaussian((cells * cells - spline).sqrt(), LEAST_VARIANCE, DROP_CUT);
        let less = LESS_RADIUS[usize::from(is_refined)];
        let radius = (DROP_RADIUS - less / (spacing * spacing)).max(LEAST_DROP_RADIUS);
        let amount = f64::from(Amount::of_spacing(spacing).steps());
        // The sample of a single particle's smoothed cloud at the particle. With the gain, it is
        // about 2048 to 4096.
        let alone = amount / (width * std::f64::consts::TAU.sqrt()).powi(3);
        let bits_between = |value: f64, most: f64| {
            (0..15).take_while(|&bits| value * f64::from(1 << (bits + 1)) <= most).count() as u32
        };
        let gain = bits_between(alone, 4096.0);
        // At most 27/64 of a particle's cloud lies in one cell.
        let share = 27.0 / 64.0 * amount / (alone * f64::from(1_u32 << gain));
        let bits = bits_between(share, 49152.0);
        let shape = DropShape { radius, width: (width / spacing).min(WIDEST_DROP), spline };
        let drops = Self {
            around: weights.gaining(gain),
            // With this gain, a spread quotient of 1 is the share 32768.
            spread: spread.gaining((15 + gain).saturating_sub(bits).min(15)),
            bits,
            radius: (radius * UNITS).round() as i32,
            width: (shape.width * UNITS).round() as i32,
        };
        (drops, shape)
    }
}
