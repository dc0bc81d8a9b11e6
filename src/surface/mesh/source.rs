//! A mesh handed out piece by piece, so that writing it needs no more memory than a few pieces.

use std::borrow::Cow;
use std::io;
use std::sync::{Mutex, PoisonError};

use crate::particles::AttributeInfo;
use crate::system::control::{Control, Meter, Stage};

use super::up::UpAxis;
use super::{Mesh, VertexAttribute};

/// Vertices or triangles of a piece of a mesh in memory.
const PIECE: usize = 1 << 14;

/// The vertices of a piece.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Vertices<'a> {
    /// The vertices' positions, in the particles' unit of length.
    pub positions: Cow<'a, [[f64; 3]]>,
    /// One a vertex, or none at all.
    pub normals: Cow<'a, [[f32; 3]]>,
    /// For each attribute its values, all components of one vertex after the other; whole numbers as
    /// their 32 bits.
    pub attributes: Vec<Cow<'a, [f32]>>,
}

/// A summary of a mesh, known before any of its pieces is asked for.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Outline {
    /// Vertices of all pieces.
    pub vertices: u64,
    /// Triangles of all pieces.
    pub triangles: u64,
    /// Whether vertices have normals.
    pub normals: bool,
    /// Further values on the vertices.
    pub attributes: Vec<AttributeInfo>,
    /// How many pieces there are.
    pub pieces: usize,
}

/// The positions of all vertices, and all triangles as indices into them.
pub type Indexed = (Vec<[f64; 3]>, Vec<[u32; 3]>);

/// A mesh in pieces. The vertices of all pieces in order are the mesh's vertices, and likewise the
/// triangles; a piece can be asked for as often as one likes, by several threads.
pub trait MeshSource: Sync {
    /// Returns a summary of the mesh.
    fn outline(&self) -> Outline;

    /// The vertices of piece number `piece`, perhaps none.
    ///
    /// # Errors
    /// Where pieces are kept in a file that cannot be read.
    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>>;

    /// The triangles of piece number `piece`, perhaps none, as indices into all vertices of the
    /// mesh.
    ///
    /// # Errors
    /// Where pieces are kept in a file that cannot be read.
    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>>;

    /// The axis that points up: y, unless it is known to be z.
    fn up(&self) -> UpAxis {
        UpAxis::Y
    }

    /// The positions of all vertices, where they are in memory side by side.
    fn whole_positions(&self) -> Option<&[[f64; 3]]> {
        None
    }

    /// Makes the positions of all vertices, and all triangles, where that is less work at once than
    /// piece by piece.
    ///
    /// # Errors
    /// Where pieces are kept in a file that cannot be read.
    fn at_once(&self) -> io::Result<Option<Indexed>> {
        Ok(None)
    }

    /// A mesh that looks like it from afar, of about a quarter of its triangles, where that costs
    /// little. It may have fewer triangles than its outline says.
    ///
    /// # Errors
    /// Where pieces are kept in a file that cannot be read.
    fn coarser(&self) -> io::Result<Option<Box<dyn MeshSource + '_>>> {
        Ok(None)
    }

    /// Vertices of all pieces.
    fn vertex_count(&self) -> u64 {
        self.outline().vertices
    }

    /// Triangles of all pieces.
    fn triangle_count(&self) -> u64 {
        self.outline().triangles
    }

    /// Whether vertices have normals.
    fn has_normals(&self) -> bool {
        self.outline().normals
    }

    /// Further values on the vertices.
    fn attributes(&self) -> Vec<AttributeInfo> {
        self.outline().attributes
    }

    /// How many pieces there are.
    fn pieces(&self) -> usize {
        self.outline().pieces
    }
}

impl MeshSource for Mesh {
    fn outline(&self) -> Outline {
        Outline {
            vertices: self.positions.len() as u64,
            triangles: self.triangles.len() as u64,
            normals: self.normals.is_some(),
            attributes: self.attributes.iter().map(VertexAttribute::info).collect(),
            pieces: self.positions.len().max(self.triangles.len()).div_ceil(PIECE),
        }
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        assert_complete(self);
        let range = range(piece, self.positions.len());
        let attribute = |a: &VertexAttribute| range.start * a.components..range.end * a.components;
        Ok(Vertices {
            positions: Cow::Borrowed(&self.positions[range.clone()]),
            normals: self
                .normals
                .as_ref()
                .map_or(Cow::default(), |n| Cow::Borrowed(&n[range.clone()])),
            attributes: self.attributes.iter().map(|a| a.words(attribute(a))).collect(),
        })
    }

    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        let triangles = &self.triangles[range(piece, self.triangles.len())];
        Ok(triangles.iter().map(|t| t.map(u64::from)).collect())
    }

    fn whole_positions(&self) -> Option<&[[f64; 3]]> {
        Some(&self.positions)
    }
}

