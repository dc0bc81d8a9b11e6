//! The oracle of the cloud indicator, whose field consists of distances: implements the formulas on
//! one dense array, as simply as possible.
//!
//! There are two implementations. One uses the library's integers, and the library must equal its
//! result to the bit. The other uses f64. The oracle shares only the committed tables with the
//! library. Cells have edge 1, and the grid's origin is 0.

use glam::{DVec3, IVec3};
use meniscus::internals::field::distance::{AWAY, DEPTHS};
use meniscus::internals::grid::CellBox;

use super::dense::{Dense, Mirrors};

/// The settings of the oracle.
pub struct Distances {
    /// The spacing, in cells.
    pub spacing: f64,
    /// The smoothing width, in spacings.
    pub smooth: f64,
    /// The measured plateau.
    pub plateau: u16,
    pub walls: Option<CellBox>,
}

/// Units of a sample per spacing.
pub const UNITS: f64 = 8192.0;
/// The sample that means distance 0.
pub const ZERO: f64 = 32768.0;

/// Minimum edge of a wide cell, in spacings.
const LEAST_WIDE: f64 = 0.55;
/// The three widths (standard deviations of blurred clouds), relative to the smoothing width, each
/// with the minimum variance of its mask, in squared wide cells. Masks are cut off at `CUT`
/// standard deviations.
const WIDTHS: [(f64, f64); 3] = [(0.625, 0.35), (1.0, 0.85), (1.5, 1.75)];
const CUT: f64 = 2.2;
/// The standard deviation of the mask that averages the distance between the fine and the calm
/// surface, relative to the smoothing width.
const DIFFERENCE_WIDTH: f64 = 0.5625;
const DIFFERENCE_CUT: f64 = 1.7;
/// Minimum variance of all other masks, in squared cells of the field that the mask blurs.
const LEAST_VARIANCE: f64 = 0.35;
/// Maximum distance from the surface, in spacings, that is computed with one width.
const DEEPEST: f64 = 2.5;
/// Maximum distance, in spacings, between the fine and the calm surface.
const FARTHEST_APART: f64 = 1.0;
/// Limits, in spacings, for the distance between the fine and the calm surface. Up to the first
/// limit, the distance counts as noise; from the second on, it counts as shape.
const APART: [f64; 2] = [0.07, 0.14];
/// Depths, in spacings, between which the fine surface is faded out.
const DEEP: [f64; 2] = [0.3, 0.9];
/// Distances of nearby particles outside the calm surface, in spacings. Up to the first distance, a
/// cell gets only the surface of the bulk; from the second distance on, the surface of drops is
/// added completely.
const STANDS_OUT: [f64; 2] = [0.4, 1.0];
/// A wide cell counts as occupied if it contains at least 1 / `PARTS` of a particle's cloud.
const PARTS: f64 = 9.0;
/// Number of bits of precision that the samples of wide cells gain when they are blurred.
const GAIN: u32 = 2;
/// The variance of the spline that interpolates wide cells, in squared wide cells.
const SPLINE: f64 = 0.25;
/// The width (standard deviation) of the blurred clouds of a drop, in spacings.
const DROP: f64 = 0.6;
/// The masks of drops are cut off at this number of standard deviations.
const DROP_CUT: f64 = 2.6;
/// The radius of a drop, in spacings.
const DROP_RADIUS: f64 = 0.55;
/// The radius of a drop is reduced by this number of spacings, divided by the square of the spacing
/// in cells. The first number applies without refinement, the second with refinement.
const LESS_RADIUS: [f64; 2] = [0.29, 0.41];
/// The minimum radius of a drop, in spacings.
const LEAST_RADIUS: f64 = 0.38;

