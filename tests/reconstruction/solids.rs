//! Tests of solids: the water ends at their surfaces.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;
use meniscus::error::{Conflict, Error, ReadFault, SolidFault};
use meniscus::files::MeshFormat;
use meniscus::internals::backend::{Backend, Vulkan};
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::frame::{Engine, Method, Normals, Sampling, Surfacing};
use meniscus::internals::grid::units::{MemoryBudget, SolidOffset};
use meniscus::internals::grid::{Grid, Periodic};
use meniscus::internals::io::CoordinateWidth;
use meniscus::internals::surface::solid::Solid;
use meniscus::internals::system::timings::Timings;
use meniscus::internals::vulkan::DeviceOptions;
use meniscus::mesh::{Mesh, measure};
use meniscus::{PeriodicMesh, Reconstruction, Warning};
use tempfile::TempDir;

use crate::common::device;
use crate::common::files::{bytes_of, raw, text_of_obj};
use crate::common::periodic::{Faces, repeated, triangles_within};
use crate::common::scene::Random;
use crate::common::shapes::{cuboid, moved, sphere};
use crate::common::{sampling, surfacing, watertight};
use crate::sheets::{FILMS, assert_whole, film, of_cells};

/// The size of the pool along x and z.
const SIZE: f64 = 30.0;
/// The water level of the pool.
const LEVEL: f64 = 13.0;
/// The centre of a ball that is mostly under water.
const CENTRE: DVec3 = DVec3::new(15.0, 8.0, 15.0);
const RADIUS: f64 = 9.0;
/// Half of the edge lengths of a box that is rotated about the centre of the ball.
const HALF: DVec3 = DVec3::new(7.0, 3.0, 6.0);
const ANGLE: f64 = 0.5;

/// Water outside a solid. `distance` is the distance of a point from the solid, and `jitter` is in
/// spacings.
fn pool(jitter: f64, distance: impl Fn(DVec3) -> f64) -> Vec<[f64; 3]> {
    let mut random = Random::new(11);
    let mut water = Vec::new();
    for (x, z) in (0..SIZE as u32).flat_map(|x| (0..SIZE as u32).map(move |z| (x, z))) {
        for y in 0..LEVEL as u32 {
            let place = DVec3::from([x, y, z].map(f64::from)) + 0.5;
            let by = DVec3::from([(); 3].map(|()| 2.0 * random.unit() - 1.0));
            let at = place + jitter * by;
            if distance(at) > 0.0 {
                water.push(at.to_array());
            }
        }
    }
    water
}

fn from_ball(at: DVec3) -> f64 {
    at.distance(CENTRE) - RADIUS
}

fn rotated(at: DVec3, angle: f64) -> DVec3 {
    let (sin, cos) = angle.sin_cos();
    DVec3::new(at.x * cos - at.y * sin, at.x * sin + at.y * cos, at.z)
}

fn from_box(at: DVec3) -> f64 {
    let over = rotated(at - CENTRE, -ANGLE).abs() - HALF;
    over.max(DVec3::ZERO).length() + over.max_element().min(0.0)
}

fn rotated_box() -> Mesh {
    let mut mesh = cuboid((-HALF).to_array(), HALF.to_array());
    for position in &mut mesh.positions {
        *position = (rotated(DVec3::from(*position), ANGLE) + CENTRE).to_array();
    }
    mesh
}

fn ball() -> Mesh {
    moved(&sphere(RADIUS, 5), CENTRE.to_array())
}

/// Writes a mesh as an .obj file, and returns its path.
fn written(folder: &TempDir, name: &str, mesh: &Mesh) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, text_of_obj(mesh)).unwrap();
    path
}

fn request(cell: f64) -> Reconstruction {
    let request = Reconstruction::new().spacing(1.0).cell_size(cell);
    request.domain([0.0; 3], [SIZE, f64::INFINITY, SIZE])
}

fn touching(request: Reconstruction, solid: &Path) -> Reconstruction {
    request.solids([solid.to_str().unwrap()]).solid_offset(0.0)
}

/// The mean and the root mean square of errors.
fn mean_and_rms(errors: &[f64]) -> (f64, f64) {
    assert!(errors.len() > 50, "{} vertices", errors.len());
    let count = errors.len() as f64;
    let square: f64 = errors.iter().map(|error| error * error).sum();
    (errors.iter().sum::<f64>() / count, (square / count).sqrt())
}

