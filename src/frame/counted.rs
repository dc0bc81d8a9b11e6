//! Particles that are counted: the last moment to say what a frame will take, and to refuse it.

use glam::IVec3;

use crate::brick::{BinError, BinPlan, Census, CountingRoom, InvalidParticles, WithImages};
use crate::frame::estimate::{MemoryEstimate, OverBudget, SMALLEST_BUDGET};
use crate::grid::stretch::{Stretch, WantedBins};
use crate::grid::{BLOCK, CellBox, Grid, MortonKey};
use crate::particles::{MeteredParticles, Particles};
use crate::surface::mesh::spool::Spool;
use crate::system::control::Stage;

use super::{FrameError, Method, OccupiedTiles, Sampling, Surfacing};

/// Particles that are counted by bin: what they will take is known, and nothing is stored for them
/// yet.
pub struct CountedFrame<'a, P: ?Sized> {
    pub(super) particles: WithImages<'a, P>,
    pub(super) sampling: &'a Sampling,
    pub(super) plan: BinPlan,
    census: Census,
    surfacing: Surfacing,
    /// The blocks that are going to be meshed.
    stretch: Stretch,
}

impl<'a, P: Particles + ?Sized> CountedFrame<'a, P> {
    /// Counts the particles, and refuses what cannot be done with them.
    ///
    /// # Errors
    /// [`FrameError`] for particles that cannot be placed, none at all, or more than the budget can
    /// hold.
    pub fn of(particles: &'a P, sampling: &'a Sampling) -> Result<Self, FrameError> {
        Self::planned(particles, sampling, None)
    }

    /// Takes a plan of all particles that was made before, by the same sampling.
    fn planned(
        particles: &'a P,
        sampling: &'a Sampling,
        plan: Option<BinPlan>,
    ) -> Result<Self, FrameError> {
        let Sampling { grid, domain, invalid, .. } = sampling;
        let (particles, plan) =
            Self::with_images(particles, sampling, *invalid, |particles, room| {
                plan.map_or_else(
                    || BinPlan::count(particles, grid, domain.as_ref(), *invalid, room),
                    Ok,
                )
            })?;
        let census = particles.census(plan.census());
        if census.binned == 0 {
            return Err(FrameError::NoParticles(census));
        }
        Ok(Self {
            particles,
            sampling,
            plan,
            census,
            surfacing: Surfacing::PLAIN,
            stretch: Stretch::ALL,
        })
    }

    /// The particles with the images that they have in a periodic box, and their bins, as `count`
    /// finds them.
    fn with_images(
        given: &'a P,
        sampling: &'a Sampling,
        invalid: InvalidParticles,
        count: impl FnOnce(&WithImages<'a, P>, CountingRoom) -> Result<BinPlan, BinError>,
    ) -> Result<(WithImages<'a, P>, BinPlan), FrameError> {
        let Sampling { grid, domain, periodic, resources, .. } = sampling;
        let metered = MeteredParticles::new(given, &resources.control, Stage::Counting);
        let particles = WithImages::of(metered, grid, domain.as_ref(), periodic.as_ref(), invalid);
        resources.go_on()?;
        given.check()?;
        refuse_wide_attributes(given, sampling)?;
        let particles = particles?;
        let room = CountingRoom::within(resources.budget.0);
        let plan = count(&particles, room);
        // Of cancelled work no particle has a place.
        resources.go_on()?;
        given.check()?;
        let plan = match plan {
            Err(BinError::TooManyBins { .. }) => return Err(over_budget(given, sampling, room)),
            plan => plan?,
        };
        Ok((particles, plan))
    }

    /// Counts the particles in some bins alone, of which there may be none, and in a periodic box
    /// their images; the others have been counted before, and refused or skipped if they are
    /// invalid.
    pub fn of_wanted(
        particles: &'a P,
        sampling: &'a Sampling,
        surfacing: &Surfacing,
        wanted: WantedBins,
    ) -> Result<Self, FrameError> {
        let Sampling { grid, domain, .. } = sampling;
        let count = |particles: &WithImages<'a, P>, room| {
            BinPlan::count_wanted(particles, grid, domain.as_ref(), wanted, room)
        };
        let (particles, plan) =
            Self::with_images(particles, sampling, InvalidParticles::Skip, count)?;
        let census = plan.census();
        Ok(Self {
            particles,
            sampling,
            plan,
            census,
            surfacing: surfacing.clone(),
            stretch: wanted.stretch,
        })
    }

    /// Refuses what such a surface cannot be drawn through, then counts the particles for it,
    /// unless a `plan` of them all was made before, by a sampling that differs in nothing that a
    /// plan depends on.
    pub fn for_surface(
        particles: &'a P,
        sampling: &'a Sampling,
        surfacing: &Surfacing,
        plan: Option<BinPlan>,
    ) -> Result<Self, FrameError> {
        sampling.refuse_unfit(surfacing)?;
        Ok(Self { surfacing: surfacing.clone(), ..Self::planned(particles, sampling, plan)? })
    }

    /// Returns how many particles went into bins, and how many were left out and why.
    pub fn census(&self) -> Census {
        self.census
    }

