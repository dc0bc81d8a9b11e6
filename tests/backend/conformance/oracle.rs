//! Compares the sparse pipeline with an oracle, which implements the method on one dense array.

use std::sync::Arc;

use glam::{DVec3, IVec3};
use meniscus::internals::backend::field;
use meniscus::internals::brick::BrickSide;
use meniscus::internals::field::distance::{AWAY, BRICK, DEPTHS, InsideBricks};
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::field::recipe::Filters;
use meniscus::internals::frame::{Detail, Engine, Sampling, Surfacing};
use meniscus::internals::grid::units::{Isovalue, SheetStretch, Sigma, Smooth};
use meniscus::internals::grid::{BLOCK, CellBox, Domain, Grid};
use meniscus::internals::system::timings::Timings;

use super::TestBackend;
use crate::common::dense::{self, Dense, Method};
use crate::common::distances::{Distances, UNITS, ZERO, away, quantile};
use crate::common::scene::Random;
use crate::common::{dif, fill, recipe, reconstruct, shuffle, splashes, surfacing, tank};

/// Particles and settings for a comparison with the oracle.
struct Variant {
    particles: Vec<[f64; 3]>,
    sampling: Sampling,
    surfacing: Surfacing,
}

fn variants(backend: &TestBackend, seed: u64) -> Vec<Variant> {
    let mut variants = Vec::new();
    for indicator in [IndicatorKind::Symmetry, IndicatorKind::Counting] {
        for (sigma, detail) in [
            (1.0, Detail::Smoothed),
            (0.8, Detail::Recovered),
            (1.5, Detail::Recovered),
            (2.0, Detail::Smoothed),
        ] {
            for walls in [false, true] {
                let mut sampling = Sampling { method: indicator.into(), ..backend.sampling() };
                sampling.domain = walls.then(|| tank(&sampling.grid));
                let (sigma, iso) = (Sigma::new(sigma).ok(), Isovalue::new(0.3).ok());
                let surfacing = Surfacing { sigma, detail, iso, ..surfacing() };
                variants.push(Variant { particles: splashes(seed), sampling, surfacing });
            }
        }
    }
    variants.extend(of_clouds(backend, seed));
    variants
}

/// Variants with clouds in cells of 1/8 to 1.25 spacings. Their wide cells are 1 to 8 times as wide
/// as cells.
fn of_clouds(backend: &TestBackend, seed: u64) -> Vec<Variant> {
    let deep = fill(14.0, 1.0, 0.3, seed, |p| p.abs().max_element() < 12.0);
    let water = water(seed);
    let cases = [
        (&deep, 1.5, 1.6, false),
        (&water, 0.8, 1.6, false),
        (&water, 1.0, 0.8, false),
        (&water, 1.5, 4.0, true),
        (&water, 2.0, 2.5, false),
        (&water, 3.0, 1.2, true),
        (&water, 4.0, 1.6, false),
        (&water, 4.0, 1.6, true),
        (&water, 8.0, 1.6, true),
    ];
    let variant = |(particles, spacing, smooth, walls): (&Vec<[f64; 3]>, f64, f64, bool)| {
        let method = IndicatorKind::Cloud.into();
        let mut sampling = Sampling { method, spacing: Some(spacing), ..backend.sampling() };
        if walls {
            // Put walls at odd numbers of cells, so that wide cells cross the walls.
            let odd = |spacings: f64| 2.0 * (spacings * spacing / 2.0).floor() + 1.0;
            let [lo, hi] = [[-2.6, -3.4, -4.1], [3.2, 2.4, 4.4]].map(|p| DVec3::from(p.map(odd)));
            sampling.domain = Domain::new(&sampling.grid, lo, hi + DVec3::X).ok();
        }
        let particles = particles.iter().map(|p| p.map(|x| x * spacing)).collect();
        let surfacing = Surfacing { smooth: Smooth::new(smooth).unwrap(), ..without_sheets() };
        Variant { particles, sampling, surfacing }
    };
    cases.into_iter().map(variant).collect()
}

/// Disordered water at spacing 1: waves, a sheet, single particles, pairs and a chain.
fn water(seed: u64) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    let mut particles = fill(5.0, 1.0, 0.4, seed, |p| p.y < p.x.sin() - 0.6 && p.x + p.z < 4.0);
    particles.extend(fill(5.0, 1.0, 0.3, seed + 9, |p| p.y > 2.0 && p.y < 3.0 && p.x > -1.0));
    particles.extend((0..12).map(|_| [(); 3].map(|()| 10.0 * random.unit() - 5.0)));
    // A pair of particles at the same position, and a chain of four particles.
    particles.extend([[-4.2, 1.3, 0.4]; 2]);
    particles.extend((0..4).map(|i| [-4.0 + 1.4 * f64::from(i), 1.5, -4.0]));
    particles
}

