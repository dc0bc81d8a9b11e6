//! A mesh in pieces, so that writing it needs memory for only a few pieces.

use std::borrow::Cow;
use std::io;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use crate::grid::Grid;
use crate::particles::AttributeInfo;
use crate::system::control::{Control, Meter, Stage};

use super::up::UpAxis;
use super::{Mesh, VertexAttribute};

/// Number of vertices, or of triangles, in one piece of a mesh that is in memory.
const PIECE: usize = 1 << 14;

/// The vertices of a piece.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Vertices<'a> {
    /// The vertices' positions, in the particles' unit of length.
    pub positions: Cow<'a, [[f64; 3]]>,
    /// One normal per vertex, or empty.
    pub normals: Cow<'a, [[f32; 3]]>,
    /// The values of each attribute, with the components of each vertex contiguous. Integers are
    /// stored as their 32 bits.
    pub attributes: Vec<Cow<'a, [f32]>>,
}

/// A summary of a mesh, known before any piece is read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Outline {
    /// Total number of vertices.
    pub vertices: u64,
    /// Total number of triangles.
    pub triangles: u64,
    /// Whether vertices have normals.
    pub normals: bool,
    /// Attributes of the vertices.
    pub attributes: Vec<AttributeInfo>,
    /// Number of pieces.
    pub pieces: usize,
    /// The lattice of the samples from which the mesh was made, if it is known.
    pub lattice: Option<Lattice>,
}

/// A lattice of points: `origin` plus `step` times integer coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    /// The position of the coordinates (0, 0, 0), in the mesh's unit of length.
    pub origin: [f64; 3],
    /// The distance between neighbouring points, in the mesh's unit of length.
    pub step: f64,
}

impl Lattice {
    /// The centres of the cells of `grid`.
    #[must_use]
    pub fn of(grid: Grid) -> Self {
        let (origin, step) = (grid.origin(), grid.cell_size());
        Self { origin: (origin + step / 2.0).to_array(), step }
    }
}

/// A mesh without vertices, made on a known lattice.
#[derive(Debug, Clone)]
pub struct EmptyMesh {
    /// The mesh, which has names of attributes, but no values.
    pub mesh: Mesh,
    /// The lattice of the samples.
    pub lattice: Lattice,
}

/// The positions of all vertices, and all triangles as indices into them.
pub type Indexed = (Vec<[f64; 3]>, Vec<[u32; 3]>);

/// The bounding box and the counts of a piece, known before the piece is read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PieceOutline {
    /// A box that contains the piece's triangles. It may be larger than necessary.
    pub bounds: Corners,
    /// Number of vertices in the piece.
    pub vertices: u64,
    /// Number of triangles in the piece.
    pub triangles: u64,
}

/// A mesh in pieces. The mesh has the vertices of all pieces, in order, and the triangles of all
/// pieces, in order. Pieces can be read repeatedly, by several threads.
pub trait MeshSource: Sync {
    /// A summary of the mesh.
    fn outline(&self) -> Outline;

    /// The vertices of piece number `piece`, which may be empty.
    ///
    /// # Errors
    /// If the pieces are in a file that cannot be read.
    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>>;

    /// The triangles of piece number `piece`, which may be empty, as indices into all vertices of
    /// the mesh.
    ///
    /// # Errors
    /// If the pieces are in a file that cannot be read.
    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>>;

    /// Fails if the work on the mesh was cancelled. A long operation that no longer reads the mesh
    /// must call this repeatedly.
    ///
    /// # Errors
    /// If the work was cancelled.
    fn go_on(&self) -> io::Result<()> {
        Ok(())
    }

    /// The axis that points up: y, unless it is known to be z.
    fn up(&self) -> UpAxis {
        UpAxis::Y
    }

    /// The positions of all vertices, if they are contiguous in memory.
    fn whole_positions(&self) -> Option<&[[f64; 3]]> {
        None
    }

    /// All positions and triangles, if the source can read them faster together than piece by
    /// piece.
    ///
    /// # Errors
    /// If the pieces are in a file that cannot be read.
    fn at_once(&self) -> io::Result<Option<Indexed>> {
        Ok(None)
    }

    /// The outline of piece number `piece`, if it is known before the piece is read.
    fn piece_outline(&self, _piece: usize) -> Option<PieceOutline> {
        None
    }

    /// The folder for scratch files, if the mesh is in files.
    fn scratch_folder(&self) -> Option<&Path> {
        None
    }

