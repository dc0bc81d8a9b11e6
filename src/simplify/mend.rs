//! Brings a simplified patch within its distance, by as little as possible: edges are flipped, vertices put back.

use std::collections::VecDeque;

use glam::Vec3;

use super::near::Near;
use super::surface::{Nearest, Surface, edges};
use super::topology::Topology;

/// Of the distance, what a sample may take: the rest is for what lies between samples.
const SAMPLE_SHARE: f32 = 0.95;
/// Samples along an edge are this far apart at the most, in cells. Around one that takes more than its share of doubt
/// there are more, so many either way.
const SAMPLE_STEP: f32 = 0.5;
const DOUBT_SHARE: f32 = 0.4;
const FINE: i32 = 4;
/// An edge of the reference is a ridge where the cosine between the normals beside it is less; a crest where it is
/// still less. Steps between samples are in cells; on a crest they are not above the distance either.
const RIDGE: f32 = 0.95;
const CREST: f32 = 0.5;
const RIDGE_STEP: f32 = 0.4;
const CREST_STEP: f32 = 0.15;
/// Within more than this, in cells, fit whole features of the surface: all edges are looked at.
const WIDE: f32 = 0.25;
/// How many changes are made, beyond one for every eight triangles.
const PATIENCE: usize = 100;
/// A point whose barycentric coordinate is less is put onto the edge, not into the triangle.
const EDGE_WEIGHT: f32 = 0.15;

/// What is wrong.
enum Fault {
    /// A vertex of the patch as it was has no triangle within the distance.
    Missed(u32),
    /// A sample of an edge of a triangle has no triangle of the reference within the distance.
    Stray(usize, [u32; 2], Vec3),
    /// A sample of a sharp edge of the reference has no triangle within the distance.
    Ridge(Ridge),
    /// An edge of a triangle between two vertices of the border that was none before.
    Chord(usize, [u32; 2]),
}

/// A sample of a sharp edge of the reference.
#[derive(Clone, Copy)]
pub struct Ridge {
    ends: [u32; 2],
    sample: Vec3,
    normal: Vec3,
}

/// The samples of all sharp edges.
pub struct Ridges {
    all: Vec<Ridge>,
    near: Near,
}

impl Ridges {
    /// Of a surface; those of sharper edges are closer together, for there the surface falls away faster.
    pub fn of(surface: &Surface, distance: f32) -> Self {
        let mut ridges = Vec::new();
        for triangle in 0..surface.triangles.len() {
            for [from, to] in edges(surface.triangles[triangle]).into_iter().filter(|[from, to]| from < to) {
                let Some((pair, _)) = surface.at_edge(triangle, from, to) else { continue };
                let [m, n] = pair.map(|triangle| surface.normal(triangle));
                let cosine = m.dot(n) / (m.length() * n.length()).max(f32::MIN_POSITIVE);
                if cosine < RIDGE || distance > WIDE {
                    let [p, q] = [from, to].map(|vertex| surface.positions[vertex as usize]);
                    let step = if cosine < CREST { CREST_STEP.min(distance) } else { RIDGE_STEP };
                    let samples = (p.distance(q) / step).ceil() as i32;
                    ridges.extend((0..samples).map(|i| {
                        let sample = p.lerp(q, (i as f32 + 0.5) / samples as f32);
                        Ridge { ends: [from, to], sample, normal: m + n }
                    }));
                }
            }
        }
        let samples: Vec<Vec3> = ridges.iter().map(|ridge| ridge.sample).collect();
        Self { all: ridges, near: Near::points(&samples) }
    }
}

/// A simplified patch, and what it is measured by.
pub struct Mending<'a> {
    pub topology: &'a Topology<'a>,
    /// What it must not leave.
    pub reference: &'a Surface<'a>,
    /// Itself before it was simplified.
    pub before: &'a dyn Fn() -> &'a Surface<'a>,
    /// All vertices of the reference.
    pub points: &'a Near,
    /// Of the reference, for all vertices.
    pub normals: &'a [Vec3],
    pub ridges: &'a Ridges,
    pub distance: f32,
}

/// In progress.
struct Work<'a, 'b> {
    by: &'b Mending<'a>,
    surface: Surface<'a>,
    present: Vec<bool>,
    faults: VecDeque<Fault>,
    changes: usize,
}

