//! `meniscus info`: what a file holds.

use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use clap::Args;
use glam::IVec3;
use meniscus::brick::InvalidParticles;
use meniscus::error::Error;
use meniscus::field::indicator::SampledDif;
use meniscus::field::spacing;
use meniscus::frame::{Counted, Resources};
use meniscus::grid::units::{MeanCount, MemoryBudget, shown};
use meniscus::io::bytes::Unpacking;
use meniscus::io::input::{holds_mesh, open_particles};
use meniscus::io::mnf::open_frame;
use meniscus::io::output::read_mesh;
use meniscus::io::scene::spacing_beside;
use meniscus::particles::{Particles, bounds};
use meniscus::reconstruction::{Origin, SamplingRequest};
use meniscus::surface::mesh::VertexAttribute;
use meniscus::surface::mesh::measure::measure;
use meniscus::system::memory::default_budget;
use serde::Serialize;

use crate::outcome::{Verdict, print, print_json};
use meniscus::io::mnf::is_packed;

#[derive(Args)]
pub struct Options {
    /// Particle files or meshes.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// As JSON, for programs: a list with an entry for each file.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Attribute {
    name: String,
    components: usize,
}

#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
enum Info {
    Particles {
        file: PathBuf,
        format: &'static str,
        particles: usize,
        not_finite: usize,
        bounds: Option<[[f64; 3]; 2]>,
        attributes: Vec<Attribute>,
        spacing: Option<f64>,
        /// Where the spacing comes from.
        spacing_source: Option<String>,
        /// To reconstruct in memory by default.
        memory_bytes: Option<u64>,
    },
    Frame {
        file: PathBuf,
        particles: usize,
        /// That are not 0 by what their own bin's particles leave in them.
        cells: u64,
        bricks: u64,
        /// Of these cells.
        bounds: Option<[[f64; 3]; 2]>,
        cell_size: f64,
        origin: [f64; 3],
        domain: Option<[[f64; 3]; 2]>,
        indicator: &'static str,
        mu0: Option<f64>,
    },
    Mesh {
        file: PathBuf,
        vertices: usize,
        triangles: usize,
        bounds: Option<[[f64; 3]; 2]>,
        components: usize,
        normals: bool,
        attributes: Vec<Attribute>,
    },
}

/// Runs the command.
pub fn run(options: &Options) -> Result<Verdict, Error> {
    let infos = options.files.iter().map(|path| inspect(path)).collect::<Result<Vec<_>, _>>()?;
    if options.json {
        print_json(&infos)?;
    } else {
        for info in &infos {
            print(&describe(info))?;
        }
    }
    Ok(Verdict::Good)
}

fn inspect(path: &Path) -> Result<Info, Error> {
    if is_packed(path) {
        inspect_frame(path)
    } else if holds_mesh(path)? {
        inspect_mesh(path)
    } else {
        inspect_particles(path)
    }
}

fn inspect_frame(path: &Path) -> Result<Info, Error> {
    let SampledDif { facts, indicator, dif, .. } = open_frame(path, 0)?;
    let full = dif.infos().iter().map(|info| info.full).reduce(|a, b| a.union(&b));
    let world = |cells: IVec3| facts.grid.world_from_cells(cells.as_dvec3()).to_array();
    Ok(Info::Frame {
        file: path.to_owned(),
        particles: facts.census.binned,
        cells: dif.full_cells(),
        bricks: dif.bricks(),
        bounds: full.map(|full| [world(full.lo), world(full.hi)]),
        cell_size: facts.grid.cell_size(),
        origin: facts.grid.origin().to_array(),
        domain: facts.domain.map(|domain| domain.walls().map(|wall| wall.to_array())),
        indicator: indicator.kind().name(),
        mu0: indicator.mean().map(MeanCount::particles),
    })
}

fn inspect_mesh(path: &Path) -> Result<Info, Error> {
    let mesh = read_mesh(path)?;
    let measures = measure(&mesh);
    let attribute = |a: &VertexAttribute| Attribute { name: a.name.clone(), components: a.components };
    Ok(Info::Mesh {
        file: path.to_owned(),
        vertices: mesh.positions.len(),
        triangles: mesh.triangles.len(),
        bounds: measures.bounds,
        components: measures.components,
        normals: mesh.normals.is_some(),
        attributes: mesh.attributes.iter().map(attribute).collect(),
    })
}

