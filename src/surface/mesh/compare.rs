//! Distances between two surfaces.
//!
//! Each surface is sampled, and the exact distance from every sample to the nearest point on any
//! triangle of the other surface is measured. Vertices count only for the maximum; means are over
//! samples that are evenly distributed by area. Samples and sums have a fixed order, so the results
//! do not depend on the number of threads.
//!
//! The sign of a distance comes from the angle-weighted pseudo-normal at the nearest point, which
//! distinguishes inside from outside even if that point is on an edge or a vertex (Baerentzen and
//! Aanaes 2005).

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

pub use super::tree::{CompareError, Side};

use super::Mesh;
use super::box_tree::Place;
use super::check::Stars;
use super::tree::{GREATEST_COORDINATE, SurfacePoint, TriangleTree, origin_on, scaled_normal};

/// Minimum and maximum number of samples of a surface. Within these bounds, there are ten samples
/// per triangle.
const SAMPLES: [usize; 2] = [100_000, 2_000_000];

/// Samples per task. Within a task, each search starts from the nearest triangle of the previous
/// sample.
const CHUNK: usize = 1 << 12;

/// The result of [`compare`]. Lengths are in the meshes' unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The maximum distance from any sample of either surface to the other surface.
    pub hausdorff: f64,
    /// Mean signed distance of the mesh from the reference, positive if the mesh is outside the
    /// reference.
    pub bias: f64,
    /// Distances from samples of the mesh to the reference.
    pub from_mesh: Distances,
    /// Distances from samples of the reference to the mesh.
    pub from_reference: Distances,
}

/// Distances from samples of one surface to the other surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Distances {
    /// The maximum distance, including vertices.
    pub max: f64,
    /// The sample with the maximum distance.
    pub farthest: [f64; 3],
    /// Mean distance, weighted by area.
    pub mean: f64,
    /// Root mean square of the distances, weighted by area.
    pub rms: f64,
    /// Number of samples that are distributed by area.
    pub samples: usize,
    /// Number of vertices, which are samples only for the maximum.
    pub vertices: usize,
}

/// Measures the distances between `mesh` and `reference`, in both directions.
///
/// Triangles with a missing or repeated vertex are left out. The reference may be open; the bias is
/// then positive if the mesh is on the side that the reference's triangles face.
///
/// # Errors
/// If either mesh has no surface, or an invalid vertex: see [`CompareError`].
pub fn compare(reference: &Mesh, mesh: &Mesh) -> Result<Comparison, CompareError> {
    let origin = origin_on(reference);
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
    tree: TriangleTree,
    stars: Stars,
    /// The [pseudo-normal](Self::pseudo_normal) of each vertex. Pseudo-normals are computed once,
    /// because a vertex with thousands of triangles may be nearest to many samples.
    at_vertices: Vec<DVec3>,
    /// Cumulative areas of the triangles.
    area_up_to: Vec<f64>,
}

impl SearchableSurface {
    /// Prepares a reference mesh.
    ///
    /// # Errors
    /// If the mesh has no surface, or an invalid vertex: see [`CompareError`].
    pub fn reference(mesh: &Mesh) -> Result<Self, CompareError> {
        Self::new(mesh, origin_on(mesh), Side::Reference)
    }

    /// Signed distances of places from this surface, negative inside. The distance is NaN if a
    /// coordinate is not finite, or if its magnitude exceeds 1e70.
    #[must_use]
    pub fn signed_distances(&self, places: &[[f64; 3]]) -> Vec<f64> {
        let mut near = None;
        let mut distance = |&place: &[f64; 3]| {
            if !place.iter().all(|x| x.abs() <= GREATEST_COORDINATE) {
                return f64::NAN;
            }
            let point = DVec3::from(place) - self.tree.origin();
            let nearest = self.tree.nearest(point, near);
            near = Some(nearest.triangle);
            self.signed(point, &nearest)
        };
        places.iter().map(&mut distance).collect()
    }

    fn new(mesh: &Mesh, origin: DVec3, side: Side) -> Result<Self, CompareError> {
        let tree = TriangleTree::new(mesh, origin, side)?;
        let numbers = 0..tree.triangles().len();
        let area_up_to = numbers.scan(0.0, |total, triangle| {
            *total += scaled_normal(tree.corners(triangle)).length() / 2.0;
            Some(*total)
        });
        let area_up_to = area_up_to.collect();
        let stars = Stars::new(mesh.positions.len(), &mesh.triangles);
        let weighted =
            |[v, p, q]: [DVec3; 3]| (p - v).angle_between(q - v) * unit_normal([v, p, q]);
        let vertices = (0..tree.positions().len() as u32).into_par_iter();
        let at_vertices = vertices
            .map(|vertex| around(&stars, tree.positions(), vertex).map(weighted).sum())
            .collect();
        Ok(Self { tree, stars, at_vertices, area_up_to })
    }

