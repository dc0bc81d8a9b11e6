//! Tests of resident frames, whose meshes stay on a device: the meshes equal those of the CPU,
//! rounded to f32.

#[path = "../../tools/examples/resident.rs"]
mod example;

use meniscus::internals::brick::InvalidParticles;
use meniscus::internals::brick::vulkan::{Coordinate, DevicePositions};
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::field::recipe::Detail;
use meniscus::internals::frame::resident::{DeviceRequest, Exchange, Pipeline, ResidentSurface};
use meniscus::internals::frame::{FrameError, Sampling, Surfacing};
use meniscus::internals::grid::units::{Isovalue, Sigma, Smooth};
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::vulkan::{
    BufferKind, Device, DeviceOptions, Queue, Queues, ValidationLog, VulkanError,
};

use crate::common::scene::Random;
use crate::common::{
    INDICATORS, device, dif, reconstruct, sampling, splashes, surfacing, uneven_tank,
};
use crate::compile;

fn open() -> Option<(Device, ValidationLog)> {
    device::open(&DeviceOptions::default()).map_err(device::skip).ok()
}

fn positions(device: &Device, particles: &[[f64; 3]]) -> DevicePositions {
    let view = device.uploaded(particles).unwrap();
    DevicePositions { view, count: particles.len(), coordinate: Coordinate::Double }
}

fn read(device: &Device, surface: &ResidentSurface) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let mut batch = device.batch(Queue::Transfer).unwrap();
    batch.begin().unwrap();
    let [vertices, indices] = [&surface.positions, &surface.indices].map(|buffer| {
        let read = device.buffer(BufferKind::Download, buffer.bytes()).unwrap().whole();
        batch.copy(buffer, &read);
        read
    });
    batch.submit(&[]).unwrap();
    batch.wait().unwrap();
    // SAFETY: the only batch that writes the buffers is done.
    unsafe {
        (vertices.read(0, surface.vertices as usize), indices.read(0, surface.triangles as usize))
    }
}

fn settings(sampling: &Sampling, surfacing: &Surfacing) -> DeviceRequest {
    DeviceRequest {
        grid: sampling.grid,
        domain: sampling.domain,
        indicator: sampling.method.indicator().unwrap(),
        mean: None,
        invalid: InvalidParticles::Refuse,
        spacing: sampling.spacing,
        surfacing: surfacing.clone(),
        calibration: None,
    }
}

/// The spacing, in cells, for tests of an indicator: clouds need a large spacing to have wide
/// cells, and the paper's indicators need a small spacing.
fn spacing(indicator: IndicatorKind) -> f64 {
    if indicator == IndicatorKind::Cloud { 3.0 } else { 0.8 }
}

fn rounded(mesh: &Mesh) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    (mesh.positions.iter().map(|p| p.map(|x| x as f32)).collect(), mesh.triangles.clone())
}

#[test]
fn resident_frames_match_the_cpu_for_all_indicators_filters_and_walls() {
    let particles = splashes(31);
    let Some((device, log)) = open() else { return };
    let pipeline = Pipeline::new(&device).unwrap();
    let input = [positions(&device, &particles)];
    for indicator in INDICATORS {
        // Also test clouds with three cells per spacing, whose wide cells are twice as wide as
        // cells.
        let spacings = if indicator == IndicatorKind::Cloud { &[0.8, 3.0][..] } else { &[0.8] };
        for (detail, sigma, smooth) in [(Detail::Smoothed, 1.0, 1.6), (Detail::Recovered, 1.5, 2.5)]
        {
            for (walls, &spacing) in
                [false, true].iter().flat_map(|walls| spacings.iter().map(move |s| (*walls, s)))
            {
                let mut sampling =
                    Sampling { method: indicator.into(), spacing: Some(spacing), ..sampling() };
                sampling.domain = walls.then(|| uneven_tank(&sampling.grid));
                let (sigma, smooth) = (Sigma::new(sigma).ok(), Smooth::new(smooth).unwrap());
                let surfacing = Surfacing { smooth, detail, sigma, ..surfacing() };
                let (frame, expected) = reconstruct(&particles[..], &sampling, &surfacing);
                let surface = pipeline.surface(&input, &settings(&sampling, &surfacing)).unwrap();
                let what = format!("{indicator:?}, {detail:?}, walls {walls}, spacing {spacing}");
                assert_eq!(
                    (surface.iso, surface.census),
                    (expected.iso, frame.facts().census),
                    "{what}"
                );
                assert!(read(&device, &surface) == rounded(&expected.mesh), "{what}");
            }
        }
    }
    drop((pipeline, input));
    assert_eq!(device.allocated(), 0, "some buffers are not freed");
    drop(device);
    assert_eq!(log.messages(), [""; 0]);
}

