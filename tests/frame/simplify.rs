//! Tests of simplified surfaces: they are manifold, near the original, and the same on every
//! machine. Drops remain unless an option removes them.

use std::collections::HashMap;

use glam::{DVec3, IVec3};
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::frame::{Engine, Normals, Sampling, Surfacing};
use meniscus::internals::grid::units::Tolerance;
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::check::check;
use meniscus::internals::surface::mesh::compare::compare;
use meniscus::internals::surface::mesh::measure::measure;
use meniscus::internals::surface::mesh::source::MeshSource;
use meniscus::internals::surface::simplify::{Reduction, TriangleSpace, simplify};
use meniscus::internals::surface::stitch::StitchedSurface;
use meniscus::internals::system::control::Control;
use meniscus::internals::system::timings::Timings;

use crate::common::scene::Random;
use crate::common::{INDICATORS, fill, sampling, splashes, surfacing};

fn surface(particles: &[[f64; 3]], sampling: &Sampling) -> StitchedSurface {
    let surfacing = Surfacing { normals: Normals::Gradient, ..surfacing() };
    let frame = Engine::sample(&particles, sampling, &mut Timings::default()).unwrap();
    frame.surface(&surfacing, &mut Timings::default()).unwrap()
}

fn within(cells: f64) -> Reduction {
    Reduction { tolerance: Some(Tolerance::new(cells).unwrap()), ..Reduction::default() }
}

fn without(volume: f64) -> Reduction {
    Reduction { smallest_component: Some(volume), ..Reduction::default() }
}

fn collected(source: &dyn MeshSource) -> Mesh {
    let mut mesh = Mesh { normals: source.has_normals().then(Vec::new), ..Mesh::default() };
    for piece in 0..source.pieces() {
        let vertices = source.vertices(piece).unwrap();
        mesh.positions.extend_from_slice(&vertices.positions);
        mesh.normals.as_mut().unwrap().extend_from_slice(&vertices.normals);
        let triangles = source.triangles(piece).unwrap();
        mesh.triangles.extend(triangles.into_iter().map(|t| t.map(|v| u32::try_from(v).unwrap())));
    }
    assert_eq!(mesh.positions.len() as u64, source.vertex_count());
    assert_eq!(mesh.triangles.len() as u64, source.triangle_count());
    mesh
}

fn simplified(particles: &[[f64; 3]], sampling: &Sampling, reduction: &Reduction) -> (Mesh, u64) {
    let particle = sampling.spacing.unwrap_or(1.0).powi(3);
    let surface = surface(particles, sampling);
    let room = TriangleSpace { bytes: u64::MAX, folder: &std::env::temp_dir() };
    let result = simplify(surface, reduction, particle, room, &Control::default()).unwrap();
    (collected(&result), result.too_small().total())
}

#[test]
fn simplification_keeps_topology_and_stays_within_the_tolerance() {
    for indicator in INDICATORS {
        for seed in [1, 2] {
            let (particles, sampling) =
                (splashes(seed), Sampling { method: indicator.into(), ..sampling() });
            let whole = surface(&particles, &sampling).to_mesh().unwrap();
            for cells in [0.05, 0.1, 0.25, 0.5, 2.0] {
                let (mesh, _) = simplified(&particles, &sampling, &within(cells));
                let what = format!("{indicator:?}, splashes {seed}, {cells} cells");
                let report = check(&mesh);
                assert!(report.is_closed_oriented_manifold(), "{what}: {report}");
                assert_eq!(report.topology.unreferenced_vertices.count, 0, "{what}");
                let distance = compare(&whole, &mesh).unwrap().hausdorff;
                assert!(distance <= cells, "{what}: {distance}");
                assert!(mesh.triangles.len() < whole.triangles.len(), "{what}");
                let shape = |mesh: &Mesh| {
                    let measures = measure(mesh);
                    (measures.components, measures.genus)
                };
                assert_eq!(shape(&mesh), shape(&whole), "{what}");
            }
        }
    }
}