#[test]
fn water_ends_at_solids_and_keeps_its_level_up_to_them() {
    let folder = TempDir::new().unwrap();
    let distances: [fn(DVec3) -> f64; 2] = [from_ball, from_box];
    let solids = [("ball.obj", ball()), ("box.obj", rotated_box())];
    for ((name, mesh), distance) in solids.into_iter().zip(distances) {
        let solid = written(&folder, name, &mesh);
        for (jitter, cell) in [(0.3, 0.25), (0.3, 0.5), (0.5, 0.5)] {
            let what = format!("{name}, jitter {jitter}, cells of {cell}");
            let water = pool(jitter, distance);
            let surface = touching(request(cell), &solid).run(&water[..]).unwrap();
            let mesh = surface.to_mesh().unwrap();
            assert_eq!(watertight::defect(&mesh), None, "{what}");
            let inner = |p: &DVec3| {
                let [x, z] = [p.x, p.z].map(|c| (1.0..SIZE - 1.0).contains(&c));
                x && z && p.y > 1.0
            };
            let vertices: Vec<DVec3> =
                mesh.positions.iter().map(|&p| DVec3::from(p)).filter(inner).collect();
            let of = |is: &dyn Fn(DVec3, f64) -> bool, error: &dyn Fn(DVec3, f64) -> f64| {
                let all = vertices.iter().map(|&p| (p, distance(p)));
                all.filter(|&(p, d)| is(p, d)).map(|(p, d)| error(p, d)).collect::<Vec<_>>()
            };
            let at_solid = of(&|p, d| d.abs() < 1.5 && p.y < LEVEL - 1.0, &|_, d| d);
            let (bias, rms) = mean_and_rms(&at_solid);
            assert!(bias.abs() < 0.02 && rms < 0.04, "{what}: at the solid {bias}, {rms}");
            let is_level = |p: DVec3, d: f64| d > 0.3 && (p.y - LEVEL).abs() < 2.0;
            let (level, _) = mean_and_rms(&of(&|p, d| is_level(p, d) && d > 4.0, &|p, _| p.y));
            let near = of(&|p, d| is_level(p, d) && d < 4.0, &|p, _| p.y - level);
            let (bias, rms) = mean_and_rms(&near);
            // With a jitter of 0.5, the level has noise of 0.07 even far from the solid.
            let most = if jitter < 0.4 { 0.1 } else { 0.14 };
            assert!(bias.abs() < 0.05 && rms < most, "{what}: level near the solid {bias}, {rms}");
        }
    }
}

#[test]
fn films_on_solids_stay_whole_and_keep_their_volume() {
    let folder = TempDir::new().unwrap();
    let mut plate = cuboid([-20.0, -6.0, -20.0], [20.0, 0.0, 20.0]);
    for position in &mut plate.positions {
        *position = rotated(DVec3::from(*position), ANGLE).to_array();
    }
    let solid = written(&folder, "plate.obj", &plate);
    for (layers, stretch) in FILMS {
        for cell in [0.25, 0.5] {
            let film = film(layers, stretch, &mut Random::new(5));
            // The particles of the lowest layer lie half a spacing above the plate.
            let raised = |[x, y, z]: [f64; 3]| {
                rotated(DVec3::new(x, y * stretch * stretch, z), ANGLE).to_array()
            };
            let particles: Vec<_> = film.into_iter().map(raised).collect();
            let request = of_cells(cell).solids([solid.to_str().unwrap()]);
            let what = format!("{layers} layers, {stretch}, cells of {cell}");
            // Coarse cells make thin films thicker, so the surface may enclose more volume.
            let most = if cell < 0.5 { 1.4 } else { 2.0 };
            assert_whole(&request, &particles, 0.8..most, &what);
        }
    }
}

#[test]
fn solids_are_independent_of_threads_and_memory_and_act_only_nearby() {
    let folder = TempDir::new().unwrap();
    let solid = written(&folder, "ball.obj", &ball());
    let water = pool(0.5, from_ball);
    let bytes = |request: Reconstruction| bytes_of(&request.run(&water[..]).unwrap());
    let expected = bytes(touching(request(0.5), &solid).threads(1).normals(true));
    assert_eq!(bytes(touching(request(0.5), &solid).threads(3).normals(true)), expected);
    let small_budget =
        touching(request(0.5), &solid).threads(1).normals(true).memory(MemoryBudget(40 << 20));
    assert_eq!(bytes(small_budget), expected);
    let far = written(&folder, "far.obj", &moved(&ball(), [200.0, 0.0, 0.0]));
    assert_eq!(bytes(touching(request(0.5), &far)), bytes(request(0.5)));
}

