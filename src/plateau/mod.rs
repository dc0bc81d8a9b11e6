//! The isovalue that places the surface without bias.
//!
//! At the true surface the smoothed field is 0.47 of its interior plateau ([`Isovalue::PLATEAU_PERCENT`]). The plateau is
//! the median of the smoothed DIF over interior cells: those whose filters see nothing but fluid. What is interior is told
//! by lengths in spacings, so that it is the same in cells of any size: gaps between particles in which a cube of two
//! spacings finds room count as fluid, for particles at random leave such cubes empty in the middle of the fluid.
//!
//! Where there is no interior (spray, a sheet, a handful of particles), what a fluid of that spacing would have stands in.

mod expected;
mod histogram;
mod interior;
mod precision;

pub use precision::{COARSEST_STEP, FINEST_OF_SYMMETRY, ON_CORNERS, Remedy, TooFine, step_cells};

use crate::brick::{DifField, equal_steps};
use crate::grid::{CellBox, Domain, Grid};
use crate::recipe::{Details, Recipe};
use crate::stage::adaptive::Adaptive;
use crate::stage::blur::{Kernel, Smoothing};
use crate::stage::detail::Detail;
use crate::stage::indicator::Indicator;
use crate::units::{Isovalue, MeanCount, Sigma};

use expected::expected;
use histogram::Histogram;
use interior::Interior;
use precision::{fitting, refuse_symmetry, refuse_too_fine, roundly_above};

/// Blocks that are looked at; in a larger frame they are taken at equal steps along the Morton curve.
const SAMPLED_BLOCKS: usize = 64;

/// Interior that the blocks' middles have to have, in cubed spacings; else they are looked at whole.
const ENOUGH: f64 = (1 << 16) as f64 * 8.0 / 27.0;

/// Interior that a frame has to have, in cubed spacings: in less, a clump of particles would tell for all of it.
const LEAST: f64 = 256.0;

/// Gaps that count as fluid, in spacings, and the least plateau of a fluid with such gaps, if that matters, as a share of what is
/// expected of its spacing. Thin fluids at random have an interior by the wider gaps alone; but those are in mist as well.
const GAPS: [(f64, Option<f64>); 2] = [(2.0, None), (3.0, Some(1.0 / 3.0))];

/// The value of the smoothed DIF deep in the fluid, measured or expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plateau {
    /// Interior cells were found.
    Interior {
        /// Median of the field over the interior cells.
        median: u16,
        /// The least value seen in the parts of blocks that were looked at: from there on the interior fills with bubbles.
        lowest: u16,
    },
    /// Next to none of the fluid is deeper than the filters reach; what a fluid of the same spacing would have stands in.
    Shallow {
        /// The mean of the field deep in such a fluid.
        expected: u16,
    },
}

/// The DIF of a frame, and how it was sampled.
#[derive(Debug, Clone, Copy)]
pub struct SampledDif<'a> {
    /// Of the frame.
    pub dif: &'a DifField,
    /// What it was made by. It knows its mu0.
    pub indicator: Indicator,
    /// Walls, if there are any.
    pub domain: Option<&'a Domain>,
    /// The particles' spacing, in cells. Where it is `None` they are taken to be a cell apart, and any interior tells for all.
    pub spacing: Option<f64>,
}

impl Plateau {
    /// Measures a frame's plateau. The result depends on the frame and the smoothing alone.
    #[must_use]
    pub fn of(frame: &SampledDif<'_>, smoothing: &Smoothing) -> Self {
        let &SampledDif { dif, indicator, domain, spacing } = frame;
        let width = smoothing.width(indicator);
        let cells = spacing.unwrap_or(1.0);
        // Symmetry does not tell how many particles there are, and any interior is better than none where the spacing is not
        // known, for nothing can be expected there.
        let counted = spacing.filter(|_| indicator.counts());
        let volume = cells * cells * cells;
        let (enough, least) = (ENOUGH * volume, if spacing.is_some() { LEAST * volume } else { 1.0 });
        let found = GAPS.into_iter().find_map(|(gap, share)| {
            let interior = Interior::new(dif, smoothing, domain, width, gap * cells);
            let (median, lowest) = measured(dif, &interior, enough, least)?;
            let is_fluid = |(share, spacing)| f64::from(median) >= share * expected(indicator, spacing, None);
            share.zip(counted).is_none_or(is_fluid).then_some(Self::Interior { median, lowest })
        });
        found.unwrap_or_else(|| {
            let expected = expected(indicator, cells, Some(dif)).round().max(1.0) as u16;
            Self::Shallow { expected }
        })
    }

    /// The field deep in the fluid.
    #[must_use]
    pub fn value(self) -> u16 {
        match self {
            Self::Interior { median, .. } => median,
            Self::Shallow { expected } => expected,
        }
    }

    /// What goes with the plateau.
    #[must_use]
    pub fn isovalue(self) -> Isovalue {
        Isovalue::of_plateau(self.value())
    }
}

