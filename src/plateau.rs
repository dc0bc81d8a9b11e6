//! The isovalue that places the surface without bias.
//!
//! At the true surface the smoothed field is 0.47 of its interior plateau ([`Isovalue::PLATEAU_PERCENT`]). The
//! plateau is the median of the smoothed DIF over interior cells: those whose filters see nothing but
//! fluid. A cell counts as fluid when it is full, or lies in a gap that one cell on every side closes,
//! for particles at random leave cells empty in the middle of the fluid.

use glam::IVec3;
use rayon::prelude::*;

use crate::brick::{Block, DifField};
use crate::grid::{CellBox, Domain};
use crate::recipe::{Details, Recipe, gather};
use crate::stage::adaptive::Adaptive;
use crate::stage::blur::{Kernel, Smoothing};
use crate::stage::detail::Detail;
use crate::stage::indicator::Indicator;
use crate::units::{FULL, Isovalue, Sigma};

/// Blocks that are looked at; in a larger frame they are taken at equal steps along the Morton curve.
const SAMPLED_BLOCKS: usize = 64;

/// What the smoothed DIF is like where the fluid is deep.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plateau {
    /// Interior cells were found.
    Interior {
        /// Of the field over the interior cells.
        median: u16,
        /// The least value seen: from there on the interior fills with bubbles.
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
        let step = blocks.len().div_ceil(SAMPLED_BLOCKS).max(1);
        let sampled: Vec<_> = blocks.iter().step_by(step).collect();
        let interior = histogram(&sampled, |&cells| interior_samples(dif, smoothing, domain, cells));
        if let Some(median) = quantile(&interior, 0.5) {
            return Self::Interior { median, lowest: quantile(&interior, 0.0).unwrap_or(median) };
        }
        // A frame without depth is small for its number of blocks, or all of it is spray: look at all.
        let all: Vec<_> = blocks.iter().collect();
        let interior = histogram(&all, |&cells| interior_samples(dif, smoothing, domain, cells));
        match quantile(&interior, 0.5) {
            Some(median) => Self::Interior { median, lowest: quantile(&interior, 0.0).unwrap_or(median) },
            None => {
                let field =
                    histogram(&all, |&cells| smooth(dif, smoothing, domain, cells).samples().to_vec());
                Self::Shallow { greatest: quantile(&field, 1.0).unwrap_or(0) }
            }
        }
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
    let details = match detail {
        Detail::Smoothed => Details::Smoothed,
        Detail::Recovered => Details::Recovered(Kernel::gaussian(sigma.half())),
        Detail::Spared => Details::Spared(Adaptive::new(sigma)),
    };
    Recipe { smoothing: Smoothing::new(indicator, sigma), details, iso }
}

type Histogram = Vec<u64>;

fn histogram<T: Sync>(parts: &[&T], samples: impl Fn(&T) -> Vec<u16> + Sync) -> Histogram {
    let empty = || vec![0; usize::from(FULL) + 1];
    // Histograms are large: few of them, for few threads.
    let share = parts.len().div_ceil(2 * rayon::current_num_threads()).max(1);
    parts
        .par_iter()
        .with_min_len(share)
        .fold(empty, |mut histogram, part| {
            samples(part).into_iter().for_each(|sample| histogram[usize::from(sample)] += 1);
            histogram
        })
        .reduce(empty, |mut a, b| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
            a
        })
}

/// The lowest value that at least a `share` of the samples does not exceed.
fn quantile(histogram: &Histogram, share: f64) -> Option<u16> {
    let total: u64 = histogram.iter().sum();
    let wanted = ((total as f64 * share).ceil() as u64).max(1);
    let mut below = 0;
    histogram
        .iter()
        .position(|&count| {
            below += count;
            below >= wanted
        })
        .map(|value| value as u16)
}

fn smooth(dif: &DifField, smoothing: &Smoothing, domain: Option<&Domain>, cells: CellBox) -> Block {
    let reach = smoothing.reach();
    smoothing.apply(&gather(dif, cells.grown(reach, reach), domain), domain.map(Domain::cells))
}

/// The smoothed DIF over the interior cells among `cells`.
fn interior_samples(
    dif: &DifField,
    smoothing: &Smoothing,
    domain: Option<&Domain>,
    cells: CellBox,
) -> Vec<u16> {
    // Closing is a dilation and an erosion by one cell; then the filters' reach is taken off.
    let closing = 1;
    let erosion = closing + smoothing.reach();
    let seen = cells.grown(erosion + closing, erosion + closing);
    let wide = gather(dif, seen, domain);
    let full: Vec<u8> = wide.samples().iter().map(|&theta| u8::from(theta > 0)).collect();
    let covered = window(&full, wide.strides(), closing, |a, b| a | b);
    let interior = window(&covered, wide.strides(), erosion, |a, b| a & b);
    let interior: Vec<bool> = wide
        .rows(cells)
        .flat_map(|([y, z], row)| {
            let first = wide.index(IVec3::new(cells.lo.x, y, z));
            interior[first..first + row.len()].iter().map(|&inside| inside != 0)
        })
        .collect();
    if !interior.contains(&true) {
        return Vec::new();
    }
    let field = smooth(dif, smoothing, domain, cells);
    let samples = field.samples().iter().zip(interior);
    samples.filter(|&(_, interior)| interior).map(|(&sample, _)| sample).collect()
}

/// Combines every cell with all others within `reach` along each axis. Cells nearer than that to the end of
/// their block are combined with what stands there in memory: whoever calls this leaves them out.
fn window(cells: &[u8], strides: [usize; 3], reach: i32, combine: impl Fn(u8, u8) -> u8) -> Vec<u8> {
    let mut out = cells.to_vec();
    for stride in strides {
        let margin = reach as usize * stride;
        let from = out.clone();
        let middle = margin..out.len() - margin;
        for offset in 0..=2 * reach as usize {
            let shifted = &from[offset * stride..][..middle.len()];
            out[middle.clone()].iter_mut().zip(shifted).for_each(|(to, &from)| *to = combine(*to, from));
        }
    }
    out
}