/// Half of a Gaussian mask with this variance and cutoff, from the centre outwards. The full mask
/// sums to 1.
fn gaussian(variance: f64, cut: f64) -> Vec<f64> {
    let reach = (cut * variance.sqrt()).round().max(1.0) as i32;
    let mask = |square: f64| -> Vec<f64> {
        let mask: Vec<f64> =
            (0..=reach).map(|k| (-f64::from(k * k) / (2.0 * square)).exp()).collect();
        let sum = mask[0] + 2.0 * mask[1..].iter().sum::<f64>();
        mask.iter().map(|weight| weight / sum).collect()
    };
    let (mut below, mut above) = (variance / 2.0, 4.0 * variance);
    for _ in 0..60 {
        let middle = (below + above) / 2.0;
        *(if variance_of_mask(&mask(middle)) < variance { &mut below } else { &mut above }) =
            middle;
    }
    mask(below)
}

/// The variance of the mask whose half is `half`.
fn variance_of_mask(half: &[f64]) -> f64 {
    2.0 * (0_u32..).zip(half).map(|(k, weight)| f64::from(k * k) * weight).sum::<f64>()
}

/// Rounds the weights of a mask to integers, in units of 1 / 65536.
fn integers(half: &[f64]) -> Vec<u64> {
    let mut weights: Vec<u64> =
        half.iter().map(|weight| (weight * 65536.0).round() as u64).collect();
    weights[0] = 65536 - 2 * weights[1..].iter().sum::<u64>();
    weights
}

/// The standard deviation of clouds that are blurred with a mask of this variance. The clouds
/// themselves have a variance of 0.25 squared cells.
fn width(variance: f64) -> f64 {
    (variance + 0.25).sqrt()
}

/// The same as [`width`], for a mask in units of 1 / 65536.
fn integer_width(half: &[u64]) -> f64 {
    let moments = (0_u64..).zip(half).map(|(k, weight)| k * k * weight);
    width(2.0 * moments.sum::<u64>() as f64 / 65536.0)
}

/// Blurs a field along each axis. The blur along the last axis adds `gain` bits of precision.
fn blur(field: &Dense<u16>, half: &[u64], gain: u32, walls: Option<Mirrors>) -> Dense<u16> {
    (0..3).fold(field.clone(), |field, axis| {
        let shift = if axis == 2 { 16 - gain } else { 16 };
        let reach = half.len() as i32 - 1;
        Dense::new(field.cells, |cell| {
            let tap = |k: i32| {
                half[k.unsigned_abs() as usize] * u64::from(field.along(cell, (k, axis), walls))
            };
            let sum: u64 = (-reach..=reach).map(tap).sum();
            (((sum + (1 << (shift - 1))) >> shift).min(65535)) as u16
        })
    })
}

/// Interpolates linearly between two entries of a table of 1024 steps.
fn interpolated(table: impl Fn(usize) -> i64, share: i64, bits: u32) -> i64 {
    let (at, between) = ((share / 32) as usize, share % 32);
    let low = table(at) << bits;
    low + ((((table(at + 1) - table(at)) << bits) * between) >> 5)
}

/// The smooth step 3 x^2 - 2 x^3, in units of 1 / 4096, as `value` rises from `begin` to `end`,
/// both in spacings.
fn smooth_step(value: i64, [begin, end]: [f64; 2]) -> i64 {
    let (begin, range) = (units(begin), units(end) - units(begin));
    let slope = ((1_i64 << 28) + range - 1) / range;
    let x = ((value - begin).clamp(0, range) * slope) >> 16;
    (((x * x) >> 8) * (3 * 4096 - 2 * x)) >> 16
}

fn units(spacings: f64) -> i64 {
    (spacings * UNITS).round() as i64
}

/// Maximum distance from a point of the surface to the nearest particle, in wide cells. This is
/// about one spacing. The edge of a wide cell is `edge` spacings.
fn near(edge: f64) -> i32 {
    (1.0 / edge).round().max(1.0) as i32
}

/// The integer that represents one particle in a field of clouds, for a spacing in cells.
pub fn amount(spacing: f64) -> u64 {
    ((32768.0 / (8.0 / spacing.powi(3)).max(1.0)) as u64).max(4)
}

