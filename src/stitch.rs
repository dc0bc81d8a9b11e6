//! One mesh from the surfaces of all blocks, by the identity of dual edges.
//!
//! A vertex's number is its block's base, plus its tile's, plus its rank among the tile's crossed edges:
//! a prefix sum and a population count. Nothing is searched for by position and nothing depends on
//! distance. Order is that of tiles along the Morton curve.

use glam::{DVec3, IVec3};
use rayon::prelude::*;
use thiserror::Error;

use crate::grid::{BLOCK, Domain, Grid, MortonKey, TILE};
use crate::mesh::{BlockMesh, Mesh, TileMask, VertexAttribute, bits, cell_of_bit};
use crate::particles::AttributeInfo;
use crate::stage::dual_mc::{table::TABLE, vertex_fraction};
use crate::units::Isovalue;

/// Tiles along a block's edge.
const TILES: i32 = BLOCK / TILE;

/// A mesh that cannot be indexed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("the surface has {vertices} vertices; an indexed mesh holds {limit} at most; use a larger cell size", limit = u32::MAX)]
pub struct TooManyVertices {
    /// How many there are.
    pub vertices: u64,
}

/// Joins the surfaces of blocks, which must be in Morton order.
///
/// # Errors
/// [`TooManyVertices`] where 32 bits cannot number them.
pub fn stitch(
    blocks: &[BlockMesh],
    grid: &Grid,
    domain: Option<&Domain>,
    iso: Isovalue,
    attributes: &[AttributeInfo],
) -> Result<Mesh, TooManyVertices> {
    let vertices: u64 = blocks.iter().map(|b| b.ends.len() as u64).sum();
    if u32::try_from(vertices).is_err() {
        return Err(TooManyVertices { vertices });
    }
    let bases: Vec<u32> = blocks
        .iter()
        .scan(0, |next, block| {
            let base = *next;
            *next += block.ends.len() as u32;
            Some(base)
        })
        .collect();
    let triangle_count = blocks.iter().map(|b| b.triangle_count).sum();

    let mut positions = vec![[0.0; 3]; vertices as usize];
    split(&mut positions, blocks.iter().map(|b| b.ends.len()))
        .into_par_iter()
        .zip(blocks)
        .for_each(|(to, block)| place_vertices(to, block, grid, domain, iso));

    let mut triangles = vec![[0; 3]; triangle_count];
    split(&mut triangles, blocks.iter().map(|b| b.triangle_count))
        .into_par_iter()
        .zip(0..blocks.len())
        .for_each(|(to, i)| emit_triangles(to, blocks, &bases, i));

    let normals = blocks.iter().any(|b| !b.normals.is_empty());
    Ok(Mesh {
        positions,
        triangles,
        normals: normals.then(|| blocks.iter().flat_map(|b| &b.normals).copied().collect()),
        attributes: attributes
            .iter()
            .enumerate()
            .map(|(i, AttributeInfo { name, components })| VertexAttribute {
                name: name.clone(),
                components: *components,
                values: blocks.iter().flat_map(|b| &b.attributes[i]).copied().collect(),
            })
            .collect(),
    })
}

/// Consecutive pieces of the given lengths.
fn split<T>(mut rest: &mut [T], lengths: impl Iterator<Item = usize>) -> Vec<&mut [T]> {
    lengths
        .map(|length| {
            let (piece, tail) = std::mem::take(&mut rest).split_at_mut(length);
            rest = tail;
            piece
        })
        .collect()
}

/// The one place where floating point enters: v = (1 - a) p_i + a p_j, or a point of the wall.
fn place_vertices(
    to: &mut [[f64; 3]],
    block: &BlockMesh,
    grid: &Grid,
    domain: Option<&Domain>,
    iso: Isovalue,
) {
    let edges = block.tiles.iter().flat_map(|tile| {
        let corner = tile.corner(block.block);
        tile.edges().map(move |(cell, axis)| (corner + cell, axis))
    });
    for ((to, &ends), (cell, axis)) in to.iter_mut().zip(&block.ends).zip(edges) {
        let mut cells = cell.as_dvec3() + 0.5;
        cells[axis] += vertex_fraction(ends, iso);
        let mut world = grid.world_from_cells(cells);
        if let Some(domain) = domain {
            let [lower, upper] = domain.walls();
            if cell[axis] < domain.cells().lo[axis] {
                world[axis] = lower[axis];
            } else if cell[axis] + 1 == domain.cells().hi[axis] {
                world[axis] = upper[axis];
            }
            world = DVec3::clamp(world, lower, upper);
        }
        *to = world.to_array();
    }
}

/// What is needed of a tile to number the vertices on its edges.
#[derive(Clone, Copy, Default)]
struct Numbering {
    crossed: [TileMask; 3],
    /// The number of the first vertex along each axis.
    first: [u32; 3],
}

impl Numbering {
    fn vertex(&self, axis: usize, bit: u32) -> u32 {
        self.first[axis] + (self.crossed[axis] & ((1 << bit) - 1)).count_ones()
    }
}

/// Writes the triangles of block number `i`: each refers to vertices of the block and of those next to it
/// along the axes.
fn emit_triangles(to: &mut [[u32; 3]], blocks: &[BlockMesh], bases: &[u32], i: usize) {
    let block = &blocks[i];
    let numberings = gather_numberings(blocks, bases, block.block);
    let mut to = to.iter_mut();
    for tile in &block.tiles {
        let corner = tile.corner(block.block) - block.block * BLOCK;
        for bit in bits(tile.mixed()) {
            let cell = corner + cell_of_bit(bit);
            for triangle in &TABLE[tile.case(bit)] {
                let vertices = triangle.map(|edge| {
                    let at = cell + edge.offset();
                    let in_tile = at & (TILE - 1);
                    let bit = in_tile.x + TILE * (in_tile.y + TILE * in_tile.z);
                    numberings[numbering_index(at / TILE)].vertex(edge.axis.into(), bit as u32)
                });
                *to.next().expect("triangles were counted by the same table") = vertices;
            }
        }
    }
}

/// Tiles of a block, and one layer of the blocks above.
const NUMBERED: i32 = TILES + 1;

fn numbering_index(tile: IVec3) -> usize {
    (tile.x + NUMBERED * (tile.y + NUMBERED * tile.z)) as usize
}

fn gather_numberings(blocks: &[BlockMesh], bases: &[u32], coord: IVec3) -> Vec<Numbering> {
    let mut numberings = vec![Numbering::default(); NUMBERED.pow(3) as usize];
    for neighbour in 0..8 {
        let offset = IVec3::new(neighbour & 1, neighbour >> 1 & 1, neighbour >> 2);
        let key = MortonKey::of(coord + offset);
        let Ok(found) = blocks.binary_search_by_key(&key, |b| MortonKey::of(b.block)) else { continue };
        let block = &blocks[found];
        for tile in &block.tiles {
            let local = (tile.corner(coord + offset) - coord * BLOCK) / TILE;
            if local.max_element() > TILES {
                continue;
            }
            let crossed = [0, 1, 2].map(|axis| tile.crossed(axis));
            let x = bases[found] + tile.first_vertex;
            let y = x + crossed[0].count_ones();
            let z = y + crossed[1].count_ones();
            numberings[numbering_index(local)] = Numbering { crossed, first: [x, y, z] };
        }
    }
    numberings
}
