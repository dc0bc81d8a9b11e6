//! A frame with the field of a kernel method.

use crate::baselines::{KernelField, KernelMethod, Spacing, kernel_field};
use crate::brick::{Bins, FrameFacts};
use crate::field::blur::Smoothing;
use crate::field::indicator::IndicatorKind;
use crate::frame::estimate::MemoryPlan;
use crate::grid::LevelRegion;
use crate::grid::units::Sigma;
use crate::grid::{Grid, PeriodicMesh};
use crate::surface::dual_mc::{Crossings, Normals};

use super::surface::{ExtractableField, cube_by_cube};
use super::{FrameError, Resources};

/// The kernels of a frame.
#[derive(Debug)]
pub(super) struct SampledKernels {
    pub(super) facts: FrameFacts,
    pub(super) method: KernelMethod,
    field: Box<dyn KernelField>,
    /// A Gaussian that has the same reach as the kernels.
    attribute_smoothing: Smoothing,
}

impl SampledKernels {
    /// Computes the kernels of [sorted](Bins::sorted) particles.
    pub(super) fn sample(
        bins: &Bins,
        facts: FrameFacts,
        method: KernelMethod,
        plan: MemoryPlan,
        resources: &Resources,
    ) -> Result<Self, FrameError> {
        let spacing = kernel_spacing(facts.spacing, &facts.grid)?;
        let share = match plan {
            MemoryPlan::InCore => u64::MAX,
            MemoryPlan::OutOfCore(shares) => shares.field,
        };
        let field = kernel_field(bins, method, spacing, share, &resources.scratch)
            .map_err(resources.scratch_error())?;
        Ok(Self { facts, method, field, attribute_smoothing: attribute_smoothing(spacing.cells()) })
    }

    /// The field from which the surface is extracted.
    pub(super) fn extracted(
        &self,
        normals: Normals,
        periodic_mesh: PeriodicMesh,
    ) -> ExtractableField<'_> {
        let walls = self.facts.mesh_walls(periodic_mesh).map(|walls| walls.cells());
        ExtractableField {
            regions: self.field.regions(walls).into_iter().map(LevelRegion::finest).collect(),
            crossings: Crossings::Fractions,
            attribute_smoothing: vec![self.attribute_smoothing.clone()],
            empty_error: FrameError::NoKernelSurface,
            contour: cube_by_cube(1, move |regions, meter| {
                let regions = regions.iter().take_while(|_| meter.goes_on());
                let meshes = regions.map(|&LevelRegion { cells: region, .. }| {
                    meter.add(1);
                    self.field.mesh(region, normals, walls)
                });
                meshes.filter_map(Result::transpose).collect()
            }),
        }
    }
}

/// The particles' spacing in cells, checked for kernels.
pub(super) fn kernel_spacing(spacing: Option<f64>, grid: &Grid) -> Result<Spacing, FrameError> {
    Ok(Spacing::new(spacing.ok_or(FrameError::NoSpacing)? / grid.cell_size())?)
}

/// A Gaussian with the reach of kernels for `spacing`, which is in cells.
pub(super) fn attribute_smoothing(spacing: f64) -> Smoothing {
    let sigma = ((Spacing::SUPPORT * spacing).ceil() + 1.0) / 3.0;
    let sigma = Sigma::new(sigma.min(Sigma::MAX)).expect("a length within the bounds");
    Smoothing::new(IndicatorKind::Symmetry, sigma)
}
