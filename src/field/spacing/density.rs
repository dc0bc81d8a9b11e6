//! The particles' spacing from their number density deep in the fluid.
//!
//! The spacing is the edge of the cube that a particle fills: (volume / number)^(1/3). Particles
//! are counted in cells a few spacings wide, but only in cells whose 26 neighbours also hold
//! particles, which excludes surfaces. In thin fluid, even such cells have gaps, so the estimated
//! spacing is too large.

use glam::{DVec3, IVec3};
use hashbrown::HashMap;
use multiversion::multiversion;
use rayon::prelude::*;

use super::sample::SHARE;
use crate::brick::{BinPlan, CountingRoom, InvalidParticles};
use crate::grid::{BIN, Grid};
use crate::particles::Bounds;

/// Target number of particles per counting cell; the smaller numbers are for thin layers.
const TARGETS: [f64; 3] = [48.0, 16.0, 6.0];
/// Minimum number of interior cells for an estimate.
const ENOUGH_CELLS: usize = 8;
/// Maximum number of counting cells. In spray, each particle can occupy its own cell.
const MOST_CELLS: usize = 1 << 24;
/// Maximum number of cells in the box around all particles for which counts are kept in a dense
/// list. The list includes empty cells.
const MOST_LISTED: f64 = (1 << 21) as f64;

/// Number of particles in a parallel task.
const CHUNK: usize = 1 << 16;

/// Number of particles whose cell numbers are computed together.
const AT_ONCE: usize = 256;

/// For each particle, computes the index of its cell in a dense list of cells. The list has the
/// cells of a box, x fastest; the box begins one cell below `origin`.
#[multiversion(targets("x86_64+avx512f+avx512dq", "x86_64+avx2", "x86_64+sse4.1"))]
fn numbers_of(
    positions: &[[f64; 3]],
    origin: [f64; 3],
    cell: f64,
    size: [f64; 3],
    numbers: &mut [u32],
) {
    for (number, position) in numbers.iter_mut().zip(positions) {
        let place = |axis: usize| ((position[axis] - origin[axis]) / cell).floor() + 1.0;
        *number = (place(0) + size[0] * (place(1) + size[1] * place(2))) as i32 as u32;
    }
}

/// The spacings of particles, estimated from the numbers of particles in cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spacings {
    /// The spacing of all particles, as if they were evenly distributed.
    pub mean: f64,
    /// For particles that clearly have two resolutions: the spacing of the majority, and the
    /// spacing of the other particles.
    pub two: Option<[f64; 2]>,
    /// The share of the particles that are deep in evenly filled fluid: in cells whose 26
    /// neighbours hold similar numbers of particles.
    pub even: f64,
}

impl Spacings {
    /// Multiplies the spacings by a factor.
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            mean: self.mean * factor,
            two: self.two.map(|two| two.map(|spacing| spacing * factor)),
            ..self
        }
    }
}

/// Estimates the spacings of finite particles within their bounds; returns `None` if interior cells
/// hold less than `enough_share` of the particles.
pub fn spacings(particles: &[[f64; 3]], bounds: &Bounds, enough_share: f64) -> Option<Spacings> {
    let Bounds { lo, hi, finite } = *bounds;
    let extent = hi - lo;
    let volume: f64 =
        extent.to_array().iter().map(|e| e.max(1e-3 * extent.max_element())).product();
    let mut cell = libm::cbrt(TARGETS[0] * volume / finite as f64);
    if !(cell.is_finite() && cell > 0.0) {
        return None;
    }
    let counts = |origin: DVec3, cell: f64| CellCounts::of(particles, [lo, hi], origin, cell);
    TARGETS.iter().find_map(|&target| {
        let at_corner;
        (cell, at_corner) = cell_for(|cell| counts(lo, cell), target, cell)?;
        let placements = (SHARE / particles.len().max(1)).clamp(1, 8) as u32;
        // The fractional parts of multiples of these numbers are evenly spread. The numbers are the
        // inverse powers of the golden ratio, generalised to three axes.
        let shifts = (0..placements).map(|i| {
            let i = f64::from(i);
            DVec3::new(i * 0.819_172_513, i * 0.671_043_606, i * 0.549_700_478).fract()
        });
        let mut inside = at_corner.interior();
        let even =
            inside.iter().filter(|cell| cell.is_even()).map(|cell| cell.count).sum::<usize>();
        for shift in shifts.skip(1) {
            inside.extend(counts(lo - shift * cell, cell)?.interior());
        }
        let (total, cells) = (total(&inside), inside.len());
        let enough = cells >= ENOUGH_CELLS * placements as usize
            && total as f64 >= enough_share * f64::from(placements) * finite as f64;
        enough.then(|| {
            // In cells of this width, the particles of the coarser resolution may have no interior
            // cells, so this also tries wider cells.
            let wider = || two_of(at_corner.twice_as_wide().interior(), 2.0 * cell);
            Spacings {
                mean: cell * libm::cbrt(cells as f64 / total as f64),
                two: two_of(inside, cell).or_else(wider),
                even: even as f64 / finite as f64,
            }
        })
    })
}

