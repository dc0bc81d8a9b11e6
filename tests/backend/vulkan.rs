//! Tests of the Vulkan backend with validation: stages and frames equal the CPU's, even with little
//! memory and after failures.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::IVec3;
use meniscus::internals::backend::{Backend, Cpu, Executor, Surfaces, Work};
use meniscus::internals::brick::vulkan::{DeviceBlock, DeviceBlocks};
use meniscus::internals::brick::{
    BinPlan, Block, BrickSide, CountingRoom, DifField, InvalidParticles,
};
use meniscus::internals::field::blur::{self, Weights};
use meniscus::internals::field::indicator::{CloudWalls, IndicatorKind, PageRule};
use meniscus::internals::field::recipe::{PaperFilters, Recipe};
use meniscus::internals::frame::{Detail, Engine, Normals, Resources, Sampling, Surfacing};
use meniscus::internals::grid::units::{Isovalue, MemoryBudget, Sigma, Smooth};
use meniscus::internals::grid::{BIN, CellBox, Domain, Grid, Mirror, PeriodicMesh};
use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::input::open_particles;
use meniscus::internals::shaders::{BLUR, SHADERS};
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::system::control::{Control, Stage};
use meniscus::internals::system::timings::Timings;
use meniscus::internals::vulkan::{
    BufferKind, Device, DeviceChoice, DeviceOptions, Faults, Instance, Queue, Queues,
    ValidationLog, VulkanError,
};

use crate::common::device::{self, contoured, watched};
use crate::common::scene::Random;
use crate::common::{
    INDICATORS, Reconstructed, dif, full_cells, reconstruct, sampled, sampling, splashes,
    surfacing, tank,
};
use crate::compile;

const DETAILS: [Detail; 2] = [Detail::Smoothed, Detail::Recovered];

/// Runs a test on a new device, and checks the validation log after all objects are freed. Skips
/// the test if there is no device.
fn validated<T>(test: impl FnOnce(&Device) -> T) -> Option<T> {
    validated_with(&DeviceOptions::default(), test)
}

fn validated_with<T>(options: &DeviceOptions, test: impl FnOnce(&Device) -> T) -> Option<T> {
    let (device, log) = device::open(options).map_err(device::skip).ok()?;
    let outcome = test(&device);
    assert_eq!(device.allocated(), 0, "some buffers are not freed");
    drop(device);
    assert_clean(&log);
    Some(outcome)
}

fn assert_clean(log: &ValidationLog) {
    assert_eq!(log.messages(), [""; 0]);
}

fn random_block(cells: CellBox, seed: u64) -> Block {
    let mut random = Random::new(seed);
    let mut block = Block::zero(cells);
    block.samples_mut().iter_mut().for_each(|sample| *sample = random.bits() as u16);
    block
}

#[test]
fn blurring_on_the_device_matches_the_cpu_for_every_reach_and_wall() {
    validated(|device| {
        let pipeline = Arc::new(device.pipeline(&BLUR).unwrap());
        for (seed, sigma) in (0..).zip([0.5, 0.9, 1.2, 1.6, 2.0, 3.3, 10.0]) {
            let weights = Weights::gaussian(Sigma::new(sigma).unwrap());
            let reach = weights.reach();
            let inner = CellBox { lo: IVec3::new(-5, 3, -20), hi: IVec3::new(6, 12, -13) };
            let dif = random_block(inner.grown(reach, reach), seed);
            let faces = Mirror::new(CellBox { lo: inner.lo + 2, hi: inner.hi + 1 });
            let twice = CellBox { lo: 2 * inner.lo + 3, hi: 2 * inner.hi - 1 };
            let middles = Mirror::new(twice).in_wider_cells(1);
            for mirror in [None, Some(faces), Some(middles)] {
                let mut mirrored = dif.clone();
                mirrored.mirror(mirror);
                let expected = blur::blur(mirrored, &weights, None);
                let (block, samples) = blurred_on(device, &pipeline, &dif, &weights, mirror);
                let inside = mirror.map_or(inner, |mirror| inner.intersection(&mirror.cells()));
                for ([y, z], row) in expected.rows(inside) {
                    for (x, &sample) in (inside.lo.x..).zip(row) {
                        let at = IVec3::new(x, y, z) - IVec3::from(block.lo);
                        let [width, height, _] = block.size.map(|n| n as i32);
                        let found = samples[(at.x + width * (at.y + height * at.z)) as usize];
                        assert_eq!(found, sample, "sigma {sigma}, {mirror:?}, cell {x} {y} {z}");
                    }
                }
            }
        }
    });
}

