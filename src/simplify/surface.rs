//! A patch's triangles with their neighbours, to be changed one by one, and to be measured against.
//!
//! Nothing is looked up by place. What is asked lies near a triangle that is known, and is searched for from there.

use glam::Vec3;

use super::collapse::Spoke;

/// No triangle.
pub const NONE: u32 = u32::MAX;
/// How many triangles a search looks at before it gives up.
const PATIENCE: usize = 32;
/// It goes on from a triangle whose squared distance is so many times the least so far.
const DETOUR: f32 = 1.5;
/// Nor does one walk farther than so many triangles for a cell.
const STEPS_A_CELL: f32 = 8.0;

/// Triangles, each directed edge at most once.
#[derive(Clone)]
pub struct Surface<'a> {
    pub positions: &'a [Vec3],
    pub triangles: Vec<[u32; 3]>,
    /// For each triangle its neighbours: along the edge from its first corner to the second, and so on.
    across: Vec<[u32; 3]>,
    /// For each vertex a triangle with it, or `NONE`.
    at: Vec<u32>,
    /// Outward, twice the triangle's area long.
    normals: Vec<Vec3>,
}

/// The edges of a surface by the vertices that they leave.
pub struct Leaving {
    /// For each vertex where its edges end.
    ends: Vec<u32>,
    /// Where to, and of which triangle.
    edges: Vec<(u32, u32)>,
}

impl Leaving {
    /// Of all triangles.
    pub fn of(vertices: usize, triangles: &[[u32; 3]]) -> Self {
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
        Self { ends, edges: leaving }
    }

    /// Those of a vertex.
    pub fn at(&self, vertex: u32) -> &[(u32, u32)] {
        let start = vertex.checked_sub(1).map_or(0, |before| self.ends[before as usize]);
        &self.edges[start as usize..self.ends[vertex as usize] as usize]
    }
}

impl<'a> Surface<'a> {
    /// By edges that leave their vertices once each.
    pub fn new(positions: &'a [Vec3], triangles: Vec<[u32; 3]>, leaving: &Leaving) -> Self {
        let across = |[from, to]: [u32; 2]| {
            leaving.at(to).iter().find(|(back, _)| *back == from).map_or(NONE, |(_, triangle)| *triangle)
        };
        let across = triangles.iter().map(|&triangle| edges(triangle).map(across)).collect();
        let at = |vertex| leaving.at(vertex).first().map_or(NONE, |(_, triangle)| *triangle);
        let at = (0..positions.len() as u32).map(at).collect();
        let normals: Vec<Vec3> =
            triangles.iter().map(|&triangle| scaled_normal(positions, triangle)).collect();
        Self { positions, triangles, across, at, normals }
    }