/// The field of the particles' clouds. Each particle adds `amount` in total.
pub fn clouds(
    particles: &[[f64; 3]],
    cells: CellBox,
    walls: Option<CellBox>,
    amount: u64,
) -> Dense<u16> {
    let mut sums = Dense::new(cells, |_| 0_u64);
    let inside = |cell: IVec3| walls.is_none_or(|walls| walls.contains(cell));
    for particle in
        particles.iter().map(|&p| DVec3::from(p)).filter(|p| inside(p.floor().as_ivec3()))
    {
        let cell = particle.floor().as_ivec3();
        let offset = particle - cell.as_dvec3();
        // Divide the particle's amount among three cells along each axis, with the weights of a
        // quadratic B-spline around the particle. A share beyond a wall goes to the cell before the
        // wall.
        let shares = [0, 1, 2].map(|axis: usize| {
            let twice = 2 * (offset[axis] * 8192.0).floor() as u64 + 1;
            let [below, above] = [16384 - twice, twice].map(|length| length * length / 8192);
            let mut shares = [0; 3];
            for (away, share) in [(-1, below), (0, 65536 - below - above), (1, above)] {
                let mut to = cell;
                to[axis] += away;
                let within = walls.map_or(to, |walls| to.clamp(walls.lo, walls.hi - 1));
                shares[(within[axis] - cell[axis] + 1) as usize] += share;
            }
            shares
        });
        let part = |amount: u64, share: u64| (amount * share + 32768) / 65536;
        for away in CellBox::cube(IVec3::ZERO, 3).cubes(1) {
            let share = |axis: usize| shares[axis][away[axis] as usize];
            let share = part(part(part(amount, share(2)), share(1)), share(0));
            *sums.nearest(cell + away - 1) += share;
        }
    }
    Dense { cells, values: sums.values.iter().map(|&sum| sum.min(65535) as u16).collect() }
}

/// Sums a field into cells twice as wide. Multiplies the sums by `factor`, in units of 1 / 65536.
fn halved(field: &Dense<u16>, walls: Option<Mirrors>, factor: u64) -> Dense<u16> {
    let cells = CellBox { lo: field.cells.lo >> 1, hi: (field.cells.hi + 1) >> 1 };
    Dense::new(cells, |wide| {
        let weight = |away: IVec3| {
            [1, 3, 3, 1][away.x as usize]
                * [1, 3, 3, 1][away.y as usize]
                * [1, 3, 3, 1][away.z as usize]
        };
        let tap = |away: IVec3| weight(away) * u64::from(field.at(2 * wide - 1 + away, walls));
        let sum: u64 = CellBox::cube(IVec3::ZERO, 4).cubes(1).map(tap).sum();
        ((sum * factor + (1 << 21)) >> 22).min(65535) as u16
    })
}

impl Distances {
    /// The level of the wide cells, and their edge in spacings.
    fn wide(&self) -> (u32, f64) {
        let mut wide = (0, 1.0 / self.spacing);
        while wide.1 < LEAST_WIDE - 1e-9 {
            wide = (wide.0 + 1, 2.0 * wide.1);
        }
        wide
    }

    /// The cells between the walls or, without walls, all cells that the field can reach. Without
    /// walls, the box consists of complete wide cells.
    fn cells(&self, particles: &[[f64; 3]]) -> CellBox {
        self.walls.unwrap_or_else(|| {
            // Add the distance of a surface from a particle, the reach of the mask that averages
            // values, and one cell for the spline.
            let (level, edge) = self.wide();
            let reach = (near(edge) + self.around(edge).len() as i32 + 2) << level;
            let around = particles
                .iter()
                .map(|&p| DVec3::from(p).floor().as_ivec3())
                .fold(CellBox::EMPTY, |all, cell| all.union(&CellBox { lo: cell, hi: cell + 1 }));
            let edge = IVec3::splat(1 << level);
            let CellBox { lo, hi } = around.grown(reach, reach);
            CellBox { lo: lo.div_euclid(edge) * edge, hi: (hi.div_euclid(edge) + 1) * edge }
        })
    }

