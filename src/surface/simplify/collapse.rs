//! Collapses edges as long as the surface stays within the distance.
//!
//! A vertex goes onto a neighbour, the least quadric error first (Garland and Heckbert, Surface
//! simplification using quadric error metrics, 1997), if the mesh stays a 2-manifold there (Dey et
//! al., Topology preserving edge contraction, 1999), no triangle turns over or becomes a sliver,
//! and what changes stays near, both ways.
//!
//! Every vertex of the reference that is gone has a closest triangle, which is near enough. When
//! triangles change, those that they were closest to must find new ones among them. What lies
//! between two vertices that one triangle is near to, it is near to as well, for triangles are
//! convex; elsewhere it is halved.

use glam::{Vec3A, Vec4};

use super::surface::{Edge, Incident, NONE, Outgoing, Spot, Surface, scaled_normal, squared_near};
use super::surface::{Outside, Topology};

/// The share of the distance that a sample may take: the rest is for what lies between samples.
const SAMPLE_SHARE: f32 = 0.93;
/// Maximum distance of samples along an edge, in cells. There are more around an uncertain one.
const SAMPLE_STEP: f32 = 0.5;
const DOUBT_SHARE: f32 = 0.4;
const FINE: i32 = 4;
/// Nothing between two vertices is looked at if each takes no more than this share of the distance,
/// and the cosine between the normals of their closest triangles is not less.
const CLOSE_SHARE: f32 = 0.75;
const FLAT: f32 = 0.9;
/// Where this was so all around a vertex, nobody looks again until its closest triangle has turned
/// by more, as a cosine.
const STEADY: f32 = 0.98;
/// How often what lies between two vertices is halved.
const HALVINGS: u32 = 4;
/// Collapses with a mean error of more than this share of the distance are not tried.
const QUADRIC_SHARE: f32 = 0.9;
/// No triangle turns by more, as a cosine.
const TURN: f32 = 0.2;
/// Two triangles fold back on each other when the cosine between their normals is below this: 170
/// degrees.
const FOLD: f32 = -0.985;
/// A triangle is a sliver when the squared sine of its least angle is less: 10 degrees.
const SLIVER: f32 = 0.03;
/// A closed part of no more triangles keeps so large a share of its volume with every collapse: one
/// that is smaller than the distance could vanish or turn inside out.
const SMALL: usize = 16;
const KEPT: f32 = 0.5;

/// The reference surface and the limits that the collapses of a patch are checked against.
pub struct Measure<'a> {
    pub topology: &'a Topology,
    /// The surface that the result must not leave.
    pub reference: &'a Surface<'a>,
    /// The edges of the reference.
    pub outgoing: &'a Outgoing,
    /// Normals of the reference, for all vertices.
    pub normals: &'a [Vec3A],
    pub distance: f32,
}

/// Finds closest triangles on `surface` for the vertices of `reference` that it does not have, from
/// one that has one to the next.
pub fn find_homes(reference: &Surface, surface: &mut Surface, normals: &[Vec3A], distance: f32) {
    let lacks = |surface: &Surface, corners: &[u32; 3]| {
        corners.iter().any(|&v| surface.spot(v) == Spot::NOWHERE)
    };
    let mut left: Vec<[u32; 3]> =
        reference.triangles.iter().copied().filter(|corners| lacks(surface, corners)).collect();
    let mut found_some = true;
    while std::mem::take(&mut found_some) {
        left.retain(|corners| {
            let Some(&known) =
                corners.iter().find(|&&vertex| surface.spot(vertex) != Spot::NOWHERE)
            else {
                return true;
            };
            for &vertex in corners {
                if surface.spot(vertex) != Spot::NOWHERE {
                    continue;
                }
                let (place, normal) =
                    (reference.positions[vertex as usize], normals[vertex as usize]);
                let from = match surface.has(known) {
                    true => surface.towards(known, place),
                    false => surface.at(known),
                };
                if let Some((closest, squared)) =
                    surface.holder(from, place, normal, SAMPLE_SHARE * distance)
                {
                    let is_close = squared <= (CLOSE_SHARE * distance).powi(2);
                    surface.settle(vertex, Spot::gone(closest, is_close));
                    found_some = true;
                }
            }
            // Others may know better, but each is asked but once.
            false
        });
    }
}

