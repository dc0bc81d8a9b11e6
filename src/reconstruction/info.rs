//! Contents of a particle file, a packed frame or a mesh, for people and programs that look before
//! they convert.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use glam::IVec3;
use serde::Serialize;

use crate::brick::InvalidParticles;
use crate::error::Error;
use crate::field::indicator::SampledDif;
use crate::frame::{Counted, Resources};
use crate::grid::units::{MeanCount, MemoryBudget};
use crate::io::bytes::Unpacking;
use crate::io::collection::{frame_of, is_list};
use crate::io::input::{InputFormat, KNOWN, file_and_step, holds_mesh, open_wanted};
use crate::io::mnf::{is_packed, open_frame};
use crate::io::output::read_mesh;
use crate::io::wanted::{Wanted, WantedAttributes};
use crate::io::{ReadError, ReadFault};
use crate::particles::occurring::{Occurring, occurring};
use crate::particles::{AttributeInfo, Particles, bounds};
use crate::surface::mesh::VertexAttribute;
use crate::surface::mesh::measure::measure;
use crate::system::memory::default_memory;

use crate::settings::Settings;

use super::{Cells, FoundWalls, SamplingRequest, Search, Slab, Source, SpacingSource};

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
}

/// Contents of a particle file.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct ParticlesInfo {
    /// The file.
    pub file: PathBuf,
    /// The kind of file, in the words that people use for it.
    pub format: &'static str,
    /// The number of particles.
    pub particles: usize,
    /// The number of those whose coordinates are not finite.
    pub not_finite: usize,
    /// The lowest and the highest corner of the box around all others.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// The attributes beside positions.
    pub attributes: Vec<AttributeInfo>,
    /// The attributes of few values, and how often each value occurs.
    pub values: Vec<Occurring>,
    /// The number of particles that fail the conditions.
    pub unselected: usize,
    /// The number of particles that are left out, as copies of those of other pieces.
    pub ghosts: usize,
    /// Parts of the input that are not read, in words.
    pub left_out: Vec<String>,
    /// Edges of the simulation's box by the file, which does not say whether it is periodic.
    pub box_size: Option<[f64; 3]>,
    /// The unit of length in metres, by the file.
    pub unit_metres: Option<f64>,
    /// Types of particles that the file holds, the one that was read first; none where it holds
    /// but one without a name.
    pub particle_types: Vec<String>,
    /// Distance between neighbouring particles.
    pub spacing: Option<f64>,
    /// Where the spacing comes from.
    pub spacing_source: Option<String>,
    /// Why the spacing may be wrong.
    pub spacing_doubts: Vec<String>,
    /// Why there is no spacing.
    pub spacing_unknown: Option<String>,
    /// The spacing that nearest neighbours suggest, where there is none.
    pub nearest_neighbours: Option<f64>,
    /// The slab that is meshed, where all particles lie in a plane.
    pub slab: Option<Slab>,
    /// The walls that the scene and the ends of the particles show.
    pub walls: Option<Box<FoundWalls>>,
    /// Bytes that reconstructing in memory takes by default.
    pub memory_bytes: Option<u64>,
}

/// Contents of a packed frame.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct FrameInfo {
    /// The file.
    pub file: PathBuf,
    /// The number of particles that it was made of.
    pub particles: usize,
    /// Cells that are not 0 by what their own bin's particles leave in them.
    pub cells: u64,
    /// Bricks that are stored.
    pub bricks: u64,
    /// The lowest and the highest corner of the box around these cells.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// Edge of a cell.
    pub cell_size: f64,
    /// A corner of the grid's cells.
    pub origin: [f64; 3],
    /// The walls of the tank, if the fluid is in one.
    pub domain: Option<[[f64; 3]; 2]>,
    /// The faces of the periodic box along each axis that is not open, if the fluid is in one.
    pub periodic: Option<[Option<[f64; 2]>; 3]>,
    /// The indicator's name.
    pub indicator: &'static str,
    /// Mean number of particles in a full cell, where the indicator counts.
    pub mu0: Option<f64>,
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
    /// The lowest and the highest corner of the box around the vertices.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// The number of connected components.
    pub components: usize,
    /// Whether vertices have normals.
    pub normals: bool,
    /// The other attributes of the vertices.
    pub attributes: Vec<AttributeInfo>,
}

/// The extensions of all files that are looked into, in the words of a message.
static ALL_KNOWN: LazyLock<String> = LazyLock::new(|| {
    format!(
        "particles: {KNOWN}; packed frames: .mnf; meshes: .ply, .obj, .vtk, .vtp and .stl"
    )
});