/// A region counts as a separate resolution only if it has at least this share of the fluid's
/// volume or of the fluid's particles.
const REGION: f64 = 0.05;
/// The minimum number of particles in a typical cell of a separate resolution. With fewer particles
/// per cell, the region could be spray.
const ENOUGH_IN_CELL: usize = 4;
/// More than this share of the cells of a separate resolution must have similar counts.
const EVEN: f64 = 0.8;
/// At least this share of the cells of a coarser resolution must have no neighbour with the counts
/// of the majority. Otherwise, these cells may hold a wall that a narrow gap separates from fluid.
const DEEP: f64 = 0.15;

/// A cell whose 26 neighbours also hold particles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct InteriorCell {
    /// The number of particles in the cell.
    count: usize,
    /// The smallest number of particles in the cell or one of its neighbours.
    sparsest: usize,
    /// The greatest number of particles in the cell or one of its neighbours.
    densest: usize,
}

impl InteriorCell {
    /// Whether each neighbour holds between 0.45 and 2.2 times as many particles as this cell. The
    /// limits are wide because the planes of a lattice fill some cells with twice as many particles
    /// as others.
    fn is_even(&self) -> bool {
        20 * self.sparsest >= 9 * self.count && 9 * self.densest <= 20 * self.count
    }
}

/// The number of particles in these cells.
fn total(cells: &[InteriorCell]) -> usize {
    cells.iter().map(|cell| cell.count).sum()
}

/// The spacings of two resolutions, from the counts of interior cells of edge `edge`. There must be
/// two groups of cells with different counts, and fewer cells with counts in between, because a
/// fluid that thins out into spray has cells of every count.
fn two_of(mut inside: Vec<InteriorCell>, edge: f64) -> Option<[f64; 2]> {
    inside.sort_unstable();
    let all = total(&inside);
    let mut below = 0;
    // The median, over all particles, of the count in the particle's cell.
    let typical = inside.iter().find(|cell| {
        below += cell.count;
        2 * below >= all
    })?;
    let typical = typical.count as f64;
    // `between` returns the cells whose counts are from `from` to `to` times `typical`.
    let between = |from: f64, to: f64| {
        let [from, to] = [from, to]
            .map(|bound| inside.partition_point(|cell| (cell.count as f64) < bound * typical));
        &inside[from..to]
    };
    let cells = |part: &[InteriorCell]| part.len() as f64;
    let particles = |part: &[InteriorCell]| total(part) as f64;
    let is_even = |part: &[InteriorCell]| {
        let median = part[part.len() / 2].count;
        let near = part.iter().filter(|cell| cell.count <= 2 * median && median <= 2 * cell.count);
        median >= ENOUGH_IN_CELL && near.count() as f64 > EVEN * cells(part)
    };
    let is_deep = |part: &[InteriorCell]| {
        let deep = part.iter().filter(|cell| (cell.densest as f64) < 0.5 * typical);
        deep.count() as f64 >= DEEP * cells(part)
    };
    let (thin, thinner) = (between(0.25, 0.5), between(0.0, 0.25));
    let (dense, denser) = (between(2.0, 4.0), between(4.0, f64::INFINITY));
    let other = if cells(thinner) >= REGION * cells(&inside)
        && cells(thinner) > 2.0 * cells(thin)
        && is_deep(thinner)
    {
        thinner
    } else if particles(denser) >= REGION * all as f64 && particles(denser) > 2.0 * particles(dense)
    {
        denser
    } else {
        return None;
    };
    let spacing = |part: &[InteriorCell]| edge * libm::cbrt(cells(part) / particles(part));
    is_even(other).then(|| [spacing(between(0.5, 2.0)), spacing(other)])
}

/// Numbers of particles per cell.
enum CellCounts {
    /// For all cells of a box, x fastest.
    Listed { size: [usize; 3], counts: Vec<u32> },
    /// For non-empty cells only.
    Hashed(HashMap<IVec3, usize>),
}