#[test]
fn a_device_makes_the_same_mesh_with_solids_as_the_cpu() {
    let device = match device::open(&DeviceOptions::default()) {
        Ok((device, _)) => device,
        Err(error) => return device::skip(error),
    };
    let folder = TempDir::new().unwrap();
    // Put the ball at a corner of the pool, so that some blocks are far from it.
    let corner = DVec3::new(1.0, 9.0, 1.0);
    let solid = written(&folder, "ball.obj", &moved(&sphere(2.0, 3), corner.to_array()));
    let water = pool(0.5, |at| at.distance(corner) - 2.0);
    let run = |request: Reconstruction| request.run(&water[..]).unwrap();
    let expected = run(touching(request(0.25), &solid));
    let made =
        run(touching(request(0.25), &solid).backend(Backend::of(Vulkan::new(device).unwrap())));
    assert_eq!(bytes_of(&made), bytes_of(&expected));
    let by_device = made.report().on_device.regions;
    assert!(by_device > 0, "{by_device} regions");
}

#[test]
fn in_a_periodic_box_solids_repeat_as_the_fluid_does() {
    let folder = TempDir::new().unwrap();
    let edge = 40.0;
    let faces: Faces = [Some([0.0, edge]), None, Some([0.0, edge])];
    // Most of the ball is beyond the faces at a corner of the box. Coordinates have few binary
    // digits, so that copies are exact.
    let dyadic = |p: DVec3| (p * 1024.0).floor() / 1024.0;
    let mut solid = moved(&sphere(5.0, 3), [-2.0, 4.0, -1.0]);
    for position in &mut solid.positions {
        *position = dyadic(DVec3::from(*position)).to_array();
    }
    let from_solid = |p: DVec3| {
        let centre = DVec3::new(-2.0, 4.0, -1.0);
        let shifts = [0.0, edge].into_iter().flat_map(|x| [0.0, edge].map(|z| [x, 0.0, z]));
        shifts.map(|s| p.distance(centre + DVec3::from(s)) - 5.0).fold(f64::MAX, f64::min)
    };
    let mut random = Random::new(3);
    let mut water = Vec::new();
    for cell in
        (0..40 * 40 * 7).map(|i| DVec3::from([i % 40, i / 1600, i / 40 % 40].map(f64::from)))
    {
        let p = dyadic(cell + DVec3::from([(); 3].map(|()| random.unit())));
        if from_solid(p) > 0.0 {
            water.push(p.to_array());
        }
    }
    let copies =
        [-edge, 0.0, edge].into_iter().flat_map(|x| [-edge, 0.0, edge].map(|z| [x, 0.0, z]));
    let copies: Vec<Mesh> = copies.map(|shift| moved(&solid, shift)).collect();
    let offset = SolidOffset::new(0.0).unwrap();
    let at_solids = |meshes: Vec<Mesh>, periodic_mesh: PeriodicMesh| Surfacing {
        at_solids: true,
        solid: Some(Arc::new(Solid::new(meshes, offset).unwrap().keeping_distances(1 << 20))),
        normals: Normals::Gradient,
        periodic_mesh,
        ..surfacing()
    };
    let (method, grid) = (Method::from(IndicatorKind::Cloud), Grid::new(DVec3::ZERO, 0.5).unwrap());
    let of_all = at_solids(copies, PeriodicMesh::Cut);
    let reach = of_all.reach(method, Some(1.0), None, &grid);
    let periodic = Some(Periodic::new(&grid, faces, reach).unwrap());
    let alone =
        Sampling { method, grid, spacing: Some(1.0), side: method.brick_side(), ..sampling() };
    let in_box = Sampling { periodic, ..alone.clone() };
    let timings = &mut Timings::default();
    let frame = Engine::sample(&water, &in_box, timings).unwrap();
    // Use the calibration of the periodic box for both frames.
    let calibrated = of_all.calibrate(frame.dif().unwrap()).unwrap().calibration;
    let mut meshed = |frame: &Engine, surfacing: &Surfacing| {
        let frame = frame.calibrate(surfacing, Some(&calibrated), timings).unwrap();
        frame.surface(timings).unwrap().to_mesh().unwrap()
    };
    let around = Engine::sample(&repeated(&water, faces), &alone, &mut Timings::default());
    let all = meshed(&around.unwrap(), &of_all);
    for (ends, margin) in [(PeriodicMesh::Cut, 1.0), (PeriodicMesh::Overlap, 0.0)] {
        let mesh = meshed(&frame, &at_solids(vec![solid.clone()], ends));
        assert_eq!(watertight::defect(&mesh), None);
        let [found, expected] = [&mesh, &all].map(|mesh| triangles_within(mesh, faces, margin));
        let both = found.intersection(&expected).count();
        assert!(
            expected.len() > 5000 && found == expected,
            "{ends:?}: {both} of {} and {} triangles",
            found.len(),
            expected.len()
        );
    }
    // Also test a solid from a file. Check the mesh at the upper faces, which only a periodic image
    // of the ball reaches.
    let file = written(&folder, "ball.obj", &solid);
    let request =
        touching(Reconstruction::new().spacing(1.0).cell_size(0.5).periodic(faces), &file);
    let mesh = request.run(&water[..]).unwrap().to_mesh().unwrap();
    assert_eq!(watertight::defect(&mesh), None);
    let at_upper_faces =
        |p: &&[f64; 3]| p[0] > edge - 9.0 && p[2] > edge - 9.0 && (0.5..5.0).contains(&p[1]);
    let at_upper_faces =
        mesh.positions.iter().filter(at_upper_faces).map(|&p| from_solid(DVec3::from(p)));
    let on = at_upper_faces.filter(|distance| distance.abs() < 0.2).count();
    assert!(on > 50, "only {on} vertices are at the solid");
}

