//! The triangles of a patch with their neighbours, for local changes and distance searches.
//!
//! There is no spatial index. Searches start from a known nearby triangle.

use glam::{Vec3A, Vec3Swizzles};

/// Stands for a missing triangle or vertex.
pub const NONE: u32 = u32::MAX;
/// For each corner of a triangle, the index of the next corner.
const NEXT: [usize; 3] = [1, 2, 0];
const PREVIOUS: [usize; 3] = [2, 0, 1];
/// Maximum number of triangles that a search visits before it gives up.
const MOST_VISITED: usize = 32;
/// A search continues from a triangle whose squared distance is at most this many times the
/// smallest squared distance found so far.
const DETOUR: f32 = 1.5;
/// Maximum number of triangles that a path crosses per cell of its length.
const STEPS_PER_CELL: f32 = 8.0;

/// Triangles in which each directed edge occurs at most once.
#[derive(Clone)]
pub struct EditableMesh<'a> {
    pub positions: &'a [Vec3A],
    pub triangles: Vec<[u32; 3]>,
    /// For each triangle, its neighbours: first the one across the edge from its first corner to
    /// the second, and so on.
    across: Vec<[u32; 3]>,
    /// For each vertex, its state. If the vertex is on the border, the state refers to the first of
    /// the vertex's triangles in counter-clockwise order.
    states: Vec<VertexState>,
    /// The outward unit normals of the triangles.
    normals: Vec<Vec3A>,
}

/// The state of a vertex: it is a corner of a triangle, it was removed (and then has a closest
/// triangle), or it is unused.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct VertexState(u32);

impl VertexState {
    pub const UNUSED: Self = Self(NONE);
    const REMOVED: u32 = 1 << 31;
    const FAR: u32 = 1 << 30;

    fn corner(triangle: u32) -> Self {
        Self(triangle)
    }

    pub fn removed(closest: u32, is_close: bool) -> Self {
        Self(closest | Self::REMOVED | if is_close { 0 } else { Self::FAR })
    }

    /// A triangle at the vertex, or the closest triangle of a removed vertex.
    pub fn triangle(self) -> u32 {
        self.0 & !(Self::REMOVED | Self::FAR)
    }

    pub fn is_removed(self) -> bool {
        self.0 & Self::REMOVED != 0
    }

    /// Whether a removed vertex is close to its closest triangle. On a flat surface, the segment
    /// between two close vertices needs no check.
    pub fn is_close(self) -> bool {
        self.0 & Self::FAR == 0
    }
}

/// A triangle around a vertex, the triangle's corner after the vertex, and the triangle's normal.
#[derive(Clone, Copy)]
pub struct Incident {
    pub triangle: u32,
    pub rim: u32,
    pub normal: Vec3A,
}

/// The edges of a surface, grouped by the vertices at which they start.
pub struct OutgoingEdges {
    /// For each vertex, the end of its range in `edges`.
    ends: Vec<u32>,
    edges: Vec<HalfEdge>,
}

/// An edge, seen from its start.
#[derive(Clone, Copy, Default)]
pub struct HalfEdge {
    pub to: u32,
    /// The third corner of the edge's triangle.
    pub before: u32,
    /// The index of the edge among the sides of all triangles.
    side: u32,
}

impl OutgoingEdges {
    /// Lists the edges of all triangles by their start.
    pub fn of(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let mut ends = vec![0_u32; vertices];
        for &vertex in triangles.as_flattened() {
            ends[vertex as usize] += 1;
        }
        let mut total = 0;
        for end in &mut ends {
            total += std::mem::replace(end, total);
        }
        let mut outgoing = vec![HalfEdge::default(); 3 * triangles.len()];
        for (side, [a, b, c]) in (0..).step_by(3).zip(triangles.iter().copied()) {
            for (from, edge) in [
                (a, HalfEdge { to: b, before: c, side }),
                (b, HalfEdge { to: c, before: a, side: side + 1 }),
                (c, HalfEdge { to: a, before: b, side: side + 2 }),
            ] {
                let end = &mut ends[from as usize];
                outgoing[*end as usize] = edge;
                *end += 1;
            }
        }
        Self { ends, edges: outgoing }
    }

    /// The edges that start at a vertex.
    pub fn at(&self, vertex: u32) -> &[HalfEdge] {
        let start = vertex.checked_sub(1).map_or(0, |before| self.ends[before as usize]);
        &self.edges[start as usize..self.ends[vertex as usize] as usize]
    }
}

