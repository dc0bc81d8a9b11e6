//! Tests of surfaces of known shapes: they are closed, oriented and manifold, with the right genus
//! and volume and with outward normals.

use std::f64::consts::PI;

use glam::{DVec3, IVec3};
use meniscus::internals::backend::Surfaces;
use meniscus::internals::brick::{BrickSide, DifField, PageInfo};
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::field::recipe::PaperFilters;
use meniscus::internals::field::recipe::Recipe;
use meniscus::internals::frame::estimate::MemoryPlan;
use meniscus::internals::frame::{
    CountedFrame, Detail, Engine, FrameError, Normals, Resources, Sampling, Surfacing,
};
use meniscus::internals::grid::units::{Isovalue, MemoryBudget, Sigma, Smooth};
use meniscus::internals::grid::{BIN, BLOCK, CellBox, Domain, Grid, MortonKey, PeriodicMesh};
use meniscus::internals::surface::mesh::check::check;
use meniscus::internals::surface::mesh::measure::measure;
use meniscus::internals::surface::mesh::spool::Spool;
use meniscus::internals::surface::mesh::{BlockMesh, Mesh};
use meniscus::internals::surface::stitch::StitchedSurface;
use meniscus::internals::system::control::{Control, Stage};
use meniscus::internals::system::timings::Timings;

use super::TestBackend;
use crate::common::attributed::Attributed;
use crate::common::scene::Random;
use crate::common::{
    INDICATORS, Reconstructed, dif, fill, reconstruct, sampled, splashes, surfacing, uneven_tank,
};

fn assert_watertight(mesh: &Mesh, what: &str) {
    let report = check(mesh);
    assert!(report.is_closed_oriented_manifold(), "{what}: {report}");
}