    /// The masks of the three widths, for wide cells with this edge in spacings.
    fn widths(&self, edge: f64) -> [Vec<f64>; 3] {
        WIDTHS.map(|(times, least)| {
            let cells = times * self.smooth / edge;
            gaussian((cells * cells - 0.25).max(least), CUT)
        })
    }

    /// The mask that averages the distance between the fine and the calm surface.
    fn around(&self, edge: f64) -> Vec<f64> {
        gaussian(
            (DIFFERENCE_WIDTH * self.smooth / edge).powi(2).max(LEAST_VARIANCE),
            DIFFERENCE_CUT,
        )
    }

    /// The variance that the spline between wide cells adds, in squared spacings.
    fn spline(&self, edge: f64) -> f64 {
        if self.wide().0 > 0 { SPLINE / 2.0 * edge * edge } else { 0.0 }
    }

    /// Computes the field in the library's integers. Wide cells for which `inside` returns true get
    /// the maximum sample instead of a computed one.
    pub fn integer(&self, particles: &[[f64; 3]], inside: impl Fn(IVec3) -> bool) -> Dense<u16> {
        let (level, edge) = self.wide();
        let cells = self.cells(particles);
        let fine = clouds(particles, cells, self.walls, amount(self.spacing));
        // Clouds at every level of wide cells, each with the walls in cells of that level.
        let mut clouds = vec![(fine, self.walls.map(Mirrors::of))];
        for level in 0..level {
            let of = |level: u32| amount(self.spacing / f64::from(1 << level)) as f64;
            let (finer, walls) = clouds.last().expect("level 0 always exists");
            let wider = halved(finer, *walls, (of(level + 1) / of(level) * 65536.0) as u64);
            let walls = walls.map(Mirrors::wider);
            clouds.push((wider, walls));
        }
        let (wide, walls) = clouds.last().expect("level 0 always exists");
        let (bulk, outlying) = self.bulk(wide, *walls, edge, inside);
        let [bulk, outlying] = [bulk, outlying].map(|field| refined(&field, level, cells, *walls));
        // Compute drops in cells half as wide as wide cells. If wide cells are as wide as the
        // grid's cells, compute drops in the grid's cells.
        let level = level.max(1) - 1;
        let (fine, walls) = &clouds[level as usize];
        let drops = Drops::new(self.spacing / f64::from(1 << level), level > 0);
        let shares = refined(&drops.shares(fine, *walls), level, cells, *walls);
        drops.joined(&shares, &bulk, &outlying)
    }

