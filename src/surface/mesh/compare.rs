//! Distances between two surfaces.
//!
//! Each surface is sampled, and the exact distance of every sample to the nearest point on any
//! triangle of the other surface is measured. Vertices count only for the maximum; means are over
//! samples that are evenly distributed by area. Samples and sums have a fixed order, so the results
//! do not depend on the number of threads.
//!
//! The sign of a distance comes from the angle-weighted pseudo-normal at the nearest point, which
//! distinguishes inside from outside even if that point is on an edge or a vertex (Baerentzen and
//! Aanaes 2005).

use std::ops::Range;

use glam::DVec3;
use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::partitioning::{Bvh, BvhBuildStrategy, BvhNode};
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::{Triangle, TrianglePointLocation};
use rayon::prelude::*;
use serde::Serialize;
use thiserror::Error;

use super::Mesh;
use super::check::{Stars, is_sound};

/// Number of samples of a surface: ten per triangle, within these bounds.
const SAMPLES: [usize; 2] = [100_000, 2_000_000];

/// Samples per task. Within a task, each search starts from the nearest triangle of the previous
/// sample.
const CHUNK: usize = 1 << 12;

/// Products of four lengths must not overflow.
const GREATEST_COORDINATE: f64 = 1e70;

/// The result of [`compare`]. Lengths are in the meshes' unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The maximum distance from any sample of either surface to the other.
    pub hausdorff: f64,
    /// Mean signed distance of the mesh from the reference, positive if the mesh is outside.
    pub bias: f64,
    /// From samples of the mesh to the reference.
    pub from_mesh: Distances,
    /// From samples of the reference to the mesh.
    pub from_reference: Distances,
}

/// Distances from samples of one surface to the other surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Distances {
    /// The maximum distance, including vertices.
    pub max: f64,
    /// The sample with the maximum distance.
    pub farthest: [f64; 3],
    /// Mean distance by area.
    pub mean: f64,
    /// Root mean square of the distances by area.
    pub rms: f64,
    /// Number of samples that are distributed by area.
    pub samples: usize,
    /// Number of vertices, which are samples only for the maximum.
    pub vertices: usize,
}

/// One of the two compared meshes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The reference.
    Reference,
    /// The mesh that is compared with the reference.
    Mesh,
}

/// An error of comparing meshes.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum CompareError {
    /// No triangle has an area.
    #[error("every triangle of the {} has zero area", .0.name())]
    NoSurface(Side),
    /// A coordinate is not finite, or so large that its powers overflow.
    #[error("vertex {vertex} of the {} is not finite, or farther than 1e70 from the origin", side.name())]
    NotFinite {
        /// The mesh that the vertex belongs to.
        side: Side,
        /// The first such vertex that a triangle uses.
        vertex: u32,
    },
}

impl CompareError {
    /// The mesh with the error.
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

/// Measures the distances between `mesh` and `reference`, in both directions.
///
/// Triangles with a missing or repeated vertex are left out. The reference need not be closed; the
/// bias then refers to the side that its triangles face.
///
/// # Errors
/// If either mesh has no surface, or an invalid vertex: see [`CompareError`].
pub fn compare(reference: &Mesh, mesh: &Mesh) -> Result<Comparison, CompareError> {
    // Positions relative to the first vertex have the most significant digits.
    let origin = reference.positions.first().map_or(DVec3::ZERO, |&p| DVec3::from(p));
    let (reference, mesh) = (
        SearchableSurface::new(reference, origin, Side::Reference)?,
        SearchableSurface::new(mesh, origin, Side::Mesh)?,
    );
    let (from_mesh, bias) = mesh.distances_to(&reference, origin);
    let (from_reference, _) = reference.distances_to(&mesh, origin);
    Ok(Comparison {
        hausdorff: from_mesh.max.max(from_reference.max),
        bias,
        from_mesh,
        from_reference,
    })
}

/// A mesh with indices for sampling and searching.
#[derive(Debug)]
pub struct SearchableSurface {
    /// The origin of the positions.
    origin: DVec3,
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    stars: Stars,
    /// The [pseudo-normal](Self::pseudo_normal) of each vertex: a vertex with thousands of
    /// triangles may be nearest to many samples.
    at_vertices: Vec<DVec3>,
    tree: Bvh,
    /// Cumulative areas of the triangles.
    area_up_to: Vec<f64>,
}

impl SearchableSurface {
    /// Prepares a reference mesh.
    ///
    /// # Errors
    /// The errors of [`compare`] for the reference.
    pub fn reference(mesh: &Mesh) -> Result<Self, CompareError> {
        let origin = mesh.positions.first().map_or(DVec3::ZERO, |&p| DVec3::from(p));
        Self::new(mesh, origin, Side::Reference)
    }

