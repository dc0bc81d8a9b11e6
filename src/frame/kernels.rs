//! A frame by one of the kernel methods.

use crate::brick::Bins;
use crate::estimate::Plan;
use crate::grid::Grid;
use crate::rivals::{KernelField, Method, Spacing, kernel_field};
use crate::stage::blur::Smoothing;
use crate::stage::indicator::{FrameFacts, IndicatorKind};
use crate::units::Sigma;

use super::{FrameError, Resources};

/// The kernels of a frame.
#[derive(Debug)]
pub(super) struct SampledKernels {
    pub(super) facts: FrameFacts,
    pub(super) method: Method,
    pub(super) field: Box<dyn KernelField>,
    /// A Gaussian that reaches as far as the kernels.
    pub(super) attribute_smoothing: Smoothing,
}

impl SampledKernels {
    /// Works out the kernels of particles in [order](Bins::sorted).
    pub(super) fn sample(
        bins: &Bins,
        facts: FrameFacts,
        method: Method,
        plan: Plan,
        resources: &Resources,
    ) -> Result<Self, FrameError> {
        let spacing = kernel_spacing(facts.spacing, &facts.grid)?;
        let share = match plan {
            Plan::InCore => u64::MAX,
            Plan::OutOfCore(shares) => shares.particles / 2,
        };
        let field = kernel_field(bins, method, spacing, share, &resources.scratch)
            .map_err(resources.scratch_error())?;
        Ok(Self { facts, method, field, attribute_smoothing: attribute_smoothing(spacing.cells()) })
    }
}

/// The particles' spacing in cells, if kernels can be as wide.
pub(super) fn kernel_spacing(spacing: Option<f64>, grid: &Grid) -> Result<Spacing, FrameError> {
    Ok(Spacing::new(spacing.ok_or(FrameError::NoSpacing)? / grid.cell_size())?)
}

/// A Gaussian that reaches as far as the kernels of particles so many cells apart.
pub(super) fn attribute_smoothing(spacing: f64) -> Smoothing {
    let sigma = ((Spacing::SUPPORT * spacing).ceil() + 1.0) / 3.0;
    let sigma = Sigma::new(sigma.min(Sigma::MAX)).expect("a length within the bounds");
    Smoothing::new(IndicatorKind::Symmetry, sigma)
}
