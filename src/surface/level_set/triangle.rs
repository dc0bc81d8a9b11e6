//! Distances from triangles to voxels, computed for four voxels at a time.
//!
//! Each triangle has its own coordinate system, in which the triangle lies in the plane z = 0, with
//! the first corner at the origin and the first edge along x. In this system, a point's squared
//! distance is the sum of the squares of its height z and of its distance within the plane.

use glam::DVec3;

/// Number of voxels that a triangle is compared with at once. They are neighbours along z.
pub const VOXELS_PER_GROUP: usize = 4;

/// Triangles whose coordinates are in voxels. Each triangle has [`VOXELS_PER_GROUP`] lanes, one for
/// each voxel; all of its lanes have the same numbers. The compiler turns loops over the lanes into
/// vector instructions.
#[derive(Debug, Clone, Copy)]
pub struct Triangles<const LANES: usize> {
    /// The coordinates of the lattice's origin in the triangle's system, and the amounts by which
    /// they change with each step along the lattice's x, y and z.
    system: [[[f32; LANES]; 3]; 4],
    /// The length of the first edge.
    length: [f32; LANES],
    /// The directions of the other two edges in the plane, and their lengths.
    edges: [[[f32; LANES]; 3]; 2],
}

impl<const LANES: usize> Triangles<LANES> {
    pub fn new() -> Self {
        let none = [0.0; LANES];
        Self { system: [[none; 3]; 4], length: none, edges: [[none; 3]; 2] }
    }

    /// Prepares triangle number `index`, which must not be degenerate. `normal` is its unit normal.
    #[inline]
    pub fn set(&mut self, index: usize, [a, b, c]: [DVec3; 3], normal: DVec3) {
        let (ab, ac) = (b - a, c - a);
        let length = ab.length();
        let x = ab * length.recip();
        let y = normal.cross(x);
        let (c_x, c_y) = (ac.dot(x), ac.dot(y) as f32);
        let edge = |x: f32| {
            let length = (x * x + c_y * c_y).sqrt();
            let inverse = length.recip();
            [x * inverse, c_y * inverse, length]
        };
        let axes = [x, y, normal];
        let start = axes.map(|axis| (-axis.dot(a)) as f32);
        let along = |k: usize| axes.map(|axis| axis[k] as f32);
        let system = [start, along(0), along(1), along(2)];
        let edges = [edge((c_x - length) as f32), edge(c_x as f32)];
        let put = |to: &mut [f32; LANES], number: f32| {
            to.as_chunks_mut::<VOXELS_PER_GROUP>().0[index] = [number; VOXELS_PER_GROUP];
        };
        put(&mut self.length, length as f32);
        for (to, number) in self.system.as_flattened_mut().iter_mut().zip(system.as_flattened()) {
            put(to, *number);
        }
        for (to, number) in self.edges.as_flattened_mut().iter_mut().zip(edges.as_flattened()) {
            put(to, *number);
        }
    }

    /// The squared distances from each triangle of the voxels from (x, y, z) to (x, y, z + 3).
    #[inline(always)]
    pub fn squared_distances(&self, [x, y, z]: [f32; 3]) -> [f32; LANES] {
        let mut squared = [0.0; LANES];
        let [start, along_x, along_y, along_z] = &self.system;
        let [second, third] = &self.edges;
        for i in 0..LANES {
            let z = z + (i % VOXELS_PER_GROUP) as f32;
            let u = start[0][i] + along_x[0][i] * x + along_y[0][i] * y + z * along_z[0][i];
            let v = start[1][i] + along_x[1][i] * x + along_y[1][i] * y + z * along_z[1][i];
            let height = start[2][i] + along_x[2][i] * x + along_y[2][i] * y + z * along_z[2][i];
            // The squared distance from an edge, and the distance from the edge's line.
            let from_edge = |x: f32, along_x: f32, along_y: f32, length: f32| {
                let along = x * along_x + v * along_y;
                let across = v * along_x - x * along_y;
                let beyond = along - less(greater(along, 0.0), length);
                (beyond * beyond + across * across, across)
            };
            let beyond = u - less(greater(u, 0.0), self.length[i]);
            let first_squared = beyond * beyond + v * v;
            let (second_squared, left_of_second) =
                from_edge(u - self.length[i], second[0][i], second[1][i], second[2][i]);
            let (third_squared, left_of_third) =
                from_edge(u, third[0][i], third[1][i], third[2][i]);

            let is_inside = less(less(v, left_of_second), -left_of_third) >= 0.0;
            let nearest_edge = less(less(first_squared, second_squared), third_squared);
            let in_plane = if is_inside { 0.0 } else { nearest_edge };
            squared[i] = in_plane + height * height;
        }
        squared
    }
}

/// The greater number. Unlike [`f32::max`], this takes one instruction, because it need not ignore
/// NaN.
#[inline(always)]
pub fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The lesser number; see [`greater`].
#[inline(always)]
pub fn less(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Returns the barycentric coordinates of the point of a triangle that is nearest to the origin:
/// the weights of the three corners, which add up to 1. The function first tests whether this point
/// is a corner or lies on an edge. Otherwise, the point is inside the triangle (Ericson, Real-Time
/// Collision Detection, 5.1.5).
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
