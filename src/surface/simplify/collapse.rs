//! Collapses edges while the surface stays within the tolerance.
//!
//! Each step moves a vertex onto a neighbour, in order of increasing quadric error (Garland and
//! Heckbert, Surface simplification using quadric error metrics, 1997). Around the vertex, the mesh
//! must stay a 2-manifold (Dey et al., Topology preserving edge contraction, 1999), and no triangle
//! may turn over or become a sliver. The simplified surface and the reference surface must stay
//! within the tolerance of each other.
//!
//! Every removed vertex of the reference has a closest triangle on the simplified surface, within
//! the tolerance. When a collapse replaces triangles, it searches the new triangles for a closest
//! triangle of every vertex whose closest triangle was replaced. If one triangle is close to both
//! ends of a segment, the triangle is also close to the whole segment, because triangles are
//! convex. Segments for which no such triangle is known are bisected.

use glam::{Vec3A, Vec4};

use super::surface::{
    EditableMesh, HalfEdge, Incident, NONE, OutgoingEdges, VertexState, cross, scaled_normal,
    squared_near,
};
use super::surface::{PatchTopology, Surroundings};

/// Samples may be at most this fraction of the tolerance away from the other surface. The rest of
/// the tolerance is reserved for the surface between samples.
const SAMPLE_SHARE: f32 = 0.93;
/// Maximum distance between samples along an edge, in cells.
const SAMPLE_STEP: f32 = 0.5;
/// If a sample is farther away than this fraction of the tolerance, more samples around it are
/// checked.
const UNCERTAIN_SHARE: f32 = 0.4;
/// Number of these additional samples on each side of the sample.
const EXTRA_SAMPLES: i32 = 4;
/// The segment between two vertices is not checked if both vertices are at most this fraction of
/// the tolerance away from their closest triangles, and the cosine between the normals of these
/// triangles is at least `FLAT`.
const CLOSE_SHARE: f32 = 0.75;
const FLAT: f32 = 0.9;
/// If no segment around a removed vertex needed a check, later collapses skip these segments as
/// long as the vertex is close to its closest triangle (`CLOSE_SHARE`), and the cosine between this
/// triangle's normal and `CollapseState::unchecked_normal` is at least this.
const STEADY_COSINE: f32 = 0.98;
/// Maximum number of bisections of a segment.
const HALVINGS: u32 = 4;
/// A vertex is not moved to a place whose root mean square distance from the planes of its quadric
/// is above this fraction of the tolerance.
const QUADRIC_SHARE: f32 = 0.9;
/// Maximum rotation of a triangle in one collapse, as a cosine.
const LEAST_TURN_COSINE: f32 = 0.2;
/// Two triangles fold back on each other if the cosine between their normals is less than this,
/// which corresponds to 170 degrees.
const FOLD_COSINE: f32 = -0.985;
/// A triangle is a sliver if the squared sine of its smallest angle is less than this, which
/// corresponds to 10 degrees.
const SLIVER: f32 = 0.03;
/// Maximum number of triangles in a closed part whose volume is checked in every collapse. Without
/// this check, a part smaller than the tolerance could vanish or turn inside out.
const MOST_CHECKED_TRIANGLES: usize = 16;
/// A collapse must leave at least this fraction of the volume of a part that is checked
/// (`MOST_CHECKED_TRIANGLES`).
const LEAST_VOLUME_SHARE: f32 = 0.5;

/// The reference surface and the limits for the collapses in a patch.
pub struct Measure<'a> {
    pub topology: &'a PatchTopology,
    /// The surface from which the result may deviate by at most the tolerance.
    pub reference: &'a EditableMesh<'a>,
    /// The edges of the reference.
    pub outgoing: &'a OutgoingEdges,
    /// Normals of the reference at all vertices.
    pub normals: &'a [Vec3A],
    /// The tolerance, in cells.
    pub distance: f32,
}