#[test]
fn simplification_removes_most_slivers_and_adds_none_to_flat_surfaces() {
    // The number of triangles with an angle of less than 10 degrees.
    let slivers = |mesh: &Mesh| measure(mesh).quality.least_angles[..2].iter().sum::<usize>();
    for (what, particles, share) in [("splashes", splashes(5), 8), ("pool", pool(), 2)] {
        for indicator in INDICATORS {
            let sampling = Sampling { method: indicator.into(), ..sampling() };
            let whole = slivers(&surface(&particles, &sampling).to_mesh().unwrap());
            for cells in [0.05, 0.1, 0.5] {
                let left = slivers(&simplified(&particles, &sampling, &within(cells)).0);
                // With clouds, drops are curved everywhere, so simplifying removes fewer slivers.
                let share =
                    if matches!(indicator, IndicatorKind::Cloud) { share.min(4) } else { share };
                // A calm pool has almost no slivers.
                assert!(
                    left <= (whole / share).max(30),
                    "{what}, {indicator:?}, {cells} cells: {left} of {whole}"
                );
            }
        }
    }
}

#[test]
fn remaining_vertices_keep_their_positions_and_normals() {
    let particles = splashes(3);
    let whole = surface(&particles, &sampling()).to_mesh().unwrap();
    let bits = |p: &[f64; 3]| p.map(f64::to_bits);
    let normals = whole.normals.as_ref().unwrap();
    let known: HashMap<_, _> = whole.positions.iter().map(bits).zip(normals).collect();
    let (mesh, _) = simplified(&particles, &sampling(), &within(0.25));
    assert!(
        (100..known.len()).contains(&mesh.positions.len()),
        "{} vertices remain",
        mesh.positions.len()
    );
    for (position, normal) in mesh.positions.iter().zip(mesh.normals.as_ref().unwrap()) {
        assert_eq!(known.get(&bits(position)), Some(&normal));
    }
}

#[test]
fn simplification_is_independent_of_threads_and_scratch_files() {
    let particles = splashes(4);
    let reduction = Reduction { smallest_component: Some(5.0), ..within(0.1) };
    let run = |threads: usize, bytes: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let scratch = std::env::temp_dir();
        pool.install(|| {
            let (surface, room) =
                (surface(&particles, &sampling()), TriangleSpace { bytes, folder: &scratch });
            collected(&simplify(surface, &reduction, 1.0, room, &Control::default()).unwrap())
        })
    };
    let first = run(1, u64::MAX);
    for (threads, bytes) in [(1, 0), (2, u64::MAX), (3, 0)] {
        assert_eq!(run(threads, bytes), first, "{threads} threads, {bytes} bytes in memory");
    }
}

/// A slab of fluid that extends across many chunks of the simplification.
fn pool() -> Vec<[f64; 3]> {
    fill(70.0, 1.0, 0.0, 1, |p| p.y.abs() < 8.0 && p.x.abs() < 69.0 && p.z.abs() < 69.0)
}

#[test]
fn a_flat_pool_is_simplified_across_block_seams() {
    let (mesh, _) = simplified(&pool(), &sampling(), &within(0.1));
    // A single pass would keep a vertex in every cell along the seams between chunks, on both sides
    // of the slab: 2384 vertices.
    let flat = |p: &&[f64; 3]| p[0].abs() < 66.0 && p[2].abs() < 66.0;
    let count = mesh.positions.iter().filter(flat).count();
    assert!(count < 1000, "{count} vertices remain on the flat surface");
}

#[test]
fn small_drops_survive_the_largest_tolerance() {
    let mut particles = fill(12.0, 1.0, 0.0, 1, |p| p.length() < 10.0);
    // Add small drops in the middle of a block, on a corner of blocks, and across two chunks.
    let drop = fill(4.0, 2.0, 0.0, 1, |p| p.length() < 1.8);
    for centre in [[20.5, 0.5, 0.5], [32.0, 32.0, 32.0], [32.0, 64.0, 0.5]] {
        particles.extend(drop.iter().map(|&p| (DVec3::from(p) + DVec3::from(centre)).to_array()));
    }
    let whole = measure(&surface(&particles, &sampling()).to_mesh().unwrap());
    assert_eq!(whole.components, 4);
    let (mesh, dropped) = simplified(&particles, &sampling(), &within(Tolerance::MAX));
    let measures = measure(&mesh);
    assert_eq!((measures.components, dropped), (4, 0));
    assert!(check(&mesh).is_closed_oriented_manifold());
}