/// Blurs a block on the device. Returns the block and its samples.
fn blurred_on(
    device: &Device,
    pipeline: &Arc<meniscus::internals::vulkan::ComputePipeline>,
    dif: &Block,
    weights: &Weights,
    mirror: Option<Mirror>,
) -> (DeviceBlock, Vec<u16>) {
    let block = DeviceBlock::new(dif.cells(), CellBox { lo: IVec3::ZERO, hi: IVec3::ZERO });
    let mut padded = Block::<u16>::zero(block.cells());
    for ([y, z], row) in dif.rows(dif.cells()) {
        let to = padded.index(IVec3::new(dif.cells().lo.x, y, z));
        padded.samples_mut()[to..to + row.len()].copy_from_slice(row);
    }
    let field = device.uploaded(padded.samples()).unwrap();
    let uploaded = device.uploaded(weights.half()).unwrap();
    let through = device.buffer(BufferKind::Device, field.bytes()).unwrap().whole();
    let to = device.buffer(BufferKind::Download, field.bytes()).unwrap().whole();
    let blocks = DeviceBlocks::new(device.uploaded(&[block]).unwrap(), &[block]);
    let mut batch = device.batch(Queue::Compute).unwrap();
    batch.begin().unwrap();
    let views = [&field, &through, &to];
    blur::vulkan::blur(&mut batch, pipeline, &blocks, (weights, &uploaded), mirror, 0, views)
        .unwrap();
    batch.submit(&[]).unwrap();
    batch.wait().unwrap();
    // SAFETY: the only batch that writes the buffer is done.
    (block, unsafe { to.read(0, padded.samples().len()) })
}

#[test]
fn validation_reports_a_missing_barrier() {
    if !device::chosen().is_ok_and(|(instance, _)| instance.sees_shaders()) {
        return;
    }
    let Ok((device, log)) = device::open(&DeviceOptions::default()).map_err(device::skip) else {
        return;
    };
    let pipeline = Arc::new(device.pipeline(&BLUR).unwrap());
    let weights = Weights::gaussian(Sigma::new(1.0).unwrap());
    // Remove a barrier, so that the blur along the second axis does not wait for the first axis.
    device.faults().barrier.store(2, Ordering::Relaxed);
    blurred_on(
        &device,
        &pipeline,
        &random_block(CellBox::cube(IVec3::ZERO, 16), 1),
        &weights,
        None,
    );
    let messages = log.messages();
    assert!(
        messages.iter().any(|message| message.to_lowercase().contains("hazard")),
        "{messages:?}"
    );
}

/// Particles at cell corners and elsewhere, with one, two or very many particles per cell.
fn crowds() -> Vec<[f64; 3]> {
    let mut random = Random::new(5);
    let mut particles = splashes(5);
    particles.extend(std::iter::repeat_n([3.999_999, 3.0, 3.5], 600_000));
    particles.extend((0..300_000).map(|_| [9.0 + random.unit(), 3.0 + random.unit(), 5.999_99]));
    particles.extend((0..70_000).map(|_| std::array::from_fn(|_| -17.0 + random.unit())));
    particles
}

/// Compares the pages of [`crowds`] on a device and on the CPU, for every rule. Returns the work
/// that the device did for each rule, and the total work of one rule.
fn compare_pages_on(device: &Backend, budget: MemoryBudget) -> (Vec<Work>, Work) {
    let particles = crowds();
    let grid = Grid::new(glam::DVec3::ZERO, 1.0).unwrap();
    let plan =
        BinPlan::count(&particles, &grid, None, InvalidParticles::Refuse, CountingRoom::BINS)
            .unwrap();
    let bins = plan.fill(&particles, &[]).unwrap();
    let all = 0..bins.keys().len();
    let mut made = Vec::new();
    for indicator in INDICATORS {
        for side in [BrickSide::Four, BrickSide::Eight, BrickSide::Sixteen] {
            let frame = device.executor().start(budget);
            let mean = particles.len() as f64 / full_cells(&bins) as f64;
            let rule = PageRule {
                indicator,
                spacing_cells: mean.cbrt().recip(),
                side,
                walls: Some(CloudWalls {
                    cells: CellBox::cube(IVec3::ZERO, 9),
                    gains: [[7000, 4096, 3000], [4096, 2800, 8192]],
                }),
            };
            let (control, parts) = (Control::default(), all.len());
            let meter = control.meter(Stage::Sampling, parts);
            let pages = frame.indicate(&bins, all.clone(), &rule, &meter).unwrap();
            let expected = Cpu.start(budget).indicate(&bins, all.clone(), &rule, &meter).unwrap();
            let [pages, expected] = [&pages, &expected].map(|pages| {
                let all = pages
                    .iter()
                    .map(|(info, samples)| (info, samples.dense(rule.shape()), samples.bytes()));
                all.collect::<Vec<_>>()
            });
            assert!(pages == expected, "{rule:?} under {budget:?}");
            assert_eq!(frame.warnings(), [""; 0]);
            made.push(frame.on_device());
        }
    }
    (made, Work { pages: all.len(), regions: 0 })
}

