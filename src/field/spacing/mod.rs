//! The spacing of particles, estimated from their positions: the edge of the cube that a particle
//! fills, (volume / number)^(1/3).
//!
//! Two estimates check each other. `density` counts particles in cells; the result is accurate in
//! deep fluid, but too large in thin fluid with gaps. `neighbours` measures the density around
//! single particles. If the two estimates agree, the result is the spacing from counting.
//! Otherwise, or if no fluid is deep enough to count, the result usually comes from the neighbours.
//! An unreliable [`SpacingEstimate`] is marked as thin.
//!
//! Up to [`ALL`] particles are read once and held in memory. If there are more, the first reading
//! takes an even sample for counting, and the second reading takes all particles in some cubes for
//! the search for neighbours. Code that reads the particles for another purpose can do the second
//! reading at the same time.

mod clouds;
mod density;
mod neighbours;
mod sample;

use glam::DVec3;
use rayon::prelude::*;
use thiserror::Error;

use crate::grid::units::shown;
use crate::particles::{Bounds, CHUNK, Particles, bounds};

pub use clouds::spacing_by_clouds;
pub use density::Spacings;
pub use neighbours::Neighbours;
pub use sample::{CubeSample, Cubes, EvenSample, FinishedSample, NeighbourSample};

use sample::SHARE;

/// The maximum number of particles that are held in memory for the estimate. An [`EvenSample`] can
/// hold the same number.
pub const ALL: usize = 2 * SHARE;
/// If there are more particles than this, a small sample is enough to confirm a count.
const FEWEST_SAMPLED: usize = 1 << 12;
/// If there are at most this many particles, and a small sample does not confirm the count, all
/// particles are searched.
const MOST_SEARCHED: usize = 1 << 15;
/// The count of a sample is used only if at least this share of its particles is in interior cells.
const ENOUGH_SHARE: f64 = 1.0 / 16.0;
/// The minimum number of distinct positions for an estimate.
const FEWEST: usize = 8;
/// If an estimate fails and the middle of the particles has a coordinate of at least this
/// magnitude, the error is [`NoEstimate::TooLarge`].
const LARGEST: f64 = 1e100;
/// The minimum share of deep particles; with a smaller share, the fluid is thin.
const THIN: f64 = 0.15;
/// If at least this share of the particles is in evenly filled cells, the fluid is certainly deep.
const DEEP: f64 = 0.24;

/// The evidence about the spacing that the particles' positions give.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Number of finite particles.
    pub particles: usize,
    /// Number of distinct positions.
    pub places: usize,
    /// The spacings from counting.
    pub counted: Option<Spacings>,
    /// The distances to nearest neighbours.
    pub neighbours: Neighbours,
    /// The facts about the coordinates.
    pub place: CoordinateFacts,
}

/// The position of particles and the precision of their coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoordinateFacts {
    /// The plane in which all particles lie, if there is one.
    pub plane: Option<Plane>,
    /// The step of the coordinates, if they were rounded to single precision.
    pub step: Option<f64>,
    /// A robust middle of the particles, which stray particles do not affect.
    pub middle: DVec3,
}

/// A plane perpendicular to an axis that contains all particles of a two-dimensional simulation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// 0, 1 or 2 for x, y or z.
    pub axis: usize,
    /// The plane's coordinate along that axis.
    pub at: f64,
}

/// An estimated spacing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpacingEstimate {
    /// The estimate.
    pub spacing: f64,
    /// For particles that clearly have two resolutions: the spacing of the majority, and the
    /// spacing of the other particles.
    pub two: Option<[f64; 2]>,
    /// Whether the fluid is too thin or too ragged for a reliable estimate.
    pub thin: bool,
}

impl SpacingEstimate {
    /// The smallest and the largest spacing of the particles.
    pub fn extremes(&self) -> [f64; 2] {
        let [one, other] = self.two.unwrap_or([self.spacing; 2]);
        [one.min(other), one.max(other)]
    }
}

