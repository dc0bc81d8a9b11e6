//! The triangles of a mesh in a tree of boxes, for finding nearest points and crossings.

use glam::DVec3;
use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::partitioning::{Bvh, BvhBuildStrategy, BvhNode};
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::{Triangle, TrianglePointLocation};
use thiserror::Error;

use super::Mesh;
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
    #[error("the {} has no triangle with a nonzero area", .0.name())]
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

/// A mesh whose triangles can be searched.
#[derive(Debug)]
pub struct TriangleTree {
    /// The origin to which the positions are relative.
    origin: DVec3,
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    tree: Bvh,
}

impl TriangleTree {
    /// Prepares a mesh, with positions relative to `origin`. Triangles with a missing or repeated
    /// vertex are left out.
    ///
    /// # Errors
    /// If the mesh has no surface, or an invalid vertex: see [`CompareError`].
    pub fn new(mesh: &Mesh, origin: DVec3, side: Side) -> Result<Self, CompareError> {
        let sound = mesh.triangles.iter().copied().filter(|&t| is_sound(t, mesh.positions.len()));
        let triangles: Vec<[u32; 3]> = sound.collect();
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
        let boxes = triangles.iter().map(|triangle| {
            let [a, b, c] = corners(triangle);
            Aabb::new(a.min(b).min(c), a.max(b).max(c))
        });
        let tree = Bvh::from_iter(BvhBuildStrategy::Binned, boxes.enumerate());
        Ok(Self { origin, positions, triangles, tree })
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
    /// most `most`. The search is faster if `near` is a triangle close to the place. The distance
    /// depends neither on `most` nor on `near`.
    #[must_use]
    pub fn distance_within(
        &self,
        place: DVec3,
        most: f64,
        near: Option<usize>,
    ) -> Option<(f64, usize)> {
        let point = place - self.origin;
        let bound = (most * (1.0 + 1e-9) + f64::MIN_POSITIVE).powi(2);
        let known = near.map(|triangle| self.nearest_on(triangle, point));
        let known = known.filter(|known| known.squared < bound);
        let bound = known.as_ref().map_or(bound, |known| known.squared);
        let nearest = self.nearest_within(point, bound).or(known)?;
        let distance = nearest.squared.sqrt();
        (distance <= most).then_some((distance, nearest.triangle))
    }

    /// Whether the bounding box of any triangle meets the box from `lo` to `hi`.
    #[must_use]
    pub fn meets(&self, lo: DVec3, hi: DVec3) -> bool {
        let around = Aabb::new(lo - self.origin, hi - self.origin);
        self.tree.intersect_aabb(&around).next().is_some()
    }

    /// The crossings of a line along x, at the given y and z, with all triangles that reach beyond
    /// x = `from`, in no particular order. A crossing has an x coordinate, and 1 or -1 if the
    /// triangle faces along x or against it.
    ///
    /// The edges of a triangle decide whether the line crosses it, and an edge gives the same
    /// decision for both of its triangles. For a closed surface, the sum of the signs beyond a
    /// place is therefore the winding number of the surface around this place, for every line.
    #[must_use]
    pub fn crossings(&self, [y, z]: [f64; 2], from: f64) -> Vec<(f64, i32)> {
        let at = DVec3::new(from, y, z) - self.origin;
        let line = Aabb::new(at, DVec3::new(f64::MAX, at.y, at.z));
        let passed = self.tree.intersect_aabb(&line);
        let crossing = |triangle: u32| crossing(self.corners(triangle as usize), [at.y, at.z]);
        passed.filter_map(crossing).map(|(x, sign)| (x + self.origin.x, sign)).collect()
    }

    /// The nearest point of the surface, if its squared distance is less than `bound`.
    pub(super) fn nearest_within(&self, point: DVec3, bound: f64) -> Option<SurfacePoint> {
        let box_cost = |node: &BvhNode, _| {
            let outside = (node.mins() - point).max(point - node.maxs()).max(DVec3::ZERO);
            outside.length_squared()
        };
        let triangle_cost = |triangle: u32, _| {
            let nearest = self.nearest_on(triangle as usize, point);
            Some((nearest.squared, nearest))
        };
        let found = self.tree.find_best(bound, box_cost, triangle_cost);
        found.map(|(_, (_, nearest))| nearest)
    }

    pub(super) fn nearest_on(&self, triangle: usize, point: DVec3) -> SurfacePoint {
        let [a, b, c] = self.corners(triangle);
        let (projection, location) =
            Triangle::new(a, b, c).project_local_point_and_get_location(point, false);
        let at = projection.point;
        SurfacePoint { triangle, squared: point.distance_squared(at), at, location }
    }
}

/// The crossing of a line along x, at the given y and z, with a triangle: the x coordinate, and 1
/// or -1 if the triangle faces along x or against it.
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
    pub(super) location: TrianglePointLocation,
}
