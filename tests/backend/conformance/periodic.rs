//! Tests of periodic boxes: the mesh equals the mesh of a fluid with explicit copies of its
//! particles.

use glam::DVec3;
use meniscus::internals::backend::Backend;
use meniscus::internals::field::calibration::Calibration;
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::frame::{Engine, Method, Normals, Sampling, Surfacing};
use meniscus::internals::grid::{Domain, Grid, Periodic, PeriodicMesh};
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::check::check;
use meniscus::internals::surface::mesh::measure::measure;
use meniscus::internals::system::timings::Timings;

use super::TestBackend;
use crate::common::periodic::{Faces, fluid, repeated, triangles_within, unwrapped};
use crate::common::{INDICATORS, surfacing};

/// Settings for an indicator and a cell size, with particles 1 apart.
fn sampling(backend: &TestBackend, kind: IndicatorKind, cell: f64) -> Sampling {
    let grid = Grid::new(DVec3::ZERO, cell).unwrap();
    Sampling {
        method: kind.into(),
        grid,
        spacing: Some(1.0),
        side: kind.brick_side(),
        ..backend.sampling()
    }
}

fn in_box(sampling: &Sampling, surfacing: &Surfacing, faces: Faces) -> Sampling {
    let reach = surfacing.reach(sampling.method, sampling.spacing, None, &sampling.grid);
    let periodic = Periodic::new(&sampling.grid, faces, reach).unwrap();
    Sampling { periodic: Some(periodic), ..sampling.clone() }
}

/// Reconstructs particles, and returns the mesh and the calibration.
fn meshed(
    particles: &[[f64; 3]],
    sampling: &Sampling,
    surfacing: &Surfacing,
    known: Option<&Calibration>,
) -> (Mesh, Option<Calibration>) {
    let timings = &mut Timings::default();
    let frame = Engine::sample(&particles, sampling, timings).unwrap();
    let calibrated = frame.calibrate(surfacing, known, timings).unwrap();
    let measured = calibrated.measured().map(|measured| measured.calibration);
    (calibrated.surface(timings).unwrap().to_mesh().unwrap(), measured)
}

fn assert_watertight(mesh: &Mesh, what: &str) {
    let report = check(mesh);
    assert!(report.is_closed_oriented_manifold(), "{what}: {report}");
}

pub fn a_periodic_mesh_equals_the_mesh_of_repeated_particles(backend: &TestBackend) {
    let edges = DVec3::new(32.0, 40.0, 24.0);
    let particles = fluid(5, edges);
    let along = |axis: usize| Some([0.0, edges[axis]]);
    let open = [f64::NEG_INFINITY, f64::INFINITY];
    for (faces, walls) in [
        ([along(0), along(1), along(2)], None),
        ([along(0), None, along(2)], None),
        ([along(0), None, None], Some([open, [1.0, 30.0], [2.0, 21.0]])),
    ] {
        for kind in INDICATORS {
            let cell = if kind == IndicatorKind::Cloud { 0.5 } else { 1.0 };
            let mut sampling = sampling(backend, kind, cell);
            sampling.domain = walls.map(|walls| {
                let [lo, hi] =
                    [0, 1].map(|side: usize| DVec3::from(walls.map(|walls| walls[side])));
                Domain::new(&sampling.grid, lo, hi).unwrap()
            });
            for mesh in [PeriodicMesh::Cut, PeriodicMesh::Overlap] {
                let surfacing =
                    Surfacing { normals: Normals::Gradient, periodic_mesh: mesh, ..surfacing() };
                let in_box = in_box(&sampling, &surfacing, faces);
                let (found, calibration) = meshed(&particles, &in_box, &surfacing, None);
                let what = format!("{faces:?}, walls {walls:?}, {kind:?}, {mesh:?}");
                assert_watertight(&found, &what);

                let mean = calibration.and_then(|known| known.mean());
                let method = Method::Indicator { kind, mean };
                // The CPU makes the expected mesh, because there are many repeated particles.
                let mut alone = Sampling { method, ..sampling.clone() };
                alone.resources.backend = Backend::cpu();
                let (expected, _) =
                    meshed(&repeated(&particles, faces), &alone, &surfacing, calibration.as_ref());
                // Near the faces, a cut mesh differs, because it is cut between the outermost cell
                // centres and the faces, and because gradients end there.
                let margin = if mesh == PeriodicMesh::Cut { 1.51 * cell } else { 0.0 };
                let [found, expected] =
                    [&found, &expected].map(|mesh| triangles_within(mesh, faces, margin));
                assert!(expected.len() > 1000, "{what}: {} triangles", expected.len());
                assert!(
                    found == expected,
                    "{what}: {} and {} triangles",
                    found.len(),
                    expected.len()
                );
            }
        }
    }
}