/// A reason why the spacing cannot be estimated.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum NoEstimate {
    /// Too few particles.
    #[error("there are too few particles")]
    TooFew,
    /// No position is finite.
    #[error("no particle has a finite position")]
    NotFinite,
    /// Coordinates so large that squares of distances exceed f64.
    #[error("the coordinates of the particles are too large")]
    TooLarge,
    /// Nearly all particles share a few positions.
    #[error("the particles have only {places} different positions")]
    Coincident {
        /// The number of distinct positions.
        places: usize,
    },
    /// Coordinates that are too coarse.
    #[error(
        "the particles are so far from the origin that single precision rounds their coordinates \
         to multiples of {}, which is too coarse",
        shown(*step)
    )]
    SinglePrecision {
        /// The step of the coordinates.
        step: f64,
    },
}

/// The result of counting an even sample of the particles, before the search for neighbours.
#[derive(Debug)]
pub struct SpacingDraft {
    particles: usize,
    places: usize,
    counted: Option<Spacings>,
    /// The scale of the search for neighbours.
    scale: f64,
    place: CoordinateFacts,
}

/// Estimates the spacing of particles; `None` if that is impossible.
pub fn estimate(particles: &dyn Particles) -> Option<f64> {
    evidence(particles)?.estimate().ok().map(|estimate| estimate.spacing)
}

/// Reads the particles and collects the evidence about their spacing; `None` if there are no finite
/// particles, or if the reading was cancelled. Up to [`ALL`] particles are read once; more
/// particles are read at least twice.
pub fn evidence(particles: &dyn Particles) -> Option<Evidence> {
    if particles.len() <= ALL {
        let (positions, bounds) = gathered(particles);
        return if particles.goes_on() { of_all(positions, bounds) } else { None };
    }
    let share = EvenSample::of(particles.len());
    for_each_chunk(particles, |positions| share.add(positions));
    let mut taken = share.taken();
    while particles.goes_on() {
        let Some(larger) = taken.larger() else {
            return SpacingDraft::of(taken)?.completed(particles);
        };
        for_each_chunk(particles, |positions| larger.add(positions));
        taken = larger.taken();
    }
    None
}

/// Reads the particles and searches for neighbours at the scale of a known spacing; `None` if there
/// are no particles, or if the reading was cancelled. The particles are read twice if there are at
/// most [`ALL`] of them and a small sample does not confirm the spacing.
pub fn survey(particles: &dyn Particles, spacing: f64) -> Option<SampleSurvey> {
    let of = |sample| if particles.goes_on() { SampleSurvey::of(sample, spacing) } else { None };
    if particles.len() <= FEWEST_SAMPLED {
        return of(NeighbourSample::whole(gathered(particles).0));
    }
    let sample = |new: fn(Cubes, usize) -> CubeSample| {
        let in_cubes = new(Cubes::for_spacing(spacing), particles.len());
        for_each_chunk(particles, |positions| in_cubes.add(positions));
        in_cubes.sample()
    };
    if particles.len() <= ALL {
        let few = sample(CubeSample::few);
        if particles.goes_on()
            && let Some(place) = CoordinateFacts::of_sample(&few)
            && let Some(neighbours) = Neighbours::of_few(few, spacing)
        {
            return Some(SampleSurvey { neighbours, place });
        }
    }
    of(sample(CubeSample::new))
}

/// A survey of a sample of particles, at the scale of a known spacing.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleSurvey {
    /// Distances between neighbours.
    pub neighbours: Neighbours,
    /// The facts about the sample's coordinates. The sample may lie in a plane even if not all
    /// particles do.
    pub place: CoordinateFacts,
}

impl SampleSurvey {
    /// Surveys a sample for a spacing; `None` if it is empty.
    pub fn of(sample: NeighbourSample, spacing: f64) -> Option<Self> {
        let place = CoordinateFacts::of_sample(&sample)?;
        Some(Self { neighbours: Neighbours::for_check(sample, Some(spacing)), place })
    }
}

/// Passes the positions of all particles to `add`, in chunks, in any order.
pub fn for_each_chunk(particles: &dyn Particles, add: impl Fn(&[[f64; 3]]) + Sync) {
    let buffer = || vec![[0.0; 3]; CHUNK];
    (0..particles.len().div_ceil(CHUNK)).into_par_iter().for_each_init(buffer, |buffer, chunk| {
        let range = chunk * CHUNK..particles.len().min((chunk + 1) * CHUNK);
        let positions = &mut buffer[..range.len()];
        particles.positions(range.start, positions);
        particles.release(range);
        add(positions);
    });
}

