//! The axis that points up. Programs disagree on whether y or z points up, and few file formats
//! record the axis.

use std::borrow::Cow;
use std::fmt;
use std::io;
use std::ops::Sub;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::source::{Lattice, MeshSource, Outline, PieceOutline, Vertices, joined};
use crate::particles::AttributeInfo;

/// The axis that points up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[allow(missing_docs)]
pub enum UpAxis {
    Y,
    Z,
}

impl fmt::Display for UpAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Y => "Y",
            Self::Z => "Z",
        })
    }
}

impl UpAxis {
    /// Rotates a place or a direction by a quarter turn about x, so that the axis `self` becomes
    /// `to`.
    #[must_use]
    pub fn turned<T: Copy + Default + Sub<Output = T>>(
        self,
        to: Self,
        [x, y, z]: [T; 3],
    ) -> [T; 3] {
        // Subtraction from zero never gives a negative zero.
        let negative = |value: T| T::default() - value;
        match (self, to) {
            (Self::Y, Self::Z) => [x, negative(z), y],
            (Self::Z, Self::Y) => [x, z, negative(y)],
            _ => [x, y, z],
        }
    }
}

/// A mesh that is rotated, if necessary, so that another axis points up. The rotation changes
/// positions, normals, and attributes with three components, except colours and integers. Other
/// attributes, including tensors, stay unchanged.
pub struct TurnedMesh<'a> {
    mesh: &'a dyn MeshSource,
    from: UpAxis,
    to: UpAxis,
    /// For each attribute, whether it is a direction.
    directions: Vec<bool>,
}

impl<'a> TurnedMesh<'a> {
    /// Rotates `mesh` from up axis `from` to up axis `to`.
    pub fn new(mesh: &'a dyn MeshSource, from: UpAxis, to: UpAxis) -> Self {
        let directions = mesh.attributes().iter().map(AttributeInfo::is_direction).collect();
        Self { mesh, from, to, directions }
    }

    fn turn<T: Copy + Default + Sub<Output = T>>(&self, values: &mut [[T; 3]]) {
        values.iter_mut().for_each(|value| *value = self.from.turned(self.to, *value));
    }
}

impl MeshSource for TurnedMesh<'_> {
    fn outline(&self) -> Outline {
        let outline = self.mesh.outline();
        let turned = |lattice: Lattice| Lattice {
            origin: self.from.turned(self.to, lattice.origin),
            ..lattice
        };
        Outline { lattice: outline.lattice.map(turned), ..outline }
    }

    fn go_on(&self) -> io::Result<()> {
        self.mesh.go_on()
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        let mut vertices = self.mesh.vertices(piece)?;
        if self.from == self.to {
            return Ok(vertices);
        }
        self.turn(vertices.positions.to_mut());
        self.turn(vertices.normals.to_mut());
        for (values, _) in
            vertices.attributes.iter_mut().zip(&self.directions).filter(|(_, turns)| **turns)
        {
            self.turn(Cow::to_mut(values).as_chunks_mut().0);
        }
        Ok(vertices)
    }

    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        self.mesh.triangles(piece)
    }

    fn up(&self) -> UpAxis {
        self.to
    }

    fn whole_positions(&self) -> Option<&[[f64; 3]]> {
        self.mesh.whole_positions().filter(|_| self.from == self.to)
    }

    fn piece_outline(&self, piece: usize) -> Option<PieceOutline> {
        let outline = self.mesh.piece_outline(piece)?;
        let [a, b] = outline.bounds.map(|corner| self.from.turned(self.to, corner));
        Some(PieceOutline { bounds: joined([a, a], [b, b]), ..outline })
    }

    fn scratch_folder(&self) -> Option<&Path> {
        self.mesh.scratch_folder()
    }
}
