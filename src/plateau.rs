//! The isovalue that places the surface without bias.
//!
//! At the true surface the smoothed field is 0.47 of its interior plateau ([`Isovalue::PLATEAU_PERCENT`]). The
//! plateau is the median of the smoothed DIF over interior cells: those whose filters see nothing but
//! fluid. A cell counts as fluid when it is full, or lies in a gap that one cell on every side closes,
//! for particles at random leave cells empty in the middle of the fluid.

use glam::IVec3;
use rayon::prelude::*;

use crate::brick::{Block, DifField, equal_steps, full_bits, fullness};
use crate::grid::{CellBox, Domain};
use crate::recipe::{Details, Recipe, gather};
use crate::stage::adaptive::Adaptive;
use crate::stage::blur::{Kernel, Smoothing};
use crate::stage::detail::Detail;
use crate::stage::indicator::Indicator;
use crate::units::{Isovalue, Sigma};

/// Blocks that are looked at; in a larger frame they are taken at equal steps along the Morton curve.
const SAMPLED_BLOCKS: usize = 64;

/// Interior cells that the blocks' middles have to have; else they are looked at whole.
const ENOUGH: u64 = 1 << 16;

/// What the smoothed DIF is like where the fluid is deep.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plateau {
    /// Interior cells were found.
    Interior {
        /// Of the field over the interior cells.
        median: u16,
        /// The least value seen in the parts of blocks that were looked at: from there on the interior fills with bubbles.
        lowest: u16,
    },
    /// The fluid is nowhere deeper than the filters reach; the greatest value stands in.
    Shallow {
        /// Of the field over all cells.
        greatest: u16,
    },
}

impl Plateau {
    /// Measures a frame's plateau. The result depends on the frame and the smoothing alone.
    #[must_use]
    pub fn of(dif: &DifField, smoothing: &Smoothing, domain: Option<&Domain>) -> Self {
        let blocks = dif.regions(0, 0);
        let sampled: Vec<_> = equal_steps(blocks.len(), SAMPLED_BLOCKS).map(|i| blocks[i]).collect();
        let middles = || sampled.iter().map(middle).collect::<Vec<_>>();
        let interior = |parts: &[CellBox], enough: u64| {
            let add = |seen: &mut _, &cells: &_| add_interior(seen, dif, smoothing, domain, cells);
            let samples = Histogram::of(parts, add);
            (samples.total() >= enough).then_some(())?;
            Some(Self::Interior { median: samples.quantile(0.5)?, lowest: samples.quantile(0.0)? })
        };
        let of_middles = if sampled.len() < blocks.len() { interior(&middles(), ENOUGH) } else { None };
        // A frame without depth is small for its number of blocks, or all of it is spray: look at all.
        let found = of_middles.or_else(|| interior(&sampled, 1)).or_else(|| interior(&blocks, 1));
        found.unwrap_or_else(|| {
            let field = Histogram::of(&blocks, |seen, &cells| {
                for (_, row) in smooth(dif, smoothing, domain, cells).rows(cells) {
                    seen.add(row, u128::MAX);
                }
            });
            Self::Shallow { greatest: field.quantile(1.0).unwrap_or(0) }
        })
    }

    /// What goes with the plateau.
    #[must_use]
    pub fn isovalue(self) -> Isovalue {
        match self {
            Self::Interior { median, .. } => Isovalue::of_plateau(median),
            Self::Shallow { greatest } => Isovalue::of_plateau(greatest),
        }
    }
}

/// From the DIF of a frame to its surface: the smoothing's kernels, and the isovalue, measured where it is `None`.
#[must_use]
pub fn recipe(
    dif: &DifField,
    indicator: Indicator,
    domain: Option<&Domain>,
    sigma: Sigma,
    detail: Detail,
    iso: Option<Isovalue>,
) -> (Recipe, Plateau) {
    let plateau = Plateau::of(dif, &Smoothing::new(indicator, sigma), domain);
    (recipe_at(indicator, sigma, detail, iso.unwrap_or(plateau.isovalue())), plateau)
}

/// The same where the isovalue is known, of whichever frame.
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

/// How often each sample was seen, by its upper and its lower byte: samples lie close together.
struct Histogram {
    pages: [Option<Box<[u64; 256]>>; 256],
}

impl Default for Histogram {
    fn default() -> Self {
        Self { pages: [const { None }; 256] }
    }
}

