//! Checks whether a mesh is closed, oriented and 2-manifold, and where it is not.
//!
//! Every vertex is checked separately. The check finds out whether shared edges connect all
//! triangles around the vertex, and examines each edge to a higher-numbered vertex. It needs no
//! hash table, and sorts only the few edges of a vertex. Findings are in vertex order for any
//! number of threads.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;

use super::Mesh;

/// Number of vertices per task: enough to make the task's overhead negligible.
const CHUNK: usize = 1 << 14;

/// The number of occurrences of a defect, and the first occurrence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Defects<T> {
    /// Number of occurrences.
    pub count: usize,
    /// The first occurrence, in vertex or triangle order.
    pub first: Option<T>,
}

impl<T> Default for Defects<T> {
    fn default() -> Self {
        Self { count: 0, first: None }
    }
}

impl<T> Defects<T> {
    /// Whether there is no occurrence.
    #[must_use]
    pub fn is_none(&self) -> bool {
        self.count == 0
    }

    fn note(&mut self, what: T) {
        self.count += 1;
        self.first.get_or_insert(what);
    }

    /// Adds the occurrences of a later part of the mesh.
    fn append(&mut self, later: Self) {
        self.count += later.count;
        self.first = self.first.take().or(later.first);
    }
}

impl<T> FromIterator<T> for Defects<T> {
    fn from_iter<I: IntoIterator<Item = T>>(all: I) -> Self {
        let mut found = Self::default();
        all.into_iter().for_each(|what| found.note(what));
        found
    }
}

/// The connectivity of a mesh's triangles, without positions.
///
/// Triangles with a missing vertex or a repeated vertex are counted and then ignored, so that they
/// do not cause other defects. An edge is counted in at most one class of defects.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Topology {
    /// Number of pairs of vertices that a triangle connects.
    pub edges: usize,
    /// Number of triangles with three different existing vertices.
    pub sound_triangles: usize,
    /// Triangles with a missing vertex, by their number.
    pub out_of_range: Defects<usize>,
    /// Triangles with a repeated vertex, by their number.
    pub degenerate_triangles: Defects<usize>,
    /// Edges with only one triangle, by their ends.
    pub boundary_edges: Defects<[u32; 2]>,
    /// Edges that both triangles traverse in the same direction, by their ends.
    pub misoriented_edges: Defects<[u32; 2]>,
    /// Edges with more than two triangles, by their ends.
    pub crowded_edges: Defects<[u32; 2]>,
    /// Vertices whose triangles form more than one fan.
    pub pinched_vertices: Defects<u32>,
    /// Triangles with the same three vertices as an earlier triangle, in any orientation.
    ///
    /// A twin is not a defect by itself, because two triangles back to back can form a closed
    /// manifold. All other twins also cause `crowded_edges` or `misoriented_edges`.
    pub twin_triangles: Defects<[u32; 3]>,
    /// Vertices without a sound triangle. They are not a defect.
    pub unreferenced_vertices: Defects<u32>,
}

impl Topology {
    /// Whether no edge is on a boundary.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.boundary_edges.is_none()
    }

    /// Whether no two triangles traverse an edge in the same direction. If three triangles share an
    /// edge, at least two of them traverse the edge in the same direction.
    #[must_use]
    pub fn is_oriented(&self) -> bool {
        self.misoriented_edges.is_none() && self.crowded_edges.is_none()
    }

    /// Whether all triangles are sound, no edge has more than two triangles, and the triangles at
    /// each vertex form one fan.
    #[must_use]
    pub fn is_manifold(&self) -> bool {
        self.out_of_range.is_none()
            && self.degenerate_triangles.is_none()
            && self.crowded_edges.is_none()
            && self.pinched_vertices.is_none()
    }

    /// Whether the mesh is closed, oriented and 2-manifold. Every directed edge and its reverse
    /// then occur exactly once.
    #[must_use]
    pub fn is_closed_oriented_manifold(&self) -> bool {
        self.is_closed() && self.is_oriented() && self.is_manifold()
    }

    fn append(mut self, later: Self) -> Self {
        self.edges += later.edges;
        self.boundary_edges.append(later.boundary_edges);
        self.misoriented_edges.append(later.misoriented_edges);
        self.crowded_edges.append(later.crowded_edges);
        self.pinched_vertices.append(later.pinched_vertices);
        self.twin_triangles.append(later.twin_triangles);
        self.unreferenced_vertices.append(later.unreferenced_vertices);
        self
    }
}

/// The findings of [`check`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CheckReport {
    /// The number of vertices, referenced or not.
    pub vertices: usize,
    /// The number of triangles, sound or not.
    pub triangles: usize,
    /// The connectivity of the triangles.
    #[serde(flatten)]
    pub topology: Topology,
    /// Vertices with a coordinate that is not finite.
    pub non_finite_positions: Defects<usize>,
    /// Vertices with exactly the position of an earlier vertex. They are not a defect, because
    /// meshes may touch themselves.
    pub duplicate_positions: Defects<usize>,
}

