//! The nearest point of a triangle.

use glam::Vec3;

/// A triangle in voxels.
#[derive(Debug, Clone, Copy)]
pub struct Triangle {
    corners: [Vec3; 3],
    /// The normal, of unit length.
    normal: Vec3,
    /// A disc that contains the triangle.
    centre: Vec3,
    radius: f32,
}

/// The nearest point of a triangle to a place.
#[derive(Debug, Clone, Copy)]
pub struct NearestPoint {
    /// The square of the distance.
    pub squared: f32,
    /// The share of each corner in the point; their sum is 1.
    pub shares: [f32; 3],
}

impl Triangle {
    /// `None` for a triangle without area, whose edges are also those of its neighbours.
    pub fn new(corners: [Vec3; 3]) -> Option<Self> {
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).try_normalize()?;
        let centre = (a + b + c) / 3.0;
        let radius = corners.map(|corner| corner.distance(centre)).into_iter().fold(0.0, f32::max);
        Some(Self { corners, normal, centre, radius })
    }

    /// The box of the corners.
    pub fn bounds(&self) -> [Vec3; 2] {
        let [a, b, c] = self.corners;
        [a.min(b).min(c), a.max(b).max(c)]
    }

    /// A lower bound of the squared distance from `place`: that of a disc in the triangle's plane
    /// that contains it.
    pub fn least_squared(&self, place: Vec3) -> f32 {
        let from_centre = place - self.centre;
        let height = self.normal.dot(from_centre);
        let along = (from_centre.length_squared() - height * height).max(0.0).sqrt();
        let beyond = (along - self.radius).max(0.0);
        height * height + beyond * beyond
    }

    /// The nearest point to `place`: a corner, a point of an edge, or the foot of the perpendicular,
    /// by the part of space in which `place` is.
    pub fn nearest(&self, place: Vec3) -> NearestPoint {
        let [a, b, c] = self.corners;
        let shares = self.shares(place);
        let point = a * shares[0] + b * shares[1] + c * shares[2];
        NearestPoint { squared: place.distance_squared(point), shares }
    }

    fn shares(&self, place: Vec3) -> [f32; 3] {
        let [a, b, c] = self.corners;
        let (ab, ac) = (b - a, c - a);
        let from_a = place - a;
        let (along_b, along_c) = (ab.dot(from_a), ac.dot(from_a));
        if along_b <= 0.0 && along_c <= 0.0 {
            return [1.0, 0.0, 0.0];
        }
        let from_b = place - b;
        let (b_along_b, b_along_c) = (ab.dot(from_b), ac.dot(from_b));
        if b_along_b >= 0.0 && b_along_c <= b_along_b {
            return [0.0, 1.0, 0.0];
        }
        let of_c = along_b * b_along_c - b_along_b * along_c;
        if of_c <= 0.0 && along_b >= 0.0 && b_along_b <= 0.0 {
            let share = along_b / (along_b - b_along_b);
            return [1.0 - share, share, 0.0];
        }
        let from_c = place - c;
        let (c_along_b, c_along_c) = (ab.dot(from_c), ac.dot(from_c));
        if c_along_c >= 0.0 && c_along_b <= c_along_c {
            return [0.0, 0.0, 1.0];
        }
        let of_b = c_along_b * along_c - along_b * c_along_c;
        if of_b <= 0.0 && along_c >= 0.0 && c_along_c <= 0.0 {
            let share = along_c / (along_c - c_along_c);
            return [1.0 - share, 0.0, share];
        }
        let of_a = b_along_b * c_along_c - c_along_b * b_along_c;
        let (to_c, to_b) = (b_along_c - b_along_b, c_along_b - c_along_c);
        if of_a <= 0.0 && to_c >= 0.0 && to_b >= 0.0 {
            let share = to_c / (to_c + to_b);
            return [0.0, 1.0 - share, share];
        }
        let all = of_a + of_b + of_c;
        let (b, c) = (of_b / all, of_c / all);
        [1.0 - b - c, b, c]
    }

    /// The distance of `place` from the triangle's plane; negative behind it.
    pub fn height(&self, place: Vec3) -> f32 {
        self.normal.dot(place - self.corners[0])
    }
}