#[test]
fn the_device_makes_the_pages_of_crowded_cells_like_the_cpu() {
    validated(|device| {
        compare_pages_on(&watched(device.clone()).unwrap(), MemoryBudget(1 << 30));
    });
}

#[test]
fn only_the_page_of_a_bin_too_large_for_a_batch_is_made_on_the_cpu() {
    validated(|device| {
        // A batch may use at most 8 MiB, but the dense bin needs 14 MiB.
        let vulkan = Backend::vulkan(device.clone()).unwrap();
        let (made, all) = compare_pages_on(&vulkan, MemoryBudget(64 << 20));
        assert_eq!(made, [Work { pages: all.pages - 1, ..all }; 9]);
    });
}

/// Compares all methods and indicators on the CPU and on a device.
fn assert_same_surfaces(
    vulkan: &Backend,
    particles: &[[f64; 3]],
    budget: MemoryBudget,
    what: &str,
) {
    for indicator in INDICATORS {
        for walls in [false, true] {
            let mut sampling = Sampling { method: indicator.into(), ..sampling() };
            sampling.domain = walls.then(|| tank(&sampling.grid));
            for (detail, sigma, smooth, spacing) in
                [(DETAILS[0], 1.0, 1.6, 1.0), (DETAILS[1], 1.5, 2.5, 3.0)]
            {
                sampling.spacing = (indicator == IndicatorKind::Cloud).then_some(spacing);
                let (sigma, smooth) = (Sigma::new(sigma).ok(), Smooth::new(smooth).unwrap());
                let surfacing =
                    Surfacing { smooth, detail, sigma, normals: Normals::Gradient, ..surfacing() };
                let (_, expected) = reconstruct(particles, &sampling, &surfacing);
                let mut resources = Resources::new(budget, std::env::temp_dir());
                resources.backend = vulkan.clone();
                let sampling = Sampling { resources, ..sampling.clone() };
                let (_, surface) = reconstruct(particles, &sampling, &surfacing);
                assert!(
                    surface.mesh == expected.mesh,
                    "{what}: {indicator:?}, {detail:?}, walls {walls}"
                );
            }
        }
    }
}

#[test]
fn the_device_makes_the_mesh_of_the_cpu_in_one_batch_and_in_many() {
    let particles = splashes(23);
    validated(|device| {
        let vulkan = watched(device.clone()).unwrap();
        assert_same_surfaces(&vulkan, &particles, MemoryBudget(8 << 30), "in one batch");
        // The device gets a quarter of the budget, and batches get half of this quarter: 4 MiB.
        assert_same_surfaces(&vulkan, &particles, MemoryBudget(32 << 20), "in many batches");
    });
}

/// Checks that two fields have equal pages and equal cell counts.
fn assert_same_fields(one: &DifField, other: &DifField, what: &str) {
    assert_eq!(one.infos(), other.infos(), "{what}");
    for (page, info) in one.infos().iter().enumerate() {
        assert!(one.stored(page) == other.stored(page), "{what}: {info:?}");
        let around = CellBox::cube(info.key.coord(), BIN).grown(2, 2);
        assert!(one.gather(around) == other.gather(around), "{what}: {info:?}");
    }
}