    /// Computes, for each wide cell, the distance from the surface of the bulk, and how far nearby
    /// particles lie outside the calm surface.
    fn bulk(
        &self,
        wide: &Dense<u16>,
        walls: Option<Mirrors>,
        edge: f64,
        inside: impl Fn(IVec3) -> bool,
    ) -> (Dense<u16>, Dense<u16>) {
        let widths = self.widths(edge).map(|half| {
            let half = integers(&half);
            let width = (integer_width(&half) * edge * 4096.0).round() as i64;
            (blur(wide, &half, GAIN, walls), width)
        });
        let scale = ((f64::from(1 << 29) / f64::from(self.plateau)).round() as i64).min(65535);
        let depth = |which: usize, cell: IVec3| {
            let (field, width) = &widths[which];
            let share = ((i64::from(field.at(cell, None)) * scale) >> 14).min(32768);
            let deviations = {
                let (at, between) = ((share / 32) as usize, share % 32);
                let [low, high] = [at, at + 1].map(|at| i64::from(DEPTHS[at]));
                4 * low + (((high - low) * between) >> 3)
            };
            let most = (units(DEEPEST) << 14) / width;
            (deviations.clamp(-most, most) * width) >> 14
        };
        let spline = self.spline(edge) * 4096.0 * 4096.0;
        let share = |narrow: usize| {
            let [a, b] = [narrow, narrow + 1].map(|which| (widths[which].1 as f64).powi(2));
            ((a + spline) / (b - a) * 4096.0).round() as i64
        };
        let surface = |narrow: usize| {
            let share = share(narrow);
            Dense::new(wide.cells, |cell| {
                let [near, far] = [narrow, narrow + 1].map(|which| depth(which, cell));
                (near + (((near - far) * share + 2048) >> 12) + 32768).clamp(1, 65535) as u16
            })
        };
        let [fine, calm] = [surface(0), surface(1)];
        let [of_fine, of_calm] = [&fine, &calm].map(|field| |cell| i64::from(field.at(cell, None)));
        let farthest = units(FARTHEST_APART);
        let apart = Dense::new(wide.cells, |cell| {
            ((of_fine(cell) - of_calm(cell)).clamp(-farthest, farthest) + 32768) as u16
        });
        let apart = blur(&apart, &integers(&self.around(edge)), 0, walls);
        let mixed = Dense::new(wide.cells, |cell| {
            let distance = (i64::from(apart.at(cell, None)) - 32768).abs();
            let shallow = 4096 - smooth_step(of_calm(cell) - 32768, DEEP);
            let share = (smooth_step(distance, APART) * shallow) >> 12;
            (of_calm(cell) + (((of_fine(cell) - of_calm(cell)) * share + 2048) >> 12)) as u16
        });
        let least = ((amount(1.0 / edge) as f64 / PARTS) as u16).max(1);
        let outlying = Dense::new(wide.cells, |cell| {
            if wide.at(cell, None) >= least { (65535 - of_calm(cell)).max(1) as u16 } else { 0 }
        });
        let reach = near(edge);
        let outlying = (0..3).fold(outlying, |field, axis| {
            Dense::new(field.cells, |cell| {
                let taps = (-reach..=reach).map(|k| field.along(cell, (k, axis), walls));
                taps.max().unwrap_or(0)
            })
        });
        let bulk = Dense::new(wide.cells, |cell| match outlying.at(cell, None) {
            _ if inside(cell) => u16::MAX,
            0 => 0,
            _ => mixed.at(cell, None),
        });
        (bulk, outlying)
    }
}

/// The surface around single particles and small groups.
struct Drops {
    /// The spacing, in cells.
    spacing: f64,
    around: Vec<f64>,
    spread: Vec<f64>,
    radius: f64,
}

impl Drops {
    /// Creates the masks for a spacing in cells. `refined` says whether a spline refines the
    /// result.
    fn new(spacing: f64, refined: bool) -> Self {
        let variance = (DROP * spacing).powi(2) - 0.25;
        let spline = if refined { SPLINE } else { 0.0 };
        let less = LESS_RADIUS[usize::from(refined)];
        Self {
            spacing,
            around: gaussian(variance.max(LEAST_VARIANCE), DROP_CUT),
            spread: gaussian((variance - spline).max(LEAST_VARIANCE), DROP_CUT),
            radius: (DROP_RADIUS - less / spacing.powi(2)).max(LEAST_RADIUS),
        }
    }

    /// The number of bits of precision that averages gain, and the number of bits of a share.
    fn bits(&self) -> (u32, u32) {
        let amount = amount(self.spacing) as f64;
        let alone = amount
            / (integer_width(&integers(&self.around)) * std::f64::consts::TAU.sqrt()).powi(3);
        let doublings = |value: f64, most: f64| {
            (0..15).take_while(|&n| value * 2_f64.powi(n + 1) <= most).count() as u32
        };
        let gain = doublings(alone, 4096.0);
        (gain, doublings(27.0 / 64.0 * amount / (alone * 2_f64.powi(gain as i32)), 49152.0))
    }

    /// Computes each cell's share of the clouds around it, and blurs the shares.
    fn shares(&self, clouds: &Dense<u16>, walls: Option<Mirrors>) -> Dense<u16> {
        let (gain, bits) = self.bits();
        let around = blur(clouds, &integers(&self.around), gain, walls);
        let shares = Dense::new(clouds.cells, |cell| {
            let [own, all] = [clouds, &around].map(|field| u64::from(field.at(cell, None)));
            ((own << bits) / all.max(1)).min(65535) as u16
        });
        blur(&shares, &integers(&self.spread), (15 + gain).saturating_sub(bits).min(15), walls)
    }

