//! Fits a linear function to the density around each cell (moving least squares, Lancaster and
//! Salkauskas 1981).
//!
//! Each cell has a share: the factor, from 0 to 1, by which its density counts in a fit. The fit
//! needs weighted sums of the shares and of the products of share and density, each also multiplied
//! by coordinates. The weights are a Gaussian, so each sum is computed along x, then along y, then
//! along z. A sum always adds its terms in the same order, so it does not depend on the box of
//! cells in a request.

use std::collections::VecDeque;

use glam::{DMat3, DVec3, IVec3};
use multiversion::multiversion;

use crate::brick::Block;
use crate::field::blur::Weights;
use crate::field::distance::spread;
use crate::grid::CellBox;

use super::WHOLE;

/// The minimum weighted sum of the shares for a fit. The sum would be 1 if all shares were 1.
const LEAST_SUM: f64 = 0.004;
/// The variance that is added to the variances of the positions of a fit's cells, as a fraction of
/// the Gaussian's variance. If all cells of a fit lie in a plane, this variance keeps the linear
/// function nearly constant across the plane. If a fit has few cells, it keeps the function nearly
/// constant in all directions.
const STIFFNESS: f64 = 0.01;
/// Number of different sums along x.
const ALONG_X: usize = 5;
/// For each sum of a [`Plane`]: the index of the sum along x that is added up along y, and the
/// power of y by which each term is multiplied.
const ALONG_Y: [(usize, usize); 9] =
    [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2), (3, 0), (4, 0), (3, 1)];

/// Sums along x and y, at all cells of a box with the same z coordinate, with x varying fastest.
/// Let u be the share of a cell, and f the product of its share and its density. The summed terms
/// are u, u x, u x^2, u y, u x y, u y^2, f, f x and f y, each multiplied by the weights along x and
/// y. Here, x and y are relative to the cell to which the sum belongs.
type Plane = [Vec<f64>; ALONG_Y.len()];

/// Fits linear functions to the densities of the cells outside a solid. The cells' z coordinates
/// must not decrease from one call of [`at`](Self::at) to the next.
pub struct LinearFit<'a> {
    dense: &'a Block,
    usable: &'a Block,
    /// For each cell, the greatest density among the usable cells within the Gaussian's reach.
    greatest: Block,
    /// The weights, multiplied by the signed distance from the centre to the power of 0, 1 and 2.
    weights: [Vec<f64>; 3],
    stiffness: f64,
    /// The latest planes, in ascending order of z.
    planes: VecDeque<Plane>,
    /// The z coordinate of the first plane that was not computed yet.
    next: i32,
}

impl<'a> LinearFit<'a> {
    /// Prepares fits with the weights `gaussian` at the cells of `part`. `usable` is the share of
    /// each cell, in units of 1 / [`WHOLE`], and `dense` is the density of each cell.
    ///
    /// # Panics
    /// If `dense` and `usable` do not consist of `part` and a halo of the reach of `gaussian`.
    pub fn new(gaussian: &Weights, dense: &'a Block, usable: &'a Block, part: CellBox) -> Self {
        let reach = gaussian.reach();
        let mut greatest = dense.clone();
        for (greatest, &share) in greatest.samples_mut().iter_mut().zip(usable.samples()) {
            *greatest = if share > 0 { *greatest } else { 0 };
        }
        let greatest = spread(greatest, reach);
        assert_eq!([greatest.cells(), usable.cells()], [part, dense.cells()]);
        let weight = |k: i32| f64::from(gaussian.half()[k.unsigned_abs() as usize]);
        let weights = [0, 1, 2].map(|power| {
            (-reach..=reach).map(|k| weight(k) * f64::from(k.pow(power)) / 65536.0).collect()
        });
        let stiffness = STIFFNESS * gaussian.variance();
        let (planes, next) = (VecDeque::new(), part.lo.z - reach);
        Self { dense, usable, greatest, weights, stiffness, planes, next }
    }