    /// Distances of this surface's samples from `other`, and their signed mean.
    fn distances_to(&self, other: &Self, origin: DVec3) -> (Distances, f64) {
        let samples = (10 * self.tree.triangles().len()).clamp(SAMPLES[0], SAMPLES[1]);
        let area = in_chunks(samples, |range| other.summary(self.samples(range, samples)));
        let vertices = in_chunks(self.tree.positions().len(), |range| {
            let used = range.filter(|&vertex| !self.stars.of(vertex).is_empty());
            other.summary(used.map(|vertex| self.tree.positions()[vertex]))
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

    /// The samples with the numbers in `range`, out of `samples` samples of the whole surface. Each
    /// sample is in the middle of an equal share of the area.
    fn samples(&self, range: Range<usize>, samples: usize) -> impl Iterator<Item = DVec3> {
        let total = self.area_up_to[self.tree.triangles().len() - 1];
        let mut triangle = 0;
        range.map(move |number| {
            let target = (number as f64 + 0.5) / samples as f64 * total;
            if self.area_up_to[triangle] <= target {
                triangle += self.area_up_to[triangle..].partition_point(|&area| area <= target);
            }
            let [a, b, c] = self.tree.corners(triangle);
            let [u, v] = sample_weights(number);
            a + (b - a) * u + (c - a) * v
        })
    }

    /// Summarizes the distances from `points` to this surface.
    fn summary(&self, points: impl Iterator<Item = DVec3>) -> DistanceSums {
        let mut summary = DistanceSums::default();
        let mut near = None;
        for point in points {
            let nearest = self.tree.nearest(point, near);
            near = Some(nearest.triangle);
            summary.note(point, nearest.squared.sqrt(), self.signed(point, &nearest));
        }
        summary
    }

    /// The signed distance of a point from its nearest point on the surface, negative inside.
    fn signed(&self, point: DVec3, nearest: &SurfacePoint) -> f64 {
        let distance = nearest.squared.sqrt();
        let side = (point - nearest.at).dot(self.pseudo_normal(nearest));
        if side < 0.0 { -distance } else { distance }
    }

    /// A vector that points outwards at the nearest point. Inside a triangle, it is the triangle's
    /// normal. On an edge, it is the sum of the unit normals of the edge's triangles. On a vertex,
    /// it is the sum of the unit normals of the vertex's triangles, weighted by their angles at the
    /// vertex.
    fn pseudo_normal(&self, nearest: &SurfacePoint) -> DVec3 {
        let [a, b, c] = self.tree.triangles()[nearest.triangle];
        match nearest.place {
            Place::Corner(corner) => self.at_vertices[[a, b, c][corner] as usize],
            Place::Edge(edge) => {
                let ends = [[a, b], [b, c], [c, a]][edge];
                let triangles_at = |vertex: u32| self.stars.of(vertex as usize).len();
                let [from, to] = if triangles_at(ends[1]) < triangles_at(ends[0]) {
                    [ends[1], ends[0]]
                } else {
                    ends
                };
                let around = around(&self.stars, self.tree.positions(), from);
                let star = self.stars.of(from as usize).iter().zip(around);
                star.filter(|(across, _)| across.contains(&to))
                    .map(|(_, corners)| unit_normal(corners))
                    .sum()
            }
            Place::Face => scaled_normal(self.tree.corners(nearest.triangle)),
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

fn unit_normal(corners: [DVec3; 3]) -> DVec3 {
    scaled_normal(corners).normalize_or_zero()
}

/// The position of a sample in its triangle: the weights of the second and the third corner. They
/// come from the sequence R2 (Roberts 2018), which covers a square evenly, and are folded onto the
/// triangle.
fn sample_weights(number: usize) -> [f64; 2] {
    // The inverse of the plastic number, and its square.
    let [u, v] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3]
        .map(|step| (0.5 + number as f64 * step).fract());
    if u + v > 1.0 { [1.0 - u, 1.0 - v] } else { [u, v] }
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

/// Summarizes chunks of fixed length on all threads, and joins the summaries in order.
fn in_chunks(count: usize, summary: impl Fn(Range<usize>) -> DistanceSums + Sync) -> DistanceSums {
    let chunks: Vec<DistanceSums> = (0..count.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| summary(chunk * CHUNK..((chunk + 1) * CHUNK).min(count)))
        .collect();
    chunks.into_iter().fold(DistanceSums::default(), DistanceSums::append)
}
