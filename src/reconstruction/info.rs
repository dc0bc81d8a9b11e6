//! Contents of a particle file, a packed frame, a mesh, a volume or a Houdini geometry.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use glam::IVec3;
use serde::Serialize;

use crate::brick::{DifField, InvalidParticles};
use crate::error::Error;
use crate::frame::{CountedFrame, Resources};
use crate::grid::units::{MeanCount, MemoryBudget};
use crate::io::bytes::{Unpacking, open_bytes, open_bytes_within};
use crate::io::collection::{frame_of, is_list};
use crate::io::houdini::{Primitives, read_points};
use crate::io::input::{InputFormat, KNOWN, file_and_step, holds_mesh, open_wanted};
use crate::io::mnf::{is_packed, open_frame};
use crate::io::output::{MeshFormat, mesh_format, read_mesh};
use crate::io::vdb::{GridInfo, read_grids};
use crate::io::wanted::{WantedAttributes, WantedParticles};
use crate::io::{ReadError, ReadFault};
use crate::particles::occurring::{ValueCounts, occurring};
use crate::particles::sizes::SizeChoice;
use crate::particles::{AttributeInfo, Particles, bounds};
use crate::surface::mesh::VertexAttribute;
use crate::surface::mesh::measure::measure;
use crate::system::memory::default_memory;

use crate::settings::Settings;

use super::{Cells, FoundWalls, SamplingRequest, Slab, SpacingHints, SpacingSource, WallSearch};

/// Contents of a file.
#[derive(Debug, Clone, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
#[non_exhaustive]
pub enum Info {
    /// A file of particles.
    Particles(ParticlesInfo),
    /// A packed frame.
    Frame(FrameInfo),
    /// A mesh.
    Mesh(MeshInfo),
    /// Grids of voxels.
    Volume(VolumeInfo),
    /// A Houdini geometry without particles, such as a mesh of polygons.
    Geometry(GeometryInfo),
}

/// Contents of a particle file.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct ParticlesInfo {
    /// The file.
    pub file: PathBuf,
    /// Name of the file format.
    pub format: &'static str,
    /// The number of particles.
    pub particles: usize,
    /// The number of particles with coordinates that are not finite.
    pub not_finite: usize,
    /// The lowest and highest corner of the bounding box of the finite particles.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// The attributes besides positions.
    pub attributes: Vec<AttributeInfo>,
    /// Attributes with few distinct values, and how often each value occurs.
    pub values: Vec<ValueCounts>,
    /// The number of particles that do not satisfy the conditions in the settings.
    pub unselected: usize,
    /// The number of ghost particles, which are copies from other pieces and are left out.
    pub ghosts: usize,
    /// Descriptions of the parts of the input that were not read.
    pub left_out: Vec<String>,
    /// Edge lengths of the simulation's box, if the file states them. The box need not be periodic.
    pub box_size: Option<[f64; 3]>,
    /// The file's unit of length in metres.
    pub unit_metres: Option<f64>,
    /// Types of particles in the file; the first type is the one that was read. Empty if the only
    /// type has no name.
    pub particle_types: Vec<String>,
    /// Distance between neighbouring particles.
    pub spacing: Option<f64>,
    /// Source of the spacing.
    pub spacing_source: Option<String>,
    /// Reasons why the spacing may be wrong.
    pub spacing_warnings: Vec<String>,
    /// Reason why the spacing is unknown.
    pub spacing_unknown: Option<String>,
    /// The spacing that nearest neighbours suggest, if the spacing is unknown.
    pub nearest_neighbours: Option<f64>,
    /// The slab that is meshed if all particles lie in a plane.
    pub slab: Option<Slab>,
    /// Walls that the scene file and the particles indicate.
    pub walls: Option<Box<FoundWalls>>,
    /// Estimated peak memory, in bytes, of a reconstruction with default settings.
    pub memory_bytes: Option<u64>,
}

/// Contents of a packed frame.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct FrameInfo {
    /// The file.
    pub file: PathBuf,
    /// The number of particles in the frame.
    pub particles: usize,
    /// The number of cells that are full because of particles in their own bin.
    pub cells: u64,
    /// The number of stored bricks.
    pub bricks: u64,
    /// The lowest and highest corner of the bounding box of the full cells.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// Edge of a cell.
    pub cell_size: f64,
    /// The grid's origin, which is a corner of a cell.
    pub origin: [f64; 3],
    /// The walls of the tank, if there is one.
    pub domain: Option<[[f64; 3]; 2]>,
    /// The faces of the periodic box, if there is one; `None` along an open axis.
    pub periodic: Option<[Option<[f64; 2]>; 3]>,
    /// The indicator's name.
    pub indicator: &'static str,
    /// Mean number of particles in a full cell, for the indicator counting.
    pub mu0: Option<f64>,
    /// Distance between neighbouring particles, if it is known. If the particles have several
    /// sizes, this is the smallest size.
    pub spacing: Option<f64>,
    /// The largest size of the particles, if they have several sizes.
    pub largest_size: Option<f64>,
}

