//! Brings a simplified patch within its distance, by as little as possible: edges are flipped, vertices put back.
//!
//! Every vertex of the reference has a home, a triangle of the patch that is near enough. Homes are found from one
//! vertex to the next. What lies between two vertices that one triangle is near to, it is near to as well, for
//! triangles are convex; elsewhere samples are looked at.

use std::collections::VecDeque;

use glam::Vec3;

use super::near::Near;
use super::surface::{NONE, Surface, edges};
use super::topology::Topology;

/// Of the distance, what a sample may take: the rest is for what lies between samples.
const SAMPLE_SHARE: f32 = 0.93;
/// Samples along an edge are this far apart at the most, in cells. Around one that takes more than its share of doubt
/// there are more, so many either way.
const SAMPLE_STEP: f32 = 0.5;
const DOUBT_SHARE: f32 = 0.4;
const FINE: i32 = 4;
/// Samples in the midst of a triangle are this far apart at the most, in cells, and may take more of the distance.
const MIDST_STEP: f32 = 1.0;
const MIDST_SHARE: f32 = 0.97;
/// An edge of the reference is a ridge where the cosine between the normals beside it, or of its ends' homes, is less; a
/// crest where it is still less. Steps between samples are in cells; on a crest they are not above the distance either.
const RIDGE: f32 = 0.95;
const CREST: f32 = 0.5;
const RIDGE_STEP: f32 = 0.4;
const CREST_STEP: f32 = 0.15;
/// Within more than this, in cells, fit whole features of the surface: all edges are looked at.
const WIDE: f32 = 0.25;
/// How many changes are made, beyond one for every eight triangles.
const PATIENCE: usize = 100;
/// Vertices are put back from this far around, in cells.
const AROUND: f32 = 1.0;
/// A point whose barycentric coordinate is less is put onto the edge, not into the triangle.
const EDGE_WEIGHT: f32 = 0.15;

/// What is wrong.
#[derive(Clone, Copy)]
enum Fault {
    /// A vertex of the reference has no triangle within the distance.
    Missed(u32),
    /// A sample of an edge of a triangle has no triangle of the reference within the distance.
    Stray(u32, [u32; 2], Vec3),
    /// A sample of a sharp edge of the reference has no triangle within the distance.
    Ridge(Ridge),
    /// An edge of a triangle between two vertices of the border that was none before.
    Chord(u32, [u32; 2]),
}

/// A sample of a sharp edge of the reference.
#[derive(Clone, Copy)]
struct Ridge {
    ends: [u32; 2],
    sample: Vec3,
}

/// What a simplified patch is measured by.
pub struct Mending<'a> {
    pub topology: &'a Topology,
    /// What it must not leave.
    pub reference: &'a Surface<'a>,
    /// Itself before it was simplified.
    pub before: &'a Surface<'a>,
    /// For each vertex of the reference that was near enough a triangle of it.
    pub homes_before: &'a [u32],
    /// All vertices of the reference.
    pub points: &'a Near,
    /// Of the reference, for all vertices.
    pub normals: &'a [Vec3],
    /// Whether no triangle has a vertex that the reference has, here or elsewhere.
    pub is_free: &'a dyn Fn(u32) -> bool,
    pub distance: f32,
}

/// Finds a triangle of `surface` within the distance for vertices of `reference`, from one that has one to the next,
/// and notes it in `homes`.
pub fn find_homes(
    reference: &Surface,
    surface: &Surface,
    normals: &[Vec3],
    distance: f32,
    homes: &mut [u32],
) {
    let lacks = |homes: &[u32], corners: &[u32; 3]| corners.iter().any(|&v| homes[v as usize] == NONE);
    let mut left: Vec<[u32; 3]> =
        reference.triangles.iter().copied().filter(|corners| lacks(homes, corners)).collect();
    let mut found_some = true;
    while std::mem::take(&mut found_some) {
        left.retain(|corners| {
            let Some(&known) = corners.iter().find(|&&vertex| homes[vertex as usize] != NONE) else {
                return true;
            };
            for &vertex in corners {
                if homes[vertex as usize] != NONE {
                    continue;
                }
                let (place, normal) = (reference.positions[vertex as usize], normals[vertex as usize]);
                let from =
                    if surface.has(known) { surface.towards(known, place) } else { homes[known as usize] };
                if let Some(home) = surface.holder(from, place, normal, SAMPLE_SHARE * distance) {
                    homes[vertex as usize] = home;
                    found_some = true;
                }
            }
            // Others may know better, but each is asked but once.
            false
        });
    }
}