    /// Joins the surface of the bulk with the surface of drops, where nearby particles lie far
    /// enough outside the calm surface (`STANDS_OUT`).
    fn joined(&self, shares: &Dense<u16>, bulk: &Dense<u16>, outlying: &Dense<u16>) -> Dense<u16> {
        let width = units(integer_width(&integers(&self.around)) / self.spacing);
        Dense::new(shares.cells, |cell| {
            let [bulk, outlying] = [bulk, outlying].map(|field| i64::from(field.at(cell, None)));
            let weight = smooth_step(outlying - 32768, STANDS_OUT);
            if weight == 0 {
                return bulk as u16;
            }
            let share = i64::from(shares.at(cell, None)).min(32768);
            let away = interpolated(|at| AWAY[at].into(), share, 0);
            let out = (units(self.radius) - ((away * width) >> 12) + 32768 - bulk).max(0);
            (bulk + ((out * weight + 2048) >> 12)).clamp(1, 65535) as u16
        })
    }
}

/// Interpolates wide cells at the centres of cells, by a quadratic B-spline whose control points
/// are the wide cells.
fn refined(wide: &Dense<u16>, level: u32, cells: CellBox, walls: Option<Mirrors>) -> Dense<u16> {
    if level == 0 {
        return wide.clone();
    }
    let mut field = wide.clone();
    for axis in 0..3 {
        let mut to = field.cells;
        (to.lo[axis], to.hi[axis]) = (cells.lo[axis], cells.hi[axis]);
        field = Dense::new(to, |cell| {
            let (edge, at) =
                (2_u64 << level, 2 * u64::from(cell[axis] as u32 & ((1 << level) - 1)) + 1);
            let [below, above] = [(edge - at).pow(2), at.pow(2)];
            let weights = [below, 2 * edge * edge - below - above, above];
            let mut own = cell;
            own[axis] >>= level;
            let tap = |k: i32| u64::from(field.along(own, (k, axis), walls));
            let sum: u64 = (-1..=1).map(|k| weights[(k + 1) as usize] * tap(k)).sum();
            ((sum + (edge * edge)) / (2 * edge * edge)) as u16
        });
    }
    field
}

/// The inverse of the standard normal distribution, with the cutoff of the committed table.
pub fn quantile(share: f64) -> f64 {
    let share = share.clamp(0.0002, 0.9998);
    let density = |z: f64| (-z * z / 2.0).exp() / std::f64::consts::TAU.sqrt();
    // The distribution function, as a series around 0.
    let below = |z: f64| {
        let next = |(term, k): (f64, f64)| (term * z * z / (2.0 * k + 1.0), k + 1.0);
        let terms = std::iter::successors(Some((z, 1.0)), |&term| Some(next(term)));
        0.5 + density(z) * terms.take(60).map(|(term, _)| term).sum::<f64>()
    };
    (0..12).fold(0.0, |z, _| z + (share - below(z)) / density(z))
}

/// The distance from the centre at which the standard normal density has this share of its maximum,
/// with the cutoff of the committed table.
pub fn away(share: f64) -> f64 {
    (-2.0 * share.clamp(0.0001, 1.0).ln()).sqrt()
}

/// The quadratic B-spline.
fn b_spline(x: f64) -> f64 {
    match x.abs() {
        x if x < 0.5 => 0.75 - x * x,
        x if x < 1.5 => (1.5 - x) * (1.5 - x) / 2.0,
        _ => 0.0,
    }
}