/// For each vertex of `reference` that no triangle of `surface` uses, searches `surface` for a
/// triangle within the tolerance, and stores it as the vertex's closest triangle. Each search
/// starts from a triangle at a neighbouring vertex, or from that vertex's closest triangle.
pub fn find_near_triangles(
    reference: &EditableMesh,
    surface: &mut EditableMesh,
    normals: &[Vec3A],
    distance: f32,
) {
    let lacks = |surface: &EditableMesh, corners: &[u32; 3]| {
        corners.iter().any(|&v| surface.state(v) == VertexState::UNUSED)
    };
    let mut left: Vec<[u32; 3]> =
        reference.triangles.iter().copied().filter(|corners| lacks(surface, corners)).collect();
    let mut found_some = true;
    while std::mem::take(&mut found_some) {
        left.retain(|corners| {
            let Some(&known) =
                corners.iter().find(|&&vertex| surface.state(vertex) != VertexState::UNUSED)
            else {
                return true;
            };
            for &vertex in corners {
                if surface.state(vertex) != VertexState::UNUSED {
                    continue;
                }
                let (place, normal) =
                    (reference.positions[vertex as usize], normals[vertex as usize]);
                let from = match surface.has_vertex(known) {
                    true => surface.towards(known, place),
                    false => surface.at(known),
                };
                if let Some((closest, squared)) =
                    surface.near_triangle(from, place, normal, SAMPLE_SHARE * distance)
                {
                    let is_close = squared <= (CLOSE_SHARE * distance).powi(2);
                    surface.set_state(vertex, VertexState::removed(closest, is_close));
                    found_some = true;
                }
            }
            // A search from another corner might succeed, but each triangle is tried only once.
            false
        });
    }
}

/// A weighted sum of squared distances from planes, in coordinates relative to a vertex. A quadric
/// fits into one cache line.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Quadric {
    /// Columns of a matrix. The last element of the first column is the weight.
    planes: [Vec4; 3],
    /// The last element is the constant term.
    linear: Vec4,
}

impl Quadric {
    const NONE: Self = Self { planes: [Vec4::ZERO; 3], linear: Vec4::ZERO };

    /// The quadric of a plane through the vertex; the length of the normal is the weight.
    fn of_plane(normal: Vec3A) -> Self {
        let weight = normal.length();
        let unit = normal.normalize_or_zero();
        let planes = [
            (normal * unit.x).extend(weight),
            (normal * unit.y).extend(0.0),
            (normal * unit.z).extend(0.0),
        ];
        Self { planes, linear: Vec4::ZERO }
    }

    fn weight(&self) -> f32 {
        self.planes[0].w
    }

    /// The first three elements are the matrix times `offset`.
    fn times(&self, offset: Vec3A) -> Vec4 {
        let [x, y, z] = self.planes;
        x * offset.x + y * offset.y + z * offset.z
    }

    fn at(&self, offset: Vec3A) -> f32 {
        Vec3A::from_vec4(self.times(offset) + 2.0 * self.linear).dot(offset) + self.linear.w
    }

    /// The quadric relative to a vertex at `offset`.
    fn moved(&self, offset: Vec3A) -> Self {
        let linear = self.linear + self.times(offset);
        Self { linear: linear.with_w(self.at(offset).max(0.0)), ..*self }
    }

    fn add(&mut self, other: &Self) {
        self.planes.iter_mut().zip(other.planes).for_each(|(to, from)| *to += from);
        self.linear += other.linear;
    }
}