/// In progress.
struct Work<'a, 'b> {
    by: &'b Mending<'a>,
    surface: Surface<'a>,
    homes: Vec<u32>,
    faults: VecDeque<Fault>,
    /// Edges of the reference, with a triangle, that no one triangle is near to from end to end.
    sampled: Vec<(u32, [u32; 2])>,
    changes: usize,
}

impl<'a> Mending<'a> {
    /// Mends `surface`.
    ///
    /// # Errors
    /// The vertices where that cannot be done.
    pub fn mend(&self, surface: Surface<'a>) -> Result<Surface<'a>, Vec<u32>> {
        let mut homes = self.homes_left(&surface);
        find_homes(self.reference, &surface, self.normals, self.distance, &mut homes);
        let mut work =
            Work { by: self, surface, homes, faults: VecDeque::new(), sampled: Vec::new(), changes: 0 };
        for vertex in 0..work.homes.len() as u32 {
            if work.homes[vertex as usize] == NONE {
                work.look_at_vertex(vertex);
            }
        }
        for triangle in 0..work.surface.triangles.len() as u32 {
            work.look_at_edges(triangle);
        }
        for triangle in 0..self.reference.triangles.len() as u32 {
            let corners = self.reference.triangles[triangle as usize];
            let [home, others @ ..] = corners.map(|vertex| work.homes[vertex as usize]);
            if home != NONE && others == [home; 2] {
                continue;
            }
            for [from, to] in edges(corners).into_iter().filter(|[from, to]| from < to) {
                work.look_at_ridge(triangle, [from, to]);
            }
        }
        // Two faults can undo each other's mending for ever.
        let patience = PATIENCE + work.surface.triangles.len() / 8;
        let mut failed = Vec::new();
        while !work.faults.is_empty() {
            while let Some(fault) = work.faults.pop_front() {
                if work.changes < patience {
                    work.fix(fault, &mut failed);
                } else {
                    failed.extend(work.vertices_of(&fault));
                }
            }
            if failed.is_empty() {
                let sampled = std::mem::take(&mut work.sampled);
                sampled.into_iter().for_each(|(triangle, ends)| work.look_at_ridge(triangle, ends));
            }
        }
        if failed.is_empty() { Ok(work.surface) } else { Err(failed) }
    }

    /// The corners of new triangles that have a sample in their midst too far from the reference. Within a narrow
    /// distance their edges tell enough.
    pub fn strays(&self, surface: &Surface) -> Vec<u32> {
        let mut strays = Vec::new();
        if self.distance <= WIDE {
            return strays;
        }
        for (&corners, &normal) in surface.triangles.iter().zip(surface.normals()) {
            if self.before.number_of(corners).is_none() && !self.holds_midst(corners, normal) {
                strays.extend(corners);
            }
        }
        strays
    }

    fn holds_midst(&self, corners: [u32; 3], normal: Vec3) -> bool {
        let [a, b, c] = corners.map(|vertex| self.reference.positions[vertex as usize]);
        let rows = (a.distance(b).max(b.distance(c)).max(c.distance(a)) / MIDST_STEP).ceil() as i32;
        let mut first = self.reference.at(corners[0]);
        // Rows of samples, from one corner on.
        (1..rows).all(|row| {
            let mut last = first;
            (1..=row).all(|i| {
                let (row, i) = (row as f32, i as f32 - 0.5);
                let place = a + ((b - a) * (row - i) + (c - a) * i) / rows as f32;
                let holder = self.reference.holder(last, place, normal, MIDST_SHARE * self.distance);
                last = holder.unwrap_or(last);
                if i < 1.0 {
                    first = last;
                }
                holder.is_some()
            })
        })
    }

    /// The homes in `surface` that are vertices, or triangles as before.
    fn homes_left(&self, surface: &Surface) -> Vec<u32> {
        let home = |(vertex, &before): (u32, &u32)| match self.before.triangles.get(before as usize) {
            _ if surface.has(vertex) => surface.at(vertex),
            Some(&corners) => surface.number_of(corners).unwrap_or(NONE),
            None => NONE,
        };
        (0..).zip(self.homes_before).map(home).collect()
    }

    /// Whether it is this patch that has to be near a vertex.
    fn is_ours(&self, vertex: u32) -> bool {
        self.homes_before[vertex as usize] != NONE
    }
}

impl<'a> Work<'a, '_> {
    fn vertices_of(&self, fault: &Fault) -> Vec<u32> {
        match *fault {
            Fault::Missed(vertex) => vec![vertex],
            Fault::Stray(_, ends, _) | Fault::Ridge(Ridge { ends, .. }) | Fault::Chord(_, ends) => {
                ends.to_vec()
            }
        }
    }