impl<'a> EditableMesh<'a> {
    /// Finds the neighbours of all triangles from the edges. Each directed edge must occur only
    /// once.
    pub fn new(positions: &'a [Vec3A], triangles: Vec<[u32; 3]>, outgoing: &OutgoingEdges) -> Self {
        let normals = triangles
            .iter()
            .map(|&t| scaled_normal(corners(positions, t)).normalize_or_zero())
            .collect();
        let mut across = vec![[NONE; 3]; triangles.len()];
        let mut states = vec![VertexState::UNUSED; positions.len()];
        // For each vertex, the end and the triangle of the latest edge that was found to start at
        // this vertex.
        let mut slots = vec![(NONE, NONE); positions.len()];
        for vertex in 0..positions.len() as u32 {
            let edges = outgoing.at(vertex);
            edges.iter().for_each(|edge| slots[edge.before as usize] = (vertex, edge.side / 3));
            let mut first = edges.first();
            for edge in edges {
                let (to, beyond) = slots[edge.to as usize];
                if to == vertex {
                    across.as_flattened_mut()[edge.side as usize] = beyond;
                } else {
                    first = Some(edge);
                }
            }
            states[vertex as usize] =
                first.map_or(VertexState::UNUSED, |edge| VertexState::corner(edge.side / 3));
        }
        Self { positions, triangles, across, states, normals }
    }

    pub fn corners(&self, triangle: u32) -> [Vec3A; 3] {
        corners(self.positions, self.triangles[triangle as usize])
    }

    pub fn normal(&self, triangle: u32) -> Vec3A {
        self.normals[triangle as usize]
    }

    pub fn state(&self, vertex: u32) -> VertexState {
        self.states[vertex as usize]
    }

    /// The normal of the triangle to which the state of a vertex refers; `None` for an unused
    /// vertex.
    pub fn normal_of(&self, state: VertexState) -> Option<Vec3A> {
        self.normals.get(state.triangle() as usize).copied()
    }

    /// Sets the state of a removed vertex.
    pub fn set_state(&mut self, vertex: u32, state: VertexState) {
        self.states[vertex as usize] = state;
    }

    /// Whether a vertex is a corner of a triangle.
    pub fn has_vertex(&self, vertex: u32) -> bool {
        !self.state(vertex).is_removed()
    }

    /// A triangle at `vertex`, which must be a corner of a triangle.
    pub fn at(&self, vertex: u32) -> u32 {
        self.state(vertex).triangle()
    }

    /// For every vertex, the area-weighted sum of the normals of the triangles around it.
    pub fn vertex_normals(&self) -> Vec<Vec3A> {
        let mut normals = vec![Vec3A::ZERO; self.positions.len()];
        for &triangle in &self.triangles {
            let normal = scaled_normal(corners(self.positions, triangle));
            triangle.iter().for_each(|&vertex| normals[vertex as usize] += normal);
        }
        normals
    }

    /// The triangles around a vertex, in one fan, in counter-clockwise order.
    pub fn star(&self, vertex: u32) -> impl Iterator<Item = u32> {
        self.incident(vertex).map(|incident| incident.triangle)
    }

    /// The triangle around a vertex in the direction of `point`, or any triangle around the vertex
    /// if no triangle lies in this direction.
    pub fn towards(&self, vertex: u32, point: Vec3A) -> u32 {
        let start = self.positions[vertex as usize];
        let is_towards = |&triangle: &u32| {
            let corners = self.triangles[triangle as usize];
            let corner = self.corner(triangle, vertex);
            let [a, b] = [NEXT[corner], PREVIOUS[corner]];
            let [a, b] = [
                self.positions[corners[a] as usize] - start,
                self.positions[corners[b] as usize] - start,
            ];
            let normal = self.normal(triangle);
            cross(normal, a).dot(point - start) >= 0.0 && cross(normal, b).dot(point - start) <= 0.0
        };
        self.star(vertex).find(is_towards).unwrap_or(self.at(vertex))
    }

    /// Whether the squared distance of a triangle from a point is at most `squared`.
    pub fn is_near(&self, triangle: u32, point: Vec3A, squared: f32) -> bool {
        squared_near(point, self.corners(triangle), self.normal(triangle), squared).is_some()
    }

