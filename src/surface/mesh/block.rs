//! The surface of one block before stitching: signs and samples of edges, without indices.
//!
//! Every dual edge belongs to the tile of 4^3 cells that contains its lower cell, and every dual
//! cell belongs to the tile that contains its lowest corner. Within a tile, vertices are ordered by
//! axis, then by cell (x fastest). Tiles are in Morton order. This order does not depend on blocks,
//! bricks or threads.

use glam::IVec3;

use crate::grid::{BLOCK, BlockLevel, TILE, local_from_morton};

/// One bit for each cell of a tile: bit x + 4 y + 16 z.
pub type TileMask = u64;

/// The cell of a bit, relative to its tile.
#[inline]
pub fn cell_of_bit(bit: u32) -> IVec3 {
    IVec3::new(bit as i32 & 3, bit as i32 >> 2 & 3, bit as i32 >> 4)
}

/// The numbers of the set bits, lowest first.
pub fn bits(mut mask: TileMask) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let bit = mask.trailing_zeros();
        (mask != 0).then(|| {
            mask &= mask - 1;
            bit
        })
    })
}

/// A tile that contains the surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Tile {
    /// The tile's Morton index within the block.
    pub index: u32,
    /// The number of the tile's first vertex within the block.
    pub first_vertex: u32,
    /// For each corner number x + 2 y + 4 z, the dual cells of the tile for which that corner is
    /// inside the fluid.
    pub corners: [TileMask; 8],
}

impl Tile {
    /// The lowest cell of the tile. `block` has the coordinates of its block, in blocks of the
    /// block's level.
    pub fn corner(&self, block: IVec3) -> IVec3 {
        block * BLOCK + local_from_morton(self.index as usize) * TILE
    }

    /// The cells whose dual edge along `axis` crosses the surface.
    #[inline]
    pub fn crossed(&self, axis: usize) -> TileMask {
        self.corners[0] ^ self.corners[1 << axis]
    }

    /// The dual cells with corners on both sides of the surface.
    #[inline]
    pub fn mixed(&self) -> TileMask {
        let (any, all) = self.corners.iter().fold((0, !0), |(any, all), c| (any | c, all & c));
        any & !all
    }

    /// The inside corners of dual cell number `bit`, one bit per corner.
    #[inline]
    pub fn case(&self, bit: u32) -> usize {
        self.corners.iter().enumerate().map(|(k, c)| ((c >> bit & 1) as usize) << k).sum()
    }
}

/// The corners of a tile's dual cells that are in cells wider or narrower than the tile's own
/// cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TileLevels {
    /// For each of the 8 corners, the dual cells for which this corner is in a cell wider than the
    /// tile's own.
    pub wider: [TileMask; 8],
    /// For each of the 8 corners, the dual cells for which this corner is in a cell narrower than
    /// the tile's own.
    pub narrower: [TileMask; 8],
}

/// For each axis, the cells of a tile that have the highest coordinate along that axis.
const LAST: [TileMask; 3] = [0x8888_8888_8888_8888, 0xf000_f000_f000_f000, 0xffff << 48];

impl BlockLevel {
    /// The levels of the corners of a tile's dual cells.
    #[must_use]
    pub fn of_tile(self, tile: &Tile) -> TileLevels {
        if self.is_uniform() {
            return TileLevels::default();
        }
        let place = local_from_morton(tile.index as usize);
        // Along an axis where this is true, the upper corners of the last dual cells are in the
        // next block.
        let at_end = place.to_array().map(|along| along == BLOCK / TILE - 1);
        let in_block = |corner: usize, block: usize| {
            (0..3).fold(!0, |cells: TileMask, axis| {
                let beyond = if at_end[axis] && corner >> axis & 1 == 1 { LAST[axis] } else { 0 };
                cells & if block >> axis & 1 == 1 { beyond } else { !beyond }
            })
        };
        let of = |blocks: u8| {
            std::array::from_fn(|corner| {
                let blocks = (0..8).filter(|block| blocks >> block & 1 == 1);
                blocks.fold(0, |cells, block| cells | in_block(corner, block))
            })
        };
        TileLevels { wider: of(self.wider), narrower: of(self.narrower) }
    }

    /// For each axis, the cells of a tile whose dual edge has a vertex that belongs to this block.
    #[inline]
    #[must_use]
    pub fn crossed(self, tile: &Tile) -> [TileMask; 3] {
        let crossed = [0, 1, 2].map(|axis| tile.crossed(axis));
        if self.is_uniform() {
            return crossed;
        }
        let TileLevels { wider, narrower } = self.of_tile(tile);
        [0, 1, 2].map(|axis| {
            let upper = 1 << axis;
            crossed[axis] & !(wider[0] & wider[upper]) & !(narrower[0] | narrower[upper])
        })
    }

    /// The dual cells of a tile whose triangles belong to this block.
    #[inline]
    #[must_use]
    pub fn mixed(self, tile: &Tile) -> TileMask {
        if self.is_uniform() {
            return tile.mixed();
        }
        let TileLevels { wider, narrower } = self.of_tile(tile);
        let all_wider = wider.iter().fold(!0, |all, corner| all & corner);
        let any_narrower = narrower.iter().fold(0, |any, corner| any | corner);
        tile.mixed() & !all_wider & !any_narrower
    }

    /// The edges of a tile that have vertices of this block, in vertex order. Each edge is given by
    /// its lower cell, relative to the tile, and its axis.
    pub fn edges(self, tile: &Tile) -> impl Iterator<Item = (IVec3, usize)> + use<> {
        let crossed = self.crossed(tile);
        (0..3).flat_map(move |axis| bits(crossed[axis]).map(move |bit| (cell_of_bit(bit), axis)))
    }
}

impl BlockMesh {
    /// The edges with vertices, in vertex order. Each edge is given by its lower cell, on the
    /// block's lattice, and its axis.
    pub fn edges(&self) -> impl Iterator<Item = (IVec3, usize)> + '_ {
        self.tiles.iter().flat_map(|tile| {
            let corner = tile.corner(self.block);
            self.level.edges(tile).map(move |(cell, axis)| (corner + cell, axis))
        })
    }
}

/// The surface of one block.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BlockMesh {
    /// The block's coordinates, in blocks of its level.
    pub block: IVec3,
    /// The level of the block's cells.
    pub level: BlockLevel,
    /// The tiles with vertices or triangles, in Morton order.
    pub tiles: Vec<Tile>,
    /// The stored bits of every vertex: the field at both ends of the vertex's edge, or the
    /// vertex's position on this edge, as a fraction.
    pub ends: Vec<[u16; 2]>,
    /// The outward normal of every vertex; empty if no normals were requested.
    pub normals: Vec<[f32; 3]>,
    /// For every attribute, its values at the vertices.
    pub attributes: Vec<Vec<f32>>,
    /// Number of triangles in the dual cells that the block owns.
    pub triangle_count: usize,
}