/// Contents of a mesh file.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct MeshInfo {
    /// The file.
    pub file: PathBuf,
    /// The number of vertices.
    pub vertices: usize,
    /// The number of triangles.
    pub triangles: usize,
    /// The lowest and highest corner of the bounding box of the vertices.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// The number of connected components.
    pub components: usize,
    /// Whether vertices have normals.
    pub normals: bool,
    /// The attributes of the vertices besides normals.
    pub attributes: Vec<AttributeInfo>,
}

/// Contents of a `.vdb`.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct VolumeInfo {
    /// The file.
    pub file: PathBuf,
    /// The grids, in the file's order.
    pub grids: Vec<GridInfo>,
}

/// Contents of a Houdini geometry without particles.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct GeometryInfo {
    /// The file.
    pub file: PathBuf,
    /// Name of the file format.
    pub format: &'static str,
    /// The primitives, such as polygons. They use all points of the file.
    pub primitives: Primitives,
    /// The lowest and highest corner of the bounding box of the finite points.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// The numeric attributes of the points besides positions.
    pub attributes: Vec<AttributeInfo>,
}

/// The extensions of all supported files, for an error message.
static ALL_KNOWN: LazyLock<String> = LazyLock::new(|| {
    format!(
        "particles: {KNOWN}; packed frames: .mnf; volumes: .vdb; meshes: .ply, .obj, .vtk, .vtp and .stl"
    )
});

/// Summarizes the contents of a particle file, a packed frame, a mesh, a volume or a Houdini
/// geometry.
///
/// # Errors
/// [`Error::Read`] if the file cannot be read, or has an unknown format.
pub fn info(path: impl AsRef<Path>) -> Result<Info, Error> {
    info_with(path, &Settings::default())
}

/// Like [`info`], with the format and the conditions of `settings`.
///
/// # Errors
/// [`Error::Read`] if the file cannot be read, or lacks the requested type of particles.
pub fn info_with(path: impl AsRef<Path>, settings: &Settings) -> Result<Info, Error> {
    let path = path.as_ref();
    let (file, step) = file_and_step(path);
    if is_list(file) {
        return match &frame_of(path, file, step)?.blocks[..] {
            [only] => info_with(&only.file, settings),
            _ => particles(path, settings),
        };
    }
    if is_packed(path) {
        frame(path).map(Info::Frame)
    } else if matches!(MeshFormat::of(path), Some(MeshFormat::Vdb { .. })) {
        volume(path).map(Info::Volume)
    } else if settings.format.is_some() {
        particles(path, settings)
    } else if mesh_format(path).is_some() && holds_mesh(path)? {
        // The reader of particles refuses meshes in other formats, such as .vtu.
        mesh(path).map(Info::Mesh)
    } else if InputFormat::of(file).is_some() {
        particles(path, settings)
    } else {
        Err(ReadError::new(path, ReadFault::UnknownExtension { known: &ALL_KNOWN }).into())
    }
}

fn frame(path: &Path) -> Result<FrameInfo, Error> {
    let packed = open_frame(path, 0, None)?;
    let samples = packed.samples();
    let (facts, indicator, fields) = (samples.facts(), samples.indicator(), samples.volumes());
    let full = |&(octave, field): &(u32, &DifField)| {
        let boxes = field.infos().iter().map(|info| info.full).reduce(|a, b| a.union(&b));
        boxes.map(|full| full.in_narrower_cells(octave))
    };
    let full = fields.iter().filter_map(full).reduce(|a, b| a.union(&b));
    let world = |cells: IVec3| facts.grid.world_from_cells(cells.as_dvec3()).to_array();
    Ok(FrameInfo {
        file: path.to_owned(),
        particles: facts.census.binned,
        cells: fields.iter().map(|(_, field)| field.full_cells()).sum(),
        bricks: samples.fields().iter().map(|(_, field)| field.bricks()).sum(),
        bounds: full.map(|full| [world(full.lo), world(full.hi)]),
        cell_size: facts.grid.cell_size(),
        origin: facts.grid.origin().to_array(),
        domain: facts.domain.map(|domain| domain.walls().map(|wall| wall.to_array())),
        periodic: facts.periodic.map(|periodic| periodic.faces()),
        indicator: indicator.kind().name(),
        mu0: indicator.mean().map(MeanCount::particles),
        spacing: facts.spacing,
        largest_size: samples.coarsest(),
    })
}

fn mesh(path: &Path) -> Result<MeshInfo, Error> {
    let mesh = read_mesh(path)?;
    let measures = measure(&mesh);
    let attributes = mesh.attributes.iter();
    Ok(MeshInfo {
        file: path.to_owned(),
        vertices: mesh.positions.len(),
        triangles: mesh.triangles.len(),
        bounds: measures.bounds,
        components: measures.components,
        normals: mesh.normals.is_some(),
        attributes: attributes.map(VertexAttribute::info).collect(),
    })
}

