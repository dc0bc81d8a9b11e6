//! A surface by one of the kernel methods: the same budget, bins and stitching, without a DIF.

use std::io;

use rayon::prelude::*;

use crate::brick::{BinPlan, Bins, Census};
use crate::estimate::{Plan, Shares};
use crate::grid::{CellBox, Domain};
use crate::laps::Laps;
use crate::mesh::BlockMesh;
use crate::mesh::spool::Spool;
use crate::particles::{AttributeInfo, Particles};
use crate::rivals::{KernelField, Method, Spacing, kernel_field};
use crate::simplify::{Reduction, Simplified};
use crate::stage::blur::Smoothing;
use crate::stage::dual_mc::{Crossings, Normals};
use crate::stage::indicator::Indicator;
use crate::stitch::Stitched;
use crate::units::{MemoryBudget, Sigma};

use super::blocks::mesh_blocks;
use super::{Counted, FrameError, Resources, Sampling, carried_infos, carry};

/// The kernels of a frame, and what else its surface needs.
#[derive(Debug)]
pub struct KernelFrame {
    method: Method,
    sampling: Sampling,
    census: Census,
    field: Box<dyn KernelField>,
    bins: Bins,
    /// What the vertices carry.
    attributes: Vec<AttributeInfo>,
    /// Of the attributes: as wide as the kernels.
    smoothing: Smoothing,
    surface_share: u64,
}

impl KernelFrame {
    /// Works out the kernels of `particles`. Of `sampling` the indicator and the bricks' side have no meaning here, the
    /// backend is always the processor, and the spacing must be known.
    ///
    /// # Errors
    /// [`FrameError::Kernels`] where there are too many cells a spacing, and else those of
    /// [`Frame::sample`](super::Frame::sample).
    ///
    /// # Panics
    /// Where the spacing is not known.
    pub fn sample(
        particles: &(impl Particles + ?Sized),
        sampling: &Sampling,
        method: Method,
        laps: &mut Laps,
    ) -> Result<Self, FrameError> {
        let counted = Counted::of(particles, sampling)?;
        laps.lap("count");
        Self::sample_counted(counted, method, sampling.resources.budget, laps)
    }

    /// The same for particles that have been counted, under a budget of its own.
    ///
    /// # Errors
    /// [`FrameError::Kernels`], more than the disk can hold, and scratch files that fail.
    ///
    /// # Panics
    /// Where the spacing is not known.
    pub fn sample_counted<P: Particles + ?Sized>(
        counted: Counted<'_, P>,
        method: Method,
        budget: MemoryBudget,
        laps: &mut Laps,
    ) -> Result<Self, FrameError> {
        let counted = counted.for_kernels(method);
        let estimate = counted.estimate();
        let Counted { particles, sampling, plan: bin_plan, .. } = counted;
        let resources = Resources { budget, ..sampling.resources.clone() };
        let sampling = Sampling { resources, ..sampling.clone() };
        let Sampling { grid, carried, resources, .. } = &sampling;
        let spacing = sampling.spacing.expect("kernels are as wide as the spacing says");
        let spacing = Spacing::new(spacing / grid.cell_size())?;
        let census = bin_plan.census();
        let plan = estimate.plan(budget);
        resources.check_room(estimate.least_scratch(plan))?;
        let (bins, kernel_share) = match plan {
            Plan::InCore => (bin_plan.fill(particles, carried), u64::MAX),
            Plan::OutOfCore(shares) => {
                let bins =
                    spilled(bin_plan, particles, &sampling, shares).map_err(resources.scratch_error())?;
                (bins, shares.particles / 2)
            }
        };
        let bins = bins.sorted().map_err(resources.scratch_error())?;
        laps.lap("bin");
        let field = kernel_field(&bins, method, spacing, kernel_share, &resources.scratch)
            .map_err(resources.scratch_error())?;
        laps.lap("kernels");
        Ok(Self {
            method,
            census,
            field,
            bins,
            attributes: carried_infos(particles.attributes(), carried),
            smoothing: smoothing(spacing),
            surface_share: estimate.surface_share(budget),
            sampling,
        })
    }