impl CheckReport {
    /// Whether the mesh is closed, oriented and 2-manifold, and all positions are finite.
    #[must_use]
    pub fn is_closed_oriented_manifold(&self) -> bool {
        self.topology.is_closed_oriented_manifold() && self.non_finite_positions.is_none()
    }
}

/// Checks all triangles, edges, vertices and positions of `mesh`.
#[must_use]
pub fn check(mesh: &Mesh) -> CheckReport {
    let non_finite =
        mesh.positions.iter().enumerate().filter(|(_, p)| !p.iter().all(|x| x.is_finite()));
    CheckReport {
        vertices: mesh.positions.len(),
        triangles: mesh.triangles.len(),
        topology: topology(mesh),
        non_finite_positions: non_finite.map(|(vertex, _)| vertex).collect(),
        duplicate_positions: duplicate_positions(&mesh.positions),
    }
}

/// Checks only the triangles of `mesh`.
pub fn topology(mesh: &Mesh) -> Topology {
    let vertices = mesh.positions.len();
    let mut triangles = Topology::default();
    for (number, &triangle) in mesh.triangles.iter().enumerate() {
        if is_sound(triangle, vertices) {
            triangles.sound_triangles += 1;
        } else if triangle.iter().any(|&v| v as usize >= vertices) {
            triangles.out_of_range.note(number);
        } else {
            triangles.degenerate_triangles.note(number);
        }
    }
    let stars = Stars::new(mesh.positions.len(), &mesh.triangles);
    // Vertices whose numbers exceed u32 are in no triangle. Therefore, `as` truncates only numbers
    // of unreferenced vertices.
    let chunks: Vec<Topology> = (0..vertices.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut survey = Survey::default();
            for vertex in chunk * CHUNK..((chunk + 1) * CHUNK).min(vertices) {
                survey.visit(vertex as u32, stars.of(vertex));
            }
            survey.topology
        })
        .collect();
    chunks.into_iter().fold(triangles, Topology::append)
}

/// A side of a triangle, seen from the current vertex.
#[derive(Clone, Copy)]
struct Spoke {
    /// The vertex at the other end.
    to: u32,
    /// Whether the triangle traverses the side away from the current vertex.
    outward: bool,
    /// Index of the triangle in the star.
    triangle: usize,
}

/// Findings so far, and reusable buffers.
#[derive(Default)]
struct Survey {
    topology: Topology,
    spokes: Vec<Spoke>,
    fan_of: Vec<usize>,
    opposite: Vec<[u32; 2]>,
}

impl Survey {
    fn visit(&mut self, vertex: u32, star: &[[u32; 2]]) {
        if star.is_empty() {
            self.topology.unreferenced_vertices.note(vertex);
            return;
        }
        self.spokes.clear();
        for (triangle, &[next, last]) in star.iter().enumerate() {
            self.spokes.push(Spoke { to: next, outward: true, triangle });
            self.spokes.push(Spoke { to: last, outward: false, triangle });
        }
        self.spokes.sort_unstable_by_key(|spoke| spoke.to);
        self.note_edges(vertex);
        if self.fans(star.len()) > 1 {
            self.topology.pinched_vertices.note(vertex);
        }
        self.note_twins(vertex, star);
    }

    /// Counts the edges of a vertex, and their defects. Every edge is counted at its lower-numbered
    /// end.
    fn note_edges(&mut self, vertex: u32) {
        for edge in self.spokes.chunk_by(|a, b| a.to == b.to).filter(|edge| edge[0].to > vertex) {
            let ends = [vertex, edge[0].to];
            self.topology.edges += 1;
            match edge {
                [_] => self.topology.boundary_edges.note(ends),
                [one, other] if one.outward == other.outward => {
                    self.topology.misoriented_edges.note(ends)
                }
                [_, _] => {}
                _ => self.topology.crowded_edges.note(ends),
            }
        }
    }

    /// The number of fans; triangles that share a spoke are in the same fan.
    fn fans(&mut self, triangles: usize) -> usize {
        self.fan_of.clear();
        self.fan_of.extend(0..triangles);
        let mut fans = triangles;
        for pair in self.spokes.windows(2).filter(|pair| pair[0].to == pair[1].to) {
            let [one, other] = [0, 1].map(|side| root(&mut self.fan_of, pair[side].triangle));
            if one != other {
                self.fan_of[one.max(other)] = one.min(other);
                fans -= 1;
            }
        }
        fans
    }

