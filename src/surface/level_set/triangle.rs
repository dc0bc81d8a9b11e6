//! Distances from triangles, four at a time.
//!
//! Each triangle has its own coordinate system, in which the triangle lies in the plane z = 0, with
//! the first corner at the origin and the first edge along x. In this system, a point's squared
//! distance is the sum of the squares of its height z and of its distance within the plane. Three
//! numbers describe the triangle in the plane.

use glam::{DVec3, Mat4, Vec4, Vec4Swizzles};

/// Minimum height, in voxels, of a triangle that is used.
const LEAST_HEIGHT: f64 = 1e-6;

/// A triangle, with its coordinates in voxels.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub struct Triangle {
    /// The axes of the triangle's coordinate system. The fourth component of each is minus the
    /// coordinate of the first corner along that axis.
    axes: [Vec4; 3],
    /// The coordinate x of the second corner, and the coordinates x and y of the third corner.
    shape: Vec4,
}

/// Squared distances from triangles, and heights above their planes.
#[derive(Debug, Clone, Copy)]
pub struct TriangleDistances {
    pub squared: Vec4,
    /// Negative behind the triangle.
    pub heights: Vec4,
}

impl Triangle {
    /// Prepares a triangle; `None` if its height is less than [`LEAST_HEIGHT`]. Every point of such
    /// a flat triangle is within this distance of an edge or a corner of another triangle.
    pub fn new([a, b, c]: [DVec3; 3]) -> Option<Self> {
        let (ab, ac) = (b - a, c - a);
        let normal = ab.cross(ac);
        let longest = ab.length_squared().max(ac.length_squared()).max(b.distance_squared(c));
        let area = normal.length();
        if area <= LEAST_HEIGHT * longest.sqrt() {
            return None;
        }
        let length = ab.length();
        let (x, z) = (ab / length, normal / area);
        let y = z.cross(x);
        let row = |axis: DVec3| axis.extend(-axis.dot(a)).as_vec4();
        let shape = [length, ac.dot(x), area / length, 0.0].map(|number| number as f32);
        Some(Self { axes: [row(x), row(y), row(z)], shape: shape.into() })
    }

    /// The distances of four points from this triangle. `x`, `y` and `z` have the coordinates of
    /// the four points.
    #[inline]
    pub fn distances(&self, [x, y, z]: [Vec4; 3]) -> TriangleDistances {
        let along = |axis: Vec4| axis.xxxx() * x + axis.yyyy() * y + axis.zzzz() * z + axis.wwww();
        let [u, v, height] = self.axes.map(along);
        let shape = self.shape;
        let in_plane = squared_in_plane([u, v], [shape.xxxx(), shape.yyyy(), shape.zzzz()]);
        TriangleDistances { squared: in_plane + height * height, heights: height }
    }

    /// The squared distances of a place from four triangles.
    pub fn squared_of(triangles: [&Self; 4], place: [f32; 3]) -> [f32; 4] {
        let transposed = |row: fn(&Self) -> Vec4| {
            let [a, b, c, d] = triangles.map(row);
            Mat4::from_cols(a, b, c, d).transpose()
        };
        let [x, y, z] = place.map(Vec4::splat);
        let along = |Mat4 { x_axis, y_axis, z_axis, w_axis }: Mat4| {
            x_axis * x + y_axis * y + z_axis * z + w_axis
        };
        let (u, v, height) = (
            along(transposed(|triangle| triangle.axes[0])),
            along(transposed(|triangle| triangle.axes[1])),
            along(transposed(|triangle| triangle.axes[2])),
        );
        let Mat4 { x_axis: b_x, y_axis: c_x, z_axis: c_y, .. } =
            transposed(|triangle| triangle.shape);
        (squared_in_plane([u, v], [b_x, c_x, c_y]) + height * height).to_array()
    }
}

/// The squared distances of places in the plane from triangles with the corners (0, 0), (`b_x`, 0)
/// and (`c_x`, `c_y`): 0 inside, and otherwise the squared distance from the nearest edge.
#[inline(always)]
fn squared_in_plane([x, y]: [Vec4; 2], [b_x, c_x, c_y]: [Vec4; 3]) -> Vec4 {
    let from_edge = |[x, y]: [Vec4; 2], [edge_x, edge_y]: [Vec4; 2]| {
        let length = edge_x * edge_x + edge_y * edge_y;
        let share = ((x * edge_x + y * edge_y) / length).max(Vec4::ZERO).min(Vec4::ONE);
        let (dx, dy) = (x - share * edge_x, y - share * edge_y);
        (dx * dx + dy * dy, edge_x * y - edge_y * x)
    };
    let along_x = x - x.max(Vec4::ZERO).min(b_x);
    let first = along_x * along_x + y * y;
    let (second, left_of_second) = from_edge([x - b_x, y], [c_x - b_x, c_y]);
    let (third, left_of_third) = from_edge([x, y], [c_x, c_y]);
    let zero = Vec4::ZERO;
    let inside = y.cmpge(zero) & left_of_second.cmpge(zero) & left_of_third.cmple(zero);
    Vec4::select(inside, zero, first.min(second).min(third))
}

/// The share of each corner of a triangle in the triangle's nearest point to the origin; the sum of
/// the shares is 1. The nearest point is a corner, a point on an edge, or the foot of the
/// perpendicular, depending on the region of space in which the origin lies (Ericson, Real-Time
/// Collision Detection, 5.1.5).
pub fn shares([a, b, c]: [DVec3; 3]) -> [f32; 3] {
    let (ab, ac) = (b - a, c - a);
    let (along_b, along_c) = (-ab.dot(a), -ac.dot(a));
    if along_b <= 0.0 && along_c <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let (b_along_b, b_along_c) = (-ab.dot(b), -ac.dot(b));
    if b_along_b >= 0.0 && b_along_c <= b_along_b {
        return [0.0, 1.0, 0.0];
    }
    let of_c = along_b * b_along_c - b_along_b * along_c;
    if of_c <= 0.0 && along_b >= 0.0 && b_along_b <= 0.0 {
        let share = (along_b / (along_b - b_along_b)) as f32;
        return [1.0 - share, share, 0.0];
    }
    let (c_along_b, c_along_c) = (-ab.dot(c), -ac.dot(c));
    if c_along_c >= 0.0 && c_along_b <= c_along_c {
        return [0.0, 0.0, 1.0];
    }
    let of_b = c_along_b * along_c - along_b * c_along_c;
    if of_b <= 0.0 && along_c >= 0.0 && c_along_c <= 0.0 {
        let share = (along_c / (along_c - c_along_c)) as f32;
        return [1.0 - share, 0.0, share];
    }
    let of_a = b_along_b * c_along_c - c_along_b * b_along_c;
    let (to_c, to_b) = (b_along_c - b_along_b, c_along_b - c_along_c);
    if of_a <= 0.0 && to_c >= 0.0 && to_b >= 0.0 {
        let share = (to_c / (to_c + to_b)) as f32;
        return [0.0, 1.0 - share, share];
    }
    let all = of_a + of_b + of_c;
    let (b, c) = ((of_b / all) as f32, (of_c / all) as f32);
    [1.0 - b - c, b, c]
}