    /// Memory, in bytes, of the sums for a box that has `cells` cells at each z coordinate,
    /// including its halo.
    pub fn bytes(gaussian: &Weights, cells: usize) -> usize {
        let planes = gaussian.half().len() * 2 * ALONG_Y.len();
        (planes + ALONG_X) * cells * size_of::<f64>()
    }

    /// The value, at `cell`, of the linear function that best fits the density around the cell. The
    /// value is limited to the range from 0 to the maximum density of the fit's cells. Returns
    /// `None` if too little fluid is within the Gaussian's reach.
    pub fn at(&mut self, cell: IVec3) -> Option<u64> {
        self.make_planes_around(cell.z);
        let CellBox { lo, .. } = self.greatest.cells();
        let index = (cell.y - lo.y) as usize * self.width() + (cell.x - lo.x) as usize;
        // `sum`, `first`, `square` and `product` are the sum and the first and second moments of
        // the weights. `total` and `moment` are the sum and the first moments of the densities.
        let (mut sum, mut first) = (0.0, DVec3::ZERO);
        let (mut square, mut product) = (DVec3::ZERO, DVec3::ZERO);
        let (mut total, mut moment) = (0.0, DVec3::ZERO);
        let [weights, times_z, times_square] = &self.weights;
        for (k, plane) in self.planes.iter().enumerate() {
            let [u, ux, uxx, uy, uxy, uyy, f, fx, fy] = plane.each_ref().map(|sums| sums[index]);
            let (weight, z) = (weights[k], times_z[k]);
            sum += weight * u;
            first += DVec3::new(weight * ux, weight * uy, z * u);
            square += DVec3::new(weight * uxx, weight * uyy, times_square[k] * u);
            product += DVec3::new(weight * uxy, z * ux, z * uy);
            total += weight * f;
            moment += DVec3::new(weight * fx, weight * fy, z * f);
        }
        if sum < LEAST_SUM * f64::from(WHOLE) {
            return None;
        }
        let (middle, mean, slope) = (first / sum, total / sum, moment / sum);
        let ([xx, yy, zz], [xy, xz, yz]) = ((square / sum).into(), (product / sum).into());
        let moments = DMat3::from_cols(
            DVec3::new(xx, xy, xz),
            DVec3::new(xy, yy, yz),
            DVec3::new(xz, yz, zz),
        );
        let spread = moments
            - DMat3::from_cols(middle * middle.x, middle * middle.y, middle * middle.z)
            + DMat3::from_diagonal(DVec3::splat(self.stiffness));
        let rise = spread.inverse() * (slope - middle * mean);
        let density = mean - rise.dot(middle);
        Some(density.round().clamp(0.0, f64::from(self.greatest.at(cell))) as u64)
    }

    /// Number of cells of the box along x.
    fn width(&self) -> usize {
        self.greatest.cells().size().x as usize
    }

    fn reach(&self) -> i32 {
        self.weights[0].len() as i32 / 2
    }

    /// Makes `planes` contain exactly the planes whose z coordinates are within reach of `z`.
    fn make_planes_around(&mut self, z: i32) {
        let (first, end) = (z - self.reach(), z + self.reach() + 1);
        while self.next < end {
            let plane = if self.next < first { Plane::default() } else { self.plane(self.next) };
            self.planes.push_back(plane);
            self.next += 1;
        }
        self.planes.drain(..self.planes.len() - self.weights[0].len());
    }

    /// The sums along x and y at the cells with this z coordinate.
    fn plane(&self, z: i32) -> Plane {
        let (CellBox { lo, hi }, width) = (self.greatest.cells(), self.width());
        let reach = self.reach();
        let rows = lo.y - reach..hi.y + reach;
        let mut along_x: [Vec<f64>; ALONG_X] =
            std::array::from_fn(|_| vec![0.0; rows.len() * width]);
        let (mut shares, mut products) = (Vec::new(), Vec::new());
        for (row, y) in rows.enumerate() {
            let first = IVec3::new(lo.x - reach, y, z);
            let [usable, dense] =
                [self.usable, self.dense].map(|of| of.run(first, width + 2 * reach as usize));
            if usable.iter().all(|&share| share == 0) {
                continue;
            }
            shares.clear();
            shares.extend(usable.iter().map(|&share| f64::from(share)));
            products.clear();
            products.extend(shares.iter().zip(dense).map(|(share, &d)| share * f64::from(d)));
            let powers = [(&shares, 0), (&shares, 1), (&shares, 2), (&products, 0), (&products, 1)];
            for (to, (taps, power)) in along_x.iter_mut().zip(powers) {
                let to = &mut to[row * width..][..width];
                add_weighted(to, taps, 1, &self.weights[power]);
            }
        }
        std::array::from_fn(|i| {
            let (of, power) = ALONG_Y[i];
            let mut sums = vec![0.0; (hi.y - lo.y) as usize * width];
            add_weighted(&mut sums, &along_x[of], width, &self.weights[power]);
            sums
        })
    }
}

