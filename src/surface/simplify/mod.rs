//! Simplifies a surface within a tolerance, chunk by chunk, including the seams between chunks.
//!
//! A chunk is a cube of 2^3 blocks of the widest level. The first pass simplifies the triangles
//! inside each chunk, with the chunk's border locked. The second pass uses chunks that are shifted
//! by half a chunk, and simplifies the triangles on and near the borders of the first pass. Both
//! passes measure against the original surface, so the result is within the requested distance of
//! the original surface, and every vertex of the original surface is within this distance of the
//! result.
//!
//! The remaining vertices are vertices of the original surface, and keep their positions, normals
//! and attributes. Chunks do not depend on the number of threads or on the memory limit. Only the
//! current chunks, one bit per vertex, and triangles up to the memory limit are in memory. If the
//! triangles exceed this limit, they are moved to scratch files.
//!
//! The guide for users is `guide.md`.

mod collapse;
mod drops;
mod surface;

use std::borrow::Cow;
use std::io;
use std::path::Path;

use glam::{DVec3, IVec3, Vec3A};
use hashbrown::HashSet;
use rayon::prelude::*;

use crate::grid::units::Tolerance;
use crate::grid::{BLOCK, CellBox, MortonKey};
use crate::surface::mesh::source::{MeshSource, Outline, Vertices};
use crate::surface::stitch::StitchedSurface;
use crate::system::control::{Control, Meter, Stage};
use crate::system::scratch::Lists;

use collapse::Patch;
pub use drops::TooSmall;
use drops::VertexSet;
use drops::smaller_than;
use surface::NONE;
use surface::Surroundings;

/// Edge length of a chunk, in blocks.
const CHUNK: i32 = 2;
/// The first pass keeps about one vertex in every square whose edges are this many cells long.
/// Otherwise, triangles on a flat surface would extend from a seam beyond the chunk that simplifies
/// this seam in the second pass.
const PIN_SPACING: i32 = 16;
/// The second pass simplifies triangles within this many cells of a seam of the first pass.
const BAND: i32 = 4;
/// The fraction of the stage's progress that the measurement of components takes.
const MEASURING: f64 = 0.1;
/// Edge length, in cells, of the boxes of [`NearCells`].
const BOX: i32 = 4;

/// Triangles, given by their vertex numbers in the whole mesh.
type WholeTriangles = Vec<[u64; 3]>;

/// A surface with fewer triangles. Its pieces are the chunks of the second pass.
#[derive(Debug)]
pub struct SimplifiedSurface {
    whole: StitchedSurface,
    /// The triangles, with vertex numbers of `whole`.
    triangles: Lists<[u64; 3]>,
    kept: VertexSet,
    /// The pieces of `whole` in each chunk.
    chunks: Vec<Vec<usize>>,
    /// For each piece of `whole`, the new number of its first remaining vertex.
    firsts: Vec<u64>,
    counts: [u64; 2],
    too_small: TooSmall,
}

/// Maximum memory, in bytes, of each thread's chunks: 2^3 blocks full of wrinkled surface.
pub const BYTES_PER_THREAD: u64 = 28 << 20;
/// Number of vertices in 2^3 blocks full of wrinkled surface.
const CHUNK_VERTICES: usize = 160_000;

/// The limits that decide which triangles, components and drops are left out of a surface.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reduction {
    /// Maximum distance of the simplified surface from the original; `None` to keep all triangles.
    pub tolerance: Option<Tolerance>,
    /// Minimum volume, in cells, of components of fluid or air.
    pub smallest_component: Option<f64>,
    /// Minimum number of particles in a drop, which is estimated from the drop's volume.
    pub smallest_drop: Option<u32>,
}

/// The assumed volume of a small drop, divided by the volume of its particles. The actual ratio is
/// 0.6 to 1.1 for one particle, 0.7 to 1.1 for two, and 0.8 to 1.1 for eight.
const DROP_VOLUME: f64 = 0.85;

impl Reduction {
    /// Whether no limit is set.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// Space for the triangles of a reduced surface.
#[derive(Debug, Clone, Copy)]
pub struct TriangleSpace<'a> {
    /// Maximum size of the triangles in memory, in bytes.
    pub bytes: u64,
    /// The folder of scratch files for triangles that exceed `bytes`.
    pub folder: &'a Path,
}

