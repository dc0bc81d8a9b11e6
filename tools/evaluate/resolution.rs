//! Measures stage times for several resolutions (the paper's figure 14), on the CPU and on a Vulkan
//! device if there is one. Also measures the cost and benefit of recovering details (figure 15).

use std::time::Instant;

use meniscus::internals::backend::{Backend, Surfaces, field};
use meniscus::internals::frame::{Detail, Engine, Normals, Surfacing};
use meniscus::internals::grid::PeriodicMesh;
use meniscus::internals::surface::dual_mc::contour;
use meniscus::internals::surface::mesh::measure::measure;
use meniscus::internals::surface::mesh::source::MeshSource;
use meniscus::internals::surface::mesh::spool::Spool;
use meniscus::internals::surface::stitch::StitchedSurface;
use meniscus::internals::system::timings::Timings;
use meniscus::internals::vulkan::{Device, DeviceChoice, DeviceOptions, Instance, VulkanError};
use rayon::prelude::*;

use crate::methods::{COUNTING, Iso, Sigmas, grid, sampling, surfacing, volume_ratio};
use crate::scene::splash;
use crate::speed::longest_side;
use crate::tables::Table;
use crate::{Options, Outcome};

const CELLS: [u32; 4] = [128, 256, 384, 512];
/// The paper's stages, each with the names of this library's stages on a device.
const STAGES: [(&str, &[&str]); 4] = [
    ("DIF", &["upload", "indicate"]),
    ("smoothing", &["gather", "blur", "detail"]),
    ("isosurface", &["dual marching cubes"]),
    ("transfer", &["download"]),
];

pub fn run(options: &Options) -> Outcome<()> {
    let particles = splash(options.choose(1_000_000, 20_000), 1);
    let side = longest_side(&particles);
    let mut table = Table::new(&[
        "cells",
        "on",
        "DIF",
        "smoothing",
        "isosurface",
        "transfer",
        "whole frame",
        "triangles",
    ]);
    let device = best_device();
    if let Err(fault) = &device {
        eprintln!("evaluate: no Vulkan device: {fault}");
    }
    for &cells in options.choose(&CELLS[..], &CELLS[..1]) {
        let cell = side / f64::from(cells);
        let mut row = |on: String, (stages, whole, triangles): Figures| {
            let ms =
                |seconds: Option<f64>| seconds.map_or("-".into(), |s| format!("{:.1}", s * 1e3));
            let stages = stages.into_iter().map(ms);
            let about = [format!("{cells}^3"), on].into_iter();
            table.row(about.chain(stages).chain([ms(Some(whole)), triangles.to_string()]));
        };
        row(format!("CPU, {} threads", rayon::current_num_threads()), on_cpu(&particles, cell)?);
        if let Ok(device) = &device {
            row(device.name().to_string(), on_device(device, &particles, cell)?);
        }
    }
    table.print(&format!(
        "milliseconds per stage, {} particles of a splash, counting; on the CPU, each stage is \
         measured separately, and the whole frame in a normal run",
        particles.len()
    ));
    detail(options, &particles, side)
}

fn best_device() -> Result<Device, VulkanError> {
    Device::open(&Instance::connect(false)?, &DeviceChoice::Best, &DeviceOptions::default())
}

/// The time of each of [`STAGES`] and of the whole frame, in seconds, and the number of triangles.
type Figures = ([Option<f64>; 4], f64, u64);

