//! Tests of particle bins and stitched meshes that stay on a device: both equal the CPU's results.

use std::sync::Arc;

use bytemuck::Pod;
use glam::{DVec3, IVec3};
use meniscus::internals::brick::vulkan::{
    BinPipelines, Coordinate, DeviceBinError, DeviceBins, DeviceGrid, DevicePositions, bin,
    reciprocal,
};
use meniscus::internals::brick::{
    BinError, BinPlan, Block, Census, CountingRoom, InvalidParticles,
};
use meniscus::internals::grid::units::Isovalue;
use meniscus::internals::grid::{BLOCK, CELL_LIMIT, CellBox, Domain, Grid, MortonKey};
use meniscus::internals::particles::Particles;
use meniscus::internals::surface::dual_mc::contour;
use meniscus::internals::surface::dual_mc::vulkan::BlockTally;
use meniscus::internals::surface::mesh::BlockMesh;
use meniscus::internals::surface::mesh::spool::Spool;
use meniscus::internals::surface::stitch::StitchedSurface;
use meniscus::internals::surface::stitch::vulkan::{
    MeshLayout, StitchBuffers, StitchPipelines, stitch, table,
};
use meniscus::internals::vulkan::{
    Buffer, BufferKind, Device, DeviceOptions, Queue, Shader, ValidationLog, VulkanError,
};

use crate::common::device;
use crate::common::scene::Random;
use crate::compile;

fn open() -> Option<(Device, ValidationLog)> {
    device::open(&DeviceOptions::default()).map_err(device::skip).ok()
}

/// Opens a device whose shaders can access at most `bytes` of a buffer at once.
fn open_narrow(bytes: u64) -> Option<(Device, ValidationLog)> {
    let options = DeviceOptions { storage_range: Some(bytes), ..DeviceOptions::default() };
    device::open(&options).map_err(device::skip).ok()
}

fn assert_valid(log: &ValidationLog) {
    assert_eq!(log.messages(), [""; 0]);
}

fn upload<T: Pod>(device: &Device, values: &[T]) -> Arc<Buffer> {
    let buffer = device.buffer(BufferKind::Upload, size_of_val(values) as u64).unwrap();
    // SAFETY: nothing else uses the new buffer yet.
    unsafe { buffer.write(0, values) };
    buffer
}

fn download<T: Pod>(device: &Device, buffer: &Arc<Buffer>, count: usize) -> Vec<T> {
    let bytes = (count * size_of::<T>()) as u64;
    let read = device.buffer(BufferKind::Download, bytes).unwrap();
    let mut batch = device.batch(Queue::Compute).unwrap();
    batch.begin().unwrap();
    batch.copy(&buffer.part(0, bytes), &read.whole());
    batch.submit(&[]).unwrap();
    batch.wait().unwrap();
    // SAFETY: the only batch that writes the buffer has finished.
    unsafe { read.read(0, count) }
}

// Tests of the shaders' arithmetic.

const ARITHMETIC: &str = "//! with wide float64
struct Case {
    a: vec2<u32>,
    b: vec2<u32>,
    reciprocal: vec2<u32>,
    ratio: vec2<u32>,
}
struct Answer {
    sum: vec2<u32>,
    difference: vec2<u32>,
    product: vec2<u32>,
    quotient: vec2<u32>,
    ratio: vec2<u32>,
    widened: vec2<u32>,
    half: vec2<u32>,
    narrowed: u32,
    at_most: u32,
}
@group(0) @binding(0) var<storage, read> cases: array<Case>;
@group(0) @binding(1) var<storage, read_write> answers: array<Answer>;
@compute @workgroup_size(64)
fn arithmetic(@builtin(global_invocation_id) id: vec3<u32>) {
    let a = cases[id.x].a;
    let b = cases[id.x].b;
    answers[id.x] = Answer(
        f64_add(a, b),
        f64_sub(a, b),
        f64_mul(a, b),
        f64_div(a, b, cases[id.x].reciprocal),
        f64_ratio(cases[id.x].ratio.x, cases[id.x].ratio.y),
        f64_from_f32(a.x),
        f64_half(i32(a.y) >> 6u),
        f32_from_f64(a),
        u32(f64_at_most(a, b)),
    );
}
";

