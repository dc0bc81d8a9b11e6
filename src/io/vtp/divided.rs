//! Writes a mesh as a .pvtp, which is a list of pieces. Each piece is a .vtp with an equal share of
//! the triangles, and with the vertices of these triangles.
//!
//! A vertex that several pieces share is stored in each of them. An array of global identifiers,
//! the indices of the vertices in the whole mesh, shows which vertices are the same.

use std::io::{self, Write};
use std::ops::Range;

use rayon::prelude::*;

use crate::io::CoordinateWidth;
use crate::io::up::delimited_up_comment;
use crate::surface::mesh::source::MeshSource;
use crate::surface::mesh::{Mesh, VertexAttribute};

use super::arrays::{Array, identifiers, point_data, points};
use super::write::{COMMENT, GLOBAL_IDS, declared, escaped, roles, write_piece};

/// Maximum number of triangles per piece.
pub(in crate::io) const MOST_TRIANGLES: u64 = 1 << 20;

/// A mesh divided into pieces with equal shares of the triangles. The division does not depend on
/// the pieces in which the source provides the mesh.
pub(in crate::io) struct Divided<'a> {
    mesh: &'a dyn MeshSource,
    width: CoordinateWidth,
    /// Index of the first vertex of each piece of the source, and the total number of vertices.
    vertices: Vec<u64>,
    triangles: Vec<u64>,
    pieces: u64,
}

impl<'a> Divided<'a> {
    /// Divides `mesh` into pieces of at most `most` triangles.
    pub fn new(mesh: &'a dyn MeshSource, width: CoordinateWidth, most: u64) -> io::Result<Self> {
        let counts = |piece: usize| -> io::Result<[u64; 2]> {
            let (vertices, triangles) =
                (mesh.vertices(piece)?.positions.len(), mesh.triangles(piece)?.len());
            Ok([vertices as u64, triangles as u64])
        };
        let counts: Vec<[u64; 2]> =
            (0..mesh.pieces()).into_par_iter().map(counts).collect::<io::Result<_>>()?;
        let starts = |which: usize| {
            let mut starts = vec![0];
            starts.extend(counts.iter().scan(0, |sum, count| {
                *sum += count[which];
                Some(*sum)
            }));
            starts
        };
        let [vertices, triangles] = [0, 1].map(starts);
        assert_eq!(vertices.last(), Some(&mesh.vertex_count()), "all vertices are in the pieces");
        assert_eq!(
            triangles.last(),
            Some(&mesh.triangle_count()),
            "all triangles are in the pieces"
        );
        let pieces = mesh.triangle_count().div_ceil(most).max(1);
        Ok(Self { mesh, width, vertices, triangles, pieces })
    }

    pub fn pieces(&self) -> u64 {
        self.pieces
    }

    /// Writes the list of pieces. `names` are the paths of the pieces.
    pub fn write_list(&self, out: &mut dyn Write, names: &[String]) -> io::Result<()> {
        let numbered = self.pieces > 1;
        let mut arrays = point_data(self.mesh, str::to_owned);
        arrays.extend(numbered.then(|| identifiers(GLOBAL_IDS, &[])));
        let array = |array: &Array| declared("PDataArray", array, "");
        let source = |name: &String| format!("<Piece Source=\"{}\"/>\n", escaped(name));
        write!(
            out,
            "<?xml version=\"1.0\"?>\n{}\
             <VTKFile type=\"PPolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
             <PPolyData GhostLevel=\"0\">\n\
             <PPointData{}>\n{}</PPointData>\n\
             <PPoints>\n{}</PPoints>\n\
             {}</PPolyData>\n\
             </VTKFile>\n",
            delimited_up_comment(self.mesh, COMMENT),
            roles(&arrays),
            arrays.iter().map(array).collect::<String>(),
            array(&points(self.mesh, self.width)),
            names.iter().map(source).collect::<String>(),
        )
    }

    /// Writes piece number `piece`.
    pub fn write(&self, out: &mut dyn Write, piece: u64) -> io::Result<()> {
        if self.pieces == 1 {
            return write_piece(out, self.mesh, self.width, None);
        }
        let all = u128::from(self.mesh.triangle_count());
        let start = |piece: u64| (all * u128::from(piece) / u128::from(self.pieces)) as u64;
        let triangles = self.triangles(start(piece)..start(piece + 1))?;
        let mut numbers: Vec<u64> = triangles.as_flattened().to_vec();
        numbers.par_sort_unstable();
        numbers.dedup();
        let own = |vertex: u64| {
            numbers.binary_search(&vertex).expect("all corners are in `numbers`") as u32
        };
        let mut mesh = self.vertices(&numbers)?;
        mesh.triangles = triangles.into_par_iter().map(|triangle| triangle.map(own)).collect();
        write_piece(out, &mesh, self.width, Some(&numbers))
    }

    fn triangles(&self, wanted: Range<u64>) -> io::Result<Vec<[u64; 3]>> {
        let mut triangles = Vec::with_capacity((wanted.end - wanted.start) as usize);
        for (piece, pair) in self.triangles.windows(2).enumerate() {
            let [start, end] =
                [wanted.start, wanted.end].map(|at| at.clamp(pair[0], pair[1]) - pair[0]);
            if start < end {
                triangles.extend(&self.mesh.triangles(piece)?[start as usize..end as usize]);
            }
        }
        Ok(triangles)
    }

    /// The vertices with the indices `numbers`, which must be in ascending order.
    fn vertices(&self, mut numbers: &[u64]) -> io::Result<Mesh> {
        let infos = self.mesh.attributes();
        let attribute = |info: &crate::particles::AttributeInfo| VertexAttribute {
            values: Vec::with_capacity(numbers.len() * info.components),
            ..VertexAttribute::without_values(info.clone())
        };
        let mut mesh = Mesh {
            positions: Vec::with_capacity(numbers.len()),
            normals: self.mesh.has_normals().then(Vec::new),
            attributes: infos.iter().map(attribute).collect(),
            triangles: Vec::new(),
        };
        while let Some(first) = numbers.first() {
            let piece = self.vertices.partition_point(|start| start <= first) - 1;
            let (start, end) = (self.vertices[piece], self.vertices[piece + 1]);
            let (here, rest) = numbers.split_at(numbers.partition_point(|&number| number < end));
            numbers = rest;
            let vertices = self.mesh.vertices(piece)?;
            for place in here.iter().map(|number| (number - start) as usize) {
                mesh.positions.push(vertices.positions[place]);
                if let Some(normals) = &mut mesh.normals {
                    normals.push(vertices.normals[place]);
                }
                for (all, values) in mesh.attributes.iter_mut().zip(&vertices.attributes) {
                    let components = all.components;
                    all.extend(&values[place * components..][..components]);
                }
            }
        }
        Ok(mesh)
    }
}
