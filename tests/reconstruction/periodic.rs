//! Tests of periodic boxes in the library and the program: surfaces, counts, states and errors.

use std::fs;

use glam::DVec3;
use meniscus::error::{Error, FrameError};
use meniscus::internals::baselines::KernelMethod;
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::frame::estimate::MemoryPlan;
use meniscus::internals::frame::{
    CountedFrame, Engine, Method, Normals, Resources, Sampling, Surfacing,
};
use meniscus::internals::grid::units::{Isovalue, MemoryBudget};
use meniscus::internals::grid::{Grid, Periodic};
use meniscus::internals::io::output::read_mesh;
use meniscus::internals::particles::Particles;
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::check::check;
use meniscus::internals::surface::mesh::measure::measure;
use meniscus::internals::system::timings::Timings;
use meniscus::{PeriodicMesh, Reconstruction, Warning};
use tempfile::TempDir;

use crate::common::attributed::Attributed;
use crate::common::files::{bytes_of, raw};
use crate::common::periodic::{Faces, fluid, repeated, triangles_within, unwrapped};
use crate::common::program::{command, run};
use crate::common::scene::Random;
use crate::common::{fill, sampling, shuffle, surfacing};

const METHODS: [KernelMethod; 3] = [
    KernelMethod::Mueller { iso: 0.5 },
    KernelMethod::ZhuBridson,
    KernelMethod::YuTurk { iso: 0.4 },
];

/// Particles with an attribute "direction". The direction of particle i is computed from the
/// coordinates of particle i of `first`, and further particles repeat these directions. Every
/// direction has a component of 1, which is also the greatest magnitude. Therefore, the library
/// rounds the attribute in the same way in every block that contains particles.
fn with_directions(particles: &[[f64; 3]], first: &[[f64; 3]]) -> Attributed {
    let direction = |[x, _, z]: [f64; 3]| [(x as f32).sin(), 1.0, (z as f32).cos()];
    Attributed::new(particles.to_vec()).with("direction", |i, _| direction(first[i % first.len()]))
}

fn assert_watertight(mesh: &Mesh, what: &str) {
    let report = check(mesh);
    assert!(report.is_closed_oriented_manifold(), "{what}: {report}");
}

/// Settings for a periodic box, with spacing 1 and this cell size.
fn in_box(method: impl Into<Method>, cell: f64, faces: Faces) -> Sampling {
    let (method, grid) = (method.into(), Grid::new(DVec3::ZERO, cell).unwrap());
    let periodic =
        Periodic::new(&grid, faces, surfacing().reach(method, Some(1.0), None, &grid)).unwrap();
    let periodic = Some(periodic);
    Sampling { method, grid, periodic, spacing: Some(1.0), side: method.brick_side(), ..sampling() }
}

fn meshed(
    particles: &(impl Particles + ?Sized),
    sampling: &Sampling,
    surfacing: &Surfacing,
) -> (Engine, Mesh) {
    let timings = &mut Timings::default();
    let frame = Engine::sample(&particles, sampling, timings).unwrap();
    let mesh = frame.surface(surfacing, timings).unwrap().to_mesh().unwrap();
    (frame, mesh)
}

#[test]
fn kernel_methods_in_a_periodic_box_match_repeated_particles() {
    let edges = DVec3::new(24.0, 32.0, 24.0);
    let faces = [Some([0.0, edges.x]), None, Some([0.0, edges.z])];
    let particles = fluid(7, edges);
    for method in METHODS {
        let sampling = in_box(method, 1.0, faces);
        let alone = Sampling { periodic: None, ..sampling.clone() };
        for periodic_mesh in [PeriodicMesh::Cut, PeriodicMesh::Overlap] {
            let surfacing = Surfacing { normals: Normals::Gradient, periodic_mesh, ..surfacing() };
            let (_, found) = meshed(&particles[..], &sampling, &surfacing);
            assert_watertight(&found, &format!("{method:?}, {periodic_mesh:?}"));
            let (_, expected) = meshed(&repeated(&particles, faces)[..], &alone, &surfacing);
            let margin = if periodic_mesh == PeriodicMesh::Cut { 1.51 } else { 0.0 };
            let [found, expected] =
                [found, expected].map(|mesh| triangles_within(&mesh, faces, margin));
            assert!(found.len() > 1000 && found == expected, "{method:?}, {periodic_mesh:?}");
        }
    }
}

