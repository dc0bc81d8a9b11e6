//! Compares two ways to sum positions into cells on a Vulkan device: sort particles by bins and add
//! them in shared memory, or add each particle directly to its cell in device memory.
//!
//! `cargo bench --bench binning [-- MILLIONS_OF_PARTICLES]`

#[path = "../shaders/compile.rs"]
#[allow(dead_code, reason = "the benchmark only compiles one shader")]
mod compile;
mod scene;

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use meniscus::internals::brick::vulkan::{
    BinPipelines, Coordinate, DeviceBins, DeviceGrid, DevicePositions, PAGE_WORDS, PROBES, SETTLED,
    bin,
};
use meniscus::internals::brick::{BrickSide, InvalidParticles};
use meniscus::internals::field::indicator::vulkan::{BinEntry, IndicatorPipelines, indicate};
use meniscus::internals::field::indicator::{IndicatorKind, PageRule};
use meniscus::internals::grid::{BIN, Grid, MortonKey};
use meniscus::internals::shaders::{CLOUDS, INDICATE};
use meniscus::internals::vulkan::{
    Batch, Buffer, BufferKind, Device, DeviceChoice, DeviceOptions, Instance, Queue, Shader, View,
    VulkanError,
};

#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Push {
    first: u32,
    count: u32,
    width: u32,
    mask: u32,
}

fn row(what: &str, particles: usize, seconds: f64) {
    println!(
        "{what:<44} {:>8.1} M particles/s {:>9.1} ms",
        particles as f64 / seconds / 1e6,
        seconds * 1e3
    );
}

fn upload<T: bytemuck::Pod>(device: &Device, values: &[T]) -> Result<View, VulkanError> {
    let bytes = size_of_val(values) as u64;
    let (staged, buffer) =
        (device.buffer(BufferKind::Upload, bytes)?, device.buffer(BufferKind::Device, bytes)?);
    // SAFETY: nothing else uses the new buffer yet.
    unsafe { staged.write(0, values) };
    run(device, |batch| {
        batch.copy(&staged.whole(), &buffer.whole());
        Ok(())
    })?;
    Ok(buffer.whole())
}

/// Records a batch, submits it and waits for it. Returns the time, in seconds, from submission to
/// completion.
fn run(
    device: &Device,
    record: impl FnOnce(&mut Batch) -> Result<(), VulkanError>,
) -> Result<f64, VulkanError> {
    let mut batch = device.batch(Queue::Compute)?;
    batch.begin()?;
    record(&mut batch)?;
    let start = Instant::now();
    batch.submit(&[])?;
    batch.wait()?;
    Ok(start.elapsed().as_secs_f64())
}

fn best(mut work: impl FnMut() -> Result<f64, VulkanError>) -> Result<f64, VulkanError> {
    (0..3).try_fold(f64::INFINITY, |best, _| Ok(best.min(work()?)))
}

/// Builds the hash table of bins in the layout of `bin_table.wgsl`, and lists the bin of each slot.
fn table(bins: &DeviceBins) -> (Vec<[u32; 4]>, Vec<u32>) {
    let len = (4 * bins.keys.len()).next_power_of_two();
    let (mut slots, mut numbers) = (vec![[0; 4]; len], vec![0; len]);
    for (number, key) in (0..).zip(&bins.keys) {
        let [x, y, z] = key.coord().to_array().map(|c| u64::from(c as u32 & 0x1f_ffff));
        let packed = x | y << 21 | z << 42;
        let (low, high) = (packed as u32, (packed >> 32) as u32);
        let mut hash = low.wrapping_mul(0x9e37_79b1) ^ high.wrapping_mul(0x85eb_ca77);
        hash = (hash ^ (hash >> 15)).wrapping_mul(0x2c1b_3c6d);
        let first = (hash ^ (hash >> 12)) as usize;
        let free =
            (first..first + PROBES as usize).map(|at| at % len).find(|&at| slots[at][0] == 0);
        let at = free.expect("the table is large");
        slots[at] = [SETTLED, 0, low, high];
        numbers[at] = number;
    }
    (slots, numbers)
}