    fn is_chord(&self, a: u32, b: u32) -> bool {
        self.by.topology.is_chord(self.by.before, a, b)
    }

    fn had_edge(&self, a: u32, b: u32) -> bool {
        self.by.topology.joined(self.by.before, a, b)
    }

    fn position(&self, vertex: u32) -> Vec3 {
        self.surface.positions[vertex as usize]
    }

    /// A triangle to search for `place` from, next to a vertex or near one next to it, or `NONE`.
    fn hint(&self, vertex: u32, place: Vec3) -> u32 {
        let around = self.by.reference.star(vertex);
        let around = around.flat_map(|triangle| self.by.reference.triangles[triangle as usize]);
        let known = |&vertex: &u32| self.homes[vertex as usize] != NONE;
        match std::iter::once(vertex).chain(around).find(known) {
            Some(known) if self.surface.has(known) => self.surface.towards(known, place),
            Some(known) => self.homes[known as usize],
            None => NONE,
        }
    }

    fn look_at_vertex(&mut self, vertex: u32) {
        if self.misses(vertex) {
            self.faults.push_back(Fault::Missed(vertex));
        }
    }

    /// What was too far from the patch before is another patch's business.
    fn misses(&mut self, vertex: u32) -> bool {
        if self.surface.has(vertex) || !self.by.is_ours(vertex) {
            return false;
        }
        let (place, normal) = (self.position(vertex), self.by.normals[vertex as usize]);
        let found =
            self.surface.holder(self.hint(vertex, place), place, normal, SAMPLE_SHARE * self.by.distance);
        self.homes[vertex as usize] = found.unwrap_or(NONE);
        found.is_none()
    }

    /// Looks at the new edges of a triangle, each from one side.
    fn look_at_edges(&mut self, triangle: u32) {
        for [from, to] in edges(self.surface.triangles[triangle as usize]) {
            if from > to || self.had_edge(from, to) {
                continue;
            }
            if self.is_chord(from, to) {
                self.faults.push_back(Fault::Chord(triangle, [from, to]));
                continue;
            }
            let pair = self.surface.at_edge(triangle, from, to).map_or([triangle; 2], |(pair, _)| pair);
            let normal = pair.into_iter().map(|triangle| self.surface.normal(triangle)).sum();
            if let Some(sample) = self.stray_sample(from, to, normal) {
                self.faults.push_back(Fault::Stray(triangle, [from, to], sample));
            }
        }
    }

