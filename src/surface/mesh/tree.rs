//! The triangles of a mesh, which can be searched for nearest points and crossings.

use glam::DVec3;
use thiserror::Error;

use super::Mesh;
use super::box_tree::{BoxTree, Place, Vicinity, nearest_place, squared_distance};
use super::check::is_sound;

/// Maximum absolute coordinate of a vertex, so that products of four lengths do not overflow.
pub(super) const GREATEST_COORDINATE: f64 = 1e70;

/// One of the two compared meshes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The reference.
    Reference,
    /// The mesh that is compared with the reference.
    Mesh,
}

/// An error in comparing meshes.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum CompareError {
    /// No triangle has an area.
    #[error("the {} has no triangles, or all of them have zero area", .0.name())]
    NoSurface(Side),
    /// A coordinate is not finite, or so large that its powers overflow.
    #[error(
        "vertex {vertex} of the {} has a coordinate that is not finite or exceeds 1e70",
        side.name()
    )]
    NotFinite {
        /// The mesh to which the vertex belongs.
        side: Side,
        /// The first invalid vertex that a triangle uses.
        vertex: u32,
    },
}

impl CompareError {
    /// The mesh that caused the error.
    pub fn side(&self) -> Side {
        match *self {
            Self::NoSurface(side) | Self::NotFinite { side, .. } => side,
        }
    }
}

impl Side {
    fn name(self) -> &'static str {
        match self {
            Self::Reference => "reference",
            Self::Mesh => "mesh",
        }
    }
}

/// A position on the mesh, as an origin for [`TriangleTree::new`]: positions relative to it keep
/// as many digits as possible.
pub fn origin_on(mesh: &Mesh) -> DVec3 {
    let sound = mesh.triangles.iter().find(|&&triangle| is_sound(triangle, mesh.positions.len()));
    sound.map_or(DVec3::ZERO, |&[vertex, ..]| DVec3::from(mesh.positions[vertex as usize]))
}

/// A mesh whose triangles can be searched.
#[derive(Debug)]
pub struct TriangleTree {
    /// The origin to which the positions are relative.
    origin: DVec3,
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// The corners of the box around the triangles.
    bounds: [DVec3; 2],
    tree: BoxTree,
}

