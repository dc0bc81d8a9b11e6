//! Joins the surfaces of all blocks into one mesh. Triangles of different blocks that meet at a
//! dual edge share the vertex on this edge.
//!
//! A vertex's number is the sum of three numbers: the number of the first vertex of its block, the
//! number of vertices in previous tiles of the block, and the rank of its edge among the tile's
//! crossed edges. The numbering uses neither positions nor distances. Tiles are ordered along the
//! Morton curve. Positions and triangles are computed on request, block by block, and never stored.

mod coarse;
mod numbers;
pub mod vulkan;

use std::borrow::Cow;
use std::cell::Cell;
use std::io;

use bytemuck::Zeroable;
use glam::{DVec3, IVec3};
use rayon::prelude::*;
use thiserror::Error;

use crate::grid::{BLOCK, BlockLevel, CellBox, Domain, Grid, corner_offset};
use crate::particles::AttributeInfo;
use crate::surface::dual_mc::Crossings;
use crate::surface::mesh::source::{Indexed, MeshSource};
use crate::surface::mesh::spool::Spool;
use crate::surface::mesh::{BlockMesh, Mesh, Tile, VertexAttribute, bits, cell_of_bit};
use crate::system::memory::zeroed_in_huge_pages;

use numbers::VertexNumbers;
pub use numbers::writing_bytes;

/// An error in making one indexed mesh in memory.
#[derive(Debug, Error)]
pub enum WholeMeshError {
    /// Vertex numbers exceed 32 bits.
    #[error(
        "the surface has {0} vertices, but a mesh in memory can have at most 4294967295; use a \
         larger cell size"
    )]
    TooManyVertices(u64),
    /// A scratch file with surfaces cannot be read.
    #[error("cannot use a scratch file: {0}")]
    Scratch(#[from] io::Error),
}

/// The surfaces of all blocks as one shared, indexed mesh.
#[derive(Debug)]
pub struct StitchedSurface {
    spool: Spool,
    grid: Grid,
    domain: Option<Domain>,
    crossings: Crossings,
    attributes: Vec<AttributeInfo>,
}

impl StitchedSurface {
    /// Joins the surfaces in `spool`, whose vertices have `attributes`.
    pub fn new(
        spool: Spool,
        grid: Grid,
        domain: Option<Domain>,
        crossings: impl Into<Crossings>,
        attributes: Vec<AttributeInfo>,
    ) -> Self {
        Self { spool, grid, domain, crossings: crossings.into(), attributes }
    }

    /// The maximum absolute coordinate of the corners of the mesh's blocks.
    pub fn farthest_coordinate(&self) -> f64 {
        let corners = |(block, level): (IVec3, BlockLevel)| {
            let CellBox { lo, hi } = CellBox::cube(block, BLOCK);
            let grid = self.grid.in_wider_cells(level.level.into());
            [lo, hi].map(|cells| grid.world_from_cells(cells.as_dvec3()).abs().max_element())
        };
        self.spool.blocks().flat_map(corners).fold(0.0, f64::max)
    }

    /// Makes the whole mesh in memory.
    pub fn to_mesh(&self) -> Result<Mesh, WholeMeshError> {
        if u32::try_from(self.vertex_count()).is_err() {
            return Err(WholeMeshError::TooManyVertices(self.vertex_count()));
        }
        let (positions, triangles) = self.positions_and_triangles()?;
        let normals = || self.of_vertices(1, |block, to| to.copy_from_slice(&block.normals));
        let attribute = |(i, info): (usize, &AttributeInfo)| {
            let put = |block: &BlockMesh, to: &mut [f32]| to.copy_from_slice(&block.attributes[i]);
            let values = self.of_vertices(info.components, put)?;
            let mut attribute = VertexAttribute::without_values(info.clone());
            if info.kind.is_whole() {
                attribute.extend(&values);
            } else {
                attribute.values = values;
            }
            Ok(attribute)
        };
        Ok(Mesh {
            positions,
            triangles,
            normals: self.has_normals().then(normals).transpose()?,
            attributes: self
                .attributes
                .iter()
                .enumerate()
                .map(attribute)
                .collect::<io::Result<_>>()?,
        })
    }