    /// A triangle within `distance` of `point` whose normal does not oppose `normal`, and its
    /// squared distance, if a search from triangle `from` finds one. The condition on the normals
    /// separates the two sides of a thin sheet. The search goes towards the point, and then visits
    /// connected triangles within the distance, up to a maximum number.
    pub fn near_triangle(
        &self,
        from: u32,
        point: Vec3A,
        normal: Vec3A,
        distance: f32,
    ) -> Option<(u32, f32)> {
        let mut visited = [(NONE, 0.0); MOST_VISITED];
        let mut count = 0;
        let mut least = f32::INFINITY;
        let mut next = [from, NONE, NONE];
        // The neighbours of the triangles before index `expanded` have been visited.
        for expanded in 0..MOST_VISITED {
            for triangle in next {
                if triangle == NONE || visited[..count].iter().any(|(other, _)| *other == triangle)
                {
                    continue;
                }
                let squared = self.squared_distance(triangle, point);
                if squared <= distance * distance && self.normal(triangle).dot(normal) >= 0.0 {
                    return Some((triangle, squared));
                }
                if count == MOST_VISITED {
                    return None;
                }
                visited[count] = (triangle, squared);
                count += 1;
                least = least.min(squared);
            }
            let best = (expanded..count).min_by(|&a, &b| visited[a].1.total_cmp(&visited[b].1))?;
            if visited[best].1 > (DETOUR * least).max(distance * distance) {
                return None;
            }
            visited.swap(expanded, best);
            next = self.across[visited[expanded].0 as usize];
        }
        None
    }

    fn squared_distance(&self, triangle: u32, point: Vec3A) -> f32 {
        let near =
            squared_near(point, self.corners(triangle), self.normal(triangle), f32::INFINITY);
        near.map_or(f32::INFINITY, |(squared, _)| squared)
    }

    /// Whether a path on the surface joins two vertices that are not adjacent. The path is in the
    /// plane that contains `normal` and the line between the vertices. It stays within `distance`
    /// of this line, and crosses no triangle whose normal opposes `normal`.
    pub fn has_straight_path(&self, from: u32, to: u32, normal: Vec3A, distance: f32) -> bool {
        let start = self.positions[from as usize];
        let ahead = self.positions[to as usize] - start;
        let (leftward, length) = (cross(normal, ahead), ahead.length_squared());
        let shrink = length.recip();
        let with_offset = |vertex: u32| {
            let offset = self.positions[vertex as usize] - start;
            (vertex, offset, leftward.dot(offset))
        };
        let crossing =
            |a: Vec3A, right: f32, b: Vec3A, left: f32| a + (b - a) * (right / (right - left));
        // The current triangle, the side through which the path leaves it, and the ends of that
        // side.
        let mut first_crossing = None;
        let mut before = None;
        for triangle in self.star(from) {
            let corners = self.triangles[triangle as usize];
            let corner = self.corner(triangle, from);
            let a = before.unwrap_or_else(|| with_offset(corners[NEXT[corner]]));
            let b = with_offset(corners[PREVIOUS[corner]]);
            if a.2 < 0.0 && b.2 >= 0.0 && crossing(a.1, a.2, b.1, b.2).dot(ahead) > 0.0 {
                first_crossing = Some((triangle, NEXT[corner], [a, b]));
                break;
            }
            before = Some(b);
        }
        let Some((mut triangle, mut side, mut ends)) = first_crossing else { return false };
        let steps = STEPS_PER_CELL * length.sqrt() + STEPS_PER_CELL;
        for _ in 0..steps as usize {
            let [(a, offset, right), (_, left_offset, left)] = ends;
            let offset = crossing(offset, right, left_offset, left);
            let along = (offset.dot(ahead) * shrink).clamp(0.0, 1.0);
            if offset.distance_squared(along * ahead) > distance * distance
                || self.normal(triangle).dot(normal) < 0.0
            {
                return false;
            }
            triangle = self.across[triangle as usize][side];
            if triangle == NONE {
                return false;
            }
            let corner = self.corner(triangle, a);
            let beyond = self.triangles[triangle as usize][NEXT[corner]];
            if beyond == to {
                return true;
            }
            let beyond = with_offset(beyond);
            let is_left = usize::from(beyond.2 >= 0.0);
            ends[is_left] = beyond;
            side = [NEXT[corner], corner][is_left];
        }
        false
    }

    /// The edges of a triangle that no other triangle shares.
    pub fn open_edges(&self, triangle: u32) -> impl Iterator<Item = [u32; 2]> {
        let edges = edges(self.triangles[triangle as usize]).into_iter();
        edges
            .zip(self.across[triangle as usize])
            .filter(|(_, across)| *across == NONE)
            .map(|(edge, _)| edge)
    }