    /// Looks at an edge of a triangle of the reference.
    fn look_at_ridge(&mut self, triangle: u32, ends: [u32; 2]) {
        if self.is_shared(ends) || !ends.into_iter().all(|end| self.by.is_ours(end)) {
            return;
        }
        let Some((pair, _)) = self.by.reference.at_edge(triangle, ends[0], ends[1]) else { return };
        let [m, n] = pair.map(|triangle| self.by.reference.normal(triangle));
        let cosine = cosine(m, n);
        let homes = ends.map(|end| self.homes[end as usize]);
        let is_flat = cosine >= RIDGE
            && !homes.contains(&NONE)
            && self::cosine(self.surface.normal(homes[0]), self.surface.normal(homes[1])) >= RIDGE;
        if is_flat && self.by.distance <= WIDE || self.spans(ends) {
            return;
        }
        self.sampled.push((triangle, ends));
        let [p, q] = ends.map(|end| self.position(end));
        let step = if cosine < CREST { CREST_STEP.min(self.by.distance) } else { RIDGE_STEP };
        let samples = (p.distance(q) / step).ceil() as i32;
        for i in 0..samples {
            let ridge = Ridge { ends, sample: p.lerp(q, (i as f32 + 0.5) / samples as f32) };
            if self.misses_ridge(ridge) {
                self.faults.push_back(Fault::Ridge(ridge));
            }
        }
    }

    /// Whether both ends have one home, or one is a corner of the other's.
    fn is_shared(&self, ends: [u32; 2]) -> bool {
        let homes = ends.map(|end| self.homes[end as usize]);
        let has = |home: u32, end: u32| self.surface.triangles[home as usize].contains(&end);
        !homes.contains(&NONE) && (homes[0] == homes[1] || has(homes[0], ends[1]) || has(homes[1], ends[0]))
    }

    /// Whether one triangle is near both ends, and so all between them. Each is near its own home.
    fn spans(&self, ends: [u32; 2]) -> bool {
        let homes = ends.map(|end| self.homes[end as usize]);
        let within = SAMPLE_SHARE * self.by.distance;
        let holds =
            |home: u32, end: u32| self.surface.squared_distance(home, self.position(end)) <= within * within;
        !homes.contains(&NONE) && (holds(homes[0], ends[1]) || holds(homes[1], ends[0]))
    }

    /// A crest's normal says little of where it faces.
    fn misses_ridge(&self, Ridge { ends, sample }: Ridge) -> bool {
        let within = SAMPLE_SHARE * self.by.distance;
        let is_held = |surface: &Surface, homes: [u32; 2]| {
            homes.into_iter().any(|home| surface.holder(home, sample, Vec3::ZERO, within).is_some())
        };
        !is_held(&self.surface, ends.map(|end| self.hint(end, sample)))
            && is_held(self.by.before, ends.map(|end| self.by.homes_before[end as usize]))
    }

    /// The first sample that is too far from the reference, of an edge whose triangles face this way.
    fn stray_sample(&self, from: u32, to: u32, normal: Vec3) -> Option<Vec3> {
        let (reference, distance) = (self.by.reference, self.by.distance);
        if reference.leads(from, to, normal, SAMPLE_SHARE * distance) {
            return None;
        }
        let [p, q] = [from, to].map(|vertex| self.position(vertex));
        let steps = ((p.distance(q) / SAMPLE_STEP).ceil() as i32).max(2);
        let at = |fine: i32| p.lerp(q, fine as f32 / (steps * 2 * FINE) as f32);
        let mut last = reference.at(from);
        let mut within = |sample: Vec3, share: f32| {
            let holder = reference.holder(last, sample, normal, share * distance);
            last = holder.unwrap_or(last);
            holder.is_some()
        };
        for step in (1..steps).map(|step| step * 2 * FINE) {
            if !within(at(step), DOUBT_SHARE) {
                let mut around = (step - FINE..=step + FINE).map(at);
                let stray = around.find(|&sample| !within(sample, SAMPLE_SHARE));
                if stray.is_some() {
                    return stray;
                }
            }
        }
        None
    }

