//! Mueller, Charypar and Gross 2003, "Particle-based fluid simulation for interactive applications"
//! (their eq. 2).
//!
//! phi(x) = sum_i W(x - x_i, h) m_i / rho_i with rho_i = sum_j m_j W(x_i - x_j, h). Masses are
//! equal, so they and the scale of W (their eq. 3) cancel: a particle contributes w(x - x_i) /
//! sum_j w(x_i - x_j).

use glam::DVec3;

use super::neighbours::NeighbourGrid;
use super::scheme::{Scheme, Spacing, weight};

/// The method of Mueller et al. Its field is phi - iso.
#[derive(Debug)]
pub struct Mueller {
    support: f64,
    iso: f64,
}

impl Mueller {
    pub fn new(spacing: Spacing, iso: f64) -> Self {
        Self { support: spacing.support(), iso }
    }
}

/// The number density at `place`, divided by the density of a single particle: sum_j w(x_j -
/// place).
pub fn density(place: DVec3, support: f64, neighbours: &NeighbourGrid) -> f64 {
    let mut density = 0.0;
    neighbours
        .within(place, support, |_, squared| density += weight(squared / (support * support)));
    density
}

impl Scheme for Mueller {
    /// The particle's position, and the reciprocal of its density.
    type Kernel = [f64; 4];
    type Sum = f64;

    fn neighbourhood(&self) -> f64 {
        self.support
    }

    fn kernel(&self, place: DVec3, neighbours: &NeighbourGrid) -> [f64; 4] {
        place.extend(density(place, self.support, neighbours).recip()).to_array()
    }

    #[inline]
    fn extent(&self, &[x, y, z, _]: &[f64; 4]) -> [DVec3; 2] {
        [DVec3::new(x, y, z), DVec3::splat(self.support)]
    }

    #[inline]
    fn add(&self, &[.., share]: &[f64; 4], point: DVec3, sum: &mut f64) {
        *sum += share * weight(point.length_squared() / (self.support * self.support));
    }

    fn field(&self, sum: f64) -> f64 {
        sum - self.iso
    }
}