/// Squared distances from planes, weighted, as seen from a vertex: a cache line.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Quadric {
    /// Columns of a matrix. The last of the first is the weight.
    planes: [Vec4; 3],
    /// The last is the constant.
    linear: Vec4,
}

impl Quadric {
    const NONE: Self = Self { planes: [Vec4::ZERO; 3], linear: Vec4::ZERO };

    /// Builds the quadric of a plane through the vertex, by a normal as long as its weight.
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

    /// The first three are the matrix times `offset`.
    fn times(&self, offset: Vec3A) -> Vec4 {
        let [x, y, z] = self.planes;
        x * offset.x + y * offset.y + z * offset.z
    }

    fn at(&self, offset: Vec3A) -> f32 {
        Vec3A::from_vec4(self.times(offset) + 2.0 * self.linear).dot(offset) + self.linear.w
    }

    /// Returns the quadric as seen from a vertex at `offset`.
    fn moved(&self, offset: Vec3A) -> Self {
        let linear = self.linear + self.times(offset);
        Self { linear: linear.with_w(self.at(offset).max(0.0)), ..*self }
    }

    fn add(&mut self, other: &Self) {
        self.planes.iter_mut().zip(other.planes).for_each(|(to, from)| *to += from);
        self.linear += other.linear;
    }
}

/// In progress.
struct Work<'a, 'b> {
    by: &'b Measure<'a>,
    surface: Surface<'a>,
    /// For each triangle one of those whose closest triangle it is, and for each of these the next.
    first: Vec<u32>,
    next: Vec<u32>,
    /// For each vertex that is gone the normal of its closest triangle when nothing around it
    /// needed a look, or zero.
    calm: Vec<Vec3A>,
    /// Vertices at the other ends of what was looked at: they are calm no more.
    looked_at: Vec<u32>,
    quadrics: Vec<Quadric>,
    /// For each vertex its least error and where to, or `NONE` where that is to be found.
    best: Vec<(f32, u32)>,
    /// Vertices whose neighbourhood has changed.
    changed: Vec<u32>,
    is_changed: Vec<bool>,
    ring: Vec<Incident>,
    order: Vec<(f32, u32)>,
    /// The triangles that are to be, and their normals.
    parts: Vec<([Vec3A; 3], Vec3A)>,
    /// The first triangles from one on.
    near: Vec<u32>,
    moved: Vec<Moved>,
    /// For each vertex the last mark that it got, to be told from others without clearing.
    marks: Vec<u32>,
    mark: u32,
}

/// A vertex that is gone, and its closest triangle before and after.
#[derive(Clone, Copy)]
struct Moved {
    vertex: u32,
    from: Spot,
    to: Spot,
    /// The new value of `Work::calm` for the vertex.
    calm: Vec3A,
}

