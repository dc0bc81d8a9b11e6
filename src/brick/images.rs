//! Particles of a periodic box together with their images, so that binning need not handle periodic
//! boxes.
//!
//! Images have the indices after the last particle, and are never stored. [`WithImages::of`] counts
//! the images of each group of particles. Each read of images recomputes them from the particles of
//! their groups, and does not read groups without images.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use crate::grid::{Domain, Grid, InBox, Periodic, PlacementError};
use crate::particles::{AttributeInfo, MeteredParticles, Particles, RereadError};

use crate::system::control::Stage;

use super::place::Placer;
use super::{BinError, Census, InvalidParticles};

/// Number of particles in a group.
const GROUP: usize = 1 << 10;

/// The particles to bin, together with their images if the box is periodic.
#[derive(Debug)]
pub struct WithImages<'a> {
    particles: MeteredParticles<'a>,
    images: Option<Images<'a>>,
}

/// The images of particles in a periodic box.
#[derive(Debug)]
struct Images<'a> {
    placer: Placer,
    periodic: &'a Periodic,
    /// A particle is wrapped into the box if it is at most this far outside, in the particles' unit
    /// of length.
    farthest: f64,
    /// For each group, the number of images in the groups before it; the last entry is the number
    /// of all images.
    before: Vec<u64>,
    /// Number of particles that are too far outside the box to be wrapped.
    outside: usize,
    /// Number of binned particles that were wrapped into the box.
    wrapped: usize,
}

/// The wrapped and invalid particles of all groups.
#[derive(Default)]
struct ParticleCounts {
    outside: AtomicUsize,
    wrapped: AtomicUsize,
    /// The number of the first group with an invalid particle, and the error for this particle.
    first_invalid: Mutex<Option<(usize, BinError)>>,
}

impl<'a> WithImages<'a> {
    /// If the box is periodic, reads all particles once and counts their images. Particles at most
    /// one `spacing` outside the box are wrapped into it.
    ///
    /// # Errors
    /// Unless invalid particles are skipped, the [`BinError`] of the first particle that cannot be
    /// placed or is too far outside the box.
    pub fn of(
        particles: MeteredParticles<'a>,
        grid: &Grid,
        domain: Option<&Domain>,
        periodic: Option<&'a Periodic>,
        spacing: f64,
        invalid: InvalidParticles,
    ) -> Result<Self, BinError> {
        let Some(periodic) = periodic else { return Ok(Self { particles, images: None }) };
        let placer = Placer { grid: *grid, domain: domain.copied(), wanted: None };
        // `farthest` is at most the reach, because the box is at least twice as wide as the reach,
        // and the grid contains all positions within the reach.
        let farthest = spacing.min(f64::from(periodic.reach()) * grid.cell_size());
        let images =
            Images { placer, periodic, farthest, before: Vec::new(), outside: 0, wrapped: 0 };
        let mut before = Vec::new();
        let (counts, groups) = (ParticleCounts::default(), particles.len().div_ceil(GROUP));
        (0..groups)
            .into_par_iter()
            .map(|group| images.count(&particles, group, &counts))
            .collect_into_vec(&mut before);
        let ParticleCounts { outside, wrapped, first_invalid } = counts;
        let first_invalid = first_invalid.into_inner().unwrap_or_else(PoisonError::into_inner);
        if let (InvalidParticles::Refuse, Some((_, error))) = (invalid, first_invalid) {
            return Err(error);
        }
        let mut all = 0;
        for before in &mut before {
            all += std::mem::replace(before, all);
        }
        before.push(all);
        let (outside, wrapped) = (outside.into_inner(), wrapped.into_inner());
        Ok(Self { particles, images: Some(Images { before, outside, wrapped, ..images }) })
    }

    /// Starts `stage`: from now on, reading particles advances the progress of this stage up to the
    /// fraction `to`.
    pub fn begin(&mut self, stage: Stage, to: f64) {
        self.particles.begin(stage, to);
    }

    /// Converts a census that includes images to a census of the particles alone.
    pub fn census(&self, census: Census) -> Census {
        let Some(images) = &self.images else { return census };
        Census {
            binned: census.binned - images.count_all(),
            not_finite: census.not_finite - images.outside,
            outside: census.outside + images.outside,
            wrapped: images.wrapped,
            ..census
        }
    }
}

/// A position within the faces of the periodic box, and the same position in steps.
type Placed = (InBox, [i64; 3]);

/// A particle that cannot be binned.
enum MisplacedParticle {
    /// Too far outside the box along this axis.
    OutsideBox(char),
    /// Not finite, or too far from the grid's origin.
    Unplaced(PlacementError),
}

