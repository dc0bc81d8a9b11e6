//! A patch's triangles with their neighbours, to be changed one by one, and to be measured against.

use glam::Vec3;

use super::near::{Near, closest};

/// No triangle: the edge is on the border.
const NONE: u32 = u32::MAX;

/// Triangles, each directed edge at most once.
pub struct Surface<'a> {
    pub positions: &'a [Vec3],
    pub triangles: Vec<[u32; 3]>,
    /// For each triangle its neighbours: along the edge from its first corner to the second, and so on.
    across: Vec<[u32; 3]>,
    /// Outward, twice the triangle's area long.
    normals: Vec<Vec3>,
    balls: Vec<Ball>,
    near: Near,
    reach: f32,
}

/// Around a triangle, and its plane: whether a point can be near is told sooner by these.
#[derive(Clone, Copy)]
struct Ball {
    centre: Vec3,
    radius: f32,
    unit_normal: Vec3,
}

impl Ball {
    fn around(corners: [Vec3; 3], normal: Vec3) -> Self {
        let [a, b, c] = corners;
        let centre = (a + b + c) / 3.0;
        let radius =
            corners.map(|corner| corner.distance_squared(centre)).into_iter().fold(0.0, f32::max).sqrt();
        Self { centre, radius, unit_normal: normal.normalize_or_zero() }
    }

    #[inline]
    fn may_hold(&self, point: Vec3, normal: Vec3, distance: f32) -> bool {
        let offset = point - self.centre;
        let reach = self.radius + distance;
        offset.length_squared() <= reach * reach
            && offset.dot(self.unit_normal).abs() <= distance
            && self.unit_normal.dot(normal) >= 0.0
    }
}

/// The nearest point of a triangle.
#[derive(Clone, Copy)]
pub struct Nearest {
    /// Its number.
    pub triangle: usize,
    squared: f32,
    /// The point's barycentric coordinates.
    pub weights: [f32; 3],
}