/// The state of a simplification.
struct CollapseState<'a, 'b> {
    measure: &'b Measure<'a>,
    surface: EditableMesh<'a>,
    /// For each triangle, a linked list of the removed vertices to which it is closest:
    /// `first_removed` has the first vertex of each triangle's list, and `next_removed` the vertex
    /// after each vertex.
    first_removed: Vec<u32>,
    next_removed: Vec<u32>,
    /// For each removed vertex, the normal of its closest triangle if no segment around the vertex
    /// needed a check, and otherwise zero.
    unchecked_normal: Vec<Vec3A>,
    /// Vertices at the other ends of segments that needed a check in the current collapse. After
    /// the collapse, their `unchecked_normal` is set to zero.
    checked_ends: Vec<u32>,
    quadrics: Vec<Quadric>,
    /// For each vertex, the smallest error of moving it onto a neighbour, and this neighbour. The
    /// neighbour is `NONE` if the error must be computed.
    best: Vec<(f32, u32)>,
    /// Vertices whose neighbourhood has changed.
    changed: Vec<u32>,
    is_changed: Vec<bool>,
    ring: Vec<Incident>,
    order: Vec<(f32, u32)>,
    /// The new triangles of a collapse and their normals.
    new_triangles: Vec<([Vec3A; 3], Vec3A)>,
    /// The triangles found so far of the part whose volume is being checked.
    part_triangles: Vec<u32>,
    moved: Vec<MovedVertex>,
    /// For each vertex, the value of `mark` when the vertex was last marked. A vertex counts as
    /// marked if this value equals `mark`, so incrementing `mark` removes all marks.
    marks: Vec<u32>,
    mark: u32,
}

/// A removed vertex, with its closest triangle before and after a collapse.
#[derive(Clone, Copy)]
struct MovedVertex {
    vertex: u32,
    from: VertexState,
    to: VertexState,
    /// The new value of `CollapseState::unchecked_normal` for the vertex.
    unchecked_normal: Vec3A,
}

impl<'a> Measure<'a> {
    /// Collapses edges of `surface`, except at locked vertices.
    pub fn collapse(&self, surface: EditableMesh<'a>, locked: &[bool]) -> EditableMesh<'a> {
        let vertices = surface.positions.len();
        let mut work = CollapseState {
            measure: self,
            first_removed: vec![NONE; surface.triangles.len()],
            next_removed: vec![NONE; vertices],
            unchecked_normal: vec![Vec3A::ZERO; vertices],
            checked_ends: Vec::new(),
            quadrics: vec![Quadric::NONE; vertices],
            best: vec![(f32::INFINITY, NONE); vertices],
            changed: Vec::new(),
            is_changed: vec![false; vertices],
            ring: Vec::new(),
            order: Vec::new(),
            new_triangles: Vec::new(),
            part_triangles: Vec::new(),
            moved: Vec::new(),
            marks: vec![0; vertices],
            mark: 0,
            surface,
        };
        for triangle in 0..work.surface.triangles.len() as u32 {
            let plane = Quadric::of_plane(scaled_normal(work.surface.corners(triangle)));
            for corner in work.surface.triangles[triangle as usize] {
                work.quadrics[corner as usize].add(&plane);
            }
        }
        for vertex in 0..vertices as u32 {
            let state = work.surface.state(vertex);
            if state.is_removed() && state != VertexState::UNUSED {
                work.set_state(vertex, state);
            }
        }
        work.run(locked);
        work.surface
    }

    /// Whether a sample of the edge from `from` to `to` is too far from all triangles of the
    /// reference whose normals do not oppose `normal`.
    fn is_edge_far(&self, from: u32, to: u32, normal: Vec3A) -> bool {
        let (reference, distance) = (self.reference, self.distance);
        let is_next = |edge: &HalfEdge| edge.to == to || edge.before == to;
        if self.outgoing.at(from).iter().any(is_next)
            || reference.has_straight_path(from, to, normal, SAMPLE_SHARE * distance)
        {
            return false;
        }
        let [p, q] = [from, to].map(|vertex| reference.positions[vertex as usize]);
        let steps = ((p.distance(q) / SAMPLE_STEP).ceil() as i32).max(2);
        let at = |fine: i32| p.lerp(q, fine as f32 / (steps * 2 * EXTRA_SAMPLES) as f32);
        let mut last = reference.at(from);
        let mut within = |sample: Vec3A, share: f32| {
            let near_triangle = reference.near_triangle(last, sample, normal, share * distance);
            last = near_triangle.map_or(last, |(near_triangle, _)| near_triangle);
            near_triangle.is_some()
        };
        (1..steps).map(|step| step * 2 * EXTRA_SAMPLES).any(|step| {
            !within(at(step), UNCERTAIN_SHARE)
                && (step - EXTRA_SAMPLES..=step + EXTRA_SAMPLES)
                    .map(at)
                    .any(|sample| !within(sample, SAMPLE_SHARE))
        })
    }
}

impl CollapseState<'_, '_> {
    fn run(&mut self, locked: &[bool]) {
        let limit = (QUADRIC_SHARE * self.measure.distance).powi(2);
        self.changed
            .extend((0..locked.len() as u32).filter(|&vertex| self.surface.has_vertex(vertex)));
        let mut queue: Vec<u64> = Vec::new();
        while !self.changed.is_empty() {
            for i in 0..self.changed.len() {
                let vertex = self.changed[i];
                self.is_changed[vertex as usize] = false;
                if !locked[vertex as usize] && self.surface.has_vertex(vertex) {
                    if self.best[vertex as usize].1 == NONE {
                        self.best[vertex as usize] = self.best_of(vertex);
                    }
                    let (error, _) = self.best[vertex as usize];
                    if error <= limit {
                        // Nonnegative floats have the same order as their bits.
                        queue.push(u64::from(error.max(0.0).to_bits()) << 32 | u64::from(vertex));
                    }
                }
            }
            self.changed.clear();
            queue.sort_unstable();
            for vertex in queue.drain(..).map(|entry| entry as u32) {
                // If this round has changed the vertex's neighbourhood, the vertex waits for the
                // next round, in which it may have a better target.
                if !self.is_changed[vertex as usize] {
                    self.try_vertex(vertex, limit);
                }
            }
        }
    }