impl CellCounts {
    /// Counts particles between two corners in the cells of edge `cell` that begin at `origin`.
    fn of(particles: &[[f64; 3]], corners: [DVec3; 2], origin: DVec3, cell: f64) -> Option<Self> {
        // Cell numbers begin one below the first cell, so that each cell has neighbours.
        let last = ((corners[1] - origin) / cell).floor() + 1.0;
        let size = (last + 2.0).to_array();
        let is_small = size.iter().product::<f64>() <= MOST_LISTED;
        if !is_small {
            // The counting cells are the bins of a grid whose cells are sixteen times finer.
            let grid = Grid::new(origin, cell / f64::from(BIN)).ok()?;
            let room = CountingRoom { bins: MOST_CELLS, places: 0 };
            let plan =
                BinPlan::count(&particles, &grid, None, InvalidParticles::Skip, room).ok()?;
            return Some(Self::Hashed(
                plan.keys().iter().map(|key| key.coord()).zip(plan.counts()).collect(),
            ));
        }
        let none = || vec![0_u32; size.iter().product::<f64>() as usize];
        let count = |chunk: &[[f64; 3]]| {
            let (mut counts, mut numbers) = (none(), [0; AT_ONCE]);
            for positions in chunk.chunks(AT_ONCE) {
                let numbers = &mut numbers[..positions.len()];
                numbers_of(positions, origin.into(), cell, size, numbers);
                for &number in &*numbers {
                    if let Some(count) = counts.get_mut(number as usize) {
                        *count += 1;
                    }
                }
            }
            counts
        };
        let all = particles.par_chunks(CHUNK).map(count).reduce_with(|mut sum, counts| {
            sum.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
            sum
        });
        let counts = all.unwrap_or_else(none);
        Some(Self::Listed { size: size.map(|size| size as usize), counts })
    }

    /// The counts in cells that are twice as wide and begin at the same corner.
    fn twice_as_wide(&self) -> Self {
        match self {
            Self::Listed { size, counts } => {
                let half = |c: usize| (c - 1) / 2 + 2;
                let wide = size.map(half);
                let mut sums = vec![0; wide.iter().product()];
                for (row, counts) in counts.chunks_exact(size[0]).enumerate() {
                    let [y, z] = [row % size[1], row / size[1]].map(|c| c.div_ceil(2));
                    let first = wide[0] * (y + wide[1] * z);
                    counts
                        .iter()
                        .enumerate()
                        .for_each(|(x, count)| sums[first + x.div_ceil(2)] += count);
                }
                Self::Listed { size: wide, counts: sums }
            }
            Self::Hashed(counts) => {
                let mut sums = HashMap::new();
                counts
                    .iter()
                    .for_each(|(cell, count)| *sums.entry(cell >> 1).or_default() += count);
                Self::Hashed(sums)
            }
        }
    }

    /// The counts of non-empty cells.
    fn filled(&self) -> Vec<usize> {
        match self {
            Self::Listed { counts, .. } => {
                counts.iter().filter(|&&n| n > 0).map(|&n| n as usize).collect()
            }
            Self::Hashed(counts) => counts.values().copied().collect(),
        }
    }

    /// The cells whose 26 neighbours also hold particles.
    fn interior(&self) -> Vec<InteriorCell> {
        match self {
            Self::Listed { size: [x, y, _], counts } => {
                // The smallest and the greatest count around a cell; `None` if any of the counts is
                // 0.
                let around = |index: usize| {
                    let (mut sparsest, mut densest) = (u32::MAX, 0);
                    for layer in [0, x * y, 2 * x * y] {
                        for row in [0, *x, 2 * x] {
                            let first = index + layer + row - x * y - x - 1;
                            for &count in &counts[first..first + 3] {
                                sparsest = sparsest.min(count);
                                densest = densest.max(count);
                            }
                            if sparsest == 0 {
                                return None;
                            }
                        }
                    }
                    Some((sparsest as usize, densest as usize))
                };
                // The outermost layer of cells is empty.
                let inner = x * y + x + 1..counts.len().saturating_sub(x * y + x + 1);
                let inner = inner.filter(|&index| counts[index] > 0);
                let interior = inner.filter_map(|index| {
                    let (sparsest, densest) = around(index)?;
                    Some(InteriorCell { count: counts[index] as usize, sparsest, densest })
                });
                interior.collect()
            }
            Self::Hashed(counts) => {
                let around = |cell: IVec3| {
                    (0..27).try_fold((usize::MAX, 0), |(sparsest, densest), i| {
                        let neighbour = cell + IVec3::new(i % 3, i / 3 % 3, i / 9) - 1;
                        let &count = counts.get(&neighbour)?;
                        Some((count.min(sparsest), count.max(densest)))
                    })
                };
                let interior = counts.iter().filter_map(|(&cell, &count)| {
                    let (sparsest, densest) = around(cell)?;
                    Some(InteriorCell { count, sparsest, densest })
                });
                interior.collect()
            }
        }
    }
}