/// The particles of a group.
fn group_range(particles: &dyn Particles, group: usize) -> Range<usize> {
    group * GROUP..particles.len().min((group + 1) * GROUP)
}

impl Images<'_> {
    fn count_all(&self) -> usize {
        self.before.last().map_or(0, |&all| all as usize)
    }

    /// A particle's position within the faces of the periodic box. If the particle is too far
    /// outside, `Err` names the axis.
    fn inside(&self, position: [f64; 3]) -> Result<InBox, char> {
        self.periodic.inside(position, self.farthest)
    }

    /// A particle's position within the faces of the periodic box, and its steps; `None` outside
    /// the domain.
    fn placed(&self, position: [f64; 3]) -> Result<Option<Placed>, MisplacedParticle> {
        let inside = self.inside(position).map_err(MisplacedParticle::OutsideBox)?;
        let steps = self.placer.place(inside.position).map_err(MisplacedParticle::Unplaced)?;
        Ok(steps.map(|steps| (inside, steps)))
    }

    fn images(&self, (inside, steps): Placed) -> impl Iterator<Item = [f64; 3]> + use<> {
        self.periodic.images(&self.placer.grid, inside.position, steps)
    }

    /// The images of a particle; a skipped particle has none.
    fn of(&self, position: [f64; 3]) -> impl Iterator<Item = [f64; 3]> + use<> {
        let near = self.periodic.is_near_face(position);
        let placed = if near { self.placed(position).ok().flatten() } else { None };
        placed.map(|placed| self.images(placed)).into_iter().flatten()
    }

    /// Returns the number of images of a group, and adds the group's wrapped and invalid particles
    /// to `counts`.
    fn count(&self, particles: &dyn Particles, group: usize, counts: &ParticleCounts) -> u64 {
        let range = group_range(particles, group);
        let mut positions = vec![[0.0; 3]; range.len()];
        particles.positions(range.start, &mut positions);
        let (mut images, mut outside, mut wrapped, mut first_invalid) = (0, 0, 0, None);
        for (index, &position) in range.clone().zip(&positions) {
            let invalid = match self.placed(position) {
                Ok(None) => continue,
                Ok(Some(placed)) => {
                    images += self.images(placed).count() as u64;
                    wrapped += usize::from(placed.0.wrapped);
                    continue;
                }
                Err(MisplacedParticle::OutsideBox(axis)) => {
                    outside += 1;
                    BinError::OutsideBox { index, position, axis, farthest: self.farthest }
                }
                Err(MisplacedParticle::Unplaced(PlacementError::NotFinite)) => {
                    BinError::NotFinite { index, position }
                }
                Err(MisplacedParticle::Unplaced(PlacementError::TooFar)) => {
                    BinError::TooFar { index, position, cell_size: self.placer.grid.cell_size() }
                }
            };
            first_invalid.get_or_insert(invalid);
        }
        particles.release(range);
        counts.outside.fetch_add(outside, Ordering::Relaxed);
        counts.wrapped.fetch_add(wrapped, Ordering::Relaxed);
        if let Some(invalid) = first_invalid {
            let mut first = counts.first_invalid.lock().unwrap_or_else(PoisonError::into_inner);
            if first.is_none_or(|(before, _)| group < before) {
                *first = Some((group, invalid));
            }
        }
        images
    }

    /// Calls `take` for each group that has any of the images `first..first + count`. The first
    /// argument of `take` is the range of the group's particles. The second lists, for each of
    /// these images, the index of its particle within the group. The third lists the positions of
    /// these images.
    fn groups(
        &self,
        particles: &dyn Particles,
        first: usize,
        count: usize,
        mut take: impl FnMut(Range<usize>, &[usize], &[[f64; 3]]),
    ) {
        let wanted = first as u64..(first + count) as u64;
        // `begin` is the last group whose images begin at or before the first wanted image. Earlier
        // groups with the same entry in `before` have no images.
        let begin = self.before.partition_point(|&before| before <= wanted.start).saturating_sub(1);
        let ends = self.before[1..].iter().enumerate().skip(begin);
        let groups = ends.take_while(|&(group, _)| self.before[group] < wanted.end);
        for (group, _) in groups.filter(|&(group, &end)| end > self.before[group]) {
            let range = group_range(particles, group);
            let mut positions = vec![[0.0; 3]; range.len()];
            particles.positions(range.start, &mut positions);
            let all = positions
                .iter()
                .enumerate()
                .flat_map(|(own, &at)| self.of(at).map(move |at| (own, at)));
            // Particles that moved since they were counted may have different images. If there are
            // fewer images now, the missing ones are set to NaN, and binning detects the change.
            let nowhere = std::iter::repeat((0, [f64::NAN; 3]));
            let numbered = (self.before[group]..self.before[group + 1]).zip(all.chain(nowhere));
            let numbered = numbered.filter(|(number, _)| wanted.contains(number));
            let (own, images): (Vec<usize>, Vec<[f64; 3]>) =
                numbered.map(|(_, image)| image).unzip();
            take(range.clone(), &own, &images);
            particles.release(range);
        }
    }
}