fn volume(path: &Path) -> Result<VolumeInfo, Error> {
    let bytes = open_bytes(path)?;
    let grids = read_grids(bytes.view()).map_err(|fault| ReadError::new(path, fault))?;
    Ok(VolumeInfo { file: path.to_owned(), grids })
}

fn geometry(
    file: PathBuf,
    primitives: Primitives,
    unpacking: Unpacking,
) -> Result<GeometryInfo, Error> {
    let bytes = open_bytes_within(&file, unpacking)?;
    let opened = read_points(bytes, WantedAttributes::All, unpacking)
        .map_err(|fault| ReadError::new(&file, fault))?;
    let points = &opened.particles;
    Ok(GeometryInfo {
        file,
        format: opened.format,
        primitives,
        bounds: bounds(points).map(|b| [b.lo.to_array(), b.hi.to_array()]),
        attributes: points.attributes().to_vec(),
    })
}

/// Summarizes the particles of a file or, for a Houdini geometry without particles, its primitives
/// and points.
fn particles(path: &Path, settings: &Settings) -> Result<Info, Error> {
    let scratch = std::env::temp_dir();
    let unpacking =
        Unpacking { in_memory: default_memory().0 / 8, scratch: &scratch, control: None };
    let wanted = WantedParticles {
        attributes: WantedAttributes::All,
        ..settings.wanted(&SizeChoice::Ignored)
    };
    let file = match open_wanted(path, wanted, unpacking) {
        Err(ReadError { path: file, fault: ReadFault::OnlyPrimitives(primitives) })
            if file == path && settings.conditions().is_empty() =>
        {
            return geometry(file, primitives, unpacking).map(Info::Geometry);
        }
        opened => opened?,
    };
    let particles = &file.particles;
    let bounds = bounds(particles);
    let request = SamplingRequest {
        invalid: InvalidParticles::Skip,
        search: WallSearch::Hint,
        size: SizeChoice::Usual,
        ..SamplingRequest::default()
    };
    let source = SpacingHints { path: Some(path), spacing: file.spacing };
    let (cells, spacing_unknown) = match request.cells(particles, source) {
        Ok(cells) => (Some(cells), None),
        Err(Error::NoSpacing { why, suggested, .. }) => (None, Some((why.to_string(), suggested))),
        Err(_) => (None, None),
    };
    let known = cells.as_ref().and_then(|cells| cells.spacing.clone());
    let (nearest_neighbours, spacing_unknown) =
        spacing_unknown.map_or((None, None), |(why, suggested)| (suggested, Some(why)));
    Ok(Info::Particles(ParticlesInfo {
        file: path.to_owned(),
        format: file.format,
        particles: particles.len(),
        not_finite: particles.len() - bounds.map_or(0, |b| b.finite),
        bounds: bounds.map(|b| [b.lo.to_array(), b.hi.to_array()]),
        attributes: particles.attributes().iter().chain(&file.unread).cloned().collect(),
        values: occurring(particles),
        unselected: file.unselected,
        ghosts: file.ghosts,
        left_out: file.left_out.iter().map(ToString::to_string).collect(),
        box_size: file.box_size,
        unit_metres: file.unit_metres,
        particle_types: file.particle_types,
        memory_bytes: cells.as_ref().and_then(|cells| memory(particles, cells)),
        spacing: known.as_ref().map(|(spacing, _)| *spacing),
        spacing_source: known.map(|(_, source)| match source {
            SpacingSource::Scene(scene) => scene.display().to_string(),
            SpacingSource::Sizes(attribute) => format!("the smallest {attribute}"),
            SpacingSource::Estimated => "an estimate".to_owned(),
            SpacingSource::File
            | SpacingSource::Given
            | SpacingSource::State
            | SpacingSource::Packed => "the file".to_owned(),
        }),
        slab: cells.as_ref().and_then(|cells| cells.slab),
        walls: cells.as_ref().and_then(|cells| cells.walls.clone()).map(Box::new),
        spacing_warnings: cells
            .map_or(Vec::new(), |cells| cells.warnings.iter().map(ToString::to_string).collect()),
        spacing_unknown,
        nearest_neighbours,
    }))
}

/// Estimated peak memory, in bytes, of a reconstruction with default settings.
fn memory(particles: &dyn Particles, cells: &Cells) -> Option<u64> {
    let request = SamplingRequest { invalid: InvalidParticles::Skip, ..SamplingRequest::default() };
    let request = request.in_slab(cells.slab);
    let resources = Resources::new(MemoryBudget(u64::MAX), PathBuf::new());
    let grid = request.grid_of(cells).ok()?;
    let carried = Settings::default().carried(particles, None).ok()?;
    let sampling =
        request.sampling_on(grid, request.method, cells.lengths(), carried, resources).ok()?;
    let sampling = sampling.sized(cells.sizes.as_ref(), particles).ok()?;
    let counted = CountedFrame::of(particles, &sampling).ok()?;
    Some(counted.estimate().in_core())
}