    fn position(&self, vertex: u32) -> Vec3A {
        self.surface.positions[vertex as usize]
    }

    fn error(&self, from: u32, to: u32) -> f32 {
        let quadric = &self.quadrics[from as usize];
        quadric.at(self.position(to) - self.position(from)) / quadric.weight()
    }

    /// The smallest error of moving a vertex onto a neighbour, and this neighbour.
    fn best_of(&self, vertex: u32) -> (f32, u32) {
        let rim = self
            .surface
            .incident(vertex)
            .map(|incident| (self.error(vertex, incident.rim), incident.rim));
        rim.fold(
            (f32::INFINITY, NONE),
            |least, other| if other.0 < least.0 { other } else { least },
        )
    }

    /// Collapses the best valid edge of a vertex, if there is one.
    fn try_vertex(&mut self, vertex: u32, limit: f32) {
        let mut ring = std::mem::take(&mut self.ring);
        ring.clear();
        ring.extend(self.surface.incident(vertex));
        let best = self.best[vertex as usize].1;
        let turn = ring.iter().position(|incident| incident.rim == best).unwrap_or_default();
        ring.rotate_left(turn);
        let mut is_done = self.try_edge(vertex, &ring);
        if !is_done {
            let mut order = std::mem::take(&mut self.order);
            order.extend(
                ring.iter().map(|incident| (self.error(vertex, incident.rim), incident.rim)),
            );
            order.retain(|&(error, rim)| error <= limit && rim != best);
            order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            is_done = order.drain(..).any(|(_, rim)| {
                let turn = ring.iter().position(|incident| incident.rim == rim).unwrap_or_default();
                ring.rotate_left(turn);
                self.try_edge(vertex, &ring)
            });
            self.order = order;
        }
        if is_done {
            self.note_changes(vertex, &ring);
        }
        self.ring = ring;
    }

    /// Marks the vertices around a collapse as changed.
    fn note_changes(&mut self, removed: u32, ring: &[Incident]) {
        let target = ring[0].rim;
        for &Incident { rim, .. } in ring {
            if !std::mem::replace(&mut self.is_changed[rim as usize], true) {
                self.changed.push(rim);
            }
            let (error, best) = self.best[rim as usize];
            if rim == target || best == removed {
                self.best[rim as usize].1 = NONE;
            } else if best != NONE {
                let other = self.error(rim, target);
                if other < error {
                    self.best[rim as usize] = (other, target);
                }
            }
        }
    }