impl<'a> Measure<'a> {
    /// Collapses edges of `surface` except at vertices that are locked.
    pub fn collapse(&self, surface: Surface<'a>, locked: &[bool]) -> Surface<'a> {
        let vertices = surface.positions.len();
        let mut work = Work {
            by: self,
            first: vec![NONE; surface.triangles.len()],
            next: vec![NONE; vertices],
            calm: vec![Vec3A::ZERO; vertices],
            looked_at: Vec::new(),
            quadrics: vec![Quadric::NONE; vertices],
            best: vec![(f32::INFINITY, NONE); vertices],
            changed: Vec::new(),
            is_changed: vec![false; vertices],
            ring: Vec::new(),
            order: Vec::new(),
            parts: Vec::new(),
            near: Vec::new(),
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
            let spot = work.surface.spot(vertex);
            if spot.is_gone() && spot != Spot::NOWHERE {
                work.settle(vertex, spot);
            }
        }
        work.run(locked);
        work.surface
    }

    /// Whether a sample is too far from the reference, of an edge whose triangles face this way.
    fn is_stray(&self, from: u32, to: u32, normal: Vec3A) -> bool {
        let (reference, distance) = (self.reference, self.distance);
        let is_next = |edge: &Edge| edge.to == to || edge.before == to;
        if self.outgoing.at(from).iter().any(is_next)
            || reference.leads(from, to, normal, SAMPLE_SHARE * distance)
        {
            return false;
        }
        let [p, q] = [from, to].map(|vertex| reference.positions[vertex as usize]);
        let steps = ((p.distance(q) / SAMPLE_STEP).ceil() as i32).max(2);
        let at = |fine: i32| p.lerp(q, fine as f32 / (steps * 2 * FINE) as f32);
        let mut last = reference.at(from);
        let mut within = |sample: Vec3A, share: f32| {
            let holder = reference.holder(last, sample, normal, share * distance);
            last = holder.map_or(last, |(holder, _)| holder);
            holder.is_some()
        };
        (1..steps).map(|step| step * 2 * FINE).any(|step| {
            !within(at(step), DOUBT_SHARE)
                && (step - FINE..=step + FINE).map(at).any(|sample| !within(sample, SAMPLE_SHARE))
        })
    }
}

impl Work<'_, '_> {
    fn run(&mut self, locked: &[bool]) {
        let limit = (QUADRIC_SHARE * self.by.distance).powi(2);
        self.changed.extend((0..locked.len() as u32).filter(|&vertex| self.surface.has(vertex)));
        let mut queue: Vec<u64> = Vec::new();
        while !self.changed.is_empty() {
            for i in 0..self.changed.len() {
                let vertex = self.changed[i];
                self.is_changed[vertex as usize] = false;
                if !locked[vertex as usize] && self.surface.has(vertex) {
                    if self.best[vertex as usize].1 == NONE {
                        self.best[vertex as usize] = self.best_of(vertex);
                    }
                    let (error, _) = self.best[vertex as usize];
                    if error <= limit {
                        // Positive numbers sort as their bits do.
                        queue.push(u64::from(error.max(0.0).to_bits()) << 32 | u64::from(vertex));
                    }
                }
            }
            self.changed.clear();
            queue.sort_unstable();
            for vertex in queue.drain(..).map(|entry| entry as u32) {
                // Where something has changed nearby, there may be a better one next time.
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

    /// The least error of a vertex, and where to.
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

    /// Collapses the best edge of a vertex that can be, if any.
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

    /// Sees to what a collapse means for the vertices around it.
    fn note_changes(&mut self, gone: u32, ring: &[Incident]) {
        let target = ring[0].rim;
        for &Incident { rim, .. } in ring {
            if !std::mem::replace(&mut self.is_changed[rim as usize], true) {
                self.changed.push(rim);
            }
            let (error, best) = self.best[rim as usize];
            if rim == target || best == gone {
                self.best[rim as usize].1 = NONE;
            } else if best != NONE {
                let other = self.error(rim, target);
                if other < error {
                    self.best[rim as usize] = (other, target);
                }
            }
        }
    }

    /// Moves a vertex onto the first of its ring, if it can be.
    fn try_edge(&mut self, vertex: u32, ring: &[Incident]) -> bool {
        let target = ring[0].rim;
        if !self.may_turn(target, ring)
            || !self.may_join(vertex, target, ring)
            || !self.keeps_volume(vertex, target, ring[0].triangle)
            || !self.find_new_homes(vertex, ring)
            || !self.are_edges_near(target, ring)
        {
            return false;
        }
        self.surface.collapse(vertex, ring, self.parts.iter().map(|&(_, normal)| normal));
        for moved in &self.moved {
            self.surface.settle(moved.vertex, moved.to);
        }
        if !self.is_between_near() {
            for moved in &self.moved {
                self.surface.settle(moved.vertex, moved.from);
            }
            self.surface.restore(vertex, ring);
            return false;
        }
        for incident in ring {
            self.first[incident.triangle as usize] = NONE;
        }
        for i in 0..self.moved.len() {
            let Moved { vertex, to, calm, .. } = self.moved[i];
            self.settle(vertex, to);
            self.calm[vertex as usize] = calm;
        }
        for &vertex in &self.looked_at {
            self.calm[vertex as usize] = Vec3A::ZERO;
        }
        let offset = self.position(target) - self.position(vertex);
        let quadric = self.quadrics[vertex as usize].moved(offset);
        self.quadrics[target as usize].add(&quadric);
        true
    }

    fn settle(&mut self, vertex: u32, spot: Spot) {
        self.surface.settle(vertex, spot);
        self.next[vertex as usize] =
            std::mem::replace(&mut self.first[spot.triangle() as usize], vertex);
    }

    /// Whether no triangle turns over, folds back or becomes a worse sliver than there were.
    fn may_turn(&mut self, target: u32, ring: &[Incident]) -> bool {
        let fold = |m: Vec3A, n: Vec3A| m.dot(n) < FOLD;
        let (place, mut from) = (self.position(target), self.position(ring[1].rim));
        let mut worst = f32::INFINITY;
        self.parts.clear();
        for (incident, next) in ring[1..].iter().zip(&ring[2..]) {
            let corners = [place, from, self.position(next.rim)];
            let scaled = scaled_normal(corners);
            let normal = scaled.normalize_or_zero();
            if normal.dot(incident.normal) < TURN {
                return false;
            }
            worst = worst.min(shape(corners, scaled));
            self.parts.push((corners, normal));
            from = corners[2];
        }
        let is_folded = |(incident, &(_, normal)): (&Incident, &(_, Vec3A))| {
            let outer = self.surface.across_from(incident.triangle, incident.rim);
            outer != NONE && fold(normal, self.surface.normal(outer))
        };
        if ring[1..].iter().zip(&self.parts).any(is_folded)
            || self.parts.windows(2).any(|parts| fold(parts[0].1, parts[1].1))
        {
            return false;
        }
        let mut shapes = ring.iter().map(|incident| {
            let corners = self.surface.corners(incident.triangle);
            shape(corners, scaled_normal(corners))
        });
        if self.parts.is_empty() || worst < SLIVER && shapes.all(|shape| shape > worst) {
            return false;
        }
        // What is across from the triangles that vanish.
        let last = ring[ring.len() - 1];
        let sides = [
            (ring[0].triangle, target, self.parts.first()),
            (last.triangle, last.rim, self.parts.last()),
        ];
        sides.into_iter().all(|(triangle, from, part)| {
            let outer = self.surface.across_from(triangle, from);
            outer == NONE
                || part.is_some_and(|&(_, normal)| !fold(normal, self.surface.normal(outer)))
        })
    }

    /// Whether the mesh stays a 2-manifold.
    fn may_join(&mut self, vertex: u32, target: u32, ring: &[Incident]) -> bool {
        let topology = self.by.topology;
        let inner = &ring[2..ring.len() - 1];
        if topology.is_pinched(target)
            || topology.border[target as usize]
                && inner
                    .iter()
                    .any(|incident| topology.is_chord(&self.surface, target, incident.rim))
        {
            return false;
        }
        // Of a part whose triangles elsewhere may have come to one, too, more than one must stay.
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
        let beside = [ring[1].rim, ring[ring.len() - 1].rim];
        self.surface.star(target).all(|triangle| {
            let corners = self.surface.triangles[triangle as usize];
            corners.iter().all(|&corner| self.marks[corner as usize] != self.mark)
                // Nothing is left of a tetrahedron.
                && (ring.len() > 3 || corners.contains(&vertex) || !beside.iter().all(|v| corners.contains(v)))
        })
    }

    /// Whether the part that a triangle belongs to keeps its share of volume, if it is small and
    /// closed.
    fn keeps_volume(&mut self, vertex: u32, target: u32, triangle: u32) -> bool {
        let Self { surface, near, .. } = self;
        near.clear();
        near.push(triangle);
        let mut looked_at = 0;
        while let Some(&triangle) = near.get(looked_at) {
            looked_at += 1;
            for beside in surface.beside(triangle) {
                if beside == NONE {
                    return true;
                }
                if !near.contains(&beside) {
                    near.push(beside);
                }
            }
            if near.len() > SMALL {
                return true;
            }
        }
        let [from, to] = [vertex, target].map(|vertex| surface.positions[vertex as usize]);
        // As seen from the target, triangles that vanish have no volume.
        let volume = |from: Vec3A| -> f32 {
            let of = |&triangle: &u32| {
                let corners = surface.triangles[triangle as usize];
                let [a, b, c] = corners.map(
                    |corner| if corner == vertex { from } else { surface.positions[corner as usize] } - to,
                );
                a.dot(b.cross(c))
            };
            near.iter().map(of).sum()
        };
        let after = volume(to);
        after > 0.0 && after >= KEPT * volume(from)
    }

    /// Finds closest triangles among the triangles that are to be for all whose closest triangle
    /// changes.
    fn find_new_homes(&mut self, vertex: u32, ring: &[Incident]) -> bool {
        self.moved.clear();
        self.mark += 1;
        let within = (SAMPLE_SHARE * self.by.distance).powi(2);
        let close = (CLOSE_SHARE * self.by.distance).powi(2);
        let last = self.parts.len();
        let closest = |gone: u32, before: usize| {
            let (place, normal) =
                (self.surface.positions[gone as usize], self.by.normals[gone as usize]);
            // The triangle that it was before, first, and those beside it.
            let mut nearest = None;
            let mut least = within;
            for part in (before..last).chain(0..before) {
                let (corners, facing) = &self.parts[part];
                if facing.dot(normal) < 0.0 {
                    continue;
                }
                if let Some((squared, is_above)) = squared_near(place, *corners, *facing, least) {
                    least = squared;
                    nearest = Some((part, squared <= close));
                    if is_above {
                        break;
                    }
                }
            }
            nearest.map(|(part, is_close)| Spot::gone(ring[part + 1].triangle, is_close))
        };
        let Some(to) = closest(vertex, 0) else { return false };
        self.moved.push(Moved { vertex, from: Spot::NOWHERE, to, calm: Vec3A::ZERO });
        self.marks[vertex as usize] = self.mark;
        for (turn, incident) in ring.iter().enumerate() {
            let mut gone = self.first[incident.triangle as usize];
            while gone != NONE {
                let Some(to) = closest(gone, turn.clamp(1, last) - 1) else { return false };
                self.moved.push(Moved {
                    vertex: gone,
                    from: self.surface.spot(gone),
                    to,
                    calm: Vec3A::ZERO,
                });
                self.marks[gone as usize] = self.mark;
                gone = self.next[gone as usize];
            }
        }
        true
    }

    /// Whether new edges are near the reference.
    fn are_edges_near(&self, target: u32, ring: &[Incident]) -> bool {
        self.parts.windows(2).zip(&ring[2..]).all(|(parts, incident)| {
            let normal = parts[0].1 + parts[1].1;
            !self.by.is_stray(target, incident.rim, normal)
        })
    }

    /// Whether edges of the reference are near whose ends have new closest triangles.
    fn is_between_near(&mut self) -> bool {
        let (mut moved, mut looked_at) =
            (std::mem::take(&mut self.moved), std::mem::take(&mut self.looked_at));
        looked_at.clear();
        let is_near = moved.iter_mut().all(|moved| {
            let (closest, is_close) = (moved.to.triangle(), moved.to.is_close());
            let (corners, normal) =
                (self.surface.triangles[closest as usize], self.surface.normal(closest));
            if self.stays_calm(moved.vertex) {
                moved.calm = self.calm[moved.vertex as usize];
                return true;
            }
            let mut is_calm = is_close;
            let is_near =
                self.by.outgoing.at(moved.vertex).iter().all(|&Edge { to: other, .. }| {
                    let spot = self.surface.spot(other);
                    // Without branches, for none could be foreseen.
                    let facing = self.surface.normal_of(spot);
                    let needs_no_look = (spot.triangle() == closest)
                        | (!spot.is_gone() & corners.contains(&other))
                        | facing.is_none_or(|facing| {
                            is_close & spot.is_close() & (normal.dot(facing) >= FLAT)
                        });
                    if !needs_no_look {
                        is_calm = false;
                        looked_at.push(other);
                    }
                    // Where both ends have moved and look, one is enough.
                    needs_no_look
                        || self.marks[other as usize] == self.mark
                            && other < moved.vertex
                            && !self.stays_calm(other)
                        || self.is_edge_near(moved.vertex, closest, other)
                });
            moved.calm = if is_calm { normal } else { Vec3A::ZERO };
            is_near
        });
        (self.moved, self.looked_at) = (moved, looked_at);
        is_near
    }

    /// Whether a vertex that is gone needs no look at what is around it, for its closest triangle
    /// has hardly turned since nothing did.
    fn stays_calm(&self, vertex: u32) -> bool {
        let spot = self.surface.spot(vertex);
        let facing = self.surface.normal_of(spot);
        spot.is_close()
            && facing.is_some_and(|facing| facing.dot(self.calm[vertex as usize]) >= STEADY)
    }

    /// Whether an edge of the reference is near, one end of which is gone.
    fn is_edge_near(&self, gone: u32, closest: u32, other: u32) -> bool {
        let other_closest = match self.surface.has(other) {
            true => self.surface.towards(other, self.position(gone)),
            false => self.surface.at(other),
        };
        self.are_near(
            [closest, other_closest],
            [gone, other].map(|end| self.position(end)),
            HALVINGS,
        )
    }

    /// Whether triangles are near all between two points, each of which has one that is near.
    fn are_near(&self, closest: [u32; 2], [mut p, mut q]: [Vec3A; 2], halvings: u32) -> bool {
        let within = SAMPLE_SHARE * self.by.distance;
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
                    // A crest's normal says little of where it faces.
                    let between = self.surface.holder(closest[0], middle, Vec3A::ZERO, within);
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

/// The squared sine of a triangle's least angle, by its normal that is twice its area long.
fn shape([a, b, c]: [Vec3A; 3], scaled: Vec3A) -> f32 {
    let [ab, bc, ca] = [b - a, c - b, a - c].map(Vec3A::length_squared);
    scaled.length_squared() * ab.min(bc).min(ca) / (ab * bc * ca).max(f32::MIN_POSITIVE)
}

/// A part of a surface. Its border, where other parts go on, stays as it is.
#[derive(Clone, Copy)]
pub struct Patch<'a> {
    /// The places of the vertices in cells; no two alike.
    pub positions: &'a [Vec3A],
    /// The surface that the result must not leave.
    pub reference: &'a [[u32; 3]],
    /// The triangles to be simplified.
    pub triangles: &'a [[u32; 3]],
    /// Vertices that stay, besides those of the border.
    pub pinned: &'a [u32],
    /// The kind of triangles beyond the border.
    pub outside: Outside,
}

impl<'a> Patch<'a> {
    /// Simplifies it: every sample of the result is within `distance` cells of the reference, and
    /// every vertex of `positions` that was within as much of `triangles` is of the result.
    #[inline(never)]
    pub fn simplified(&self, distance: f32) -> Vec<[u32; 3]> {
        let vertices = self.positions.len();
        let outgoing = Outgoing::of(vertices, self.reference);
        let reference = Surface::new(self.positions, self.reference.to_vec(), &outgoing);
        let normals = reference.vertex_normals();
        let surface = if self.reference == self.triangles {
            reference.clone()
        } else {
            let own = Outgoing::of(vertices, self.triangles);
            let mut surface = Surface::new(self.positions, self.triangles.to_vec(), &own);
            find_homes(&reference, &mut surface, &normals, distance);
            surface
        };
        let topology = Topology::of(&surface, self.outside);
        let mut locked = topology.border.clone();
        self.pinned.iter().for_each(|&vertex| locked[vertex as usize] = true);
        let (reference, outgoing) = (&reference, &outgoing);
        let measure =
            Measure { topology: &topology, reference, outgoing, normals: &normals, distance };
        let triangles = measure.collapse(surface, &locked).triangles;
        triangles.into_iter().filter(|corners| corners[0] != NONE).collect()
    }
}
