//! Measures the heights of surfaces at the points of a horizontal grid.

use glam::{DMat3, DVec2, DVec3, IVec2};
use meniscus::internals::surface::mesh::Mesh;
use rayon::prelude::*;

/// The points of a horizontal grid.
#[derive(Debug, Clone, Copy)]
pub struct Columns {
    lo: DVec2,
    step: f64,
    pub size: [usize; 2],
}

/// The highest point of a surface above a grid point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Top {
    pub height: f64,
    /// The surface's angle to the horizontal, in radians.
    pub slope: f64,
}

impl Columns {
    /// A grid with half a spacing between points, over a range of x and z.
    pub fn over(lo: DVec2, hi: DVec2) -> Self {
        let step = 0.5;
        let size = ((hi - lo) / step).round().max(DVec2::ONE);
        Self { lo: lo + step / 2.0, step, size: [size.x as usize, size.y as usize] }
    }

    pub fn count(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// The coordinates x and z of a point.
    pub fn point(&self, number: usize) -> DVec2 {
        self.lo
            + self.step * DVec2::new((number % self.size[0]) as f64, (number / self.size[0]) as f64)
    }

    /// The slope between the heights of two neighbouring points.
    pub fn per_step(&self, from: f64, to: f64) -> f64 {
        (to - from) / self.step
    }

    /// The number of the point nearest to a position, or `None` outside the grid.
    #[cfg(test)]
    pub fn nearest(&self, at: DVec2) -> Option<usize> {
        let place = ((at - self.lo) / self.step).round();
        let within = place.cmpge(DVec2::ZERO).all() && (place.x as usize) < self.size[0];
        (within && (place.y as usize) < self.size[1])
            .then(|| place.x as usize + place.y as usize * self.size[0])
    }

    /// Calls a function for every grid point and every triangle above or below it, with the number
    /// of the point, the triangle's height there, and the triangle's normal.
    pub fn cross(&self, mesh: &Mesh, mut call: impl FnMut(usize, f64, DVec3)) {
        for triangle in &mesh.triangles {
            let corners = triangle.map(|vertex| DVec3::from(mesh.positions[vertex as usize]));
            let [a, b, c] = corners;
            let normal = (b - a).cross(c - a);
            if normal.y == 0.0 {
                continue;
            }
            let [u, v, w] = corners.map(|p| (DVec2::new(p.x, p.z) - self.lo) / self.step);
            let last = DVec2::new(self.size[0] as f64, self.size[1] as f64) - 1.0;
            let first = u.min(v).min(w).ceil().max(DVec2::ZERO);
            let last = u.max(v).max(w).floor().min(last);
            let doubled_area = (v - u).perp_dot(w - u);
            for z in first.y as usize..(last.y + 1.0).max(0.0) as usize {
                for x in first.x as usize..(last.x + 1.0).max(0.0) as usize {
                    let p = DVec2::new(x as f64, z as f64);
                    let of_a = (v - p).perp_dot(w - p) / doubled_area;
                    let of_b = (w - p).perp_dot(u - p) / doubled_area;
                    let of_c = 1.0 - of_a - of_b;
                    if of_a >= 0.0 && of_b >= 0.0 && of_c >= 0.0 {
                        call(x + z * self.size[0], of_a * a.y + of_b * b.y + of_c * c.y, normal);
                    }
                }
            }
        }
    }

    /// The highest point of a surface at each grid point, among triangles that face upwards.
    pub fn tops(&self, mesh: &Mesh) -> Vec<Option<Top>> {
        let mut tops = vec![None; self.count()];
        self.cross(mesh, |point, height, normal| {
            let top: &mut Option<Top> = &mut tops[point];
            if normal.y > 0.0 && top.is_none_or(|top| top.height < height) {
                *top = Some(Top { height, slope: (normal.y / normal.length()).min(1.0).acos() });
            }
        });
        tops
    }

    /// Subtracts from each height its Gaussian mean, computed where heights exist. A plane becomes
    /// zero, even at the edges.
    pub fn without_gaussian(&self, heights: &[Option<f64>], sigma: f64) -> Vec<Option<f64>> {
        let reach = (3.0 * sigma / self.step).ceil() as i32;
        let offs: Vec<(IVec2, f64)> = (-reach..=reach)
            .flat_map(|z| (-reach..=reach).map(move |x| IVec2::new(x, z)))
            .map(|off| (off, (-0.5 * (off.as_dvec2() * self.step / sigma).length_squared()).exp()))
            .collect();
        let [width, depth] = self.size.map(|size| size as i32);
        let left = |n: usize| {
            let height = heights[n]?;
            let place = IVec2::new(n as i32 % width, n as i32 / width);
            // Fit a plane by weighted least squares.
            let (mut squares, mut sums) = (DMat3::ZERO, DVec3::ZERO);
            for &(off, weight) in &offs {
                let at = place + off;
                if at.cmplt(IVec2::ZERO).any() || at.x >= width || at.y >= depth {
                    continue;
                }
                if let Some(other) = heights[(at.x + at.y * width) as usize] {
                    let terms = DVec3::new(1.0, off.x.into(), off.y.into());
                    squares += DMat3::from_cols(terms, terms * terms.y, terms * terms.z) * weight;
                    sums += terms * (weight * (other - height));
                }
            }
            (squares.determinant() > 1e-6).then(|| -(squares.inverse() * sums).x)
        };
        (0..heights.len()).into_par_iter().map(left).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::meshes::sphere;

    #[test]
    fn tops_of_a_ball_have_its_heights_and_slopes() {
        let columns = Columns::over(DVec2::splat(-2.0), DVec2::splat(2.0));
        let tops = columns.tops(&sphere(1.5, 5));
        for (n, top) in tops.iter().enumerate() {
            let from_axis = columns.point(n).length();
            assert_eq!(top.is_some(), from_axis < 1.5, "{from_axis}");
            let Some(top) = top else { continue };
            let slope = (from_axis / 1.5).asin();
            assert!(
                (top.height - 1.5 * slope.cos()).abs() < 0.02 && (top.slope - slope).abs() < 0.05
            );
        }
    }

    #[test]
    fn subtracting_the_gaussian_removes_planes_and_keeps_short_waves() {
        let columns = Columns::over(DVec2::ZERO, DVec2::splat(40.0));
        let middle = columns.nearest(DVec2::splat(20.25)).unwrap();
        let left = |height: &dyn Fn(DVec2) -> f64| {
            let heights: Vec<_> =
                (0..columns.count()).map(|n| Some(height(columns.point(n)))).collect();
            columns.without_gaussian(&heights, 3.0)[middle].unwrap()
        };
        assert!(left(&|at| 0.2 * at.x + 7.0).abs() < 1e-9);
        let wave = |at: DVec2| (std::f64::consts::PI * at.x).cos();
        assert!((left(&wave) - wave(columns.point(middle))).abs() < 1e-3);
    }
}
