//! Interior cells: those deep in the fluid, by lengths that do not depend on the cell.
//!
//! A cell counts as fluid where the particles' cells, closed, hold it: dilated and then eroded by
//! the same length, so that gaps between particles count as fluid and the fluid's outside does not
//! move. Interior is what lies deeper in that than the filters see, or 2.5 standard deviations of
//! what they make of a particle, beyond which next to nothing comes from.

use glam::IVec3;

use crate::brick::{Block, DifField, full_bits, fullness};
use crate::grid::{BLOCK, CellBox};
use crate::system::control::Meter;

use super::histogram::Histogram;

/// How deep interior cells lie, in standard deviations of what a particle is smoothed into.
const DEPTH: f64 = 2.5;

/// Cells of a row, at the most: each is a bit.
const ROW: i32 = u128::BITS as i32;

/// Samples, and what smooths them.
pub struct BlurredSamples<'a> {
    pub dif: &'a DifField,
    /// The cells that count, where others repeat them.
    pub own: Option<CellBox>,
    /// Beyond them edge cells are repeated.
    pub walls: Option<CellBox>,
    /// How far from its own cell a particle leaves something.
    pub reach: i32,
    /// How far the filters see.
    pub halo: i32,
    /// The standard deviation of what they make of a particle, in cells.
    pub width: f64,
    /// Smooths a block.
    pub apply: &'a (dyn Fn(Block, Option<CellBox>) -> Block + Sync),
    /// A count of the parts that were looked at. From an early end on nothing is found.
    pub meter: &'a Meter<'a>,
}

/// The interior cells of a frame.
pub struct Interior<'a> {
    blurred: &'a BlurredSamples<'a>,
    /// By how much full cells are dilated.
    dilation: i32,
    /// By how much that is eroded.
    erosion: i32,
}

impl<'a> Interior<'a> {
    /// Where gaps in which a cube of `gap` cells finds room are closed, or of three where that is
    /// more.
    pub fn new(blurred: &'a BlurredSamples<'a>, gap: f64) -> Self {
        let &BlurredSamples { reach, halo, width, .. } = blurred;
        let depth = (reach + halo).min((DEPTH * width).ceil() as i32);
        // Half the edge of the cube around each cell. The quotient of two decimals can be off by a
        // rounding.
        let closing = (((gap - 1.0) / 2.0 - 1e-9).ceil() as i32).max(1);
        let fitting = ((ROW - BLOCK) / 2 - depth + reach) / 2;
        let closing = closing.min(fitting);
        // What is stored of clouds is dilated by their reach already.
        Self { blurred, dilation: closing - reach, erosion: closing + depth }
    }

    /// Whether two find the same cells interior.
    pub fn is_same(&self, other: &Self) -> bool {
        (self.dilation, self.erosion) == (other.dilation, other.erosion)
    }

    /// The parts of blocks that hold samples.
    pub fn blocks(&self) -> Vec<CellBox> {
        let own = |cells: CellBox| self.blurred.own.map_or(cells, |own| cells.intersection(&own));
        let blocks = self.blurred.dif.regions(0, 0).into_iter().map(own);
        blocks.filter(|cells| !cells.is_empty()).collect()
    }

    /// Adds the smoothed DIF over the interior cells among `cells`, a block or a part of it.
    pub fn add(&self, histogram: &mut Histogram, cells: CellBox) {
        let Self { blurred, dilation, erosion } = *self;
        if !blurred.meter.goes_on() {
            return;
        }
        blurred.meter.add(1);
        let walls = blurred.walls;
        let (seen, reach) = (dilation + erosion, blurred.halo);
        let margin = seen.max(reach);
        let wide = blurred.dif.gather_within(cells.grown(margin, margin), walls);
        let [_, width, slab] = wide.strides();
        let mut rows: Vec<u128> =
            fullness(wide.samples()).chunks_exact(width).map(full_bits).collect();
        windows(&mut rows, slab / width, 2 * dilation + 1, |a, b| a | b);
        windows(&mut rows, slab / width, 2 * erosion + 1, |a, b| a & b);
        // Both windows of a cell begin `seen` below it, and `wide` begins `margin` below `cells`.
        let CellBox { lo, hi } = cells;
        let among = (1 << (hi.x - lo.x)) - 1;
        let row = |y, z| {
            let begins = wide.index(IVec3::new(lo.x - margin, y - seen, z - seen));
            rows[begins / width] >> (margin - seen) & among
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
        let field = (blurred.apply)(wide.part(near.grown(reach, reach)), walls);
        for (y, z, bits) in interior {
            let first = field.index(IVec3::new(near.lo.x, y, z));
            histogram.add(
                &field.samples()[first..][..near.size().x as usize],
                bits >> (near.lo.x - lo.x),
            );
        }
    }
}

/// Combines every cell, a bit of its row, with those after it in a cube of this edge. `combine` can
/// see a cell more than once. Cells that are nearer to the end of a row give arbitrary results.
fn windows(
    rows: &mut [u128],
    rows_a_slab: usize,
    width: i32,
    combine: impl Fn(u128, u128) -> u128,
) {
    let mut seen = 1;
    while seen < width {
        let step = seen.min(width - seen);
        rows.iter_mut().for_each(|row| *row = combine(*row, *row >> step));
        for beyond in [step as usize, step as usize * rows_a_slab] {
            for at in beyond..rows.len() {
                rows[at - beyond] = combine(rows[at - beyond], rows[at]);
            }
        }
        seen += step;
    }
}
