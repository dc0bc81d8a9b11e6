//! Zhu and Bridson 2005, "Animating sand as a fluid".
//!
//! phi(x) = |x - xbar| - r with xbar = sum_j x_j w(x - x_j) / sum_j w(x - x_j), where w reaches 4 r
//! and r is half of the spacing. Where no particle is within 4 r, phi is set to 3 r, because phi is
//! less than 3 r everywhere else.

use glam::DVec3;

use super::neighbours::NeighbourGrid;
use super::scheme::{Scheme, Spacing, weight};

/// The method of Zhu and Bridson. Its field is -phi.
#[derive(Debug)]
pub struct ZhuBridson {
    support: f64,
    radius: f64,
}

impl ZhuBridson {
    pub fn new(spacing: Spacing) -> Self {
        Self { support: spacing.support(), radius: spacing.radius() }
    }
}

impl Scheme for ZhuBridson {
    /// The particle's position.
    type Kernel = [f64; 3];
    /// The sum of the weighted positions relative to the point, and the sum of the weights.
    type Sum = [f64; 4];

    fn neighbourhood(&self) -> f64 {
        0.0
    }

    fn kernel(&self, place: DVec3, _: &NeighbourGrid) -> [f64; 3] {
        place.to_array()
    }

    #[inline]
    fn extent(&self, &place: &[f64; 3]) -> [DVec3; 2] {
        [place.into(), DVec3::splat(self.support)]
    }

    #[inline]
    fn add(&self, _: &[f64; 3], point: DVec3, sum: &mut [f64; 4]) {
        let weight = weight(point.length_squared() / (self.support * self.support));
        let weighted = (-point * weight).extend(weight).to_array();
        sum.iter_mut().zip(weighted).for_each(|(sum, x)| *sum += x);
    }

    fn field(&self, [x, y, z, weight]: [f64; 4]) -> f64 {
        if weight > 0.0 {
            self.radius - DVec3::new(x, y, z).length() / weight
        } else {
            self.radius - self.support
        }
    }
}