#[test]
fn a_resident_field_with_its_wide_and_inside_cells_matches_the_cpu() {
    // Fluid that is deep enough for an interior, in all octants around the origin, and spray.
    let mut random = Random::new(11);
    let mut particles: Vec<[f64; 3]> = Vec::new();
    for at in
        CellBox::cube(IVec3::splat(-1), 24).cubes(1).chain(CellBox::cube(IVec3::ZERO, 6).cubes(1))
    {
        particles.push(at.to_array().map(|at| f64::from(at) + 0.5 * random.unit()));
    }
    particles.extend((0..400).map(|_| std::array::from_fn(|_| 90.0 * random.unit() - 50.0)));
    let own = DeviceOptions { shares_host_memory: Some(false), ..DeviceOptions::default() };
    validated_with(&own, |device| {
        for (indicator, side) in INDICATORS.iter().flat_map(|&indicator| {
            [BrickSide::Four, BrickSide::Eight, BrickSide::Sixteen].map(|side| (indicator, side))
        }) {
            let cells = [(0.3, true), (0.3, false), (0.6, false), (1.1, true)];
            // The paper's indicators need cells wide enough to contain about one particle each.
            let cells = if indicator == IndicatorKind::Cloud { &cells[..] } else { &cells[3..] };
            for &(cell_size, walls) in cells {
                let grid = Grid::new(glam::DVec3::splat(0.1), cell_size).unwrap();
                let mut known = Sampling { grid, method: indicator.into(), side, ..sampling() };
                known.spacing = Some(1.0);
                known.domain = walls.then(|| {
                    Domain::new(&grid, [-30.0, -9.7, -20.0].into(), [21.0; 3].into()).unwrap()
                });
                let what = format!("{indicator:?}, {side:?}, cells of {cell_size}, walls {walls}");
                let surfacing = surfacing();
                let (expected, _) = reconstruct(&particles[..], &known, &surfacing);
                known.resources.backend = watched(device.clone()).unwrap();
                let frame = Engine::sample(&particles, &known, &mut Timings::default()).unwrap();
                let [made, expected] = [&frame, &expected].map(dif);
                assert!(made.dif.remote().is_some(), "{what}: the field is not resident");
                let calibration = surfacing.calibrate(expected).unwrap().calibration;
                if made.is_clouds() {
                    for level in 1..=made.wide_cells().level {
                        assert!(
                            made.wide(level).remote().is_some(),
                            "{what}: level {level} is not resident"
                        );
                        assert_same_fields(
                            made.wide(level),
                            expected.wide(level),
                            &format!("{what}: {level}"),
                        );
                    }
                }
                let [recipe, known] =
                    [made, expected].map(|dif| surfacing.recipe(dif, &calibration));
                assert!(recipe == known, "{what}: the inside differs");
                assert_eq!(surfacing.calibrate(made).unwrap().calibration, calibration, "{what}");
                assert_same_fields(&made.dif, &expected.dif, &what);
                assert_eq!(frame.warnings(), [""; 0], "{what}");
            }
        }
    });
}

#[test]
fn a_resident_field_is_recomputed_on_the_cpu_if_it_cannot_be_read() {
    let particles = splashes(31);
    let mut sampling = sampling();
    (sampling.method, sampling.spacing) = (IndicatorKind::Cloud.into(), Some(2.0));
    let (expected, _) = reconstruct(&particles[..], &sampling, &surfacing());
    let own = DeviceOptions { shares_host_memory: Some(false), ..DeviceOptions::default() };
    validated_with(&own, |device| {
        let mut sampling = sampling.clone();
        sampling.resources.backend = Backend::vulkan(device.clone()).unwrap();
        let frame = Engine::sample(&particles, &sampling, &mut Timings::default()).unwrap();
        assert!(dif(&frame).dif.remote().is_some());
        device.faults().submission.store(1, Ordering::Relaxed);
        assert_same_fields(&dif(&frame).dif, &dif(&expected).dif, "after a loss");
        let [made, expected] = [&frame, &expected].map(dif);
        assert_same_fields(made.wide(1), expected.wide(1), "after a loss");
        let warnings = frame.warnings();
        assert!(
            !warnings.is_empty() && warnings.iter().all(|warning| warning.ends_with("on the CPU")),
            "{warnings:?}"
        );
    });
}

#[test]
fn a_resident_field_transfers_less_data_than_a_downloaded_field() {
    let particles = splashes(29);
    let mut sampling = sampling();
    (sampling.method, sampling.spacing) = (IndicatorKind::Cloud.into(), Some(2.0));
    let received = |own: bool| {
        let options = DeviceOptions { shares_host_memory: Some(!own), ..DeviceOptions::default() };
        validated_with(&options, |device| {
            let mut sampling = sampling.clone();
            sampling.resources.backend = watched(device.clone()).unwrap();
            let timings = &mut Timings::default();
            let frame = Engine::sample(&particles, &sampling, timings).unwrap();
            let known = surfacing().calibrate(dif(&frame)).unwrap().calibration;
            drop(frame);
            let before = device.counters();
            let frame = Engine::sample(&particles, &sampling, timings).unwrap();
            let surface = frame
                .calibrate(&surfacing(), Some(&known), timings)
                .unwrap()
                .surface(timings)
                .unwrap();
            let after = device.counters();
            (after.received - before.received, after.sent - before.sent, surface.to_mesh().unwrap())
        })
    };
    let (Some((all, all_sent, there)), Some((some, sent, here))) =
        (received(false), received(true))
    else {
        return;
    };
    assert!(there == here);
    let pages =
        (sampling.method.indicator().unwrap().shape(sampling.side).bin_samples() * 2) as u64;
    assert!(some + 8 * pages < all, "{some} bytes of {all}");
    assert!(sent < all_sent, "{sent} bytes of {all_sent}");
}

