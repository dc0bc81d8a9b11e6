//! Particles that are counted: the last moment to say what a frame will take, and to refuse it.

use crate::brick::{BinError, BinPlan, Census, CountingRoom, InvalidParticles};
use crate::frame::estimate::{Estimate, OverBudget};
use crate::grid::Grid;
use crate::particles::Particles;

use super::{FieldRequest, FrameError, Sampling, Surfacing};

/// Particles that are counted by bin: what they will take is known, and nothing is stored for them yet.
pub struct Counted<'a, P: ?Sized> {
    pub(super) particles: &'a P,
    pub(super) sampling: &'a Sampling,
    pub(super) plan: BinPlan<'a>,
    surfacing: Surfacing,
}

impl<'a, P: Particles + ?Sized> Counted<'a, P> {
    /// Counts the particles, and refuses what cannot be done with them.
    ///
    /// # Errors
    /// [`FrameError`] for particles that cannot be placed, none at all, or more than the budget can hold.
    pub fn of(particles: &'a P, sampling: &'a Sampling) -> Result<Self, FrameError> {
        let Sampling { grid, domain, invalid, resources, .. } = sampling;
        let room = CountingRoom::within(resources.budget.0);
        let plan = BinPlan::count(particles, grid, domain.as_ref(), *invalid, room);
        particles.check()?;
        let plan = match plan {
            Err(BinError::TooManyBins { .. }) => {
                return Err(FrameError::OverBudget(OverBudget {
                    cell_size: grid.cell_size(),
                    budget: resources.budget.0,
                    fitting_cell_size: fitting_cell_size(particles, sampling, room),
                }));
            }
            plan => plan?,
        };
        resources.go_on()?;
        if plan.census().binned == 0 {
            return Err(FrameError::NoParticles(plan.census()));
        }
        Ok(Self { particles, sampling, plan, surfacing: Surfacing::PLAIN })
    }

    /// Refuses what such a surface cannot be drawn through, then counts the particles for it.
    ///
    /// # Errors
    /// Those of [`Sampling::refuse_unfit`] and of [`of`](Self::of).
    pub fn for_surface(
        particles: &'a P,
        sampling: &'a Sampling,
        surfacing: &Surfacing,
    ) -> Result<Self, FrameError> {
        sampling.refuse_unfit(surfacing)?;
        Ok(Self { surfacing: *surfacing, ..Self::of(particles, sampling)? })
    }

    /// Returns how many particles went into bins, and how many were left out and why.
    #[must_use]
    pub fn census(&self) -> Census {
        self.plan.census()
    }

    /// Estimates the memory and disk space that the frame will take.
    #[must_use]
    pub fn estimate(&self) -> Estimate {
        let Sampling { grid, field, side, carried, spacing, resources, .. } = self.sampling;
        let attributes = self.particles.attributes();
        let components = carried.iter().map(|&index| attributes[index].components).collect();
        let drawing = field.drawing(&self.surfacing, *spacing, grid, components);
        let in_memory = self.particles.resident_bytes() + resources.host_bytes();
        let shape = field.indicator().map(|asked| asked.kind.shape(*side));
        let bins = self.plan.keys().iter().copied().zip(self.plan.counts());
        let estimate = Estimate::of(bins, shape, &drawing, in_memory);
        let estimate = Estimate { places: self.plan.places_bytes(), ..estimate };
        match *field {
            FieldRequest::Indicator(_) => estimate,
            // Kernels are kept until the surface is done, and so are the particles at the most.
            FieldRequest::Kernels(method) => {
                let kernels = self.census().binned as u64 * method.kernel_bytes();
                Estimate { particles: estimate.particles + kernels, carried: true, ..estimate }
            }
        }
    }
}

/// The smallest doubling of the cell size with which the tables of bins fit.
fn fitting_cell_size(particles: &(impl Particles + ?Sized), sampling: &Sampling, room: CountingRoom) -> f64 {
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
