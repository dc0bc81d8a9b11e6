//! Does a simplified patch hang together as the one that it replaces, so that the mesh around it stays a
//! closed, oriented 2-manifold?
//!
//! All is decided at the patch's own vertices. Around a vertex inside of the patch the triangles form one closed
//! fan, as everywhere on a 2-manifold. Around a vertex of its border they form fans between the same border edges as
//! before. Patches share no vertices, so a new edge can only meet its like among the triangles between them: an edge
//! between two vertices of the border (a chord) must have been there before, if there may be one outside.

use glam::Vec3;

use super::drops::root;
use super::surface::{Surface, edges};

/// Two triangles fold back on each other when the cosine between their normals is below this: 170 degrees.
const FOLD: f32 = -0.985;

/// The triangles around a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outside {
    /// As marching cubes made them: each lies in one dual cell.
    DualCells,
    /// Of any size.
    Simplified,
}

impl Outside {
    fn may_join(self, p: Vec3, q: Vec3) -> bool {
        match self {
            Self::Simplified => true,
            Self::DualCells => {
                // Dual cells reach from centre to centre; positions are rounded.
                let slack = 1e-3;
                let [lo, hi] = [p.min(q) - 0.5, p.max(q) - 0.5];
                hi.cmple((lo + slack).floor() + (1.0 + slack)).all()
            }
        }
    }
}

/// What a patch must keep.
pub struct Topology {
    /// The vertices on the border, which other patches use, too.
    pub border: Vec<bool>,
    outside: Outside,
    /// Around each vertex of the border the ends of its open fans, sorted.
    fans: Vec<Fan>,
    /// For each closed component its vertices: they must not all vanish.
    drops: Drops,
    /// Vertices less half the triangles: with the border, the Euler characteristic.
    euler: i64,
}

/// A vertex of the border, and the ends of a chain of triangles around it.
type Fan = [u32; 3];

impl Topology {
    /// Of a patch that is oriented, and manifold but for its border.
    pub fn of(patch: &Surface, outside: Outside) -> Self {
        let mut border = vec![false; patch.positions.len()];
        let fans = open_fans(patch, |_| ());
        fans.iter().for_each(|&[vertex, ..]| border[vertex as usize] = true);
        let drops = Drops::of(&border, &patch.triangles);
        let euler = euler(patch.positions.len(), &patch.triangles);
        Self { border, outside, fans, drops, euler }
    }

    /// Whether there may be an edge between the two outside of the patch.
    pub fn is_chord(&self, patch: &Surface, a: u32, b: u32) -> bool {
        let [p, q] = [a, b].map(|vertex| patch.positions[vertex as usize]);
        self.border[a as usize] && self.border[b as usize] && self.outside.may_join(p, q)
    }

    /// Whether there is an edge between two vertices. Of those inside of the patch all triangles are known.
    pub fn joined(&self, surface: &Surface, a: u32, b: u32) -> bool {
        let [inner, other] = if self.border[a as usize] { [b, a] } else { [a, b] };
        surface.joined(inner, other) || self.border[inner as usize] && surface.joined(other, inner)
    }

    /// The vertices at which `simplified` does not hang together as `before`, sorted; none where it may take its
    /// place. Where the fault has no place, all vertices that are left.
    pub fn offenders(&self, before: &Surface, simplified: &Surface) -> Vec<u32> {
        let mut offenders = self.misfits(simplified);
        for (number, &triangle) in simplified.triangles.iter().enumerate() {
            for [from, to] in edges(triangle).into_iter().filter(|[from, to]| from < to) {
                let Some((pair, apexes)) = simplified.at_edge(number as u32, from, to) else { continue };
                let [m, n] = pair.map(|triangle| simplified.normal(triangle));
                let is_fold = m.dot(n) < FOLD * m.length() * n.length();
                let is_old =
                    |triangle: u32| before.number_of(simplified.triangles[triangle as usize]).is_some();
                if is_fold && !pair.into_iter().all(is_old)
                    || self.is_chord(before, from, to) && !self.joined(before, from, to)
                {
                    offenders.extend([from, to]);
                    offenders.extend(apexes);
                }
            }
        }
        if offenders.is_empty() && euler(simplified.positions.len(), &simplified.triangles) != self.euler {
            offenders.extend_from_slice(simplified.triangles.as_flattened());
        }
        offenders.sort_unstable();
        offenders.dedup();
        offenders
    }