#[test]
fn attributes_are_interpolated_across_periodic_faces() {
    let edges = DVec3::new(32.0, 40.0, 24.0);
    let faces = [Some([0.0, edges.x]), Some([0.0, edges.y]), Some([0.0, edges.z])];
    let fluid = fluid(3, edges);
    let particles = with_directions(&fluid, &fluid);
    let sampling = Sampling { carried: vec![0], ..in_box(IndicatorKind::Cloud, 0.5, faces) };
    let surfacing = Surfacing { periodic_mesh: PeriodicMesh::Overlap, ..surfacing() };
    let (_, found) = meshed(&particles, &sampling, &surfacing);
    let alone = Sampling { periodic: None, ..sampling };
    let around = with_directions(&repeated(&fluid, faces), &fluid);
    let (frame, calibrated) =
        (Engine::sample(&around, &alone, &mut Timings::default()).unwrap(), {
            let frame = Engine::sample(
                &particles,
                &in_box(IndicatorKind::Cloud, 0.5, faces),
                &mut Timings::default(),
            );
            surfacing.calibrate(frame.unwrap().dif().unwrap()).unwrap().calibration
        });
    let timings = &mut Timings::default();
    let expected =
        frame.calibrate(&surfacing, Some(&calibrated), timings).unwrap().surface(timings).unwrap();
    let [found, expected] =
        [found, expected.to_mesh().unwrap()].map(|mesh| triangles_within(&mesh, faces, 0.0));
    assert!(
        found.len() > 5000 && found == expected,
        "{} and {} triangles",
        found.len(),
        expected.len()
    );
}

#[test]
fn a_periodic_mesh_is_independent_of_order_threads_and_memory() {
    let edges = DVec3::new(31.0, 40.0, 29.0);
    let faces = [Some([0.0, edges.x]), None, Some([0.0, edges.z])];
    let fluid = fluid(11, edges);
    let particles = with_directions(&fluid, &fluid);
    let surfacing = Surfacing { normals: Normals::Gradient, ..surfacing() };
    let scratch = TempDir::new().unwrap();
    for kind in crate::common::INDICATORS {
        let sampling = Sampling { carried: vec![0], ..in_box(kind, 0.9, faces) };
        let (_, expected) = meshed(&particles, &sampling, &surfacing);
        assert_watertight(&expected, &format!("{kind:?}"));
        let mut shuffled = fluid.clone();
        shuffle(&mut shuffled, &mut Random::new(1));
        let shuffled = with_directions(&shuffled, &shuffled);
        for (budget, threads) in [(1 << 18, 1), (1 << 20, 3), (8 << 30, 4)] {
            let resources = Resources::new(MemoryBudget(budget), scratch.path().to_owned());
            let sampling = Sampling { resources, ..sampling.clone() };
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let plan = CountedFrame::of(&shuffled, &sampling)
                    .unwrap()
                    .estimate()
                    .plan(MemoryBudget(budget));
                assert_eq!(
                    matches!(plan, MemoryPlan::OutOfCore(_)),
                    budget < 1 << 30,
                    "{budget} bytes"
                );
                let (_, mesh) = meshed(&shuffled, &sampling, &surfacing);
                assert!(mesh == expected, "{kind:?}, {budget} bytes, {threads} threads");
            });
        }
    }
}

#[test]
fn particles_slightly_outside_a_periodic_box_are_wrapped_into_it() {
    let edges = DVec3::new(31.0, 40.0, 29.0);
    let faces = [Some([0.0, edges.x]), None, Some([0.0, edges.z])];
    let fluid = fluid(23, edges);
    let (outside, count) = unwrapped(&fluid, faces);
    assert!(count > 100, "{count} particles outside the box");
    let [inside, outside] = [&fluid, &outside].map(|particles| with_directions(particles, &fluid));
    let scratch = TempDir::new().unwrap();
    for kind in crate::common::INDICATORS {
        let sampling = Sampling { carried: vec![0], ..in_box(kind, 0.9, faces) };
        let (_, expected) = meshed(&inside, &sampling, &surfacing());
        for budget in [1 << 18, 8 << 30] {
            let resources = Resources::new(MemoryBudget(budget), scratch.path().to_owned());
            let sampling = Sampling { resources, ..sampling.clone() };
            let (frame, mesh) = meshed(&outside, &sampling, &surfacing());
            assert!(mesh == expected, "{kind:?}, {budget} bytes");
            let census = frame.facts().census;
            assert_eq!((census.binned, census.outside), (fluid.len(), 0));
            assert_eq!(census.wrapped, count);
        }
    }
}