/// A cell size at which the cell of a typical particle holds about `target` particles, and the
/// counts in such cells.
fn cell_for(
    counts: impl Fn(f64) -> Option<CellCounts>,
    target: f64,
    mut cell: f64,
) -> Option<(f64, CellCounts)> {
    for _ in 0..12 {
        let counted = counts(cell)?;
        let mut sizes = counted.filled();
        sizes.sort_unstable();
        let binned: usize = sizes.iter().sum();
        let mut below = 0;
        let typical = sizes.into_iter().find(|size| {
            below += size;
            2 * below >= binned
        })?;
        if (0.6..1.6).contains(&(typical as f64 / target)) {
            return Some((cell, counted));
        }
        cell *= libm::cbrt(target / typical as f64).clamp(0.1, 10.0);
    }
    Some((cell, counts(cell)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::bounds;

    /// A lattice with a spacing that does not divide a cell.
    fn lattice(side: i32) -> Vec<[f64; 3]> {
        let place = |i: i32| [i % side, i / side % side, i / (side * side)];
        (0..side.pow(3)).map(|i| place(i).map(|c| 1.037 * f64::from(c) - 3.3)).collect()
    }

    fn sorted<T: Ord>(mut items: Vec<T>) -> Vec<T> {
        items.sort_unstable();
        items
    }

    /// The two spacings of the points of a lattice with spacing 1 that `keep` accepts.
    fn two_in_lattice(size: [i32; 3], keep: impl Fn(IVec3) -> bool) -> Option<[f64; 2]> {
        let [x, y, z] = size;
        let points = (0..x * y * z).map(|i| IVec3::new(i % x, i / x % y, i / (x * y)));
        let points: Vec<[f64; 3]> =
            points.filter(|p| keep(*p)).map(|p| p.as_dvec3().to_array()).collect();
        spacings(&points, &bounds(&points).unwrap(), 0.0).unwrap().two
    }

    #[test]
    fn walls_near_fluid_are_not_a_coarser_resolution_but_deep_fluid_is() {
        // The walls and the floor have three layers. The fluid fills a part of the tank.
        let tank = |[x, y, z]: [i32; 3], fluid: IVec3| {
            two_in_lattice([x + 6, y + 3, z + 6], |p| {
                let p = p - 3;
                let is_wall = p.min_element() < 0 || p.x >= x || p.z >= z;
                is_wall || p.cmplt(fluid).all()
            })
        };
        for fluid in [[15, 20, 30], [20, 15, 30], [21, 15, 30], [22, 15, 30], [30, 15, 30]] {
            assert_eq!(tank([30, 30, 30], fluid.into()), None, "{fluid:?}");
        }
        // The right half keeps only every third point along each axis.
        let two = two_in_lattice([120, 48, 48], |p| p.x < 60 || p % 3 == IVec3::ZERO);
        let [fine, coarse] = two.unwrap();
        assert!((fine - 1.0).abs() < 0.1 && (coarse - 3.0).abs() < 0.3, "{fine} and {coarse}");
    }

    #[test]
    fn listed_and_hashed_cells_have_equal_counts() {
        let particles = lattice(23);
        let near = bounds(&particles).unwrap();
        for (shift, cell) in [(0.0, 3.1), (0.7, 2.0), (1.3, 5.5)] {
            let of = |far: f64| {
                CellCounts::of(&particles, [near.lo, near.hi + far], near.lo - shift, cell).unwrap()
            };
            let (listed, hashed) = (of(0.0), of(1e6));
            assert!(
                matches!(listed, CellCounts::Listed { .. })
                    && matches!(hashed, CellCounts::Hashed(_))
            );
            assert_eq!(sorted(listed.filled()), sorted(hashed.filled()));
            assert_eq!(sorted(listed.interior()), sorted(hashed.interior()));
            let twice = [listed.twice_as_wide(), hashed.twice_as_wide()]
                .map(|twice| sorted(twice.interior()));
            assert_eq!(twice[0], twice[1]);
            let wide = CellCounts::of(&particles, [near.lo, near.hi], near.lo - shift, 2.0 * cell)
                .unwrap();
            assert_eq!(twice[0], sorted(wide.interior()));
            assert!(!twice[0].is_empty() && listed.interior().len() > twice[0].len());
        }
    }
}