    /// The positions of all vertices, and all triangles. Vertex numbers must fit into 32 bits.
    fn positions_and_triangles(&self) -> io::Result<Indexed> {
        let positions = self.of_vertices(1, |block, to| self.place(block, to))?;
        let mut triangles = zeroed_in_huge_pages(self.triangle_count() as usize);
        split(&mut triangles, (0..self.pieces()).map(|i| self.spool.counts(i)[1]))
            .into_par_iter()
            .enumerate()
            .try_for_each(|(i, to)| self.emit(i, |n, _, t| to[n] = t.map(|v| v as u32)))?;
        Ok((positions, triangles))
    }

    /// Collects `width` numbers per vertex; `put` writes them block by block.
    fn of_vertices<T: Zeroable + Send>(
        &self,
        width: usize,
        put: impl Fn(&BlockMesh, &mut [T]) + Sync,
    ) -> io::Result<Vec<T>> {
        let mut all = zeroed_in_huge_pages(width * self.vertex_count() as usize);
        split(&mut all, (0..self.pieces()).map(|i| width * self.spool.counts(i)[0]))
            .into_par_iter()
            .enumerate()
            .try_for_each(|(i, to)| self.spool.get(i).map(|block| put(&block, to)))?;
        Ok(all)
    }

    /// The grid of the surface.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Size of all block surfaces, in bytes.
    pub fn bytes(&self) -> u64 {
        self.spool.bytes()
    }

    /// The enclosed volume, computed from columns of cells along x and their lengths inside the
    /// surface. It equals the volume of the mesh, except for the effect of the surface's curvature
    /// within a cell.
    ///
    /// # Errors
    /// If the scratch file cannot be read.
    pub fn volume(&self) -> io::Result<f64> {
        self.volume_within(None)
    }

    /// The [volume](Self::volume) inside the cells `within`, or everywhere if `within` is `None`.
    ///
    /// # Errors
    /// If the scratch file cannot be read.
    pub fn volume_within(&self, within: Option<CellBox>) -> io::Result<f64> {
        let of_piece =
            |piece: usize| self.spool.get(piece).map(|block| self.block_columns(&block, within));
        let columns: Vec<f64> =
            (0..self.pieces()).into_par_iter().map(of_piece).collect::<io::Result<_>>()?;
        Ok(columns.iter().sum::<f64>() * self.grid.cell_size().powi(3))
    }

    /// The contribution of a block's columns along x to the enclosed volume, in units of the volume
    /// of a finest cell.
    fn block_columns(&self, block: &BlockMesh, within: Option<CellBox>) -> f64 {
        let edge = f64::from(1_u32 << block.level.level);
        let of_tile = |tile: &Tile| {
            let first = tile.corner(block.block);
            let ends = &block.ends[tile.first_vertex as usize..];
            let crossings = bits(block.level.crossed(tile)[0]).zip(ends).map(|(bit, &ends)| {
                let cell = first + cell_of_bit(bit);
                let [lower, upper] = [cell, cell + IVec3::X].map(|cell| middle(block, cell).x);
                let fraction = self.crossings.fraction(ends);
                let mut x = edge * (lower + (upper - lower) * fraction);
                if let Some(CellBox { lo, hi }) = within {
                    let column = (cell << i32::from(block.level.level)).with_x(lo.x);
                    if column.cmplt(lo).any() || column.cmpge(hi).any() {
                        return 0.0;
                    }
                    x = x.clamp(f64::from(lo.x), f64::from(hi.x));
                }
                if tile.corners[0] >> bit & 1 == 1 { x } else { -x }
            });
            crossings.sum::<f64>()
        };
        block.tiles.iter().map(of_tile).sum::<f64>() * edge * edge
    }