/// Reduces `surface`. One particle fills `particle_cells` cells, `room` limits the memory for
/// triangles, and `control` receives the progress.
///
/// # Errors
/// If scratch files cannot be read or written, or if the work was cancelled.
pub fn simplify(
    surface: StitchedSurface,
    reduction: &Reduction,
    particle_cells: f64,
    room: TriangleSpace<'_>,
    control: &Control,
) -> io::Result<SimplifiedSurface> {
    let TriangleSpace { bytes, folder } = room;
    let Reduction { smallest_component, smallest_drop, .. } = *reduction;
    let (left_out, too_small) = if smallest_component.is_some() || smallest_drop.is_some() {
        let particles =
            smallest_drop.map_or(0.0, |particles| DROP_VOLUME * (f64::from(particles) - 0.5));
        let volume = smallest_component.unwrap_or(0.0);
        let (vertices, too_small) =
            smaller_than(&surface, volume, particles * particle_cells, control)?;
        (Some(vertices), too_small)
    } else {
        (None, TooSmall::default())
    };
    let begun = if left_out.is_some() { MEASURING } else { 0.0 };
    let blocks: Vec<IVec3> = surface.blocks().collect();
    let scale = Scale(1 << surface.widest_level());
    let aligned = grouped(&blocks, |block| scale.aligned_chunk(block));
    let shifted = grouped(&blocks, |block| scale.shifted_chunk(block));
    let chunks = aligned.len() + shifted.len();
    let meter = control.meter(Stage::Simplifying, chunks).between(begun, 1.0);
    let tolerance = reduction.tolerance;
    let passes = Passes { surface: &surface, scale, left_out, tolerance, meter };
    let mut between = Lists::in_memory();
    // For each list in `between`: its shifted chunk, its treatment in the second pass, and its
    // number.
    let mut destinations: Vec<(MortonKey, SecondPass, usize)> = Vec::new();
    for chunks in batches(&surface, &aligned) {
        let done: Vec<_> = chunks
            .par_iter()
            .map(|(_, pieces)| passes.first_pass(pieces))
            .collect::<io::Result<_>>()?;
        for ((destination, treatment), list) in done.into_iter().flatten() {
            destinations.push((destination, treatment, between.len()));
            between.push(list)?;
        }
        if between.bytes() > bytes / 2 {
            between.move_to_file(folder)?;
        }
    }
    destinations.sort_unstable();

    let mut triangles = Lists::in_memory();
    let mut kept = VertexSet::none_of(surface.vertex_count());
    let mut triangle_count = 0;
    for chunks in batches(&surface, &shifted) {
        let done: Vec<WholeTriangles> = chunks
            .par_iter()
            .map(|(destination, pieces)| {
                let start = destinations.partition_point(|(other, ..)| other < destination);
                let lists =
                    destinations[start..].iter().take_while(|(other, ..)| other == destination);
                passes.second_pass(
                    pieces,
                    &between,
                    lists.map(|&(_, treatment, list)| (treatment, list)),
                )
            })
            .collect::<io::Result<_>>()?;
        for list in done {
            list.as_flattened().iter().for_each(|&vertex| kept.insert(vertex));
            triangle_count += list.len() as u64;
            triangles.push(list)?;
        }
        if triangles.bytes() > bytes / 2 {
            triangles.move_to_file(folder)?;
        }
    }
    kept.count();
    let mut firsts = vec![0; blocks.len()];
    let mut vertex_count = 0;
    let chunks: Vec<Vec<usize>> = shifted.into_iter().map(|(_, pieces)| pieces).collect();
    for &piece in chunks.iter().flatten() {
        firsts[piece] = vertex_count;
        let first = surface.first_vertex(piece);
        vertex_count += kept.rank(first + surface.piece_vertices(piece) as u64) - kept.rank(first);
    }
    Ok(SimplifiedSurface {
        whole: surface,
        triangles,
        kept,
        chunks,
        firsts,
        counts: [vertex_count, triangle_count],
        too_small,
    })
}

/// The width of the surface's widest cells, in finest cells. All lengths that are given in cells
/// are multiplied by this width, so that each block of the widest cells is within one chunk.
#[derive(Debug, Clone, Copy)]
struct Scale(i32);

impl Scale {
    /// Edge length of a chunk, in finest blocks.
    fn chunk(self) -> i32 {
        CHUNK * self.0
    }