#[test]
fn resident_frames_are_independent_of_the_queues() {
    let particles = splashes(31);
    for (queues, indicator) in [Queues::One, Queues::OneAsTwo]
        .iter()
        .flat_map(|&queues| INDICATORS.map(|indicator| (queues, indicator)))
    {
        let sampling =
            Sampling { method: indicator.into(), spacing: Some(spacing(indicator)), ..sampling() };
        let (frame, expected) = reconstruct(&particles[..], &sampling, &surfacing());
        let options =
            DeviceOptions { queues, shares_host_memory: Some(false), ..DeviceOptions::default() };
        let Some((device, log)) = device::open(&options).map_err(device::skip).ok() else { return };
        let input = [positions(&device, &particles)];
        let pipeline = Pipeline::new(&device).unwrap();
        let surface = pipeline.surface(&input, &settings(&sampling, &surfacing())).unwrap();
        assert_eq!(surface.census, frame.facts().census, "{queues:?}, {indicator:?}");
        assert!(read(&device, &surface) == rounded(&expected.mesh), "{queues:?}, {indicator:?}");
        drop((surface, pipeline, input, device));
        assert_eq!(log.messages(), [""; 0], "{queues:?}, {indicator:?}");
    }
}

#[test]
fn a_second_resident_frame_fits_if_the_first_does() {
    let steps = || (-22..22).map(|i| f64::from(i) + 0.5);
    let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
    let particles: Vec<[f64; 3]> =
        lattice.filter(|p| p.iter().map(|c| c * c).sum::<f64>() < 484.0).collect();
    let mut fitting = 0;
    for indicator in [IndicatorKind::Symmetry, IndicatorKind::Cloud] {
        let sampling = Sampling { method: indicator.into(), spacing: Some(1.0), ..sampling() };
        let settings = settings(&sampling, &surfacing());
        for memory in (8..40).map(|step| step << 18) {
            let options = DeviceOptions {
                memory: Some(memory),
                shares_host_memory: Some(false),
                ..DeviceOptions::default()
            };
            let Some((device, _)) = device::open(&options).map_err(device::skip).ok() else {
                return;
            };
            let Ok(pipeline) = Pipeline::new(&device) else { continue };
            let Ok(view) = device.uploaded(particles.as_flattened()) else { continue };
            let input =
                [DevicePositions { view, count: particles.len(), coordinate: Coordinate::Double }];
            let frames = [0, 1]
                .map(|_| pipeline.surface(&input, &settings).map(|surface| surface.triangles));
            if frames[0].is_ok() {
                fitting += 1;
                assert!(
                    frames.iter().all(Result::is_ok),
                    "{indicator:?}, {memory} bytes: {frames:?}"
                );
            }
        }
    }
    assert!(fitting > 3, "only {fitting} budgets fit a frame");
}

#[test]
fn a_resident_frame_with_a_given_calibration_measures_nothing() {
    let options = DeviceOptions { shares_host_memory: Some(false), ..DeviceOptions::default() };
    let Some((device, _)) = device::open(&options).map_err(device::skip).ok() else { return };
    let particles = splashes(37);
    let input = [positions(&device, &particles)];
    let pipeline = Pipeline::new(&device).unwrap();
    for indicator in INDICATORS {
        let sampling =
            Sampling { method: indicator.into(), spacing: Some(spacing(indicator)), ..sampling() };
        let settings = settings(&sampling, &surfacing());
        let received = |settings: &DeviceRequest| {
            let before = device.counters().received;
            let surface = pipeline.surface(&input, settings).unwrap();
            (device.counters().received - before, surface)
        };
        let (with_measuring, first) = received(&settings);
        let known = DeviceRequest { calibration: Some(first.calibration), ..settings.clone() };
        let (without, second) = received(&known);
        assert!(first.measured.is_some() && second.measured.is_none(), "{indicator:?}");
        assert!(without < with_measuring / 2, "{indicator:?}: {without} bytes of {with_measuring}");
        assert!(read(&device, &first) == read(&device, &second), "{indicator:?}");
        let other = match indicator {
            IndicatorKind::Cloud => IndicatorKind::Counting,
            _ => IndicatorKind::Cloud,
        };
        let refused = pipeline.surface(&input, &DeviceRequest { indicator: other, ..known });
        assert!(matches!(refused, Err(FrameError::OtherIndicator)), "{indicator:?}: {refused:?}");
    }
}