/// Adds to `to[i]` the taps `taps[i]`, `taps[i + step]` and so on, each times its weight.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn add_weighted(to: &mut [f64], taps: &[f64], step: usize, weights: &[f64]) {
    for (k, &weight) in weights.iter().enumerate() {
        for (to, &tap) in to.iter_mut().zip(&taps[k * step..]) {
            *to += weight * tap;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::places;
    use super::*;

    /// A linear density on a box of cells, with a share for each cell.
    fn sampled(cells: CellBox, share: impl Fn(IVec3) -> u16) -> (Block, Block) {
        let (mut dense, mut usable) = (Block::zero(cells), Block::zero(cells));
        for cell in places(cells) {
            let index = dense.index(cell);
            dense.samples_mut()[index] = (5000 + 300 * cell.x - 200 * cell.y + 100 * cell.z) as u16;
            usable.samples_mut()[index] = share(cell);
        }
        (dense, usable)
    }

    #[test]
    fn a_linear_density_is_continued_into_a_solid_in_every_direction() {
        let gaussian = Weights::of_variance(4.0, 5);
        let part = CellBox { lo: IVec3::new(-3, -2, -4), hi: IVec3::new(4, 3, 5) };
        let around = part.grown(gaussian.reach(), gaussian.reach());
        for normal in [IVec3::X, IVec3::NEG_Y, IVec3::Z, IVec3::new(1, -1, 1)] {
            let is_outside = |cell: IVec3| u16::from(cell.dot(normal) >= 1) * WHOLE;
            let (dense, usable) = sampled(around, is_outside);
            let mut fit = LinearFit::new(&gaussian, &dense, &usable, part);
            for cell in places(part).filter(|cell| cell.dot(normal) > -2) {
                let expected = f64::from(5000 + 300 * cell.x - 200 * cell.y + 100 * cell.z);
                let found = fit.at(cell).unwrap() as f64;
                // The stiffness of the fit makes the continuation slightly too flat.
                assert!((found - expected).abs() < 60.0, "{normal} {cell}: {found}, {expected}");
            }
        }
    }

    #[test]
    fn a_fit_is_independent_of_the_box_and_of_the_cells_that_were_fitted_before() {
        let gaussian = Weights::of_variance(2.5, 4);
        let part = CellBox::cube(IVec3::ZERO, 9);
        let around = |part: CellBox| part.grown(gaussian.reach(), gaussian.reach());
        let share = |cell: IVec3| {
            let mixed = (cell.x * 73 + cell.y * 31 + cell.z * 17).rem_euclid(101);
            if mixed < 60 { 0 } else { (mixed * 324) as u16 }
        };
        let (dense, usable) = sampled(around(part), share);
        let mut fit = LinearFit::new(&gaussian, &dense, &usable, part);
        let all: Vec<_> = places(part).map(|cell| (cell, fit.at(cell))).collect();
        let few = CellBox { lo: IVec3::new(2, 3, 1), hi: IVec3::new(8, 6, 9) };
        let (dense, usable) = (dense.part(around(few)), usable.part(around(few)));
        let mut fit = LinearFit::new(&gaussian, &dense, &usable, few);
        for (cell, expected) in all {
            if few.contains(cell) && cell.z % 3 == 0 {
                assert_eq!(fit.at(cell), expected, "{cell}");
            }
        }
    }
}
