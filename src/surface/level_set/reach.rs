//! The voxels to which a triangle can be nearest.
//!
//! Let a point of a triangle be the point of the mesh that is nearest to a voxel. If the point is
//! inside the triangle, the line through the point and the voxel is parallel to the triangle's
//! normal. If the point is on an edge or a vertex, this line is only within some angle of the
//! normal of one of the triangles around the edge or vertex. In both cases, the voxel is near the
//! line that passes through the point along the normal.

use glam::{IVec3, Vec3A, Vec4};

use super::near::{NearTriangle, NearTriangles};
use super::{BAND, BLOCK};

/// Number of voxels that a triangle is compared with at once. They are neighbours along z.
pub const VOXELS_PER_GROUP: usize = 4;
/// A margin, in voxels, added to limits on distances because distances are rounded.
pub const ROUNDING: f32 = 1e-3;

/// The voxels of a block, within the band, to which one of a few triangles can be nearest.
/// Coordinates are relative to `first`.
#[derive(Debug)]
pub struct Reach {
    /// The first voxel of the bounding box of these voxels, in the block.
    pub first: IVec3,
    /// The end of this bounding box.
    end: IVec3,
    /// The middle of the triangles' bounding box, and half the size of this box.
    centre: Vec3A,
    half: Vec3A,
    /// The mean normal of the triangles, and the reciprocals of its components.
    normal: Vec3A,
    inverse: Vec3A,
    /// For each axis, the greatest component of a unit vector that is perpendicular to the normal.
    across: Vec3A,
    /// The tangent of the greatest angle between the normal and the direction from the triangles to
    /// a voxel.
    spread: f32,
    /// The greatest distance of a voxel from the line that passes along the normal through the
    /// voxel's nearest point.
    aside: f32,
}

impl Reach {
    /// Returns `None` if the triangles are nearest to no voxel of the block. If there are several
    /// triangles, they must be nearly parallel.
    pub fn of(near: &NearTriangles, triangles: &[NearTriangle]) -> Option<Self> {
        // Large coordinates are clamped, because they would lose digits that matter.
        let [least, most] = [-2.0 * BAND, BLOCK as f32 + 2.0 * BAND].map(Vec3A::splat);
        let (mut low, mut high) = (most, least);
        let (mut spread, mut normal) = (0.0, Vec3A::ZERO);
        for triangle in triangles {
            for corner in triangle.corners {
                let place = near.place(corner).as_vec3a();
                (low, high) = (low.min(place), high.max(place));
                spread = greater(spread, near.spread(corner));
            }
            normal += triangle.normal.as_vec3a();
        }
        let (low, high) = (low.max(least), high.min(most));
        if triangles.len() > 1 {
            normal = normal.normalize();
            let cos = normal.dot(triangles[0].normal.as_vec3a());
            let tan = (1.0 - cos * cos).max(0.0).sqrt() / cos;
            // The tangent of the sum of both angles, which is less than 90 degrees.
            if spread.is_finite() {
                spread = (spread + tan) / (1.0 - spread * tan);
            }
        }
        let aside = less(spread * BAND, BAND);
        let across = Vec4::from((1.0 - normal * normal, 0.0)).max(Vec4::splat(1e-6)).sqrt();
        let across = Vec3A::from(across.truncate());
        let reach = (normal.abs() * BAND + across * aside).min(Vec3A::splat(BAND)) + ROUNDING;
        // Casts of positive numbers round down.
        let first = (low - reach + 1.0).max(Vec3A::ZERO).as_ivec3();
        let end = (high + reach + 1.0).clamp(Vec3A::ZERO, Vec3A::splat(BLOCK as f32)).as_ivec3();
        first.cmplt(end).all().then(|| Self {
            first,
            end: end - first,
            centre: (low + high) / 2.0 - first.as_vec3a(),
            half: (high - low) / 2.0 + ROUNDING,
            normal,
            inverse: normal.recip(),
            across,
            spread,
            aside,
        })
    }

    /// The last voxel of the bounding box, in the block.
    pub fn last(&self) -> IVec3 {
        self.first + self.end - 1
    }

    /// Stores the first voxel of each group of [`VOXELS_PER_GROUP`] voxels that contains voxels
    /// within reach, and returns the number of groups. All voxels of a group are in the block.
    pub fn groups(&self, groups: &mut [[i8; 4]]) -> usize {
        let per_group = VOXELS_PER_GROUP as i32;
        let last = BLOCK - per_group - self.first.z;
        let mut count = 0;
        for x in 0..self.end.x {
            let heights = self.heights([-BAND, BAND], 0, x);
            let remaining = BAND * BAND + ROUNDING - self.squared_beyond(0, x);
            let [y, y_end] = self.range(heights, 1, remaining);
            for y in y..y_end {
                let heights = self.heights(heights, 1, y);
                let [mut z, z_end] = self.range(heights, 2, remaining - self.squared_beyond(1, y));
                // There is rarely more than one group. Storing the first one without a branch
                // leaves only branches that the processor predicts well.
                groups[count] = [x as i8, y as i8, z.min(last) as i8, 0];
                count += usize::from(z < z_end);
                while z_end - z > per_group {
                    z += per_group;
                    groups[count] = [x as i8, y as i8, z.min(last) as i8, 0];
                    count += 1;
                }
            }
        }
        count
    }

    /// Limits a range of heights to the heights that voxels within reach can have at the coordinate
    /// `at` along `axis`. A height is a distance from the middle of the triangles along the normal.
    fn heights(&self, [low, high]: [f32; 2], axis: usize, at: i32) -> [f32; 2] {
        let middle = (at as f32 - self.centre[axis]) * self.inverse[axis];
        let half = (self.half[axis] + self.across[axis] * self.aside) * self.inverse[axis].abs();
        [greater(middle - half, low), less(middle + half, high)]
    }

    /// The squared distance of the coordinate `at` from the triangles' bounding box along `axis`.
    fn squared_beyond(&self, axis: usize, at: i32) -> f32 {
        let beyond = greater((at as f32 - self.centre[axis]).abs() - self.half[axis], 0.0);
        beyond * beyond
    }

    /// The range of coordinates along `axis` that voxels within reach can have if their heights are
    /// from `low` to `high`, and if their squared distance from the triangles' bounding box along
    /// `axis` is at most `remaining`.
    fn range(&self, [low, high]: [f32; 2], axis: usize, remaining: f32) -> [i32; 2] {
        let aside = less(self.spread * greater(-low, high), BAND);
        let middle = self.centre[axis] + (low + high) / 2.0 * self.normal[axis];
        let half = self.half[axis]
            + (high - low) / 2.0 * self.normal[axis].abs()
            + aside * self.across[axis];
        let reach = self.half[axis] + remaining.max(0.0).sqrt();
        [
            next_integer(greater(middle - half, self.centre[axis] - reach)),
            next_integer(less(middle + half, self.centre[axis] + reach)).min(self.end[axis]),
        ]
    }
}

/// The least whole number that is greater than `at` and not negative.
fn next_integer(at: f32) -> i32 {
    (at + 1.0).max(0.0) as i32
}

/// The greater number. Unlike [`f32::max`], this takes one instruction, because it need not ignore
/// NaN.
fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The lesser number; see [`greater`].
fn less(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}
