//! Distances from triangles, four at a time.
//!
//! Each triangle has its own coordinate system, in which the triangle lies in the plane z = 0, with
//! the first corner at the origin and the first edge along x. In this system, a point's squared
//! distance is the sum of the squares of its height z and of its distance within the plane.

use glam::{DVec3, Vec4, Vec4Swizzles};

/// A triangle, with its coordinates in voxels. A `Vec4` that describes one number has four copies
/// of this number, one for each point.
#[derive(Debug, Default, Clone, Copy)]
pub struct Triangle {
    /// The coordinates of the lattice's origin in the triangle's system, and the amounts by which
    /// they change with each step along the lattice's x and y. The fourth components are 0.
    start: [Vec4; 3],
    /// The amount by which each coordinate changes with each step along the lattice's z.
    along_z: [Vec4; 3],
    /// The length of the first edge.
    length: Vec4,
    /// The directions of the other two edges in the plane, and their lengths.
    edges: [[Vec4; 3]; 2],
}

impl Triangle {
    /// Prepares a triangle that is not degenerate. `normal` is its unit normal.
    #[inline]
    pub fn new([a, b, c]: [DVec3; 3], normal: DVec3) -> Self {
        let (ab, ac) = (b - a, c - a);
        let length = ab.length();
        let x = ab * length.recip();
        let y = normal.cross(x);
        let (c_x, c_y) = (ac.dot(x), ac.dot(y) as f32);
        let edge = |x: f32| {
            let length = (x * x + c_y * c_y).sqrt();
            let inverse = length.recip();
            [x * inverse, c_y * inverse, length].map(Vec4::splat)
        };
        let start = [-x.dot(a), -y.dot(a), -normal.dot(a)].map(|number| number as f32);
        let [x, y, z] = [x.as_vec3(), y.as_vec3(), normal.as_vec3()];
        Self {
            start: [
                Vec4::new(start[0], start[1], start[2], 0.0),
                Vec4::new(x.x, y.x, z.x, 0.0),
                Vec4::new(x.y, y.y, z.y, 0.0),
            ],
            along_z: [Vec4::splat(x.z), Vec4::splat(y.z), Vec4::splat(z.z)],
            length: Vec4::splat(length as f32),
            edges: [edge((c_x - length) as f32), edge(c_x as f32)],
        }
    }

    /// The squared distances of four points with equal x and y.
    #[inline(always)]
    pub fn squared_distances(&self, x: f32, y: f32, z: Vec4) -> Vec4 {
        let start = self.start[0] + self.start[1] * x + self.start[2] * y;
        let [u, v, height] = [
            start.xxxx() + z * self.along_z[0],
            start.yyyy() + z * self.along_z[1],
            start.zzzz() + z * self.along_z[2],
        ];
        let zero = Vec4::ZERO;
        let from_edge = |x: Vec4, [along_x, along_y, length]: [Vec4; 3]| {
            let along = x * along_x + v * along_y;
            let across = v * along_x - x * along_y;
            let beyond = along - along.max(zero).min(length);
            (beyond * beyond + across * across, across)
        };
        let beyond = u - u.max(zero).min(self.length);
        let first = beyond * beyond + v * v;
        let (second, left_of_second) = from_edge(u - self.length, self.edges[0]);
        let (third, left_of_third) = from_edge(u, self.edges[1]);
        let is_inside = v.min(left_of_second).min(-left_of_third).cmpge(zero);
        let in_plane = Vec4::select(is_inside, zero, first.min(second).min(third));
        in_plane + height * height
    }
}

/// The weights (barycentric coordinates) of a triangle's corners in the point of the triangle that
/// is nearest to the origin; the sum of the weights is 1. The tests find whether the nearest point
/// is a corner, on an edge, or inside the triangle (Ericson, Real-Time Collision Detection, 5.1.5).
#[inline]
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