#[test]
fn a_resident_frame_of_many_bins_has_the_calibration_of_the_cpu() {
    let Some((device, _)) = open() else { return };
    // The drops have different numbers of particles, so that the mean over a subset of the bins
    // differs from mu0.
    let mut random = Random::new(23);
    let mut particles: Vec<[f64; 3]> = Vec::new();
    for drop in 0..300 {
        let centre = [(); 3].map(|()| 300.0 * random.unit());
        let place = |random: &mut Random| centre.map(|c| c + 4.0 * random.unit());
        particles.extend(std::iter::repeat_with(|| place(&mut random)).take(20 + drop));
    }
    let pipeline = Pipeline::new(&device).unwrap();
    for indicator in [IndicatorKind::Counting, IndicatorKind::Cloud] {
        let sampling = Sampling { method: indicator.into(), ..sampling() };
        let (frame, expected) = reconstruct(&particles[..], &sampling, &surfacing());
        assert!(dif(&frame).dif.infos().len() > 300, "{indicator:?}: too few bins for a sample");
        let input = [positions(&device, &particles)];
        let surface = pipeline.surface(&input, &settings(&sampling, &surfacing())).unwrap();
        assert!(read(&device, &surface) == rounded(&expected.mesh), "{indicator:?}");
    }
}

#[test]
fn shaders_that_check_every_index_give_the_same_mesh() {
    let options =
        DeviceOptions { binaries: compile::checked().unwrap(), ..DeviceOptions::default() };
    let Some((device, log)) = device::open(&options).map_err(device::skip).ok() else { return };
    let particles = splashes(31);
    for indicator in INDICATORS {
        let sampling = Sampling { method: indicator.into(), ..sampling() };
        let (_, expected) = reconstruct(&particles[..], &sampling, &surfacing());
        let pipeline = Pipeline::new(&device).unwrap();
        let input = [positions(&device, &particles)];
        let surface = pipeline.surface(&input, &settings(&sampling, &surfacing())).unwrap();
        assert!(read(&device, &surface) == rounded(&expected.mesh), "{indicator:?}");
    }
    drop(device);
    assert_eq!(log.messages(), [""; 0]);
}

/// Opens a device with optional features. Returns `None`, and reports the test as skipped, if no
/// device can be opened with these features.
fn open_with(options: &DeviceOptions) -> Option<(Device, ValidationLog)> {
    match device::open(options) {
        Err(VulkanError::Unsuitable { device, lacks }) => {
            device::skip(format!("{device}: {lacks}"))
        }
        Err(why) => device::skip(why),
        Ok(opened) => return Some(opened),
    }
    None
}

#[test]
#[cfg(unix)]
fn another_device_reads_the_surface_from_exported_memory() {
    let options = DeviceOptions { exports: true, addresses: true, ..DeviceOptions::default() };
    let (Some((device, log)), Some((other, other_log))) =
        (open_with(&options), open_with(&options))
    else {
        return;
    };
    assert_eq!(device.uuid(), other.uuid());
    let particles = splashes(47);
    let (_, expected) = reconstruct(&particles[..], &sampling(), &surfacing());
    let pipeline = Pipeline::new(&device).unwrap();
    let input = [positions(&device, &particles)];
    let settings = settings(&sampling(), &surfacing());
    let between = |exchange: &Exchange<'_>| {
        // SAFETY: the exchange has no semaphores, which are the only unsafe part.
        unsafe { pipeline.surface_between(&input, &settings, exchange) }
    };
    let small = [1, 2].map(|_| device.buffer(BufferKind::Device, 4).unwrap().whole());
    let refused = between(&Exchange { into: Some(small.each_ref()), ..Exchange::default() });
    let Err(FrameError::NoSpace { vertices, triangles }) = refused else { panic!("{refused:?}") };
    let rows = [vertices, triangles].map(|rows| 12 * u64::from(rows));
    let exported = rows.map(|bytes| device.exported_buffer(bytes).unwrap());
    let into = exported.each_ref().map(|buffer| buffer.whole());
    let mut surface =
        between(&Exchange { into: Some(into.each_ref()), ..Exchange::default() }).unwrap();
    surface.wait().unwrap();
    let address = surface.positions.address().unwrap();
    assert!(address != 0 && surface.indices.address().unwrap() != address);
    let imported = [0, 1].map(|i: usize| {
        let memory = exported[i].export().unwrap();
        other.imported_buffer(memory, rows[i]).unwrap().whole()
    });
    let mut batch = other.batch(Queue::Compute).unwrap();
    batch.begin().unwrap();
    let read = imported.each_ref().map(|view| {
        let read = other.buffer(BufferKind::Download, view.bytes()).unwrap().whole();
        batch.copy(view, &read);
        read
    });
    batch.submit(&[]).unwrap();
    batch.wait().unwrap();
    // SAFETY: the only batch that writes the buffers is done.
    let found =
        unsafe { (read[0].read(0, vertices as usize), read[1].read(0, triangles as usize)) };
    assert!(found == rounded(&expected.mesh));
    drop((surface, into, small, exported, pipeline, input, device));
    drop((imported, read, batch, other));
    assert_eq!(log.messages(), [""; 0]);
    assert_eq!(other_log.messages(), [""; 0]);
}