    /// For each piece, the first of its finest blocks in Morton order.
    pub fn blocks(&self) -> impl Iterator<Item = IVec3> + '_ {
        self.spool.blocks().map(|(block, level)| level.first_block(block))
    }

    /// The widest level of any piece.
    pub fn widest_level(&self) -> u8 {
        self.spool.blocks().map(|(_, level)| level.level).max().unwrap_or(0)
    }

    /// The level of a piece.
    pub fn level(&self, piece: usize) -> BlockLevel {
        self.spool.level(piece)
    }

    /// The tiles of a piece.
    ///
    /// # Errors
    /// If the scratch file cannot be read.
    pub fn tiles(&self, piece: usize) -> io::Result<Cow<'_, [Tile]>> {
        self.spool.tiles(piece)
    }

    /// The block of a piece, in blocks of its level.
    pub fn block(&self, piece: usize) -> IVec3 {
        self.spool.block(piece)
    }

    /// The number of the first vertex of a piece.
    pub fn first_vertex(&self, piece: usize) -> u64 {
        self.spool.first_vertex(piece)
    }

    /// The piece that contains a vertex.
    pub fn piece_of(&self, vertex: u64) -> usize {
        self.spool.piece_of(vertex)
    }

    /// Number of vertices in a piece.
    pub fn piece_vertices(&self, piece: usize) -> usize {
        self.spool.counts(piece)[0]
    }

    /// For each vertex of a piece, the lower cell of its edge and the position of the vertex, both
    /// in finest cells.
    ///
    /// # Errors
    /// If the scratch file cannot be read.
    pub fn places(&self, piece: usize) -> io::Result<Vec<(IVec3, DVec3)>> {
        let block = self.spool.get(piece)?;
        let positions = self.positions(&block);
        let mut places = Vec::with_capacity(positions.len());
        block.edges().for_each(|(cell, _)| {
            let cell = cell << i32::from(block.level.level);
            places.push((cell, self.grid.cells_from_world(positions[places.len()]).into()));
        });
        Ok(places)
    }

    /// Calls `put` with each triangle of a piece, and the lowest corner of the triangle's dual
    /// cell, in finest cells.
    ///
    /// # Errors
    /// If the scratch file cannot be read.
    pub fn cell_triangles(
        &self,
        piece: usize,
        mut put: impl FnMut(IVec3, [u64; 3]),
    ) -> io::Result<()> {
        let level = i32::from(self.spool.level(piece).level);
        self.emit(piece, |_, cell, triangle| put(cell << level, triangle))
    }

    /// Computes the positions of a block's vertices: v = (1 - a) p_i + a p_j, or a point on the
    /// wall. Stitching needs floating-point arithmetic only here.
    fn place(&self, block: &BlockMesh, positions: &mut [[f64; 3]]) {
        let level = block.level.level.into();
        let grid = self.grid.in_wider_cells(level);
        let domain = self.domain.map(|domain| domain.in_wider_cells(level));
        let uniform = block.level.is_uniform();
        let place = |cell: IVec3, axis: usize, ends: [u16; 2]| {
            let fraction = self.crossings.fraction(ends);
            let mut cells = cell.as_dvec3() + 0.5;
            // Beyond a wall, there are only ghost points.
            let is_within = |cell| domain.is_none_or(|domain| domain.cells().contains(cell));
            if uniform || !is_within(cell) || !is_within(cell + IVec3::AXES[axis]) {
                cells[axis] += fraction;
            } else {
                let [lower, upper] =
                    [cell, cell + IVec3::AXES[axis]].map(|cell| middle(block, cell));
                cells = lower + (upper - lower) * fraction;
            }
            let mut world = grid.world_from_cells(cells);
            if let Some(domain) = &domain {
                let [lower, upper] = domain.walls();
                if cell[axis] < domain.cells().lo[axis] {
                    world[axis] = lower[axis];
                } else if cell[axis] + 1 == domain.cells().hi[axis] {
                    world[axis] = upper[axis];
                }
                world = DVec3::clamp(world, lower, upper);
            }
            world.to_array()
        };
        let mut places = positions.iter_mut().zip(&block.ends);
        block.edges().for_each(|(cell, axis)| {
            let (position, &ends) = places.next().expect("a place for every edge");
            *position = place(cell, axis, ends);
        });
    }

    fn positions(&self, block: &BlockMesh) -> Vec<[f64; 3]> {
        let mut positions = vec![[0.0; 3]; block.ends.len()];
        self.place(block, &mut positions);
        positions
    }

    /// Number of triangles in a piece.
    fn piece_triangles(&self, piece: usize) -> usize {
        self.spool.counts(piece)[1]
    }

    /// Calls `put` with the rank, the dual cell and the vertices of each triangle of block number
    /// `i`. Vertices belong to the block or to its upper neighbours.
    fn emit(&self, i: usize, put: impl FnMut(usize, IVec3, [u64; 3])) -> io::Result<()> {
        let numbered = |found: usize, tile: &Tile| {
            let mut next = self.spool.first_vertex(found) + u64::from(tile.first_vertex);
            move |_| {
                next += 1;
                next - 1
            }
        };
        self.emit_by(i, numbered, put)
    }

    /// Like `emit`, but with other vertex numbers. `numbered` is called for each tile of a block in
    /// order, and returns a function that gives the number of a vertex from its bit in the tile.
    fn emit_by<N: FnMut(u32) -> u64>(
        &self,
        i: usize,
        mut numbered: impl FnMut(usize, &Tile) -> N,
        mut put: impl FnMut(usize, IVec3, [u64; 3]),
    ) -> io::Result<()> {
        thread_local! {
            static NUMBERS: Cell<Option<VertexNumbers>> = const { Cell::new(None) };
        }
        let mut numbers = NUMBERS.take().unwrap_or_else(VertexNumbers::new);
        let (block, own) = (self.spool.block(i), self.spool.tiles(i)?);
        let level = self.spool.level(i);
        let mut wider: Vec<IVec3> = Vec::new();
        for neighbour in 0..8 {
            let coord = block + corner_offset(neighbour);
            if level.wider >> neighbour & 1 == 1 && !wider.contains(&(coord >> 1)) {
                wider.push(coord >> 1);
            }
            let Some(found) = self.spool.find(coord, level.level) else { continue };
            let tiles = if found == i { Cow::Borrowed(&*own) } else { self.spool.tiles(found)? };
            let of_found = self.spool.level(found);
            for tile in tiles.iter() {
                let corner = tile.corner(coord) - block * BLOCK;
                numbers.enter(tile, of_found, corner, numbered(found, tile));
            }
        }
        for coord in wider {
            let Some(found) = self.spool.find(coord, level.level + 1) else { continue };
            let of_found = self.spool.level(found);
            for tile in self.spool.tiles(found)?.iter() {
                let corner = tile.corner(coord) * 2 - block * BLOCK;
                numbers.enter_wider(tile, of_found, corner, numbered(found, tile));
            }
        }
        numbers.triangles((block, level), &own, &mut put);
        NUMBERS.set(Some(numbers));
        Ok(())
    }
}

/// The middle of a cell of a block's lattice, or of the wide cell that contains it, in cells of the
/// block.
fn middle(block: &BlockMesh, cell: IVec3) -> DVec3 {
    if !block.level.is_uniform() && block.level.is_wider(block.block, cell) {
        (cell & !1).as_dvec3() + 1.0
    } else {
        cell.as_dvec3() + 0.5
    }
}

/// Splits a slice into consecutive pieces of the given lengths.
fn split<T>(mut rest: &mut [T], lengths: impl Iterator<Item = usize>) -> Vec<&mut [T]> {
    lengths
        .map(|length| {
            let (piece, tail) = std::mem::take(&mut rest).split_at_mut(length);
            rest = tail;
            piece
        })
        .collect()
}