/// A random f64 of any kind: random bits, few bits, close to a simple number, close to the midpoint
/// of two numbers, tiny, huge or special.
fn number(random: &mut Random) -> f64 {
    const SPECIAL: [f64; 10] = [
        0.0,
        -0.0,
        1.0,
        f64::MIN_POSITIVE,
        f64::MAX,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::NAN,
        5e-324,
        3.402_823_466_385_288_6e38,
    ];
    let bits = random.bits();
    match random.bits() % 8 {
        0 => f64::from_bits(bits),
        1 => f64::from_bits(bits & 0xfff0_0000_0000_0000 | bits & 0x3),
        2 => f64::from_bits(bits & 0x800f_ffff_ffff_ffff),
        3 => SPECIAL[(bits % 10) as usize],
        4 => f64::from(f32::from_bits(bits as u32)),
        5 => f64::from(bits as i32 >> (bits >> 59)) / 1024.0,
        6 => f64::from_bits(
            bits & 0x800f_ffff_f000_0000 | (0x3fd8_0000_1000_0000 + (bits >> 58 << 52)),
        ),
        _ => f64::from_bits(bits & 0x803f_ffff_ffff_ffff | 0x3fc0_0000_0000_0000),
    }
}

#[test]
fn emulated_f64_arithmetic_matches_the_cpu() {
    #[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
    #[repr(C)]
    struct Case {
        a: f64,
        b: f64,
        reciprocal: u64,
        ratio: [u32; 2],
    }
    #[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
    #[repr(C)]
    struct Answer {
        sum: u64,
        difference: u64,
        product: u64,
        quotient: u64,
        ratio: u64,
        widened: u64,
        half: u64,
        narrowed: u32,
        at_most: u32,
    }
    let Some((device, log)) = open() else { return };
    let shader: &'static Shader = Box::leak(Box::new(Shader {
        name: "arithmetic",
        code: compile::compiled("arithmetic", &compile::whole(ARITHMETIC).unwrap()).unwrap().leak(),
        buffers: &["cases", "answers"],
        push_bytes: 0,
        group: 64,
    }));
    let mut random = Random::new(5);
    let count = 1 << 20;
    let cases: Vec<Case> = (0..count)
        .map(|_| {
            let (a, b) = (number(&mut random), number(&mut random));
            let divides = b.is_finite() && b != 0.0;
            let upper = 2 + random.bits() as u32 % ((1 << 17) - 2);
            Case {
                a,
                b,
                reciprocal: if divides { reciprocal(b) } else { 0 },
                ratio: [1 + random.bits() as u32 % (upper - 1), upper],
            }
        })
        .collect();
    let answers = device.buffer(BufferKind::Device, (count * size_of::<Answer>()) as u64).unwrap();
    let pipeline = Arc::new(device.pipeline(shader).unwrap());
    let mut batch = device.batch(Queue::Compute).unwrap();
    batch.begin().unwrap();
    let views = [upload(&device, &cases).whole(), answers.whole()];
    batch.dispatch(&pipeline, &views, &(), [count as u32 / 64, 1, 1]).unwrap();
    batch.submit(&[]).unwrap();
    batch.wait().unwrap();
    let answers: Vec<Answer> = download(&device, &answers, count);
    for (Case { a, b, ratio, .. }, answer) in cases.into_iter().zip(answers) {
        let same = |what: &str, host: f64, device: u64| {
            let found = f64::from_bits(device);
            let equal = host.to_bits() == device || host.is_nan() && found.is_nan();
            assert!(equal, "{what} of {a:e} and {b:e}: {found:e} instead of {host:e}");
        };
        same("sum", a + b, answer.sum);
        same("difference", a - b, answer.difference);
        if a.is_finite() && b.is_finite() {
            same("product", a * b, answer.product);
            if b != 0.0 {
                same("quotient", a / b, answer.quotient);
            }
        }
        same("ratio", f64::from(ratio[0]) / f64::from(ratio[1]), answer.ratio);
        same("widened", f64::from(f32::from_bits(a.to_bits() as u32)), answer.widened);
        same("half", f64::from((a.to_bits() >> 32) as i32 >> 6) / 2.0, answer.half);
        if !a.is_nan() {
            assert_eq!((a as f32).to_bits(), answer.narrowed, "{a:e}");
            assert!(b.is_nan() || u32::from(a <= b) == answer.at_most, "{a:e} {b:e}");
        }
    }
    assert_valid(&log);
}