#[test]
fn shaders_that_check_every_index_give_the_same_bytes() {
    let particles = splashes(23);
    let binaries = compile::checked().unwrap();
    let differ = SHADERS.iter().filter(|shader| binaries[shader.name] != shader.code).count();
    assert!(differ > SHADERS.len() / 2, "only {differ} shaders have index checks");
    let options =
        DeviceOptions { binaries, shares_host_memory: Some(false), ..DeviceOptions::default() };
    validated_with(&options, |device| {
        let vulkan = watched(device.clone()).unwrap();
        assert_same_surfaces(&vulkan, &particles, MemoryBudget(32 << 20), "with checks");
    });
}

#[test]
fn batches_without_a_surface_do_not_change_other_batches() {
    // The ball is so large that one block has no surface. With a tiny budget, this block is a batch
    // of its own.
    let lattice =
        CellBox::cube(IVec3::splat(-1), 9).union(&CellBox::cube(IVec3::ZERO, 10)).cubes(1);
    let ball = lattice.filter(|at| at.as_dvec3().length() <= 9.0);
    let particles: Vec<[f64; 3]> = ball.map(|at| (at.as_dvec3() + 11.1).to_array()).collect();
    let mut sampling = sampling();
    sampling.grid = Grid::new(glam::DVec3::ZERO, 0.5).unwrap();
    (sampling.method, sampling.spacing) = (IndicatorKind::Cloud.into(), Some(1.0));
    let (_, expected) = reconstruct(&particles[..], &sampling, &surfacing());
    for shares_host_memory in [Some(true), Some(false)] {
        validated_with(
            &DeviceOptions { shares_host_memory, ..DeviceOptions::default() },
            |device| {
                for budget in [12, 16, 24, 32, 48, 64, 128] {
                    let mut sampling = sampling.clone();
                    sampling.resources =
                        Resources::new(MemoryBudget(budget << 20), std::env::temp_dir());
                    sampling.resources.backend = Backend::vulkan(device.clone()).unwrap();
                    let (_, surface) = reconstruct(&particles[..], &sampling, &surfacing());
                    assert!(surface.mesh == expected.mesh, "{budget} MiB, {shares_host_memory:?}");
                }
            },
        );
    }
}

#[test]
fn a_drop_at_a_wall_has_the_same_normals_on_the_device_and_the_cpu() {
    let particles = [[9.08165, -8.98358, 17.7202], [8.34095, 5.02534, 10.917]];
    let mut sampling = sampling();
    sampling.grid = Grid::new(glam::DVec3::ZERO, 0.5).unwrap();
    (sampling.method, sampling.spacing) = (IndicatorKind::Cloud.into(), Some(0.5));
    let corners =
        [[-5.49096, -19.6614, -9.54228], [16.9536, 23.555, 18.2697]].map(glam::DVec3::from);
    sampling.domain = Some(Domain::new(&sampling.grid, corners[0], corners[1]).unwrap());
    let surfacing = Surfacing { normals: Normals::Gradient, ..surfacing() };
    let (_, expected) = reconstruct(&particles[..], &sampling, &surfacing);
    validated(|device| {
        let mut sampling = sampling.clone();
        sampling.resources.backend = watched(device.clone()).unwrap();
        let (_, surface) = reconstruct(&particles[..], &sampling, &surfacing);
        assert!(surface.mesh == expected.mesh);
    });
}

#[test]
fn later_frames_allocate_no_buffers() {
    let particles = splashes(23);
    validated(|device| {
        let mut sampling = sampling();
        sampling.resources.backend = watched(device.clone()).unwrap();
        let made = [0, 1, 2].map(|_| {
            let before = device.counters().allocations;
            reconstruct(&particles[..], &sampling, &surfacing());
            device.counters().allocations - before
        });
        assert!(made[0] > 10, "{made:?}");
        assert_eq!(made[1..], [0, 0]);
    });
}