/// The finite positions of all particles, in the order of the particles, and their bounds.
fn gathered(particles: &dyn Particles) -> (Vec<[f64; 3]>, Bounds) {
    let mut all = vec![[0.0; 3]; particles.len()];
    let bounds = all.par_chunks_mut(CHUNK).enumerate().map(|(chunk, positions)| {
        particles.positions(chunk * CHUNK, positions);
        particles.release(chunk * CHUNK..chunk * CHUNK + positions.len());
        Bounds::of(positions)
    });
    let bounds = bounds.reduce(|| Bounds::NONE, Bounds::joined);
    if bounds.finite < all.len() {
        all.retain(|position| DVec3::from(*position).is_finite());
    }
    (all, bounds)
}

/// Collects the evidence from all particles, which lie within `bounds`.
fn of_all(positions: Vec<[f64; 3]>, bounds: Bounds) -> Option<Evidence> {
    if positions.is_empty() {
        return None;
    }
    let place = CoordinateFacts::of(&positions, &bounds);
    let particles = positions.len();
    let mut places = particles;
    let count = |positions: &[[f64; 3]]| {
        let spacings = |enough_share| density::spacings(positions, &bounds, enough_share);
        match (place.plane, particles > SHARE) {
            (Some(_), _) => None,
            (None, true) => spacings(ENOUGH_SHARE).or_else(|| spacings(0.0)),
            (None, false) => spacings(0.0),
        }
    };
    let mut counted = count(&positions);
    let search = |positions: &[[f64; 3]], counted: Option<Spacings>| {
        let counted = counted.map(|counted| counted.mean);
        let all = || NeighbourSample::whole(positions.to_vec());
        let scale = match counted {
            // A search in cubes queries only particles in the middles of cubes. If all particles
            // lie in a plane, the plane may pass through no middle of a cube.
            _ if positions.len() <= FEWEST_SAMPLED || place.plane.is_some() => None,
            None if positions.len() <= MOST_SEARCHED => None,
            None => {
                let one_in = (positions.len() / MOST_SEARCHED).next_power_of_two() as u64;
                let few =
                    |&&position: &&[f64; 3]| sample::position_hash(position) & (one_in - 1) == 0;
                scale_of(positions.iter().filter(few).copied().collect())
            }
            known => known,
        };
        let Some(scale) = scale else { return Neighbours::of(all()) };
        let in_cubes = |new: fn(Cubes, usize) -> CubeSample| {
            let in_cubes = new(Cubes::for_spacing(scale), positions.len());
            positions.par_chunks(1 << 12).for_each(|positions| in_cubes.add(positions));
            in_cubes.sample()
        };
        let few =
            counted.and_then(|counted| Neighbours::of_few(in_cubes(CubeSample::few), counted));
        // A search in cubes may miss particles at walls, because it queries only particles in the
        // middles of cubes. A search in all particles queries particles anywhere.
        let more =
            || if positions.len() <= MOST_SEARCHED { all() } else { in_cubes(CubeSample::new) };
        let found = few.unwrap_or_else(|| Neighbours::of(more()));
        // If the search in cubes found nothing, all particles are searched, because a plane or a
        // film may miss the middles of all cubes.
        if found.suggested().is_some() { found } else { Neighbours::of(all()) }
    };
    let mut neighbours = search(&positions, counted);
    if neighbours.coincident > 0 {
        let positions = sample::distinct(positions);
        places = positions.len();
        counted = count(&positions);
        neighbours = search(&positions, counted);
    }
    Some(Evidence { particles, places, counted, neighbours, place })
}

/// The scale of the search for neighbours if the particles have not been counted: half the distance
/// to the third neighbour in a small sample. In a sample of sheets or filaments, particles are
/// farther apart than in a sample of deep fluid, so the cubes are wider and hold more particles.
fn scale_of(few: Vec<[f64; 3]>) -> Option<f64> {
    Some(Neighbours::of(NeighbourSample::whole(few)).nearest?[2] / 2.0)
}