    fn aligned_chunk(self, block: IVec3) -> IVec3 {
        block >> self.chunk().ilog2()
    }

    fn shifted_chunk(self, block: IVec3) -> IVec3 {
        self.aligned_chunk(block + self.chunk() / 2)
    }

    /// Whether all cells have the same size.
    fn is_uniform(self) -> bool {
        self.0 == 1
    }

    /// Two opposite corners of a box of cells. The box contains the cells of all vertices of a dual
    /// cell. If cells differ in size, the box begins one wide cell lower, because the cell of a
    /// vertex between two wide cells can begin there.
    fn corners(self, cell: IVec3) -> [IVec3; 2] {
        if self.is_uniform() { [cell, cell + 1] } else { [cell - self.0, cell + 2 * self.0] }
    }
}

/// The pieces of each chunk, with the chunks in Morton order.
fn grouped(blocks: &[IVec3], chunk: impl Fn(IVec3) -> IVec3) -> Vec<(MortonKey, Vec<usize>)> {
    let mut pieces: Vec<(MortonKey, usize)> = blocks
        .iter()
        .enumerate()
        .map(|(piece, &block)| (MortonKey::of(chunk(block)), piece))
        .collect();
    pieces.sort_unstable();
    let groups = pieces.chunk_by(|a, b| a.0 == b.0);
    groups.map(|group| (group[0].0, group.iter().map(|&(_, piece)| piece).collect())).collect()
}

/// Splits chunks into batches that are simplified together: at most two chunks and
/// [`CHUNK_VERTICES`] vertices per thread. A chunk that alone exceeds the limit for all threads is
/// a batch of its own.
fn batches<'c>(
    surface: &StitchedSurface,
    chunks: &'c [(MortonKey, Vec<usize>)],
) -> Vec<&'c [(MortonKey, Vec<usize>)]> {
    let threads = rayon::current_num_threads();
    let vertices = |(_, pieces): &(MortonKey, Vec<usize>)| -> usize {
        pieces.iter().map(|&piece| surface.piece_vertices(piece)).sum()
    };
    let (mut batches, mut rest) = (Vec::new(), chunks);
    while !rest.is_empty() {
        let mut sum = 0;
        let fitting = rest.iter().take(2 * threads).take_while(|chunk| {
            sum += vertices(chunk);
            sum <= threads * CHUNK_VERTICES
        });
        let (batch, later) = rest.split_at(fitting.count().max(1));
        batches.push(batch);
        rest = later;
    }
    batches
}

/// The treatment of a triangle in the second pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum SecondPass {
    Simplify,
    /// The triangle stays unchanged, because it is far from the former borders, or too close to the
    /// border of its shifted chunk.
    Keep,
}

struct Passes<'a> {
    surface: &'a StitchedSurface,
    scale: Scale,
    left_out: Option<VertexSet>,
    /// Without a tolerance, all triangles are kept.
    tolerance: Option<Tolerance>,
    /// Progress of the chunks.
    meter: Meter<'a>,
}