/// Splits `out`, which has `width` items for each particle from `first` on, into the part for the
/// first `own` particles and the part for images.
fn split<T>(out: &mut [T], width: usize, first: usize, own: usize) -> (&mut [T], &mut [T]) {
    let at = width * own.saturating_sub(first);
    out.split_at_mut(at.min(out.len()))
}

impl Particles for WithImages<'_> {
    fn len(&self) -> usize {
        self.particles.len() + self.images.as_ref().map_or(0, Images::count_all)
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        let Some(images) = &self.images else { return self.particles.positions(first, out) };
        let own = self.particles.len();
        let (real, mut rest) = split(out, 1, first, own);
        if !real.is_empty() {
            self.particles.positions(first, real);
            // Particles too far outside the box get NaN positions.
            real.iter_mut().for_each(|at| {
                *at = images.inside(*at).map_or([f64::NAN; 3], |inside| inside.position);
            });
        }
        let (first, count) = (first.max(own) - own, rest.len());
        images.groups(&self.particles, first, count, |_, _, positions| {
            let (to, later) = std::mem::take(&mut rest).split_at_mut(positions.len());
            to.copy_from_slice(positions);
            rest = later;
        });
    }

    fn check(&self) -> Result<(), RereadError> {
        self.particles.check()
    }

    fn goes_on(&self) -> bool {
        self.particles.goes_on()
    }

    fn resident_bytes(&self) -> u64 {
        let counts = self.images.as_ref().map_or(0, |images| size_of_val(&images.before[..]));
        self.particles.resident_bytes() + counts as u64
    }

    fn release(&self, range: Range<usize>) {
        let own = self.particles.len();
        if range.start < own {
            self.particles.release(range.start..range.end.min(own));
        }
    }

    fn attributes(&self) -> &[AttributeInfo] {
        self.particles.attributes()
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        self.tuples(index, first, out, |first, out| self.particles.attribute(index, first, out));
    }

    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        self.tuples(index, first, out, |first, out| self.particles.integers(index, first, out));
    }
}

