//! Measures each stage of a frame on a Vulkan device and on the CPU, and prints a Markdown table.
//!
//! The table contains the time of each stage, in milliseconds, with transfers as separate stages,
//! and the share of the device's memory bandwidth that the stage uses. The frames use the cloud
//! indicator, and the paper's symmetry indicator with recovered details. Fails if the device's mesh
//! differs from the CPU's.
//!
//! `cargo bench --bench backends [-- --device DEVICE] [--cells 256,384,512] [--millions 1,10,100]`

mod scene;

use std::error::Error;
use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use glam::DVec3;
use meniscus::internals::backend::Backend;
use meniscus::internals::brick::InvalidParticles;
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::field::spacing::estimate;
use meniscus::internals::frame::{Detail, Engine, FrameError, Resources, Sampling, Surfacing};
use meniscus::internals::grid::Grid;
use meniscus::internals::grid::units::MemoryBudget;
use meniscus::internals::surface::mesh::source::MeshSource;
use meniscus::internals::system::timings::Timings;
use meniscus::internals::vulkan::{
    BufferKind, Device, DeviceChoice, DeviceOptions, Instance, Queue, Timing, VulkanError,
};

/// Sizes, in bytes, of the copies that measure the device's bandwidth. The first size is larger
/// than caches. The second is for devices with too little memory for the first.
const COPIED: [u64; 2] = [1 << 30, 64 << 20];
/// The names of the stages on the device, in the order of the table's columns.
const STAGES: [&str; 12] = [
    "upload",
    "indicate",
    "full cells",
    "halve",
    "inside",
    "gather",
    "blur",
    "detail",
    "distances",
    "drops",
    "dual marching cubes",
    "download",
];
/// The indicators whose surfaces are measured.
const KINDS: [IndicatorKind; 2] = [IndicatorKind::Cloud, IndicatorKind::Symmetry];

/// Options of the measurement.
#[derive(Parser)]
pub struct Options {
    /// A device's number or a part of its name.
    #[arg(long)]
    pub device: Option<String>,
    /// Numbers of cells along the scene's longest side.
    #[arg(long, value_delimiter = ',', default_value = "256,384,512")]
    pub cells: Vec<u32>,
    /// Numbers of particles, in millions.
    #[arg(long, value_delimiter = ',', default_value = "1,10,100")]
    pub millions: Vec<f64>,
    /// Ignored: `cargo bench` passes this flag.
    #[arg(long, hide = true)]
    pub bench: bool,
}

