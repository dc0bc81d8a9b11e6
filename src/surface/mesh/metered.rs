//! A mesh whose pieces are counted as they are read, until its caller asks for an early end.

use std::io;

use crate::system::control::{Control, Meter, Stage};

use super::source::{Indexed, MeshSource, Outline, Vertices};

/// A mesh that reports to a caller how many of its pieces have been read.
pub struct Metered<'a> {
    mesh: &'a dyn MeshSource,
    meter: Meter<'a>,
}

impl<'a> Metered<'a> {
    /// Counts the pieces of a mesh whose reader asks for the vertices and for the triangles of each.
    #[must_use]
    pub fn new(mesh: &'a dyn MeshSource, control: &'a Control, stage: Stage) -> Self {
        Self { mesh, meter: control.meter(stage, 2 * mesh.pieces()) }
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

    fn whole_positions(&self) -> Option<&[[f64; 3]]> {
        self.mesh.whole_positions()
    }

    fn at_once(&self) -> io::Result<Option<Indexed>> {
        self.meter.go_on()?;
        self.mesh.at_once()
    }
}