    /// Signed distances of places from this surface, negative inside; NaN for a place that is not
    /// finite or beyond 1e70.
    #[must_use]
    pub fn signed_distances(&self, places: &[[f64; 3]]) -> Vec<f64> {
        let mut near = None;
        let mut distance = |&place: &[f64; 3]| {
            if !place.iter().all(|x| x.abs() <= GREATEST_COORDINATE) {
                return f64::NAN;
            }
            let point = DVec3::from(place) - self.origin;
            let nearest = self.nearest(point, near);
            near = Some(nearest.triangle);
            self.signed(point, &nearest)
        };
        places.iter().map(&mut distance).collect()
    }

    /// The distance of a place from the surface, if it is at most `most`. The result does not
    /// depend on `most`.
    #[must_use]
    pub fn distance_within(&self, place: DVec3, most: f64) -> Option<f64> {
        let bound = most * (1.0 + 1e-9) + f64::MIN_POSITIVE;
        self.nearest_within(place - self.origin, bound * bound)
            .map(|nearest| nearest.squared.sqrt())
            .filter(|&distance| distance <= most)
    }

    /// Whether the bounding box of any triangle meets the box from `lo` to `hi`.
    #[must_use]
    pub fn meets(&self, lo: DVec3, hi: DVec3) -> bool {
        let around = Aabb::new(lo - self.origin, hi - self.origin);
        self.tree.intersect_aabb(&around).next().is_some()
    }

    /// The crossings of a line along x, at given y and z, with triangles beyond x = `from`, in no
    /// particular order: the position, and 1 or -1 if the triangle faces along x or against it.
    ///
    /// Whether the line crosses a triangle is decided edge by edge, and equally for both triangles
    /// of an edge. For a closed surface, the signs beyond a place therefore sum to the winding
    /// number of the surface around it, wherever the line is.
    #[must_use]
    pub fn crossings(&self, [y, z]: [f64; 2], from: f64) -> Vec<(f64, i32)> {
        let at = DVec3::new(from, y, z) - self.origin;
        let line = Aabb::new(at, DVec3::new(f64::MAX, at.y, at.z));
        let passed = self.tree.intersect_aabb(&line);
        let crossing = |triangle: u32| crossing(self.corners(triangle as usize), [at.y, at.z]);
        passed.filter_map(crossing).map(|(x, sign)| (x + self.origin.x, sign)).collect()
    }

    fn new(mesh: &Mesh, origin: DVec3, side: Side) -> Result<Self, CompareError> {
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
        let area_up_to: Vec<f64> = triangles
            .iter()
            .scan(0.0, |total, triangle| {
                *total += scaled_normal(corners(triangle)).length() / 2.0;
                Some(*total)
            })
            .collect();
        if area_up_to.last().is_none_or(|&area| area == 0.0) {
            return Err(CompareError::NoSurface(side));
        }
        let boxes = triangles.iter().map(|triangle| {
            let [a, b, c] = corners(triangle);
            Aabb::new(a.min(b).min(c), a.max(b).max(c))
        });
        let tree = Bvh::from_iter(BvhBuildStrategy::Binned, boxes.enumerate());
        let stars = Stars::new(mesh.positions.len(), &mesh.triangles);
        let weighted =
            |[v, p, q]: [DVec3; 3]| (p - v).angle_between(q - v) * unit_normal([v, p, q]);
        let vertices = (0..positions.len() as u32).into_par_iter();
        let at_vertices =
            vertices.map(|vertex| around(&stars, &positions, vertex).map(weighted).sum());
        let at_vertices = at_vertices.collect();
        Ok(Self { origin, positions, triangles, stars, at_vertices, tree, area_up_to })
    }

    fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|vertex| self.positions[vertex as usize])
    }

    /// Distances of this surface's samples from `other`, and their signed mean.
    fn distances_to(&self, other: &Self, origin: DVec3) -> (Distances, f64) {
        let samples = (10 * self.triangles.len()).clamp(SAMPLES[0], SAMPLES[1]);
        let area = in_chunks(samples, |range| other.summary(self.spread(range, samples)));
        let vertices = in_chunks(self.positions.len(), |range| {
            let used = range.filter(|&vertex| !self.stars.of(vertex).is_empty());
            other.summary(used.map(|vertex| self.positions[vertex]))
        });
        let farthest = if vertices.max > area.max { vertices.farthest } else { area.farthest };
        let count = samples as f64;
        let distances = Distances {
            max: area.max.max(vertices.max),
            farthest: (farthest + origin).to_array(),
            mean: area.sum / count,
            rms: (area.sum_of_squares / count).sqrt(),
            samples,
            vertices: vertices.count,
        };
        (distances, area.signed_sum / count)
    }

    /// Samples number `range` of `samples`, each in the middle of an equal share of the area.
    fn spread(&self, range: Range<usize>, samples: usize) -> impl Iterator<Item = DVec3> {
        let total = self.area_up_to[self.triangles.len() - 1];
        let mut triangle = 0;
        range.map(move |number| {
            let target = (number as f64 + 0.5) / samples as f64 * total;
            if self.area_up_to[triangle] <= target {
                triangle += self.area_up_to[triangle..].partition_point(|&area| area <= target);
            }
            let [a, b, c] = self.corners(triangle);
            let [u, v] = spot(number);
            a + (b - a) * u + (c - a) * v
        })
    }

    /// Summarizes the distances from `points` to this surface.
    fn summary(&self, points: impl Iterator<Item = DVec3>) -> DistanceSums {
        let mut summary = DistanceSums::default();
        let mut near = None;
        for point in points {
            let nearest = self.nearest(point, near);
            near = Some(nearest.triangle);
            summary.note(point, nearest.squared.sqrt(), self.signed(point, &nearest));
        }
        summary
    }

    /// The signed distance of a point from its nearest point, negative inside.
    fn signed(&self, point: DVec3, nearest: &SurfacePoint) -> f64 {
        let distance = nearest.squared.sqrt();
        let side = (point - nearest.at).dot(self.pseudo_normal(nearest));
        if side < 0.0 { -distance } else { distance }
    }

    /// The nearest point of the surface. The search is faster with a triangle `near` it.
    fn nearest(&self, point: DVec3, near: Option<usize>) -> SurfacePoint {
        let known = near.map(|triangle| self.nearest_on(triangle, point));
        let bound = known.as_ref().map_or(f64::INFINITY, |known| known.squared);
        self.nearest_within(point, bound)
            .or(known)
            .expect("there are triangles, and finite points are at a finite distance from each")
    }

    /// The nearest point of the surface, if its squared distance is less than `bound`.
    fn nearest_within(&self, point: DVec3, bound: f64) -> Option<SurfacePoint> {
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

    fn nearest_on(&self, triangle: usize, point: DVec3) -> SurfacePoint {
        let [a, b, c] = self.corners(triangle);
        let (projection, location) =
            Triangle::new(a, b, c).project_local_point_and_get_location(point, false);
        let at = projection.point;
        SurfacePoint { triangle, squared: point.distance_squared(at), at, location }
    }

    /// A vector that points outwards at the nearest point: the triangle's normal; on an edge, the
    /// sum of both unit normals; on a vertex, the sum of all, weighted by the triangles' angles.
    fn pseudo_normal(&self, nearest: &SurfacePoint) -> DVec3 {
        let [a, b, c] = self.triangles[nearest.triangle];
        match nearest.location {
            TrianglePointLocation::OnVertex(corner) => {
                self.at_vertices[[a, b, c][corner as usize] as usize]
            }
            TrianglePointLocation::OnEdge(side, _) => {
                let ends = [[a, b], [b, c], [a, c]][side as usize];
                let triangles_at = |vertex: u32| self.stars.of(vertex as usize).len();
                let [from, to] = if triangles_at(ends[1]) < triangles_at(ends[0]) {
                    [ends[1], ends[0]]
                } else {
                    ends
                };
                let around = around(&self.stars, &self.positions, from);
                let star = self.stars.of(from as usize).iter().zip(around);
                star.filter(|(across, _)| across.contains(&to))
                    .map(|(_, corners)| unit_normal(corners))
                    .sum()
            }
            TrianglePointLocation::OnFace(..) | TrianglePointLocation::OnSolid => {
                scaled_normal(self.corners(nearest.triangle))
            }
        }
    }
}