impl<'a> Surface<'a> {
    /// Measured within `reach` only. Where directed edges occur twice, their vertices.
    pub fn new(positions: &'a [Vec3], triangles: Vec<[u32; 3]>, reach: f32) -> Result<Self, Vec<u32>> {
        let across = neighbours(positions.len(), &triangles)?;
        let near = Near::triangles(positions, &triangles, reach);
        let normals: Vec<Vec3> =
            triangles.iter().map(|&triangle| scaled_normal(positions, triangle)).collect();
        let corners = triangles.iter().map(|triangle| triangle.map(|vertex| positions[vertex as usize]));
        let balls = corners.zip(&normals).map(|(corners, &normal)| Ball::around(corners, normal)).collect();
        Ok(Self { positions, triangles, across, normals, balls, near, reach })
    }

    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|vertex| self.positions[vertex as usize])
    }

    pub fn normal(&self, triangle: usize) -> Vec3 {
        self.normals[triangle]
    }

    /// For every vertex the sum of the normals around it.
    pub fn vertex_normals(&self) -> Vec<Vec3> {
        let mut normals = vec![Vec3::ZERO; self.positions.len()];
        for (triangle, &normal) in self.triangles.iter().zip(&self.normals) {
            triangle.iter().for_each(|&vertex| normals[vertex as usize] += normal);
        }
        normals
    }

    /// The triangles that may be within reach of a point.
    pub fn near(&self, point: Vec3) -> Vec<u32> {
        self.near.at(point).concat()
    }

    /// Whether a triangle is within `distance` of `point`, no more than the surface's reach, that does not face the
    /// other way than `normal`: of a thin sheet's two sides each has to be near its own.
    pub fn holds(&self, point: Vec3, normal: Vec3, distance: f32) -> bool {
        let within = distance * distance;
        for list in self.near.at(point) {
            for &triangle in list {
                let triangle = triangle as usize;
                if self.balls[triangle].may_hold(point, normal, distance)
                    && closest(point, self.corners(triangle)).0 <= within
                {
                    return true;
                }
            }
        }
        false
    }

    /// The nearest of all triangles that do not face the other way; the first of equals.
    pub fn nearest(&self, point: Vec3, normal: Vec3) -> Option<Nearest> {
        let listed = self.near.at(point).into_iter().flatten().map(|&triangle| triangle as usize);
        self.nearest_of(point, normal, listed)
            .or_else(|| self.nearest_of(point, normal, 0..self.triangles.len()))
    }

    fn nearest_of(
        &self,
        point: Vec3,
        normal: Vec3,
        triangles: impl Iterator<Item = usize>,
    ) -> Option<Nearest> {
        let triangles = triangles.filter(|&triangle| self.normals[triangle].dot(normal) >= 0.0);
        let on = |triangle: usize| {
            let (squared, weights) = closest(point, self.corners(triangle));
            Nearest { triangle, squared, weights }
        };
        triangles.map(on).reduce(|best, next| if next.squared < best.squared { next } else { best })
    }

    /// The two triangles at an edge, and the corners across from it; nothing where there is no such edge in
    /// `triangle`, or it is on the border.
    pub fn at_edge(&self, triangle: usize, from: u32, to: u32) -> Option<([usize; 2], [u32; 2])> {
        let corners = self.triangles.get(triangle)?;
        let side = (0..3).find(|&side| corners[side] == from && corners[(side + 1) % 3] == to)?;
        let across = self.across[triangle][side];
        if across == NONE {
            return None;
        }
        let apex = |triangle: usize| {
            let apex = self.triangles[triangle].into_iter().find(|&vertex| vertex != from && vertex != to);
            apex.expect("a triangle has three corners")
        };
        Some(([triangle, across as usize], [apex(triangle), apex(across as usize)]))
    }

    /// A triangle with one of two vertices, and the number of its side beyond which is one with the other: where the
    /// two are across from each other at an edge.
    pub fn edge_between(&self, one: u32, other: u32) -> Option<(usize, usize)> {
        let listed = self.near.at(self.positions[one as usize]);
        let candidates = listed.into_iter().flatten().map(|&triangle| triangle as usize);
        candidates
            .filter_map(|triangle| {
                let corner = self.triangles[triangle].iter().position(|&vertex| vertex == one)?;
                let side = (corner + 1) % 3;
                let across = self.across[triangle][side];
                let found = across != NONE && self.triangles[across as usize].contains(&other);
                found.then_some((triangle, side))
            })
            .next()
    }

    /// Whether a vertex inside of the patch, a corner of `triangle`, has an edge to another.
    pub fn joined(&self, triangle: usize, vertex: u32, other: u32) -> bool {
        let mut at = triangle;
        loop {
            let corners = self.triangles[at];
            if corners.contains(&other) {
                return true;
            }
            let side = corners.iter().position(|&corner| corner == vertex).expect("a corner of each");
            at = self.across[at][side] as usize;
            if at == triangle || at == NONE as usize {
                return false;
            }
        }
    }

    /// Puts `parts` in place of whole triangles with the same rim, unless one of them would fold back. Returns whether
    /// it did; the first parts take the numbers of the whole ones, further ones new numbers.
    pub fn replace(&mut self, whole: &[usize], parts: &[[u32; 3]]) -> Option<Vec<usize>> {
        let before: Vec3 = whole.iter().map(|&number| self.normals[number]).sum();
        if parts.iter().any(|&part| scaled_normal(self.positions, part).dot(before) <= 0.0) {
            return None;
        }
        let mut rim = Vec::new();
        for &number in whole {
            let sides = edges(self.triangles[number]).into_iter().zip(self.across[number]);
            rim.extend(sides.filter(|(_, across)| !whole.contains(&(*across as usize))));
        }
        let added = self.triangles.len()..;
        let numbers: Vec<usize> = whole.iter().copied().chain(added).take(parts.len()).collect();
        for (&number, &part) in numbers.iter().zip(parts) {
            let corners = part.map(|vertex| self.positions[vertex as usize]);
            let across = edges(part).map(|edge| {
                let inner = parts.iter().position(|&other| edges(other).contains(&[edge[1], edge[0]]));
                if let Some(inner) = inner {
                    return numbers[inner] as u32;
                }
                let (_, outer) =
                    rim.iter().find(|(other, _)| *other == edge).expect("the rim stays the same");
                if *outer != NONE {
                    let sides = edges(self.triangles[*outer as usize]);
                    let side = sides.iter().position(|&side| side == [edge[1], edge[0]]).expect("neighbours");
                    self.across[*outer as usize][side] = number as u32;
                }
                *outer
            });
            let normal = scaled_normal(self.positions, part);
            let ball = Ball::around(corners, normal);
            if number < self.triangles.len() {
                self.balls[number] = ball;
                (self.triangles[number], self.across[number], self.normals[number]) = (part, across, normal);
            } else {
                self.triangles.push(part);
                self.across.push(across);
                self.normals.push(normal);
                self.balls.push(ball);
            }
        }
        for &number in &numbers {
            self.near.add(number as u32, self.corners(number), self.reach);
        }
        Some(numbers)
    }
}

/// Outward, twice the triangle's area long.
pub fn scaled_normal(positions: &[Vec3], triangle: [u32; 3]) -> Vec3 {
    let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
    (b - a).cross(c - a)
}

pub fn edges([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

fn neighbours(vertices: usize, triangles: &[[u32; 3]]) -> Result<Vec<[u32; 3]>, Vec<u32>> {
    // For each vertex the edges that leave it: where to, and of which triangle.
    let mut ends = vec![0_u32; vertices];
    for &vertex in triangles.as_flattened() {
        ends[vertex as usize] += 1;
    }
    let mut total = 0;
    for end in &mut ends {
        total += std::mem::replace(end, total);
    }
    let mut leaving = vec![(0, 0); 3 * triangles.len()];
    for (number, &triangle) in triangles.iter().enumerate() {
        for [from, to] in edges(triangle) {
            let end = &mut ends[from as usize];
            leaving[*end as usize] = (to, number as u32);
            *end += 1;
        }
    }
    let of = |vertex: u32| {
        let start = vertex.checked_sub(1).map_or(0, |before| ends[before as usize]);
        &leaving[start as usize..ends[vertex as usize] as usize]
    };
    let mut twice = Vec::new();
    for vertex in 0..vertices as u32 {
        let leaving = of(vertex);
        for (i, (to, _)) in leaving.iter().enumerate() {
            if leaving[..i].iter().any(|(other, _)| other == to) {
                twice.extend([vertex, *to]);
            }
        }
    }
    if !twice.is_empty() {
        return Err(twice);
    }
    let across =
        |[from, to]: [u32; 2]| of(to).iter().find(|(back, _)| *back == from).map_or(NONE, |(_, t)| *t);
    Ok(triangles.iter().map(|&triangle| edges(triangle).map(across)).collect())
}