#[test]
fn components_below_the_volume_are_removed_across_blocks() {
    // A ball with a volume of about 113 cells around a corner of eight blocks, a ball of 33 cells
    // in the middle of a block, and a ball of 905 cells far away.
    let balls = [(DVec3::ZERO, 3.0), (DVec3::splat(16.0), 2.0), (DVec3::new(3e5, -4e5, 0.0), 6.0)];
    let particles: Vec<[f64; 3]> = balls
        .iter()
        .flat_map(|&(centre, radius)| {
            let ball = fill(8.0, 2.0, 0.0, 1, |p| p.length() < radius);
            ball.into_iter().map(move |p| (DVec3::from(p) + centre).to_array())
        })
        .collect();
    let whole = surface(&particles, &sampling()).to_mesh().unwrap();
    for (volume, left) in [(1.0, 3), (60.0, 2), (300.0, 1), (2000.0, 0)] {
        for reduction in
            [without(volume), Reduction { smallest_component: Some(volume), ..within(0.1) }]
        {
            let (mesh, dropped) = simplified(&particles, &sampling(), &reduction);
            let report = check(&mesh);
            assert!(report.is_closed_oriented_manifold(), "{reduction:?}: {report}");
            assert_eq!(
                (measure(&mesh).components, dropped),
                (left, 3 - left as u64),
                "{reduction:?}"
            );
            if left == 3 && reduction.tolerance.is_none() {
                assert_eq!(mesh.triangles.len(), whole.triangles.len());
                assert_eq!(measure(&mesh).volume.map(f32_of), measure(&whole).volume.map(f32_of));
            }
        }
    }
}

#[test]
fn a_drop_on_a_corner_of_eight_blocks_is_one_component() {
    // Put the drop around the origin, where eight blocks meet. Each pair of blocks shares few
    // vertices, and some vertices are shared by three or more blocks.
    let places = [-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0];
    for (x, y, z) in
        places.iter().flat_map(|x| places.iter().flat_map(move |y| places.map(|z| (*x, *y, z))))
    {
        let drop = fill(4.0, 2.0, 0.0, 1, |p| p.length() < 1.0);
        let drop: Vec<_> =
            drop.iter().map(|&p| (DVec3::from(p) + DVec3::new(x, y, z)).to_array()).collect();
        let (mesh, dropped) = simplified(&drop, &sampling(), &without(1e3));
        assert_eq!((mesh.triangles.len(), dropped), (0, 1), "drop at {x}, {y}, {z}");
    }
}

#[test]
fn smallest_drop_counts_particles_for_any_cell_size_and_keeps_bubbles() {
    let mut particles = fill(8.0, 1.0, 0.0, 1, |p| p.length() > 3.0);
    let mut random = Random::new(5);
    for i in 0..12_i32 {
        let at = DVec3::new(f64::from(i % 4) * 8.0 - 12.0, f64::from(i / 4) * 8.0 + 16.0, 0.0);
        let at = at + DVec3::new(random.unit(), random.unit(), random.unit());
        let own = match i % 3 {
            0 => vec![DVec3::ZERO],
            1 => vec![DVec3::ZERO, DVec3::X],
            _ => (0..8).map(|k| IVec3::new(k & 1, k >> 1 & 1, k >> 2).as_dvec3()).collect(),
        };
        particles.extend(own.into_iter().map(|p| (at + p).to_array()));
    }
    for cells in [1.5, 2.0, 3.0, 4.0] {
        let scaled: Vec<_> = particles.iter().map(|p| p.map(|x| x * cells)).collect();
        let sampling =
            Sampling { method: IndicatorKind::Cloud.into(), spacing: Some(cells), ..sampling() };
        for (particles, dropped) in [(1, 0), (2, 4), (3, 8), (8, 8), (20, 12)] {
            let reduction = Reduction { smallest_drop: Some(particles), ..Reduction::default() };
            let (mesh, gone) = simplified(&scaled, &sampling, &reduction);
            assert_eq!(
                gone, dropped,
                "smallest drop of {particles} particles, cells of 1/{cells} spacings"
            );
            // Two components always remain: the bulk, and the bubble in it.
            assert_eq!(measure(&mesh).components as u64, 2 + 12 - dropped);
            assert!(check(&mesh).is_closed_oriented_manifold());
        }
    }
}

fn f32_of(value: f64) -> f32 {
    value as f32
}