/// Looks into a particle file, a packed frame or a mesh.
///
/// # Errors
/// [`Error::Read`].
pub fn info(path: impl AsRef<Path>) -> Result<Info, Error> {
    info_by(path, &Settings::default())
}

/// Looks into a file like [`info`], read in the format and for the type of particles that settings
/// name.
///
/// # Errors
/// [`Error::Read`], also where there is no such type.
pub fn info_by(path: impl AsRef<Path>, settings: &Settings) -> Result<Info, Error> {
    let path = path.as_ref();
    let (file, step) = file_and_step(path);
    if is_list(file) {
        return match &frame_of(path, file, step)?.files[..] {
            [only] => info_by(only, settings),
            _ => particles(path, settings).map(Info::Particles),
        };
    }
    if is_packed(path) {
        frame(path).map(Info::Frame)
    } else if settings.format.is_some() {
        particles(path, settings).map(Info::Particles)
    } else if holds_mesh(path)? {
        mesh(path).map(Info::Mesh)
    } else if InputFormat::of(file).is_some() {
        particles(path, settings).map(Info::Particles)
    } else {
        Err(ReadError::new(path, ReadFault::UnknownExtension { known: &ALL_KNOWN }).into())
    }
}

fn frame(path: &Path) -> Result<FrameInfo, Error> {
    let SampledDif { facts, indicator, dif, .. } = open_frame(path, 0)?;
    let full = dif.infos().iter().map(|info| info.full).reduce(|a, b| a.union(&b));
    let world = |cells: IVec3| facts.grid.world_from_cells(cells.as_dvec3()).to_array();
    Ok(FrameInfo {
        file: path.to_owned(),
        particles: facts.census.binned,
        cells: dif.full_cells(),
        bricks: dif.bricks(),
        bounds: full.map(|full| [world(full.lo), world(full.hi)]),
        cell_size: facts.grid.cell_size(),
        origin: facts.grid.origin().to_array(),
        domain: facts.domain.map(|domain| domain.walls().map(|wall| wall.to_array())),
        periodic: facts.periodic.map(|periodic| periodic.faces()),
        indicator: indicator.kind().name(),
        mu0: indicator.mean().map(MeanCount::particles),
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

fn particles(path: &Path, settings: &Settings) -> Result<ParticlesInfo, Error> {
    let scratch = std::env::temp_dir();
    let unpacking =
        Unpacking { in_memory: default_memory().0 / 8, scratch: &scratch, control: None };
    let wanted = Wanted { attributes: WantedAttributes::All, ..settings.wanted() };
    let file = open_wanted(path, wanted, unpacking)?;
    let particles = &file.particles;
    let bounds = bounds(particles);
    let request = SamplingRequest {
        invalid: InvalidParticles::Skip,
        search: Search::Hint,
        ..SamplingRequest::default()
    };
    let source = Source { path: Some(path), spacing: file.spacing };
    let (cells, spacing_unknown) = match request.cells(particles, source) {
        Ok(cells) => (Some(cells), None),
        Err(Error::NoSpacing { why, suggested, .. }) => (None, Some((why.to_string(), suggested))),
        Err(_) => (None, None),
    };
    let known = cells.as_ref().and_then(|cells| cells.spacing.clone());
    let (nearest_neighbours, spacing_unknown) =
        spacing_unknown.map_or((None, None), |(why, suggested)| (suggested, Some(why)));
    Ok(ParticlesInfo {
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
            SpacingSource::Estimated => "an estimate".to_owned(),
            SpacingSource::File
            | SpacingSource::Given
            | SpacingSource::State
            | SpacingSource::Packed => "the file".to_owned(),
        }),
        slab: cells.as_ref().and_then(|cells| cells.slab),
        walls: cells.as_ref().and_then(|cells| cells.walls.clone()).map(Box::new),
        spacing_doubts: cells
            .map_or(Vec::new(), |cells| cells.doubts.iter().map(ToString::to_string).collect()),
        spacing_unknown,
        nearest_neighbours,
    })
}

/// The bytes that reconstructing by default takes.
fn memory(particles: &impl Particles, cells: &Cells) -> Option<u64> {
    let request = SamplingRequest { invalid: InvalidParticles::Skip, ..SamplingRequest::default() };
    let request = request.in_slab(cells.slab);
    let resources = Resources::new(MemoryBudget(u64::MAX), PathBuf::new());
    let grid = request.grid_of(cells).ok()?;
    let carried = Settings::default().carried(particles.attributes(), None).ok()?;
    let sampling =
        request.sampling_on(grid, request.method, cells.spacing(), carried, resources).ok()?;
    let counted = Counted::of(particles, &sampling).ok()?;
    Some(counted.estimate().in_core())
}