    /// Sees to a fault, unless it is gone by now. Where that cannot be done, another vertex nearby is put back first.
    fn fix(&mut self, fault: Fault, failed: &mut Vec<u32>) {
        let (done, place) = match fault {
            Fault::Missed(vertex) => (!self.misses(vertex) || self.put_back(vertex), self.position(vertex)),
            Fault::Stray(triangle, [from, to], sample) => {
                let Some((pair, apexes)) = self.surface.at_edge(triangle, from, to) else { return };
                let done =
                    self.flip(pair, [from, to], apexes) || self.split_near(pair, [from, to], apexes, sample);
                (done, sample)
            }
            Fault::Ridge(ridge) => (!self.misses_ridge(ridge) || self.put_back_ridge(ridge), ridge.sample),
            Fault::Chord(triangle, [from, to]) => {
                let Some((pair, apexes)) = self.surface.at_edge(triangle, from, to) else { return };
                let middle = self.position(from).midpoint(self.position(to));
                let done =
                    self.flip(pair, [from, to], apexes) || self.split_near(pair, [from, to], apexes, middle);
                (done, middle)
            }
        };
        if !done {
            let vertices = self.vertices_of(&fault);
            let hints = vertices.iter().map(|&vertex| self.hint(vertex, place));
            let hint = hints.into_iter().find(|&hint| hint != NONE).unwrap_or(NONE);
            if self.put_back_near(place) || self.flip_back_near(hint, place) {
                self.faults.push_back(fault);
            } else {
                failed.extend(self.vertices_of(&fault));
            }
        }
    }

    /// Joins the corners across from an edge instead, if the new edge stays near.
    fn flip(&mut self, pair: [u32; 2], ends: [u32; 2], apexes: [u32; 2]) -> bool {
        let normal = self.surface.normal(pair[0]) + self.surface.normal(pair[1]);
        self.stray_sample(apexes[0], apexes[1], normal).is_none() && self.turn(pair, ends, apexes)
    }

    /// Joins the corners across from an edge instead, unless they are joined already.
    fn turn(&mut self, pair: [u32; 2], [from, to]: [u32; 2], [apex, beyond]: [u32; 2]) -> bool {
        let border = &self.by.topology.border;
        // Around a vertex inside of the patch all edges are known.
        let is_free = !border[apex as usize] || !border[beyond as usize];
        is_free
            && !self.by.topology.joined(&self.surface, apex, beyond)
            && self.replace(&pair, &[[apex, from, beyond], [beyond, to, apex]])
    }

    /// Puts the nearest absent vertex back of those that can be.
    fn put_back_near(&mut self, place: Vec3) -> bool {
        self.absent_near(place).into_iter().any(|vertex| self.put_back(vertex))
    }

    /// Flips an edge near a place for one that the patch had before, if there is such.
    fn flip_back_near(&mut self, hint: u32, place: Vec3) -> bool {
        self.surface.around(hint, place, self.by.distance).into_iter().any(|triangle| {
            edges(self.surface.triangles[triangle as usize]).into_iter().any(|[from, to]| {
                let Some((pair, [apex, beyond])) = self.surface.at_edge(triangle, from, to) else {
                    return false;
                };
                !self.had_edge(from, to)
                    && self.had_edge(apex, beyond)
                    && self.flip(pair, [from, to], [apex, beyond])
            })
        })
    }

    /// Whether a vertex is gone that can be put back.
    fn is_absent(&self, vertex: u32) -> bool {
        !self.surface.has(vertex) && (self.by.before.has(vertex) || (self.by.is_free)(vertex))
    }

    /// The absent vertices around `place`, the nearest first.
    fn absent_near(&self, place: Vec3) -> Vec<u32> {
        let mut absent = self.by.points.within(place - AROUND, place + AROUND);
        absent.retain(|&vertex| self.is_absent(vertex));
        let squared = |vertex: u32| self.position(vertex).distance_squared(place);
        absent.sort_by(|&a, &b| squared(a).total_cmp(&squared(b)).then(a.cmp(&b)));
        absent
    }

    /// Puts an end of an edge of the reference back, or else the edge itself.
    fn put_back_ridge(&mut self, ridge: Ridge) -> bool {
        let [from, to] = ridge.ends;
        if let Some(&absent) = ridge.ends.iter().find(|&&end| self.is_absent(end)) {
            let put = self.put_back(absent);
            // Perhaps that is not enough.
            self.faults.extend(put.then_some(Fault::Ridge(ridge)));
            return put;
        }
        if self.is_chord(from, to) && !self.had_edge(from, to) {
            return false;
        }
        // Edges that cross it are flipped until it is there, from its ends on, so that each crosses it no more.
        let normal = self.by.normals[from as usize] + self.by.normals[to as usize];
        let crossing = self.surface.crossing(from, to, normal);
        let flipped = [crossing.first(), crossing.last()].into_iter().flatten().any(|&(triangle, [a, b])| {
            let pair = self.surface.at_edge(triangle, a, b);
            pair.is_some_and(|(pair, apexes)| self.turn(pair, [a, b], apexes))
        });
        self.faults.extend(flipped.then_some(Fault::Ridge(ridge)));
        flipped
    }