    /// A mesh that looks the same from a distance, but has only about a quarter of the triangles;
    /// `None` if the source cannot make such a mesh cheaply. The mesh may have fewer triangles than
    /// its outline says.
    ///
    /// # Errors
    /// If the pieces are in a file that cannot be read.
    fn coarser(&self) -> io::Result<Option<Box<dyn MeshSource + '_>>> {
        Ok(None)
    }

    /// Total number of vertices.
    fn vertex_count(&self) -> u64 {
        self.outline().vertices
    }

    /// Total number of triangles.
    fn triangle_count(&self) -> u64 {
        self.outline().triangles
    }

    /// Whether vertices have normals.
    fn has_normals(&self) -> bool {
        self.outline().normals
    }

    /// Attributes of the vertices.
    fn attributes(&self) -> Vec<AttributeInfo> {
        self.outline().attributes
    }

    /// Number of pieces.
    fn pieces(&self) -> usize {
        self.outline().pieces
    }
}

impl MeshSource for EmptyMesh {
    fn outline(&self) -> Outline {
        Outline { lattice: Some(self.lattice), ..self.mesh.outline() }
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        self.mesh.vertices(piece)
    }

    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        self.mesh.triangles(piece)
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
            lattice: None,
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

/// Panics if arrays differ in length, which is a bug in this library.
fn assert_complete(mesh: &Mesh) {
    let vertices = mesh.positions.len();
    let normals = mesh.normals.as_ref().map_or(vertices, Vec::len);
    assert_eq!(normals, vertices, "one normal per vertex");
    for VertexAttribute { name, components, values, kind, whole } in &mesh.attributes {
        assert_eq!(
            Some(values.len()),
            vertices.checked_mul(*components),
            "{components} components of {name} per vertex"
        );
        let whole_count = if kind.is_whole() { values.len() } else { 0 };
        assert_eq!(whole.len(), whole_count, "whole numbers of {name}");
    }
}

/// A mesh that reports how many of its pieces have been read.
pub struct MeteredMesh<'a> {
    mesh: &'a dyn MeshSource,
    meter: Meter<'a>,
}

impl<'a> MeteredMesh<'a> {
    /// Prepares the progress reports of a mesh. `readings` is the number of passes over all pieces;
    /// each pass reads either the vertices or the triangles.
    pub fn new(
        mesh: &'a dyn MeshSource,
        readings: usize,
        control: &'a Control,
        stage: Stage,
    ) -> Self {
        Self { mesh, meter: control.meter(stage, readings * mesh.pieces()) }
    }
}

impl MeshSource for MeteredMesh<'_> {
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

    fn go_on(&self) -> io::Result<()> {
        Ok(self.meter.go_on()?)
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

    fn piece_outline(&self, piece: usize) -> Option<PieceOutline> {
        self.mesh.piece_outline(piece)
    }

    fn scratch_folder(&self) -> Option<&Path> {
        self.mesh.scratch_folder()
    }
}

/// The minimum and the maximum corner of a box.
pub type Corners = [[f64; 3]; 2];

/// The bounding box of positions; `None` if `positions` is empty.
pub fn bounds_of(positions: &[[f64; 3]]) -> Option<Corners> {
    positions.iter().map(|&p| [p, p]).reduce(joined)
}

/// The bounding box of two boxes.
pub fn joined([lo, hi]: Corners, [p, q]: Corners) -> Corners {
    [
        std::array::from_fn(|axis| lo[axis].min(p[axis])),
        std::array::from_fn(|axis| hi[axis].max(q[axis])),
    ]
}

/// A mesh that records the bounding box of the vertices that have been read.
pub struct BoundedMesh<'a> {
    mesh: &'a dyn MeshSource,
    bounds: Mutex<Option<Corners>>,
}

impl<'a> BoundedMesh<'a> {
    /// Wraps a mesh whose vertices have not been read yet.
    pub fn new(mesh: &'a dyn MeshSource) -> Self {
        Self { mesh, bounds: Mutex::new(None) }
    }

    /// The bounding box of the vertices that have been read. Once the mesh has been written, this
    /// is the bounding box of the whole mesh.
    pub fn bounds(&self) -> Option<Corners> {
        *self.bounds.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl MeshSource for BoundedMesh<'_> {
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

    fn piece_outline(&self, piece: usize) -> Option<PieceOutline> {
        self.mesh.piece_outline(piece)
    }

    fn scratch_folder(&self) -> Option<&Path> {
        self.mesh.scratch_folder()
    }
}