    /// Finds twin triangles at a vertex. Every triangle is counted at its lowest-numbered vertex.
    fn note_twins(&mut self, vertex: u32, star: &[[u32; 2]]) {
        self.opposite.clear();
        let least = star.iter().filter(|[a, b]| vertex < *a.min(b));
        self.opposite.extend(least.map(|&[a, b]| [a.min(b), a.max(b)]));
        self.opposite.sort_unstable();
        for pair in self.opposite.windows(2).filter(|pair| pair[0] == pair[1]) {
            let [a, b] = pair[0];
            self.topology.twin_triangles.note([vertex, a, b]);
        }
    }
}

/// The lowest member of the set that contains `member`.
fn root(set_of: &mut [usize], mut member: usize) -> usize {
    while set_of[member] != member {
        set_of[member] = set_of[set_of[member]];
        member = set_of[member];
    }
    member
}

/// Vertices with the position of a lower-numbered vertex.
fn duplicate_positions(positions: &[[f64; 3]]) -> Defects<usize> {
    let mut sorted: Vec<([u64; 3], usize)> = positions
        .par_iter()
        .enumerate()
        .map(|(vertex, position)| (position.map(f64::to_bits), vertex))
        .collect();
    sorted.par_sort_unstable();
    let repeated = || sorted.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| pair[1].1);
    Defects { count: repeated().count(), first: repeated().min() }
}

impl fmt::Display for CheckReport {
    /// Writes one line for each property, and one for each kind of defect that was found.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let topology = &self.topology;
        writeln!(
            f,
            "{} vertices, {} edges, {} triangles",
            self.vertices, topology.edges, self.triangles
        )?;
        for (property, holds) in [
            ("closed", topology.is_closed()),
            ("oriented", topology.is_oriented()),
            ("2-manifold", topology.is_manifold()),
        ] {
            writeln!(f, "{property}: {}", if holds { "yes" } else { "no" })?;
        }
        line(f, "edges with only one triangle", &topology.boundary_edges)?;
        line(f, "edges with two triangles in the same direction", &topology.misoriented_edges)?;
        line(f, "edges with more than two triangles", &topology.crowded_edges)?;
        line(f, "vertices with more than one fan of triangles", &topology.pinched_vertices)?;
        line(f, "triangles with a missing vertex", &topology.out_of_range)?;
        line(f, "triangles with a repeated vertex", &topology.degenerate_triangles)?;
        line(f, "triangles with the same vertices as another triangle", &topology.twin_triangles)?;
        line(f, "vertices that are not finite", &self.non_finite_positions)?;
        line(f, "vertices without a triangle", &topology.unreferenced_vertices)?;
        line(f, "vertices at the position of another vertex", &self.duplicate_positions)
    }
}

fn line<T: fmt::Debug>(f: &mut fmt::Formatter<'_>, what: &str, found: &Defects<T>) -> fmt::Result {
    match &found.first {
        Some(first) => writeln!(f, "{what}: {}, the first {first:?}", found.count),
        None => Ok(()),
    }
}

/// Whether a triangle has three different existing vertices.
pub fn is_sound([a, b, c]: [u32; 3], vertices: usize) -> bool {
    [a, b, c].iter().all(|&v| (v as usize) < vertices) && a != b && b != c && c != a
}

/// For each vertex, the opposite edges of its triangles, in triangle order: `[b, c]` for triangle
/// a, b, c seen from a. Unsound triangles are left out.
///
/// Takes 24 bytes per triangle and 8 bytes per vertex, with two passes over the triangles and one
/// pass over the vertices.
#[derive(Debug)]
pub struct Stars {
    ends: Vec<usize>,
    across: Vec<[u32; 2]>,
}

impl Stars {
    /// Collects the stars of a mesh with `vertices` vertices.
    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let sound = || triangles.iter().filter(|&&t| is_sound(t, vertices));
        let mut ends = vec![0; vertices];
        for &vertex in sound().flatten() {
            ends[vertex as usize] += 1;
        }
        // `ends` has the number of triangles of each vertex, which this loop replaces by the start
        // of the vertex's star. Filling the stars moves each start to the end of the star.
        let mut total = 0;
        for end in &mut ends {
            total += std::mem::replace(end, total);
        }
        let mut across = vec![[0; 2]; total];
        for &[a, b, c] in sound() {
            for (vertex, edge) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
                let end = &mut ends[vertex as usize];
                across[*end] = edge;
                *end += 1;
            }
        }
        Self { ends, across }
    }

    /// The edges opposite `vertex`.
    pub fn of(&self, vertex: usize) -> &[[u32; 2]] {
        let start = vertex.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.across[start..self.ends[vertex]]
    }

    /// Number of vertices, including vertices without triangles.
    pub fn vertices(&self) -> usize {
        self.ends.len()
    }
}
