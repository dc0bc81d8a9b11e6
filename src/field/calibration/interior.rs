//! Interior cells: cells deep in the fluid, defined by lengths that do not depend on the cell size.
//!
//! A cell counts as fluid if it belongs to the closing of the particles' cells: a dilation followed
//! by an erosion of the same length. The closing fills gaps between particles and does not move the
//! outer surface. A cell of the fluid is interior if it is deeper than the reach of the filters. A
//! depth of 2.5 standard deviations of a smoothed particle also suffices, because contributions
//! from farther away are negligible.

use glam::IVec3;

use crate::brick::{Block, DifField, full_bits, fullness};
use crate::grid::{BLOCK, CellBox, Mirror};
use crate::system::control::Meter;

use super::histogram::Histogram;

/// The minimum depth of interior cells, in standard deviations of a smoothed particle.
const DEPTH: f64 = 2.5;

/// The maximum number of cells in a row, because each cell is one bit of a `u128`.
const ROW: i32 = u128::BITS as i32;

/// A field's samples and the filter that smooths them.
pub struct BlurredSamples<'a> {
    pub dif: &'a DifField,
    /// The cells to examine, if all other cells are their periodic images.
    pub own: Option<CellBox>,
    /// The mirror at walls, if there are any.
    pub mirror: Option<Mirror>,
    /// The maximum distance, in cells, from a particle's cell to a sample that the particle
    /// changes.
    pub reach: i32,
    /// The halo of the filters, in cells.
    pub halo: i32,
    /// The standard deviation of a smoothed particle, in cells.
    pub width: f64,
    /// Smooths a block.
    pub apply: &'a (dyn Fn(Block, Option<Mirror>) -> Block + Sync),
    /// Counts the examined parts. After a cancel, no more interior cells are found.
    pub meter: &'a Meter<'a>,
}

/// The interior cells of a frame.
pub struct Interior<'a> {
    blurred: &'a BlurredSamples<'a>,
    /// The number of cells by which full cells are dilated.
    dilation: i32,
    /// The number of cells by which the dilated cells are eroded.
    erosion: i32,
}

impl<'a> Interior<'a> {
    /// Defines the interior cells. Gaps in which a cube with an edge of max(`gap`, 3) cells does
    /// not fit count as fluid.
    pub fn new(blurred: &'a BlurredSamples<'a>, gap: f64) -> Self {
        let &BlurredSamples { reach, halo, width, .. } = blurred;
        let depth = (reach + halo).min((DEPTH * width).ceil() as i32);
        // `closing` is the number of cells by which the cube around each cell extends on every
        // side. The 1e-9 absorbs the rounding error of a quotient of decimals.
        let closing = (((gap - 1.0) / 2.0 - 1e-9).ceil() as i32).max(1);
        let fitting = ((ROW - BLOCK) / 2 - depth + reach) / 2;
        let closing = closing.min(fitting);
        // Clouds already dilate the stored samples by `reach`.
        Self { blurred, dilation: closing - reach, erosion: closing + depth }
    }

    /// Whether `self` and `other` define the same interior cells.
    pub fn is_same(&self, other: &Self) -> bool {
        (self.dilation, self.erosion) == (other.dilation, other.erosion)
    }

    /// The parts of blocks that contain samples.
    pub fn blocks(&self) -> Vec<CellBox> {
        let own = |cells: CellBox| self.blurred.own.map_or(cells, |own| cells.intersection(&own));
        let blocks = self.blurred.dif.regions(0, 0).into_iter().map(own);
        blocks.filter(|cells| !cells.is_empty()).collect()
    }

    /// Adds the smoothed DIF of the interior cells among `cells` to `histogram`. `cells` are a
    /// block or a part of one.
    pub fn add(&self, histogram: &mut Histogram, cells: CellBox) {
        let Self { blurred, dilation, erosion } = *self;
        if !blurred.meter.goes_on() {
            return;
        }
        blurred.meter.add(1);
        let mirror = blurred.mirror;
        let (window_reach, reach) = (dilation + erosion, blurred.halo);
        let margin = window_reach.max(reach);
        let wide = blurred.dif.gather_mirrored(cells.grown(margin, margin), mirror);
        let [_, width, slab] = wide.strides();
        let mut rows: Vec<u128> =
            fullness(wide.samples()).chunks_exact(width).map(full_bits).collect();
        windows(&mut rows, slab / width, 2 * dilation + 1, |a, b| a | b);
        windows(&mut rows, slab / width, 2 * erosion + 1, |a, b| a & b);
        // After dilation and erosion, the result for a cell depends on the cells from
        // `window_reach` cells below it to `window_reach` cells above it. A window begins at its
        // cell, so this result is stored `window_reach` cells below the cell along each axis.
        // `wide` begins `margin` cells below `cells`.
        let CellBox { lo, hi } = cells;
        let among = (1 << (hi.x - lo.x)) - 1;
        let row = |y, z| {
            let begins = wide.index(IVec3::new(lo.x - margin, y - window_reach, z - window_reach));
            rows[begins / width] >> (margin - window_reach) & among
        };
        let rows = (lo.z..hi.z).flat_map(|z| (lo.y..hi.y).map(move |y| (y, z, row(y, z))));
        let interior: Vec<(i32, i32, u128)> = rows.filter(|&(.., bits)| bits != 0).collect();

        let around = |&(y, z, bits): &(i32, i32, u128)| {
            let [first, last] = [bits.trailing_zeros(), bits.ilog2()].map(|bit| lo.x + bit as i32);
            CellBox { lo: IVec3::new(first, y, z), hi: IVec3::new(last, y, z) + 1 }
        };
        let near = interior.iter().map(around).fold(CellBox::EMPTY, |a, b| a.union(&b));
        if near.is_empty() {
            return;
        }
        let field = (blurred.apply)(wide.part(near.grown(reach, reach)), mirror);
        for (y, z, bits) in interior {
            let first = field.index(IVec3::new(near.lo.x, y, z));
            histogram.add(
                &field.samples()[first..][..near.size().x as usize],
                bits >> (near.lo.x - lo.x),
            );
        }
    }
}

/// Combines every cell (one bit of its row) with the cells of the cube with edge `width` that
/// begins at the cell. `combine` may be called with the same cell more than once. Cells less than
/// `width` cells from the end of a row have undefined results.
fn windows(
    rows: &mut [u128],
    rows_per_slab: usize,
    width: i32,
    combine: impl Fn(u128, u128) -> u128,
) {
    let mut combined = 1;
    while combined < width {
        let step = combined.min(width - combined);
        rows.iter_mut().for_each(|row| *row = combine(*row, *row >> step));
        for beyond in [step as usize, step as usize * rows_per_slab] {
            for at in beyond..rows.len() {
                rows[at - beyond] = combine(rows[at - beyond], rows[at]);
            }
        }
        combined += step;
    }
}
