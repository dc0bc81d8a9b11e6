//! A surface by one of the kernel methods: the same budget, bins and stitching, without a DIF.

use std::io;

use rayon::prelude::*;

use crate::brick::{BinPlan, Bins, Census};
use crate::estimate::{Estimate, Plan, Shares};
use crate::grid::Domain;
use crate::laps::Laps;
use crate::mesh::BlockMesh;
use crate::mesh::spool::Spool;
use crate::particles::Particles;
use crate::rivals::{Method, Spacing, kernel_field};
use crate::stage::attribute::vertex_values;
use crate::stage::blur::Smoothing;
use crate::stage::dual_mc::{Crossings, Normals};
use crate::stage::indicator::Indicator;
use crate::stitch::Stitched;
use crate::units::Sigma;

use super::{BATCH, Counted, FrameError, Sampling, carried_infos};

/// A surface by a kernel method.
#[derive(Debug)]
pub struct KernelSurface {
    /// Stitched, as for a DIF.
    pub mesh: Stitched,
    /// What became of the particles.
    pub census: Census,
}

/// The surface of `particles` by a kernel method. Of `sampling` the indicator and the bricks' side have no meaning
/// here, the backend is always the processor, and the spacing must be known.
///
/// Attributes are carried to the vertices as for a DIF, smoothed by a Gaussian as wide as the kernels.
///
/// # Errors
/// Those of [`Frame::sample`](super::Frame::sample) and [`Frame::surface`](super::Frame::surface), and
/// [`FrameError::Kernels`] where there are too many cells a spacing.
///
/// # Panics
/// Where the spacing is not known.
pub fn rival_surface(
    particles: &(impl Particles + ?Sized),
    sampling: &Sampling,
    method: Method,
    with: Normals,
    laps: &mut Laps,
) -> Result<KernelSurface, FrameError> {
    let Sampling { grid, domain, carried, resources, .. } = sampling;
    let spacing = sampling.spacing.expect("kernels are as wide as the spacing says");
    let spacing = Spacing::new(spacing / grid.cell_size())?;
    let Counted { plan: bin_plan, estimate, .. } = Counted::of(particles, sampling)?;
    laps.lap("count");
    // Kernels are kept until the surface is done, as attributes are.
    let census = bin_plan.census();
    let kernel_bytes = census.binned as u64 * method.kernel_bytes();
    let particle_bytes = estimate.particles + kernel_bytes;
    let estimate = Estimate { particles: particle_bytes, field: 0, carried: true, ..estimate };
    let plan = estimate.plan(resources.budget);
    resources.check_room(estimate.least_scratch(plan))?;
    let in_scratch = resources.scratch_error();
    let (bins, kernel_share) = match plan {
        Plan::InCore => (bin_plan.fill(particles, carried), u64::MAX),
        Plan::OutOfCore(shares) => {
            let bins = spilled(bin_plan, particles, sampling, shares).map_err(&in_scratch)?;
            (bins, shares.particles / 2)
        }
    };
    let bins = bins.sorted().map_err(&in_scratch)?;
    laps.lap("bin");
    let field =
        kernel_field(&bins, method, spacing, kernel_share, &resources.scratch).map_err(&in_scratch)?;
    laps.lap("kernels");

    let attributes = carried_infos(particles.attributes(), carried);
    let components: Vec<usize> = attributes.iter().map(|info| info.components).collect();
    let walls = domain.as_ref().map(Domain::cells);
    let smoothing = smoothing(spacing);
    let carry = |mesh: &mut BlockMesh| -> io::Result<()> {
        for attribute in components.iter().copied().enumerate() {
            let values = vertex_values(&bins, attribute, &smoothing, mesh, Crossings::Fractions, walls)?;
            mesh.attributes.push(values);
        }
        Ok(())
    };
    let mut spool = Spool::in_memory(with == Normals::Gradient, components.clone());
    for regions in field.regions(walls).chunks(BATCH) {
        let block = |&region| {
            let mut mesh = field.mesh(region, with, walls)?;
            mesh.iter_mut().try_for_each(carry)?;
            Ok(mesh)
        };
        let blocks: Vec<Option<BlockMesh>> =
            regions.par_iter().map(block).collect::<io::Result<_>>().map_err(&in_scratch)?;
        blocks.into_iter().flatten().try_for_each(|block| spool.push(block)).map_err(&in_scratch)?;
        if spool.bytes() > estimate.surface_share(resources.budget) {
            spool.move_to_file(&resources.scratch).map_err(&in_scratch)?;
        }
    }
    laps.lap("mesh");
    if spool.is_empty() {
        return Err(FrameError::NoKernelSurface);
    }
    let mesh = Stitched::new(spool, *grid, *domain, Crossings::Fractions, attributes);
    Ok(KernelSurface { mesh, census })
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