/// The field that the oracle computes, on a dense array.
fn dense_field(frame: &Engine, Variant { particles, sampling, surfacing }: &Variant) -> Dense<u16> {
    if sampling.method != IndicatorKind::Cloud.into() {
        return oracle(frame, sampling, surfacing).integer(particles);
    }
    let inside = inside(frame, surfacing);
    let is_inside = |cell: IVec3| inside.contains(cell.div_euclid(IVec3::splat(BRICK)));
    distances(frame, sampling, surfacing).integer(particles, is_inside)
}

/// The bricks whose cells lie so deep in the fluid that they count as inside without being
/// computed, for a frame with the cloud indicator.
fn inside(frame: &Engine, surfacing: &Surfacing) -> Arc<InsideBricks> {
    let (recipe, _) = recipe(frame, surfacing);
    let Filters::Distances(distances) = recipe.filters else { panic!("not the filters of clouds") };
    distances.inside
}

fn distances(frame: &Engine, sampling: &Sampling, surfacing: &Surfacing) -> Distances {
    Distances {
        spacing: sampling.spacing.unwrap(),
        smooth: surfacing.smooth.spacings(),
        plateau: recipe(frame, surfacing).1.plateau.value(),
        walls: sampling.domain.map(|domain| domain.cells()),
    }
}

fn oracle(frame: &Engine, sampling: &Sampling, surfacing: &Surfacing) -> Method {
    let iso = surfacing.iso.unwrap();
    Method {
        indicator: dif(frame).indicator,
        sigma: surfacing.sigma.map_or(1.0, Sigma::cells),
        detail: surfacing.detail,
        iso: f64::from(iso.threshold()) + 0.5,
        walls: sampling.domain.map(|d| d.cells()),
    }
}

/// Checks that the sparse field equals the dense field. The sparse field is computed block by
/// block, as for meshing.
fn assert_same_field(frame: &Engine, surfacing: &Surfacing, dense: &Dense<u16>, what: &str) {
    let (recipe, _) = recipe(frame, surfacing);
    let mut cells = 0;
    for block in dense.cells.cubes(BLOCK) {
        let part = dense.cells.intersection(&CellBox::cube(block, BLOCK));
        let field = field(&recipe, dif(frame), part);
        for (([y, z], row), x) in field.rows(part).zip(std::iter::repeat(part.lo.x)) {
            for (x, &sample) in (x..).zip(row) {
                let cell = IVec3::new(x, y, z);
                assert_eq!(sample, dense.at(cell, None), "{what}: cell {cell}");
                cells += 1;
            }
        }
    }
    assert_eq!(cells, dense.values.len());
}

pub fn the_sparse_field_equals_the_dense_field(backend: &TestBackend) {
    let mut deep = 0;
    for seed in 0..2 {
        for variant in variants(backend, seed) {
            let Variant { particles, sampling, surfacing } = &variant;
            let frame = Engine::sample(&particles, sampling, &mut Timings::default()).unwrap();
            let dense = dense_field(&frame, &variant);
            let what = format!(
                "seed {seed}, {:?}, spacing {:?}, {surfacing:?}",
                sampling.method, sampling.spacing
            );
            let surface = recipe(&frame, surfacing).0.iso.threshold();
            let inside = dense.values.iter().filter(|&&sample| sample > surface).count();
            assert!(inside > 200, "{what}: only {inside} cells are inside");
            deep += usize::from(dense.values.contains(&u16::MAX));
            for (side, threads) in
                [(BrickSide::Four, 2), (BrickSide::Eight, 1), (BrickSide::Sixteen, 2)]
            {
                let mut shuffled = particles.clone();
                shuffle(&mut shuffled, &mut Random::new(threads as u64));
                let sampling = Sampling { side, ..sampling.clone() };
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let frame = pool
                    .install(|| Engine::sample(&shuffled, &sampling, &mut Timings::default()))
                    .unwrap();
                assert_same_field(&frame, surfacing, &dense, &format!("{what}, {side:?}"));
            }
        }
    }
    assert!(deep > 1, "fewer than two variants have cells deep inside");
}

pub fn the_mesh_equals_the_mesh_of_the_dense_field(backend: &TestBackend) {
    variants(backend, 7).iter().for_each(assert_mesh_is_dense);
}

