//! A mesh with fewer triangles for a preview: nearby vertices are merged (Rossignac and Borrel
//! 1993).
//!
//! The vertices of 2 x 2 x 2 cells are merged at their mean position, and triangles with two equal
//! corners are left out. If the surface is closed, every line of sight leaves the result as often
//! as it enters the result, which is the property that pictures need.

use std::io;

use glam::DVec3;
use rayon::prelude::*;

use crate::grid::BlockLevel;
use crate::surface::mesh::source::{Indexed, MeshSource, Outline, Vertices};
use crate::surface::mesh::{BlockMesh, Tile, TileMask, bits};
use crate::system::memory::zeroed_in_huge_pages;

use super::{StitchedSurface, split};

/// The lowest cells of all groups of 2 x 2 x 2 cells, as bits of a tile.
const LOWEST: TileMask = 0x0505_0000_0505;
/// This mask turns the number of a cell's bit into the number of the lowest cell in its group.
const LOWEST_OF: u32 = 0b10_1010;

/// A mesh with merged vertices.
pub(super) struct CoarseMesh<'a> {
    fine: &'a StitchedSurface,
    /// The number of the first vertex of each piece, and the total.
    firsts: Vec<u64>,
}

/// The groups of 2 x 2 x 2 cells in a tile that have vertices, each given by its lowest cell.
fn groups(tile: &Tile, level: BlockLevel) -> TileMask {
    let [x, y, z] = level.crossed(tile);
    let crossed = x | y | z;
    let along_x = crossed | crossed >> 1;
    let along_y = along_x | along_x >> 4;
    (along_y | along_y >> 16) & LOWEST
}

/// The number of a cell's group among the groups of its tile.
fn rank(groups: TileMask, bit: u32) -> usize {
    (groups & ((1 << (bit & LOWEST_OF)) - 1)).count_ones() as usize
}

impl<'a> CoarseMesh<'a> {
    /// Counts the remaining vertices.
    pub(super) fn new(fine: &'a StitchedSurface) -> io::Result<Self> {
        let count = |piece: usize| -> io::Result<u64> {
            let of = |tile: &Tile| u64::from(groups(tile, fine.level(piece)).count_ones());
            Ok(fine.tiles(piece)?.iter().map(of).sum())
        };
        let counts: Vec<u64> =
            (0..fine.pieces()).into_par_iter().map(count).collect::<io::Result<_>>()?;
        let mut firsts = vec![0];
        firsts.extend(counts.iter().scan(0, |sum, count| {
            *sum += count;
            Some(*sum)
        }));
        Ok(Self { fine, firsts })
    }

    fn vertices_of(&self, piece: usize) -> usize {
        (self.firsts[piece + 1] - self.firsts[piece]) as usize
    }

    /// Writes the merged vertices of a block.
    fn place(&self, block: &BlockMesh, to: &mut [[f64; 3]]) {
        let places = self.fine.positions(block);
        let (mut places, mut rest) = (places.iter(), to);
        for tile in &block.tiles {
            let groups = groups(tile, block.level);
            let mut sums = [(DVec3::ZERO, 0.0); 8];
            for bit in block.level.crossed(tile).into_iter().flat_map(bits) {
                let (sum, count) = &mut sums[rank(groups, bit)];
                *sum += DVec3::from(*places.next().expect("a place for every edge"));
                *count += 1.0;
            }
            let (own, others) = rest.split_at_mut(groups.count_ones() as usize);
            own.iter_mut().zip(sums).for_each(|(to, (sum, count))| *to = (sum / count).to_array());
            rest = others;
        }
    }

    /// Collects the remaining triangles of a piece.
    fn remaining_triangles<T>(
        &self,
        piece: usize,
        of: impl Fn(u64) -> T + Copy,
    ) -> io::Result<Vec<[T; 3]>> {
        let mut triangles = Vec::with_capacity(self.fine.piece_triangles(piece) / 2);
        let mut next = 0;
        self.fine.emit_by(
            piece,
            |found, tile| {
                // `first_vertex` counts the block's vertices before the tile, so it is 0 in the
                // first tile of the block.
                next = if tile.first_vertex == 0 { self.firsts[found] } else { next };
                let (groups, first) = (groups(tile, self.fine.level(found)), next);
                next += u64::from(groups.count_ones());
                move |bit| first + rank(groups, bit) as u64
            },
            |_, _, [a, b, c]| {
                if a != b && b != c && c != a {
                    triangles.push([a, b, c].map(of));
                }
            },
        )?;
        Ok(triangles)
    }
}

impl MeshSource for CoarseMesh<'_> {
    /// A summary that counts all triangles, although fewer remain.
    fn outline(&self) -> Outline {
        Outline {
            vertices: self.firsts[self.fine.pieces()],
            triangles: self.fine.triangle_count(),
            pieces: self.fine.pieces(),
            ..Outline::default()
        }
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        let mut positions = vec![[0.0; 3]; self.vertices_of(piece)];
        self.place(&*self.fine.spool.get(piece)?, &mut positions);
        Ok(Vertices { positions: positions.into(), ..Vertices::default() })
    }

    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        self.remaining_triangles(piece, |vertex| vertex)
    }

    fn at_once(&self) -> io::Result<Option<Indexed>> {
        if u32::try_from(self.vertex_count()).is_err() {
            return Ok(None);
        }
        let pieces = self.fine.pieces();
        let mut positions = zeroed_in_huge_pages(self.vertex_count() as usize);
        let left: Vec<_> = split(&mut positions, (0..pieces).map(|piece| self.vertices_of(piece)))
            .into_par_iter()
            .enumerate()
            .map(|(piece, to)| {
                self.place(&*self.fine.spool.get(piece)?, to);
                self.remaining_triangles(piece, |vertex| vertex as u32)
            })
            .collect::<io::Result<_>>()?;
        Ok(Some((positions, left.concat())))
    }
}