impl SpacingDraft {
    /// Counts a sample; `None` if it is empty.
    pub fn of(share: FinishedSample) -> Option<Self> {
        let FinishedSample { positions, part, places, bounds: all, .. } = share;
        let bounds = bounds(&positions)?;
        let place = CoordinateFacts::of(&positions, &all);
        let particles = all.finite;
        // A layer may be too thin for interior cells in a sample of this size. The search for
        // neighbours then determines the spacing.
        let counted = density::spacings(&positions, &bounds, ENOUGH_SHARE);
        let counted = counted.map(|counted| counted.scaled(libm::cbrt(part)));
        // Particles that cannot be counted may be sheets, in which distances are inversely
        // proportional to the square root of the sample's share.
        let in_sheets = || Some(2.4 * part.sqrt() * scale_of(positions)?);
        let scale = counted.map(|counted| counted.mean).or_else(in_sheets);
        Some(Self { particles, places, counted, scale: scale.unwrap_or(1.0), place })
    }

    /// The spacing from counting.
    pub fn counted(&self) -> Option<f64> {
        self.counted.map(|counted| counted.mean)
    }

    /// Begins a sample of all particles in some cubes. The caller must pass all particles to the
    /// sample.
    pub fn in_cubes(&self) -> CubeSample {
        CubeSample::new(Cubes::for_spacing(self.scale), self.particles)
    }

    /// Whether the scale of the search for neighbours suits particles with this spacing.
    pub fn suits(&self, spacing: f64) -> bool {
        within(spacing / self.scale, 2.5)
    }

    /// Reads the particles for a search for neighbours. If the scale does not suit the particles,
    /// they are read again at another scale. Returns `None` if the reading was cancelled.
    pub fn completed(mut self, particles: &dyn Particles) -> Option<Evidence> {
        const READINGS: u32 = 8;
        for _ in 1..READINGS {
            let in_cubes = self.in_cubes();
            for_each_chunk(particles, |positions| in_cubes.add(positions));
            if !particles.goes_on() {
                return None;
            }
            let sample = in_cubes.sample();
            if sample.positions.is_empty() {
                self.scale /= 8.0;
                continue;
            }
            let neighbours = Neighbours::for_check(sample, self.counted());
            match neighbours.suggested() {
                Some(suggested) if self.counted.is_none() && !self.suits(suggested) => {
                    self.scale = suggested
                }
                None if self.counted.is_none() => self.scale *= 4.0,
                _ => return Some(self.with(neighbours)),
            }
        }
        let in_cubes = self.in_cubes();
        for_each_chunk(particles, |positions| in_cubes.add(positions));
        Some(self.with_sample(in_cubes.sample()))
    }

    /// Searches a sample for neighbours, and adds the result. Searches only a few cubes of the
    /// sample if they confirm the count.
    pub fn with_sample(self, sample: NeighbourSample) -> Evidence {
        let neighbours = Neighbours::for_check(sample, self.counted());
        self.with(neighbours)
    }

    /// Adds the result of a search for neighbours.
    pub fn with(self, neighbours: Neighbours) -> Evidence {
        let Self { particles, places, counted, place, .. } = self;
        Evidence { particles, places, counted, neighbours, place }
    }
}

impl CoordinateFacts {
    fn of_sample(sample: &NeighbourSample) -> Option<Self> {
        Some(Self::of(&sample.positions, &bounds(&sample.positions)?))
    }

    /// Determines the facts from the positions of some particles and the bounds of all.
    fn of(positions: &[[f64; 3]], &Bounds { lo, hi, .. }: &Bounds) -> Self {
        // A few positions are enough. Their choice must not depend on the order of particles in the
        // file.
        let one_in = positions.len().div_ceil(1 << 12).next_power_of_two() as u64;
        let some = |position: &&[f64; 3]| sample::quick_hash(**position) & (one_in - 1) == 0;
        let some = |chunk: &'_ [[f64; 3]]| chunk.iter().filter(some).copied().collect::<Vec<_>>();
        let mut some = positions.par_chunks(1 << 14).flat_map_iter(some).collect::<Vec<_>>();
        if some.is_empty() {
            some = vec![lo.into(), hi.into()];
        }
        // Unused particles that are parked at one position count once. Stray particles hardly
        // affect medians and quartiles.
        some.sort_unstable_by_key(|position| position.map(f64::to_bits));
        some.dedup();
        let mut quantile = |axis: usize, quarter: usize| {
            let rank = quarter * (some.len() - 1) / 4;
            some.select_nth_unstable_by(rank, |a, b| a[axis].total_cmp(&b[axis])).1[axis]
        };
        let middle = DVec3::from([0, 1, 2].map(|axis| quantile(axis, 2)));
        let spread = [0, 1, 2].map(|axis| quantile(axis, 3) - quantile(axis, 1));
        /// The maximum thickness of a plane, relative to its extent. It allows for single-precision
        /// rounding.
        const FLAT: f64 = 1e-6;
        let thinnest = FLAT * spread.into_iter().fold(0.0, f64::max);
        let flat: Vec<usize> = (0..3).filter(|&a| hi[a] - lo[a] <= thinnest).collect();
        let plane = match flat[..] {
            [axis] => Some(Plane { axis, at: (lo[axis] + hi[axis]) / 2.0 }),
            _ => None,
        };
        let far = middle.abs().max_element();
        Self { plane, step: step_of(some.as_flattened(), far), middle }
    }
}