/// The name, the genus and the volume, in cells, of a shape, and a function that returns whether a
/// point is inside the shape. Shapes are at least 32 cells thick everywhere.
type Shape = (&'static str, i64, f64, fn(DVec3) -> bool);

const SHAPES: [Shape; 3] = [
    ("sphere", 0, 4.0 / 3.0 * PI * 4096.0, |p| p.length() < 16.0),
    ("slab", 0, 96.0 * 32.0 * 96.0, |p| p.abs().cmplt(DVec3::new(48.0, 16.0, 48.0)).all()),
    ("torus", 1, 2.0 * PI * PI * 32.0 * 256.0, |p| {
        (DVec3::new(p.x, 0.0, p.z).length() - 32.0).hypot(p.y) < 16.0
    }),
];

pub fn known_shapes_have_their_genus_and_volume(backend: &TestBackend) {
    for (name, genus, volume, inside) in SHAPES {
        for indicator in INDICATORS {
            for jitter in [0.0, 0.3, 0.5] {
                let particles = fill(50.0, 1.0, jitter, 5, inside);
                let (_, surface) = reconstruct(
                    &particles[..],
                    &Sampling { method: indicator.into(), ..backend.sampling() },
                    &surfacing(),
                );
                let what = format!("{name}, {indicator:?}, jitter {jitter}");
                assert_watertight(&surface.mesh, &what);
                let measures = measure(&surface.mesh);
                assert_eq!((measures.genus, measures.components), (Some(genus), 1), "{what}");
                let error = measures.volume.unwrap() / volume - 1.0;
                // A filter of variance v shrinks the volume of a sphere of radius R by the fraction
                // 3 v / R^2. For counting, v is 1.6 cells^2, including the box filter after the
                // Gaussian. This is 1.9 % for this sphere.
                let curved = name == "sphere" && indicator != IndicatorKind::Symmetry;
                assert!(
                    error.abs() < if curved { 0.019 } else { 0.01 },
                    "{what}: the volume is off by {error}"
                );
            }
        }
    }
}

pub fn the_normals_of_a_sphere_point_outwards(backend: &TestBackend) {
    let particles = fill(20.0, 2.0, 0.3, 5, |p| p.length() < 12.0);
    let surfacing = Surfacing { normals: Normals::Gradient, ..surfacing() };
    let (_, surface) = reconstruct(&particles[..], &backend.sampling(), &surfacing);
    let normals = surface.mesh.normals.as_ref().unwrap();
    assert_eq!(normals.len(), surface.mesh.positions.len());
    for (&position, &normal) in surface.mesh.positions.iter().zip(normals) {
        let normal = DVec3::from(normal.map(f64::from));
        assert!((normal.length() - 1.0).abs() < 1e-6);
        assert!(normal.dot(DVec3::from(position).normalize()) > 0.8, "{normal} at {position:?}");
    }
    assert!(measure(&surface.mesh).volume.unwrap() > 0.0);
}

/// The surface of the function `sample`, which is evaluated in each cell of `blocks`. Outside these
/// blocks of 32^3 cells, the field is 0.
fn surface_of(
    backend: &TestBackend,
    blocks: CellBox,
    iso: Isovalue,
    sample: impl Fn(IVec3) -> u16,
) -> Mesh {
    let cells = CellBox { lo: blocks.lo * BLOCK, hi: blocks.hi * BLOCK };
    let page = |bin: IVec3| {
        let rows = CellBox::cube(bin, BIN);
        let dense: Vec<u16> = rows.cubes(1).map(&sample).collect();
        PageInfo::from_dense(bin, &dense, BrickSide::Sixteen.into())
    };
    let mut pages: Vec<_> = cells.cubes(BIN).filter_map(page).collect();
    pages.sort_unstable_by_key(|(info, _)| info.key);
    let dif = DifField::in_memory(BrickSide::Sixteen.into(), pages);
    // Use a Gaussian so narrow that it does not change the samples.
    let filters =
        PaperFilters::new(IndicatorKind::Symmetry, Sigma::new(0.01).unwrap(), Detail::Smoothed);
    let recipe = Recipe::of_paper(filters, iso);
    let surfaces = Surfaces {
        sampled: &sampled(dif),
        recipe: &recipe,
        solid: None,
        normals: Normals::None,
        periodic_mesh: PeriodicMesh::Cut,
    };
    let stages = backend.sampling().resources.backend.executor().start(MemoryBudget(8 << 30));
    let mut spool = Spool::in_memory(false, Vec::new());
    let mut push = |meshes: Vec<Option<BlockMesh>>| {
        meshes.into_iter().flatten().try_for_each(|mesh| spool.push(mesh))
    };
    let control = Control::default();
    let meter = control.meter(Stage::Meshing, 1);
    stages.contour(&surfaces, &surfaces.regions(), &meter, &mut push).unwrap();
    assert_eq!(stages.warnings(), [""; 0]);
    let grid = Grid::new(DVec3::ZERO, 1.0).unwrap();
    StitchedSurface::new(spool, grid, None, iso, Vec::new()).to_mesh().unwrap()
}

pub fn the_surface_of_white_noise_over_27_blocks_is_a_closed_manifold(backend: &TestBackend) {
    for (seed, c) in [(1, 0.5), (2, 0.3), (3, 0.9), (4, 0.02)] {
        let noise = |cell: IVec3| {
            let key = MortonKey::of(cell).0;
            Random::new(key.wrapping_mul(31).wrapping_add(seed)).bits() as u16
        };
        let blocks = CellBox { lo: IVec3::NEG_ONE, hi: IVec3::splat(2) };
        let mesh = surface_of(backend, blocks, Isovalue::new(c).unwrap(), noise);
        assert!(mesh.triangles.len() > 100_000, "{} triangles", mesh.triangles.len());
        assert_watertight(&mesh, &format!("noise cut at {c}"));
    }
}

pub fn all_pairs_of_adjacent_sign_patterns_give_a_closed_manifold(backend: &TestBackend) {
    // Put all 2^12 patterns of 2 x 2 x 3 samples into one field, far apart. Each sample of a
    // pattern is inside or outside, and inside samples have one of two values.
    let pattern = |cell: IVec3| {
        let (group, local) = (cell.div_euclid(IVec3::splat(6)), cell.rem_euclid(IVec3::splat(6)));
        let which = group.x + 16 * (group.y + 16 * group.z);
        let bit = local.x - 1 + 2 * (local.y - 1) + 4 * (local.z - 1);
        let inside = local.min_element() >= 1
            && local.x < 3
            && local.y < 3
            && local.z < 4
            && which >> bit & 1 == 1;
        if inside { 40_000 + 1000 * bit as u16 } else { 100 * bit.unsigned_abs() as u16 }
    };
    let mesh = surface_of(
        backend,
        CellBox { lo: IVec3::ZERO, hi: IVec3::splat(3) },
        Isovalue::new(0.5).unwrap(),
        pattern,
    );
    assert!(mesh.triangles.len() > 50_000);
    assert_watertight(&mesh, "all patterns");
}

/// Settings for clouds with spacing 1 and cells of size `cell`, in spacings.
fn of_spacings(backend: &TestBackend, cell: f64) -> Sampling {
    let grid = Grid::new(DVec3::ZERO, cell).unwrap();
    Sampling { method: IndicatorKind::Cloud.into(), grid, spacing: Some(1.0), ..backend.sampling() }
}

/// Cell sizes from a quarter of a spacing to two thirds.
const CELLS: [f64; 4] = [0.25, 1.0 / 3.0, 0.5, 2.0 / 3.0];

pub fn clouds_keep_drops_and_sheets_whole_without_changing_the_pool(backend: &TestBackend) {
    let mut random = Random::new(6);
    let pool = fill(16.0, 1.0, 0.3, 4, |p| p.z < 0.0);
    let mut anywhere = || DVec3::new(random.unit(), random.unit(), random.unit());
    let drops: Vec<[f64; 3]> = (0..27)
        .map(|i| {
            let at = IVec3::new(i % 3, i / 3 % 3, i / 9).as_dvec3() * 10.0
                + DVec3::new(-10.0, -10.0, 10.0);
            (at + anywhere()).to_array()
        })
        .collect();
    let layer = |p: DVec3| p.z > -1.0 && p.z < 0.0 && p.abs().max_element() < 14.0;
    let sheet = fill(16.0, 1.0, 0.2, 9, layer).into_iter().map(|[x, y, z]| [x, y, z - 30.0]);
    let all: Vec<[f64; 3]> = pool.iter().copied().chain(drops).chain(sheet).collect();
    for cell in CELLS {
        let mesh = |particles: &[[f64; 3]]| {
            reconstruct(particles, &of_spacings(backend, cell), &surfacing()).1.mesh
        };
        let (alone, with) = (mesh(&pool), mesh(&all));
        assert_watertight(&with, &format!("cells of {cell}"));
        let found = measure(&with);
        assert_eq!((found.components, found.genus), (1 + 27 + 1, Some(0)), "cells of {cell}");
        let top = |mesh: &Mesh| -> Vec<[f64; 3]> {
            let near = |p: &&[f64; 3]| p[0].abs() < 10.0 && p[1].abs() < 10.0 && p[2].abs() < 3.0;
            mesh.positions.iter().filter(near).copied().collect()
        };
        assert!(
            top(&alone).len() > 300 && top(&alone) == top(&with),
            "cells of {cell}: the surface of the pool moved"
        );
    }
}

/// This test runs on the CPU only, because devices compute the same integers.
#[test]
fn a_lone_particle_has_about_its_volume_for_any_cell_size_and_position() {
    let Ok(backend) = TestBackend::cpu();
    let mut random = Random::new(8);
    for cell in CELLS {
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for i in 0..18 {
            // Use random positions in a cell, and corners at which cells, wide cells or blocks
            // meet.
            let particle = match i {
                0..8 => [(); 3].map(|()| 4.0 * random.unit()),
                8..16 => [i & 1, i >> 1 & 1, i >> 2 & 1].map(|half| 0.5 * cell * f64::from(half)),
                16 => [32.0 * cell; 3],
                _ => [31.5 * cell, -0.5 * cell, 0.0],
            };
            let (_, surface) =
                reconstruct(&[particle][..], &of_spacings(&backend, cell), &surfacing());
            let what = format!("cells of {cell}, {particle:?}");
            assert_watertight(&surface.mesh, &what);
            let found = measure(&surface.mesh);
            assert_eq!((found.components, found.genus), (1, Some(0)), "{what}");
            let volume = found.volume.unwrap();
            (least, most) = (least.min(volume), most.max(volume));
        }
        println!("cells of {cell}: drops of {least} to {most}");
        assert!(least > 0.5 && most < 1.6, "cells of {cell}: {least} to {most}");
    }
}

/// This test runs on the CPU only, because devices compute the same integers.
#[test]
fn particles_1_5_spacings_apart_form_one_chain_in_any_direction() {
    let Ok(backend) = TestBackend::cpu();
    let mut random = Random::new(8);
    let mut anywhere = || DVec3::new(random.unit(), random.unit(), random.unit());
    let mut ways = vec![DVec3::X, DVec3::ONE];
    ways.extend((0..4).map(|_| anywhere() - 0.5));
    for way in ways.into_iter().map(DVec3::normalize) {
        let start = anywhere();
        let chain: Vec<[f64; 3]> =
            (0..10).map(|i| (start + 1.5 * f64::from(i) * way).to_array()).collect();
        for cell in CELLS {
            let (_, surface) = reconstruct(&chain[..], &of_spacings(&backend, cell), &surfacing());
            assert_eq!(measure(&surface.mesh).components, 1, "along {way} in cells of {cell}");
        }
    }
}

pub fn a_ball_of_radius_5_spacings_has_the_volume_of_its_particles(backend: &TestBackend) {
    for (jitter, seed) in [(0.0, 1), (0.3, 5), (0.5, 3)] {
        let ball = fill(10.0, 1.0, jitter, seed, |p| p.length() < 5.0);
        for cell in CELLS {
            let (_, surface) = reconstruct(&ball[..], &of_spacings(backend, cell), &surfacing());
            let share = measure(&surface.mesh).volume.unwrap() / ball.len() as f64;
            println!("jitter {jitter}, cells of {cell}: {share}");
            assert!((share - 1.0).abs() < 0.015, "jitter {jitter}, cells of {cell}: {share}");
        }
    }
}

pub fn an_air_bubble_of_radius_2_spacings_survives(backend: &TestBackend) {
    let middle = DVec3::new(0.3, -0.2, 0.4);
    let water = fill(12.0, 1.0, 0.3, 3, |p| p.length() < 9.0 && (p - middle).length() > 2.0);
    for cell in CELLS {
        let (_, surface) = reconstruct(&water[..], &of_spacings(backend, cell), &surfacing());
        assert_watertight(&surface.mesh, &format!("cells of {cell}"));
        assert_eq!(measure(&surface.mesh).components, 2, "cells of {cell}");
        let radii = surface.mesh.positions.iter().map(|&p| (DVec3::from(p) - middle).length());
        let air: Vec<f64> = radii.filter(|&radius| radius < 4.0).collect();
        let radius = air.iter().sum::<f64>() / air.len() as f64;
        println!("cells of {cell}: air of {radius}");
        assert!((1.15..1.7).contains(&radius), "cells of {cell}: air of {radius}");
    }
}

pub fn air_bubbles_of_radius_2_spacings_survive_deep_in_water(backend: &TestBackend) {
    // 27 bubbles. The central bubble is at a corner where eight bricks of wide cells meet.
    let places = (0..27).map(|i| IVec3::new(i % 3, i / 3 % 3, i / 9));
    let middles: Vec<DVec3> = places.map(|at| 17.0 * (at - 1).as_dvec3()).collect();
    let deep = |p: DVec3| p.abs().max_element() < 26.0;
    let water =
        fill(26.0, 1.0, 0.2, 4, |p| deep(p) && middles.iter().all(|&m| (p - m).length() > 2.0));
    for cell in [0.5, 0.4, 1.0] {
        let (_, surface) = reconstruct(&water[..], &of_spacings(backend, cell), &surfacing());
        assert_eq!(measure(&surface.mesh).components, 1 + middles.len(), "cells of {cell}");
    }
}

/// The mean height and roughness, in spacings, of the middle of a pool 32 spacings wide. No filter
/// reaches from this area to the pool's edges.
fn level(backend: &TestBackend, cell: f64, smooth: f64) -> (f64, f64) {
    let pool = fill(16.0, 1.0, 0.3, 21, |p| p.z < 0.0 && p.z > -10.0);
    let surfacing = Surfacing { smooth: Smooth::new(smooth).unwrap(), ..surfacing() };
    let (_, surface) = reconstruct(&pool[..], &of_spacings(backend, cell), &surfacing);
    let half = 16.0 - 2.2 * 1.5 * smooth;
    let near = |p: &&[f64; 3]| p[0].abs() < half && p[1].abs() < half && p[2] > -2.0;
    let heights: Vec<f64> = surface.mesh.positions.iter().filter(near).map(|p| p[2]).collect();
    let mean = heights.iter().sum::<f64>() / heights.len() as f64;
    let square = heights.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / heights.len() as f64;
    (mean, square.sqrt())
}

pub fn the_roughness_of_a_pool_is_independent_of_the_cell_size(backend: &TestBackend) {
    let [fine, coarse] = [0.25, 2.0 / 3.0].map(|cell| level(backend, cell, 1.6));
    for (mean, rms) in [fine, coarse] {
        assert!(mean.abs() < 0.03 && rms < 0.05, "{mean}, {rms}");
    }
    assert!((fine.1 / coarse.1 - 1.0).abs() < 0.1, "{fine:?}, {coarse:?}");
}

pub fn wider_smoothing_makes_a_pool_calmer_without_moving_its_level(backend: &TestBackend) {
    let [sharp, usual, calm] = [1.0, 1.6, 3.0].map(|smooth| level(backend, 0.5, smooth));
    println!("{sharp:?}, {usual:?}, {calm:?}");
    assert!(sharp.1 > 1.2 * usual.1 && usual.1 > 1.2 * calm.1, "{sharp:?}, {usual:?}, {calm:?}");
    for (mean, _) in [sharp, usual, calm] {
        assert!(mean.abs() < 0.05, "{sharp:?}, {usual:?}, {calm:?}");
    }
}

pub fn a_tank_in_fine_cells_ends_at_its_walls_for_any_wide_cell_offset(backend: &TestBackend) {
    let walls = DVec3::splat(8.0);
    for (cell, jitter) in [(0.5, 0.3), (0.25, 0.0), (0.25, 0.3)] {
        let particles = fill(8.0, 1.0, jitter, 9, |p| p.y < 0.0);
        for cells in 0..4 {
            let grid = Grid::new(DVec3::splat(-cell * f64::from(cells)), cell).unwrap();
            let domain = Some(Domain::new(&grid, -walls, walls).unwrap());
            let sampling = Sampling { grid, domain, ..of_spacings(backend, cell) };
            let (_, Reconstructed { mesh, .. }) =
                reconstruct(&particles[..], &sampling, &surfacing());
            let what = format!("jitter {jitter}, cells of {cell}, {cells} of them off");
            assert_watertight(&mesh, &what);
            let found = measure(&mesh);
            let ([low, high], volume) = (found.bounds.unwrap(), found.volume.unwrap());
            assert_eq!((low, high[0], high[2]), ((-walls).to_array(), 8.0, 8.0), "{what}");
            // The surface may rise near the walls, because wide cells that cross a wall contain a
            // mirror image of the fluid beyond it.
            println!("{what}: {}, up to {}", volume / 2048.0, high[1]);
            assert!(
                (volume / 2048.0 - 1.0).abs() < 0.02 && high[1] < 0.35,
                "{what}: {volume}, {high:?}"
            );
        }
    }
}

/// This test runs on the CPU only, because a device with too little memory falls back to the CPU.
#[test]
fn scratch_files_do_not_change_the_mesh_in_fine_cells() {
    let Ok(backend) = TestBackend::cpu();
    let mut particles = fill(8.0, 1.0, 0.3, 5, |p| p.length() < 6.0);
    particles.extend((0..40).map(|i| [f64::from(i) * 3.0 - 60.0, 9.0, 0.3]));
    let surfacing = Surfacing { normals: Normals::Gradient, ..surfacing() };
    let whole = of_spacings(&backend, 0.25);
    let (_, expected) = reconstruct(&particles[..], &whole, &surfacing);
    for budget in [1 << 18, 1 << 22].map(MemoryBudget) {
        let resources = Resources { budget, ..whole.resources.clone() };
        let small = Sampling { resources, ..whole.clone() };
        let plan = CountedFrame::of(&particles, &small).unwrap().estimate().plan(budget);
        assert!(matches!(plan, MemoryPlan::OutOfCore(_)), "{budget:?}: the plan spills nothing");
        let (_, surface) = reconstruct(&particles[..], &small, &surfacing);
        assert!(surface.mesh == expected.mesh, "{budget:?}");
    }
}

pub fn splashes_are_watertight_for_all_indicators_filters_and_walls(backend: &TestBackend) {
    for seed in 20..24 {
        let particles = splashes(seed);
        for indicator in INDICATORS {
            for (sigma, detail) in
                [(0.8, Detail::Smoothed), (1.0, Detail::Recovered), (3.0, Detail::Smoothed)]
            {
                for walls in [false, true] {
                    let mut sampling = Sampling { method: indicator.into(), ..backend.sampling() };
                    sampling.domain = walls.then(|| uneven_tank(&sampling.grid));
                    for iso in [None, Some(Isovalue::new(0.1).unwrap())] {
                        let surfacing = Surfacing {
                            sigma: Some(Sigma::new(sigma).unwrap()),
                            detail,
                            iso,
                            ..surfacing()
                        };
                        let (_, Reconstructed { mesh, .. }) =
                            reconstruct(&particles[..], &sampling, &surfacing);
                        assert_watertight(
                            &mesh,
                            &format!("seed {seed}, {indicator:?}, {surfacing:?}, {walls}"),
                        );
                    }
                }
            }
        }
    }
}

pub fn a_half_full_tank_ends_exactly_at_its_walls_and_keeps_its_volume(backend: &TestBackend) {
    // Test walls on cell faces, and walls that divide cells. The lattice does not fill the second
    // tank exactly, so its tolerance is larger.
    for (lo, hi, tolerance) in [(-16.0, 16.0, 0.005), (-15.7, 16.4, 0.03)] {
        let (lo, hi) = (DVec3::splat(lo), DVec3::splat(hi));
        for indicator in INDICATORS {
            let sampling = backend.sampling();
            let domain = Domain::new(&sampling.grid, lo, hi).unwrap();
            let particles =
                fill(20.0, 1.0, 0.3, 9, |p| p.y < 0.0 && p.cmpgt(lo).all() && p.cmplt(hi).all());
            let sampling = Sampling { method: indicator.into(), domain: Some(domain), ..sampling };
            let (_, Reconstructed { mesh, .. }) =
                reconstruct(&particles[..], &sampling, &surfacing());
            assert_watertight(&mesh, "a tank");
            let measures = measure(&mesh);
            let [low, high] = measures.bounds.unwrap();
            assert_eq!(low, lo.to_array());
            assert_eq!((high[0], high[2]), (hi.x, hi.z));
            let volume = (hi.x - lo.x) * -lo.y * (hi.z - lo.z);
            let error = measures.volume.unwrap() / volume - 1.0;
            assert!(error.abs() < tolerance, "{indicator:?}, walls at {lo}: volume off by {error}");
        }
    }
}

pub fn the_surface_of_a_full_tank_is_its_walls(backend: &TestBackend) {
    let walls = DVec3::splat(20.0);
    for indicator in INDICATORS {
        let sampling = backend.sampling();
        let domain = Domain::new(&sampling.grid, -walls, walls).unwrap();
        let particles = fill(20.0, 1.5, 0.3, 9, |p| p.abs().cmplt(walls).all());
        let sampling = Sampling { method: indicator.into(), domain: Some(domain), ..sampling };
        let (_, Reconstructed { mesh, .. }) = reconstruct(&particles[..], &sampling, &surfacing());
        assert_watertight(&mesh, "a full tank");
        let measures = measure(&mesh);
        assert_eq!(measures.bounds, Some([(-walls).to_array(), walls.to_array()]));
        let error = measures.volume.unwrap() / 40.0_f64.powi(3) - 1.0;
        assert!(error.abs() < 0.01, "{indicator:?}: volume off by {error}");
    }
}

pub fn memory_does_not_depend_on_the_distance_between_drops(backend: &TestBackend) {
    let drop = fill(10.0, 2.0, 0.3, 4, |p| p.length() < 6.0);
    let far = |shift: DVec3| drop.iter().map(move |&p| (DVec3::from(p) + shift).to_array());
    let shift = DVec3::new(1e6, -1e6, 5e5);
    let both: Vec<[f64; 3]> = far(-shift).chain(far(shift)).collect();
    let (one_frame, one) = reconstruct(&drop[..], &backend.sampling(), &surfacing());
    let (two_frame, two) = reconstruct(&both[..], &backend.sampling(), &surfacing());
    assert_eq!(dif(&two_frame).dif.full_cells(), 2 * dif(&one_frame).dif.full_cells());
    assert!(dif(&two_frame).dif.sample_bytes() < 3 * dif(&one_frame).dif.sample_bytes());
    assert_watertight(&two.mesh, "two drops");
    assert_eq!(two.mesh.triangles.len(), 2 * one.mesh.triangles.len());
    let area = |mesh: &Mesh| measure(mesh).area;
    assert!((area(&two.mesh) / area(&one.mesh) - 2.0).abs() < 1e-4);
}

pub fn a_lone_particle_is_a_closed_drop_unless_the_isovalue_is_too_high(backend: &TestBackend) {
    let particle = [[0.3, 0.4, -0.6]];
    let (_, surface) = reconstruct(&particle[..], &of_spacings(backend, 1.0), &surfacing());
    assert_watertight(&surface.mesh, "a drop");
    assert_eq!(measure(&surface.mesh).components, 1);
    let frame = Engine::sample(&particle, &backend.sampling(), &mut Timings::default()).unwrap();
    let error = frame.surface(&surfacing(), &mut Timings::default()).unwrap_err();
    assert!(matches!(error, FrameError::NoSurface { .. }), "{error}");
    let iso = Isovalue::new(0.5).unwrap();
    let above = Surfacing { iso: Some(iso), ..surfacing() };
    let error = frame.surface(&above, &mut Timings::default()).unwrap_err();
    assert!(matches!(error, FrameError::NoSurface { iso: found } if found == iso), "{error}");
}

pub fn a_million_coincident_particles_become_one_drop_or_an_error(backend: &TestBackend) {
    let particles = vec![[0.25, 0.25, 0.25]; 1_000_000];
    for indicator in INDICATORS {
        let surface = Engine::sample(
            &particles,
            &Sampling { method: indicator.into(), spacing: Some(1.0), ..backend.sampling() },
            &mut Timings::default(),
        )
        .and_then(|frame| frame.surface(&surfacing(), &mut Timings::default()));
        match (indicator, surface) {
            (IndicatorKind::Cloud, Ok(surface)) => {
                let mesh = surface.to_mesh().unwrap();
                assert_watertight(&mesh, "coincident particles");
                assert_eq!(measure(&mesh).components, 1);
            }
            (IndicatorKind::Symmetry, Err(FrameError::NoSurface { .. })) => {}
            // The 16-bit samples cannot represent a mean count of a million particles per cell.
            (IndicatorKind::Counting, Err(FrameError::MeanCount(_))) => {}
            (indicator, other) => panic!("{indicator:?} gave {other:?}"),
        }
    }
}

pub fn attributes_are_interpolated_smoothly_for_any_particle_order(backend: &TestBackend) {
    // The velocities are a rigid rotation about y. One particle has no velocity along y, and one
    // value is NaN.
    let rotation = |i: usize, [x, _, z]: [f64; 3]| {
        [if i == 18 { f32::NAN } else { 3.0 * z as f32 }, f32::from(i != 17) * 0.5, -3.0 * x as f32]
    };
    let mut ball = fill(20.0, 2.0, 0.3, 5, |p| p.length() < 12.0);
    let moving = Attributed::new(ball.clone()).with("v", rotation);
    let sampling = Sampling { carried: vec![0], ..backend.sampling() };
    let (_, first) = reconstruct(&moving, &sampling, &surfacing());
    let [velocity] = &first.mesh.attributes[..] else { panic!("expected one attribute") };
    assert_eq!(velocity.values.len(), 3 * first.mesh.positions.len());
    for (&[x, _, z], v) in first.mesh.positions.iter().zip(velocity.values.chunks_exact(3)) {
        // The tolerance is large, because values come from particles up to two cells below the
        // surface.
        assert!((f64::from(v[0]) - 3.0 * z).abs() < 6.0 && (f64::from(v[2]) + 3.0 * x).abs() < 6.0);
        assert!((v[1] - 0.5).abs() < 0.1);
    }
    ball.swap(100, 5000);
    let moving = Attributed::new(ball).with("v", rotation);
    let (_, second) = reconstruct(&moving, &sampling, &surfacing());
    assert!(first.mesh == second.mesh, "values depend on the order of the particles");
}
