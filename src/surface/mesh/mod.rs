//! Triangle meshes, their checks and measures.

mod block;
mod box_tree;
pub mod check;
pub mod clustered;
pub mod compare;
pub mod measure;
pub mod ordered;
pub mod source;
pub mod spool;
pub mod tree;
pub mod up;

pub use block::{BlockMesh, Tile, TileLevels, TileMask, bits, cell_of_bit};

use std::borrow::Cow;
use std::ops::Range;

use crate::particles::{AttributeInfo, AttributeKind};

/// An attribute with values for every vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct VertexAttribute {
    /// The name in the particles' file; the velocity is always called `velocity`.
    pub name: String,
    /// Number of components per vertex.
    pub components: usize,
    /// The values of all vertices, with the components of each vertex contiguous.
    pub values: Vec<f32>,
    /// The meaning of the numbers.
    pub kind: AttributeKind,
    /// The exact values of an integer attribute, because f32 cannot represent all integers; empty
    /// for other kinds of attributes.
    pub whole: Vec<i64>,
}

impl VertexAttribute {
    /// A floating-point attribute: a colour if `name` is the name of a colour, otherwise plain
    /// numbers.
    #[must_use]
    pub fn new(name: impl Into<String>, components: usize, values: Vec<f32>) -> Self {
        let without = Self::without_values(AttributeInfo::new(name, components));
        Self { values, ..without }
    }

    /// An attribute that has no values yet.
    #[must_use]
    pub fn without_values(info: AttributeInfo) -> Self {
        let AttributeInfo { name, components, kind } = info;
        Self { name, components, values: Vec::new(), kind, whole: Vec::new() }
    }

    /// Adds values from a piece of a mesh.
    pub(crate) fn extend(&mut self, words: &[f32]) {
        if self.kind.is_whole() {
            self.whole.extend(words.iter().map(|&word| self.kind.whole(word)));
            self.values.extend(words.iter().map(|&word| self.kind.number(word)));
        } else {
            self.values.extend_from_slice(words);
        }
    }

    /// The values in `range`, as a piece of a mesh stores them: integers as their 32 bits.
    pub(crate) fn words(&self, range: Range<usize>) -> Cow<'_, [f32]> {
        if self.kind.is_whole() {
            self.whole[range].iter().map(|&whole| AttributeKind::word(whole)).collect()
        } else {
            Cow::Borrowed(&self.values[range])
        }
    }

    /// The attribute without its values.
    #[must_use]
    pub fn info(&self) -> AttributeInfo {
        AttributeInfo { name: self.name.clone(), components: self.components, kind: self.kind }
    }
}

/// An indexed triangle mesh. Triangles are counter-clockwise as seen from outside the fluid.
///
/// Positions are f64, so a surface far from the origin keeps its shape; the writer of each file
/// format chooses f32 or f64.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// The vertices' positions, in the particles' unit of length.
    pub positions: Vec<[f64; 3]>,
    /// Indices into `positions`.
    pub triangles: Vec<[u32; 3]>,
    /// Outward unit normals of all vertices, if requested.
    pub normals: Option<Vec<[f32; 3]>>,
    /// Attributes of the vertices.
    pub attributes: Vec<VertexAttribute>,
}

impl Mesh {
    /// Memory, in bytes, of the vertices and triangles.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let of_attribute = |VertexAttribute { values, whole, .. }: &VertexAttribute| {
            size_of_val(&values[..]) + size_of_val(&whole[..])
        };
        let values: usize = self.attributes.iter().map(of_attribute).sum();
        let normals = self.normals.as_ref().map_or(0, |normals| size_of_val(&normals[..]));
        (size_of_val(&self.positions[..]) + size_of_val(&self.triangles[..]) + normals + values)
            as u64
    }
}
