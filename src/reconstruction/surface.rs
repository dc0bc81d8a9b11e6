//! A reconstructed surface, and how it is written.

use std::fmt;
use std::io;
use std::path::Path;
use std::sync::Arc;

use crate::error::Error;
use crate::grid::units::MemoryBudget;
use crate::io::output::MeshFormat;
use crate::io::whole::Replace;
use crate::io::{UpAxis, WriteError, stl};
use crate::surface::level_set::Volume;
use crate::surface::mesh::source::{MeshSource, MeteredMesh, Outline};
use crate::surface::mesh::{Mesh, VertexAttribute};
#[cfg(feature = "pictures")]
use crate::surface::picture::{Effort, Image, Picture};
use crate::surface::stitch::WholeMeshError;
use crate::system::cancel::Cancel;
use crate::system::control::{Control, Stage};

use super::SinglePrecision;
use super::checked::CheckedRequest;
use super::extract::{ExtractedMesh, ExtractedSurface};
use super::output::{Output, coordinate_width};
use super::report::Report;
use super::threads::Threads;
use super::warning::Warning;
use crate::settings::Settings;

/// Width and height, in pixels, of a preview.
#[cfg(feature = "pictures")]
const PREVIEW: [usize; 2] = [640, 360];

/// A closed, oriented 2-manifold around the fluid.
pub struct Surface {
    extracted: ExtractedSurface,
    /// The threads that make the surface and write it. The threads are stopped in between, because
    /// a caller may keep a surface for a long time.
    threads: Threads,
    settings: Settings,
    /// Progress and cancellation of the request that made the surface.
    control: Control,
    /// The memory limit of the request that made the surface.
    #[cfg_attr(not(feature = "pictures"), expect(dead_code, reason = "only pictures use it"))]
    memory: MemoryBudget,
    particles_up: UpAxis,
}

impl Surface {
    /// Combines a surface with its request, its threads, and the up axis of its particles.
    pub(crate) fn new(
        extracted: ExtractedSurface,
        checked: &CheckedRequest,
        threads: &Arc<rayon::ThreadPool>,
        particles_up: UpAxis,
    ) -> Self {
        let (settings, control) = (checked.settings.clone(), checked.resources.control.clone());
        let memory = checked.resources.budget;
        Self { extracted, threads: threads.into(), settings, control, memory, particles_up }
    }

    /// The mesh, as the pieces in which it is stored.
    #[must_use]
    pub fn mesh(&self) -> &dyn MeshSource {
        self.extracted.mesh.source()
    }

    /// Copies the whole mesh into memory.
    ///
    /// # Errors
    /// [`Error::WholeMesh`] if the mesh is too large or a scratch file cannot be read, and
    /// [`Error::Threads`] if threads cannot be started.
    pub fn to_mesh(&self) -> Result<Mesh, Error> {
        let threads = self.threads.started().map_err(Error::Threads)?;
        let mesh = threads.install(|| match &self.extracted.mesh {
            ExtractedMesh::Empty(empty) => Ok(empty.mesh.clone()),
            ExtractedMesh::Whole(mesh) => mesh.to_mesh(),
            ExtractedMesh::Reduced(mesh) => in_one_piece(mesh),
        });
        Ok(mesh?)
    }

    /// Computes the signed distance from the surface in a band of three voxels on either side, as
    /// in a .vdb file. The voxels are the cells of the grid. Each brick of the volume takes 2 KiB.
    ///
    /// # Errors
    /// [`Error::Request`] for cells so small that coordinates of voxels overflow,
    /// [`Error::WholeMesh`] if a scratch file cannot be read or memory is full,
    /// [`Error::Cancelled`] if the request is cancelled, and [`Error::Threads`] if threads cannot
    /// be started.
    pub fn volume(&self) -> Result<Volume, Error> {
        let threads = self.threads.started().map_err(Error::Threads)?;
        let control = &self.control;
        let readings = 2;
        let metered = MeteredMesh::new(self.mesh(), readings, control, Stage::Writing);
        threads.install(|| Volume::of(&metered)).map_err(|fault| match fault.kind() {
            _ if control.cancel.is_cancelled() => Error::Cancelled,
            io::ErrorKind::InvalidInput => Error::Request(fault.to_string()),
            _ => WholeMeshError::Scratch(fault).into(),
        })
    }

    /// The report on the reconstruction.
    #[must_use]
    pub fn report(&self) -> &Report {
        &self.extracted.report
    }

    /// Draws a picture of the mesh with the up axis of its particles, using as many threads as the
    /// reconstruction. Unless the picture has its own memory limit, it uses at most half of the
    /// frame's memory limit, because the mesh may use the other half.
    ///
    /// # Errors
    /// [`Error::Picture`] if the picture cannot be drawn, and [`Error::Threads`] if threads cannot
    /// be started.
    #[cfg(feature = "pictures")]
    pub fn picture(&self, picture: &Picture) -> Result<Image, Error> {
        let picture = picture.clone().up(self.settings.particles_up.unwrap_or(self.particles_up));
        let picture = picture.memory_unless_set(self.memory.0 / 2);
        let threads = self.threads.started().map_err(Error::Threads)?;
        let drawn = threads.install(|| picture.draw(self.mesh()));
        drawn.map_err(|fault| Error::Picture { path: None, fault })
    }