#[test]
fn the_mesh_is_independent_of_queues_and_memory_type() {
    let particles = splashes(23);
    for queues in [Queues::One, Queues::OneAsTwo] {
        for shares_host_memory in [Some(false), Some(true)] {
            let options = DeviceOptions { queues, shares_host_memory, ..DeviceOptions::default() };
            validated_with(&options, |device| {
                assert_eq!(device.shares_host_memory(), shares_host_memory == Some(true));
                let vulkan = watched(device.clone()).unwrap();
                let what = format!("{queues:?}, {shares_host_memory:?}");
                assert_same_surfaces(&vulkan, &particles, MemoryBudget(32 << 20), &what);
            });
        }
    }
}

#[test]
fn a_lost_device_keeps_reporting_its_loss() {
    let Some((device, _)) = device::open(&DeviceOptions::default()).map_err(device::skip).ok()
    else {
        return;
    };
    let mut batch = device.batch(Queue::Compute).unwrap();
    batch.begin().unwrap();
    device.faults().submission.store(1, Ordering::Relaxed);
    assert_eq!(batch.submit(&[]), Err(VulkanError::Lost));
    for _ in 0..2 {
        assert_eq!(device.buffer(BufferKind::Device, 4).unwrap_err(), VulkanError::Lost);
        assert_eq!(batch.submit(&[]), Err(VulkanError::Lost));
    }
}

#[test]
fn a_device_can_be_chosen_by_number_uuid_or_name() {
    let instance = match Instance::connect(false) {
        Ok(instance) => instance,
        Err(why) => return device::skip(why),
    };
    let devices = instance.devices().unwrap();
    let Some(device) = devices.first() else { return device::skip("no device") };
    let chosen =
        |by: &str| instance.choose(&DeviceChoice::Named(by.to_owned())).map(|found| found.index);
    assert_eq!(chosen("0"), Ok(0));
    assert_eq!(chosen(&device.uuid_digits()), Ok(0));
    assert_eq!(chosen(&device.uuid_digits().to_uppercase()), Ok(0));
    let numbers = device.name.split(|c: char| !c.is_ascii_digit());
    let numbers: Vec<&str> = numbers
        .filter(|text| text.parse().is_ok_and(|number: usize| number >= devices.len()))
        .collect();
    for number in numbers {
        assert_eq!(chosen(number), Ok(0), "{number} of {}", device.name);
    }
    assert!(matches!(chosen("987654321"), Err(VulkanError::NotFound { .. })));
}

#[test]
fn bundled_frames_have_the_same_mesh_on_the_device_and_the_cpu() {
    let data = crate::common::files::data("");
    validated(|device| {
        let vulkan = watched(device.clone()).unwrap();
        for (file, spacing) in [
            ("dambreak_small/ParticleData_Fluid_20.bgeo", 0.05),
            ("dualsphysics_dambreak/Part_0005.bi4", 0.02),
        ] {
            let scratch = std::env::temp_dir();
            let unpacking = Unpacking { in_memory: u64::MAX, scratch: &scratch, control: None };
            let particles = open_particles(&data.join(file), unpacking).unwrap().particles;
            for (indicator, detail) in
                INDICATORS.iter().flat_map(|&indicator| DETAILS.map(|detail| (indicator, detail)))
            {
                for cell in [spacing, spacing / 2.0] {
                    let grid = Grid::new(glam::DVec3::ZERO, cell).unwrap();
                    let mut sampling = Sampling { method: indicator.into(), grid, ..sampling() };
                    sampling.spacing = (indicator == IndicatorKind::Cloud).then_some(spacing);
                    let surfacing = Surfacing { detail, normals: Normals::Gradient, ..surfacing() };
                    let (_, expected) = reconstruct(&particles, &sampling, &surfacing);
                    sampling.resources.backend = vulkan.clone();
                    let (_, surface) = reconstruct(&particles, &sampling, &surfacing);
                    let what = format!("{file}, {indicator:?}, {detail:?}, cells of {cell}");
                    assert!(surface.mesh == expected.mesh, "{what}");
                }
            }
        }
    });
}