/// The corners of the triangles at `vertex`, starting with `vertex`.
fn around<'a>(
    stars: &'a Stars,
    positions: &'a [DVec3],
    vertex: u32,
) -> impl Iterator<Item = [DVec3; 3]> + 'a {
    let star = stars.of(vertex as usize).iter();
    star.map(move |&[p, q]| [vertex, p, q].map(|vertex| positions[vertex as usize]))
}

/// The crossing of a line along x, at given y and z, with a triangle, and whether the triangle
/// faces along it.
fn crossing(corners: [DVec3; 3], [y, z]: [f64; 2]) -> Option<(f64, i32)> {
    let [a, b, c] = corners;
    // Of three edges, none or two cross from below z to z or above.
    let mut across = [(a, b), (b, c), (c, a)].into_iter().filter_map(|(from, to)| {
        let rises = from.z <= z;
        if rises == (to.z <= z) {
            return None;
        }
        // The position on an edge is equal for both of its triangles.
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

/// The normal, as long as twice the triangle's area.
fn scaled_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

fn unit_normal(corners: [DVec3; 3]) -> DVec3 {
    scaled_normal(corners).normalize_or_zero()
}

/// The position of a sample in its triangle: the first two barycentric coordinates, from the
/// sequence R2 (Roberts 2018), which covers a square evenly, folded onto the triangle.
fn spot(number: usize) -> [f64; 2] {
    // The inverse of the plastic number, and its square.
    let [u, v] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3]
        .map(|step| (0.5 + number as f64 * step).fract());
    if u + v > 1.0 { [1.0 - u, 1.0 - v] } else { [u, v] }
}

/// The nearest point of a surface to some point.
struct SurfacePoint {
    triangle: usize,
    squared: f64,
    at: DVec3,
    location: TrianglePointLocation,
}

/// Sums of distances.
#[derive(Default)]
struct DistanceSums {
    count: usize,
    max: f64,
    farthest: DVec3,
    sum: f64,
    sum_of_squares: f64,
    signed_sum: f64,
}

impl DistanceSums {
    fn note(&mut self, point: DVec3, distance: f64, signed: f64) {
        if distance > self.max || self.count == 0 {
            (self.max, self.farthest) = (distance, point);
        }
        self.count += 1;
        self.sum += distance;
        self.sum_of_squares += distance * distance;
        self.signed_sum += signed;
    }

    fn append(self, later: Self) -> Self {
        let farther = if later.max > self.max || self.count == 0 { &later } else { &self };
        Self {
            max: farther.max,
            farthest: farther.farthest,
            count: self.count + later.count,
            sum: self.sum + later.sum,
            sum_of_squares: self.sum_of_squares + later.sum_of_squares,
            signed_sum: self.signed_sum + later.signed_sum,
        }
    }
}

/// Summarizes chunks of fixed length on all threads, and joins them in order.
fn in_chunks(count: usize, summary: impl Fn(Range<usize>) -> DistanceSums + Sync) -> DistanceSums {
    let chunks: Vec<DistanceSums> = (0..count.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| summary(chunk * CHUNK..((chunk + 1) * CHUNK).min(count)))
        .collect();
    chunks.into_iter().fold(DistanceSums::default(), DistanceSums::append)
}