impl Passes<'_> {
    /// Calls `put` with each remaining triangle of a piece, and its dual cell.
    fn triangles(&self, piece: usize, mut put: impl FnMut(IVec3, [u64; 3])) -> io::Result<()> {
        self.surface.cell_triangles(piece, |cell, triangle| {
            if self.left_out.as_ref().is_none_or(|left_out| !left_out.contains(triangle[0])) {
                put(cell, triangle);
            }
        })
    }

    fn simplified(&self, patch: Patch) -> Vec<[u32; 3]> {
        match self.tolerance {
            Some(tolerance) => patch.simplified(tolerance.cells() as f32),
            None => patch.triangles.to_vec(),
        }
    }

    /// Simplifies the triangles inside the given pieces, and returns the remaining triangles,
    /// grouped by their treatment in the second pass.
    fn first_pass(
        &self,
        pieces: &[usize],
    ) -> io::Result<Vec<((MortonKey, SecondPass), WholeTriangles)>> {
        self.meter.go_on()?;
        let chunk = ChunkVertices::load(self.surface, pieces)?;
        let mut sorted = SortedTriangles::default();
        let mut inside = Vec::new();
        for &piece in pieces {
            self.triangles(piece, |cell, triangle| match chunk.local(triangle) {
                Some(local) => inside.push(local),
                // `cell` is a dual cell. `scale.corners` returns two opposite corner cells of a box
                // that contains the cells of the triangle's vertices.
                None => sorted.push(self.destination(cell, self.scale.corners(cell)), triangle),
            })?;
        }
        let patch = Patch {
            positions: &chunk.positions,
            reference: &inside,
            triangles: &inside,
            pinned: &chunk.pins(self.scale),
            outside: if self.scale.is_uniform() {
                Surroundings::DualCells
            } else {
                Surroundings::Simplified
            },
        };
        for triangle in self.simplified(patch) {
            let cells = triangle.map(|vertex| chunk.cells[vertex as usize]);
            sorted.push(self.destination(cells[0], cells), chunk.global(triangle));
        }
        self.meter.add(1);
        Ok(sorted.lists)
    }

    /// Maximum distance, in cells, from the vertices of a triangle to any surface that is within
    /// the tolerance of the triangle.
    fn reach(&self) -> i32 {
        let Scale(widest) = self.scale;
        let further = if self.scale.is_uniform() { 1 } else { 2 * widest };
        self.tolerance.map_or(0, |tolerance| tolerance.cells().ceil() as i32) + further
    }

    /// The shifted chunk that contains `cell`, and how the second pass treats a triangle of that
    /// chunk whose vertices are in `cells`. `cell` must be in a block with a surface. A triangle is
    /// simplified only if the chunk contains all of the surface that is within the tolerance of the
    /// triangle.
    fn destination<const N: usize>(
        &self,
        cell: IVec3,
        cells: [IVec3; N],
    ) -> (MortonKey, SecondPass) {
        let block = cell >> BLOCK.ilog2();
        let (chunk, edge) = (self.scale.shifted_chunk(block), self.scale.chunk());
        let lo = (chunk * edge - edge / 2) * BLOCK;
        let reach = self.reach();
        let inner = CellBox { lo, hi: lo + edge * BLOCK }.grown(-reach, -reach);
        let band = BAND * self.scale.0;
        let is_in_band = |x: i32| (x + band).rem_euclid(edge * BLOCK) < 2 * band;
        let is_near_seam = cells.iter().any(|cell| cell.to_array().into_iter().any(is_in_band));
        let is_inside = cells.iter().all(|&cell| inner.contains(cell));
        let treatment =
            if is_near_seam && is_inside { SecondPass::Simplify } else { SecondPass::Keep };
        (MortonKey::of(chunk), treatment)
    }

    /// Simplifies the lists of a shifted chunk that are marked [`SecondPass::Simplify`], and
    /// returns the triangles of the chunk.
    fn second_pass(
        &self,
        pieces: &[usize],
        between: &Lists<[u64; 3]>,
        lists: impl Iterator<Item = (SecondPass, usize)>,
    ) -> io::Result<WholeTriangles> {
        self.meter.go_on()?;
        self.meter.add(1);
        let mut result = WholeTriangles::new();
        let mut to_simplify = Vec::new();
        let chunk = ChunkVertices::load(self.surface, pieces)?;
        for (treatment, list) in lists {
            let list = between.get(list)?;
            match treatment {
                SecondPass::Keep => result.extend_from_slice(&list),
                SecondPass::Simplify => to_simplify.extend(list.iter().map(|&triangle| {
                    chunk
                        .local(triangle)
                        .expect("a triangle inside a chunk has all of its vertices there")
                })),
            }
        }
        if to_simplify.is_empty() {
            return Ok(result);
        }
        let edge = BOX * self.scale.0;
        let near = NearCells::around(&to_simplify, &chunk.cells, self.reach(), edge);
        let mut reference = Vec::new();
        for &piece in pieces {
            self.triangles(piece, |cell, triangle| {
                if near.contains(cell) {
                    reference.extend(chunk.local(triangle));
                }
            })?;
        }
        let mut used = UsedVertices::of(chunk.positions.len());
        reference.iter_mut().chain(&mut to_simplify).for_each(|triangle| used.renumber(triangle));
        let positions: Vec<Vec3A> =
            used.vertices.iter().map(|&at| chunk.positions[at as usize]).collect();
        let patch = Patch {
            positions: &positions,
            reference: &reference,
            triangles: &to_simplify,
            pinned: &[],
            outside: Surroundings::Simplified,
        };
        let simplified = self.simplified(patch).into_iter();
        result.extend(
            simplified.map(|triangle| chunk.global(triangle.map(|at| used.vertices[at as usize]))),
        );
        Ok(result)
    }
}