// Tests of bins.

/// Bins whose records are sorted, so that the order of threads does not matter.
#[derive(Debug, PartialEq)]
struct Sorted {
    keys: Vec<MortonKey>,
    census: Census,
    records: Vec<Vec<u64>>,
}

fn binned_on_cpu(
    particles: &(impl Particles + ?Sized),
    grid: &Grid,
    domain: Option<&Domain>,
    invalid: InvalidParticles,
    limit: usize,
) -> Result<Sorted, BinError> {
    let room = CountingRoom { bins: limit, ..CountingRoom::BINS };
    let plan = BinPlan::count(&particles, grid, domain, invalid, room)?;
    let census = plan.census();
    let bins = plan.fill(&particles, &[]).unwrap();
    let records = |bin| {
        let mut records = bins.contents(bin).unwrap().packed().to_vec();
        records.sort_unstable();
        records
    };
    Ok(Sorted {
        keys: bins.keys().to_vec(),
        census,
        records: (0..bins.keys().len()).map(records).collect(),
    })
}

fn from_device(device: &Device, bins: DeviceBins) -> Sorted {
    let DeviceBins { keys, first, census, runs } = bins;
    let mut records = Vec::new();
    for (run, buffer) in runs {
        assert_eq!(run.start, records.len());
        let all: Vec<u64> = download(device, &buffer, first[run.end] - first[run.start]);
        for bin in run.clone() {
            let mut of_bin =
                all[first[bin] - first[run.start]..first[bin + 1] - first[run.start]].to_vec();
            of_bin.sort_unstable();
            records.push(of_bin);
        }
    }
    Sorted { keys, census, records }
}

/// Uploads the pieces of a scene, each to an unaligned offset in its own buffer.
fn on_device<T: Pod>(
    device: &Device,
    pieces: &[&[[T; 3]]],
    coordinate: Coordinate,
) -> Vec<DevicePositions> {
    let place = |piece: &&[[T; 3]]| {
        let mut bytes = vec![0xff_u8; 20];
        bytes.extend_from_slice(bytemuck::cast_slice(piece));
        let view = upload(device, &bytes).part(20, bytes.len() as u64 - 20);
        DevicePositions { view, count: piece.len(), coordinate }
    };
    pieces.iter().map(place).collect()
}

/// Particles in a dense cluster, on cell faces, far away, and at non-finite positions.
fn cloud(count: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    (0..count)
        .map(|i| {
            std::array::from_fn(|_| {
                let limit = f64::from(CELL_LIMIT) * 0.37;
                match (random.bits() % 1000, i % 7) {
                    (0, 0) => number(&mut random),
                    (1, 1) => limit * (1.0 + 1e-7 * (random.unit() - 0.5)),
                    (2, 2) => -limit * (1.0 + 1e-7 * (random.unit() - 0.5)),
                    (3, _) => 1e6 * (random.unit() - 0.5),
                    (4, _) => f64::from(f32::from_bits(random.bits() as u32 & 0x807f_ffff)),
                    (_, 3) => 0.37 * (100.0 * (random.unit() - 0.5)).round(),
                    (_, 4) => -1e-12 * random.unit(),
                    _ => 40.0 * random.unit() - 20.0,
                }
            })
        })
        .collect()
}

fn single(cloud: &[[f64; 3]]) -> Vec<[f32; 3]> {
    cloud.iter().map(|p| p.map(|x| x as f32)).collect()
}