fn main() -> Result<ExitCode, Box<dyn Error>> {
    Ok(if measure(Options::parse())? { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Prints the table, and returns whether every mesh has the same bytes on the device and on the
/// CPU.
pub fn measure(options: Options) -> Result<bool, Box<dyn Error>> {
    let choice = options.device.map_or(DeviceChoice::Best, DeviceChoice::Named);
    let instance = Instance::connect(false)?;
    let device = Device::open(&instance, &choice, &DeviceOptions::default())?;
    let [large, small] = COPIED.map(|bytes| bandwidth(&device, bytes));
    let bandwidth = large.or(small)?;
    let vulkan = Backend::vulkan(device.clone())?;
    println!(
        "{}: copies {:.1} GB/s (read + write); CPU: {} threads\n",
        device.name(),
        bandwidth / 1e9,
        rayon::current_num_threads()
    );
    println!(
        "| cells | M particles | surface | CPU indicate | CPU mesh | {} | device, wall | same bytes |",
        STAGES.join(" | ")
    );
    println!("|---|---|---|---|---|{}---|---|", "---|".repeat(STAGES.len()));
    let mut all_same = true;
    for &millions in &options.millions {
        let particles = scene::splash((millions * 1e6) as usize, 1);
        let width = particles.iter().flatten().fold(0.0_f32, |a, &b| a.max(b));
        let spacing = estimate(&particles);
        for (&cells, kind) in options.cells.iter().flat_map(|cells| KINDS.map(|kind| (cells, kind)))
        {
            let mut sampling = sampling(f64::from(width) / f64::from(cells), kind, spacing);
            let (cpu, expected) = match run(&particles, &sampling) {
                Err(FrameError::TooFine(why)) => {
                    println!(
                        "| {cells} | {:.2} | {} | {why} |",
                        particles.len() as f64 / 1e6,
                        kind.name()
                    );
                    continue;
                }
                done => done?,
            };
            sampling.resources.backend = vulkan.clone();
            // Do not measure the first run: it compiles shaders and allocates memory.
            run(&particles, &sampling)?;
            drop(device.take_timings());
            let start = Instant::now();
            let (timings, found) = run(&particles, &sampling)?;
            let wall = start.elapsed().as_secs_f64();
            let on_kernels = device.take_timings();
            let stages: Vec<String> =
                STAGES.iter().map(|name| entry(&on_kernels, name, bandwidth)).collect();
            let ms = |timings: &Timings, name| {
                timings.seconds().iter().filter(|lap| lap.0 == name).map(|lap| lap.1).sum::<f64>()
                    * 1e3
            };
            let on_device = ms(&timings, "indicate") + ms(&timings, "mesh");
            println!(
                "| {cells} | {:.2} | {} | {:.1} | {:.1} | {} | {on_device:.1} of {:.1} | {} |",
                particles.len() as f64 / 1e6,
                kind.name(),
                ms(&cpu, "indicate"),
                ms(&cpu, "mesh"),
                stages.join(" | "),
                wall * 1e3,
                if found == expected { "yes" } else { "NO" },
            );
            all_same &= found == expected;
        }
    }
    Ok(all_same)
}

fn sampling(cell: f64, kind: IndicatorKind, spacing: Option<f64>) -> Sampling {
    Sampling {
        grid: Grid::new(DVec3::ZERO, cell).expect("a valid grid"),
        domain: None,
        periodic: None,
        method: kind.into(),
        invalid: InvalidParticles::Refuse,
        side: kind.brick_side(),
        carried: Vec::new(),
        kinds: Vec::new(),
        sizes: None,
        spacing,
        resources: Resources::new(MemoryBudget(u64::MAX), std::env::temp_dir()),
    }
}

/// Reconstructs a frame, and returns its timings and a checksum of its mesh.
fn run(particles: &[[f32; 3]], sampling: &Sampling) -> Result<(Timings, u32), FrameError> {
    let is_cloud = sampling.method == IndicatorKind::Cloud.into();
    let surfacing = match is_cloud {
        true => Surfacing::PLAIN,
        false => Surfacing { detail: Detail::Recovered, ..Surfacing::PLAIN },
    };
    let mut timings = Timings::default();
    let frame = Engine::sample(&particles, sampling, &mut timings)?;
    let surface = frame.surface(&surfacing, &mut timings)?;
    assert!(frame.warnings().is_empty(), "{:?}", frame.warnings());
    let mut sum = crc32fast::Hasher::new();
    for piece in 0..surface.pieces() {
        let vertices = surface.vertices(piece).expect("in memory");
        sum.update(bytemuck::cast_slice(&vertices.positions));
        sum.update(bytemuck::cast_slice(&surface.triangles(piece).expect("in memory")));
    }
    Ok((timings, sum.finalize()))
}

/// A table entry: the time of a stage, in milliseconds, and the share of the device's bandwidth
/// that the stage uses.
fn entry(timings: &[Timing], stage: &str, bandwidth: f64) -> String {
    match timings.iter().find(|timing| timing.stage == stage) {
        None => "-".into(),
        Some(timing) => {
            let share = timing.bytes as f64 / timing.seconds / bandwidth;
            format!("{:.1} ({:.0} %)", timing.seconds * 1e3, share * 1e2)
        }
    }
}

/// Measures the device's memory bandwidth for reads plus writes, in bytes per second, by copying
/// `bytes` bytes from one buffer to another.
fn bandwidth(device: &Device, bytes: u64) -> Result<f64, VulkanError> {
    let from = device.buffer(BufferKind::Device, bytes)?.whole();
    let to = device.buffer(BufferKind::Device, bytes)?.whole();
    let mut batch = device.batch(Queue::Compute)?;
    let mut best: f64 = 0.0;
    for _ in 0..5 {
        batch.begin()?;
        batch.stage("copy", 2 * bytes);
        batch.copy(&from, &to);
        batch.submit(&[])?;
        batch.wait()?;
        for timing in device.take_timings() {
            best = best.max(timing.bytes as f64 / timing.seconds);
        }
    }
    Ok(best)
}
