//! Does a simplified patch hang together as the one that it replaces, so that the mesh around it stays a
//! closed, oriented 2-manifold?
//!
//! All is decided at the patch's own vertices. Around a vertex inside of the patch the triangles form one closed
//! fan, as everywhere on a 2-manifold. Around a vertex of its border they form fans between the same border edges as
//! before. Patches share no vertices, so a new edge can only meet its like among the triangles between them: an edge
//! between two vertices of the border (a chord) must have been there before, if there may be one outside.

use glam::Vec3;

use crate::mesh::stars::Stars;

use super::drops::root;

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
pub struct Topology<'a> {
    positions: &'a [Vec3],
    stars: Stars,
    border: Vec<bool>,
    outside: Outside,
    /// For each closed component its vertices: they must not all vanish.
    drops: Drops,
    /// Vertices less half the triangles: with the border, the Euler characteristic.
    euler: i64,
}

/// The triangles around a vertex, as chains of the vertices across from it.
#[derive(PartialEq, Eq, Debug)]
struct Fans {
    /// The ends of open fans, sorted.
    open: Vec<[u32; 2]>,
    closed: usize,
}

impl<'a> Topology<'a> {
    /// Of a patch that is oriented, and manifold but for its border.
    pub fn of(positions: &'a [Vec3], triangles: &[[u32; 3]], outside: Outside) -> Self {
        let stars = Stars::new(positions.len(), triangles);
        let border: Vec<bool> = (0..positions.len()).map(|v| is_open(stars.of(v))).collect();
        let drops = Drops::of(&border, triangles);
        let euler = euler(positions.len(), triangles);
        Self { positions, stars, border, outside, drops, euler }
    }

    /// The vertices on the border, which other patches use, too.
    pub fn border(&self) -> &[bool] {
        &self.border
    }

    /// Whether there may be an edge between the two outside of the patch.
    pub fn is_chord(&self, a: u32, b: u32) -> bool {
        let [p, q] = [a, b].map(|vertex| self.positions[vertex as usize]);
        self.border[a as usize] && self.border[b as usize] && self.outside.may_join(p, q)
    }

    /// Whether the patch had an edge between the two.
    pub fn has_edge(&self, a: u32, b: u32) -> bool {
        self.stars.of(a as usize).as_flattened().contains(&b)
    }

    fn has_triangle(&self, [a, b, c]: [u32; 3]) -> bool {
        self.stars.of(a as usize).contains(&[b, c])
    }

    /// The vertices at which `simplified` does not hang together as it should, sorted; none where it may take
    /// the patch's place. Where the fault has no place, all vertices that are left.
    pub fn offenders(&self, simplified: &[[u32; 3]]) -> Vec<u32> {
        let stars = Stars::new(self.positions.len(), simplified);
        let mut offenders = Vec::new();
        for vertex in 0..self.positions.len() {
            self.judge(vertex as u32, stars.of(vertex), &mut offenders);
        }
        if offenders.is_empty() && euler(self.positions.len(), simplified) != self.euler {
            offenders.extend_from_slice(simplified.as_flattened());
        }
        offenders.sort_unstable();
        offenders.dedup();
        offenders
    }

    /// Puts components of the patch, as they were in `triangles`, back to where nothing is left of them.
    pub fn restore_components(&self, triangles: &[[u32; 3]], simplified: &mut Vec<[u32; 3]>) {
        let mut left = vec![false; self.positions.len()];
        simplified.as_flattened().iter().for_each(|&vertex| left[vertex as usize] = true);
        let mut lost = vec![false; self.positions.len()];
        for drop in self.drops.members.chunk_by(|a, b| a.0 == b.0) {
            if drop.iter().all(|&(_, vertex)| !left[vertex as usize]) {
                drop.iter().for_each(|&(_, vertex)| lost[vertex as usize] = true);
            }
        }
        simplified.extend(triangles.iter().filter(|triangle| lost[triangle[0] as usize]));
    }

    fn judge(&self, vertex: u32, star: &[[u32; 2]], offenders: &mut Vec<u32>) {
        let is_border = self.border[vertex as usize];
        if star.is_empty() && !is_border {
            return;
        }
        let sound = match fans(star) {
            None => false,
            Some(fans) if is_border => Some(fans) == self::fans(self.stars.of(vertex as usize)),
            Some(fans) => fans == Fans { open: Vec::new(), closed: 1 } && star.len() > 2,
        };
        if !sound {
            offenders.push(vertex);
            offenders.extend_from_slice(star.as_flattened());
        }
        for &[next, last] in star {
            if self.is_chord(vertex, next) && !self.has_edge(vertex, next) {
                offenders.extend([vertex, next]);
            }
            // Both triangles at an edge are seen from its ends; one is enough.
            let across = star.iter().find(|other| other[0] == last);
            if let Some(&[_, beyond]) = across
                && vertex < last
                && self.is_new_fold([vertex, next, last], [vertex, last, beyond])
            {
                offenders.extend([vertex, next, last, beyond]);
            }
        }
    }

    fn is_new_fold(&self, one: [u32; 3], other: [u32; 3]) -> bool {
        let [m, n] = [one, other].map(|triangle| self.scaled_normal(triangle));
        m.dot(n) < FOLD * m.length() * n.length() && !(self.has_triangle(one) && self.has_triangle(other))
    }

    fn scaled_normal(&self, triangle: [u32; 3]) -> Vec3 {
        let [a, b, c] = triangle.map(|vertex| self.positions[vertex as usize]);
        (b - a).cross(c - a)
    }
}

/// Whether a spoke has a triangle on one side only.
fn is_open(star: &[[u32; 2]]) -> bool {
    star.iter().any(|&[next, _]| !star.iter().any(|&[_, last]| last == next))
        || star.iter().any(|&[_, last]| !star.iter().any(|&[next, _]| next == last))
}

/// The fans that a star falls into; nothing where a spoke is run along twice the same way.
fn fans(star: &[[u32; 2]]) -> Option<Fans> {
    let follower = |of: u32| star.iter().position(|&[next, _]| next == of);
    for (i, &[next, last]) in star.iter().enumerate() {
        if star[..i].iter().any(|other| other[0] == next || other[1] == last) {
            return None;
        }
    }
    let mut fans = Fans { open: Vec::new(), closed: 0 };
    let mut seen = 0;
    for &[next, last] in star.iter().filter(|[next, _]| !star.iter().any(|other| other[1] == *next)) {
        let mut end = last;
        seen += 1;
        while let Some(further) = follower(end) {
            end = star[further][1];
            seen += 1;
        }
        fans.open.push([next, end]);
    }
    fans.open.sort_unstable();
    if seen == star.len() {
        return Some(fans);
    }
    // What is left are circles; on a sound patch there is one at the most, and no open fan beside it.
    let start = star[0][0];
    let mut at = star[0][1];
    let mut around = 1;
    while at != start && around <= star.len() {
        at = star[follower(at)?][1];
        around += 1;
    }
    fans.closed = if seen == 0 && around == star.len() { 1 } else { 2 };
    Some(fans)
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