fn grids() -> Vec<Grid> {
    [
        (DVec3::ZERO, 0.37),
        (DVec3::new(0.1, -7.3, 1e-3), 1.0),
        (DVec3::new(1e5, 0.0, -3.7), 0.02 / 3.0),
        (DVec3::ZERO, 3e30),
        (DVec3::new(1e-310, -1e300, 0.0), 1e-310),
    ]
    .map(|(origin, cell)| Grid::new(origin, cell).unwrap())
    .to_vec()
}

#[test]
fn the_device_sorts_particles_into_the_same_bins_as_the_cpu() {
    let Some((device, log)) = open() else { return };
    let pipelines = BinPipelines::new(&device).unwrap();
    let doubles = cloud(60_000, 1);
    let singles = single(&doubles);
    for grid in grids() {
        let far = 1e3 * grid.cell_size();
        let near = 13.2 * grid.cell_size();
        let box_of = |below: f64, above: f64| {
            Domain::new(&grid, grid.origin() - below, grid.origin() + above).ok()
        };
        for domain in [None, box_of(0.77 * far, 0.91 * far), box_of(near, 0.7 * near)] {
            let domain = domain.as_ref();
            let skip = InvalidParticles::Skip;
            let sort = |positions: &[DevicePositions]| {
                bin(&device, &pipelines, positions, &grid, domain, skip, 1 << 20).unwrap()
            };
            let (one, two) = singles.split_at(20_001);
            let found = sort(&on_device(&device, &[one, two], Coordinate::Single));
            let expected = binned_on_cpu(&singles[..], &grid, domain, skip, 1 << 20).unwrap();
            assert!(from_device(&device, found) == expected, "{grid:?} {domain:?}");
            let found = sort(&on_device(&device, &[&doubles], Coordinate::Double));
            let expected = binned_on_cpu(&doubles[..], &grid, domain, skip, 1 << 20).unwrap();
            assert!(from_device(&device, found) == expected, "{grid:?} {domain:?}");
        }
    }
    assert_valid(&log);
}

#[test]
fn particles_near_walls_are_binned_as_on_the_cpu() {
    let Some((device, log)) = open() else { return };
    let pipelines = BinPipelines::new(&device).unwrap();
    let grid = Grid::new(DVec3::splat(0.05), 0.1).unwrap();
    let (lo, hi) = (DVec3::new(-1.04, -0.3, 0.0), DVec3::new(2.0, 0.77, 1.26));
    let domain = Domain::new(&grid, lo, hi).unwrap();
    let mut random = Random::new(3);
    let mut near = |wall: f64| match random.bits() % 6 {
        0 => wall,
        1 => wall.next_up(),
        2 => wall.next_down(),
        _ => wall + 0.2 * (random.unit() - 0.5),
    };
    let particles: Vec<[f64; 3]> = (0..30_000)
        .map(|i| std::array::from_fn(|a| near(if i >> a & 1 == 0 { lo[a] } else { hi[a] })))
        .collect();
    let refuse = InvalidParticles::Refuse;
    let positions = on_device(&device, &[&particles], Coordinate::Double);
    let found =
        bin(&device, &pipelines, &positions, &grid, Some(&domain), refuse, 1 << 20).unwrap();
    assert!(found.census.outside > 1000 && found.census.binned > 1000);
    let expected = binned_on_cpu(&particles[..], &grid, Some(&domain), refuse, 1 << 20).unwrap();
    assert!(from_device(&device, found) == expected);
    assert_valid(&log);
}

