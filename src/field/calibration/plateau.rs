//! The field deep in the fluid. It determines the isovalue of the paper's indicators, and the
//! depths of clouds.
//!
//! At the true surface, the paper's smoothed field is 0.47 times its plateau
//! ([`Isovalue::PLATEAU_PERCENT`]). The plateau is the median of the smoothed DIF over interior
//! cells: cells whose filters reach only fluid. The interior is defined by lengths in spacings, so
//! it is the same for cells of any size. Gaps between particles up to the size of a cube of two
//! spacings count as fluid, because randomly placed particles leave such cubes empty even in the
//! middle of the fluid.
//!
//! If a frame has no interior, for example because it contains only spray, a sheet or a handful of
//! particles, the plateau is the value expected of a fluid of the same spacing.

use serde::{Deserialize, Serialize};

use crate::brick::{DifField, equal_steps};
use crate::field::blur::{Filter, Smoothing, blur};
use crate::field::distance::{BULK_GAIN, DistanceFilters};
use crate::field::indicator::{GHOST_LAYER, SampledDif, WideCells};
use crate::grid::CellBox;
use crate::grid::units::{FULL, Isovalue};
use crate::system::control::Meter;

use super::expected::expected;
use super::histogram::Histogram;
use super::interior::{BlurredSamples, Interior};

/// The maximum number of blocks in a sample of a frame's blocks. The blocks are chosen at equal
/// steps along the Morton curve.
const SAMPLED_BLOCKS: usize = 64;

/// The minimum interior volume, in cubed spacings, in the middles of the sampled blocks. If the
/// interior is smaller, whole blocks are examined.
const ENOUGH: f64 = (1 << 16) as f64 * 8.0 / 27.0;

/// The minimum interior volume of a frame, in cubed spacings. In a smaller interior, one clump of
/// particles would determine the result.
const LEAST: f64 = 256.0;

/// The sizes of gaps that count as fluid, in spacings. Each size comes with the minimum plateau of
/// a fluid with such gaps, as a fraction of the plateau expected from the spacing; `None` for no
/// minimum. Thin fluid with random particles has an interior only if the wider gaps also count as
/// fluid. Mist also has wide gaps, but a lower plateau.
const GAPS: [(f64, Option<f64>); 2] = [(2.0, None), (3.0, Some(1.0 / 3.0))];

/// The value of the smoothed DIF deep in the fluid, measured or expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Plateau {
    /// Interior cells were found.
    Interior {
        /// Median of the field over the interior cells.
        median: u16,
        /// Lowest value of the field in the examined interior cells. With a higher isovalue, the
        /// interior would contain bubbles.
        lowest: u16,
    },
    /// Almost no fluid is deeper than the reach of the filters, so the plateau is the value
    /// expected of a fluid of the same spacing.
    Shallow {
        /// The mean of the field deep in such a fluid.
        expected: u16,
    },
}

impl Plateau {
    /// The field deep in the fluid, as a fraction of 1.
    #[must_use]
    pub fn fraction(self) -> f64 {
        f64::from(self.value()) / f64::from(FULL)
    }

    /// The plateau of clouds for one particle per cubed spacing. `spacing` is in cells.
    #[must_use]
    pub fn nominal(spacing: f64) -> f64 {
        WideCells::of_spacing(spacing).plateau() * f64::from(1 << BULK_GAIN)
    }

    /// The maximum number of blocks and parts of blocks that are examined in a field.
    pub(super) fn most_parts(dif: &DifField) -> usize {
        let blocks = dif.regions(0, 0).len();
        GAPS.len() * (2 * blocks.min(SAMPLED_BLOCKS) + blocks)
    }

