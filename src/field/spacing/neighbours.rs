//! Distances between nearest neighbours. They give the spacing where counting fails: in thin fluid,
//! and for few particles.
//!
//! Deep in the fluid, the distance to the k-th neighbour measures the density: a ball of that
//! radius holds about k particles (Mack and Rosenblatt 1979,
//! <https://doi.org/10.1016/0047-259X(79)90065-4>). If the measured spacings are averaged over k =
//! 8 to 20, the error is within 3 % for lattices and randomly placed particles, and within 6 % for
//! a compressed liquid. A particle counts as deep if its neighbours surround it: their centroid is
//! near, and their second moments are nearly equal in all directions. In a sheet, the same applies
//! within its plane.

use std::f64::consts::PI;
use std::ops::{Range, RangeInclusive};

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::sample::{NeighbourSample, distinct};

/// Number of neighbours per query.
const NEIGHBOURS: usize = 20;
/// The neighbours whose distances give the density of deep particles. Over this range, the errors
/// due to the shells of a lattice cancel out.
const OF_SOLID: RangeInclusive<usize> = 8..=NEIGHBOURS;
/// The neighbours whose distances give the density in the plane of a sheet.
const OF_SHEET: RangeInclusive<usize> = 4..=8;
/// The neighbours whose distances give the density if all particles lie in a plane.
const OF_PLANE: RangeInclusive<usize> = 4..=NEIGHBOURS;
/// The factor by which the neighbours of a particle in a plane are farther away than they would be
/// if the particles were placed at random. With this factor, the error of the spacing is within
/// 1.5 % for lattices, with or without jitter.
const FARTHER: f64 = 1.03;
/// A particle is deep only if the distance to the centroid of its neighbours is less than this
/// share of the distance to the farthest neighbour.
const CENTRED: f64 = 0.2;
/// The minimum of 27 det / trace^3 of the second moments of surrounding neighbours. This measure is
/// 1 if the moments are equal along all axes, and 0 in a plane.
const ROUND: f64 = 0.5;
/// Neighbours lie in a plane if the measure of [`ROUND`] is below this value.
const FLAT: f64 = 0.2;
/// Neighbours in a plane surround the particle if 4 (sum of principal minors) / trace^2 exceeds
/// this value. The measure is 1 in a disc, and 0 on a line.
const DISC: f64 = 0.6;
/// Positions with a greater scatter than this are random. The scatter of random positions is 1;
/// FLIP particles that were seeded eight per cell have a scatter of 0.8.
const RANDOM: f64 = 0.9;
/// The maximum error of a scatter that is measured on few particles.
const SCATTER_ERROR: f64 = 0.2;
/// The minimum number of deep particles for a reliable scatter.
const ENOUGH_FOR_SCATTER: usize = 100;
/// In sheets of a single layer, more than this share of the neighbourhoods is flat.
const SHEETS: f64 = 0.6;
/// Along filaments of single particles, the third neighbour is farther away than the second by more
/// than this factor.
const FILAMENT: f64 = 1.35;
/// The spacings from counting and from neighbours agree if they differ by less than this factor.
const AGREED: f64 = 1.07;
/// The minimum share of the queried particles that an estimate must be based on.
const ENOUGH_SHARE: f64 = 0.04;
/// The minimum number of particles that an estimate must be based on.
const ENOUGH: usize = 8;
/// The minimum number of queried particles.
const FEWEST_QUERIES: usize = 300;
/// The maximum number of queried particles.
const MOST_QUERIES: usize = 2048;
/// Within these limits, one particle in `PARTICLES_PER_QUERY` is queried.
const PARTICLES_PER_QUERY: usize = 32;
/// The number of queried particles if fewer queries suggest random positions.
const QUERIES_OF_RANDOM: usize = 4096;

/// Distances between nearest neighbours in a sample of particles.
#[derive(Debug, Clone, PartialEq)]
pub struct Neighbours {
    /// Number of particles whose neighbours were searched.
    pub queried: usize,
    /// The median distances to the first four neighbours, among the most densely packed particles.
    pub nearest: Option<[f64; 4]>,
    /// The spacing from the density around particles that are surrounded by neighbours, and the
    /// share of such particles among the queried particles.
    pub solid: Option<(f64, f64)>,
    /// The spacing from the density around each particle that is surrounded by neighbours, in
    /// ascending order.
    pub(super) solids: Vec<f64>,
    /// The spacing from the density in the plane of single-layer sheets, if most particles are in
    /// such sheets.
    pub sheet: Option<f64>,
    /// The spacing from the density in the plane, if all particles lie in a plane.
    pub plane: Option<f64>,
    /// The scatter of the density, relative to that of randomly placed particles, for 12 and for 20
    /// neighbours.
    pub scatter: Option<[f64; 2]>,
    /// A lower bound of the number of particles in the sample that coincide with another particle.
    pub coincident: usize,
}