    /// The surface of the frame. Attributes are carried to its vertices as for a DIF, smoothed by a Gaussian as wide as
    /// the kernels.
    ///
    /// # Errors
    /// [`FrameError::NoKernelSurface`], and [`FrameError::Scratch`] where scratch files fail.
    pub fn surface(&self, normals: Normals, laps: &mut Laps) -> Result<Stitched, FrameError> {
        let Sampling { grid, domain, resources, .. } = &self.sampling;
        let components = self.attributes.iter().map(|info| info.components).collect();
        let mut spool = Spool::in_memory(normals == Normals::Gradient, components);
        self.mesh_blocks(normals, &mut spool).map_err(resources.scratch_error())?;
        laps.lap("mesh");
        if spool.is_empty() {
            return Err(FrameError::NoKernelSurface);
        }
        Ok(Stitched::new(spool, *grid, *domain, Crossings::Fractions, self.attributes.clone()))
    }

    /// Meshes all blocks in Morton order into `spool`.
    fn mesh_blocks(&self, normals: Normals, spool: &mut Spool) -> io::Result<()> {
        let Self { bins, attributes, smoothing, .. } = self;
        let walls = self.sampling.domain.as_ref().map(Domain::cells);
        let block = |&region: &CellBox| {
            let mut mesh = self.field.mesh(region, normals, walls)?;
            if let Some(mesh) = &mut mesh {
                carry(bins, attributes, smoothing, Crossings::Fractions, walls, mesh)?;
            }
            Ok(mesh)
        };
        let scratch = &self.sampling.resources.scratch;
        mesh_blocks(spool, &self.field.regions(walls), self.surface_share, scratch, |regions| {
            let blocks: Vec<Option<BlockMesh>> = regions.par_iter().map(block).collect::<io::Result<_>>()?;
            Ok(blocks.into_iter().flatten().collect())
        })
    }

    /// Whose kernels they are.
    #[must_use]
    pub fn method(&self) -> Method {
        self.method
    }

    /// How its particles were sampled.
    #[must_use]
    pub fn sampling(&self) -> &Sampling {
        &self.sampling
    }

    /// What became of the particles.
    #[must_use]
    pub fn census(&self) -> Census {
        self.census
    }

    /// The surface with what a reduction leaves of it.
    ///
    /// # Errors
    /// [`FrameError::NothingLeft`], and [`FrameError::Scratch`] where scratch files fail.
    pub fn simplify(
        &self,
        surface: Stitched,
        reduction: &Reduction,
        laps: &mut Laps,
    ) -> Result<Simplified, FrameError> {
        self.sampling.resources.simplify(surface, reduction, self.surface_share, laps)
    }
}

/// Bins beyond memory.
fn spilled(
    plan: BinPlan,
    particles: &(impl Particles + ?Sized),
    Sampling { carried, resources, .. }: &Sampling,
    shares: Shares,
) -> io::Result<Bins> {
    let runs = plan.runs(particles, carried, shares.particles);
    let spilled = plan.spill(particles, carried, runs, &resources.scratch, shares.field as usize)?;
    let mut sorted = spilled.sorted_store(&resources.scratch)?;
    for run in 0..spilled.runs().len() {
        sorted.push(&spilled.load(run)?)?;
    }
    Ok(sorted.finish())
}

/// A Gaussian that reaches as far as the kernels.
fn smoothing(spacing: Spacing) -> Smoothing {
    let sigma = (spacing.support().ceil() + 1.0) / 3.0;
    let sigma = Sigma::new(sigma.min(Sigma::MAX)).expect("a length within the bounds");
    Smoothing::new(Indicator::Symmetry, sigma)
}