/// The mean height of the mesh's upper side, at these distances from the box's faces along x and z.
fn level(mesh: &Mesh, edge: f64, distances: std::ops::Range<f64>) -> f64 {
    let from_faces = |p: &&[f64; 3]| {
        let from = |x: f64| x.min(edge - x);
        distances.contains(&from(p[0]).min(from(p[2]))) && p[1] > 4.0
    };
    let heights: Vec<f64> = mesh.positions.iter().filter(from_faces).map(|p| p[1]).collect();
    assert!(heights.len() > 100);
    heights.iter().sum::<f64>() / heights.len() as f64
}

#[test]
fn a_periodic_slab_is_as_high_at_the_faces_as_elsewhere() {
    let edge = 40.0;
    let particles: Vec<[f64; 3]> = fill(20.0, 1.0, 0.3, 5, |p| (-20.0..-12.0).contains(&p.y))
        .into_iter()
        .map(|p| [(p[0] + 20.0).rem_euclid(edge), p[1] + 20.0, (p[2] + 20.0).rem_euclid(edge)])
        .collect();
    let usual = || Reconstruction::new().spacing(1.0).cell(0.47);
    let periodic = usual().periodic([Some([0.0, edge]), None, Some([0.0, edge])]);
    for ends in [PeriodicMesh::Cut, PeriodicMesh::Overlap] {
        let mesh =
            periodic.clone().periodic_mesh(ends).run(&particles[..]).unwrap().to_mesh().unwrap();
        let (near, far) = (level(&mesh, edge, 0.5..1.5), level(&mesh, edge, 6.0..20.0));
        assert!((near - far).abs() < 0.02, "{ends:?}: {near} at the faces, {far} elsewhere");
    }
    // Without a periodic box, the surface is rounded off at the end of the fluid.
    let alone = usual().run(&particles[..]).unwrap().to_mesh().unwrap();
    assert!(level(&alone, edge, 6.0..20.0) - level(&alone, edge, 0.5..1.5) > 0.02);
}

#[test]
fn a_drop_across_a_periodic_corner_is_cut_into_eight_pieces() {
    let edge = 31.7;
    let ball = fill(20.0, 1.0, 0.2, 9, |p| p.length() < 7.0);
    let at = |centre: f64| -> Vec<[f64; 3]> {
        ball.iter().map(|p| p.map(|x| (x + centre).rem_euclid(edge))).collect()
    };
    let periodic = Reconstruction::new().spacing(1.0).periodic([Some([0.0, edge]); 3]);
    let whole = periodic.run(&at(edge / 2.0)[..]).unwrap().to_mesh().unwrap();
    let cut = periodic.run(&at(0.3)[..]).unwrap().to_mesh().unwrap();
    let [whole, found] = [&whole, &cut].map(|mesh| {
        assert_watertight(mesh, "a drop");
        measure(mesh)
    });
    assert_eq!((whole.components, found.components), (1, 8));
    assert_eq!(found.bounds, Some([[0.0; 3], [edge; 3]]), "the pieces must end on the faces");
    let share = found.volume.unwrap() / whole.volume.unwrap();
    assert!((0.97..1.001).contains(&share), "{share} of the drop");
}

#[test]
fn periodic_images_are_not_counted_as_particles() {
    let edges = DVec3::new(32.0, 32.0, 32.0);
    let faces = [Some([0.0, 32.0]), None, Some([0.0, 32.0])];
    let mut particles = fluid(13, edges);
    particles.retain(|p| p[1] < 12.0);
    // Add single particles along an edge of the box. Each has three images.
    particles.extend((0..30).map(|i| [0.25, 40.0 + 6.0 * f64::from(i), 31.75]));
    let counting = in_box(IndicatorKind::Counting, 1.0, faces);
    let (frame, _) = meshed(&particles[..], &counting, &surfacing());
    assert_eq!(frame.facts().census.binned, particles.len());
    let alone = Sampling { periodic: None, ..counting };
    let expected = Engine::sample(&particles, &alone, &mut Timings::default()).unwrap();
    let mean = |frame: &Engine| frame.dif().unwrap().indicator.mean();
    assert_eq!(mean(&frame), mean(&expected), "the mean count of the periodic box differs");

    let timings = &mut Timings::default();
    let mut shares = Vec::new();
    for periodic_mesh in [PeriodicMesh::Cut, PeriodicMesh::Overlap] {
        let usual = Surfacing { periodic_mesh, ..surfacing() };
        let surface = frame.surface(&usual, timings).unwrap();
        let lost = frame.lost(&surface).unwrap();
        assert!(
            (25..=45).contains(&lost),
            "{periodic_mesh:?}: {lost} particles are lost, not about 30 plus some of the spray"
        );
        assert_eq!(frame.shortfall(&surface).unwrap(), None, "{periodic_mesh:?}");
        // Choose an isovalue that almost no sample exceeds.
        let high = Surfacing { iso: Some(Isovalue::new(0.95).unwrap()), ..usual };
        let surface = frame.surface(&high, timings).unwrap();
        shares.push(frame.shortfall(&surface).unwrap().expect("the surface lacks volume"));
    }
    assert_eq!(shares[0].particles, particles.len());
    assert!((shares[0].share / shares[1].share - 1.0).abs() < 0.05, "{shares:?}");
}

