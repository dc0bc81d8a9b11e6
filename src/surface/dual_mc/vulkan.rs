//! See `mod.rs` of this folder for the formulas.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use crate::brick::vulkan::{DeviceBlocks, GROUP_ROW, mirror_planes, wall_bounds};
use crate::grid::units::Isovalue;
use crate::grid::{BLOCK, CellBox, Mirror, TILE};
use crate::shaders::{BasesPush, EmitPush, SignsPush};
use crate::surface::mesh::Tile;
use crate::vulkan::{Batch, ComputePipeline, View, VulkanError};

use super::cases::TABLE;

/// Number of tiles whose signs a block needs: its own tiles, and one layer of its upper neighbours.
pub const SIGN_TILES: u32 = ((BLOCK / TILE + 1) * (BLOCK / TILE + 1) * (BLOCK / TILE + 1)) as u32;
/// Number of 32-bit words per [`Tile`].
pub const TILE_WORDS: u32 = size_of::<Tile>() as u32 / 4;

/// Counts of a block's tiles, vertices and triangles. The shader `bases` replaces them with the
/// counts of all previous blocks of the batch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct BlockTally {
    /// Number of tiles that contain the surface.
    pub tiles: u32,
    /// Number of crossed edges.
    pub vertices: u32,
    /// Number of triangles in the dual cells that the block owns.
    pub triangles: u32,
    spare: u32,
}

impl BlockTally {
    /// The difference between this tally and `begin`.
    pub fn since(&self, begin: &Self) -> Self {
        Self {
            tiles: self.tiles - begin.tiles,
            vertices: self.vertices - begin.vertices,
            triangles: self.triangles - begin.triangles,
            spare: 0,
        }
    }
}

/// A tile's place within its block.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TileSlot {
    /// The tile's Morton index within the block.
    pub index: u32,
    /// The number of the tile's first vertex within the block.
    pub vertex: u32,
    /// The number of the tile's first triangle within the block.
    pub triangle: u32,
    spare: u32,
}

/// The shaders of dual marching cubes.
#[derive(Debug)]
pub struct DualMcPipelines {
    /// Computes the signs of all cells, tile by tile.
    pub signs: Arc<ComputePipeline>,
    /// Computes the tally of each block, and the first vertex and triangle of each of its tiles.
    pub tiles: Arc<ComputePipeline>,
    /// Computes where each block starts in the batch, and the number of work groups that `emit`
    /// needs.
    pub bases: Arc<ComputePipeline>,
    /// Writes tiles and vertices.
    pub emit: Arc<ComputePipeline>,
}

/// The buffers of dual marching cubes. The shaders read `lengths`, and write all other buffers.
#[derive(Debug, Clone)]
pub struct Outputs {
    /// [`SIGN_TILES`] 64-bit words per block.
    pub signs: View,
    /// Number of triangles for each case.
    pub lengths: View,
    /// [`BLOCK_TILES`](crate::grid::BLOCK_TILES) values of [`TileSlot`] per block.
    pub slots: View,
    /// A [`BlockTally`] for each block, and one for the totals.
    pub tallies: View,
    /// Number of work groups that write tiles, along each axis: 12 bytes.
    pub groups: View,
    /// The [`Tile`]s that contain the surface.
    pub tiles: View,
    /// For every vertex, the field at the lower and the upper end of its edge.
    pub ends: View,
    /// [`Falls`] for every vertex, if normals are requested.
    pub falls: View,
    /// The maximum number of vertices. If there are more, the shaders write no tiles and no
    /// vertices.
    pub room: u32,
}

/// Decrease of the field along each axis, from one cell below to one cell above each end of a
/// vertex's edge. The lower end comes first.
pub type Falls = [[i32; 3]; 2];

/// Number of triangles for each case, in the form that the shaders read.
pub fn lengths() -> Vec<u32> {
    TABLE.iter().map(|triangles| triangles.len() as u32).collect()
}

/// Counts and orders the vertices and triangles of all blocks, and writes them.
///
/// # Errors
/// [`VulkanError::OutOfMemory`] if a buffer is larger than a shader can access.
#[allow(clippy::too_many_arguments, reason = "the CPU version's arguments, and device objects")]
pub fn contour(
    batch: &mut Batch,
    pipelines: &DualMcPipelines,
    blocks: &DeviceBlocks,
    field: &View,
    iso: Isovalue,
    walls: Option<CellBox>,
    normals: bool,
    outputs: &Outputs,
) -> Result<(), VulkanError> {
    let [walls_lo, walls_hi] = wall_bounds(walls);
    let [mirror_lo, mirror_hi] = mirror_planes(walls.map(Mirror::new));
    let Outputs { signs, lengths, slots, tallies, groups, tiles, ends, falls, room } = outputs;
    let all = |views: &[&View]| views.iter().copied().cloned().collect::<Vec<_>>();
    batch.dispatch(
        &pipelines.signs,
        &all(&[&blocks.blocks, field, signs]),
        &SignsPush { walls_lo, threshold: iso.threshold().into(), walls_hi },
        [pipelines.signs.groups(SIGN_TILES), blocks.count, 1],
    )?;
    batch.dispatch(
        &pipelines.tiles,
        &all(&[&blocks.blocks, signs, lengths, slots, tallies]),
        &(),
        [blocks.count, 1, 1],
    )?;
    let push = BasesPush { blocks: blocks.count, room: *room, width: GROUP_ROW };
    batch.dispatch(&pipelines.bases, &all(&[tallies, groups]), &push, [1, 1, 1])?;
    batch.dispatch_as(
        &pipelines.emit,
        &all(&[&blocks.blocks, field, signs, slots, tallies, tiles, ends, falls]),
        &EmitPush { mirror_lo, blocks: blocks.count, mirror_hi, normals: normals.into() },
        groups,
    )
}
