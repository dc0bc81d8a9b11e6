//! Numbers of the vertices on a block's dual edges, and the triangles between these vertices.

use std::borrow::Cow;
use std::io;
use std::path::Path;
use std::sync::LazyLock;

use glam::IVec3;
use multiversion::multiversion;

use crate::grid::{BLOCK, BlockLevel, CellBox};
use crate::surface::dual_mc::cases::{CellEdge, TABLE};
use crate::surface::dual_mc::levels::{at_corners, joined_triangles};
use crate::surface::mesh::source::{Indexed, Lattice, MeshSource, Outline, PieceOutline, Vertices};
use crate::surface::mesh::{Tile, bits, cell_of_bit};

use super::StitchedSurface;
use super::coarse::CoarseMesh;

/// Number of cells along each axis: the cells of a block, and one layer of cells of the next block.
const EDGE: usize = BLOCK as usize + 1;

/// The maximum distance, in cells of a block, between the block and the vertices of its triangles.
const REACH: i32 = 2;

/// Approximate ratio of triangles to vertices of a closed surface.
const TRIANGLES_PER_VERTEX: u64 = 2;
/// Memory, in bytes per triangle of a block, for a thread that writes the block: three vertex
/// numbers, and 13-byte records for four blocks.
const TRIANGLE_BYTES: u64 = 24 + 4 * 13;

/// Memory, in bytes, for `threads` threads, each of which numbers and writes the triangles of a
/// block. These blocks have `vertices` vertices in total.
pub fn writing_bytes(threads: u64, vertices: u64) -> u64 {
    let numbers = (3 * EDGE.pow(3) * size_of::<u64>()) as u64;
    threads * numbers + vertices * TRIANGLES_PER_VERTEX * TRIANGLE_BYTES
}

/// The numbers of the vertices on the dual edges that a block's triangles use. Other entries are
/// undefined.
pub(super) struct VertexNumbers {
    /// Three vertex numbers per cell, one for each dual edge that starts at the cell: along x, y
    /// and z. From cell to cell, x varies fastest.
    numbers: Vec<u64>,
}

impl VertexNumbers {
    pub(super) fn new() -> Self {
        Self { numbers: vec![0; 3 * EDGE.pow(3)] }
    }

    /// Sets the numbers of the vertices of a tile whose lowest cell is at `corner`, relative to the
    /// block; `number` is called with the bit of each vertex in order, and returns the vertex's
    /// number.
    #[inline]
    pub(super) fn enter(
        &mut self,
        tile: &Tile,
        level: BlockLevel,
        corner: IVec3,
        mut number: impl FnMut(u32) -> u64,
    ) {
        if corner.max_element() >= EDGE as i32 {
            return;
        }
        for (axis, crossed) in level.crossed(tile).into_iter().enumerate() {
            for bit in bits(crossed) {
                let (cell, number) = (corner + cell_of_bit(bit), number(bit));
                if cell.max_element() < EDGE as i32 {
                    self.numbers[index(cell) + axis] = number;
                }
            }
        }
    }

    /// Like [`enter`](Self::enter), for a tile of wider cells: each edge of such a tile corresponds
    /// to four edges of the block's lattice. `corner` is in cells of that lattice.
    pub(super) fn enter_wider(
        &mut self,
        tile: &Tile,
        level: BlockLevel,
        corner: IVec3,
        mut number: impl FnMut(u32) -> u64,
    ) {
        let is_inside = |cell: IVec3| cell.min_element() >= 0 && cell.max_element() < EDGE as i32;
        for (axis, crossed) in level.crossed(tile).into_iter().enumerate() {
            for bit in bits(crossed) {
                let (lowest, number) = (corner + 2 * cell_of_bit(bit), number(bit));
                for side in 0..4 {
                    let mut cell = lowest + IVec3::AXES[axis];
                    cell[(axis + 1) % 3] += side & 1;
                    cell[(axis + 2) % 3] += side >> 1;
                    if is_inside(cell) {
                        self.numbers[index(cell) + axis] = number;
                    }
                }
            }
        }
    }

    /// Calls `put` with the rank, the dual cell and the vertices of each triangle of a block.
    pub(super) fn triangles<F: FnMut(usize, IVec3, [u64; 3])>(
        &self,
        (block, level): (IVec3, BlockLevel),
        tiles: &[Tile],
        put: &mut F,
    ) {
        if level.is_uniform() {
            triangles(&self.numbers, block, tiles, put);
        } else {
            mixed_triangles(&self.numbers, (block, level), tiles, put);
        }
    }
}