#[test]
fn settings_that_need_more_periodic_images_than_sampled_are_refused() {
    let edges = DVec3::new(32.0, 40.0, 32.0);
    let faces = [Some([0.0, 32.0]), None, Some([0.0, 32.0])];
    let request = Reconstruction::new().spacing(1.0).periodic(faces);
    let frame = request.sample(&fluid(15, edges)[..]).unwrap();
    let surface = |request: &Reconstruction| frame.surface_by(request);
    // Narrower filters need fewer images.
    assert!(surface(&request.clone().smooth(1.0)).is_ok());
    let error = surface(&request.smooth(2.5)).unwrap_err();
    assert_eq!(error.cause(), meniscus::Cause::Request);
    let Error::Frame { fault: FrameError::FewImages { needed, there }, .. } = error else {
        panic!("{error}")
    };
    assert!(needed > there, "{needed} cells of images are needed, {there} exist");
}

/// A pool with spacing 1 in a box from 0 to 24 along x and z, and its file `pool.xyz`.
fn pool() -> (TempDir, Vec<[f64; 3]>) {
    let folder = TempDir::new().unwrap();
    let particles = fluid(17, DVec3::splat(24.0));
    fs::write(folder.path().join("pool.xyz"), raw(&particles)).unwrap();
    (folder, particles)
}

const POOL: [&str; 6] = ["reconstruct", "pool.xyz", "--spacing", "1", "--backend", "cpu"];
const BOX: &str = "0,-,0,24,-,24";