fn on_cpu(particles: &[[f32; 3]], cell: f64) -> Outcome<Figures> {
    let (sampling, surfacing) =
        (sampling(grid(cell)?, 1.0, COUNTING), surfacing(Sigmas::Auto.value(), Iso::Auto.value()));
    Engine::sample(&particles, &sampling, &mut Timings::default())?;
    let start = Instant::now();
    let frame = Engine::sample(&particles, &sampling, &mut Timings::default())?;
    let dif = start.elapsed().as_secs_f64();
    let stitched = frame.surface(&surfacing, &mut Timings::default())?;
    let surface = stitched.to_mesh()?;
    let whole = start.elapsed().as_secs_f64();
    volume_ratio(&stitched, particles.len(), 1.0)?;

    let start = Instant::now();
    let sampled = frame.dif().ok_or("an indicator makes the field")?;
    let recipe = surfacing.recipe(sampled, &surfacing.calibrate(sampled)?.calibration);
    let regions = Surfaces {
        sampled,
        recipe: &recipe,
        solid: None,
        normals: Normals::None,
        periodic_mesh: PeriodicMesh::Cut,
    }
    .regions();
    let fields: Vec<_> = regions
        .par_iter()
        .map(|&cells| field(&recipe, sampled, Normals::None.cells(cells)))
        .collect();
    let smoothing = start.elapsed().as_secs_f64();

    let start = Instant::now();
    let blocks: Vec<_> = fields
        .par_iter()
        .zip(&regions)
        .map(|(field, &cells)| contour(field, cells, recipe.iso, None))
        .collect();
    let mut spool = Spool::in_memory(false, Vec::new());
    blocks.into_iter().try_for_each(|block| spool.push(block))?;
    let mesh = StitchedSurface::new(spool, grid(cell)?, None, recipe.iso, Vec::new()).to_mesh()?;
    let isosurface = start.elapsed().as_secs_f64();
    assert_eq!(mesh.triangles.len(), surface.triangles.len());
    Ok((
        [Some(dif), Some(smoothing), Some(isosurface), None],
        whole,
        surface.triangles.len() as u64,
    ))
}

fn on_device(device: &Device, particles: &[[f32; 3]], cell: f64) -> Outcome<Figures> {
    let mut sampling = sampling(grid(cell)?, 1.0, COUNTING);
    sampling.resources.backend = Backend::vulkan(device.clone())?;
    let surfacing = surfacing(Sigmas::Auto.value(), Iso::Auto.value());
    let run = || -> Outcome<(f64, u64)> {
        let start = Instant::now();
        let frame = Engine::sample(&particles, &sampling, &mut Timings::default())?;
        let mesh = frame.surface(&surfacing, &mut Timings::default())?;
        mesh.to_mesh()?;
        let seconds = start.elapsed().as_secs_f64();
        volume_ratio(&mesh, particles.len(), 1.0)?;
        Ok((seconds, mesh.triangle_count()))
    };
    // Do not measure the first run: it compiles shaders and allocates memory.
    run()?;
    drop(device.take_timings());
    let (whole, triangles) = run()?;
    let timings = device.take_timings();
    let seconds = |parts: &[&str]| {
        timings.iter().filter(|t| parts.contains(&t.stage)).map(|t| t.seconds).sum::<f64>()
    };
    Ok((STAGES.map(|(_, parts)| Some(seconds(parts))), whole, triangles))
}

/// Measures recovering details with the paper's parameters: c = 0.2, sigma = 1.2, counting, 256
/// cells.
fn detail(options: &Options, particles: &[[f32; 3]], side: f64) -> Outcome<()> {
    let mut table = Table::new(&["c", "surface", "seconds", "components", "volume", "triangles"]);
    let sampling = sampling(grid(side / options.choose(256.0, 64.0))?, 1.0, COUNTING);
    let kinds = [("smoothed", Detail::Smoothed), ("details recovered", Detail::Recovered)];
    let all = [("0.2", Iso::At(0.2)), ("auto", Iso::Auto)]
        .into_iter()
        .flat_map(|c| kinds.map(|kind| (c, kind)));
    for ((c, iso), (name, detail)) in all {
        let surfacing = Surfacing { detail, ..surfacing(Sigmas::Cells(1.2).value(), iso.value()) };
        let run = || -> Outcome<_> {
            let start = Instant::now();
            let frame = Engine::sample(&particles, &sampling, &mut Timings::default())?;
            let mesh = frame.surface(&surfacing, &mut Timings::default())?.to_mesh()?;
            Ok((start.elapsed().as_secs_f64(), mesh))
        };
        run()?;
        let (seconds, mesh) = run()?;
        let measures = measure(&mesh);
        table.row([
            c.into(),
            name.into(),
            format!("{seconds:.3}"),
            measures.components.to_string(),
            format!("{:.0}", measures.volume.unwrap_or(f64::NAN)),
            mesh.triangles.len().to_string(),
        ]);
    }
    table.print(&format!(
        "recovering details: counting, sigma 1.2, {} cells along the longest side, {} particles \
         at spacing 1",
        options.choose(256, 64),
        particles.len()
    ));
    Ok(())
}