    /// The patch's triangles around a vertex, in counter-clockwise order.
    pub fn incident(&self, vertex: u32) -> impl Iterator<Item = Incident> {
        let state = self.state(vertex);
        let start = if state.is_removed() { NONE } else { state.triangle() };
        let mut next = start;
        std::iter::from_fn(move || {
            let triangle = (next != NONE).then_some(next)?;
            let corner = self.corner(triangle, vertex);
            next = self.across[triangle as usize][PREVIOUS[corner]];
            if next == start {
                next = NONE;
            }
            let rim = self.triangles[triangle as usize][NEXT[corner]];
            Some(Incident { triangle, rim, normal: self.normals[triangle as usize] })
        })
    }

    /// The index of `vertex` among a triangle's corners.
    fn corner(&self, triangle: u32, vertex: u32) -> usize {
        // There are no branches here, because they would be unpredictable.
        let [_, b, c] = self.triangles[triangle as usize];
        usize::from(b == vertex) + 2 * usize::from(c == vertex)
    }

    /// The neighbouring triangles, or `NONE`.
    pub fn neighbours(&self, triangle: u32) -> [u32; 3] {
        self.across[triangle as usize]
    }

    /// The triangle across the edge that starts at `vertex`, or `NONE`.
    pub fn across_from(&self, triangle: u32, vertex: u32) -> u32 {
        self.across[triangle as usize][self.corner(triangle, vertex)]
    }

    fn set_across(&mut self, triangle: u32, vertex: u32, to: u32) {
        if triangle != NONE {
            let side = self.corner(triangle, vertex);
            self.across[triangle as usize][side] = to;
        }
    }

    /// Moves a vertex onto the first vertex of its ring. The ring's first and last triangle vanish;
    /// the other triangles take the new `normals`.
    pub fn collapse(
        &mut self,
        vertex: u32,
        ring: &[Incident],
        normals: impl Iterator<Item = Vec3A>,
    ) {
        let last = ring.len() - 1;
        let (target, [left, right]) = (ring[0].rim, [ring[last].rim, ring[1].rim]);
        let beyond_left = self.across_from(ring[last].triangle, left);
        let beyond_right = self.across_from(ring[0].triangle, target);
        for (incident, normal) in ring[1..last].iter().zip(normals) {
            let corner = self.corner(incident.triangle, vertex);
            self.triangles[incident.triangle as usize][corner] = target;
            self.normals[incident.triangle as usize] = normal;
        }
        let [rightmost, leftmost] = [ring[1].triangle, ring[last - 1].triangle];
        self.set_across(rightmost, target, beyond_right);
        self.set_across(beyond_right, right, rightmost);
        self.set_across(leftmost, left, beyond_left);
        self.set_across(beyond_left, target, leftmost);
        for incident in [ring[0], ring[last]] {
            self.triangles[incident.triangle as usize] = [NONE; 3];
        }
        // A border vertex keeps its first triangle. If this triangle vanishes, the vertex takes the
        // triangle that replaces it.
        for (vertex, to) in [(target, rightmost), (right, rightmost), (left, leftmost)] {
            let at = self.at(vertex);
            let is_removed = (at == ring[0].triangle) | (at == ring[last].triangle);
            self.states[vertex as usize] = VertexState::corner(if is_removed { to } else { at });
        }
    }

    /// Undoes `collapse`.
    pub fn restore(&mut self, vertex: u32, ring: &[Incident]) {
        let last = ring.len() - 1;
        let (target, [left, right]) = (ring[0].rim, [ring[last].rim, ring[1].rim]);
        let [rightmost, leftmost] = [ring[1].triangle, ring[last - 1].triangle];
        let beyond_right = self.across_from(rightmost, target);
        let beyond_left = self.across_from(leftmost, left);
        self.set_across(beyond_right, right, ring[0].triangle);
        self.set_across(beyond_left, target, ring[last].triangle);
        self.set_across(rightmost, target, ring[0].triangle);
        self.set_across(leftmost, left, ring[last].triangle);
        for incident in &ring[1..last] {
            let corner = self.corner(incident.triangle, target);
            self.triangles[incident.triangle as usize][corner] = vertex;
            self.normals[incident.triangle as usize] = incident.normal;
        }
        self.put(
            ring[0].triangle,
            [vertex, target, right],
            [ring[last].triangle, beyond_right, rightmost],
        );
        self.put(
            ring[last].triangle,
            [vertex, left, target],
            [leftmost, beyond_left, ring[0].triangle],
        );
        self.states[vertex as usize] = VertexState::corner(ring[0].triangle);
        for (vertex, at, to) in
            [(target, rightmost, ring[0].triangle), (left, leftmost, ring[last].triangle)]
        {
            if self.at(vertex) == at {
                self.states[vertex as usize] = VertexState::corner(to);
            }
        }
    }