#[test]
fn memory_estimates_include_solids() {
    let folder = TempDir::new().unwrap();
    let (ball, input) = (ball(), folder.path().join("pool.xyz"));
    fs::write(&input, raw(&pool(0.3, from_ball))).unwrap();
    let solid = written(&folder, "ball.obj", &ball);
    let budget = MemoryBudget(1 << 30);
    let needs = |request: Reconstruction| {
        request.memory(budget).open(&input).unwrap().needs(MeshFormat::Ply).unwrap().unwrap()
    };
    let (plain, with_solid) = (needs(request(0.5)), needs(touching(request(0.5), &solid)));
    let least = 300 * ball.triangles.len() as u64;
    assert!(
        with_solid.memory >= plain.memory + least && with_solid.in_core >= plain.in_core + least
    );
    assert_eq!([plain.budget, with_solid.budget], [budget.0; 2]);
}

#[test]
fn the_memory_limit_in_a_solid_error_suffices() {
    let folder = TempDir::new().unwrap();
    let solid = written(&folder, "ball.obj", &moved(&sphere(RADIUS, 6), CENTRE.to_array()));
    let water = pool(0.3, from_ball);
    let run = |bytes: u64| touching(request(0.5), &solid).memory(MemoryBudget(bytes)).run(&water);
    // The first error gives the memory that the library estimates from the size of the solid's
    // file. The second error gives the memory of the solid itself, which the library computes after
    // it has read the file.
    let mut budget = 17 << 20;
    for _ in 0..2 {
        let Err(Error::LittleMemory { least, .. }) = run(budget) else {
            panic!("{budget} bytes must be too few for the solid");
        };
        assert!(least > budget);
        budget = least;
    }
    assert!(run(budget).is_ok());
}

#[test]
fn a_solid_wall_divides_water_and_a_too_thin_wall_causes_a_warning() {
    let folder = TempDir::new().unwrap();
    let wall = |half: f64| cuboid([13.0 - half, -1.0, -1.0], [13.0 + half, 30.0, SIZE + 1.0]);
    let water = pool(0.3, |_| 1.0);
    let divided = |name: &str, half: f64, offset: f64| {
        let solid = written(&folder, name, &wall(half));
        touching(request(0.5), &solid).solid_offset(offset).run(&water[..]).unwrap()
    };
    let is_thin = |warning: &Warning| matches!(warning, Warning::ThinSolid { .. });
    let surface = divided("wall.obj", 0.3, 0.0);
    assert_eq!(measure(&surface.to_mesh().unwrap()).components, 2);
    assert!(!surface.report().warnings.iter().any(is_thin));
    // A positive solid offset leaves a gap on both sides of the thin wall.
    let surface = divided("sheet.obj", 0.05, 0.25);
    assert_eq!(measure(&surface.to_mesh().unwrap()).components, 2);
    assert!(!surface.report().warnings.iter().any(is_thin));
    let surface = divided("foil.obj", 0.05, -0.1);
    assert!(surface.report().warnings.iter().any(is_thin));
}