pub fn the_surface_of_a_full_periodic_box_is_its_faces(backend: &TestBackend) {
    // The box is so large that blocks deep in it are skipped, and its faces are not cell faces.
    let edge = 61.3;
    let steps = || (0..61).map(|i| (f64::from(i) + 0.5) * edge / 61.0);
    let particles: Vec<[f64; 3]> =
        steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z]))).collect();
    for cell in [0.9, 0.5] {
        let in_box = in_box(
            &sampling(backend, IndicatorKind::Cloud, cell),
            &surfacing(),
            [Some([0.0, edge]); 3],
        );
        let (mesh, _) = meshed(&particles, &in_box, &surfacing(), None);
        assert_watertight(&mesh, "a full box");
        let found = measure(&mesh);
        assert_eq!(found.bounds, Some([[0.0; 3], [edge; 3]]), "cells of {cell}");
        assert_eq!((found.components, found.genus), (1, Some(0)), "cells of {cell}");
        let share = found.volume.unwrap() / edge.powi(3);
        // The mesh cuts off at most one cell along the edges of the box.
        assert!((1.0 - share).abs() < 0.005, "cells of {cell}: {share}");
    }
}

pub fn a_periodic_mesh_is_the_same_on_every_backend(backend: &TestBackend) {
    // The box's edge lengths are not multiples of the width of cells or wide cells.
    let edges = DVec3::new(31.0, 40.0, 29.0);
    let particles = fluid(9, edges);
    for (kind, cell) in
        [(IndicatorKind::Cloud, 0.3), (IndicatorKind::Cloud, 0.7), (IndicatorKind::Counting, 0.7)]
    {
        for mesh in [PeriodicMesh::Cut, PeriodicMesh::Overlap] {
            let surfacing =
                Surfacing { normals: Normals::Gradient, periodic_mesh: mesh, ..surfacing() };
            let faces = [Some([0.0, edges.x]), None, Some([0.0, edges.z])];
            let in_box = in_box(&sampling(backend, kind, cell), &surfacing, faces);
            let (found, _) = meshed(&particles, &in_box, &surfacing, None);
            let mut on_cpu = in_box.clone();
            on_cpu.resources.backend = Backend::cpu();
            let (expected, _) = meshed(&particles, &on_cpu, &surfacing, None);
            assert_watertight(&found, &format!("{kind:?}, {mesh:?}"));
            assert!(found == expected, "{kind:?}, cells of {cell}, {mesh:?}");
        }
    }
}

pub fn wrapped_particles_give_the_same_mesh_on_every_backend(backend: &TestBackend) {
    let edges = DVec3::new(31.0, 40.0, 29.0);
    let faces = [Some([0.0, edges.x]), None, Some([0.0, edges.z])];
    let inside = fluid(27, edges);
    let (outside, count) = unwrapped(&inside, faces);
    assert!(count > 100, "{count} particles outside the box");
    for (kind, cell) in [(IndicatorKind::Cloud, 0.7), (IndicatorKind::Counting, 0.7)] {
        let in_box = in_box(&sampling(backend, kind, cell), &surfacing(), faces);
        let (found, _) = meshed(&outside, &in_box, &surfacing(), None);
        let mut on_cpu = in_box.clone();
        on_cpu.resources.backend = Backend::cpu();
        let (expected, _) = meshed(&inside, &on_cpu, &surfacing(), None);
        assert!(found == expected, "{kind:?}");
    }
}