    /// Vertices, and those around them, whose triangles do not form fans as they should.
    fn misfits(&self, simplified: &Surface) -> Vec<u32> {
        let mut closed = vec![0; simplified.positions.len()];
        simplified.triangles.as_flattened().iter().for_each(|&vertex| closed[vertex as usize] += 1);
        let fans = open_fans(simplified, |vertex| closed[vertex as usize] -= 1);
        let is_sound = |(vertex, &closed): (u32, &usize)| {
            closed == 0
                || !self.border[vertex as usize] && closed > 2 && simplified.star(vertex).count() == closed
        };
        let mut is_misfit: Vec<bool> = (0..).zip(&closed).map(|vertex| !is_sound(vertex)).collect();
        let own = |fan: &&Fan| self.border[fan[0] as usize];
        fans.iter().filter(|fan| !own(fan)).for_each(|fan| is_misfit[fan[0] as usize] = true);
        // Fans of the border that are there before or after only.
        for [some, others] in [[&self.fans, &fans], [&fans, &self.fans]] {
            for fan in some.iter().filter(|fan| others.binary_search(fan).is_err()) {
                is_misfit[fan[0] as usize] = true;
            }
        }
        let misfits = (0..closed.len() as u32).filter(|&vertex| is_misfit[vertex as usize]);
        let mut around: Vec<u32> = misfits.collect();
        let corners = simplified.triangles.iter();
        let touched = corners.filter(|corners| corners.iter().any(|&corner| is_misfit[corner as usize]));
        around.extend(touched.flatten());
        around
    }

    /// Puts components of the patch, as they were in `triangles`, back to where nothing is left of them.
    pub fn restore_components(&self, triangles: &[[u32; 3]], simplified: &mut Vec<[u32; 3]>) {
        if self.drops.members.is_empty() {
            return;
        }
        let mut left = vec![false; self.border.len()];
        simplified.as_flattened().iter().for_each(|&vertex| left[vertex as usize] = true);
        let mut lost = vec![false; self.border.len()];
        for drop in self.drops.members.chunk_by(|a, b| a.0 == b.0) {
            if drop.iter().all(|&(_, vertex)| !left[vertex as usize]) {
                drop.iter().for_each(|&(_, vertex)| lost[vertex as usize] = true);
            }
        }
        simplified.extend(triangles.iter().filter(|triangle| lost[triangle[0] as usize]));
    }
}

/// All fans that are no closed circles, sorted; calls `visit` with the vertex of each for each of its triangles.
fn open_fans(surface: &Surface, mut visit: impl FnMut(u32)) -> Vec<Fan> {
    let mut fans = Vec::new();
    for triangle in 0..surface.triangles.len() as u32 {
        for [vertex, next] in surface.open_edges(triangle) {
            let mut end = triangle;
            let mut last = surface.before(end, vertex);
            visit(vertex);
            while let Some((pair, [_, beyond])) = surface.at_edge(end, last, vertex) {
                visit(vertex);
                (end, last) = (pair[1], beyond);
            }
            fans.push([vertex, next, last]);
        }
    }
    fans.sort_unstable();
    fans
}

/// Used vertices, twice, less the triangles.
fn euler(vertices: usize, triangles: &[[u32; 3]]) -> i64 {
    let mut used = vec![false; vertices];
    for &vertex in triangles.as_flattened() {
        used[vertex as usize] = true;
    }
    2 * used.iter().filter(|&&used| used).count() as i64 - triangles.len() as i64
}

/// The components that lie within a patch, and could vanish without a trace.
struct Drops {
    /// Component and vertex, sorted.
    members: Vec<(u32, u32)>,
}

impl Drops {
    fn of(border: &[bool], triangles: &[[u32; 3]]) -> Self {
        let mut lesser: Vec<u32> = (0..border.len() as u32).collect();
        let mut used = vec![false; border.len()];
        for &[a, b, c] in triangles {
            let roots = [a, b, c].map(|vertex| root(&mut lesser, vertex));
            let least = roots.into_iter().min().expect("there are three");
            roots.into_iter().for_each(|root| lesser[root as usize] = least);
            [a, b, c].into_iter().for_each(|vertex| used[vertex as usize] = true);
        }
        let mut open = vec![false; border.len()];
        for vertex in 0..border.len() as u32 {
            if border[vertex as usize] {
                open[root(&mut lesser, vertex) as usize] = true;
            }
        }
        let members = (0..border.len() as u32).filter(|&vertex| used[vertex as usize]);
        let mut members: Vec<(u32, u32)> =
            members.map(|vertex| (root(&mut lesser, vertex), vertex)).collect();
        members.retain(|&(component, _)| !open[component as usize]);
        members.sort_unstable();
        Self { members }
    }
}