    fn put(&mut self, triangle: u32, corners: [u32; 3], across: [u32; 3]) {
        self.triangles[triangle as usize] = corners;
        self.across[triangle as usize] = across;
    }
}

/// The cross product, with the same rounding on every processor. On ARM, the cross product of
/// [`Vec3A`] uses fused operations.
pub fn cross(a: Vec3A, b: Vec3A) -> Vec3A {
    (a.zxy() * b - a * b.zxy()).zxy()
}

/// The outward normal, with a length of twice the triangle's area.
pub fn scaled_normal([a, b, c]: [Vec3A; 3]) -> Vec3A {
    cross(b - a, c - a)
}

/// The positions of a triangle's corners. `map` would be slower here.
fn corners(positions: &[Vec3A], [a, b, c]: [u32; 3]) -> [Vec3A; 3] {
    [positions[a as usize], positions[b as usize], positions[c as usize]]
}

fn edges([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// The squared distance from a point to a triangle with this unit normal, if it is at most
/// `squared`; and whether the point's projection is inside the triangle.
#[inline]
pub fn squared_near(
    p: Vec3A,
    corners: [Vec3A; 3],
    normal: Vec3A,
    squared: f32,
) -> Option<(f32, bool)> {
    let [a, b, c] = [corners[0] - p, corners[1] - p, corners[2] - p];
    let height = a.dot(normal);
    if height * height > squared {
        return None;
    }
    let mut least = f32::INFINITY;
    for [from, to] in [[a, b], [b, c], [c, a]] {
        // True if the projection of the point is outside this side.
        if cross(from, to).dot(normal) <= 0.0 {
            let ahead = to - from;
            let along = (-from.dot(ahead) / ahead.length_squared()).clamp(0.0, 1.0);
            least = least.min((from + ahead * along).length_squared());
        }
    }
    if least == f32::INFINITY {
        return Some((height * height, true));
    }
    (least <= squared).then_some((least, false))
}

/// The triangles around a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surroundings {
    /// Triangles from marching cubes: each lies in one dual cell.
    DualCells,
    /// Triangles of any size.
    Simplified,
}

impl Surroundings {
    fn may_join(self, p: Vec3A, q: Vec3A) -> bool {
        match self {
            Self::Simplified => true,
            Self::DualCells => {
                // A dual cell reaches from the centre of a cell to the centre of the next cell.
                // `slack` allows for the rounding of positions.
                let slack = 1e-3;
                let [lo, hi] = [p.min(q) - 0.5, p.max(q) - 0.5];
                hi.cmple((lo + slack).floor() + (1.0 + slack)).all()
            }
        }
    }
}

/// The topology that a patch must keep.
pub struct PatchTopology {
    /// For each vertex, whether it is on the border, where other patches may use it too.
    pub border: Vec<bool>,
    /// For each vertex, whether it is on the border and its triangles form more than one fan.
    pinched: Vec<bool>,
    outside: Surroundings,
}

impl PatchTopology {
    /// Examines an oriented patch that is manifold except for its border.
    pub fn of(patch: &EditableMesh, outside: Surroundings) -> Self {
        let mut fans = vec![0_u8; patch.positions.len()];
        for triangle in 0..patch.triangles.len() as u32 {
            for [from, _] in patch.open_edges(triangle) {
                fans[from as usize] += 1;
            }
        }
        let with = |least: u8| fans.iter().map(|&count| count >= least).collect();
        Self { border: with(1), pinched: with(2), outside }
    }

    /// Whether the triangles around a vertex form more than one fan.
    pub fn is_pinched(&self, vertex: u32) -> bool {
        self.pinched[vertex as usize]
    }

    /// Whether an edge outside the patch may join two vertices.
    pub fn is_chord(&self, patch: &EditableMesh, a: u32, b: u32) -> bool {
        let [p, q] = [a, b].map(|vertex| patch.positions[vertex as usize]);
        self.border[a as usize] && self.border[b as usize] && self.outside.may_join(p, q)
    }
}