fn with<'a>(usual: &[&'a str], more: &[&'a str]) -> Vec<&'a str> {
    [usual, more].concat()
}

#[test]
fn invalid_periodic_boxes_are_refused_with_the_reason() {
    let (folder, mut particles) = pool();
    particles.push([25.5, 3.0, 3.0]);
    fs::write(folder.path().join("astray.xyz"), raw(&particles)).unwrap();
    let before = fs::read_dir(folder.path()).unwrap().count();
    for (options, code, message) in [
        (&["--periodic", "0,-,0,24,-"][..], 2, "6 numbers"),
        (&["--periodic", "0,-,0,-,-,24"], 2, "one end of x is open"),
        (&["--periodic", "-,-,-,-,-,-"], 2, "the box is not periodic along any axis"),
        (&["--periodic", "24,-,0,0,-,24"], 2, "must be finite, and along a periodic axis"),
        (&["--periodic", "0,-,nan,24,-,24"], 2, "must be finite, and along a periodic axis"),
        (&["--periodic", "0,-,0,inf,-,24"], 2, "must be finite, and along a periodic axis"),
        (&["--periodic", "0,-,0,24,-,20"], 2, "20 wide along z, but must be at least"),
        (
            &["--periodic", BOX, "--domain", "0,0,0,24,20,24"],
            2,
            "a wall at an end of axis x, but x is periodic",
        ),
        (&["--periodic", "0,-,0,1e9,-,24"], 2, "from the origin"),
        (&["--periodic", BOX, "--cell", "1e-12"], 2, "less than 0.1 spacings"),
        (
            &["--periodic", BOX, "--cell", "1e-12", "--method", "mueller"],
            2,
            "cells per spacing, got",
        ),
        (&["--periodic-mesh", "overlap"], 2, "--periodic-mesh has no effect without --periodic"),
        (&["--periodic", "2,-,0,26,-,24"], 3, "is more than 1 outside the periodic box along x"),
        (
            &["--periodic", BOX, "--domain", "-,0,-,-,nan,-"],
            2,
            "invalid domain: every coordinate must be a number",
        ),
    ] {
        let options = with(&with(&POOL, &["-o", "mesh.ply"]), options);
        let errors = run(folder.path(), &options, code);
        assert!(errors.contains(message), "{options:?} does not print {message:?}: {errors}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), before, "{options:?}");
    }
    let astray =
        ["reconstruct", "astray.xyz", "--spacing", "1", "--periodic", BOX, "-o", "mesh.ply"];
    let errors = run(folder.path(), &astray, 3);
    let named = format!(
        "particle {} at (25.5, 3, 3) is more than 1 outside the periodic box along x",
        particles.len() - 1
    );
    assert!(errors.contains(&named), "{errors}");
    let errors = run(folder.path(), &with(&astray, &["--skip-invalid"]), 0);
    assert!(errors.contains("1 particle left out: outside"), "{errors}");
    run(folder.path(), &with(&POOL, &["--periodic", BOX, "-o", "whole.ply"]), 0);
    let [mesh, whole] =
        ["mesh.ply", "whole.ply"].map(|name| fs::read(folder.path().join(name)).unwrap());
    assert!(mesh == whole, "a skipped particle changes the mesh");
}

#[test]
fn a_particle_on_an_upper_face_moves_to_the_lower_one_despite_rounding() {
    let folder = TempDir::new().unwrap();
    // Rounding 24.1 to f32 gives a larger number, which is beyond the face at 24.1 in f64.
    assert!(f64::from(24.1_f32) > 24.1);
    for (name, x) in [("low", 0.0), ("high", 24.1)] {
        let mut particles = fluid(19, DVec3::splat(24.0));
        particles.extend((0..20).map(|i| [x, 15.0 + f64::from(i), 5.0]));
        fs::write(folder.path().join(format!("{name}.xyz")), raw(&particles)).unwrap();
        let [input, output] = ["xyz", "ply"].map(|extension| format!("{name}.{extension}"));
        let faces = ["--spacing", "1", "--periodic", "0,-,0,24.1,-,24.1"];
        run(folder.path(), &with(&["reconstruct", &input, "-o", &output], &faces), 0);
    }
    let [low, high] =
        ["low.ply", "high.ply"].map(|name| fs::read(folder.path().join(name)).unwrap());
    assert!(low == high);
}

#[test]
fn wrapped_particles_are_reported_and_counted_in_the_statistics() {
    let (folder, particles) = pool();
    let (outside, count) = unwrapped(&particles, [Some([0.0, 24.0]), None, Some([0.0, 24.0])]);
    fs::write(folder.path().join("outside.xyz"), raw(&outside)).unwrap();
    run(folder.path(), &with(&POOL, &["--periodic", BOX, "-o", "inside.ply"]), 0);
    let usual = ["outside.xyz", "--spacing", "1", "--periodic", BOX, "--backend", "cpu", "-o"];
    let reported = format!("{count} particles slightly outside the periodic box");
    for arguments in [
        with(&["reconstruct"], &with(&usual, &["outside.ply", "--stats", "s.jsonl"])),
        with(&["pack"], &with(&usual, &["outside.mnf"])),
        vec!["reconstruct", "outside.mnf", "-o", "packed.ply", "--stats", "s.jsonl"],
    ] {
        let messages = run(folder.path(), &arguments, 0);
        assert_eq!(messages.matches(&reported).count(), 1, "{arguments:?}: {messages}");
    }
    let [inside, outside, packed] = ["inside.ply", "outside.ply", "packed.ply"]
        .map(|name| fs::read(folder.path().join(name)).unwrap());
    assert!(outside == inside && packed == inside);
    let stats = fs::read_to_string(folder.path().join("s.jsonl")).unwrap();
    assert_eq!(stats.lines().count(), 2);
    for line in stats.lines() {
        let stats: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(stats["wrapped"], count);
        assert_eq!(stats["particles"], particles.len());
    }
}

#[test]
fn a_domain_can_bound_the_open_axes_of_a_periodic_box() {
    let (folder, _) = pool();
    let tank = ["--periodic", BOX, "--domain", "-,2,-,-,20,-", "-o", "mesh.ply"];
    let errors = run(folder.path(), &with(&POOL, &tank), 0);
    assert!(errors.contains("particles left out: outside"), "particles below the floor: {errors}");
    let mesh = read_mesh(&folder.path().join("mesh.ply")).unwrap();
    assert_watertight(&mesh, "a tank");
    let [lo, hi] = measure(&mesh).bounds.unwrap();
    assert_eq!((lo, hi[0], hi[2]), ([0.0, 2.0, 0.0], 24.0, 24.0));
    assert!(hi[1] <= 20.0);
}

#[test]
fn a_packed_frame_keeps_its_periodic_box_and_allows_both_mesh_ends() {
    let (folder, _) = pool();
    let pack = [
        "pack",
        "pool.xyz",
        "-o",
        "pool.mnf",
        "--spacing",
        "1",
        "--periodic",
        BOX,
        "--backend",
        "cpu",
    ];
    run(folder.path(), &pack, 0);
    for ends in ["cut", "overlap"] {
        let mesh = ["--periodic-mesh", ends, "-o"];
        let [direct, packed] = ["direct", "packed"].map(|name| format!("{name}_{ends}.ply"));
        run(folder.path(), &with(&with(&POOL, &["--periodic", BOX]), &with(&mesh, &[&direct])), 0);
        run(
            folder.path(),
            &with(&["reconstruct", "pool.mnf", "--backend", "cpu"], &with(&mesh, &[&packed])),
            0,
        );
        let [direct, packed] =
            [direct, packed].map(|name| fs::read(folder.path().join(name)).unwrap());
        assert!(direct == packed, "{ends}");
    }
    let errors =
        run(folder.path(), &["reconstruct", "pool.mnf", "--smooth", "2.5", "-o", "calm.ply"], 2);
    assert!(errors.contains("copies of particles only up to"), "{errors}");
    let errors =
        run(folder.path(), &["reconstruct", "pool.mnf", "--periodic", BOX, "-o", "box.ply"], 2);
    assert!(errors.contains("--periodic needs the particles"), "{errors}");
    let info = command(folder.path(), &["info", "pool.mnf"]).output().unwrap().stdout;
    assert!(String::from_utf8(info).unwrap().contains("x 0 to 24, z 0 to 24"));
}

#[test]
fn a_sequence_keeps_its_periodic_box_and_refuses_another_one() {
    let folder = TempDir::new().unwrap();
    fs::create_dir(folder.path().join("in")).unwrap();
    for frame in 1..=3 {
        let particles = fluid(20 + frame, DVec3::splat(24.0));
        fs::write(folder.path().join(format!("in/f_{frame}.xyz")), raw(&particles)).unwrap();
    }
    let frames = ["reconstruct", "in", "-o", "out/m_{}.ply", "--spacing", "1", "--backend", "cpu"];
    run(folder.path(), &with(&frames, &["--periodic", BOX, "--frames", "1..2"]), 0);
    for frame in 1..=2 {
        let mesh = read_mesh(&folder.path().join(format!("out/m_{frame}.ply"))).unwrap();
        assert_watertight(&mesh, "a frame");
        let [lo, hi] = measure(&mesh).bounds.unwrap();
        assert_eq!((lo[0], hi[0], lo[2], hi[2]), (0.0, 24.0, 0.0, 24.0));
    }
    for other in [
        &["--periodic", "0,-,-,24,-,-"][..],
        &[],
        &["--periodic", BOX, "--periodic-mesh", "overlap"],
    ] {
        let errors = run(folder.path(), &with(&frames, &with(other, &["--frames", "3..3"])), 2);
        assert!(errors.contains("periodic"), "{other:?}: {errors}");
    }
    run(folder.path(), &with(&frames, &["--periodic", BOX, "--resume"]), 0);
}

#[test]
fn the_library_and_the_program_write_the_same_periodic_mesh() {
    let (folder, particles) = pool();
    let periodic =
        Reconstruction::new().spacing(1.0).periodic([Some([0.0, 24.0]), None, Some([0.0, 24.0])]);
    for (ends, periodic_mesh) in [("cut", PeriodicMesh::Cut), ("overlap", PeriodicMesh::Overlap)] {
        let output = format!("{ends}.ply");
        let options = ["--periodic", BOX, "--periodic-mesh", ends, "-o", &output];
        run(folder.path(), &with(&POOL, &options), 0);
        let request = periodic.clone().periodic_mesh(periodic_mesh);
        let of_file = request.run_file(folder.path().join("pool.xyz")).unwrap();
        assert!(fs::read(folder.path().join(&output)).unwrap() == bytes_of(&of_file), "{ends}");
        let single: Vec<[f32; 3]> = particles.iter().map(|p| p.map(|x| x as f32)).collect();
        let surface = request.run(&single[..]).unwrap();
        assert!(bytes_of(&of_file) == bytes_of(&surface), "{ends}");
        let warnings = &surface.report().warnings;
        assert!(
            !warnings.iter().any(|w| matches!(w, Warning::Shortfall { .. } | Warning::Lost { .. }))
        );
    }
}