impl WithImages<'_> {
    /// Fills `out` with attribute number `index` of particles and images. `read` reads the
    /// attribute of particles; an image has the value of its particle.
    fn tuples<T: Copy + Default>(
        &self,
        index: usize,
        first: usize,
        out: &mut [T],
        read: impl Fn(usize, &mut [T]),
    ) {
        let Some(images) = &self.images else { return read(first, out) };
        let (own, width) = (self.particles.len(), self.attributes()[index].components);
        let (real, mut rest) = split(out, width, first, own);
        if !real.is_empty() {
            read(first, real);
        }
        let (first, count) = (first.max(own) - own, rest.len() / width.max(1));
        images.groups(&self.particles, first, count, |range, of, _| {
            let mut values = vec![T::default(); width * range.len()];
            read(range.start, &mut values);
            let (to, later) = std::mem::take(&mut rest).split_at_mut(width * of.len());
            for (to, &of) in to.chunks_exact_mut(width).zip(of) {
                to.copy_from_slice(&values[width * of..][..width]);
            }
            rest = later;
        });
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use crate::system::control::Control;

    use super::*;

    /// Particles with their own indices as an attribute.
    #[derive(Debug)]
    struct NumberedParticles(Vec<[f64; 3]>, Vec<AttributeInfo>);

    impl Particles for NumberedParticles {
        fn len(&self) -> usize {
            self.0.len()
        }

        fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
            self.0[..].positions(first, out);
        }

        fn attributes(&self) -> &[AttributeInfo] {
            &self.1
        }

        fn attribute(&self, _: usize, first: usize, out: &mut [f32]) {
            out.iter_mut().enumerate().for_each(|(i, to)| *to = (2 * first + i) as f32);
        }
    }

    #[test]
    fn images_follow_the_particles_for_any_ranges_of_reads() {
        let grid = Grid::new(DVec3::ZERO, 0.02).unwrap();
        let periodic = Periodic::new(&grid, [Some([0.0, 1.0]), None, Some([0.0, 1.0])], 3).unwrap();
        let at = |i: usize, a: usize| ((i * [7919, 6761, 5879][a]) % 40_009) as f64 / 40_009.0;
        let mut positions: Vec<[f64; 3]> =
            (0..5000).map(|i| [at(i, 0), at(i, 1), at(i, 2)]).collect();
        // The third group of 1024 particles is far from all faces, so it has no images.
        positions[2048..3072].fill([0.5; 3]);
        (positions[7], positions[8], positions[9]) =
            ([0.5, f64::NAN, 0.5], [1.5, 0.5, 0.5], [1.0, 0.5, 0.5]);
        (positions[10], positions[11]) = ([0.5, 0.5, -0.03125], [1.03125, 0.5, 0.5]);
        let info = AttributeInfo::new("number", 2);
        let particles = NumberedParticles(positions, vec![info]);
        let control = Control::default();
        let metered = || MeteredParticles::new(&particles, &control, Stage::Counting);
        let of = |invalid| WithImages::of(metered(), &grid, None, Some(&periodic), 0.05, invalid);
        let first = of(InvalidParticles::Refuse).unwrap_err();
        assert!(matches!(first, BinError::NotFinite { index: 7, .. }), "{first}");
        let all = of(InvalidParticles::Skip).unwrap();
        let len = all.len();
        // About 4000 particles fill the box. Images extend it by 0.06 on both sides along two axes.
        let expected = 4000.0 * (1.12 * 1.12 - 1.0);
        assert!(((len - 5000) as f64 - expected).abs() < 0.1 * expected, "{} images", len - 5000);

        let mut whole = vec![[0.0; 3]; len];
        all.positions(0, &mut whole);
        assert!(whole[7][1].is_nan() && whole[8][0].is_nan() && whole[9] == [0.0, 0.5, 0.5]);
        assert_eq!((whole[10], whole[11]), ([0.5, 0.5, 0.96875], [0.03125, 0.5, 0.5]));
        let mut values = vec![0.0; 2 * len];
        all.attribute(0, 0, &mut values);
        for (position, value) in whole.iter().zip(values.chunks(2)).skip(5000) {
            let own = whole[value[0] as usize / 2];
            let moved = [0, 2].map(|a| (position[a] - own[a]).abs());
            assert!(moved.iter().all(|d| *d < 1e-5 || (d - 1.0).abs() < 1e-5) && moved != [0.0; 2]);
            assert_eq!(position[1], own[1]);
            let beyond = |a: usize| {
                !(0.0..1.0).contains(&position[a]) && (-0.061..1.061).contains(&position[a])
            };
            assert!(beyond(0) || beyond(2), "{position:?}");
        }
        for step in [1, 7, 512, 3000] {
            for first in (0..len).step_by(step) {
                let count = step.min(len - first);
                let (mut some, mut some_values) = (vec![[0.0; 3]; count], vec![0.0; 2 * count]);
                all.positions(first, &mut some);
                all.attribute(0, first, &mut some_values);
                let bits =
                    |p: &[[f64; 3]]| p.iter().map(|p| p.map(f64::to_bits)).collect::<Vec<_>>();
                assert_eq!(bits(&some), bits(&whole[first..first + count]));
                assert_eq!(some_values, values[2 * first..2 * (first + count)]);
            }
        }
        let counted = Census { binned: len - 2, not_finite: 2, ..Census::default() };
        assert_eq!(
            all.census(counted),
            Census { binned: 4998, not_finite: 1, too_far: 0, outside: 1, wrapped: 2 }
        );
    }

    /// Particles whose positions change with each reading.
    struct UnstableParticles(AtomicUsize);

    impl Particles for UnstableParticles {
        fn len(&self) -> usize {
            3000
        }

        fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
            let read = self.0.fetch_add(1, Ordering::Relaxed);
            for (i, to) in (first..).zip(out) {
                *to = [((i * 7919 + 131 * read * (first + 1)) % 1009) as f64 / 1009.0, 0.5, 0.5];
            }
        }
    }

    #[test]
    fn moved_particles_never_overflow_the_requested_range_of_images() {
        let grid = Grid::new(DVec3::ZERO, 0.02).unwrap();
        let periodic = Periodic::new(&grid, [Some([0.0, 1.0]), None, None], 10).unwrap();
        let unstable = UnstableParticles(0.into());
        let invalid = InvalidParticles::Refuse;
        let control = Control::default();
        let metered = MeteredParticles::new(&unstable, &control, Stage::Counting);
        let all = WithImages::of(metered, &grid, None, Some(&periodic), 0.02, invalid).unwrap();
        for first in [0, 2990, 3000, 3100, all.len() - 5] {
            let mut positions = vec![[7.0; 3]; all.len() - first];
            all.positions(first, &mut positions);
            assert!(positions.iter().all(|p| p[1] != 7.0), "from {first} on");
        }
    }
}