impl<'a> Mending<'a> {
    /// Mends `surface`.
    ///
    /// # Errors
    /// The vertices where that cannot be done.
    pub fn mend(&self, surface: Surface<'a>) -> Result<Vec<[u32; 3]>, Vec<u32>> {
        let mut present = vec![false; surface.positions.len()];
        surface.triangles.as_flattened().iter().for_each(|&vertex| present[vertex as usize] = true);
        let mut work = Work { by: self, surface, present, faults: VecDeque::new(), changes: 0 };
        for vertex in 0..work.present.len() as u32 {
            work.look_at_vertex(vertex);
        }
        for triangle in 0..work.surface.triangles.len() {
            work.look_at_edges(triangle);
        }
        for ridge in 0..self.ridges.all.len() {
            work.look_at_ridge(ridge);
        }
        // Two faults can undo each other's mending for ever.
        let patience = PATIENCE + work.surface.triangles.len() / 8;
        let mut failed = Vec::new();
        while let Some(fault) = work.faults.pop_front() {
            if work.changes < patience {
                work.fix(fault, &mut failed);
            } else {
                failed.extend(work.vertices_of(&fault));
            }
        }
        if failed.is_empty() { Ok(work.surface.triangles) } else { Err(failed) }
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

    fn position(&self, vertex: u32) -> Vec3 {
        self.surface.positions[vertex as usize]
    }

    fn look_at_vertex(&mut self, vertex: u32) {
        if self.misses(vertex) {
            self.faults.push_back(Fault::Missed(vertex));
        }
    }

    /// What was too far from the patch before is another patch's business.
    fn misses(&self, vertex: u32) -> bool {
        !self.present[vertex as usize]
            && self.is_lost(self.position(vertex), self.by.normals[vertex as usize])
    }

    /// Whether a sample of the reference, where it faces this way, is too far from the surface, and was not before.
    fn is_lost(&self, sample: Vec3, normal: Vec3) -> bool {
        let (distance, within) = (self.by.distance, SAMPLE_SHARE * self.by.distance);
        if self.surface.holds(sample, normal, within) {
            return false;
        }
        let before = (self.by.before)();
        before.holds(sample, normal, within)
            || before.holds(sample, normal, distance) && !self.surface.holds(sample, normal, distance)
    }

    /// Looks at the new edges of a triangle, each from one side.
    fn look_at_edges(&mut self, triangle: usize) {
        for [from, to] in edges(self.surface.triangles[triangle]) {
            if from > to || self.by.topology.has_edge(from, to) {
                continue;
            }
            if self.by.topology.is_chord(from, to) {
                self.faults.push_back(Fault::Chord(triangle, [from, to]));
            } else if let Some(sample) = self.stray_sample(from, to, self.surface.normal(triangle)) {
                self.faults.push_back(Fault::Stray(triangle, [from, to], sample));
            }
        }
    }

    fn look_at_ridge(&mut self, number: usize) {
        let ridge = self.by.ridges.all[number];
        if self.misses_ridge(ridge) {
            self.faults.push_back(Fault::Ridge(ridge));
        }
    }

    fn misses_ridge(&self, Ridge { sample, normal, .. }: Ridge) -> bool {
        self.is_lost(sample, normal)
    }

    /// The first sample that is too far from the reference, of an edge whose triangles face this way.
    fn stray_sample(&self, from: u32, to: u32, normal: Vec3) -> Option<Vec3> {
        let [p, q] = [from, to].map(|vertex| self.position(vertex));
        let steps = ((p.distance(q) / SAMPLE_STEP).ceil() as i32).max(2);
        let at = |fine: i32| p.lerp(q, fine as f32 / (steps * 2 * FINE) as f32);
        let within =
            |sample: Vec3, share: f32| self.by.reference.holds(sample, normal, share * self.by.distance);
        (1..steps)
            .map(|step| step * 2 * FINE)
            .filter(|&step| !within(at(step), DOUBT_SHARE))
            .flat_map(|step| step - FINE..=step + FINE)
            .map(at)
            .find(|&sample| !within(sample, SAMPLE_SHARE))
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
            if self.put_back_near(place) || self.flip_back_near(place) {
                self.faults.push_back(fault);
            } else {
                failed.extend(self.vertices_of(&fault));
            }
        }
    }

    /// Joins the corners across from an edge instead, if that is better.
    fn flip(&mut self, pair: [usize; 2], [from, to]: [u32; 2], [apex, beyond]: [u32; 2]) -> bool {
        let border = self.by.topology.border();
        // Around a vertex inside of the patch all edges are known.
        let (hub, at) = if border[apex as usize] { (beyond, pair[1]) } else { (apex, pair[0]) };
        let other = apex ^ beyond ^ hub;
        if border[hub as usize]
            || self.by.topology.is_chord(apex, beyond)
            || self.surface.joined(at, hub, other)
            || self.is_stray_flip(pair, apex, beyond)
        {
            return false;
        }
        self.replace(&pair, &[[apex, from, beyond], [beyond, to, apex]])
    }