/// Lists of triangles, grouped by their shifted chunk and their treatment in the second pass.
#[derive(Default)]
struct SortedTriangles {
    lists: Vec<((MortonKey, SecondPass), WholeTriangles)>,
}

impl SortedTriangles {
    fn push(&mut self, destination: (MortonKey, SecondPass), triangle: [u64; 3]) {
        match self.lists.iter_mut().find(|(key, _)| *key == destination) {
            Some((_, list)) => list.push(triangle),
            None => self.lists.push((destination, vec![triangle])),
        }
    }
}

/// Boxes of cells. Each box has a flag: whether one of the given triangles is near the box.
struct NearCells {
    lo: IVec3,
    size: IVec3,
    /// Edge length of a box, in cells; a power of two.
    edge: i32,
    is_near: Vec<bool>,
}

impl NearCells {
    /// Finds the boxes within `reach` cells of triangles. `cells` has the cell of each vertex.
    fn around(triangles: &[[u32; 3]], cells: &[IVec3], reach: i32, edge: i32) -> Self {
        let bounds = |vertices: &[u32]| {
            let cells = vertices.iter().map(|&vertex| cells[vertex as usize]);
            let bounds = cells
                .map(|cell| [cell, cell])
                .reduce(|[lo, hi], [cell, _]| [lo.min(cell), hi.max(cell)]);
            let [lo, hi] = bounds.unwrap_or_default();
            [lo - reach, hi + reach].map(|cell| cell >> edge.ilog2())
        };
        let [lo, hi] = bounds(triangles.as_flattened());
        let size = hi - lo + 1;
        let mut boxes =
            Self { lo, size, edge, is_near: vec![false; size.as_usizevec3().element_product()] };
        for triangle in triangles {
            let [lo, hi] = bounds(triangle);
            for z in lo.z..=hi.z {
                for y in lo.y..=hi.y {
                    for x in lo.x..=hi.x {
                        let rank = boxes.rank(IVec3::new(x, y, z));
                        boxes.is_near[rank] = true;
                    }
                }
            }
        }
        boxes
    }

    fn rank(&self, at: IVec3) -> usize {
        let at = at - self.lo;
        (at.x + self.size.x * (at.y + self.size.y * at.z)) as usize
    }

    fn contains(&self, cell: IVec3) -> bool {
        let at = cell >> self.edge.ilog2();
        at.cmpge(self.lo).all()
            && at.cmplt(self.lo + self.size).all()
            && self.is_near[self.rank(at)]
    }
}

/// The vertices of a chunk that triangles use, in order of first use.
struct UsedVertices {
    vertices: Vec<u32>,
    /// For each vertex of the chunk, its new number, or `NONE`.
    ranks: Vec<u32>,
}

impl UsedVertices {
    fn of(vertices: usize) -> Self {
        Self { vertices: Vec::new(), ranks: vec![NONE; vertices] }
    }

    fn renumber(&mut self, triangle: &mut [u32; 3]) {
        for vertex in triangle {
            let rank = &mut self.ranks[*vertex as usize];
            if *rank == NONE {
                *rank = self.vertices.len() as u32;
                self.vertices.push(*vertex);
            }
            *vertex = *rank;
        }
    }
}

/// The vertices of a chunk.
struct ChunkVertices {
    /// For each run of consecutive pieces: the number of its first vertex in the whole mesh and in
    /// the chunk, and its number of vertices.
    ranges: Vec<[u64; 3]>,
    /// The lower cell of each vertex's edge.
    cells: Vec<IVec3>,
    /// Positions, in units of cells, relative to a corner near the first vertex. No two are equal.
    positions: Vec<Vec3A>,
}