#[test]
fn later_resident_frames_use_no_more_memory_and_release_frees_it() {
    let Some((device, _)) = open() else { return };
    let pipeline = Pipeline::new(&device).unwrap();
    let before = device.allocated();
    let particles = splashes(43);
    let input = [positions(&device, &particles)];
    let input_bytes = device.allocated() - before;
    let taken = [0, 1, 2].map(|_| {
        drop(pipeline.surface(&input, &settings(&sampling(), &surfacing())).unwrap());
        device.allocated()
    });
    assert!(taken[0] > before + input_bytes, "the pipeline keeps no memory: {taken:?}");
    assert_eq!(taken, [taken[0]; 3]);
    pipeline.release();
    assert_eq!(device.allocated(), before + input_bytes);
}

#[test]
fn the_resident_example_makes_the_mesh_of_the_cpu_on_its_own_device() {
    let number = match device::chosen() {
        Ok((_, info)) => info.index,
        Err(why) => return device::skip(why),
    };
    let particles: Vec<[f32; 3]> = splashes(37).iter().map(|p| p.map(|x| x as f32)).collect();
    // The example `resident` uses a spacing of one cell.
    let sampling = Sampling { spacing: Some(1.0), ..sampling() };
    let (_, expected) = reconstruct(&particles[..], &sampling, &surfacing());
    assert!(example::surface_of(number, &particles, 1.0).unwrap() == rounded(&expected.mesh));
    assert!(example::surface_of(99, &particles, 1.0).is_err(), "a missing device is accepted");
}

#[test]
fn invalid_resident_frames_fail_with_a_reason_and_free_their_memory() {
    let Some((device, _)) = open() else { return };
    let pipeline = Pipeline::new(&device).unwrap();
    let kept = device.allocated();
    let scene = settings(&sampling(), &surfacing());
    let surface = |particles: &[[f64; 3]], settings: &DeviceRequest| {
        pipeline.surface(&[positions(&device, particles)], settings).unwrap_err()
    };
    assert!(matches!(surface(&[], &scene), FrameError::NoParticles(_)));
    assert!(matches!(surface(&[[f64::NAN; 3]], &scene), FrameError::Bin(_)));
    let iso = Some(Isovalue::new(0.9).unwrap());
    let above = DeviceRequest { surfacing: Surfacing { iso, ..surfacing() }, ..scene };
    assert!(matches!(surface(&[[0.0; 3]], &above), FrameError::NoSurface { .. }));
    // A drop that is far smaller than a cell lies between the cell centres, so it has no surface.
    let dust = DeviceRequest { indicator: IndicatorKind::Cloud, spacing: Some(0.05), ..scene };
    assert!(matches!(surface(&[[0.0; 3]], &dust), FrameError::NoDistanceSurface { .. }));
    let fine = DeviceRequest { spacing: Some(11.0), ..dust };
    assert!(matches!(surface(&[[0.0; 3]], &fine), FrameError::TooFine(_)));
    pipeline.release();
    assert_eq!(device.allocated(), kept);
}

#[test]
fn any_failed_resident_allocation_is_an_error_or_harmless_without_leaks() {
    let particles = splashes(41);
    let (_, expected) = reconstruct(&particles[..], &sampling(), &surfacing());
    let Some((device, log)) = open() else { return };
    let pipeline = Pipeline::new(&device).unwrap();
    let input = [positions(&device, &particles)];
    let kept = device.allocated();
    let mut failures = 0;
    for number in 1.. {
        device.faults().allocation.store(number, std::sync::atomic::Ordering::Relaxed);
        let outcome = pipeline.surface(&input, &settings(&sampling(), &surfacing()));
        let fault_reached =
            device.faults().allocation.swap(0, std::sync::atomic::Ordering::Relaxed) == 0;
        match outcome {
            Ok(surface) => {
                assert!(read(&device, &surface) == rounded(&expected.mesh), "number {number}")
            }
            Err(FrameError::Vulkan(VulkanError::OutOfMemory { .. })) => failures += 1,
            Err(other) => panic!("number {number}: {other}"),
        }
        pipeline.release();
        assert_eq!(device.allocated(), kept, "number {number}");
        if !fault_reached {
            break;
        }
    }
    assert!(failures > 3, "{failures} failures");
    drop((pipeline, input, device));
    assert_eq!(log.messages(), [""; 0]);
}