    /// The bins that hold particles, in Morton order, and how many each holds.
    pub fn bins(&self) -> impl Iterator<Item = (MortonKey, usize)> + Clone + '_ {
        self.plan.keys().iter().copied().zip(self.plan.counts())
    }

    /// Estimates the memory and disk space that the frame will take.
    pub fn estimate(&self) -> MemoryEstimate {
        let bins = self.bins();
        let estimate = self.sampling.estimate(&self.particles, &self.surfacing, bins, self.stretch);
        let estimate = MemoryEstimate { places: self.plan.places_bytes(), ..estimate };
        match self.sampling.method {
            // Clouds of sizes are made of the sorted particles, octave by octave, once of their
            // volumes and once of their sizes.
            Method::Indicator { .. } if self.sampling.sizes.is_some() => {
                MemoryEstimate { field: 2 * estimate.field, carried: true, ..estimate }
            }
            Method::Indicator { .. } => estimate,
            // Kernels are kept until the surface is done, and so are the particles at the most.
            // Images have them as well.
            Method::Kernels(kernels) => {
                let bytes = self.plan.census().binned as u64 * kernels.kernel_bytes();
                MemoryEstimate { particles: estimate.particles + bytes, carried: true, ..estimate }
            }
        }
    }
}

impl Sampling {
    /// Estimates the memory and disk space that a frame with such bins takes, of which the blocks
    /// in a stretch are meshed, but for kernels and for places.
    pub fn estimate(
        &self,
        particles: &(impl Particles + ?Sized),
        surfacing: &Surfacing,
        bins: impl Iterator<Item = (MortonKey, usize)> + Clone,
        stretch: Stretch,
    ) -> MemoryEstimate {
        let Self { grid, method, side, spacing, resources, .. } = self;
        let attributes = particles.attributes();
        let sorted = self.sorted_attributes().into_iter();
        let components = sorted.map(|index| attributes[index].components).collect();
        let drawing = surfacing.drawing(*method, *spacing, grid, components);
        let shape = method.indicator().map(|kind| kind.shape(*side));
        // Blocks that are meshed have a surface from the bins next to them as well.
        let near = |bin: IVec3| {
            let around = CellBox { lo: bin - 1, hi: bin + 2 };
            stretch == Stretch::ALL || around.cubes(1).any(|bin| stretch.holds_bin(bin))
        };
        let lookup = BinPlan::lookup_bytes(particles.len(), stretch != Stretch::ALL);
        let estimate = MemoryEstimate::of(bins, shape, &drawing, particles.resident_bytes(), near);
        let sampling = rayon::current_num_threads() as u64 * lookup;
        MemoryEstimate { sampling, ..estimate }.and_backend(resources.host_bytes())
    }

    /// Bytes of a surface that may be in memory while parts are merged, when only lists of its
    /// blocks and of full bins are in memory besides.
    pub fn merging_share(
        &self,
        surfacing: &Surfacing,
        components: &[usize],
        blocks: u64,
        bins: u64,
    ) -> u64 {
        let drawing = surfacing.drawing(self.method, self.spacing, &self.grid, components.to_vec());
        let estimate =
            MemoryEstimate::without_particles(&drawing).and_backend(self.resources.host_bytes());
        let index = blocks * Spool::BLOCK_BYTES + bins * OccupiedTiles::BIN_BYTES;
        MemoryEstimate { index, ..estimate }.surface_share(self.resources.budget)
    }
}

/// Refuses attributes that exceed the budget even for a single block through which the surface
/// passes as a plane: its values, and their copy on the way to a scratch file.
fn refuse_wide_attributes(
    particles: &(impl Particles + ?Sized),
    sampling: &Sampling,
) -> Result<(), FrameError> {
    let attributes = particles.attributes();
    let components = sampling.carried.iter().map(|&index| attributes[index].components).sum();
    let values = 2 * (BLOCK as u64).pow(2);
    let needed = values.saturating_mul(components as u64 * size_of::<f32>() as u64);
    let budget = sampling.resources.budget.max(SMALLEST_BUDGET).0;
    if needed > budget {
        return Err(FrameError::WideAttributes { components, needed, budget });
    }
    Ok(())
}

/// The error for particles that touch more bins than there is room for.
fn over_budget(
    particles: &(impl Particles + ?Sized),
    sampling: &Sampling,
    room: CountingRoom,
) -> FrameError {
    FrameError::OverBudget(OverBudget {
        cell_size: sampling.grid.cell_size(),
        budget: sampling.resources.budget.0,
        fitting_cell_size: fitting_cell_size(particles, sampling, room),
    })
}

/// The smallest doubling of the cell size with which the tables of bins fit.
fn fitting_cell_size(
    particles: &(impl Particles + ?Sized),
    sampling: &Sampling,
    room: CountingRoom,
) -> f64 {
    let mut cell = sampling.grid.cell_size();
    loop {
        cell *= 2.0;
        let Ok(grid) = Grid::new(sampling.grid.origin(), cell) else { return cell };
        // Walls keep particles out; without them there are only more bins.
        if BinPlan::count(particles, &grid, None, InvalidParticles::Skip, room).is_ok() {
            return cell;
        }
    }
}