#[test]
fn batches_with_too_many_vertices_are_emitted_again() {
    // Use white noise, which has a vertex on nearly every second edge, far more than in a fluid.
    let cells = CellBox { lo: IVec3::splat(-32), hi: IVec3::splat(64) };
    let mut random = Random::new(3);
    let pages = cells.cubes(16).map(|bin| {
        let dense: Vec<u16> = (0..4096).map(|_| random.bits() as u16 | 1).collect();
        meniscus::internals::brick::PageInfo::from_dense(bin, &dense, BrickSide::Sixteen.into())
            .unwrap()
    });
    let mut pages: Vec<_> = pages.collect();
    pages.sort_unstable_by_key(|(info, _)| info.key);
    let dif = DifField::in_memory(BrickSide::Sixteen.into(), pages);
    let filters =
        PaperFilters::new(IndicatorKind::Symmetry, Sigma::new(0.2).unwrap(), Detail::Smoothed);
    let recipe = Recipe::of_paper(filters, Isovalue::new(0.5).unwrap());
    let surfaces = Surfaces {
        sampled: &sampled(dif),
        recipe: &recipe,
        solid: None,
        normals: Normals::None,
        periodic_mesh: PeriodicMesh::Cut,
    };
    let regions = surfaces.regions();
    let budget = MemoryBudget(8 << 30);
    let expected = contoured(&*Cpu.start(budget), &surfaces, &regions);
    let vertices: usize = expected.iter().flatten().map(|mesh| mesh.ends.len()).sum();
    assert!(vertices > 6144 * regions.len(), "{vertices} in {} blocks", regions.len());
    validated(|device| {
        let vulkan = watched(device.clone()).unwrap();
        // With a large budget, all regions are in one batch, which is meshed again. With a small
        // budget, several smaller batches are meshed again.
        for budget in [budget, MemoryBudget(96 << 20)] {
            let frame = vulkan.executor().start(budget);
            assert!(contoured(&*frame, &surfaces, &regions) == expected);
        }
    });
}

/// The result of a frame on a device.
struct Outcome {
    mesh: Mesh,
    warnings: Vec<String>,
    on_device: Work,
}

/// The scenes in which device calls are made to fail.
#[derive(Debug, Clone, Copy)]
enum Scene {
    /// An indicator of the paper, on a device that shares the host's memory.
    Shared,
    /// Clouds, on a device with its own memory.
    Own,
}

const SCENES: [Scene; 2] = [Scene::Shared, Scene::Own];

impl Scene {
    fn sampling(self) -> Sampling {
        match self {
            Self::Shared => sampling(),
            Self::Own => {
                Sampling { method: IndicatorKind::Cloud.into(), spacing: Some(2.0), ..sampling() }
            }
        }
    }

    fn options(self) -> DeviceOptions {
        let shares_host_memory = Some(matches!(self, Self::Shared));
        DeviceOptions { shares_host_memory, ..DeviceOptions::default() }
    }

    /// The expected mesh, computed on the CPU.
    fn mesh(self) -> Mesh {
        reconstruct(&splashes(29)[..], &self.sampling(), &surfacing()).1.mesh
    }

    fn frame_on(self, backend: Backend) -> Outcome {
        let mut sampling = self.sampling();
        sampling.resources.budget = MemoryBudget(64 << 20);
        sampling.resources.backend = backend;
        let (frame, Reconstructed { mesh, .. }) =
            reconstruct(&splashes(29)[..], &sampling, &surfacing());
        Outcome { mesh, warnings: frame.warnings(), on_device: frame.on_device() }
    }

    /// The work of a complete frame on the device, or `None` if there is no device.
    fn whole_work(self) -> Option<Work> {
        let run = |device: &Device| self.frame_on(watched(device.clone()).unwrap()).on_device;
        validated_with(&self.options(), run)
    }

    /// Runs a frame repeatedly: first the first call of a kind fails, then the second, and so on,
    /// until no call fails. Checks each time that the mesh is right and nothing leaks. Returns the
    /// outcomes.
    fn fail_each(self, fault: fn(&Faults) -> &AtomicU64) -> Vec<Outcome> {
        let expected = self.mesh();
        let mut failed = Vec::new();
        loop {
            let number = failed.len() as u64 + 1;
            let run = |device: &Device| {
                fault(device.faults()).store(number, Ordering::Relaxed);
                let outcome = self.frame_on(Backend::vulkan(device.clone()).unwrap());
                (outcome, fault(device.faults()).load(Ordering::Relaxed) == 0)
            };
            let Some((outcome, fault_reached)) = validated_with(&self.options(), run) else {
                return failed;
            };
            assert!(outcome.mesh == expected, "{self:?}: call {number} failed");
            if !fault_reached {
                assert_eq!(outcome.warnings, [""; 0], "{self:?}: a warning, but no fault");
                return failed;
            }
            failed.push(outcome);
        }
    }
}