    /// Moves a vertex onto the first vertex of its ring if this collapse is valid, and returns
    /// whether it is valid.
    fn try_edge(&mut self, vertex: u32, ring: &[Incident]) -> bool {
        let target = ring[0].rim;
        if !self.keeps_shapes(target, ring)
            || !self.stays_manifold(vertex, target, ring)
            || !self.keeps_volume(vertex, target, ring[0].triangle)
            || !self.find_new_closest_triangles(vertex, ring)
            || !self.are_edges_near(target, ring)
        {
            return false;
        }
        self.surface.collapse(vertex, ring, self.new_triangles.iter().map(|&(_, normal)| normal));
        for moved in &self.moved {
            self.surface.set_state(moved.vertex, moved.to);
        }
        if !self.are_reference_edges_near() {
            for moved in &self.moved {
                self.surface.set_state(moved.vertex, moved.from);
            }
            self.surface.restore(vertex, ring);
            return false;
        }
        for incident in ring {
            self.first_removed[incident.triangle as usize] = NONE;
        }
        for i in 0..self.moved.len() {
            let MovedVertex { vertex, to, unchecked_normal, .. } = self.moved[i];
            self.set_state(vertex, to);
            self.unchecked_normal[vertex as usize] = unchecked_normal;
        }
        for &vertex in &self.checked_ends {
            self.unchecked_normal[vertex as usize] = Vec3A::ZERO;
        }
        let offset = self.position(target) - self.position(vertex);
        let quadric = self.quadrics[vertex as usize].moved(offset);
        self.quadrics[target as usize].add(&quadric);
        true
    }

    fn set_state(&mut self, vertex: u32, state: VertexState) {
        self.surface.set_state(vertex, state);
        self.next_removed[vertex as usize] =
            std::mem::replace(&mut self.first_removed[state.triangle() as usize], vertex);
    }

    /// Whether no triangle turns over or folds back, and no new triangle is a worse sliver than
    /// every old triangle.
    fn keeps_shapes(&mut self, target: u32, ring: &[Incident]) -> bool {
        let fold = |m: Vec3A, n: Vec3A| m.dot(n) < FOLD_COSINE;
        let (place, mut from) = (self.position(target), self.position(ring[1].rim));
        let mut worst = f32::INFINITY;
        self.new_triangles.clear();
        for (incident, next) in ring[1..].iter().zip(&ring[2..]) {
            let corners = [place, from, self.position(next.rim)];
            let scaled = scaled_normal(corners);
            let normal = scaled.normalize_or_zero();
            if normal.dot(incident.normal) < LEAST_TURN_COSINE {
                return false;
            }
            worst = worst.min(squared_sine_of_least_angle(corners, scaled));
            self.new_triangles.push((corners, normal));
            from = corners[2];
        }
        let is_folded = |(incident, &(_, normal)): (&Incident, &(_, Vec3A))| {
            let outer = self.surface.across_from(incident.triangle, incident.rim);
            outer != NONE && fold(normal, self.surface.normal(outer))
        };
        if ring[1..].iter().zip(&self.new_triangles).any(is_folded)
            || self.new_triangles.windows(2).any(|pair| fold(pair[0].1, pair[1].1))
        {
            return false;
        }
        let mut shapes = ring.iter().map(|incident| {
            let corners = self.surface.corners(incident.triangle);
            squared_sine_of_least_angle(corners, scaled_normal(corners))
        });
        if self.new_triangles.is_empty() || worst < SLIVER && shapes.all(|shape| shape > worst) {
            return false;
        }
        // The outer neighbours of the two triangles that vanish become neighbours of the first and
        // the last new triangle.
        let last = ring[ring.len() - 1];
        let sides = [
            (ring[0].triangle, target, self.new_triangles.first()),
            (last.triangle, last.rim, self.new_triangles.last()),
        ];
        sides.into_iter().all(|(triangle, from, new_triangle)| {
            let outer = self.surface.across_from(triangle, from);
            outer == NONE
                || new_triangle
                    .is_some_and(|&(_, normal)| !fold(normal, self.surface.normal(outer)))
        })
    }

