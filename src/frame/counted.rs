//! Counted particles. At this stage, the memory of a frame is estimated, and a frame that needs too
//! much memory is rejected.

use glam::IVec3;

use crate::brick::{BinError, BinPlan, Census, CountingRoom, InvalidParticles, WithImages};
use crate::frame::estimate::{MemoryEstimate, OverBudget, SMALLEST_BUDGET};
use crate::grid::stretch::{Stretch, WantedBins};
use crate::grid::{BLOCK, CellBox, Grid, MortonKey};
use crate::particles::{MeteredParticles, Particles};
use crate::surface::mesh::spool::Spool;
use crate::system::control::Stage;

use super::{FrameError, Method, OccupiedTiles, Sampling, Surfacing};

/// Particles that were counted by bin. They are not stored yet, so that the memory of the frame can
/// be estimated first.
pub struct CountedFrame<'a> {
    pub(super) particles: WithImages<'a>,
    pub(super) sampling: &'a Sampling,
    pub(super) plan: BinPlan,
    census: Census,
    surfacing: Surfacing,
    /// The blocks to mesh.
    stretch: Stretch,
}

impl<'a> CountedFrame<'a> {
    /// Counts the particles, and checks that they can be processed.
    ///
    /// # Errors
    /// [`FrameError`] if particles cannot be placed, if there are none, or if there are more
    /// particles than the budget can hold.
    pub fn of(particles: &'a dyn Particles, sampling: &'a Sampling) -> Result<Self, FrameError> {
        Self::planned(particles, sampling, None)
    }