    fn is_stray_flip(&self, pair: [usize; 2], apex: u32, beyond: u32) -> bool {
        let normal = self.surface.normal(pair[0]) + self.surface.normal(pair[1]);
        self.stray_sample(apex, beyond, normal).is_some()
    }

    /// Puts the nearest absent vertex of the reference back of those that can be.
    fn put_back_near(&mut self, place: Vec3) -> bool {
        let mut absent = self.absent_near(place);
        absent.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        absent.into_iter().any(|(_, vertex)| self.put_back(vertex))
    }

    /// Flips an edge near a place for one that the patch had before, if there is such.
    fn flip_back_near(&mut self, place: Vec3) -> bool {
        let near: Vec<u32> = self.surface.near(place).to_vec();
        near.into_iter().any(|triangle| {
            edges(self.surface.triangles[triangle as usize]).into_iter().any(|[from, to]| {
                let Some((pair, [apex, beyond])) = self.surface.at_edge(triangle as usize, from, to) else {
                    return false;
                };
                !self.by.topology.has_edge(from, to)
                    && self.by.topology.has_edge(apex, beyond)
                    && self.flip(pair, [from, to], [apex, beyond])
            })
        })
    }

    fn absent_near(&self, place: Vec3) -> Vec<(f32, u32)> {
        let near = self.by.points.within(place - 1.0, place + 1.0);
        let absent = near.into_iter().filter(|&vertex| !self.present[vertex as usize]);
        absent.map(|vertex| (self.position(vertex).distance_squared(place), vertex)).collect()
    }

    /// Puts an end of an edge of the reference back, or else the edge itself.
    fn put_back_ridge(&mut self, ridge: Ridge) -> bool {
        let [from, to] = ridge.ends;
        if let Some(&absent) = ridge.ends.iter().find(|&&end| !self.present[end as usize]) {
            let put = self.put_back(absent);
            // Perhaps that is not enough.
            self.faults.extend(put.then_some(Fault::Ridge(ridge)));
            return put;
        }
        let Some((triangle, across)) = self.surface.edge_between(from, to) else { return false };
        let corners = self.surface.triangles[triangle];
        let Some((pair, apexes)) = self.surface.at_edge(triangle, corners[across], corners[(across + 1) % 3])
        else {
            return false;
        };
        if self.by.topology.is_chord(from, to) && !self.by.topology.has_edge(from, to) {
            return false;
        }
        let [apex, beyond] = apexes;
        let [a, b] = [corners[across], corners[(across + 1) % 3]];
        self.replace(&pair, &[[apex, a, beyond], [beyond, b, apex]])
    }

    /// Splits an edge at the absent vertex that is nearest to `middle`.
    fn split_near(
        &mut self,
        pair: [usize; 2],
        [from, to]: [u32; 2],
        [apex, beyond]: [u32; 2],
        middle: Vec3,
    ) -> bool {
        let absent = self.absent_near(middle).into_iter();
        let Some((_, vertex)) = absent.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))) else {
            return false;
        };
        let parts = [[from, vertex, apex], [vertex, to, apex], [to, vertex, beyond], [vertex, from, beyond]];
        self.replace(&pair, &parts)
    }

    /// Splits the nearest triangle at `vertex`, or the two at its nearest edge. Whether that could be done.
    fn put_back(&mut self, vertex: u32) -> bool {
        let Some(Nearest { triangle, weights, .. }) =
            self.surface.nearest(self.position(vertex), self.by.normals[vertex as usize])
        else {
            return false;
        };
        let corners = self.surface.triangles[triangle];
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
    fn replace(&mut self, whole: &[usize], parts: &[[u32; 3]]) -> bool {
        let corners = whole.iter().flat_map(|&triangle| self.surface.corners(triangle));
        let [lo, hi] =
            corners.map(|p| [p, p]).reduce(|[lo, hi], [p, _]| [lo.min(p), hi.max(p)]).unwrap_or_default();
        let Some(numbers) = self.surface.replace(whole, parts) else { return false };
        self.changes += 1;
        parts.as_flattened().iter().for_each(|&vertex| self.present[vertex as usize] = true);
        for number in numbers {
            // Its edges are looked at from its own side, and those that were its neighbours' business from theirs.
            self.look_at_edges(number);
        }
        let reach = self.by.distance;
        let harmed = self.by.points.within(lo - reach, hi + reach);
        harmed.into_iter().for_each(|vertex| self.look_at_vertex(vertex));
        let harmed = self.by.ridges.near.within(lo - reach, hi + reach);
        harmed.into_iter().for_each(|ridge| self.look_at_ridge(ridge as usize));
        true
    }
}