impl TriangleTree {
    /// Prepares a mesh, with positions relative to `origin`. Triangles with a missing vertex, or
    /// with two corners at the same position, are left out.
    ///
    /// # Errors
    /// If the mesh has no surface, or an invalid vertex: see [`CompareError`].
    pub fn new(mesh: &Mesh, origin: DVec3, side: Side) -> Result<Self, CompareError> {
        let is_kept = |&&triangle: &&[u32; 3]| {
            is_sound(triangle, mesh.positions.len()) && {
                let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize]);
                a != b && b != c && c != a
            }
        };
        let triangles: Vec<[u32; 3]> = mesh.triangles.iter().filter(is_kept).copied().collect();
        let far = |&&vertex: &&u32| {
            let position = mesh.positions[vertex as usize];
            !position.iter().all(|x| x.abs() <= GREATEST_COORDINATE)
        };
        if let Some(&vertex) = triangles.iter().flatten().find(far) {
            return Err(CompareError::NotFinite { side, vertex });
        }
        let positions: Vec<DVec3> =
            mesh.positions.iter().map(|&p| DVec3::from(p) - origin).collect();
        let corners = |t: &[u32; 3]| t.map(|vertex| positions[vertex as usize]);
        if triangles.iter().all(|triangle| scaled_normal(corners(triangle)).length() == 0.0) {
            return Err(CompareError::NoSurface(side));
        }
        let tree = BoxTree::new(triangles.len(), |number| corners(&triangles[number]));
        let bounds = tree.bounds();
        Ok(Self { origin, positions, triangles, bounds, tree })
    }

    /// The origin to which the positions are relative.
    pub(super) fn origin(&self) -> DVec3 {
        self.origin
    }

    /// The positions of the mesh's vertices, relative to the origin.
    pub(super) fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    pub(in crate::surface) fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    pub(in crate::surface) fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|vertex| self.positions[vertex as usize])
    }

    /// The distance of a place from the surface, and the nearest triangle, if the distance is at
    /// most `most`.
    #[must_use]
    pub fn distance_within(&self, place: DVec3, most: f64) -> Option<(f64, usize)> {
        let point = place - self.origin;
        distance_within(most, self.tree.nearest(point, squared_bound(most)))
    }

    /// The triangles within the distance `most` of the box from `lo` to `hi`.
    #[must_use]
    pub fn vicinity(&self, lo: DVec3, hi: DVec3, most: f64) -> NearTriangles<'_> {
        let most = most * (1.0 + 1e-9);
        let tree = self.tree.vicinity(lo - self.origin, hi - self.origin, most);
        NearTriangles { all: self, tree }
    }

    /// Whether the box from `lo` to `hi` meets the bounding box of a group of triangles. Each group
    /// has up to 8 neighbouring triangles. If the result is false, the box meets no triangle.
    #[must_use]
    pub fn meets(&self, lo: DVec3, hi: DVec3) -> bool {
        self.tree.meets(lo - self.origin, hi - self.origin)
    }

    /// The winding number of the surface around a place, if the surface is closed.
    ///
    /// The winding number is a sum over the triangles that a line from the place crosses. Each
    /// triangle adds 1 if it faces along the line, otherwise -1. The edges of a triangle decide
    /// whether the line crosses the triangle. An edge gives the same decision for both of its
    /// triangles, so the sum is the same for every line. The line runs along the axis in which the
    /// mesh is shortest, towards the nearer end of the mesh.
    #[must_use]
    pub fn winding_number(&self, place: DVec3) -> i32 {
        let [lo, hi] = self.bounds;
        let axis = (hi / 2.0 - lo / 2.0).min_position();
        // `turned` makes the axis x. A cyclic permutation keeps the sign of a crossing.
        let turned = |at: DVec3| DVec3::from([0, 1, 2].map(|other| at[(axis + other) % 3]));
        let from = place - self.origin;
        let is_forward = hi[axis] - from[axis] < from[axis] - lo[axis];
        let (mut start, mut end) = (from, from);
        if is_forward {
            end[axis] = f64::MAX
        } else {
            start[axis] = f64::MIN
        }
        let from = turned(from);
        let mut sum = 0;
        self.tree.visit(start, end, |triangle| {
            let corners = self.corners(triangle).map(turned);
            let crossing = crossing(corners, [from.y, from.z]);
            let beyond =
                crossing.filter(|&(x, _)| if is_forward { x > from.x } else { x <= from.x });
            sum += beyond.map_or(0, |(_, sign)| sign);
        });
        if is_forward { sum } else { -sum }
    }

    /// The nearest point of the surface. The search is faster if `near` is a triangle close to the
    /// point.
    pub(super) fn nearest(&self, point: DVec3, near: Option<usize>) -> SurfacePoint {
        let squared = near.map_or(f64::INFINITY, |near| self.squared_distance(near, point));
        let nearest = self.tree.nearest(point, squared).map(|(_, triangle)| triangle).or(near);
        let triangle = nearest
            .expect("there are triangles, and finite points are at a finite distance from each");
        let (squared, at, place) = nearest_place(point, self.corners(triangle));
        SurfacePoint { triangle, squared, at, place }
    }

    /// The squared distance of a point from a triangle.
    fn squared_distance(&self, triangle: usize, point: DVec3) -> f64 {
        squared_distance(point.to_array(), self.corners(triangle).map(|corner| corner.to_array()))
    }
}

/// The triangles near a box.
#[derive(Debug)]
pub struct NearTriangles<'a> {
    all: &'a TriangleTree,
    tree: Vicinity<'a>,
}

impl NearTriangles<'_> {
    /// The distance of a place from these triangles, and the nearest triangle, if the distance is
    /// at most `most`. The search is faster if `near` is a triangle close to the place. Except for
    /// rounding, the distance depends neither on `most` nor on `near`.
    #[must_use]
    pub fn distance_within(&self, place: DVec3, most: f64, near: usize) -> Option<(f64, usize)> {
        let point = place - self.all.origin;
        let squared = self.all.squared_distance(near, point);
        let bound = squared_bound(most);
        let nearest = self.tree.nearest(point, bound.min(squared));
        distance_within(most, nearest.or((squared < bound).then_some((squared, near))))
    }
}

