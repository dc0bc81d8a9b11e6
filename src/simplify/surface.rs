//! A patch's triangles with their neighbours, to be changed one by one, and to be measured against.
//!
//! Nothing is looked up by place. What is asked lies near a triangle that is known, and is searched for from there.

use glam::Vec3;

/// No triangle.
pub const NONE: u32 = u32::MAX;
/// How many triangles a search looks at before it gives up.
const PATIENCE: usize = 32;
/// It goes on from a triangle whose squared distance is so many times the least so far.
const DETOUR: f32 = 1.5;
/// Nor does one walk farther than so many triangles for a cell.
const STEPS_A_CELL: f32 = 8.0;

/// Triangles, each directed edge at most once.
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

impl<'a> Surface<'a> {
    /// Where directed edges occur twice, their vertices.
    pub fn new(positions: &'a [Vec3], triangles: Vec<[u32; 3]>) -> Result<Self, Vec<u32>> {
        let (across, at) = neighbours(positions.len(), &triangles)?;
        let normals: Vec<Vec3> =
            triangles.iter().map(|&triangle| scaled_normal(positions, triangle)).collect();
        Ok(Self { positions, triangles, across, at, normals })
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

    /// Of its triangles.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
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
            let corners = self.triangles[triangle as usize];
            let corner = corners.iter().position(|&corner| corner == vertex).expect("a corner of each");
            self.across[triangle as usize][(corner + turn) % 3]
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
            let corner = corners.iter().position(|&corner| corner == vertex).unwrap_or_default();
            let [a, b] = [1, 2].map(|turn| self.positions[corners[(corner + turn) % 3] as usize] - start);
            let normal = self.normal(triangle);
            normal.cross(a).dot(point - start) >= 0.0 && normal.cross(b).dot(point - start) <= 0.0
        };
        self.star(vertex).find(is_towards).unwrap_or(self.at(vertex))
    }

    /// Looks at triangles towards `point`, from triangle `from` on, and at all that hang together within `distance`
    /// of it, until `is_found` says so or patience ends.
    fn search(&self, from: u32, point: Vec3, distance: f32, mut is_found: impl FnMut(u32, f32) -> bool) {
        if from == NONE {
            return;
        }
        let mut seen = [(0, 0.0); PATIENCE];
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
                if is_found(triangle, squared) || count == PATIENCE {
                    return;
                }
                seen[count] = (triangle, squared);
                count += 1;
                least = least.min(squared);
            }
            let Some(best) = (done..count).min_by(|&a, &b| seen[a].1.total_cmp(&seen[b].1)) else { return };
            if seen[best].1 > (DETOUR * least).max(distance * distance) {
                return;
            }
            seen.swap(done, best);
            next = self.across[seen[done].0 as usize];
        }
    }

    /// What a search for `point` finds.
    pub fn around(&self, from: u32, point: Vec3, distance: f32) -> Vec<u32> {
        let mut around = Vec::new();
        self.search(from, point, distance, |triangle, _| {
            around.push(triangle);
            false
        });
        around
    }

    /// Of a triangle from a point.
    pub fn squared_distance(&self, triangle: u32, point: Vec3) -> f32 {
        closest(point, self.corners(triangle)).0
    }

    /// A triangle within `distance` of `point` that does not face the other way than `normal`, if one is found from
    /// triangle `from` on: of a thin sheet's two sides each has to be near its own.
    pub fn holder(&self, from: u32, point: Vec3, normal: Vec3, distance: f32) -> Option<u32> {
        let mut holder = None;
        self.search(from, point, distance, |triangle, squared| {
            let holds = squared <= distance * distance && self.normal(triangle).dot(normal) >= 0.0;
            holder = holds.then_some(triangle);
            holds
        });
        holder
    }

    /// Of the triangles around `point` that do not face the other way the nearest, and the barycentric coordinates of
    /// its nearest point.
    pub fn nearest(&self, from: u32, point: Vec3, normal: Vec3, distance: f32) -> Option<(u32, [f32; 3])> {
        let mut nearest: Option<(u32, f32)> = None;
        self.search(from, point, distance, |triangle, squared| {
            let is_nearer = nearest.is_none_or(|(_, least)| squared < least);
            if is_nearer && self.normal(triangle).dot(normal) >= 0.0 {
                nearest = Some((triangle, squared));
            }
            false
        });
        nearest.map(|(triangle, _)| (triangle, closest(point, self.corners(triangle)).1))
    }

    /// The number of a triangle, whichever corner comes first.
    pub fn number_of(&self, [a, b, c]: [u32; 3]) -> Option<u32> {
        let turns = [[a, b, c], [b, c, a], [c, a, b]];
        self.star(a).find(|&triangle| turns.contains(&self.triangles[triangle as usize]))
    }

    /// Whether one can walk on the surface from one of its vertices to another, in the plane of `normal` and the line
    /// between them, within `distance` of that line and on triangles that do not face the other way.
    pub fn leads(&self, from: u32, to: u32, normal: Vec3, distance: f32) -> bool {
        let [p, q] = [from, to].map(|vertex| self.positions[vertex as usize]);
        let ahead = q - p;
        self.walk([from, to], normal, |triangle, _, offset| {
            let along = (offset.dot(ahead) / ahead.length_squared()).clamp(0.0, 1.0);
            offset.distance_squared(along * ahead) <= distance * distance
                && self.normal(triangle).dot(normal) >= 0.0
        })
    }

    /// The edges that one crosses on such a walk, each with a triangle.
    pub fn crossing(&self, from: u32, to: u32, normal: Vec3) -> Vec<(u32, [u32; 2])> {
        let mut crossed = Vec::new();
        self.walk([from, to], normal, |triangle, edge, _| {
            crossed.push((triangle, edge));
            true
        });
        crossed
    }

    /// Walks from one vertex towards another, across one edge after the other, as long as `goes_on` with the triangle
    /// that one leaves, the edge and the offset from the start. Whether the other is reached.
    fn walk(
        &self,
        [from, to]: [u32; 2],
        normal: Vec3,
        mut goes_on: impl FnMut(u32, [u32; 2], Vec3) -> bool,
    ) -> bool {
        let start = self.positions[from as usize];
        let ahead = self.positions[to as usize] - start;
        let left = normal.cross(ahead);
        let offset = |vertex: u32| self.positions[vertex as usize] - start;
        let crossing = |[a, b]: [u32; 2]| {
            let [a, b] = [a, b].map(offset);
            let [right, left] = [a, b].map(|end| left.dot(end));
            a.lerp(b, right / (right - left))
        };
        // The triangle that one is in, and the edge that one leaves it by, its right end first.
        let mut way = None;
        for triangle in self.star(from) {
            let corners = self.triangles[triangle as usize];
            let corner = (0..3).find(|&corner| corners[corner] == from).expect("a triangle of its star");
            let edge = [corners[(corner + 1) % 3], corners[(corner + 2) % 3]];
            if edge.contains(&to) {
                return true;
            }
            let [a, b] = edge.map(|end| left.dot(offset(end)));
            if a < 0.0 && b >= 0.0 && crossing(edge).dot(ahead) > 0.0 {
                way = Some((triangle, edge));
            }
        }
        let steps = STEPS_A_CELL * ahead.length() + STEPS_A_CELL;
        for _ in 0..steps as usize {
            let Some((triangle, [a, b])) = way else { return false };
            if !goes_on(triangle, [a, b], crossing([a, b])) {
                return false;
            }
            let Some((pair, [_, beyond])) = self.at_edge(triangle, a, b) else { return false };
            if beyond == to {
                return true;
            }
            let is_left = left.dot(offset(beyond)) >= 0.0;
            way = Some((pair[1], if is_left { [a, beyond] } else { [beyond, b] }));
        }
        false
    }

    /// The two triangles at an edge, and the corners across from it; nothing where there is no such edge in
    /// `triangle`, or it is on the border.
    pub fn at_edge(&self, triangle: u32, from: u32, to: u32) -> Option<([u32; 2], [u32; 2])> {
        let corners = self.triangles.get(triangle as usize)?;
        let side = (0..3).find(|&side| corners[side] == from && corners[(side + 1) % 3] == to)?;
        let across = self.across[triangle as usize][side];
        if across == NONE {
            return None;
        }
        let apex = |triangle: u32| {
            let corners = self.triangles[triangle as usize];
            let apex = corners.into_iter().find(|&vertex| vertex != from && vertex != to);
            apex.expect("a triangle has three corners")
        };
        Some(([triangle, across], [apex(triangle), apex(across)]))
    }

    /// The edges of a triangle that have no other triangle.
    pub fn open_edges(&self, triangle: u32) -> impl Iterator<Item = [u32; 2]> {
        let edges = edges(self.triangles[triangle as usize]).into_iter();
        edges.zip(self.across[triangle as usize]).filter(|(_, across)| *across == NONE).map(|(edge, _)| edge)
    }

    /// The corner of a triangle before one of its corners.
    pub fn before(&self, triangle: u32, vertex: u32) -> u32 {
        let corners = self.triangles[triangle as usize];
        let corner = corners.iter().position(|&corner| corner == vertex).expect("a corner of it");
        corners[(corner + 2) % 3]
    }

    /// Whether a vertex has an edge to another, in the fan that is known of it.
    pub fn joined(&self, vertex: u32, other: u32) -> bool {
        self.star(vertex).any(|triangle| self.triangles[triangle as usize].contains(&other))
    }

    /// Puts `parts` in place of whole triangles with the same rim, unless one of them would fold back. Returns whether
    /// it did; the first parts take the numbers of the whole ones, further ones new numbers.
    pub fn replace(&mut self, whole: &[u32], parts: &[[u32; 3]]) -> Option<Vec<u32>> {
        let before: Vec3 = whole.iter().map(|&number| self.normal(number)).sum();
        if parts.iter().any(|&part| scaled_normal(self.positions, part).dot(before) <= 0.0) {
            return None;
        }
        let mut rim = Vec::new();
        for &number in whole {
            let sides = edges(self.triangles[number as usize]).into_iter().zip(self.across[number as usize]);
            rim.extend(sides.filter(|(_, across)| !whole.contains(across)));
        }
        let added = self.triangles.len() as u32..;
        let numbers: Vec<u32> = whole.iter().copied().chain(added).take(parts.len()).collect();
        for (&number, &part) in numbers.iter().zip(parts) {
            let across = edges(part).map(|edge| {
                let inner = parts.iter().position(|&other| edges(other).contains(&[edge[1], edge[0]]));
                if let Some(inner) = inner {
                    return numbers[inner];
                }
                let (_, outer) =
                    rim.iter().find(|(other, _)| *other == edge).expect("the rim stays the same");
                if *outer != NONE {
                    let sides = edges(self.triangles[*outer as usize]);
                    let side = sides.iter().position(|&side| side == [edge[1], edge[0]]).expect("neighbours");
                    self.across[*outer as usize][side] = number;
                }
                *outer
            });
            let normal = scaled_normal(self.positions, part);
            if let Some(triangle) = self.triangles.get_mut(number as usize) {
                *triangle = part;
                (self.across[number as usize], self.normals[number as usize]) = (across, normal);
            } else {
                self.triangles.push(part);
                self.across.push(across);
                self.normals.push(normal);
            }
            part.into_iter().for_each(|vertex| self.at[vertex as usize] = number);
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

/// What is across the edges of each triangle, and for each vertex a triangle.
#[expect(clippy::type_complexity)]
fn neighbours(vertices: usize, triangles: &[[u32; 3]]) -> Result<(Vec<[u32; 3]>, Vec<u32>), Vec<u32>> {
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
    let at = (0..vertices as u32).map(|vertex| of(vertex).first().map_or(NONE, |(_, triangle)| *triangle));
    Ok((triangles.iter().map(|&triangle| edges(triangle).map(across)).collect(), at.collect()))
}

/// The squared distance from a point to a triangle, and the barycentric coordinates of the nearest point
/// (Ericson, Real-Time Collision Detection, 5.1.5).
#[inline]
fn closest(p: Vec3, [a, b, c]: [Vec3; 3]) -> (f32, [f32; 3]) {
    let found = |weights: [f32; 3]| {
        let nearest = a * weights[0] + b * weights[1] + c * weights[2];
        (p.distance_squared(nearest), weights)
    };
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return found([1.0, 0.0, 0.0]);
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return found([0.0, 1.0, 0.0]);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / (d1 - d3);
        return found([1.0 - v, v, 0.0]);
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return found([0.0, 0.0, 1.0]);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / (d2 - d6);
        return found([1.0 - w, 0.0, w]);
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return found([0.0, 1.0 - w, w]);
    }
    let sum = va + vb + vc;
    found([va / sum, vb / sum, vc / sum])
}