    /// Whether the mesh stays a 2-manifold.
    fn stays_manifold(&mut self, vertex: u32, target: u32, ring: &[Incident]) -> bool {
        let topology = self.measure.topology;
        let inner = &ring[2..ring.len() - 1];
        if topology.is_pinched(target)
            || topology.border[target as usize]
                && inner
                    .iter()
                    .any(|incident| topology.is_chord(&self.surface, target, incident.rim))
        {
            return false;
        }
        // Only one triangle of a part would remain in this patch. This is not allowed, because
        // other patches may have removed the other triangles of the part.
        if ring.len() == 3
            && ring
                .iter()
                .all(|incident| self.surface.across_from(incident.triangle, incident.rim) == NONE)
        {
            return false;
        }
        self.mark += 1;
        for incident in inner {
            self.marks[incident.rim as usize] = self.mark;
        }
        let sides = [ring[1].rim, ring[ring.len() - 1].rim];
        self.surface.star(target).all(|triangle| {
            let corners = self.surface.triangles[triangle as usize];
            corners.iter().all(|&corner| self.marks[corner as usize] != self.mark)
                // A ring of three triangles, closed by a triangle of `target` and the two vertices
                // in `sides`, is a tetrahedron, which would vanish.
                && (ring.len() > 3
                    || corners.contains(&vertex)
                    || !sides.iter().all(|v| corners.contains(v)))
        })
    }

    /// Whether the part that contains a triangle keeps enough of its volume. Only small and closed
    /// parts are checked.
    fn keeps_volume(&mut self, vertex: u32, target: u32, triangle: u32) -> bool {
        let Self { surface, part_triangles, .. } = self;
        part_triangles.clear();
        part_triangles.push(triangle);
        let mut visited = 0;
        while let Some(&triangle) = part_triangles.get(visited) {
            visited += 1;
            for neighbour in surface.neighbours(triangle) {
                if neighbour == NONE {
                    return true;
                }
                if !part_triangles.contains(&neighbour) {
                    part_triangles.push(neighbour);
                }
            }
            if part_triangles.len() > MOST_CHECKED_TRIANGLES {
                return true;
            }
        }
        let [from, to] = [vertex, target].map(|vertex| surface.positions[vertex as usize]);
        // Positions are relative to the target, so the two triangles that vanish add no volume.
        let volume = |from: Vec3A| -> f32 {
            let of = |&triangle: &u32| {
                let corners = surface.triangles[triangle as usize];
                let [a, b, c] = corners.map(
                    |corner| if corner == vertex { from } else { surface.positions[corner as usize] } - to,
                );
                a.dot(cross(b, c))
            };
            part_triangles.iter().map(of).sum()
        };
        let after = volume(to);
        after > 0.0 && after >= LEAST_VOLUME_SHARE * volume(from)
    }

