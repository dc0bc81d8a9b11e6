//! Orders a mesh for renderers and codecs. Triangles that share vertices are close together in the
//! order, so that renderers reuse vertices while these are in the vertex cache. Vertices are
//! ordered by their first use.

use std::borrow::Cow;
use std::io;

use hashbrown::HashMap;
use meshopt::optimize_vertex_cache;
use rayon::prelude::*;

use super::source::{Corners, bounds_of, joined};
use super::source::{MeshSource, Outline, Vertices};

/// A mesh with its vertices and triangles in a better order within each piece. The order takes 4
/// bytes per vertex.
pub struct OrderedMesh<'a> {
    mesh: &'a dyn MeshSource,
    /// For each vertex, its new number within its piece.
    ranks: Vec<u32>,
    /// The number of the first vertex of each piece; the last entry is the total number of
    /// vertices.
    firsts: Vec<u64>,
    bounds: Option<Corners>,
}

impl<'a> OrderedMesh<'a> {
    /// Finds the order, with one pass over the vertices and one over the triangles.
    pub fn new(mesh: &'a dyn MeshSource) -> io::Result<Self> {
        let counted: Vec<_> = (0..mesh.pieces())
            .into_par_iter()
            .map(|piece| {
                let vertices = mesh.vertices(piece)?;
                Ok((vertices.positions.len(), bounds_of(&vertices.positions)))
            })
            .collect::<io::Result<_>>()?;
        let bounds = counted.iter().filter_map(|&(_, corners)| corners).reduce(joined);
        let mut firsts = vec![0];
        for (count, _) in &counted {
            firsts.push(firsts[firsts.len() - 1] + *count as u64);
        }
        let mut ordered = Self { mesh, ranks: Vec::new(), firsts, bounds };
        let ranks: Vec<Vec<u32>> = (0..mesh.pieces())
            .into_par_iter()
            .map(|piece| ordered.ranks_in(piece))
            .collect::<io::Result<_>>()?;
        ordered.ranks = ranks.concat();
        Ok(ordered)
    }

    /// The bounding box of all vertices.
    pub fn bounds(&self) -> Option<Corners> {
        self.bounds
    }

    /// The triangles of a piece in the new order, with old vertex numbers.
    fn cached(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        let triangles = self.mesh.triangles(piece)?;
        let mut local = HashMap::with_capacity(triangles.len());
        let mut global = Vec::new();
        let corners: Vec<u32> = triangles
            .as_flattened()
            .iter()
            .map(|&vertex| {
                *local.entry(vertex).or_insert_with(|| {
                    global.push(vertex);
                    global.len() as u32 - 1
                })
            })
            .collect();
        let corners = optimize_vertex_cache(&corners, global.len());
        Ok(corners
            .chunks_exact(3)
            .map(|c| [c[0], c[1], c[2]].map(|v| global[v as usize]))
            .collect())
    }

    /// For each vertex of a piece, its new number. Vertices are numbered in the order in which the
    /// piece's triangles use them, followed by the vertices that these triangles do not use.
    fn ranks_in(&self, piece: usize) -> io::Result<Vec<u32>> {
        const UNUSED: u32 = u32::MAX;
        let own = self.firsts[piece]..self.firsts[piece + 1];
        let mut ranks = vec![UNUSED; (own.end - own.start) as usize];
        let triangles = self.cached(piece)?;
        let used = triangles.as_flattened().iter().filter(|vertex| own.contains(vertex));
        let mut next = 0;
        for rank in used.map(|&vertex| (vertex - own.start) as usize).chain(0..ranks.len()) {
            if ranks[rank] == UNUSED {
                ranks[rank] = next;
                next += 1;
            }
        }
        Ok(ranks)
    }

    fn renumbered(&self, vertex: u64) -> u64 {
        let piece = self.firsts.partition_point(|&first| first <= vertex) - 1;
        self.firsts[piece] + u64::from(self.ranks[vertex as usize])
    }
}

impl MeshSource for OrderedMesh<'_> {
    fn outline(&self) -> Outline {
        self.mesh.outline()
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        let vertices = self.mesh.vertices(piece)?;
        let ranks = &self.ranks[self.firsts[piece] as usize..self.firsts[piece + 1] as usize];
        let attributes = vertices.attributes.iter().zip(self.attributes());
        Ok(Vertices {
            positions: Cow::Owned(permuted(&vertices.positions, ranks, 1)),
            normals: Cow::Owned(permuted(&vertices.normals, ranks, 1)),
            attributes: attributes
                .map(|(values, info)| Cow::Owned(permuted(values, ranks, info.components)))
                .collect(),
        })
    }

    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        let triangles = self.cached(piece)?;
        Ok(triangles
            .into_iter()
            .map(|triangle| triangle.map(|vertex| self.renumbered(vertex)))
            .collect())
    }
}

/// Moves each run of `group` values to the place given by its rank.
fn permuted<T: Copy + Default>(values: &[T], ranks: &[u32], group: usize) -> Vec<T> {
    let mut permuted = vec![T::default(); values.len()];
    for (values, &rank) in values.chunks_exact(group.max(1)).zip(ranks) {
        permuted[rank as usize * group..][..group].copy_from_slice(values);
    }
    permuted
}
