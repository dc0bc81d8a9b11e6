//! The box of a mesh, found while it is written.

use std::io;
use std::sync::{Mutex, PoisonError};

use super::source::{MeshSource, Outline, Vertices};

/// Least and greatest corner.
pub type Bounds = [[f64; 3]; 2];

/// The box around some positions; `None` around nothing.
#[must_use]
pub fn bounds_of(positions: &[[f64; 3]]) -> Option<Bounds> {
    positions.iter().map(|&p| [p, p]).reduce(joined)
}

/// The box around two boxes.
#[must_use]
pub fn joined([lo, hi]: Bounds, [p, q]: Bounds) -> Bounds {
    [std::array::from_fn(|axis| lo[axis].min(p[axis])), std::array::from_fn(|axis| hi[axis].max(q[axis]))]
}

/// Hands a mesh on, and keeps the box of the vertices that were asked for.
pub struct Bounded<'a> {
    mesh: &'a dyn MeshSource,
    bounds: Mutex<Option<Bounds>>,
}

impl<'a> Bounded<'a> {
    /// Nothing is handed on yet.
    #[must_use]
    pub fn new(mesh: &'a dyn MeshSource) -> Self {
        Self { mesh, bounds: Mutex::new(None) }
    }

    /// The box: that of the whole mesh, once it is written.
    #[must_use]
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
}
