//! Stitches the whole mesh on a device, with positions in f32. Vertices and triangles are in the
//! order of [`StitchedSurface`](super::StitchedSurface), and the positions are exactly those of
//! this surface, rounded to f32.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::IVec3;

use crate::grid::units::Isovalue;
use crate::grid::{BLOCK, MortonKey, TILE, corner_offset};
use crate::shaders::{STARTS, StartsPush, TRIANGLES, TrianglesPush, VERTICES, VerticesPush};
use crate::surface::dual_mc::cases::{CellEdge, TABLE};
use crate::surface::dual_mc::vulkan::{BlockTally, TILE_WORDS};
use crate::vulkan::{Batch, ComputePipeline, Device, Ticket, View, VulkanError};

/// Number of tiles along a block's edge.
pub const BLOCK_EDGE_TILES: u32 = (BLOCK / TILE) as u32;
/// Number of words per case in the table: one for the number of triangles, and one for each
/// triangle.
pub const CASE_WORDS: u32 = 6;
/// Number of bits in which an edge is stored, as corner + 8 axis.
pub const EDGE_BITS: u32 = 5;
/// The number of a missing block.
pub const NO_BLOCK: u32 = u32::MAX;
/// Size of a position or a triangle, in bytes.
const ROW_BYTES: u64 = 12;
/// Maximum number of vertices or triangles per submission.
const ROWS_AT_ONCE: u64 = 4 << 20;

/// The shaders that stitch meshes.
#[derive(Debug)]
pub struct StitchPipelines {
    starts: Arc<ComputePipeline>,
    vertices: Arc<ComputePipeline>,
    triangles: Arc<ComputePipeline>,
}

impl StitchPipelines {
    /// Compiles the shaders.
    ///
    /// # Errors
    /// [`VulkanError`] if the driver rejects a shader.
    pub fn new(device: &Device) -> Result<Self, VulkanError> {
        let [starts, vertices, triangles] = device.pipelines([&STARTS, &VERTICES, &TRIANGLES])?;
        Ok(Self { starts, vertices, triangles })
    }
}

/// The place of a block's surface in the whole mesh, with the layout of `Block` in `surface.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct MeshBlock {
    coord: [i32; 3],
    first_tile: u32,
    tiles: u32,
    first_vertex: u32,
    first_triangle: u32,
    spare: u32,
    above: [u32; 8],
}

/// The start of each block in the whole mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshLayout {
    blocks: Vec<MeshBlock>,
    tiles: u32,
    vertices: u32,
    triangles: u32,
}

impl MeshLayout {
    /// Lays out blocks by their coordinates and tallies; `None` if a number exceeds 32 bits. Blocks
    /// must be in Morton order. Their coordinates are in units of blocks.
    ///
    /// # Panics
    /// If the blocks are in a different order.
    pub fn new(blocks: &[(IVec3, BlockTally)]) -> Option<Self> {
        let keys: Vec<_> = blocks.iter().map(|&(block, _)| MortonKey::of(block)).collect();
        assert!(keys.is_sorted_by(|a, b| a < b), "blocks are in Morton order");
        let number =
            |coord| keys.binary_search(&MortonKey::of(coord)).map_or(NO_BLOCK, |i| i as u32);
        let mut layout =
            Self { blocks: Vec::with_capacity(blocks.len()), tiles: 0, vertices: 0, triangles: 0 };
        for &(block, BlockTally { tiles, vertices, triangles, .. }) in blocks {
            let above = |k: i32| number(block + corner_offset(k));
            layout.blocks.push(MeshBlock {
                coord: block.to_array(),
                first_tile: layout.tiles,
                tiles,
                first_vertex: layout.vertices,
                first_triangle: layout.triangles,
                spare: 0,
                above: [0, 1, 2, 3, 4, 5, 6, 7].map(above),
            });
            layout.tiles = layout.tiles.checked_add(tiles)?;
            layout.vertices = layout.vertices.checked_add(vertices)?;
            layout.triangles = layout.triangles.checked_add(triangles)?;
        }
        Some(layout)
    }

    /// The blocks, in the form that shaders read.
    pub fn blocks(&self) -> &[MeshBlock] {
        &self.blocks
    }

    /// The total number of tiles in all blocks.
    pub fn tiles(&self) -> u32 {
        self.tiles
    }

    /// The total number of vertices in all blocks.
    pub fn vertices(&self) -> u32 {
        self.vertices
    }

    /// The total number of triangles in all blocks.
    pub fn triangles(&self) -> u32 {
        self.triangles
    }

    /// Divides the blocks into runs whose rows, which are positions or triangles, fit into one
    /// shader binding. `first` returns the first row of each block.
    fn runs(&self, first: impl Fn(&MeshBlock) -> u32, total: u32, range: u64) -> Vec<TileRun> {
        let begin =
            |i: usize| self.blocks.get(i).map_or((self.tiles, total), |b| (b.first_tile, first(b)));
        let mut runs: Vec<TileRun> = Vec::new();
        for i in 0..self.blocks.len() {
            let ((tile, row), (next_tile, next_row)) = (begin(i), begin(i + 1));
            match runs.last_mut() {
                Some(run) if u64::from(next_row - run.rows.start) * ROW_BYTES <= range => {
                    run.tiles.end = next_tile;
                    run.rows.end = next_row;
                }
                _ => runs.push(TileRun { tiles: tile..next_tile, rows: row..next_row }),
            }
        }
        runs.retain(|run| !run.rows.is_empty());
        runs
    }
}

