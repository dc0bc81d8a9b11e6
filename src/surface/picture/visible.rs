//! The visible part of a mesh: triangles that are visible at any sample, and the positions, normals
//! and values of their corners.

use std::io;

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::camera::Camera;
use super::colour::ColourSource;
use super::ranked::{AtomicSet, RankedSet};
use super::raster::Raster;
use super::request::Budget;
use super::request::PictureError;
use super::shape::{Shape, TriangleBatch};

/// Number of triangles per task.
const TASK: usize = 1 << 13;
/// Number of groups of corners. Each group's normals are summed by one thread.
const GROUPS: usize = 16;
/// The rank of an invisible corner.
const INVISIBLE: u32 = u32::MAX;

/// The visible triangles and their corners.
pub(super) struct VisibleTriangles {
    triangles: RankedSet,
    corners: Vec<[u32; 3]>,
    /// The [camera coordinates](Camera::camera_coordinates) of the corners, divided by the eye's
    /// distance from the target.
    coordinates: Vec<[f32; 3]>,
    /// Normals of the corners: unit vectors, or zeros.
    normals: Vec<Vec3>,
    /// Values of the corners; empty if no values are shown.
    values: Vec<f32>,
}

/// A place on a surface.
pub(super) struct VisiblePoint {
    /// The normal, which does not have unit length.
    pub(super) normal: Vec3,
    pub(super) value: f32,
}

/// How far a place on a triangle is from the triangle's edges, and how large the triangle is.
pub(super) struct Edges {
    /// Distance from the nearest edge, in units of the picture's height.
    pub(super) nearest: f32,
    /// The radius of the inscribed circle, in units of the picture's height.
    pub(super) radius: f32,
}

impl VisibleTriangles {
    /// Memory per visible triangle, in bytes, while normals are summed.
    pub(super) const TRIANGLE_BYTES: u64 =
        (size_of::<[u32; 3]>() + 3 * size_of::<Addition>()) as u64;
    /// Memory per visible corner, in bytes.
    pub(super) const VERTEX_BYTES: u64 = (2 * size_of::<[f32; 4]>() + size_of::<f32>()) as u64;

    /// Collects the visible part of a mesh that has been drawn on a raster.
    pub(super) fn of(
        raster: &Raster,
        shape: &Shape<'_>,
        camera: &Camera,
        values: &ColourSource<'_>,
        budget: &Budget,
    ) -> Result<Self, PictureError> {
        let triangles = AtomicSet::none_of(0..shape.mesh.triangle_count() as u32);
        let samples = raster.width * raster.height;
        (0..samples).into_par_iter().with_min_len(TASK).for_each(|n| {
            if let Some(sample) = raster.sample(n) {
                triangles.insert(sample.triangle);
            }
        });
        let triangles = triangles.ranked();

        let mut corners: Vec<[u32; 3]> = Vec::with_capacity(triangles.len());
        shape.triangles(|first, all| {
            let own = first..first + all.len() as u32;
            corners.extend(triangles.map(own, |number| all[(number - first) as usize]));
            Ok(())
        })?;
        let vertices = AtomicSet::none_of(0..shape.vertices());
        corners.par_iter().flatten_iter().for_each(|&corner| vertices.insert(corner));
        let vertices = vertices.ranked();
        let [visible_triangles, visible_vertices] =
            [triangles.len(), vertices.len()].map(|count| count as u64);
        budget.check(
            visible_triangles * Self::TRIANGLE_BYTES + visible_vertices * Self::VERTEX_BYTES,
        )?;
        corners.par_iter_mut().flatten_iter().for_each(|corner| *corner = rank(&vertices, *corner));

        let mut visible = Self {
            triangles,
            corners,
            coordinates: vec![[0.0; 3]; vertices.len()],
            normals: vec![Vec3::ZERO; vertices.len()],
            values: Vec::new(),
        };
        let add_up = !shape.mesh.has_normals();
        let numbers = vertices.map(0..shape.vertices(), |vertex| vertex);
        shape.batches(|batch| {
            visible.coordinates.par_iter_mut().zip(&numbers).with_min_len(TASK).for_each(
                |(coordinates, &vertex)| {
                    if let Some(at) = batch.find(vertex) {
                        *coordinates = camera
                            .camera_coordinates(batch.places[at].into())
                            .map(|x| (x / camera.distance()) as f32);
                    }
                },
            );
            if add_up {
                add_normals(batch, &vertices, camera.distance(), &mut visible.normals);
            }
            Ok(())
        })?;
        visible.set_normals_and_values(shape, &vertices, values)?;
        visible.normals.par_iter_mut().for_each(|normal| *normal = normal.normalize_or_zero());
        Ok(visible)
    }

    /// Sets the normals and the values of the vertices from the mesh.
    fn set_normals_and_values(
        &mut self,
        shape: &Shape<'_>,
        vertices: &RankedSet,
        values: &ColourSource<'_>,
    ) -> io::Result<()> {
        let all = 0..shape.vertices();
        let (normals, valued) = (shape.mesh.has_normals(), values.has_values());
        if !normals && !valued {
            return Ok(());
        }
        if let (Some(whole_normals), Some(whole_values)) =
            (shape.whole_normals(), shape.whole_values())
        {
            if normals {
                self.normals = vertices.map(all.clone(), |n| Vec3::from(whole_normals[n as usize]));
            }
            if valued {
                self.values = vertices.map(all, |n| whole_values[n as usize]);
            }
            return Ok(());
        }
        self.normals.truncate(if normals { 0 } else { self.normals.len() });
        for (piece, own) in shape.pieces().enumerate() {
            let members: Vec<usize> =
                vertices.within(own.clone()).map(|number| (number - own.start) as usize).collect();
            if members.is_empty() {
                continue;
            }
            let read = shape.mesh.vertices(piece)?;
            if normals {
                self.normals.extend(members.iter().map(|&n| Vec3::from(read.normals[n])));
            }
            if valued {
                let of_piece = values.of(&read);
                self.values.extend(members.iter().map(|&n| of_piece[n]));
            }
        }
        Ok(())
    }