/// The neighbours of one particle.
struct Neighbourhood {
    /// The distances to the neighbours in ascending order; infinite beyond the range that the
    /// sample covers.
    distances: [f64; NEIGHBOURS],
    /// Whether the neighbours surround the particle.
    solid: bool,
    /// Whether the neighbours lie in a plane.
    flat: bool,
    /// Whether the nearest neighbours surround the particle in a plane.
    sheet: bool,
    /// Whether all neighbours surround the particle in a plane.
    plane: bool,
}

impl Neighbours {
    /// Searches a sample of a few cubes. Returns `None` if the sample does not confirm `spacing`,
    /// has coincident particles, or may be randomly placed. In these cases, more cubes must be
    /// searched.
    pub fn of_few(sample: NeighbourSample, spacing: f64) -> Option<Self> {
        let few = Self::of(sample);
        (few.confirms(spacing) && few.coincident == 0 && !few.may_be_random()).then_some(few)
    }

    /// Searches a few of a sample's cubes, and all of them if the few do not confirm the counted
    /// spacing.
    pub fn for_check(mut sample: NeighbourSample, counted: Option<f64>) -> Self {
        let few = std::mem::take(&mut sample.few);
        let few = NeighbourSample {
            cubes: sample.cubes,
            coincident: sample.coincident,
            ..NeighbourSample::whole(few)
        };
        counted.and_then(|counted| Self::of_few(few, counted)).unwrap_or_else(|| Self::of(sample))
    }

    /// Searches a sample for neighbours.
    pub fn of(sample: NeighbourSample) -> Self {
        let NeighbourSample { positions, cubes, coincident, .. } = sample;
        let all = positions.len() + coincident;
        let positions = distinct(positions);
        let coincident = all - positions.len();
        let wanted = (positions.len() / PARTICLES_PER_QUERY).clamp(FEWEST_QUERIES, MOST_QUERIES);
        let covered = |&point: &[f64; 3]| {
            let covered = cubes.map_or(Some(f64::INFINITY), |of| of.covered_around(point))?;
            Some((point, covered))
        };
        let mut queries = positions
            .iter()
            .filter_map(covered)
            .take(QUERIES_OF_RANDOM.max(wanted))
            .collect::<Vec<_>>();
        let more = queries.split_off(wanted.min(queries.len()));
        let tree = PointTree::new(positions);
        let found = |queries: Vec<([f64; 3], f64)>| {
            queries.into_par_iter().map(|(point, covered)| Neighbourhood::of(&tree, point, covered))
        };
        let few: Vec<Neighbourhood> = found(queries).collect();
        let by_few = Self::from_neighbourhoods(&few, coincident);
        if more.is_empty() || by_few.scatter.is_none() || !by_few.may_be_random() {
            return by_few;
        }
        let all: Vec<Neighbourhood> = few.into_par_iter().chain(found(more)).collect();
        Self::from_neighbourhoods(&all, coincident)
    }

    fn from_neighbourhoods(all: &[Neighbourhood], coincident: usize) -> Self {
        let queried = all.len();
        let enough =
            |count: usize| count >= ENOUGH && count as f64 >= ENOUGH_SHARE * queried as f64;
        // Only the most densely packed particles count, according to the distance to their third
        // neighbours, so that spray around the fluid does not affect the estimate.
        let mut thirds: Vec<f64> =
            all.iter().map(|of| of.distances[2]).filter(|d| d.is_finite()).collect();
        thirds.sort_unstable_by(f64::total_cmp);
        let packed = densest(&thirds).unwrap_or(f64::INFINITY);
        let packed: Vec<&Neighbourhood> =
            all.iter().filter(|of| of.distances[2] <= 2.0 * packed).collect();
        let nearest = (packed.len() >= 4).then(|| {
            [0, 1, 2, 3].map(|k| {
                median(packed.iter().map(|of| of.distances[k]).collect()).unwrap_or_default()
            })
        });
        let solid: Vec<&Neighbourhood> = all.iter().filter(|of| of.solid).collect();
        let density = |of: &&Neighbourhood| of.spacing(OF_SOLID, |k| libm::cbrt(k * 0.75 / PI));
        let mut solids: Vec<f64> = solid.iter().map(density).collect();
        solids.sort_unstable_by(f64::total_cmp);
        let by_solid = densest(&solids).filter(|_| enough(solids.len()));
        let flat = packed.iter().filter(|of| of.flat).count() as f64;
        let sheet: Vec<f64> = packed
            .iter()
            .filter(|of| of.sheet)
            .map(|of| of.spacing(OF_SHEET, |k| (k / PI).sqrt()))
            .collect();
        let plane = all
            .iter()
            .filter(|of| of.plane)
            .map(|of| of.spacing(OF_PLANE, |k| FARTHER * (k / PI).sqrt()));
        let plane: Vec<f64> = plane.collect();
        Self {
            queried,
            plane: enough(plane.len()).then(|| median(plane)).flatten(),
            nearest: nearest.filter(|nearest| nearest[2].is_finite() && nearest[2] > 0.0),
            solid: by_solid.map(|spacing| (spacing, solid.len() as f64 / queried as f64)),
            sheet: (enough(sheet.len()) && flat > SHEETS * packed.len() as f64)
                .then(|| median(sheet))
                .flatten(),
            scatter: (solid.len() >= ENOUGH_FOR_SCATTER)
                .then(|| [12, 20].map(|k| scatter(&solid, k))),
            solids,
            coincident,
        }
    }