    /// Splits an edge at the absent vertex that is nearest to `middle`.
    fn split_near(
        &mut self,
        pair: [u32; 2],
        [from, to]: [u32; 2],
        [apex, beyond]: [u32; 2],
        middle: Vec3,
    ) -> bool {
        let Some(&vertex) = self.absent_near(middle).first() else { return false };
        let parts = [[from, vertex, apex], [vertex, to, apex], [to, vertex, beyond], [vertex, from, beyond]];
        self.replace(&pair, &parts)
    }

    /// Splits the nearest triangle at `vertex`, or the two at its nearest edge. Whether that could be done.
    fn put_back(&mut self, vertex: u32) -> bool {
        if !self.is_absent(vertex) {
            return false;
        }
        let (place, normal) = (self.position(vertex), self.by.normals[vertex as usize]);
        let Some((triangle, weights)) =
            self.surface.nearest(self.hint(vertex, place), place, normal, self.by.distance)
        else {
            return false;
        };
        let corners = self.surface.triangles[triangle as usize];
        let mut sides = [0, 1, 2];
        sides.sort_by(|&a: &usize, &b| weights[a].total_cmp(&weights[b]));
        let thirds = [0, 1, 2].map(|i| [corners[i], corners[(i + 1) % 3], vertex]);
        if weights[sides[0]] >= EDGE_WEIGHT && self.replace(&[triangle], &thirds) {
            return true;
        }
        for side in sides {
            // Across from the corner with the least weight first.
            let [from, to] = [corners[(side + 1) % 3], corners[(side + 2) % 3]];
            let Some((pair, [apex, beyond])) = self.surface.at_edge(triangle, from, to) else { continue };
            let parts =
                [[from, vertex, apex], [vertex, to, apex], [to, vertex, beyond], [vertex, from, beyond]];
            if self.replace(&pair, &parts) {
                return true;
            }
        }
        self.replace(&[triangle], &thirds)
    }

    /// Replaces triangles, and looks at all that this can have harmed.
    fn replace(&mut self, whole: &[u32], parts: &[[u32; 3]]) -> bool {
        let corners = whole.iter().flat_map(|&triangle| self.surface.corners(triangle));
        let [lo, hi] =
            corners.map(|p| [p, p]).reduce(|[lo, hi], [p, _]| [lo.min(p), hi.max(p)]).unwrap_or_default();
        let Some(numbers) = self.surface.replace(whole, parts) else { return false };
        self.changes += 1;
        for number in numbers {
            // Its edges are looked at from its own side, and those that were its neighbours' business from theirs.
            self.look_at_edges(number);
        }
        parts.as_flattened().iter().for_each(|&v| self.homes[v as usize] = self.surface.at(v));
        let reach = self.by.distance;
        let mut harmed = self.by.points.within(lo - reach, hi + reach);
        harmed.retain(|&vertex| {
            whole.contains(&self.homes[vertex as usize]) || parts.as_flattened().contains(&vertex)
        });
        for &vertex in &harmed {
            self.look_at_vertex(vertex);
        }
        for &vertex in &harmed {
            let around: Vec<u32> = self.by.reference.star(vertex).collect();
            for triangle in around {
                let corners = self.by.reference.triangles[triangle as usize];
                let corner = corners.iter().position(|&corner| corner == vertex).unwrap_or_default();
                self.look_at_ridge(triangle, [vertex, corners[(corner + 1) % 3]]);
            }
        }
        true
    }
}

fn cosine(m: Vec3, n: Vec3) -> f32 {
    m.dot(n) / (m.length() * n.length()).max(f32::MIN_POSITIVE)
}