    /// The point of a triangle that is visible at the place `towards` of the picture. The
    /// coordinates of `towards` are the distances of this place to the right and up from the
    /// picture's middle, in units of the picture's height.
    pub(super) fn point(&self, triangle: u32, towards: Vec2) -> VisiblePoint {
        let (corners, _, [a, b, c]) = self.around(triangle, towards);
        let shares = [b.perp_dot(c), c.perp_dot(a), a.perp_dot(b)];
        let sum: f32 = shares.iter().sum();
        let [a, b, c] = shares;
        let shares = [(a / sum).max(0.0), (b / sum).max(0.0), (c / sum).max(0.0)];
        let sum: f32 = shares.iter().sum();
        let [a, b, c] = shares;
        let shares =
            if sum.is_finite() && sum > 0.0 { [a / sum, b / sum, c / sum] } else { [1.0 / 3.0; 3] };
        let weighted = |n: usize| self.normals[corners[n]] * shares[n];
        let value = match &self.values[..] {
            [] => 0.0,
            values => (0..3).map(|n| values[corners[n]] * shares[n]).sum(),
        };
        VisiblePoint { normal: weighted(0) + weighted(1) + weighted(2), value }
    }

    /// How far the point that is visible at the place `towards` of the picture is from the edges of
    /// its triangle, and how large the triangle is.
    pub(super) fn edges(&self, triangle: u32, towards: Vec2) -> Edges {
        let (_, distances, from_line) = self.around(triangle, towards);
        let at: [Vec2; 3] = std::array::from_fn(|n| from_line[n] / distances[n]);
        let sides = [[0, 1], [1, 2], [2, 0]]
            .map(|[n, m]| (at[n].perp_dot(at[m]).abs(), at[n].distance(at[m])));
        let nearest =
            sides.map(|(area, length)| area / length).into_iter().fold(f32::INFINITY, f32::min);
        let area = (at[1] - at[0]).perp_dot(at[2] - at[0]).abs();
        let radius = area / sides.iter().map(|(_, length)| length).sum::<f32>();
        Edges { nearest, radius }
    }

    /// The corners of a triangle, their distances, and their offsets from a line of sight at those
    /// distances.
    fn around(&self, triangle: u32, towards: Vec2) -> ([usize; 3], [f32; 3], [Vec2; 3]) {
        let [a, b, c] = self.corners[rank(&self.triangles, triangle) as usize];
        let corners = [a as usize, b as usize, c as usize];
        let coordinates = |n: usize| self.coordinates[corners[n]];
        let from_line = |[x, y, distance]: [f32; 3]| Vec2::new(x, y) - distance * towards;
        let [a, b, c] = [coordinates(0), coordinates(1), coordinates(2)];
        (corners, [a[2], b[2], c[2]], [from_line(a), from_line(b), from_line(c)])
    }
}

/// The area-weighted normal of a triangle, and the ranks of the corners to which it is added.
type Addition = ([u32; 3], Vec3);

/// Adds the area-weighted normals of triangles to their visible corners, in triangle order.
fn add_normals(batch: &TriangleBatch<'_>, vertices: &RankedSet, unit: f64, normals: &mut [Vec3]) {
    let group_size = normals.len().div_ceil(GROUPS).max(1);
    let scale = 1.0 / unit;
    // For each task, the triangles that contribute to each group, given by the ranks of their
    // corners. Most triangles contribute to one group only.
    let additions: Vec<[Vec<Addition>; GROUPS]> = batch
        .triangles
        .par_chunks(TASK)
        .map(|triangles| {
            let mut additions: [Vec<_>; GROUPS] = Default::default();
            for &[a, b, c] in triangles {
                // Most triangles of a fine mesh have no visible corner.
                if !(vertices.contains(a) | vertices.contains(b) | vertices.contains(c)) {
                    continue;
                }
                let rank = |corner: u32| vertices.rank(corner).unwrap_or(INVISIBLE);
                let ranks = [rank(a), rank(b), rank(c)];
                let place = |corner: u32| DVec3::from(batch.places[batch.index(corner)]);
                let [a, b, c] = [place(a), place(b), place(c)];
                let normal = ((b - a) * scale).cross((c - a) * scale).as_vec3();
                let groups = [
                    ranks[0] as usize / group_size,
                    ranks[1] as usize / group_size,
                    ranks[2] as usize / group_size,
                ];
                for (n, of) in groups.into_iter().enumerate() {
                    if ranks[n] != INVISIBLE && !groups[..n].contains(&of) {
                        additions[of].push((ranks, normal));
                    }
                }
            }
            additions
        })
        .collect();
    normals.par_chunks_mut(group_size).enumerate().for_each(|(n, normals)| {
        let first = (n * group_size) as u32;
        for (ranks, normal) in additions.iter().flat_map(|of_task| &of_task[n]) {
            for rank in ranks {
                if let Some(sum) = normals.get_mut(rank.wrapping_sub(first) as usize) {
                    *sum += normal;
                }
            }
        }
    });
}

fn rank(set: &RankedSet, number: u32) -> u32 {
    set.rank(number).expect("visible triangles and corners have ranks")
}