    /// Whether part of the fluid is deep, and as dense as the spacing implies.
    pub fn has_solid(&self, spacing: f64) -> bool {
        const LEAST_FITTING_SHARE: f64 = 0.02;
        let below = |ratio: f64| self.solids.partition_point(|&solid| solid < ratio * spacing);
        let fitting = below(1.25) - below(0.8);
        fitting >= ENOUGH && fitting as f64 >= LEAST_FITTING_SHARE * self.queried as f64
    }

    /// The spacing that the distances to the nearest neighbours suggest, even if few particles were
    /// queried.
    pub fn suggested(&self) -> Option<f64> {
        let [first, second, third, fourth] = self.nearest?;
        // In an ordered fluid, three or four neighbours are about a spacing away; in a compressed
        // liquid, they are somewhat closer. In a disordered fluid, the fourth neighbour is farther
        // away.
        let order = ((first / fourth - 0.7) / 0.2).clamp(0.0, 1.0);
        let near = third + order * (fourth - third);
        let suggested = if third > FILAMENT * second {
            (first + second) / 2.0
        } else {
            self.sheet.filter(|sheet| (0.8..1.25).contains(&(sheet / third))).unwrap_or(near)
        };
        (suggested.is_finite() && suggested > 0.0).then_some(suggested)
    }

    /// The spacing from the density around deep particles, and the share of such particles; `None`
    /// if the spacing does not fit the distances to nearest neighbours, for example in sheets or
    /// filaments that are close together.
    pub fn measured(&self) -> Option<(f64, f64)> {
        let [_, second, third, _] = self.nearest?;
        let (spacing, share) = self.solid?;
        let fits = (0.85..1.07).contains(&(spacing / self.by_third()?));
        (fits && third <= FILAMENT * second).then_some((spacing, share))
    }

    /// The spacing from the distance to the third neighbour, corrected for disorder, which reduces
    /// this distance by 14 % for randomly placed particles.
    fn by_third(&self) -> Option<f64> {
        let [first, _, third, fourth] = self.nearest?;
        let disorder = (0.72 - first / fourth).clamp(0.0, 0.15);
        Some(third * (1.0 + disorder))
    }

    /// Whether the neighbours confirm a spacing from counting.
    pub fn confirms(&self, counted: f64) -> bool {
        let Some(((measured, _), by_third)) = self.measured().zip(self.by_third()) else {
            return false;
        };
        let agree = |factor: f64| (1.0 / factor..factor).contains(&(counted / measured));
        // For sheets that nearly touch, the counted and the measured spacing are both too large,
        // but the distances to third neighbours are not.
        let most = if agree(1.02) { 1.06 } else { 1.04 };
        agree(AGREED) && counted < most * by_third
    }

    /// Whether the particles are placed randomly, as in spray. In a fluid, particles are not placed
    /// randomly.
    pub fn is_random(&self) -> bool {
        self.scatter.is_some_and(|scatter| scatter.iter().all(|&scatter| scatter > RANDOM))
    }

    /// Whether the particles may be spray: they are placed randomly, or too few particles are deep
    /// to rule out a random placement.
    pub fn may_be_spray(&self) -> bool {
        self.scatter.is_none() || self.is_random()
    }