fn main() -> Result<(), compile::Fault> {
    let millions = std::env::args().skip(1).find_map(|a| a.parse::<f64>().ok()).unwrap_or(1.0);
    let instance = Instance::connect(false)?;
    let device = Device::open(&instance, &DeviceChoice::Best, &DeviceOptions::default())?;
    let particles = scene::splash((millions * 1e6) as usize, 1);
    let count = particles.len();
    println!("{count} particles in random order, cell = spacing, on {}", device.name());
    let grid = Grid::new(DVec3::ZERO, 1.0)?;
    let positions = DevicePositions {
        view: upload(&device, &particles)?,
        count,
        coordinate: Coordinate::Single,
    };
    let pipelines = BinPipelines::new(&device)?;

    let mut sorted = None;
    let mut whole = f64::INFINITY;
    for _ in 0..3 {
        drop(sorted.take());
        drop(device.take_timings());
        let start = Instant::now();
        let positions = std::slice::from_ref(&positions);
        sorted = Some(bin(
            &device,
            &pipelines,
            positions,
            &grid,
            None,
            InvalidParticles::Refuse,
            usize::MAX,
        )?);
        whole = whole.min(start.elapsed().as_secs_f64());
    }
    let bins = sorted.expect("three runs");
    row("bins: place, count, sort", count, whole);
    for timing in device.take_timings() {
        row(&format!("  {}", timing.stage), count, timing.seconds);
    }

    let entry = |(key, first): (&MortonKey, &[usize])| BinEntry {
        first: first[0] as u32,
        count: (first[1] - first[0]) as u32,
        coord: key.coord().to_array(),
    };
    let entries: Vec<BinEntry> = bins.keys.iter().zip(bins.first.windows(2)).map(entry).collect();
    let entries_view = upload(&device, &entries)?;
    let pages = device
        .buffer(BufferKind::Device, 4 * u64::from(PAGE_WORDS) * entries.len() as u64)?
        .whole();
    let [indicate_pipeline, clouds] =
        [&INDICATE, &CLOUDS].map(|shader| device.pipeline(shader).map(Arc::new));
    let pipelines = IndicatorPipelines { indicate: indicate_pipeline?, clouds: clouds? };
    let (indicator, side) = (IndicatorKind::Symmetry, BrickSide::default());
    let rule = PageRule { indicator, spacing_cells: 1.0, side, walls: None };
    let [(_, records)] = &bins.runs[..] else {
        return Err("too many particles for one run".into());
    };
    let seconds = best(|| {
        run(&device, |batch| {
            let views = [&entries_view, &records.whole(), &pages];
            indicate(batch, &pipelines, entries.len() as u32, &rule, views)
        })
    })?;
    row("sums in shared memory, and the DIF", count, seconds);

    let direct: &'static Shader = Box::leak(Box::new(Shader {
        name: "direct",
        code: compile::compiled("direct", &compile::whole(include_str!("direct.wgsl"))?)?.leak(),
        buffers: &["grid", "positions", "slots", "bins", "sums"],
        push_bytes: size_of::<Push>() as u32,
        group: 256,
    }));
    let pipeline = Arc::new(device.pipeline(direct)?);
    let (slots, numbers) = table(&bins);
    let sums: Arc<Buffer> =
        device.buffer(BufferKind::Device, 28 * BIN.pow(3) as u64 * entries.len() as u64)?;
    let grid = upload(&device, &[DeviceGrid::new(&grid, None)])?;
    let mask = slots.len() as u32 - 1;
    let (slots, numbers) = (upload(&device, &slots)?, upload(&device, &numbers)?);
    let chunk = 1 << 20;
    let clear = best(|| {
        run(&device, |batch| {
            batch.clear(&sums.whole());
            Ok(())
        })
    })?;
    row("directly to cells: clear", count, clear);
    let seconds = best(|| {
        run(&device, |batch| {
            for first in (0..count).step_by(chunk) {
                let len = chunk.min(count - first);
                let positions = positions.view.part(12 * first as u64, 12 * len as u64);
                let buffers =
                    [grid.clone(), positions, slots.clone(), numbers.clone(), sums.whole()];
                let push = Push { first: 0, count: len as u32, width: 1, mask };
                batch.dispatch(&pipeline, &buffers, &push, [pipeline.groups(len as u32), 1, 1])?;
            }
            Ok(())
        })
    })?;
    row("directly to cells: place, add", count, seconds);
    Ok(())
}