impl Histogram {
    fn of<T: Sync>(parts: &[T], add: impl Fn(&mut Self, &T) + Sync) -> Self {
        let add = |mut histogram: Self, part: &T| {
            add(&mut histogram, part);
            histogram
        };
        parts.par_iter().fold(Self::default, add).reduce(Self::default, Self::join)
    }

    fn page(&mut self, upper: u8) -> &mut [u64; 256] {
        self.pages[usize::from(upper)].get_or_insert_with(|| Box::new([0; 256]))
    }

    /// Adds those samples of a row whose bit is set.
    fn add(&mut self, row: &[u16], mut chosen: u128) {
        for sample in row {
            if chosen & 1 != 0 {
                let [upper, lower] = sample.to_be_bytes();
                self.page(upper)[usize::from(lower)] += 1;
            }
            chosen >>= 1;
        }
    }

    fn join(mut self, other: Self) -> Self {
        for (upper, page) in (0..=255).zip(other.pages) {
            let Some(page) = page else { continue };
            self.page(upper).iter_mut().zip(*page).for_each(|(a, b)| *a += b);
        }
        self
    }

    /// The samples that were seen, in order, and how often each.
    fn counts(&self) -> impl Iterator<Item = (u16, u64)> + '_ {
        let pages = (0_u8..=255).zip(&self.pages).filter_map(|(upper, page)| Some((upper, page.as_ref()?)));
        let counts = pages.flat_map(|(upper, page)| {
            (0_u8..=255)
                .zip(page.iter())
                .map(move |(lower, &count)| (u16::from_be_bytes([upper, lower]), count))
        });
        counts.filter(|&(_, count)| count > 0)
    }

    /// How many samples were seen.
    fn total(&self) -> u64 {
        self.counts().map(|(_, count)| count).sum()
    }

    /// The lowest value that at least a `share` of the samples does not exceed.
    fn quantile(&self, share: f64) -> Option<u16> {
        let wanted = ((self.total() as f64 * share).ceil() as u64).max(1);
        let mut below = 0;
        let reached = |&(_, count): &(u16, u64)| {
            below += count;
            below >= wanted
        };
        self.counts().find(reached).map(|(sample, _)| sample)
    }
}

/// Half of a box along each axis.
fn middle(cells: &CellBox) -> CellBox {
    let size = cells.size();
    CellBox { lo: cells.lo + size / 4, hi: cells.hi - size / 4 }
}

fn smooth(dif: &DifField, smoothing: &Smoothing, domain: Option<&Domain>, cells: CellBox) -> Block {
    let reach = smoothing.reach();
    smoothing.apply(gather(dif, cells.grown(reach, reach), domain), domain.map(Domain::cells))
}

/// Adds the smoothed DIF over the interior cells among `cells`.
fn add_interior(
    histogram: &mut Histogram,
    dif: &DifField,
    smoothing: &Smoothing,
    domain: Option<&Domain>,
    cells: CellBox,
) {
    // Closing is a dilation and an erosion by one cell, which clouds dilate by themselves; then what decides a cell's
    // field is taken off.
    let dilation = 1 - dif.reach();
    let erosion = 1 + dif.reach() + smoothing.reach();
    let seen = dilation + erosion;
    let wide = gather(dif, cells.grown(seen, seen), domain);
    let [_, width, slab] = wide.strides();
    let mut rows: Vec<u128> = fullness(wide.samples()).chunks_exact(width).map(full_bits).collect();
    windows(&mut rows, slab / width, 2 * dilation + 1, |a, b| a | b);
    windows(&mut rows, slab / width, 2 * erosion + 1, |a, b| a & b);
    // Both windows of a cell begin as far below it as `wide` does below `cells`.
    let CellBox { lo, hi } = cells;
    let among = (1 << (hi.x - lo.x)) - 1;
    let row = |y, z| rows[wide.index(IVec3::new(lo.x, y, z) - seen) / width] & among;
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
    let reach = smoothing.reach();
    let field = smoothing.apply(wide.part(near.grown(reach, reach)), domain.map(Domain::cells));
    for (y, z, bits) in interior {
        let first = field.index(IVec3::new(near.lo.x, y, z));
        histogram.add(&field.samples()[first..][..near.size().x as usize], bits >> (near.lo.x - lo.x));
    }
}

/// Combines every cell, a bit of its row, with those that follow in a cube of so many along each axis. `combine` may see a
/// cell more than once. Cells nearer than that to the end of a row are combined with whatever.
fn windows(rows: &mut [u128], rows_a_slab: usize, width: i32, combine: impl Fn(u128, u128) -> u128) {
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