    /// Whether the placement may be random, allowing for the error of a scatter measured on few
    /// particles.
    fn may_be_random(&self) -> bool {
        self.scatter
            .is_none_or(|scatter| scatter.iter().all(|&scatter| scatter > RANDOM - SCATTER_ERROR))
    }
}

impl Neighbourhood {
    fn of(tree: &PointTree, point: [f64; 3], covered: f64) -> Self {
        let nearest = tree.nearest(point);
        let mut distances = [f64::INFINITY; NEIGHBOURS];
        let found = &nearest.found[..nearest.count];
        for (distance, (squared, _)) in distances.iter_mut().zip(found) {
            let length = squared.sqrt();
            *distance = if length <= covered { length } else { f64::INFINITY };
        }
        let moments = |count: usize| {
            let farthest = distances[count - 1];
            farthest.is_finite().then(|| Moments::of(&found[..count], farthest))
        };
        let (near, all) = (moments(*OF_SHEET.end()), moments(NEIGHBOURS));
        let in_plane = |of: &Moments| of.round < FLAT && of.disc > DISC;
        let flat = near.as_ref().is_some_and(in_plane);
        Self {
            distances,
            solid: all.as_ref().is_some_and(|of| of.centroid < CENTRED && of.round > ROUND),
            plane: all.is_some_and(|of| of.centroid < CENTRED && in_plane(&of)),
            flat,
            sheet: flat && near.is_some_and(|of| of.centroid < CENTRED),
        }
    }

    /// The spacing for which the mean number of particles within `radius(k)` spacings is k.
    fn spacing(&self, neighbours: RangeInclusive<usize>, radius: impl Fn(f64) -> f64) -> f64 {
        let count = neighbours.clone().count() as f64;
        // The median of the k-th distance is the radius within which k - 1/3 neighbours are
        // expected.
        neighbours.map(|k| self.distances[k - 1] / radius(k as f64 - 1.0 / 3.0)).sum::<f64>()
            / count
    }
}

/// Moments of the neighbours of a particle, in units of the distance to the farthest neighbour.
struct Moments {
    centroid: f64,
    round: f64,
    disc: f64,
}

impl Moments {
    fn of(near: &[(f64, DVec3)], farthest: f64) -> Self {
        let (mut sum, mut second) = (DVec3::ZERO, DMat3::ZERO);
        for at in near.iter().map(|&(_, at)| at / farthest) {
            sum += at;
            second += DMat3::from_cols(at * at.x, at * at.y, at * at.z);
        }
        let [x, y, z] = [second.x_axis, second.y_axis, second.z_axis];
        let trace = x.x + y.y + z.z;
        let minors = x.x * y.y - x.y * y.x + x.x * z.z - x.z * z.x + y.y * z.z - y.z * z.y;
        Self {
            centroid: sum.length() / near.len() as f64,
            round: 27.0 * second.determinant() / trace.powi(3),
            disc: 4.0 * minors / trace.powi(2),
        }
    }
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// A typical value of `values`, which are in ascending order. It comes from the lowest group that
/// holds a tenth of the values within a factor of 1.25.
fn densest(values: &[f64]) -> Option<f64> {
    const WITHIN: f64 = 1.25;
    const GROUP: f64 = 0.1;
    let group =
        |first: usize| values.partition_point(|&value| value <= WITHIN * values[first]) - first;
    let enough = (GROUP * values.len() as f64).max(4.0);
    let lowest = (0..values.len()).find(|&first| group(first) as f64 >= enough)?;
    // The lowest group may be the flank of a larger group, so the largest group slightly above it
    // is used.
    let end = values.partition_point(|&value| value <= 1.3 * values[lowest]);
    let best = (lowest..end).rev().max_by_key(|&first| group(first))?;
    Some(values[best + group(best) / 2])
}

/// The standard deviation of the density around particles, relative to that of random particles. It
/// is estimated from quantiles.
fn scatter(solid: &[&Neighbourhood], k: usize) -> f64 {
    let mut volumes: Vec<f64> = solid.iter().map(|of| of.distances[k - 1].powi(3)).collect();
    volumes.sort_unstable_by(f64::total_cmp);
    let quantile = |share: f64| volumes[(share * (volumes.len() - 1) as f64) as usize];
    // 68 % of a normal distribution lies between these two quantiles.
    (quantile(0.84) - quantile(0.16)) / 2.0 / quantile(0.5) * (k as f64).sqrt()
}

/// A k-d tree: each range of points is halved along its longest axis, and has its median in the
/// middle.
struct PointTree {
    points: Vec<[f64; 3]>,
    /// For each median, the axis along which its range is halved.
    axes: Vec<u8>,
}

/// The maximum number of points in a range that is not halved.
const LEAF: usize = 12;

/// The nearest points so far, ordered by distance.
struct NearestPoints {
    found: [(f64, DVec3); NEIGHBOURS],
    count: usize,
}

impl NearestPoints {
    fn farthest(&self) -> f64 {
        if self.count == NEIGHBOURS { self.found[NEIGHBOURS - 1].0 } else { f64::INFINITY }
    }