    /// For each vertex whose closest triangle changes, finds the closest of the new triangles.
    /// Returns `false` if, for one of these vertices, every new triangle is too far away or faces
    /// away from the vertex's normal.
    fn find_new_closest_triangles(&mut self, vertex: u32, ring: &[Incident]) -> bool {
        self.moved.clear();
        self.mark += 1;
        let within = (SAMPLE_SHARE * self.measure.distance).powi(2);
        let close = (CLOSE_SHARE * self.measure.distance).powi(2);
        let last = self.new_triangles.len();
        let closest = |removed: u32, before: usize| {
            let (place, normal) =
                (self.surface.positions[removed as usize], self.measure.normals[removed as usize]);
            // Tries the previous closest triangle first, and then the other triangles.
            let mut nearest = None;
            let mut least = within;
            for index in (before..last).chain(0..before) {
                let (corners, facing) = &self.new_triangles[index];
                if facing.dot(normal) < 0.0 {
                    continue;
                }
                if let Some((squared, is_above)) = squared_near(place, *corners, *facing, least) {
                    least = squared;
                    nearest = Some((index, squared <= close));
                    if is_above {
                        break;
                    }
                }
            }
            nearest
                .map(|(index, is_close)| VertexState::removed(ring[index + 1].triangle, is_close))
        };
        let Some(to) = closest(vertex, 0) else { return false };
        self.moved.push(MovedVertex {
            vertex,
            from: VertexState::UNUSED,
            to,
            unchecked_normal: Vec3A::ZERO,
        });
        self.marks[vertex as usize] = self.mark;
        for (turn, incident) in ring.iter().enumerate() {
            let mut removed = self.first_removed[incident.triangle as usize];
            while removed != NONE {
                let Some(to) = closest(removed, turn.clamp(1, last) - 1) else { return false };
                self.moved.push(MovedVertex {
                    vertex: removed,
                    from: self.surface.state(removed),
                    to,
                    unchecked_normal: Vec3A::ZERO,
                });
                self.marks[removed as usize] = self.mark;
                removed = self.next_removed[removed as usize];
            }
        }
        true
    }

    /// Whether the new edges are within the tolerance of the reference.
    fn are_edges_near(&self, target: u32, ring: &[Incident]) -> bool {
        self.new_triangles.windows(2).zip(&ring[2..]).all(|(pair, incident)| {
            let normal = pair[0].1 + pair[1].1;
            !self.measure.is_edge_far(target, incident.rim, normal)
        })
    }

    /// Whether the edges of the reference whose ends have new closest triangles are within the
    /// tolerance of the surface.
    fn are_reference_edges_near(&mut self) -> bool {
        let (mut moved, mut checked_ends) =
            (std::mem::take(&mut self.moved), std::mem::take(&mut self.checked_ends));
        checked_ends.clear();
        let is_near = moved.iter_mut().all(|moved| {
            let (closest, is_close) = (moved.to.triangle(), moved.to.is_close());
            let (corners, normal) =
                (self.surface.triangles[closest as usize], self.surface.normal(closest));
            if self.stays_unchecked(moved.vertex) {
                moved.unchecked_normal = self.unchecked_normal[moved.vertex as usize];
                return true;
            }
            let mut needed_no_check = is_close;
            let is_near = self.measure.outgoing.at(moved.vertex).iter().all(
                |&HalfEdge { to: other, .. }| {
                    let state = self.surface.state(other);
                    // There are no branches here, because they would be unpredictable.
                    let facing = self.surface.normal_of(state);
                    let needs_no_check = (state.triangle() == closest)
                        | (!state.is_removed() & corners.contains(&other))
                        | facing.is_none_or(|facing| {
                            is_close & state.is_close() & (normal.dot(facing) >= FLAT)
                        });
                    if !needs_no_check {
                        needed_no_check = false;
                        checked_ends.push(other);
                    }
                    // If both ends have new closest triangles and need a check, one check is
                    // enough.
                    needs_no_check
                        || self.marks[other as usize] == self.mark
                            && other < moved.vertex
                            && !self.stays_unchecked(other)
                        || self.is_edge_near(moved.vertex, closest, other)
                },
            );
            moved.unchecked_normal = if needed_no_check { normal } else { Vec3A::ZERO };
            is_near
        });
        (self.moved, self.checked_ends) = (moved, checked_ends);
        is_near
    }

    /// Whether the segments around a removed vertex need no check, because the vertex is close to
    /// its closest triangle, and the normal of this triangle has hardly changed since the last
    /// check.
    fn stays_unchecked(&self, vertex: u32) -> bool {
        let state = self.surface.state(vertex);
        let facing = self.surface.normal_of(state);
        state.is_close()
            && facing.is_some_and(|facing| {
                facing.dot(self.unchecked_normal[vertex as usize]) >= STEADY_COSINE
            })
    }