fn inspect_particles(path: &Path) -> Result<Info, Error> {
    let scratch = std::env::temp_dir();
    let unpacking = Unpacking { in_memory: default_budget().0 / 8, scratch: &scratch };
    let file = open_particles(path, unpacking)?;
    let particles = &file.particles;
    let bounds = bounds(particles);
    let (spacing, spacing_source) = if let Some(spacing) = file.spacing {
        (Some(spacing), Some("the file".to_owned()))
    } else if let Some((spacing, scene)) = spacing_beside(path) {
        (Some(spacing), Some(scene.display().to_string()))
    } else {
        let estimate = spacing::estimate(particles);
        (estimate, estimate.map(|_| "an estimate".to_owned()))
    };
    Ok(Info::Particles {
        file: path.to_owned(),
        format: file.format,
        particles: particles.len(),
        not_finite: particles.len() - bounds.map_or(0, |b| b.finite),
        bounds: bounds.map(|b| [b.lo.to_array(), b.hi.to_array()]),
        attributes: particles
            .attributes()
            .iter()
            .map(|a| Attribute { name: a.name.clone(), components: a.components })
            .collect(),
        memory_bytes: spacing.and_then(|spacing| memory(particles, spacing)),
        spacing,
        spacing_source,
    })
}

/// What reconstructing by default takes, in bytes.
fn memory(particles: &impl Particles, spacing: f64) -> Option<u64> {
    let request = SamplingRequest {
        spacing: Some(spacing),
        invalid: InvalidParticles::Skip,
        ..SamplingRequest::default()
    };
    let cells = request.cells(particles, Origin::default()).ok()?;
    let resources = Resources::new(MemoryBudget(u64::MAX), PathBuf::new());
    let grid = request.grid(cells.size).ok()?;
    let sampling = request.sampling_on(grid, request.field, None, Vec::new(), resources).ok()?;
    let counted = Counted::of(particles, &sampling).ok()?;
    Some(counted.estimate().in_core())
}

fn describe(info: &Info) -> String {
    let mut lines = Vec::new();
    let mut line = |name: &str, text: String| lines.push(format!("  {name:<12} {text}"));
    let corners = |[lo, hi]: &[[f64; 3]; 2]| format!("{lo:?} to {hi:?}");
    let names = |attributes: &[Attribute]| {
        let names: Vec<_> = attributes.iter().map(|a| format!("{} ({})", a.name, a.components)).collect();
        if names.is_empty() { "none".to_owned() } else { names.join(", ") }
    };
    let title = match info {
        Info::Particles {
            file,
            format,
            particles,
            not_finite,
            bounds,
            attributes,
            spacing,
            spacing_source,
            memory_bytes,
        } => {
            line("particles", particles.to_string());
            if *not_finite > 0 {
                line("not finite", not_finite.to_string());
            }
            bounds.iter().for_each(|bounds| line("box", corners(bounds)));
            line("attributes", names(attributes));
            let source = spacing_source.as_deref().unwrap_or_default();
            line("spacing", spacing.map_or("unknown".into(), |s| format!("{}, from {source}", shown(s))));
            if let Some(bytes) = memory_bytes {
                line("memory", format!("about {} by default", ByteSize(*bytes)));
            }
            format!("{}: {format}", file.display())
        }
        Info::Frame { file, particles, cells, bricks, bounds, cell_size, origin, domain, indicator, mu0 } => {
            line("particles", particles.to_string());
            line("cells", cells.to_string());
            line("bricks", bricks.to_string());
            bounds.iter().for_each(|bounds| line("box", corners(bounds)));
            line("cell size", cell_size.to_string());
            line("origin", format!("{origin:?}"));
            line("domain", domain.as_ref().map_or("unbounded".into(), corners));
            line("indicator", indicator.to_string());
            mu0.iter().for_each(|mu0| line("mu0", mu0.to_string()));
            format!("{}: packed frame", file.display())
        }
        Info::Mesh { file, vertices, triangles, bounds, components, normals, attributes } => {
            line("vertices", vertices.to_string());
            line("triangles", triangles.to_string());
            line("components", components.to_string());
            line("normals", if *normals { "yes" } else { "no" }.into());
            bounds.iter().for_each(|bounds| line("box", corners(bounds)));
            line("attributes", names(attributes));
            format!("{}: mesh", file.display())
        }
    };
    format!("{title}\n{}", lines.join("\n"))
}