    pub fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.triangles[triangle as usize].map(|vertex| self.positions[vertex as usize])
    }

    pub fn normal(&self, triangle: u32) -> Vec3 {
        self.normals[triangle as usize]
    }

    /// Whether a triangle has this vertex.
    pub fn has(&self, vertex: u32) -> bool {
        self.at[vertex as usize] != NONE
    }

    /// A triangle with this vertex, or `NONE`.
    pub fn at(&self, vertex: u32) -> u32 {
        self.at[vertex as usize]
    }

    /// For every vertex the sum of the normals around it.
    pub fn vertex_normals(&self) -> Vec<Vec3> {
        let mut normals = vec![Vec3::ZERO; self.positions.len()];
        for (triangle, &normal) in self.triangles.iter().zip(&self.normals) {
            triangle.iter().for_each(|&vertex| normals[vertex as usize] += normal);
        }
        normals
    }

    /// The triangles around a vertex, all of one fan.
    pub fn star(&self, vertex: u32) -> impl Iterator<Item = u32> {
        let beside = move |triangle: u32, turn: usize| {
            self.across[triangle as usize][(self.corner(triangle, vertex) + turn) % 3]
        };
        let start = self.at[vertex as usize];
        let (mut next, mut turn) = (start, 0);
        std::iter::from_fn(move || {
            let triangle = (next != NONE).then_some(next)?;
            next = beside(triangle, turn);
            if next == start {
                next = NONE;
            } else if next == NONE && turn == 0 {
                turn = 2;
                next = beside(start, turn);
            }
            Some(triangle)
        })
    }

    /// The triangle around a vertex that lies towards `point`, if one does, or else any; `NONE` where there is none.
    pub fn towards(&self, vertex: u32, point: Vec3) -> u32 {
        let start = self.positions[vertex as usize];
        let is_towards = |&triangle: &u32| {
            let corners = self.triangles[triangle as usize];
            let corner = self.corner(triangle, vertex);
            let [a, b] = [1, 2].map(|turn| self.positions[corners[(corner + turn) % 3] as usize] - start);
            let normal = self.normal(triangle);
            normal.cross(a).dot(point - start) >= 0.0 && normal.cross(b).dot(point - start) <= 0.0
        };
        self.star(vertex).find(is_towards).unwrap_or(self.at(vertex))
    }

    /// Whether a triangle is within a distance, squared, of a point.
    pub fn is_near(&self, triangle: u32, point: Vec3, squared: f32) -> bool {
        squared_near(point, self.corners(triangle), self.normal(triangle), squared).is_some()
    }

    /// The corner of a triangle after one of its corners.
    pub fn after(&self, triangle: u32, vertex: u32) -> u32 {
        self.triangles[triangle as usize][(self.corner(triangle, vertex) + 1) % 3]
    }

    /// A triangle within `distance` of `point` that does not face the other way than `normal`, if one is found from
    /// triangle `from` on: of a thin sheet's two sides each has to be near its own. Looks towards the point, and at all
    /// that hang together within the distance of it, until patience ends.
    pub fn holder(&self, from: u32, point: Vec3, normal: Vec3, distance: f32) -> Option<u32> {
        let mut seen = [(NONE, 0.0); PATIENCE];
        let mut count = 0;
        let mut least = f32::INFINITY;
        let mut next = [from, NONE, NONE];
        // Those before `done` have been gone on from.
        for done in 0..PATIENCE {
            for triangle in next {
                if triangle == NONE || seen[..count].iter().any(|(other, _)| *other == triangle) {
                    continue;
                }
                let squared = self.squared_distance(triangle, point);
                if squared <= distance * distance && self.normal(triangle).dot(normal) >= 0.0 {
                    return Some(triangle);
                }
                if count == PATIENCE {
                    return None;
                }
                seen[count] = (triangle, squared);
                count += 1;
                least = least.min(squared);
            }
            let best = (done..count).min_by(|&a, &b| seen[a].1.total_cmp(&seen[b].1))?;
            if seen[best].1 > (DETOUR * least).max(distance * distance) {
                return None;
            }
            seen.swap(done, best);
            next = self.across[seen[done].0 as usize];
        }
        None
    }

    fn squared_distance(&self, triangle: u32, point: Vec3) -> f32 {
        let near = squared_near(point, self.corners(triangle), self.normal(triangle), f32::INFINITY);
        near.map_or(f32::INFINITY, |(squared, _)| squared)
    }

    /// Whether one can walk on the surface from one of its vertices to another, in the plane of `normal` and the line
    /// between them, within `distance` of that line and on triangles that do not face the other way.
    pub fn leads(&self, from: u32, to: u32, normal: Vec3, distance: f32) -> bool {
        let start = self.positions[from as usize];
        let ahead = self.positions[to as usize] - start;
        let (leftward, length) = (normal.cross(ahead), ahead.length_squared());
        let seen = |vertex: u32| {
            let offset = self.positions[vertex as usize] - start;
            (vertex, offset, leftward.dot(offset))
        };
        let crossing = |a: Vec3, right: f32, b: Vec3, left: f32| a + (b - a) * (right / (right - left));
        // The triangle that one is in, and the ends of the edge that one leaves it by.
        let mut way = None;
        for triangle in self.star(from) {
            let corner = self.corner(triangle, from);
            let [a, b] = [1, 2].map(|turn| self.triangles[triangle as usize][(corner + turn) % 3]);
            if a == to || b == to {
                return true;
            }
            let (a, b) = (seen(a), seen(b));
            if a.2 < 0.0 && b.2 >= 0.0 && crossing(a.1, a.2, b.1, b.2).dot(ahead) > 0.0 {
                way = Some((triangle, a, b));
            }
        }
        let Some((mut triangle, mut a, mut b)) = way else { return false };
        let steps = STEPS_A_CELL * length.sqrt() + STEPS_A_CELL;
        for _ in 0..steps as usize {
            let offset = crossing(a.1, a.2, b.1, b.2);
            let along = (offset.dot(ahead) / length).clamp(0.0, 1.0);
            if offset.distance_squared(along * ahead) > distance * distance
                || self.normal(triangle).dot(normal) < 0.0
            {
                return false;
            }
            triangle = self.across_from(triangle, a.0);
            if triangle == NONE {
                return false;
            }
            let beyond = self.after(triangle, a.0);
            if beyond == to {
                return true;
            }
            let beyond = seen(beyond);
            *(if beyond.2 >= 0.0 { &mut b } else { &mut a }) = beyond;
        }
        false
    }

    /// The edges of a triangle that have no other triangle.
    pub fn open_edges(&self, triangle: u32) -> impl Iterator<Item = [u32; 2]> {
        let edges = edges(self.triangles[triangle as usize]).into_iter();
        edges.zip(self.across[triangle as usize]).filter(|(_, across)| *across == NONE).map(|(edge, _)| edge)
    }

    /// The triangles around a vertex inside of the patch, counterclockwise.
    pub fn spokes(&self, vertex: u32) -> impl Iterator<Item = Spoke> {
        let start = self.at[vertex as usize];
        let mut next = start;
        std::iter::from_fn(move || {
            let triangle = (next != NONE).then_some(next)?;
            let corner = self.corner(triangle, vertex);
            next = self.across[triangle as usize][(corner + 2) % 3];
            if next == start {
                next = NONE;
            }
            let rim = self.triangles[triangle as usize][(corner + 1) % 3];
            Some(Spoke { triangle, rim, normal: self.normals[triangle as usize] })
        })
    }

    /// Which of a triangle's corners this vertex is.
    fn corner(&self, triangle: u32, vertex: u32) -> usize {
        let [a, b, _] = self.triangles[triangle as usize];
        if a == vertex {
            0
        } else if b == vertex {
            1
        } else {
            2
        }
    }

    /// The triangle across the edge that leaves `vertex`, or `NONE`.
    pub fn across_from(&self, triangle: u32, vertex: u32) -> u32 {
        self.across[triangle as usize][self.corner(triangle, vertex)]
    }

    fn set_across(&mut self, triangle: u32, vertex: u32, to: u32) {
        if triangle != NONE {
            let side = self.corner(triangle, vertex);
            self.across[triangle as usize][side] = to;
        }
    }

    /// Moves a vertex onto the first one of the ring around it. The ring's first and last triangle vanish.
    pub fn collapse(&mut self, vertex: u32, ring: &[Spoke]) {
        let last = ring.len() - 1;
        let (target, [left, right]) = (ring[0].rim, [ring[last].rim, ring[1].rim]);
        let beyond_left = self.across_from(ring[last].triangle, left);
        let beyond_right = self.across_from(ring[0].triangle, target);
        for spoke in &ring[1..last] {
            let corner = self.corner(spoke.triangle, vertex);
            self.triangles[spoke.triangle as usize][corner] = target;
            self.normals[spoke.triangle as usize] =
                scaled_normal(self.positions, self.triangles[spoke.triangle as usize]);
        }
        let [rightmost, leftmost] = [ring[1].triangle, ring[last - 1].triangle];
        self.set_across(rightmost, target, beyond_right);
        self.set_across(beyond_right, right, rightmost);
        self.set_across(leftmost, left, beyond_left);
        self.set_across(beyond_left, target, leftmost);
        for spoke in [ring[0], ring[last]] {
            self.triangles[spoke.triangle as usize] = [NONE; 3];
        }
        self.at[vertex as usize] = NONE;
        self.at[target as usize] = rightmost;
        self.at[right as usize] = rightmost;
        self.at[left as usize] = leftmost;
    }

    /// Undoes what `collapse` did.
    pub fn restore(&mut self, vertex: u32, ring: &[Spoke]) {
        let last = ring.len() - 1;
        let (target, [left, right]) = (ring[0].rim, [ring[last].rim, ring[1].rim]);
        let [rightmost, leftmost] = [ring[1].triangle, ring[last - 1].triangle];
        let beyond_right = self.across_from(rightmost, target);
        let beyond_left = self.across_from(leftmost, left);
        self.set_across(beyond_right, right, ring[0].triangle);
        self.set_across(beyond_left, target, ring[last].triangle);
        self.set_across(rightmost, target, ring[0].triangle);
        self.set_across(leftmost, left, ring[last].triangle);
        for spoke in &ring[1..last] {
            let corner = self.corner(spoke.triangle, target);
            self.triangles[spoke.triangle as usize][corner] = vertex;
            self.normals[spoke.triangle as usize] = spoke.normal;
        }
        self.put(ring[0].triangle, [vertex, target, right], [ring[last].triangle, beyond_right, rightmost]);
        self.put(ring[last].triangle, [vertex, left, target], [leftmost, beyond_left, ring[0].triangle]);
        self.at[vertex as usize] = ring[0].triangle;
        self.at[target as usize] = ring[0].triangle;
        self.at[right as usize] = ring[0].triangle;
        self.at[left as usize] = ring[last].triangle;
    }

    fn put(&mut self, triangle: u32, corners: [u32; 3], across: [u32; 3]) {
        self.triangles[triangle as usize] = corners;
        self.across[triangle as usize] = across;
    }
}

/// Outward, twice the triangle's area long.
fn scaled_normal(positions: &[Vec3], triangle: [u32; 3]) -> Vec3 {
    let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
    (b - a).cross(c - a)
}

fn edges([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// The squared distance from a point to a triangle with this normal, if it is not above the one given; and whether the
/// point is right above or below.
#[inline]
pub fn squared_near(p: Vec3, corners: [Vec3; 3], normal: Vec3, squared: f32) -> Option<(f32, bool)> {
    let [a, b, c] = corners.map(|corner| corner - p);
    let (height, length) = (a.dot(normal), normal.length_squared());
    if height * height > squared * length {
        return None;
    }
    let mut least = f32::INFINITY;
    for [from, to] in [[a, b], [b, c], [c, a]] {
        // Beyond this side.
        if from.cross(to).dot(normal) <= 0.0 {
            let ahead = to - from;
            let along = (-from.dot(ahead) / ahead.length_squared()).clamp(0.0, 1.0);
            least = least.min((from + ahead * along).length_squared());
        }
    }
    if least == f32::INFINITY {
        return Some((height * height / length, true));
    }
    (least <= squared).then_some((least, false))
}