    /// Measures the plateau of a frame of clouds, in wide cells, smoothed with the narrowest width.
    /// The result depends only on the frame and that width.
    #[must_use]
    pub fn of_clouds(frame: &SampledDif, distances: &DistanceFilters, meter: &Meter<'_>) -> Self {
        let narrowest = &distances.bulk.widths[0];
        let spacing = 1.0 / frame.wide_cells().edge;
        let volume = spacing * spacing * spacing;
        let nominal = Self::nominal(frame.facts.spacing_cells_or_one());
        let blurred = BlurredSamples {
            dif: frame.wide(distances.level),
            own: frame.facts.own_cells().map(|own| own.in_wider_cells(distances.level)),
            mirror: frame.facts.mirror(distances.level),
            reach: GHOST_LAYER,
            halo: narrowest.weights.reach(),
            width: f64::from(narrowest.spacings) / 4096.0 * spacing,
            apply: &|block, mirror| blur(block, &narrowest.weights, mirror),
            meter,
        };
        let [narrow, wide] = GAPS.map(|(gap, _)| Interior::new(&blurred, gap * spacing));
        // In coarse cells both gaps give the same interior, so the wider gap finds nothing new.
        let count = if narrow.is_same(&wide) { 1 } else { GAPS.len() };
        let found =
            [narrow, wide].into_iter().zip(GAPS).take(count).find_map(|(interior, (_, share))| {
                let (median, lowest) = measured(&interior, ENOUGH * volume, LEAST * volume)?;
                let is_fluid = |share| f64::from(median) >= share * nominal;
                share.is_none_or(is_fluid).then_some(Self::Interior { median, lowest })
            });
        found.unwrap_or(Self::Shallow { expected: nominal.round() as u16 })
    }

    /// Measures a frame's plateau for an indicator of the paper. The result depends only on the
    /// frame and the smoothing. An unknown spacing is assumed to be one cell.
    #[must_use]
    pub fn of(frame: &SampledDif, smoothing: &Smoothing, meter: &Meter<'_>) -> Self {
        let (dif, indicator, spacing) = (&frame.dif, frame.indicator, frame.facts.spacing_cells());
        let cells = spacing.unwrap_or(1.0);
        let blurred = BlurredSamples {
            dif,
            own: frame.facts.own_cells(),
            mirror: frame.facts.mirror(0),
            reach: 0,
            halo: smoothing.halo(),
            width: smoothing.width(),
            apply: &|block, walls| smoothing.apply(block, walls),
            meter,
        };
        // The minimum plateau is not checked if the spacing is unknown, because then there is no
        // expected value. It is not checked for the symmetry indicator either, because this
        // indicator does not count particles.
        let counted = spacing.filter(|_| indicator.kind().counts());
        let volume = cells * cells * cells;
        let (enough, least) =
            (ENOUGH * volume, if spacing.is_some() { LEAST * volume } else { 1.0 });
        let found = GAPS.into_iter().find_map(|(gap, share)| {
            let interior = Interior::new(&blurred, gap * cells);
            let (median, lowest) = measured(&interior, enough, least)?;
            let is_fluid =
                |(share, spacing)| f64::from(median) >= share * expected(indicator, spacing, None);
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

    /// The isovalue for a field with this plateau.
    #[must_use]
    pub fn isovalue(self) -> Isovalue {
        Isovalue::of_plateau(self.value())
    }
}

/// The median and the minimum over interior cells. Tries three sets in this order, and uses the
/// first with sufficient interior cells: the middles of some blocks (`enough` cells are needed),
/// these blocks as a whole, and all blocks (`least` cells are needed).
fn measured(interior: &Interior<'_>, enough: f64, least: f64) -> Option<(u16, u16)> {
    let blocks = interior.blocks();
    let sampled: Vec<_> = equal_steps(blocks.len(), SAMPLED_BLOCKS).map(|i| blocks[i]).collect();
    let middles = || sampled.iter().map(middle).collect::<Vec<_>>();
    let of = |parts: &[CellBox], enough: f64| {
        let samples = Histogram::of(parts, |histogram, &cells| interior.add(histogram, cells));
        (samples.total() as f64 >= enough).then_some(())?;
        Some((samples.quantile(0.5)?, samples.quantile(0.0)?))
    };
    let of_middles = if sampled.len() < blocks.len() { of(&middles(), enough) } else { None };
    // Shallow frames have few interior cells in each block, and spray may have none. For such
    // frames, examine all blocks.
    of_middles.or_else(|| of(&sampled, least)).or_else(|| of(&blocks, least))
}

/// The middle half of a box along each axis.
fn middle(cells: &CellBox) -> CellBox {
    let size = cells.size();
    CellBox { lo: cells.lo + size / 4, hi: cells.hi - size / 4 }
}
