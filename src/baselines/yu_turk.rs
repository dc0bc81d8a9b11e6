//! Yu and Turk 2013, "Reconstructing surfaces of particle-based fluids using anisotropic kernels".
//!
//! phi(x) = sum_i W(x - xbar_i, G_i) m_i / rho_i with W(r, G) = s det(G) w(|G r|), and m_i / rho_i
//! as in Mueller's method.
//!
//! The following sums run over the particles j whose distance from x_i is less than R = 2 h. Their
//! weights are w_ij = 1 - (|x_i - x_j| / R)^3, and their weighted mean is x_i^w:
//!
//! - xbar_i = (1 - lambda) x_i + lambda x_i^w (their eq. 6), with lambda = 1/2;
//! - C_i = sum_j w_ij (x_j - x_i^w)(x_j - x_i^w)^T / sum_j w_ij (their eq. 9), decomposed as A
//!   diag(s_1, s_2, s_3) A^T, where s_1 is the greatest;
//! - s'_k = k_s max(s_k, s_1 / k_r) if there are more than N_e other particles, and otherwise s'_k
//!   = k_n (their eq. 15);
//! - G_i = A diag(1 / s'_k) A^T / h (their eq. 16).
//!
//! k_r = 4, k_n = 0.5 and N_e = 25 are from their paper. Their lambda is 0.9, but since h is two
//! spacings here, 0.9 would move the particles of a flat surface inwards by more than a spacing.
//! Therefore lambda is 1/2, as in the implementation that the DIF paper compares with (Kim, Fluid
//! Engine Development, 2016). Their k_s makes k_s C about the identity deep in the fluid, so k_s
//! depends on the unit of length. Here, k_s follows from a uniform density, for which C is 0.15 R^2
//! times the identity.

use glam::{DMat3, DVec3};

use super::eigen::symmetric_eigen;
use super::mueller::density;
use super::neighbours::NeighbourGrid;
use super::scheme::{Scheme, Spacing, weight};

/// The centre of a kernel moves this fraction of the way from the particle to the mean of the
/// particle's neighbours.
const LAMBDA: f64 = 0.5;
/// Maximum ratio of a kernel's length to its width.
const K_R: f64 = 4.0;
/// The width of a kernel with few neighbours, divided by h.
const K_N: f64 = 0.5;
/// A particle with at most this many neighbours has a kernel of the width `K_N`.
const N_EPSILON: usize = 25;
/// The neighbourhood's radius, divided by h.
const NEIGHBOURHOOD: f64 = 2.0;
/// The distance within which particles affect the field, divided by h: the maximum distance to a
/// particle's neighbours, plus the reach of the particle's kernel. The reach is taken to be 2 h,
/// because a kernel in a fluid hardly ever reaches more than twice as far as at uniform density.
pub const REACH: f64 = NEIGHBOURHOOD + 2.0;
/// The eigenvalues of C, divided by R^2, if the density is uniform.
const UNIFORM: f64 = 0.15;

/// The method of Yu and Turk. Its field is phi - iso.
#[derive(Debug)]
pub struct YuTurk {
    /// The length h.
    support: f64,
    iso: f64,
}

impl YuTurk {
    pub fn new(spacing: Spacing, iso: f64) -> Self {
        Self { support: spacing.support(), iso }
    }

    /// The weighted mean of the particles around `place`, and A diag(s'_k) A^T.
    fn ellipsoid(&self, place: DVec3, neighbours: &NeighbourGrid) -> (DVec3, DMat3) {
        let radius = self.neighbourhood();
        let mut found = 0;
        let (mut weights, mut first, mut second) = (0.0, DVec3::ZERO, DMat3::ZERO);
        neighbours.within(place, radius, |offset, squared| {
            let weight = 1.0 - (squared.sqrt() / radius).powi(3);
            let weighted = weight * offset;
            found += 1;
            weights += weight;
            first += weighted;
            second +=
                DMat3::from_cols(weighted * offset.x, weighted * offset.y, weighted * offset.z);
        });
        // The particle itself is also found, with weight 1, so `weights` is at least 1.
        let mean = first / weights;
        let outer = DMat3::from_cols(mean * mean.x, mean * mean.y, mean * mean.z);
        let covariance = second * weights.recip() - outer;
        let (eigenvalues, eigenvectors) = symmetric_eigen(covariance);
        let greatest = eigenvalues.max_element() / (UNIFORM * radius * radius);
        // If all particles are at the same position, the covariance is zero and defines no widths.
        let widths = if found > N_EPSILON + 1 && greatest > f64::EPSILON {
            let scaled = eigenvalues / (UNIFORM * radius * radius);
            scaled.max(DVec3::splat(greatest / K_R))
        } else {
            DVec3::splat(K_N)
        };
        (place + mean, eigenvectors * DMat3::from_diagonal(widths) * eigenvectors.transpose())
    }
}

/// A particle's kernel.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Ellipsoid {
    centre: DVec3,
    /// The matrix G.
    shape: DMat3,
    /// The factor det(G) h^3 / sum_j w(x_i - x_j) of the kernel.
    share: f64,
    reach: DVec3,
}

impl Scheme for YuTurk {
    type Kernel = Ellipsoid;
    type Sum = f64;

    fn neighbourhood(&self) -> f64 {
        NEIGHBOURHOOD * self.support
    }

    fn kernel(&self, place: DVec3, neighbours: &NeighbourGrid) -> Ellipsoid {
        let (mean, widths) = self.ellipsoid(place, neighbours);
        let axes = self.support * widths;
        Ellipsoid {
            centre: place.lerp(mean, LAMBDA),
            shape: axes.inverse(),
            share: 1.0 / (widths.determinant() * density(place, self.support, neighbours)),
            // A linear map turns the unit ball into an ellipsoid, whose extent along each axis is
            // the length of a row of the map.
            reach: DVec3::new(axes.row(0).length(), axes.row(1).length(), axes.row(2).length()),
        }
    }

    #[inline]
    fn extent(&self, kernel: &Ellipsoid) -> [DVec3; 2] {
        [kernel.centre, kernel.reach]
    }

    #[inline]
    fn add(&self, kernel: &Ellipsoid, point: DVec3, sum: &mut f64) {
        *sum += kernel.share * weight((kernel.shape * point).length_squared());
    }

    fn field(&self, sum: f64) -> f64 {
        sum - self.iso
    }
}