/// A range of tiles, with their rows.
struct TileRun {
    tiles: Range<u32>,
    rows: Range<u32>,
}

impl TileRun {
    /// The number of work groups along each axis: at least one work group per tile, and at most
    /// 2^15 work groups along x, which every device supports.
    fn groups(&self) -> [u32; 3] {
        let tiles = self.tiles.len() as u32;
        let width = tiles.clamp(1, 1 << 15);
        [width, tiles.div_ceil(width), 1]
    }

    /// A view of the run's part of a buffer, and the number of words in the view before that part.
    fn view(&self, all: &View, alignment: u64) -> (View, u32) {
        all.aligned(
            u64::from(self.rows.start) * ROW_BYTES,
            self.rows.len() as u64 * ROW_BYTES,
            alignment,
        )
    }
}

/// The table of marching cubes for shaders: [`CASE_WORDS`] for each combination of signs.
pub fn table() -> Vec<u32> {
    let bits = |edge: CellEdge| u32::from(edge.corner) | u32::from(edge.axis) << 3;
    let pack =
        |[a, b, c]: [CellEdge; 3]| bits(a) | bits(b) << EDGE_BITS | bits(c) << (2 * EDGE_BITS);
    let mut words = vec![0; TABLE.len() * CASE_WORDS as usize];
    for (row, triangles) in words.chunks_exact_mut(CASE_WORDS as usize).zip(TABLE.iter()) {
        row[0] = triangles.len() as u32;
        row[1..].iter_mut().zip(triangles).for_each(|(word, &triangle)| *word = pack(triangle));
    }
    words
}

/// The buffers that stitching reads and writes.
#[derive(Debug, Clone)]
pub struct StitchBuffers {
    /// A [`DeviceGrid`](crate::brick::vulkan::DeviceGrid).
    pub grid: View,
    /// [`MeshLayout::blocks`].
    pub blocks: View,
    /// A [`Tile`](crate::surface::mesh::Tile) for each tile of all blocks, in order.
    pub tiles: View,
    /// For every vertex, the field at the lower and the upper end of its edge, 16 bits each, in
    /// order.
    pub ends: View,
    /// [`table`].
    pub table: View,
    /// Two words per tile, as a temporary buffer.
    pub begins: View,
    /// Output: three f32 per vertex.
    pub positions: View,
    /// Output: three u32 per triangle.
    pub indices: View,
}

/// Writes the positions and the triangles of the whole mesh, once the work of the tickets `after`
/// has finished. The submissions are short enough for any driver, and the caller submits the last
/// one.
///
/// # Errors
/// [`VulkanError::OutOfMemory`] if the tiles or the ends do not fit into one shader binding, and
/// other errors if the device fails.
///
/// # Panics
/// If a buffer is too small.
pub fn stitch(
    device: &Device,
    (batch, after): (&mut Batch, &[Ticket]),
    pipelines: &StitchPipelines,
    layout: &MeshLayout,
    iso: Isovalue,
    buffers: &StitchBuffers,
) -> Result<(), VulkanError> {
    let StitchBuffers { grid, blocks, tiles, ends, table, begins, positions, indices } = buffers;
    let all = |views: &[&View]| views.iter().copied().cloned().collect::<Vec<_>>();
    assert!(
        tiles.bytes() >= u64::from(layout.tiles) * u64::from(TILE_WORDS) * 4
            && begins.bytes() >= u64::from(layout.tiles) * 8
    );
    batch.stage("stitch", tiles.bytes());
    let count = layout.blocks.len() as u32;
    let width = count.clamp(1, 1 << 15);
    batch.dispatch(
        &pipelines.starts,
        &all(&[blocks, tiles, table, begins]),
        &StartsPush { blocks: count },
        [width, count.div_ceil(width), 1],
    )?;
    let limits = device.limits();
    // A run's view can begin with padding for alignment, which must fit into the binding as well.
    let range = (limits.storage_range - limits.alignment).min(ROWS_AT_ONCE * ROW_BYTES);
    for run in layout.runs(|block| block.first_vertex, layout.vertices, range) {
        let (positions, first_word) = run.view(positions, limits.alignment);
        let push = VerticesPush {
            first_tile: run.tiles.start,
            tiles: run.tiles.len() as u32,
            first_vertex: run.rows.start,
            first_word,
            threshold: iso.threshold().into(),
        };
        let views = all(&[grid, blocks, tiles, begins, ends, &positions]);
        batch.dispatch(&pipelines.vertices, &views, &push, run.groups())?;
        batch.submit(after)?;
        batch.begin()?;
        batch.stage("stitch", 2 * run.rows.len() as u64 * ROW_BYTES);
    }
    for run in layout.runs(|block| block.first_triangle, layout.triangles, range) {
        let (indices, first_word) = run.view(indices, limits.alignment);
        let push = TrianglesPush {
            first_tile: run.tiles.start,
            tiles: run.tiles.len() as u32,
            first_triangle: run.rows.start,
            first_word,
        };
        batch.dispatch(
            &pipelines.triangles,
            &all(&[blocks, tiles, begins, table, &indices]),
            &push,
            run.groups(),
        )?;
        if run.rows.end < layout.triangles {
            batch.submit(&[])?;
            batch.begin()?;
            batch.stage("stitch", 2 * run.rows.len() as u64 * ROW_BYTES);
        }
    }
    Ok(())
}
