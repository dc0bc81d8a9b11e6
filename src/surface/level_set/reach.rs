//! The voxels to which a triangle can be nearest.
//!
//! Suppose that, of all points of the mesh, a point of a triangle is the nearest to a voxel. If the
//! point is inside the triangle, the line from the point to the voxel is perpendicular to the
//! triangle, and so parallel to its normal. If the point is on an edge or a vertex, the line is
//! within a certain angle of the normal of one of the triangles that meet there: see
//! [`NearTriangles::spread`]. In both cases, the voxel is near the line that passes through the
//! point along the normal. Its distance from this line is at most its height above the point along
//! the normal, times the tangent of the angle.

use glam::{IVec3, Vec3A, Vec4};

use super::near::{NearTriangle, NearTriangles};
use super::triangle::{VOXELS_PER_GROUP, greater, less};
use super::{BAND, BLOCK};

/// A margin, in voxels, added to limits on distances because distances are rounded.
pub const ROUNDING: f32 = 1e-3;
/// Number of coordinates whose ranges are computed at once.
const LANES: usize = 4;
/// Adding this to a whole number from 0 to 2^23 - 1 puts the number into the lowest bits of the
/// sum. This converts floats to integers without the checks of a cast.
const TO_BITS: f32 = (1 << 23) as f32;
/// The coordinates whose ranges are computed at once, relative to the first one.
const STEPS: Vec4 = Vec4::new(0.0, 1.0, 2.0, 3.0);

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
        // Large coordinates are clamped, because f32 sums with large numbers lose digits that
        // matter.
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
        for first_x in (0..self.end.x).step_by(LANES) {
            let at = first_x as f32 + STEPS;
            let heights = self.heights([-BAND, BAND].map(Vec4::splat), 0, at);
            let remaining = BAND * BAND + ROUNDING - self.squared_beyond(0, at);
            let [ys, y_ends] = self.range(heights, 1, remaining);
            let [low, high] = heights.map(|heights| heights.to_array());
            for (lane, x) in (first_x..self.end.x).take(LANES).enumerate() {
                let heights = [low[lane], high[lane]].map(Vec4::splat);
                let remaining = Vec4::splat(remaining[lane]);
                for first_y in (ys[lane]..y_ends[lane]).step_by(LANES) {
                    let at = first_y as f32 + STEPS;
                    let heights = self.heights(heights, 1, at);
                    let remaining = remaining - self.squared_beyond(1, at);
                    let [zs, z_ends] = self.range(heights, 2, remaining);
                    for (lane, y) in (first_y..y_ends[lane]).take(LANES).enumerate() {
                        let (mut z, z_end) = (zs[lane], z_ends[lane]);
                        // There is rarely more than one group. Storing the first one without a
                        // branch leaves only branches that the processor predicts well.
                        groups[count] = [x as i8, y as i8, z.min(last) as i8, 0];
                        count += usize::from(z < z_end);
                        while z_end - z > per_group {
                            z += per_group;
                            groups[count] = [x as i8, y as i8, z.min(last) as i8, 0];
                            count += 1;
                        }
                    }
                }
            }
        }
        count
    }

    /// Limits ranges of heights to the heights that voxels within reach can have at the coordinates
    /// `at` along `axis`. A height is a distance from the middle of the triangles along the normal.
    #[inline(always)]
    fn heights(&self, [low, high]: [Vec4; 2], axis: usize, at: Vec4) -> [Vec4; 2] {
        let middle = (at - self.centre[axis]) * self.inverse[axis];
        let half = (self.half[axis] + self.across[axis] * self.aside) * self.inverse[axis].abs();
        [greater_of_each(middle - half, low), less_of_each(middle + half, high)]
    }

    /// The squared distances of the coordinates `at` from the triangles' bounding box along `axis`.
    #[inline(always)]
    fn squared_beyond(&self, axis: usize, at: Vec4) -> Vec4 {
        let beyond = ((at - self.centre[axis]).abs() - self.half[axis]).max(Vec4::ZERO);
        beyond * beyond
    }

    /// The ranges of coordinates along `axis` that voxels within reach can have if their heights
    /// are from `low` to `high`, and if their squared distance from the triangles' bounding box
    /// along `axis` is at most `remaining`.
    #[inline(always)]
    fn range(&self, [low, high]: [Vec4; 2], axis: usize, remaining: Vec4) -> [[i32; LANES]; 2] {
        let aside = less_of_each(self.spread * (-low).max(high), Vec4::splat(BAND));
        let middle = self.centre[axis] + (low + high) / 2.0 * self.normal[axis];
        let half = self.half[axis]
            + (high - low) / 2.0 * self.normal[axis].abs()
            + aside * self.across[axis];
        let reach = self.half[axis] + remaining.max(Vec4::ZERO).sqrt();
        // The least whole numbers that are greater than `at` and not negative.
        let next_integers = |at: Vec4| {
            let next = (at + 1.0).max(Vec4::ZERO).min(Vec4::splat(self.end[axis] as f32));
            (next.floor() + TO_BITS)
                .to_array()
                .map(|next| (next.to_bits() - TO_BITS.to_bits()) as i32)
        };
        [
            next_integers(greater_of_each(middle - half, self.centre[axis] - reach)),
            next_integers(less_of_each(middle + half, self.centre[axis] + reach)),
        ]
    }
}

/// The greater number of each pair; the number in `b` if the number in `a` is NaN. [`Vec4::max`]
/// would treat NaN differently on different processors.
fn greater_of_each(a: Vec4, b: Vec4) -> Vec4 {
    Vec4::from_array(std::array::from_fn(|i| greater(a[i], b[i])))
}

/// The lesser number of each pair; see [`greater_of_each`].
fn less_of_each(a: Vec4, b: Vec4) -> Vec4 {
    Vec4::from_array(std::array::from_fn(|i| less(a[i], b[i])))
}
