//! Finds components that are smaller than a given volume, and drops with few particles.
//!
//! Each block's triangles are divided into parts; parts that share a vertex belong to one
//! component. A block's triangles refer only to vertices of the block itself and of later blocks,
//! so one pass over the blocks in order finds all vertices that blocks share.
//!
//! By the divergence theorem, the volume of a component is a sum over its triangles. Each part
//! stores its share of this sum, computed relative to a corner of its block. Each part also stores
//! the sum of its triangles' area vectors, with which `join` converts the share to the corner of
//! another block.

use std::collections::BTreeMap;
use std::io;

use glam::DVec3;
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::grid::BLOCK;
use crate::surface::mesh::source::MeshSource;
use crate::surface::stitch::StitchedSurface;
use crate::system::control::{Control, Meter, Stage};

use super::MEASURING;

/// Numbers of components that are left out of a surface because they are too small.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TooSmall {
    /// Number of components of fluid or air with too little volume.
    pub components: u64,
    /// Number of drops that have enough volume, but too few particles.
    pub drops: u64,
}

impl TooSmall {
    /// Total number of components that are left out.
    #[must_use]
    pub fn total(self) -> u64 {
        self.components + self.drops
    }

    /// The names of the limits that caused components to be left out.
    #[must_use]
    pub fn limits(self) -> &'static str {
        match (self.components, self.drops) {
            (_, 0) => "smallest-component",
            (0, _) => "smallest-drop",
            _ => "smallest-component and smallest-drop",
        }
    }
}

/// Finds the components of `surface`, including enclosed air, that are smaller than `volume`, and
/// the drops that are smaller than `drop`. Both limits are volumes in cells. Returns the vertices
/// of these components and drops, and counts the components and drops.
///
/// # Errors
/// If scratch files cannot be read, or if the work was cancelled.
pub fn smaller_than(
    surface: &StitchedSurface,
    volume: f64,
    drop: f64,
    control: &Control,
) -> io::Result<(VertexSet, TooSmall)> {
    let pieces = surface.pieces();
    let meter = control.meter(Stage::Simplifying, 2 * pieces).between(0.0, MEASURING);
    let mut components = Components::default();
    let mut firsts = Vec::with_capacity(pieces);
    // Vertices of later blocks that parts of earlier blocks use, each with the number of one of
    // these parts.
    let mut awaited: BTreeMap<u64, u32> = BTreeMap::new();
    in_batches(
        pieces,
        &meter,
        |piece| PieceParts::of(surface, piece),
        |piece, parts| {
            let base = components.parents.len() as u32;
            firsts.push(base);
            for &part in &parts.parts {
                components.push(part);
            }
            let first = surface.first_vertex(piece);
            let own = first..first + parts.part_of.len() as u64;
            let named: Vec<(u64, u32)> =
                awaited.range(own).map(|(&vertex, &component)| (vertex, component)).collect();
            for (vertex, component) in named {
                awaited.remove(&vertex);
                components.join(component, base + parts.part_of[(vertex - first) as usize]);
            }
            for &(vertex, part) in &parts.beyond {
                if let Some(other) = awaited.insert(vertex, base + part) {
                    components.join(other, base + part);
                }
            }
        },
    )?;
    let mut found = TooSmall::default();
    let mut small = Vec::with_capacity(firsts.len());
    for part in 0..components.parents.len() as u32 {
        let own = components.volume(part);
        let (too_small, drop) = (own.abs() < volume, (0.0..drop).contains(&own));
        small.push(too_small || drop);
        if components.parents[part as usize] == part {
            found.components += u64::from(too_small);
            found.drops += u64::from(drop && !too_small);
        }
    }
    let mut vertices = VertexSet::none_of(surface.vertex_count());
    in_batches(
        pieces,
        &meter,
        |piece| PieceParts::of(surface, piece),
        |piece, parts| {
            for (vertex, part) in (surface.first_vertex(piece)..).zip(&parts.part_of) {
                if small[(firsts[piece] + part) as usize] {
                    vertices.insert(vertex);
                }
            }
        },
    )?;
    Ok((vertices, found))
}

/// Calls `make` for all pieces, on all threads, and then `take` with each result, in the order of
/// the pieces.
fn in_batches<T: Send>(
    pieces: usize,
    meter: &Meter<'_>,
    make: impl Fn(usize) -> io::Result<T> + Sync,
    mut take: impl FnMut(usize, T),
) -> io::Result<()> {
    let batch = 4 * rayon::current_num_threads();
    for first in (0..pieces).step_by(batch) {
        meter.go_on()?;
        let range = first..(first + batch).min(pieces);
        let made: Vec<T> = range.clone().into_par_iter().map(&make).collect::<io::Result<_>>()?;
        meter.add(made.len());
        range.zip(made).for_each(|(piece, made)| take(piece, made));
    }
    Ok(())
}

/// The volume and the area vector of a part, summed over its triangles. The volume is relative to
/// the point `from`.
#[derive(Clone, Copy)]
struct PartSums {
    from: DVec3,
    volume: f64,
    area: DVec3,
}

/// The parts of one piece.
struct PieceParts {
    parts: Vec<PartSums>,
    /// For each vertex of the piece, the index of its part in `parts`.
    part_of: Vec<u32>,
    /// Vertices that belong to other pieces. Each is paired with the number of a part of this piece
    /// that uses it.
    beyond: Vec<(u64, u32)>,
}