/// The median and the least value over the interior: of `enough` cells in the middles of some blocks, else of all that these
/// have, if that is at `least` so much.
fn measured(dif: &DifField, interior: &Interior<'_>, enough: f64, least: f64) -> Option<(u16, u16)> {
    let blocks = dif.regions(0, 0);
    let sampled: Vec<_> = equal_steps(blocks.len(), SAMPLED_BLOCKS).map(|i| blocks[i]).collect();
    let middles = || sampled.iter().map(middle).collect::<Vec<_>>();
    let of = |parts: &[CellBox], enough: f64| {
        let samples = Histogram::of(parts, |seen, &cells| interior.add(seen, cells));
        (samples.total() as f64 >= enough).then_some(())?;
        Some((samples.quantile(0.5)?, samples.quantile(0.0)?))
    };
    let of_middles = if sampled.len() < blocks.len() { of(&middles(), enough) } else { None };
    // A frame without depth is small for its number of blocks, or all of it is spray: look at all.
    of_middles.or_else(|| of(&sampled, least)).or_else(|| of(&blocks, least))
}

/// Half of a box along each axis.
fn middle(cells: &CellBox) -> CellBox {
    let size = cells.size();
    CellBox { lo: cells.lo + size / 4, hi: cells.hi - size / 4 }
}

/// Refuses cells that are too fine for particles of a known spacing, before there is a DIF, by a Gaussian that may depend on their
/// size; those that are found to be so only once mu0 is known are refused by [`recipe`].
///
/// # Errors
/// [`TooFine`].
pub fn refuse_too_fine_for(
    indicator: Indicator,
    spacing: f64,
    cell_size: f64,
    sigma: impl Fn(f64) -> Sigma,
) -> Result<(), TooFine> {
    if indicator == Indicator::Symmetry {
        refuse_symmetry(spacing / cell_size, cell_size)?;
    }
    // The fewer particles there are in full cells, the more each of them makes of its own, and there is one at least.
    let one = || MeanCount::new(1.0).expect("a number within the bounds");
    let indicator = indicator.with_mean(Some(indicator.mean().unwrap_or_else(one)));
    let plateau = |size: f64| expected(indicator, spacing / size, None);
    let width = |size: f64| Smoothing::new(indicator, sigma(size)).width(indicator);
    let larger = |_| Remedy::Cells(fitting(cell_size, |size| step_cells(plateau(size), width(size))));
    refuse_too_fine(plateau(cell_size), width(cell_size), cell_size, larger)
}

/// From the DIF of a frame to its surface: the smoothing's kernels, and the isovalue, measured where it is `None`.
///
/// # Errors
/// [`TooFine`] where the field does not tell finely enough where the surface is.
pub fn recipe(
    frame: &SampledDif<'_>,
    grid: &Grid,
    sigma: Sigma,
    detail: Detail,
    iso: Option<Isovalue>,
) -> Result<(Recipe, Plateau), TooFine> {
    let (indicator, cell_size) = (frame.indicator, grid.cell_size());
    if let (Indicator::Symmetry, Some(spacing)) = (indicator, frame.spacing) {
        refuse_symmetry(spacing, cell_size)?;
    }
    let smoothing = Smoothing::new(indicator, sigma);
    let plateau = Plateau::of(frame, &smoothing);
    let value = f64::from(plateau.value().max(1));
    refuse_too_fine(value, smoothing.width(indicator), cell_size, |step_cells| {
        if indicator == Indicator::Symmetry && frame.dif.mean_of_full() < ON_CORNERS {
            return Remedy::Origin;
        }
        // The plateau grows with the cell's volume.
        Remedy::Cells(roundly_above(cell_size * (step_cells / COARSEST_STEP).cbrt()))
    })?;
    Ok((recipe_at(indicator, sigma, detail, iso.unwrap_or(plateau.isovalue())), plateau))
}

/// The smoothing's kernels and an isovalue that is known, of whichever frame.
#[must_use]
pub fn recipe_at(indicator: Indicator, sigma: Sigma, detail: Detail, iso: Isovalue) -> Recipe {
    Recipe { smoothing: Smoothing::new(indicator, sigma), details: details(indicator, sigma, detail), iso }
}

/// How far from a cell the DIF decides its field by such a recipe, whatever its isovalue.
#[must_use]
pub fn halo(indicator: Indicator, sigma: Sigma, detail: Detail) -> i32 {
    Smoothing::new(indicator, sigma).reach() + details(indicator, sigma, detail).halo()
}

fn details(indicator: Indicator, sigma: Sigma, detail: Detail) -> Details {
    match detail {
        Detail::Smoothed => Details::Smoothed,
        Detail::Recovered => Details::Recovered(Kernel::gaussian(sigma.half())),
        Detail::Spared => Details::Spared(Adaptive::new(indicator, sigma)),
    }
}