#[test]
fn solid_offset_moves_the_contact_surface_and_inverted_solids_are_flipped() {
    let folder = TempDir::new().unwrap();
    let mut inwards = ball();
    inwards.triangles.iter_mut().for_each(|triangle| triangle.reverse());
    let solids = [written(&folder, "out.obj", &ball()), written(&folder, "in.obj", &inwards)];
    let water = pool(0.3, from_ball);
    for offset in [-0.3, 0.5] {
        let [outwards, inwards] = solids.each_ref().map(|solid| {
            touching(request(0.5), solid).solid_offset(offset).run(&water[..]).unwrap()
        });
        assert_eq!(bytes_of(&outwards), bytes_of(&inwards));
        let is_inverted = |warning: &Warning| *warning == Warning::InvertedSolid(solids[1].clone());
        let warns = |warnings: &[Warning]| warnings.iter().any(is_inverted);
        assert!(warns(&inwards.report().warnings) && !warns(&outwards.report().warnings));
        let mesh = outwards.to_mesh().unwrap();
        let vertices = mesh.positions.iter().map(|&p| DVec3::from(p));
        // Measure above the floor and below the level, because the ball reaches through the floor.
        let depths = 2.0..LEVEL - 2.0;
        let under = vertices.filter(|p| from_ball(*p).abs() < 1.5 && depths.contains(&p.y));
        let errors: Vec<f64> = under.map(|p| from_ball(p) - offset).collect();
        let (bias, rms) = mean_and_rms(&errors);
        assert!(bias.abs() < 0.03 && rms < 0.05, "{offset}: {bias}, {rms}");
    }
}

#[test]
fn a_solid_gives_the_same_water_in_each_format() {
    let folder = tempfile::tempdir().unwrap();
    let water = pool(0.2, from_ball);
    let mesh_at = |name: &str| {
        let path = folder.path().join(name);
        let mut bytes = Vec::new();
        let format = MeshFormat::of(&path).unwrap();
        format.write(&mut bytes, &ball(), CoordinateWidth::F64).unwrap();
        fs::write(&path, bytes).unwrap();
        let request = request(0.5).solids([path.to_str().unwrap()]);
        bytes_of(&request.run(&water[..]).unwrap())
    };
    let expected = mesh_at("ball.ply");
    for name in ["ball.obj", "ball.vtp", "ball.bgeo.sc"] {
        assert!(mesh_at(name) == expected, "{name}");
    }
}

#[test]
fn invalid_solids_are_refused_with_their_file_and_bad_edges() {
    let folder = TempDir::new().unwrap();
    let whole = cuboid([0.0; 3], [1.0; 3]);
    let mut open = whole.clone();
    open.triangles.truncate(11);
    let mut twisted = whole.clone();
    twisted.triangles[0].reverse();
    let particles = [[0.0; 3]];
    let refused = |name: &str, mesh: &Mesh| {
        let solid = written(&folder, name, mesh);
        match request(0.5).solids([solid.to_str().unwrap()]).run(&particles[..]) {
            Err(Error::Solid { path, fault }) if path == solid => fault,
            other => panic!("{name}: {other:?}"),
        }
    };
    assert_eq!(refused("open.obj", &open), SolidFault::Open { edges: 3 });
    assert_eq!(refused("twisted.obj", &twisted), SolidFault::Inconsistent { edges: 3 });
    let points = Mesh { triangles: Vec::new(), ..whole };
    assert!(matches!(refused("points.obj", &points), SolidFault::Mesh(_)));
    let gone = folder.path().join("gone.obj");
    match request(0.5).solids([gone.to_str().unwrap()]).run(&particles[..]) {
        Err(Error::Read(error)) => {
            assert!(error.path == gone && matches!(error.fault, ReadFault::Io(_)), "{error}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn settings_that_conflict_with_solids_are_refused_by_name() {
    let particles = [[0.0; 3]];
    let refused = |request: Reconstruction| match request.run(&particles[..]) {
        Err(Error::SettingConflict(conflict)) => (conflict.setting.name(), conflict.with),
        other => panic!("{other:?}"),
    };
    let offset = Reconstruction::new().spacing(1.0).solid_offset(0.1);
    assert!(
        matches!(refused(offset), ("solid_offset", Conflict::Needs(other)) if other.name() == "solid")
    );
}