#[test]
fn any_failed_allocation_leaves_the_right_mesh_and_leaks_no_memory() {
    for scene in SCENES {
        let Some(whole) = scene.whole_work() else { return };
        let failed = scene.fail_each(|faults| &faults.allocation);
        assert!(failed.len() > 10, "{scene:?}: {} calls", failed.len());
        let mut silent = 0;
        for (call, Outcome { warnings, on_device, .. }) in (1..).zip(failed) {
            assert!(warnings.len() <= 1, "{scene:?}, call {call}: {warnings:?}");
            silent += usize::from(warnings.is_empty());
            assert_eq!(
                on_device, whole,
                "{scene:?}, call {call}: the device did not continue with less memory"
            );
        }
        // A field's buffer is first allocated with headroom for later fields. If this allocation
        // fails, the device allocates the buffer without headroom, and gives no warning. The frames
        // of these scenes have at most two such buffers: one for the samples of the cells, and one
        // for the samples of the wide cells.
        assert!((1..=2).contains(&silent), "{scene:?}: {silent} without a warning");
    }
}

#[test]
fn losing_the_device_at_any_submission_falls_back_to_the_cpu() {
    for scene in SCENES {
        let Some(whole) = scene.whole_work() else { return };
        let failed = scene.fail_each(|faults| &faults.submission);
        assert!(failed.len() > 5, "{scene:?}: {} calls", failed.len());
        for (call, Outcome { warnings, on_device, .. }) in (1..).zip(failed) {
            assert!(
                warnings.len() == 1 && warnings[0].ends_with("continuing on the CPU"),
                "{scene:?}, call {call}: {warnings:?}"
            );
            assert_ne!(
                on_device, whole,
                "{scene:?}, call {call}: the lost device did all of the work"
            );
        }
    }
}

#[test]
fn work_falsely_reported_complete_leaves_the_right_mesh_and_no_leak() {
    for scene in SCENES {
        let Some(whole) = scene.whole_work() else { return };
        let failed = scene.fail_each(|faults| &faults.completion);
        for (call, Outcome { warnings, on_device, .. }) in (1..).zip(&failed) {
            assert_eq!(
                warnings.is_empty(),
                *on_device == whole,
                "{scene:?}, call {call}: {warnings:?}"
            );
        }
        // Each unit of work uploads, computes and downloads. A failed download gives a warning.
        let reported = failed.iter().filter(|outcome| !outcome.warnings.is_empty()).count();
        assert!(reported > failed.len() / 3, "{scene:?}: {reported} of {}", failed.len());
    }
}

#[test]
fn a_device_with_too_little_memory_falls_back_to_the_cpu() {
    for scene in SCENES {
        let Some(whole) = scene.whole_work() else { return };
        let expected = scene.mesh();
        for memory in [4096, 100_000, 1 << 20, 3 << 20] {
            let options = DeviceOptions { memory: Some(memory), ..scene.options() };
            let (device, log) = device::open(&options).unwrap();
            let Outcome { mesh, on_device, warnings } =
                scene.frame_on(Backend::vulkan(device).unwrap());
            let what = format!("{scene:?}, {memory} bytes: {warnings:?}");
            assert!(mesh == expected, "{what}");
            let fell_back =
                warnings.iter().any(|warning| warning.ends_with("continuing on the CPU"));
            assert_eq!(fell_back, on_device != whole, "{what}");
            assert!(fell_back || memory > 2 << 20, "{what}");
            assert_clean(&log);
        }
    }
}

#[test]
fn the_pipeline_cache_is_reused_and_rewritten_if_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let options = DeviceOptions {
        pipeline_cache: Some(folder.path().to_owned()),
        ..DeviceOptions::default()
    };
    let run = || {
        let (device, log) = device::open(&options).map_err(device::skip).ok()?;
        let Outcome { mesh, .. } = Scene::Shared.frame_on(watched(device).unwrap());
        assert_clean(&log);
        Some(mesh)
    };
    let Some(first) = run() else { return };
    let files: Vec<_> =
        std::fs::read_dir(folder.path()).unwrap().map(|f| f.unwrap().path()).collect();
    let [file] = &files[..] else { panic!("expected one cache file, found {files:?}") };
    assert!(run() == Some(first.clone()));
    let mut bytes = std::fs::read(file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(file, &bytes).unwrap();
    assert!(run() == Some(first));
    assert_ne!(std::fs::read(file).unwrap(), bytes, "the damaged cache was not rewritten");
}