    /// Adds a point if it is one of the nearest. A point at the same position is ignored.
    #[inline]
    fn add(&mut self, at: DVec3) {
        let squared = at.length_squared();
        if squared >= self.farthest() || squared == 0.0 {
            return;
        }
        let mut slot = self.count.min(NEIGHBOURS - 1);
        while slot > 0 && self.found[slot - 1].0 > squared {
            self.found[slot] = self.found[slot - 1];
            slot -= 1;
        }
        self.found[slot] = (squared, at);
        self.count = (self.count + 1).min(NEIGHBOURS);
    }
}

impl PointTree {
    fn new(mut points: Vec<[f64; 3]>) -> Self {
        let mut axes = vec![0; points.len()];
        halve(&mut points, &mut axes);
        Self { points, axes }
    }

    /// The points nearest to `point`, without the point itself, ordered by distance.
    fn nearest(&self, point: [f64; 3]) -> NearestPoints {
        let mut nearest = NearestPoints { found: [(0.0, DVec3::ZERO); NEIGHBOURS], count: 0 };
        self.search(0..self.points.len(), point.into(), &mut nearest);
        nearest
    }

    fn search(&self, range: Range<usize>, point: DVec3, nearest: &mut NearestPoints) {
        if range.len() <= LEAF {
            self.points[range].iter().for_each(|&other| nearest.add(DVec3::from(other) - point));
            return;
        }
        let middle = range.start + range.len() / 2;
        let axis = usize::from(self.axes[middle]);
        let at = DVec3::from(self.points[middle]) - point;
        nearest.add(at);
        let halves = [range.start..middle, middle + 1..range.end];
        let own = usize::from(at[axis] < 0.0);
        self.search(halves[own].clone(), point, nearest);
        if at[axis] * at[axis] < nearest.farthest() {
            self.search(halves[1 - own].clone(), point, nearest);
        }
    }
}

fn halve(points: &mut [[f64; 3]], axes: &mut [u8]) {
    if points.len() <= LEAF {
        return;
    }
    let (mut lo, mut hi) = (DVec3::MAX, DVec3::MIN);
    for &point in &*points {
        (lo, hi) = (lo.min(point.into()), hi.max(point.into()));
    }
    let size = hi - lo;
    let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0);
    let middle = points.len() / 2;
    points.select_nth_unstable_by(middle, |a, b| a[axis].total_cmp(&b[axis]));
    axes[middle] = axis as u8;
    let (below, above) = points.split_at_mut(middle);
    let (axes_below, axes_above) = axes.split_at_mut(middle);
    rayon::join(|| halve(below, axes_below), || halve(&mut above[1..], &mut axes_above[1..]));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tree_finds_the_same_points_as_a_linear_search() {
        let coordinate =
            |i: u32| f64::from(i.wrapping_mul(2_654_435_761) >> 8) / f64::from(1 << 20);
        let points: Vec<[f64; 3]> = (0..1500)
            .map(|i| [coordinate(3 * i), coordinate(3 * i + 1), 0.1 * coordinate(3 * i + 2)])
            .collect();
        let tree = PointTree::new(points.clone());
        for &point in points.iter().step_by(7) {
            let mut all: Vec<f64> = points
                .iter()
                .map(|&p| (DVec3::from(p) - DVec3::from(point)).length_squared())
                .collect();
            all.sort_unstable_by(f64::total_cmp);
            let found = tree.nearest(point);
            let squares: Vec<f64> = found.found.iter().map(|(squared, _)| *squared).collect();
            assert_eq!(squares, all[1..=NEIGHBOURS]);
        }
        let few = PointTree::new(points[..5].to_vec());
        assert_eq!(few.nearest(points[0]).count, 4);
    }

    #[test]
    fn the_lowest_dense_group_of_values_is_found() {
        let mut values: Vec<f64> = (0..100).map(|i| 1.0 + 0.001 * f64::from(i)).collect();
        values.extend((0..800).map(|i| 5.0 + 0.01 * f64::from(i)));
        values.insert(0, 0.1);
        assert!((densest(&values).unwrap() - 1.05).abs() < 0.02);
        assert_eq!(densest(&[1.0, 2.0, 4.0]), None);
    }
}