#[test]
fn binning_is_independent_of_chunks_runs_and_particle_order() {
    let Some((device, log)) = open_narrow(4 << 20) else { return };
    let pipelines = BinPipelines::new(&device).unwrap();
    let mut random = Random::new(8);
    let mut particles: Vec<[f32; 3]> = (0..340_000)
        .map(|_| std::array::from_fn(|_| (60.0 * random.unit() - 30.0) as f32))
        .collect();
    particles.extend_from_within(..);
    particles.extend_from_within(..);
    let grid = Grid::new(DVec3::ZERO, 1.0).unwrap();
    let refuse = InvalidParticles::Refuse;
    let sort = |particles: &[[f32; 3]]| {
        let pieces: Vec<_> = particles.chunks(300_001).collect();
        let positions = on_device(&device, &pieces, Coordinate::Single);
        let bins = bin(&device, &pipelines, &positions, &grid, None, refuse, 1 << 20).unwrap();
        assert!(bins.runs.len() > 2);
        from_device(&device, bins)
    };
    let expected = binned_on_cpu(&particles[..], &grid, None, refuse, 1 << 20).unwrap();
    assert!(sort(&particles) == expected);
    for i in (1..particles.len()).rev() {
        particles.swap(i, (random.bits() % (i as u64 + 1)) as usize);
    }
    assert!(sort(&particles) == expected);
    assert_valid(&log);
}

#[test]
fn the_bin_table_grows_until_all_bins_fit_or_the_limit_is_exceeded() {
    let Some((device, log)) = open() else { return };
    let pipelines = BinPipelines::new(&device).unwrap();
    let mut random = Random::new(2);
    let particles: Vec<[f32; 3]> = (0..50_000)
        .map(|_| std::array::from_fn(|_| (1e6 * (random.unit() - 0.5)) as f32))
        .collect();
    let grid = Grid::new(DVec3::ZERO, 1.0).unwrap();
    let refuse = InvalidParticles::Refuse;
    let positions = on_device(&device, &[&particles], Coordinate::Single);
    let found = bin(&device, &pipelines, &positions, &grid, None, refuse, 1 << 20).unwrap();
    assert!(found.keys.len() > 40_000);
    assert!(
        from_device(&device, found)
            == binned_on_cpu(&particles[..], &grid, None, refuse, 1 << 20).unwrap()
    );
    for limit in [100, 2000, 40_000] {
        let refused = bin(&device, &pipelines, &positions, &grid, None, refuse, limit).unwrap_err();
        assert_eq!(refused, DeviceBinError::Bin(BinError::TooManyBins { limit }));
    }
    assert_valid(&log);
}

#[test]
fn the_first_invalid_particle_is_reported_as_on_the_cpu() {
    let Some((device, log)) = open() else { return };
    let pipelines = BinPipelines::new(&device).unwrap();
    let grid = Grid::new(DVec3::ZERO, 1.0).unwrap();
    let refuse = InvalidParticles::Refuse;
    for (bad, far) in [(70_003, 9000), (0, 99_999), (99_999, 99_998)] {
        let mut particles = vec![[0.5_f32; 3]; 100_000];
        particles[bad][1] = f32::INFINITY;
        particles[far][2] = -1e30;
        let positions =
            on_device(&device, &[&particles[..300], &particles[300..]], Coordinate::Single);
        let found = bin(&device, &pipelines, &positions, &grid, None, refuse, 8).unwrap_err();
        let expected = binned_on_cpu(&particles[..], &grid, None, refuse, 8).unwrap_err();
        assert_eq!(found, DeviceBinError::Bin(expected));
    }
    assert_valid(&log);
}

#[test]
fn binning_no_particles_gives_no_bins() {
    let Some((device, log)) = open() else { return };
    let pipelines = BinPipelines::new(&device).unwrap();
    let grid = Grid::new(DVec3::ZERO, 1.0).unwrap();
    let none = on_device::<f32>(&device, &[&[]], Coordinate::Single);
    for positions in [&none[..], &[]] {
        let bins =
            bin(&device, &pipelines, positions, &grid, None, InvalidParticles::Refuse, 8).unwrap();
        assert_eq!((bins.keys, bins.first, bins.census), (vec![], vec![0], Census::default()));
        assert!(bins.runs.is_empty());
    }
    assert_valid(&log);
}