    /// Counts the particles, or uses `plan`, an earlier count of all particles with the same
    /// sampling.
    fn planned(
        particles: &'a dyn Particles,
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

    /// Returns the particles, with their images in a periodic box, and the plan that `count`
    /// computes for them.
    fn with_images(
        input: &'a dyn Particles,
        sampling: &'a Sampling,
        invalid: InvalidParticles,
        count: impl FnOnce(&WithImages<'a>, CountingRoom) -> Result<BinPlan, BinError>,
    ) -> Result<(WithImages<'a>, BinPlan), FrameError> {
        let Sampling { grid, domain, periodic, spacing, resources, .. } = sampling;
        let metered = MeteredParticles::new(input, &resources.control, Stage::Counting);
        let (domain, periodic) = (domain.as_ref(), periodic.as_ref());
        let spacing = spacing.unwrap_or(grid.cell_size());
        let particles = WithImages::of(metered, grid, domain, periodic, spacing, invalid);
        resources.go_on()?;
        input.check()?;
        check_attribute_memory(input, sampling)?;
        let particles = particles?;
        let room = CountingRoom::within(resources.budget.0);
        let plan = count(&particles, room);
        // After a cancel, positions are read as NaN, so the plan is useless.
        resources.go_on()?;
        input.check()?;
        let plan = match plan {
            Err(BinError::TooManyBins { .. }) => return Err(over_budget(input, sampling, room)),
            plan => plan?,
        };
        Ok((particles, plan))
    }

    /// Counts only the particles and, in a periodic box, the images in the `wanted` bins. These
    /// bins may be empty. Invalid particles are skipped, because they were refused or skipped in an
    /// earlier count of all particles.
    pub fn of_wanted(
        particles: &'a dyn Particles,
        sampling: &'a Sampling,
        surfacing: &Surfacing,
        wanted: WantedBins,
    ) -> Result<Self, FrameError> {
        let Sampling { grid, domain, .. } = sampling;
        let count = |particles: &WithImages<'a>, room| {
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

    /// Checks the surface request, then counts the particles for it. If `plan` is given, it
    /// replaces the count. `plan` must be a count of all particles, and the settings that affect a
    /// plan must not have changed since it was made.
    pub fn for_surface(
        particles: &'a dyn Particles,
        sampling: &'a Sampling,
        surfacing: &Surfacing,
        plan: Option<BinPlan>,
    ) -> Result<Self, FrameError> {
        sampling.check_fit(surfacing)?;
        Ok(Self { surfacing: surfacing.clone(), ..Self::planned(particles, sampling, plan)? })
    }

    /// Returns the number of binned particles, and the number of skipped particles by reason.
    pub fn census(&self) -> Census {
        self.census
    }

    /// The bins that contain particles, in Morton order, each with its number of particles.
    pub fn bins(&self) -> impl Iterator<Item = (MortonKey, usize)> + Clone + '_ {
        self.plan.keys().iter().copied().zip(self.plan.counts())
    }

    /// Estimates the memory and disk space of the frame.
    pub fn estimate(&self) -> MemoryEstimate {
        let bins = self.bins();
        let estimate = self.sampling.estimate(&self.particles, &self.surfacing, bins, self.stretch);
        let estimate = MemoryEstimate { counted_positions: self.plan.places_bytes(), ..estimate };
        match self.sampling.method {
            // If particles have several sizes, two DIFs are computed for each octave from the
            // sorted particles: one for the particles' volumes, and one for their sizes.
            Method::Indicator { .. } if self.sampling.sizes.is_some() => {
                MemoryEstimate { field: 2 * estimate.field, carried: true, ..estimate }
            }
            Method::Indicator { .. } => estimate,
            // The kernels of particles and images are kept until the surface is done. In the worst
            // case, the particles are kept as well.
            Method::Kernels(kernels) => {
                let bytes = self.plan.census().binned as u64 * kernels.kernel_bytes();
                MemoryEstimate { particles: estimate.particles + bytes, carried: true, ..estimate }
            }
        }
    }
}

impl Sampling {
    /// Estimates the memory and disk space of a frame with these `bins`, without the memory for its
    /// kernels and for the positions that counting keeps. Only the blocks in `stretch` are meshed.
    pub fn estimate(
        &self,
        particles: &dyn Particles,
        surfacing: &Surfacing,
        bins: impl Iterator<Item = (MortonKey, usize)> + Clone,
        stretch: Stretch,
    ) -> MemoryEstimate {
        let Self { grid, method, side, spacing, resources, .. } = self;
        let attributes = particles.attributes();
        let sorted = self.sorted_attributes().into_iter();
        let components = sorted.map(|index| attributes[index].components).collect();
        let coarsest = self.coarsest();
        let mut extraction = surfacing.extraction(*method, *spacing, coarsest, grid, components);
        if self.periodic.is_some() {
            extraction.levels = 1;
        }
        let shape = method.indicator().map(|kind| kind.shape(*side));
        // Particles in the bins next to meshed blocks also affect the surface in these blocks.
        let near = |bin: IVec3| {
            let around = CellBox { lo: bin - 1, hi: bin + 2 };
            stretch == Stretch::ALL || around.cubes(1).any(|bin| stretch.contains_bin(bin))
        };
        let lookup = BinPlan::lookup_bytes(particles.len(), stretch != Stretch::ALL);
        let estimate =
            MemoryEstimate::of(bins, shape, &extraction, particles.resident_bytes(), near);
        let sampling = rayon::current_num_threads() as u64 * lookup;
        MemoryEstimate { sampling, ..estimate }.and_backend(resources.host_bytes())
    }

    /// Maximum bytes of the surface in memory while parts are merged. Besides the surface, only the
    /// lists of its blocks and of the bins with particles are then in memory.
    pub fn merging_share(
        &self,
        surfacing: &Surfacing,
        components: &[usize],
        blocks: u64,
        bins: u64,
    ) -> u64 {
        let extraction =
            surfacing.extraction(self.method, self.spacing, None, &self.grid, components.to_vec());
        let estimate =
            MemoryEstimate::without_particles(&extraction).and_backend(self.resources.host_bytes());
        let index = blocks * Spool::BLOCK_BYTES + bins * OccupiedTiles::BIN_BYTES;
        MemoryEstimate { index, ..estimate }.surface_share(self.resources.budget)
    }
}

/// Returns an error if the budget cannot hold the attributes of a single block through which the
/// surface passes as a plane. The values of a block are in memory twice, because they are copied on
/// the way to a scratch file.
fn check_attribute_memory(
    particles: &dyn Particles,
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

/// The error for particles that lie in more bins than the budget allows.
fn over_budget(particles: &dyn Particles, sampling: &Sampling, room: CountingRoom) -> FrameError {
    FrameError::OverBudget(OverBudget {
        cell_size: sampling.grid.cell_size(),
        budget: sampling.resources.budget.0,
        fitting_cell_size: fitting_cell_size(particles, sampling, room),
    })
}

/// The cell size, doubled until the tables of bins fit into the budget.
fn fitting_cell_size(particles: &dyn Particles, sampling: &Sampling, room: CountingRoom) -> f64 {
    let mut cell = sampling.grid.cell_size();
    loop {
        cell *= 2.0;
        let Ok(grid) = Grid::new(sampling.grid.origin(), cell) else { return cell };
        // Walls never increase the number of bins, so a count without walls is an upper bound.
        if BinPlan::count(particles, &grid, None, InvalidParticles::Skip, room).is_ok() {
            return cell;
        }
    }
}