impl ChunkVertices {
    fn load(surface: &StitchedSurface, pieces: &[usize]) -> io::Result<Self> {
        let vertices = pieces.iter().map(|&piece| surface.piece_vertices(piece)).sum();
        let mut chunk = Self {
            ranges: Vec::with_capacity(pieces.len()),
            cells: Vec::with_capacity(vertices),
            positions: Vec::with_capacity(vertices),
        };
        let mut corner = None;
        let mut taken = HashSet::with_capacity(vertices);
        for &piece in pieces {
            let places = surface.places(piece)?;
            let (first, count) = (surface.first_vertex(piece), places.len() as u64);
            match chunk.ranges.last_mut() {
                Some(range) if range[0] + range[2] == first => range[2] += count,
                _ => chunk.ranges.push([first, chunk.cells.len() as u64, count]),
            }
            for (cell, place) in places {
                let corner: DVec3 = *corner.get_or_insert(place.floor());
                let mut position = (place - corner).as_vec3a();
                // A triangle with two equal positions would have no normal, so `x` grows until the
                // position is unique.
                while !taken.insert(position.to_array().map(f32::to_bits)) {
                    position.x = position.x.next_up();
                }
                chunk.cells.push(cell);
                chunk.positions.push(position);
            }
        }
        Ok(chunk)
    }

    /// The vertices that the first pass keeps: the vertices on the lines of a coarse lattice.
    fn pins(&self, scale: Scale) -> Vec<u32> {
        let spacing = PIN_SPACING * scale.0;
        let on_line = |cell: &IVec3| {
            cell.to_array().into_iter().filter(|x| x.rem_euclid(spacing) == spacing / 2).count()
                >= 2
        };
        (0..).zip(&self.cells).filter(|(_, cell)| on_line(cell)).map(|(vertex, _)| vertex).collect()
    }

    fn local(&self, triangle: [u64; 3]) -> Option<[u32; 3]> {
        let mut local = [0; 3];
        for (to, vertex) in local.iter_mut().zip(triangle) {
            let own = |range: &&[u64; 3]| {
                vertex.checked_sub(range[0]).is_some_and(|rank| rank < range[2])
            };
            let [first, base, _] = self.ranges.iter().find(own)?;
            *to = (vertex - first + base) as u32;
        }
        Some(local)
    }

    fn global(&self, triangle: [u32; 3]) -> [u64; 3] {
        triangle.map(|vertex| {
            let vertex = u64::from(vertex);
            let own = self
                .ranges
                .iter()
                .rfind(|range| range[1] <= vertex && vertex < range[1] + range[2]);
            let [first, base, _] = own.expect("every vertex is in a range");
            vertex - base + first
        })
    }
}

impl SimplifiedSurface {
    /// The original surface.
    pub fn whole(&self) -> &StitchedSurface {
        &self.whole
    }

    /// The numbers of components and drops that were left out.
    pub fn too_small(&self) -> TooSmall {
        self.too_small
    }

    fn renumbered(&self, vertex: u64) -> u64 {
        let piece = self.whole.piece_of(vertex);
        self.firsts[piece] + self.kept.rank(vertex) - self.kept.rank(self.whole.first_vertex(piece))
    }
}

impl MeshSource for SimplifiedSurface {
    fn outline(&self) -> Outline {
        Outline {
            vertices: self.counts[0],
            triangles: self.counts[1],
            normals: self.whole.has_normals(),
            attributes: self.whole.attributes(),
            pieces: self.chunks.len(),
            lattice: self.whole.outline().lattice,
        }
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        let attributes = self.attributes();
        let (mut positions, mut normals) = (Vec::new(), Vec::new());
        let mut values = vec![Vec::new(); attributes.len()];
        for &part in &self.chunks[piece] {
            let first = self.whole.first_vertex(part);
            let vertices = self.whole.vertices(part)?;
            let kept = (0..vertices.positions.len())
                .filter(|&rank| self.kept.contains(first + rank as u64));
            for rank in kept {
                positions.push(vertices.positions[rank]);
                normals.extend(vertices.normals.get(rank));
                for ((to, from), info) in
                    values.iter_mut().zip(&vertices.attributes).zip(&attributes)
                {
                    to.extend_from_slice(&from[rank * info.components..][..info.components]);
                }
            }
        }
        Ok(Vertices {
            positions: Cow::Owned(positions),
            normals: Cow::Owned(normals),
            attributes: values.into_iter().map(Cow::Owned).collect(),
        })
    }

    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        let triangles = self.triangles.get(piece)?;
        Ok(triangles
            .iter()
            .map(|triangle| triangle.map(|vertex| self.renumbered(vertex)))
            .collect())
    }
}