#[test]
fn binning_without_enough_memory_fails_and_frees_its_buffers() {
    let Some((device, log)) = open() else { return };
    let pipelines = BinPipelines::new(&device).unwrap();
    let particles = vec![[0.5_f32; 3]; 1000];
    let grid = Grid::new(DVec3::ZERO, 1.0).unwrap();
    let positions = on_device(&device, &[&particles], Coordinate::Single);
    let before = device.allocated();
    let mut failures = 0;
    for number in 1.. {
        device.faults().allocation.store(number, std::sync::atomic::Ordering::Relaxed);
        let found = bin(&device, &pipelines, &positions, &grid, None, InvalidParticles::Refuse, 8);
        device.faults().allocation.store(0, std::sync::atomic::Ordering::Relaxed);
        match found {
            Ok(bins) => {
                assert_eq!(bins.census.binned, 1000);
                break;
            }
            Err(error) => {
                assert!(
                    matches!(error, DeviceBinError::Vulkan(VulkanError::OutOfMemory { .. })),
                    "{error}"
                );
                failures += 1;
            }
        }
        assert_eq!(device.allocated(), before);
    }
    assert!(failures > 5);
    assert_valid(&log);
}

// Tests of meshes.

/// The surface of a bumpy field, in several blocks.
fn surfaces(region: CellBox, iso: Isovalue, walls: Option<CellBox>, seed: u64) -> Vec<BlockMesh> {
    let mut random = Random::new(seed);
    let mut bumps: Vec<[f64; 5]> = (0..40)
        .map(|_| {
            let at: [f64; 3] = std::array::from_fn(|a| {
                let size = f64::from(region.size()[a]);
                f64::from(region.lo[a]) + 3.0 + random.unit() * (size - 6.0)
            });
            [at[0], at[1], at[2], 2.0 + 10.0 * random.unit(), 0.3 + random.unit()]
        })
        .collect();
    bumps.push([f64::from(region.lo.x), 0.0, 0.0, 30.0, 1.0]);
    let noise = random.bits();
    let sample = |cell: IVec3| {
        let open = cell.cmple(region.lo).any() || cell.cmpge(region.hi - 1).any();
        if open && walls.is_none() {
            return 0;
        }
        let p = cell.as_dvec3();
        let sum: f64 = bumps
            .iter()
            .map(|b| {
                b[4] * (-(p - DVec3::new(b[0], b[1], b[2])).length_squared() / (b[3] * b[3])).exp()
            })
            .sum();
        let hash = Random::new(noise ^ MortonKey::of(cell).0).bits() % 3000;
        (40_000.0 * sum + hash as f64).min(65_535.0) as u16
    };
    let mut regions: Vec<CellBox> = region
        .cubes(BLOCK)
        .map(|block| CellBox::cube(block, BLOCK).intersection(&region))
        .collect();
    regions.sort_by_key(|r| MortonKey::of(r.lo.div_euclid(IVec3::splat(BLOCK))));
    let of_region = |region: CellBox| {
        let cells = region.tiled().grown(0, 1);
        let mut field = Block::zero(cells);
        for z in cells.lo.z..cells.hi.z {
            for y in cells.lo.y..cells.hi.y {
                for x in cells.lo.x..cells.hi.x {
                    let cell = IVec3::new(x, y, z);
                    let nearest = walls.map_or(cell, |walls| cell.clamp(walls.lo, walls.hi - 1));
                    let index = field.index(cell);
                    field.samples_mut()[index] = sample(nearest);
                }
            }
        }
        contour(&field, region, iso, walls)
    };
    let meshes = regions.into_iter().map(of_region);
    meshes.filter(|mesh| !mesh.tiles.is_empty()).collect()
}