/// The smooth step 3 x^2 - 2 x^3, as `value` rises from `begin` to `end`.
fn smooth_step_f64(value: f64, [begin, end]: [f64; 2]) -> f64 {
    let x = ((value - begin) / (end - begin)).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

fn blurred_f64(field: &Dense<f64>, half: &[f64], walls: Option<Mirrors>) -> Dense<f64> {
    let reach = half.len() as i32 - 1;
    (0..3).fold(field.clone(), |field, axis| {
        Dense::new(field.cells, |cell| {
            let tap =
                |k: i32| half[k.unsigned_abs() as usize] * field.along(cell, (k, axis), walls);
            (-reach..=reach).map(tap).sum()
        })
    })
}

fn refined_f64(
    wide: &Dense<f64>,
    level: u32,
    cells: CellBox,
    walls: Option<Mirrors>,
) -> Dense<f64> {
    if level == 0 {
        return wide.clone();
    }
    let edge = f64::from(1 << level);
    (0..3).fold(wide.clone(), |field, axis| {
        let mut to = field.cells;
        (to.lo[axis], to.hi[axis]) = (cells.lo[axis], cells.hi[axis]);
        Dense::new(to, |cell| {
            let at = (f64::from(cell[axis]) + 0.5) / edge;
            let mut own = cell;
            own[axis] = at.floor() as i32;
            let tap = |k: i32| {
                let away = at.floor() + f64::from(k) + 0.5 - at;
                b_spline(away) * field.along(own, (k, axis), walls)
            };
            (-1..=1).map(tap).sum()
        })
    })
}

impl Distances {
    /// The clouds at every level in f64, each with the walls at that level. A value is the number
    /// of particles in a cell, clamped to the maximum of an integer sample.
    fn real_clouds(&self, particles: &[[f64; 3]]) -> Vec<(Dense<f64>, Option<Mirrors>)> {
        let clamped = |level: u32, cloud: Dense<f64>| {
            let most = 65535.0 / amount(self.spacing / f64::from(1 << level)) as f64;
            Dense {
                cells: cloud.cells,
                values: cloud.values.iter().map(|value| value.min(most)).collect(),
            }
        };
        let mut fine = Dense::new(self.cells(particles), |_| 0.0_f64);
        let inside = |cell: IVec3| self.walls.is_none_or(|walls| walls.contains(cell));
        for particle in
            particles.iter().map(|&p| DVec3::from(p)).filter(|p| inside(p.floor().as_ivec3()))
        {
            for away in CellBox::cube(IVec3::ZERO, 3).cubes(1) {
                let to = particle.floor().as_ivec3() + away - 1;
                let from = to.as_dvec3() + 0.5 - particle;
                let share: f64 = from.to_array().into_iter().map(b_spline).product();
                *fine.nearest(to) += share;
            }
        }
        let mut clouds = vec![(clamped(0, fine), self.walls.map(Mirrors::of))];
        for level in 1..=self.wide().0 {
            let (finer, walls) = clouds.last().expect("level 0 always exists");
            let to = CellBox { lo: finer.cells.lo >> 1, hi: (finer.cells.hi + 1) >> 1 };
            let wider = Dense::new(to, |cell| {
                let tap = |away: IVec3| {
                    let weight = |k: i32| [0.25, 0.75, 0.75, 0.25][k as usize];
                    let weight: f64 = away.to_array().into_iter().map(weight).product();
                    weight * finer.at(2 * cell - 1 + away, *walls)
                };
                CellBox::cube(IVec3::ZERO, 4).cubes(1).map(tap).sum()
            });
            let walls = walls.map(Mirrors::wider);
            clouds.push((clamped(level, wider), walls));
        }
        clouds
    }

    /// Computes the density of wide cells in f64, blurred with the narrowest width, in particles
    /// per cubed spacing. Also returns the level: wide cells are 2^level times as wide as cells.
    pub fn density(&self, particles: &[[f64; 3]]) -> (Dense<f64>, u32) {
        let (level, edge) = self.wide();
        let (wide, walls) = self.real_clouds(particles).pop().expect("level 0 always exists");
        let [narrowest, ..] = self.widths(edge);
        let smooth = blurred_f64(&wide, &narrowest, walls);
        let values = smooth.values.iter().map(|particles| particles / edge.powi(3)).collect();
        (Dense { cells: smooth.cells, values }, level)
    }

    /// Computes the field in f64: the distance in spacings, or -4 far from all particles.
    pub fn real(&self, particles: &[[f64; 3]]) -> Dense<f64> {
        let (level, edge) = self.wide();
        let cells = self.cells(particles);
        let clouds = self.real_clouds(particles);
        let (wide, walls) = clouds.last().expect("level 0 always exists");
        let (bulk, near) = self.real_bulk(wide, *walls, edge);
        let [bulk, near] = [bulk, near].map(|field| refined_f64(&field, level, cells, *walls));

        let level = level.max(1) - 1;
        let (fine, walls) = &clouds[level as usize];
        let drops = Drops::new(self.spacing / f64::from(1 << level), level > 0);
        let around = blurred_f64(fine, &drops.around, *walls);
        let shares = Dense::new(fine.cells, |cell| match fine.at(cell, None) {
            0.0 => 0.0,
            cloud => cloud / around.at(cell, None),
        });
        let shares = blurred_f64(&shares, &drops.spread, *walls);
        let shares = refined_f64(&shares, level, cells, *walls);
        let width = width(variance_of_mask(&drops.around)) / drops.spacing;
        Dense::new(cells, |cell| {
            let share = shares.at(cell, None);
            let [bulk, near] = [&bulk, &near].map(|field| field.at(cell, None) - 4.0);
            let out = (drops.radius - away(share) * width - bulk).max(0.0);
            bulk + out * smooth_step_f64(near, STANDS_OUT)
        })
    }

    /// Computes the distance from the surface of the bulk, and how far nearby particles lie outside
    /// the calm surface. Both values are increased by 4, and are 0 far from all particles.
    fn real_bulk(
        &self,
        wide: &Dense<f64>,
        walls: Option<Mirrors>,
        edge: f64,
    ) -> (Dense<f64>, Dense<f64>) {
        // `self.plateau` is the integer sample of a wide cell deep in the fluid, which filters have
        // multiplied by 2^`GAIN`. The quotient is the number of particles per wide cell.
        let plateau = f64::from(self.plateau) / (f64::from(1 << GAIN) * amount(1.0 / edge) as f64);
        let depths = self.widths(edge).map(|half| {
            let width = width(variance_of_mask(&half)) * edge;
            let smooth = blurred_f64(wide, &half, walls);
            let depth =
                |cell| (quantile(smooth.at(cell, None) / plateau) * width).clamp(-DEEPEST, DEEPEST);
            (Dense::new(wide.cells, depth), width)
        });
        let surface = |narrow: usize| {
            let [(near, a), (far, b)] = [&depths[narrow], &depths[narrow + 1]];
            let share = (a * a + self.spline(edge)) / (b * b - a * a);
            Dense::new(wide.cells, |cell| {
                let [near, far] = [near, far].map(|depth| depth.at(cell, None));
                (near + (near - far) * share).clamp(-4.0, 4.0)
            })
        };
        let [fine, calm] = [surface(0), surface(1)];
        let apart = Dense::new(wide.cells, |cell| {
            (fine.at(cell, None) - calm.at(cell, None)).clamp(-FARTHEST_APART, FARTHEST_APART)
        });
        let apart = blurred_f64(&apart, &self.around(edge), walls);
        let outlying = Dense::new(wide.cells, |cell| {
            if wide.at(cell, None) >= 1.0 / PARTS { 4.0 - calm.at(cell, None) } else { 0.0 }
        });
        let reach = near(edge);
        let near = (0..3).fold(outlying, |field, axis| {
            Dense::new(field.cells, |cell| {
                let taps = (-reach..=reach).map(|k| field.along(cell, (k, axis), walls));
                taps.fold(0.0, f64::max)
            })
        });
        let bulk = Dense::new(wide.cells, |cell| {
            if near.at(cell, None) <= 0.0 {
                return 0.0;
            }
            let [fine, calm, apart] = [&fine, &calm, &apart].map(|field| field.at(cell, None));
            4.0 + calm
                + (fine - calm)
                    * smooth_step_f64(apart.abs(), APART)
                    * (1.0 - smooth_step_f64(calm, DEEP))
        });
        (bulk, near)
    }
}