#[multiversion(targets("x86_64+avx2+bmi1+bmi2", "x86_64+sse4.2"))]
fn triangles<F: FnMut(usize, IVec3, [u64; 3])>(
    numbers: &[u64],
    block: IVec3,
    tiles: &[Tile],
    put: &mut F,
) {
    let (fans, mut rank) = (&*FANS, 0);
    for tile in tiles {
        let corner = tile.corner(block);
        for bit in bits(tile.mixed()) {
            let cell = corner + cell_of_bit(bit);
            let numbers = &numbers[index(cell - block * BLOCK)..];
            for edges in &fans[tile.case(bit)] {
                put(rank, cell, edges.map(|edge| numbers[usize::from(edge)]));
                rank += 1;
            }
        }
    }
}

/// Like [`triangles`], for a block whose dual cells join cells of several levels.
fn mixed_triangles<F: FnMut(usize, IVec3, [u64; 3])>(
    numbers: &[u64],
    (block, level): (IVec3, BlockLevel),
    tiles: &[Tile],
    put: &mut F,
) {
    let mut rank = 0;
    for tile in tiles {
        let corner = tile.corner(block);
        let wider = level.of_tile(tile).wider;
        for bit in bits(level.mixed(tile)) {
            let cell = corner + cell_of_bit(bit);
            let numbers = &numbers[index(cell - block * BLOCK)..];
            for edges in joined_triangles(cell, tile.case(bit), at_corners(&wider, bit)) {
                put(rank, cell, edges.map(|edge| numbers[usize::from(place(edge))]));
                rank += 1;
            }
        }
    }
}

/// The index of an edge's number, relative to the first number of the dual cell's lowest corner.
fn place(edge: CellEdge) -> u16 {
    (index(edge.offset()) + usize::from(edge.axis)) as u16
}

/// The index of a cell's first number.
fn index(cell: IVec3) -> usize {
    let cell = cell.as_usizevec3();
    3 * (cell.x + EDGE * (cell.y + EDGE * cell.z))
}

/// [`TABLE`], with each edge replaced by the index of its number, relative to the first number of
/// the dual cell's lowest corner.
static FANS: LazyLock<[Vec<[u16; 3]>; 256]> = LazyLock::new(|| {
    std::array::from_fn(|case| TABLE[case].iter().map(|triangle| triangle.map(place)).collect())
});

impl MeshSource for StitchedSurface {
    fn outline(&self) -> Outline {
        Outline {
            vertices: self.spool.vertices(),
            triangles: self.spool.triangles(),
            normals: self.spool.has_normals(),
            attributes: self.attributes.clone(),
            pieces: self.spool.len(),
            lattice: Some(Lattice::of(self.grid)),
        }
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        let block = self.spool.get(piece)?;
        let positions = self.positions(&block).into();
        Ok(match block {
            Cow::Borrowed(block) => Vertices {
                positions,
                normals: (&block.normals).into(),
                attributes: block.attributes.iter().map(Into::into).collect(),
            },
            Cow::Owned(block) => Vertices {
                positions,
                normals: block.normals.into(),
                attributes: block.attributes.into_iter().map(Into::into).collect(),
            },
        })
    }

    fn coarser(&self) -> io::Result<Option<Box<dyn MeshSource + '_>>> {
        Ok(Some(Box::new(CoarseMesh::new(self)?)))
    }

    fn at_once(&self) -> io::Result<Option<Indexed>> {
        u32::try_from(self.vertex_count())
            .is_ok()
            .then(|| self.positions_and_triangles())
            .transpose()
    }

    fn piece_outline(&self, piece: usize) -> Option<PieceOutline> {
        let [vertices, triangles] = self.spool.counts(piece).map(|count| count as u64);
        let cells = CellBox::cube(self.spool.block(piece), BLOCK).grown(REACH, REACH);
        let grid = self.grid.in_wider_cells(self.spool.level(piece).level.into());
        let corner = |cell: IVec3| grid.world_from_cells(cell.as_dvec3()).to_array();
        Some(PieceOutline { bounds: [corner(cells.lo), corner(cells.hi)], vertices, triangles })
    }

    fn scratch_folder(&self) -> Option<&Path> {
        self.spool.scratch_folder()
    }

    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        let mut triangles = Vec::with_capacity(self.spool.counts(piece)[1]);
        self.emit(piece, |_, _, triangle| triangles.push(triangle))?;
        Ok(triangles)
    }
}