/// An upper bound on the squares of distances up to `most`.
fn squared_bound(most: f64) -> f64 {
    (most * (1.0 + 1e-9)).powi(2) + f64::MIN_POSITIVE
}

/// The distance and the triangle that a search found, if the distance is at most `most`.
fn distance_within(most: f64, nearest: Option<(f64, usize)>) -> Option<(f64, usize)> {
    let (squared, triangle) = nearest?;
    let distance = squared.sqrt();
    (distance <= most).then_some((distance, triangle))
}

/// The point at which a line along x, at the given y and z, crosses a triangle: the point's x
/// coordinate, and 1 if the triangle faces along x, or -1 if it faces against x. `None` if the line
/// does not cross the triangle.
fn crossing(corners: [DVec3; 3], [y, z]: [f64; 2]) -> Option<(f64, i32)> {
    let [a, b, c] = corners;
    // Either none or two of the three edges join a point at or below z to a point above z.
    let mut across = [(a, b), (b, c), (c, a)].into_iter().filter_map(|(from, to)| {
        let rises = from.z <= z;
        if rises == (to.z <= z) {
            return None;
        }
        // The computed position on an edge is the same for both of its triangles.
        let (low, high) = if rises { (from, to) } else { (to, from) };
        let share = (z - low.z) / (high.z - low.z);
        let at = low + (high - low) * share;
        // Rounding must not move this position beyond the ends of the edge, because the search
        // would then miss a triangle.
        let at = at.clamp(low.min(high), low.max(high));
        Some((at.y, at.x, if rises { 1 } else { -1 }))
    });
    let (one, other) = (across.next()?, across.next()?);
    let (left, right) = if one.0 > y { (other, one) } else { (one, other) };
    if left.0 > y || right.0 <= y {
        return None;
    }
    let share = (y - left.0) / (right.0 - left.0);
    Some((left.1 + (right.1 - left.1) * share, right.2))
}

/// The normal, with a length of twice the triangle's area.
pub(super) fn scaled_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// The point of a surface that is nearest to a given point.
pub(super) struct SurfacePoint {
    pub(super) triangle: usize,
    pub(super) squared: f64,
    pub(super) at: DVec3,
    pub(super) place: Place,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crossing_is_within_the_box_of_its_triangle() {
        // The distance of the second corner from the line is less than the rounding errors of
        // positions on the edges.
        let triangle =
            [DVec3::new(0.0, 1.0, -1.0), DVec3::new(0.0, 1e-17, 1e-17), DVec3::new(0.0, 2.0, 1.0)];
        assert_eq!(crossing(triangle, [0.0, 0.0]), None);
        assert!(crossing(triangle, [1.0, 0.5]).is_some());
    }

    #[test]
    fn the_origin_is_a_corner_of_a_triangle() {
        let positions = vec![[f64::NAN; 3], [1.0; 3], [2.0; 3], [1.0, 2.0, 3.0]];
        let mesh = Mesh { positions, triangles: vec![[0, 0, 9], [1, 2, 3]], ..Mesh::default() };
        assert_eq!(origin_on(&mesh), DVec3::ONE);
        assert_eq!(origin_on(&Mesh::default()), DVec3::ZERO);
    }

    #[test]
    fn the_winding_number_is_correct_if_lines_pass_close_to_vertices() {
        // An octahedron whose vertices are on the axes, except for rounding errors.
        let noise = 1e-17;
        let positions = vec![
            [1.0, noise, -noise],
            [-1.0, noise, noise],
            [-noise, 1.0, noise],
            [noise, -1.0, noise],
            [noise, noise, 1.0],
            [-noise, noise, -1.0],
        ];
        let sides = [[0, 2], [2, 1], [1, 3], [3, 0]];
        let triangles = sides.iter().flat_map(|&[a, b]| [[a, b, 4], [b, a, 5]]).collect();
        let mesh = Mesh { positions, triangles, ..Mesh::default() };
        let tree = TriangleTree::new(&mesh, DVec3::ZERO, Side::Mesh).unwrap();
        for x in [-0.5, -0.25, 0.0, 0.25, 0.5] {
            for place in [DVec3::X * x, DVec3::Y * x, DVec3::Z * x] {
                assert_eq!(tree.winding_number(place), 1, "{place}");
            }
        }
        assert_eq!(tree.winding_number(DVec3::splat(0.5)), 0);
    }
}