pub fn the_mesh_of_spray_equals_the_mesh_of_the_dense_field(backend: &TestBackend) {
    let mut random = Random::new(17);
    let mut spray: Vec<[f64; 3]> =
        (0..8).map(|_| [(); 3].map(|()| 30.0 * random.unit() - 15.0)).collect();
    // A drop of two particles and a drop of three.
    spray.extend([
        [9.0, 1.0, 3.0],
        [10.3, 1.2, 3.1],
        [-8.0, -7.0, 8.0],
        [-8.0, -6.0, 8.3],
        [-7.2, -6.4, 8.9],
    ]);
    for (spacing, walls) in [(1.0, false), (1.5, true), (2.0, false), (2.0, true)] {
        let particles: Vec<[f64; 3]> = spray.iter().map(|p| p.map(|x| x * spacing)).collect();
        let method = IndicatorKind::Cloud.into();
        let mut sampling = Sampling { method, spacing: Some(spacing), ..backend.sampling() };
        if walls {
            let half = DVec3::splat((12.0 * spacing).floor());
            sampling.domain = Domain::new(&sampling.grid, -half, half).ok();
        }
        assert_mesh_is_dense(&Variant { particles, sampling, surfacing: without_sheets() });
    }
}

/// Settings that do not join sheets. Other tests cover the joining.
fn without_sheets() -> Surfacing {
    Surfacing { sheets: SheetStretch::new(0.0).unwrap(), ..surfacing() }
}

fn assert_mesh_is_dense(variant: &Variant) {
    let Variant { particles, sampling, surfacing } = variant;
    let (frame, surface) = reconstruct(&particles[..], sampling, surfacing);
    let field = dense_field(&frame, variant);
    let field =
        Dense { cells: field.cells, values: field.values.iter().map(|&v| f64::from(v)).collect() };
    let walls = sampling.domain.map(|d| d.cells());
    let c = f64::from(surface.iso.threshold()) + 0.5;
    let (positions, triangles) = dense::mesh(&field, c, walls);
    assert_eq!(surface.mesh.triangles, triangles);
    assert_eq!(surface.mesh.positions.len(), positions.len());
    for (ours, theirs) in surface.mesh.positions.iter().zip(&positions) {
        for axis in 0..3 {
            assert!((ours[axis] - theirs[axis]).abs() < 1e-12, "{ours:?} instead of {theirs:?}");
        }
    }
}

pub fn the_mesh_is_independent_of_threads_particle_order_and_brick_side(backend: &TestBackend) {
    for Variant { particles, sampling, surfacing } in variants(backend, 3) {
        let (_, expected) = reconstruct(&particles[..], &sampling, &surfacing);
        for (threads, side) in
            [(1, BrickSide::Four), (2, BrickSide::Sixteen), (5, BrickSide::Eight)]
        {
            let mut shuffled = particles.clone();
            shuffle(&mut shuffled, &mut Random::new(threads as u64));
            let sampling = Sampling { side, ..sampling.clone() };
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let (_, surface) = pool.install(|| reconstruct(&shuffled[..], &sampling, &surfacing));
            assert!(surface.mesh == expected.mesh, "{threads} threads, {side:?}");
        }
    }
}

pub fn the_integer_field_and_its_vertices_approximate_the_method_in_f64(backend: &TestBackend) {
    for Variant { particles, sampling, surfacing } in variants(backend, 12) {
        if sampling.method == IndicatorKind::Cloud.into() {
            continue;
        }
        let (frame, surface) = reconstruct(&particles[..], &sampling, &surfacing);
        let method = oracle(&frame, &sampling, &surfacing);
        let (integer, real) = (method.integer(&particles), method.real(&particles));
        let scaled = Dense {
            cells: integer.cells,
            values: integer.values.iter().map(|&v| f64::from(v) / 65535.0).collect(),
        };
        let errors = scaled.values.iter().zip(&real.values).map(|(i, r)| (i - r).abs());
        let worst = errors.fold(0.0, f64::max);
        assert!(worst < 1e-4, "{surfacing:?}: a cell is off by {worst}");

        let c = surface.iso.value();
        let (ours, our_triangles) = dense::mesh(&scaled, c, method.walls);
        let (theirs, their_triangles) = dense::mesh(&real, c, method.walls);
        assert_eq!(our_triangles, their_triangles, "a sample is too close to the isovalue");
        let pairs = ours.iter().flatten().zip(theirs.iter().flatten());
        let squares: f64 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
        let rms = (squares / ours.len() as f64).sqrt();
        assert!(rms < 2e-3, "{surfacing:?}: vertices are off by {rms} cells RMS");
    }
}

/// Maximum error, in spacings, of the integer distances for 99 % of the cells that are within one
/// spacing of the surface.
const ERROR_99_PERCENT: f64 = 0.0045;
/// Maximum error, in spacings, of the integer distances for all cells that are within one spacing
/// of the surface.
const MAX_ERROR: f64 = 0.017;