fn range(piece: usize, len: usize) -> std::ops::Range<usize> {
    (piece * PIECE).min(len)..((piece + 1) * PIECE).min(len)
}

/// A mesh whose arrays differ in length is our bug.
fn assert_complete(mesh: &Mesh) {
    let vertices = mesh.positions.len();
    let normals = mesh.normals.as_ref().map_or(vertices, Vec::len);
    assert_eq!(normals, vertices, "one normal a vertex");
    for VertexAttribute { name, components, values, kind, whole } in &mesh.attributes {
        assert_eq!(
            Some(values.len()),
            vertices.checked_mul(*components),
            "{components} of {name} a vertex"
        );
        let whole_count = if kind.is_whole() { values.len() } else { 0 };
        assert_eq!(whole.len(), whole_count, "whole numbers of {name}");
    }
}

/// A mesh that reports to a caller how many of its pieces have been read.
pub struct Metered<'a> {
    mesh: &'a dyn MeshSource,
    meter: Meter<'a>,
}

impl<'a> Metered<'a> {
    /// Counts the pieces of a mesh whose reader reads the vertices or triangles of each several
    /// times.
    pub fn new(
        mesh: &'a dyn MeshSource,
        readings: usize,
        control: &'a Control,
        stage: Stage,
    ) -> Self {
        Self { mesh, meter: control.meter(stage, readings * mesh.pieces()) }
    }
}

impl MeshSource for Metered<'_> {
    fn outline(&self) -> Outline {
        self.mesh.outline()
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        self.meter.go_on()?;
        self.meter.add(1);
        self.mesh.vertices(piece)
    }

    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        self.meter.go_on()?;
        self.meter.add(1);
        self.mesh.triangles(piece)
    }

    fn up(&self) -> UpAxis {
        self.mesh.up()
    }

    fn whole_positions(&self) -> Option<&[[f64; 3]]> {
        self.mesh.whole_positions()
    }

    fn at_once(&self) -> io::Result<Option<Indexed>> {
        self.meter.go_on()?;
        self.mesh.at_once()
    }
}

/// Least and greatest corner.
pub type Bounds = [[f64; 3]; 2];

/// The box around some positions; `None` around nothing.
pub fn bounds_of(positions: &[[f64; 3]]) -> Option<Bounds> {
    positions.iter().map(|&p| [p, p]).reduce(joined)
}

/// The box around two boxes.
pub fn joined([lo, hi]: Bounds, [p, q]: Bounds) -> Bounds {
    [
        std::array::from_fn(|axis| lo[axis].min(p[axis])),
        std::array::from_fn(|axis| hi[axis].max(q[axis])),
    ]
}

/// Hands a mesh on, and keeps the box of the vertices that were asked for.
pub struct Bounded<'a> {
    mesh: &'a dyn MeshSource,
    bounds: Mutex<Option<Bounds>>,
}

impl<'a> Bounded<'a> {
    /// Nothing is handed on yet.
    pub fn new(mesh: &'a dyn MeshSource) -> Self {
        Self { mesh, bounds: Mutex::new(None) }
    }

    /// The box: that of the whole mesh, once it is written.
    pub fn bounds(&self) -> Option<Bounds> {
        *self.bounds.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl MeshSource for Bounded<'_> {
    fn outline(&self) -> Outline {
        self.mesh.outline()
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        let vertices = self.mesh.vertices(piece)?;
        let own = bounds_of(&vertices.positions);
        let mut all = self.bounds.lock().unwrap_or_else(PoisonError::into_inner);
        *all = [*all, own].into_iter().flatten().reduce(joined);
        drop(all);
        Ok(vertices)
    }

    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        self.mesh.triangles(piece)
    }

    fn up(&self) -> UpAxis {
        self.mesh.up()
    }
}