    /// Whether an edge of the reference with a removed end is within the tolerance of the surface.
    fn is_edge_near(&self, removed: u32, closest: u32, other: u32) -> bool {
        let other_closest = match self.surface.has_vertex(other) {
            true => self.surface.towards(other, self.position(removed)),
            false => self.surface.at(other),
        };
        self.are_near(
            [closest, other_closest],
            [removed, other].map(|end| self.position(end)),
            HALVINGS,
        )
    }

    /// Whether the segment between two points is within the tolerance of the surface. `closest` has
    /// a triangle close to each of the points.
    fn are_near(&self, closest: [u32; 2], [mut p, mut q]: [Vec3A; 2], halvings: u32) -> bool {
        let within = SAMPLE_SHARE * self.measure.distance;
        let [from, to] = closest.map(|closest| {
            move |place: Vec3A| self.surface.is_near(closest, place, within * within)
        });
        if closest[0] == closest[1] || from(q) || to(p) {
            return true;
        }
        for left in (0..halvings).rev() {
            let middle = p.midpoint(q);
            match (from(middle), to(middle)) {
                (true, true) => return true,
                (true, false) => p = middle,
                (false, true) => q = middle,
                (false, false) => {
                    // On a crest, normals are not reliable. With a zero normal, the search accepts
                    // triangles that face in any direction.
                    let between =
                        self.surface.near_triangle(closest[0], middle, Vec3A::ZERO, within);
                    return between.is_some_and(|(between, _)| {
                        self.are_near([closest[0], between], [p, middle], left)
                            && self.are_near([between, closest[1]], [middle, q], left)
                    });
                }
            }
        }
        true
    }
}

/// The squared sine of a triangle's smallest angle. `scaled` is the triangle's normal, whose length
/// is twice the area.
fn squared_sine_of_least_angle([a, b, c]: [Vec3A; 3], scaled: Vec3A) -> f32 {
    let [ab, bc, ca] = [b - a, c - b, a - c].map(Vec3A::length_squared);
    scaled.length_squared() * ab.min(bc).min(ca) / (ab * bc * ca).max(f32::MIN_POSITIVE)
}

/// A part of a surface. Its border with other parts stays unchanged.
#[derive(Clone, Copy)]
pub struct Patch<'a> {
    /// The positions of the vertices in cells, all different.
    pub positions: &'a [Vec3A],
    /// The surface from which the result may deviate by at most the tolerance.
    pub reference: &'a [[u32; 3]],
    /// The triangles to simplify.
    pub triangles: &'a [[u32; 3]],
    /// Vertices that must stay, in addition to the vertices on the border.
    pub pinned: &'a [u32],
    /// The kind of triangles beyond the border.
    pub outside: Surroundings,
}

impl<'a> Patch<'a> {
    /// Simplifies the patch: every sample of the result is within `distance` cells of the
    /// reference, and every vertex of `positions` that is within this distance of `triangles` is
    /// also within this distance of the result.
    #[inline(never)]
    pub fn simplified(&self, distance: f32) -> Vec<[u32; 3]> {
        let vertices = self.positions.len();
        let outgoing = OutgoingEdges::of(vertices, self.reference);
        let reference = EditableMesh::new(self.positions, self.reference.to_vec(), &outgoing);
        let normals = reference.vertex_normals();
        let surface = if self.reference == self.triangles {
            reference.clone()
        } else {
            let own = OutgoingEdges::of(vertices, self.triangles);
            let mut surface = EditableMesh::new(self.positions, self.triangles.to_vec(), &own);
            find_near_triangles(&reference, &mut surface, &normals, distance);
            surface
        };
        let topology = PatchTopology::of(&surface, self.outside);
        let mut locked = topology.border.clone();
        self.pinned.iter().for_each(|&vertex| locked[vertex as usize] = true);
        let (reference, outgoing) = (&reference, &outgoing);
        let measure =
            Measure { topology: &topology, reference, outgoing, normals: &normals, distance };
        let triangles = measure.collapse(surface, &locked).triangles;
        triangles.into_iter().filter(|corners| corners[0] != NONE).collect()
    }
}