impl PieceParts {
    fn of(surface: &StitchedSurface, piece: usize) -> io::Result<Self> {
        let first = surface.first_vertex(piece);
        let mut triangles = Vec::new();
        surface.cell_triangles(piece, |_, triangle| triangles.push(triangle))?;
        let mut places: Vec<DVec3> =
            surface.places(piece)?.into_iter().map(|(_, place)| place).collect();
        let own = places.len();
        let mut beyond: Vec<u64> = triangles
            .iter()
            .flatten()
            .copied()
            .filter(|&vertex| vertex >= first + own as u64)
            .collect();
        beyond.sort_unstable();
        beyond.dedup();
        for vertices in beyond.chunk_by(|&a, &b| surface.piece_of(a) == surface.piece_of(b)) {
            let other = surface.piece_of(vertices[0]);
            let theirs = surface.places(other)?;
            let of = |vertex: &u64| theirs[(vertex - surface.first_vertex(other)) as usize].1;
            places.extend(vertices.iter().map(of));
        }
        let ranks: HashMap<u64, usize> = beyond.iter().copied().zip(own..).collect();
        let local = |vertex: u64| ranks.get(&vertex).copied().unwrap_or((vertex - first) as usize);

        let mut parents: Vec<u32> = (0..places.len() as u32).collect();
        for triangle in &triangles {
            let roots = triangle.map(|vertex| root(&mut parents, local(vertex) as u32));
            let least = roots.into_iter().min().expect("a triangle has three corners");
            roots.into_iter().for_each(|root| parents[root as usize] = least);
        }
        let mut numbers = HashMap::new();
        let part_of: Vec<u32> = (0..places.len() as u32)
            .map(|vertex| {
                let next = numbers.len() as u32;
                *numbers.entry(root(&mut parents, vertex)).or_insert(next)
            })
            .collect();
        let block = surface.level(piece).first_block(surface.block(piece));
        let from = (block * BLOCK).as_dvec3();
        let mut parts = vec![PartSums { from, volume: 0.0, area: DVec3::ZERO }; numbers.len()];
        for triangle in triangles {
            let corners = triangle.map(local);
            let [a, b, c] = corners.map(|corner| places[corner] - from);
            let area = (b - a).cross(c - a) / 2.0;
            let part = &mut parts[part_of[corners[0]] as usize];
            part.volume += a.dot(area) / 3.0;
            part.area += area;
        }
        let beyond = beyond.into_iter().zip(part_of[own..].iter().copied()).collect();
        Ok(Self { parts, part_of: part_of[..own].to_vec(), beyond })
    }
}

/// Components, each of which consists of joined parts.
#[derive(Default)]
struct Components {
    parents: Vec<u32>,
    sums: Vec<PartSums>,
}

impl Components {
    fn push(&mut self, part: PartSums) {
        self.parents.push(self.parents.len() as u32);
        self.sums.push(part);
    }

    fn join(&mut self, a: u32, b: u32) {
        let [a, b] = [a, b].map(|part| root(&mut self.parents, part));
        let [kept, other] = [a.min(b), a.max(b)];
        if kept != other {
            let added = self.sums[other as usize];
            let sum = &mut self.sums[kept as usize];
            sum.volume += added.volume - (sum.from - added.from).dot(added.area) / 3.0;
            sum.area += added.area;
            self.parents[other as usize] = kept;
        }
    }

    /// The volume of the component that contains a part.
    fn volume(&mut self, part: u32) -> f64 {
        let root = root(&mut self.parents, part);
        self.sums[root as usize].volume
    }
}

pub(super) fn root(parents: &mut [u32], mut member: u32) -> u32 {
    while parents[member as usize] != member {
        parents[member as usize] = parents[parents[member as usize] as usize];
        member = parents[member as usize];
    }
    member
}

/// Number of words per run. `VertexSet::before` has one count for each run.
const RUN: usize = 8;

/// A set of vertices.
#[derive(Debug)]
pub struct VertexSet {
    words: Vec<u64>,
    /// Number of members before each run of words; empty until `count` is called.
    before: Vec<u64>,
}

impl VertexSet {
    /// An empty set, for vertices with numbers below `vertices`.
    pub fn none_of(vertices: u64) -> Self {
        Self { words: vec![0; vertices.div_ceil(64) as usize], before: Vec::new() }
    }

    /// Adds a vertex.
    pub fn insert(&mut self, vertex: u64) {
        self.words[(vertex / 64) as usize] |= 1 << (vertex % 64);
    }

    /// Whether a vertex is a member.
    pub fn contains(&self, vertex: u64) -> bool {
        self.words[(vertex / 64) as usize] >> (vertex % 64) & 1 == 1
    }

    /// Counts the members. `rank` can be called only afterwards.
    pub fn count(&mut self) {
        let mut total = 0;
        self.before = self
            .words
            .chunks(RUN)
            .map(|run| {
                let before = total;
                total += run.iter().map(|word| u64::from(word.count_ones())).sum::<u64>();
                before
            })
            .collect();
        self.before.push(total);
    }

    /// The number of members that are less than `vertex`.
    pub fn rank(&self, vertex: u64) -> u64 {
        let word = (vertex / 64) as usize;
        let run = word / RUN;
        let whole: u64 =
            self.words[run * RUN..word].iter().map(|word| u64::from(word.count_ones())).sum();
        let part = self.words.get(word).map_or(0, |word| word & ((1 << (vertex % 64)) - 1));
        self.before[run] + whole + u64::from(part.count_ones())
    }
}