/// This test runs on the CPU only, because devices compute the same integers.
#[test]
fn integer_distances_are_within_a_fiftieth_of_a_spacing_of_f64() {
    let Ok(backend) = TestBackend::cpu();
    for variant in of_clouds(&backend, 5) {
        let Variant { particles, sampling, surfacing } = &variant;
        let frame = Engine::sample(&particles, sampling, &mut Timings::default()).unwrap();
        let integer = dense_field(&frame, &variant);
        let real = distances(&frame, sampling, surfacing).real(particles);
        let pairs = integer.iter().zip(real.values).filter(|(_, real)| real.abs() < 1.0);
        let mut off: Vec<(f64, IVec3)> = pairs
            .map(|((cell, sample), real)| (((f64::from(sample) - ZERO) / UNITS - real).abs(), cell))
            .collect();
        off.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (usual, worst) = (off[off.len() * 99 / 100].0, off[off.len() - 1]);
        let what = format!(
            "{:?} cells a spacing, {:?}, walls {}",
            sampling.spacing,
            surfacing.smooth,
            sampling.domain.is_some()
        );
        println!("{what}: {} cells, {usual:.5}, {worst:?}", off.len());
        assert!(off.len() > 500, "{what}: the scene has no surface");
        assert!(usual < ERROR_99_PERCENT && worst.0 < MAX_ERROR, "{what}: {usual}, {worst:?}");
    }
}

#[test]
fn committed_lookup_tables_match_their_functions() {
    for (i, (&depth, &far)) in DEPTHS.iter().zip(&AWAY).enumerate() {
        let share = (i as f64 / 1024.0).min(1.0);
        assert_eq!(i32::from(depth), (quantile(share) * 8192.0).round() as i32, "depth at {share}");
        assert_eq!(i32::from(far), (away(share) * 4096.0).round() as i32, "away at {share}");
    }
}

/// Variants with symmetry, with counting, and with clouds whose wide cells are 1 and 4 times as
/// wide as cells.
fn of_each_kind(backend: &TestBackend, seed: u64) -> impl Iterator<Item = Variant> {
    let which = [0, 8, 16, 22];
    variants(backend, seed)
        .into_iter()
        .enumerate()
        .filter(move |(i, _)| which.contains(i))
        .map(|(_, v)| v)
}

pub fn moving_a_scene_by_whole_bins_moves_its_field(backend: &TestBackend) {
    let shift = IVec3::new(16, -32, 48);
    for Variant { particles, sampling, surfacing } in of_each_kind(backend, 13) {
        let moved: Vec<[f64; 3]> =
            particles.iter().map(|&p| (DVec3::from(p) + shift.as_dvec3()).to_array()).collect();
        let frame = |particles: &[[f64; 3]]| {
            Engine::sample(&particles, &sampling, &mut Timings::default()).unwrap()
        };
        let (here, there) = (frame(&particles), frame(&moved));
        let (recipe, measured) = recipe(&here, &surfacing);
        let cells = CellBox { lo: IVec3::splat(-20), hi: IVec3::splat(20) };
        let elsewhere = CellBox { lo: cells.lo + shift, hi: cells.hi + shift };
        let field_here = field(&recipe, dif(&here), cells);
        assert!(
            field_here.samples().iter().any(|&sample| sample > 20_000),
            "no cell is deep inside"
        );
        let recipe = surfacing.recipe(dif(&there), &measured.calibration);
        let field_there = field(&recipe, dif(&there), elsewhere);
        assert!(field_here.samples() == field_there.samples(), "{:?}", sampling.method);
    }
}

pub fn changing_cell_size_and_origin_scales_and_moves_the_mesh(backend: &TestBackend) {
    // Scaling by a power of two, and moving by multiples of this power, causes no rounding.
    // Therefore, each cell keeps exactly the same particles.
    let (cell, origin) = (0.25, DVec3::new(-3.0, 0.5, 10.0));
    for Variant { particles, sampling: unit, surfacing } in of_each_kind(backend, 17) {
        let placed: Vec<[f64; 3]> =
            particles.iter().map(|&p| (DVec3::from(p) * cell + origin).to_array()).collect();
        let spacing = unit.spacing.map(|spacing| spacing * cell);
        let sampling = Sampling { grid: Grid::new(origin, cell).unwrap(), spacing, ..unit.clone() };
        let (_, expected) = reconstruct(&particles[..], &unit, &surfacing);
        let (_, surface) = reconstruct(&placed[..], &sampling, &surfacing);
        assert_eq!(surface.mesh.triangles, expected.mesh.triangles);
        assert_eq!(surface.mesh.positions.len(), expected.mesh.positions.len());
        for (ours, theirs) in surface.mesh.positions.iter().zip(&expected.mesh.positions) {
            let theirs = DVec3::from(*theirs) * cell + origin;
            assert!((DVec3::from(*ours) - theirs).abs().max_element() < 1e-12);
        }
    }
}