    /// Draws a small picture of the mesh above a floor, as a first look.
    ///
    /// # Errors
    /// The errors of [`picture`](Self::picture).
    #[cfg(feature = "pictures")]
    pub fn preview(&self) -> Result<Image, Error> {
        let [width, height] = PREVIEW;
        self.picture(&Picture::new().size(width, height).ground(true).effort(Effort::Draft))
    }

    /// Warnings about storing the mesh in `format`.
    ///
    /// # Errors
    /// [`Error::Write`] if the mesh is in a scratch file that cannot be read, and
    /// [`Error::Threads`] if threads cannot be started.
    pub fn warnings_in(&self, format: MeshFormat) -> Result<Vec<Warning>, Error> {
        let threads = self.threads.started().map_err(Error::Threads)?;
        let warnings =
            || format_warnings(self.mesh(), self.extracted.precision, format, Path::new(""));
        Ok(threads.install(warnings)?)
    }

    /// Writes the mesh to a new file, completely or not at all, and returns the file's size in
    /// bytes.
    ///
    /// The extension selects the format. Coordinates are f64 if f32 would move vertices by more
    /// than 1 / 256 of a cell and the format can store f64. Missing folders are created.
    ///
    /// To replace a file, call [`overwrite`](Self::overwrite).
    ///
    /// # Errors
    /// [`Error::Write`] if the file exists or cannot be written, [`Error::SettingConflict`] for
    /// settings that the format cannot store, [`Error::Cancelled`] if the request is cancelled, and
    /// [`Error::Threads`] if threads cannot be started.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<u64, Error> {
        self.write_to(Output::prepare(
            &self.settings,
            path.as_ref(),
            Replace::Refuse,
            &Cancel::new(),
        )?)
    }

    /// Writes the mesh like [`write`](Self::write), and replaces an existing file.
    ///
    /// # Errors
    /// The errors of [`write`](Self::write), except that the file may exist.
    pub fn overwrite(&self, path: impl AsRef<Path>) -> Result<u64, Error> {
        self.write_to(Output::prepare(
            &self.settings,
            path.as_ref(),
            Replace::Allow,
            &Cancel::new(),
        )?)
    }

    /// Writes the mesh to a file that was prepared before the reconstruction, and returns the
    /// file's size in bytes.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written, [`Error::SettingConflict`] if its format
    /// cannot store the attributes that the settings name, [`Error::Cancelled`] if the request that
    /// made the surface or the request that prepared the file is cancelled, and [`Error::Threads`]
    /// if threads cannot be started.
    pub fn write_to(&self, output: Output) -> Result<u64, Error> {
        let format = output.format();
        let attributes = || Ok(self.mesh().attributes());
        self.settings.check_attributes(output.path(), format, attributes)?;
        let orientation = self.settings.orientation(self.particles_up, format);
        let width = coordinate_width(self.extracted.precision, format, output.path())?;
        let output = output.with_layout(self.settings.layout(orientation));
        let turned = orientation.turned(self.mesh());
        let threads = self.threads.started().map_err(Error::Threads)?;
        threads.install(|| output.write(&turned, width, &self.control))
    }
}

impl fmt::Debug for Surface {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Surface").field("report", self.report()).finish_non_exhaustive()
    }
}

/// Warnings about storing a mesh in `format`: coordinates that become inaccurate, attributes that
/// are renamed or left out, and vertices that become equal.
pub(crate) fn format_warnings(
    mesh: &dyn MeshSource,
    precision: SinglePrecision,
    format: MeshFormat,
    path: &Path,
) -> Result<Vec<Warning>, WriteError> {
    let coarse = precision == SinglePrecision::TooCoarse && !format.holds_f64();
    let coarse = coarse.then_some(Warning::Coarse { format });
    let renamed = format.renamed(&mesh.attributes(), mesh.has_normals()).into_iter();
    let renamed = renamed.map(|[attribute, name]| Warning::Renamed { attribute, name, format });
    let mut warnings: Vec<_> = coarse.into_iter().chain(renamed).collect();
    warnings.extend(format.not_stored(&mesh.attributes()).into_iter().map(|info| {
        Warning::NotStored { attribute: info.name, components: info.components, format }
    }));
    if format == MeshFormat::Stl {
        let vertices = stl::merged_vertices(mesh).map_err(|fault| WriteError::new(path, fault))?;
        warnings.extend((vertices > 0).then_some(Warning::Merged { vertices, format }));
    }
    Ok(warnings)
}

/// Copies a mesh of several pieces into memory as a single piece.
fn in_one_piece(mesh: &dyn MeshSource) -> Result<Mesh, WholeMeshError> {
    let Outline { vertices, normals, attributes, pieces, .. } = mesh.outline();
    if u32::try_from(vertices).is_err() {
        return Err(WholeMeshError::TooManyVertices(vertices));
    }
    let attributes = attributes.into_iter().map(VertexAttribute::without_values).collect();
    let mut whole = Mesh { normals: normals.then(Vec::new), attributes, ..Mesh::default() };
    for piece in 0..pieces {
        let vertices = mesh.vertices(piece)?;
        whole.positions.extend_from_slice(&vertices.positions);
        whole.normals.iter_mut().for_each(|normals| normals.extend_from_slice(&vertices.normals));
        let attributes = whole.attributes.iter_mut().zip(&vertices.attributes);
        attributes.for_each(|(attribute, values)| attribute.extend(values));
        whole
            .triangles
            .extend(mesh.triangles(piece)?.into_iter().map(|corners| corners.map(|v| v as u32)));
    }
    Ok(whole)
}