/// Stitches a mesh on the device, and downloads its positions and triangles.
fn stitched(
    device: &Device,
    meshes: &[BlockMesh],
    grid: &Grid,
    domain: Option<&Domain>,
    iso: Isovalue,
) -> (Vec<[u32; 3]>, Vec<[u32; 3]>) {
    let tally = |mesh: &BlockMesh| {
        let mut tally = BlockTally::default();
        tally.tiles = mesh.tiles.len() as u32;
        tally.vertices = mesh.ends.len() as u32;
        tally.triangles = mesh.triangle_count as u32;
        (mesh.block, tally)
    };
    let blocks: Vec<_> = meshes.iter().map(tally).collect();
    let layout = MeshLayout::new(&blocks).unwrap();
    let tiles: Vec<_> = meshes.iter().flat_map(|mesh| mesh.tiles.iter().copied()).collect();
    let ends: Vec<_> = meshes.iter().flat_map(|mesh| mesh.ends.iter().copied()).collect();
    let (vertices, triangles) = (layout.vertices() as usize, layout.triangles() as usize);
    assert_eq!((tiles.len(), ends.len()), (layout.tiles() as usize, vertices));
    let empty = |bytes: usize| device.buffer(BufferKind::Device, bytes as u64).unwrap();
    let (positions, indices) = (empty(12 * vertices), empty(12 * triangles));
    let buffers = StitchBuffers {
        grid: upload(device, &[DeviceGrid::new(grid, domain)]).whole(),
        blocks: upload(device, layout.blocks()).whole(),
        tiles: upload(device, &tiles).whole(),
        ends: upload(device, &ends).whole(),
        table: upload(device, &table()).whole(),
        begins: empty(8 * tiles.len()).whole(),
        positions: positions.whole(),
        indices: indices.whole(),
    };
    let pipelines = StitchPipelines::new(device).unwrap();
    let mut batch = device.batch(Queue::Compute).unwrap();
    batch.begin().unwrap();
    stitch(device, (&mut batch, &[]), &pipelines, &layout, iso, &buffers).unwrap();
    batch.submit(&[]).unwrap();
    batch.wait().unwrap();
    (download(device, &positions, vertices), download(device, &indices, triangles))
}

#[test]
fn stitching_on_the_device_gives_the_mesh_of_the_cpu() {
    let scenes = [
        (DVec3::ZERO, 1.0, IVec3::new(-40, -32, -70), IVec3::new(40, 37, 21), None),
        (DVec3::new(0.1, -7.3, 1e-3), 0.37, IVec3::new(-64, 0, 0), IVec3::new(32, 96, 64), None),
        // In this scene, the walls are not on cell faces.
        (DVec3::new(0.3, 0.0, 0.1), 0.25, IVec3::splat(-40), IVec3::splat(48), Some(0.1)),
        // In this scene, the cells are so small that all coordinates, including those of the walls,
        // are subnormal in f32.
        (DVec3::ZERO, 1e-40, IVec3::splat(-33), IVec3::splat(35), Some(0.0)),
        (DVec3::new(1e38, -1e38, 0.0), 2e37, IVec3::splat(-20), IVec3::splat(20), None),
    ];
    for narrow in [1 << 27, 300 << 10] {
        let Some((device, log)) = open_narrow(narrow) else { return };
        for (seed, (origin, cell, lo, hi, walls)) in (0..).zip(scenes) {
            let grid = Grid::new(origin, cell).unwrap();
            let domain = walls.map(|shift| {
                let corner = |cells: IVec3| grid.world_from_cells(cells.as_dvec3() + shift);
                Domain::new(&grid, corner(lo), corner(hi)).unwrap()
            });
            let region = domain.as_ref().map_or(CellBox { lo, hi }, |d| d.cells().grown(1, 0));
            let iso = Isovalue::new(0.4).unwrap();
            let meshes = surfaces(region, iso, domain.as_ref().map(Domain::cells), seed);
            assert!(meshes.len() > 7);
            let (positions, triangles) = stitched(&device, &meshes, &grid, domain.as_ref(), iso);
            let mut spool = Spool::in_memory(false, Vec::new());
            meshes.into_iter().try_for_each(|mesh| spool.push(mesh)).unwrap();
            let host =
                StitchedSurface::new(spool, grid, domain, iso, Vec::new()).to_mesh().unwrap();
            assert!(host.triangles.len() > 5000, "{}", host.triangles.len());
            assert!(triangles == host.triangles, "scene {seed}");
            for (at, (found, expected)) in positions.iter().zip(&host.positions).enumerate() {
                assert_eq!(
                    *found,
                    expected.map(|x| (x as f32).to_bits()),
                    "scene {seed}, vertex {at}"
                );
            }
            assert_eq!(positions.len(), host.positions.len());
        }
        assert_valid(&log);
    }
}
