//! The common interface of kernel methods, and the width of their kernels.

use std::fmt::Debug;

use bytemuck::Pod;
use glam::DVec3;
use thiserror::Error;

use super::neighbours::NeighbourGrid;

/// The particles' spacing in cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spacing(f64);

/// A spacing that is too large for the cells.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error("kernel methods support at most {max} cells per spacing, got {0}; use larger cells", max = Spacing::MAX)]
pub struct TooManyCells(pub f64);

impl Spacing {
    /// The maximum spacing in cells. Kernels that reach more cells would need more memory than each
    /// thread can use.
    pub const MAX: f64 = 16.0;

    /// The reach of an isotropic kernel, in spacings: four times the particles' radius.
    pub const SUPPORT: f64 = 2.0;

    /// A spacing in cells.
    ///
    /// # Errors
    /// [`TooManyCells`] if `cells` exceeds [`MAX`](Self::MAX).
    pub fn new(cells: f64) -> Result<Self, TooManyCells> {
        if cells <= Self::MAX { Ok(Self(cells)) } else { Err(TooManyCells(cells)) }
    }

    /// The spacing in cells.
    pub fn cells(self) -> f64 {
        self.0
    }

    /// The reach of an isotropic kernel, in cells.
    pub(super) fn support(self) -> f64 {
        Self::SUPPORT * self.0
    }

    pub(super) fn radius(self) -> f64 {
        self.0 / 2.0
    }
}

/// The weight w of eq. 3 in the paper by Mueller et al., for an argument whose square is `squared`.
#[inline]
pub(super) fn weight(squared: f64) -> f64 {
    let remainder = (1.0 - squared).max(0.0);
    remainder * remainder * remainder
}

/// A kernel method, which computes a field from the kernels of the particles.
pub(super) trait Scheme: Debug + Send + Sync {
    /// The kernel of a particle: its contribution to sums. Positions are relative to the lowest
    /// corner of the particle's bin.
    type Kernel: Pod + Send + Sync + Debug;
    /// The sum of the kernels at a point, from which the field is computed.
    type Sum: Copy + Default;

    /// The distance from a particle within which other particles affect its kernel.
    fn neighbourhood(&self) -> f64;

    /// The kernel of a particle.
    fn kernel(&self, place: DVec3, neighbours: &NeighbourGrid) -> Self::Kernel;

    /// The position of a kernel, and its reach along each axis.
    fn extent(&self, kernel: &Self::Kernel) -> [DVec3; 2];

    /// Adds the contribution of `kernel` at `point` to `sum`. `point` is relative to the kernel's
    /// position.
    fn add(&self, kernel: &Self::Kernel, point: DVec3, sum: &mut Self::Sum);

    /// The field at a point where the kernels add up to `sum`.
    fn field(&self, sum: Self::Sum) -> f64;
}