/// The step of coordinates that were rounded to single precision, at the distance `far` from the
/// origin. Returns `None` if the coordinates were not rounded, or if all of them are multiples of a
/// larger step.
fn step_of(coordinates: &[f64], far: f64) -> Option<f64> {
    let is_single = coordinates.iter().all(|&c| f64::from(c as f32) == c);
    let far = far as f32;
    let step = f64::from(far.next_up() - far);
    let is_rounded =
        || coordinates.iter().any(|c| c.abs() < 2.0 * f64::from(far) && (c / step) % 2.0 != 0.0);
    (is_single && is_rounded()).then_some(step)
}

impl Evidence {
    /// Estimates the spacing.
    pub fn estimate(&self) -> Result<SpacingEstimate, NoEstimate> {
        let places = self.places;
        if places < FEWEST {
            return Err(if self.particles >= 4 * FEWEST {
                NoEstimate::Coincident { places }
            } else {
                NoEstimate::TooFew
            });
        }
        let estimate = self.estimated().ok_or(match self.place.middle.abs().max_element() {
            LARGEST.. => NoEstimate::TooLarge,
            _ => NoEstimate::TooFew,
        })?;
        match self.place.step {
            // Different positions are at least one step apart, so no estimate is much less than a
            // step. If the estimate is about a step, the true spacing may be less.
            Some(step) if step > 0.7 * estimate.spacing => {
                Err(NoEstimate::SinglePrecision { step })
            }
            _ => Ok(estimate),
        }
    }

    /// Whether the particles fill deep fluid evenly but, as in a stretched or sheared lattice, at
    /// different distances along different axes. Neighbours then measure the distance along one
    /// axis, while the count gives the right spacing. In clumps of particles that are far apart,
    /// the count gives a wrong spacing, so the nearest neighbours must not be much closer than the
    /// count implies.
    fn is_deep_lattice(&self) -> bool {
        let (Some(counted), Some([_, second, third, _])) = (self.counted, self.neighbours.nearest)
        else {
            return false;
        };
        counted.even >= DEEP && second > 0.4 * counted.mean && third > 0.77 * counted.mean
    }

    fn estimated(&self) -> Option<SpacingEstimate> {
        let Self { counted, neighbours, .. } = self;
        if let Some(Spacings { mean, two: Some(two), .. }) = *counted {
            return Some(SpacingEstimate { spacing: mean, two: Some(two), thin: false });
        }
        let sure = |spacing| Some(SpacingEstimate { spacing, two: None, thin: false });
        let unsure = |spacing| Some(SpacingEstimate { spacing, two: None, thin: true });
        let counted = counted.map(|counted| counted.mean);
        let suggested = neighbours.suggested();
        match (counted, neighbours.measured()) {
            _ if self.place.plane.is_some() => sure(neighbours.plane.or(suggested)?),
            (Some(counted), Some(_)) if neighbours.confirms(counted) => sure(counted),
            (Some(_), Some((measured, share))) if share >= THIN => unsure(measured),
            (None, Some((measured, share))) if share >= THIN => sure(measured),
            (Some(counted), _) if self.is_deep_lattice() => sure(counted),
            // The cubes of the sample were too small or too wide to show neighbours.
            (Some(counted), None) if suggested.is_none() => unsure(counted),
            _ => unsure(suggested?),
        }
    }
}

/// Whether `ratio` is from 1 / `factor` to `factor`.
fn within(ratio: f64, factor: f64) -> bool {
    (1.0 / factor..factor).contains(&ratio)
}

#[cfg(test)]
mod tests;
