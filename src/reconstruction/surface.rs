//! A surface that was reconstructed, and what there is to know of it.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use rayon::ThreadPool;

use crate::brick::Census;
use crate::error::Error;
use crate::field::calibration::Calibrated;
use crate::frame::Shortfall;
use crate::grid::Grid;
use crate::io::output::MeshOutput;
use crate::io::whole::Replace;
use crate::io::{CoordinateWidth, WriteError, WriteFault};
use crate::particles::AttributeInfo;
use crate::surface::mesh::source::{MeshSource, Outline};
use crate::surface::mesh::{Mesh, VertexAttribute};
use crate::surface::simplify::{Dropped, Simplified};
use crate::surface::stitch::{Stitched, WholeMeshError};
use crate::system::timings::Timings;

use super::{Cells, SinglePrecision};

/// A closed, oriented 2-manifold around the fluid.
pub struct Surface {
    pub(super) mesh: Drawn,
    /// The threads that it was made by, and is written by.
    pub(super) threads: Arc<ThreadPool>,
    pub(super) precision: SinglePrecision,
    pub(super) report: Report,
}

/// A mesh as it is kept: in memory, or in scratch files as far as it exceeds its share of that.
pub(super) enum Drawn {
    Whole(Stitched),
    Reduced(Simplified),
}

/// A report on a surface: how it was sampled, measured and reduced.
#[derive(Debug)]
#[non_exhaustive]
pub struct Report {
    /// The cells that were chosen, unless the frame was packed.
    pub cells: Option<Cells>,
    /// Whether the grid was moved to suit particles on a lattice.
    pub moved: bool,
    /// The grid of the cells.
    pub grid: Grid,
    /// Counts of particles, by what became of them.
    pub census: Census,
    /// The measurements on the frame, unless the calibration was given or a kernel method needs none.
    pub measured: Option<Calibrated>,
    /// Particles that are in no surface, at the least.
    pub lost: u64,
    /// By how much the surface holds less than its particles, if it does so plainly.
    pub shortfall: Option<Shortfall>,
    /// How many times as many particles there are as their spacing leaves room for, where it is known.
    pub crowding: Option<f64>,
    /// Components that were left out, where any were to be.
    pub dropped: Option<Dropped>,
    /// Failures of the backend that were made good.
    pub made_good: Vec<String>,
    /// How long each stage took.
    pub timings: Timings,
}

impl Surface {
    /// The mesh, piece by piece, as it is kept.
    #[must_use]
    pub fn mesh(&self) -> &dyn MeshSource {
        match &self.mesh {
            Drawn::Whole(mesh) => mesh,
            Drawn::Reduced(mesh) => mesh,
        }
    }

    /// Copies the mesh into memory as a whole.
    ///
    /// # Errors
    /// [`WholeMeshError`] where it is too large, or cannot be read from a scratch file.
    pub fn to_mesh(&self) -> Result<Mesh, WholeMeshError> {
        self.threads.install(|| match &self.mesh {
            Drawn::Whole(mesh) => mesh.to_mesh(),
            Drawn::Reduced(mesh) => in_one_piece(mesh),
        })
    }

    /// The report on how it was made.
    #[must_use]
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// Writes the mesh to a file that is not there yet, whose extension says the format: whole or not at all. Coordinates are f64 where f32
    /// would move vertices by more than 1 / 256 of a cell and the format can hold them.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, path: impl AsRef<Path>) -> Result<u64, Error> {
        self.put(path.as_ref(), Replace::Refuse)
    }

    /// Writes the mesh in place of a file that may be there.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn overwrite(&self, path: impl AsRef<Path>) -> Result<u64, Error> {
        self.put(path.as_ref(), Replace::Allow)
    }

    fn put(&self, path: &Path, replace: Replace) -> Result<u64, Error> {
        let output = MeshOutput::prepare(path, replace)?;
        let format = output.format();
        let width = match self.precision {
            SinglePrecision::Enough => CoordinateWidth::F32,
            SinglePrecision::TooCoarse | SinglePrecision::Exceeded if format.holds_f64() => {
                CoordinateWidth::F64
            }
            SinglePrecision::TooCoarse => CoordinateWidth::F32,
            SinglePrecision::Exceeded => {
                let what = format!("{format} holds coordinates as f32, which these exceed; .ply holds f64");
                return Err(WriteError::new(path, WriteFault::Unsupported(what)).into());
            }
        };
        Ok(self.threads.install(|| output.write(self.mesh(), width))?)
    }
}

impl fmt::Debug for Surface {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Surface").field("report", &self.report).finish_non_exhaustive()
    }
}

/// Brings a mesh of several pieces into memory.
fn in_one_piece(mesh: &dyn MeshSource) -> Result<Mesh, WholeMeshError> {
    let Outline { vertices, normals, attributes, pieces, .. } = mesh.outline();
    if u32::try_from(vertices).is_err() {
        return Err(WholeMeshError::TooManyVertices(vertices));
    }
    let of_none =
        |AttributeInfo { name, components }| VertexAttribute { name, components, values: Vec::new() };
    let attributes = attributes.into_iter().map(of_none).collect();
    let mut whole = Mesh { normals: normals.then(Vec::new), attributes, ..Mesh::default() };
    for piece in 0..pieces {
        let vertices = mesh.vertices(piece)?;
        whole.positions.extend_from_slice(&vertices.positions);
        whole.normals.iter_mut().for_each(|normals| normals.extend_from_slice(&vertices.normals));
        let attributes = whole.attributes.iter_mut().zip(&vertices.attributes);
        attributes.for_each(|(attribute, values)| attribute.values.extend_from_slice(values));
        whole.triangles.extend(mesh.triangles(piece)?.into_iter().map(|corners| corners.map(|v| v as u32)));
    }
    Ok(whole)
}
