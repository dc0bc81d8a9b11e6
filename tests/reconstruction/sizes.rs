//! Tests of frames with particles of several sizes.

use std::f64::consts::PI;

use glam::DVec3;
use meniscus::error::{Conflict, Error, PeriodicError, SizeFault};
use meniscus::files::Replace;
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::grid::units::MemoryBudget;
use meniscus::mesh::{Mesh, measure};
use meniscus::{
    Cloud, KernelMethod, PeriodicMesh, Reconstruction, SpacingSource, SpacingWarning, Warning,
};

use crate::common::files::text_of_obj;
use crate::common::periodic::{Faces, repeated, triangles_within, unwrapped};
use crate::common::scene::Random;
use crate::common::shapes::{moved, sphere, union};
use crate::common::watertight;

/// The positions and sizes of particles.
#[derive(Default, Clone)]
struct Sized {
    positions: Vec<[f64; 3]>,
    sizes: Vec<f32>,
}

impl Sized {
    /// Adds a box of particles of one size, which are moved randomly by up to `JITTER` times their
    /// size along each axis.
    fn with(self, cells: [[f64; 3]; 2], size: f64, random: &mut Random) -> Self {
        self.with_jittered(cells, size, JITTER, random)
    }

    fn with_jittered(
        mut self,
        [lo, hi]: [[f64; 3]; 2],
        size: f64,
        jitter: f64,
        random: &mut Random,
    ) -> Self {
        let count = [0, 1, 2].map(|axis| ((hi[axis] - lo[axis]) / size).round() as usize);
        for i in 0..count.iter().product::<usize>() {
            let cell = [i % count[0], i / count[0] % count[1], i / (count[0] * count[1])];
            self.positions.push([0, 1, 2].map(|axis| {
                let jitter = jitter * (2.0 * random.unit() - 1.0);
                lo[axis] + (cell[axis] as f64 + 0.5 + jitter) * size
            }));
            self.sizes.push(size as f32);
        }
        self
    }

    /// Square pools next to each other along x, each with particles of a different size.
    fn pools(sizes: &[f64]) -> Self {
        Self::jittered_pools(sizes, JITTER)
    }

    fn jittered_pools(sizes: &[f64], jitter: f64) -> Self {
        let mut random = Random::new(5);
        let pool = |all: Self, (i, &size): (usize, &f64)| {
            let first = i as f64 * WIDTH;
            let cells = [[first, 0.0, 0.0], [first + WIDTH, WIDTH, DEPTH]];
            all.with_jittered(cells, size, jitter, &mut random)
        };
        sizes.iter().enumerate().fold(Self::default(), pool)
    }

    fn radii(&self) -> Vec<f32> {
        self.sizes.iter().map(|size| size / 2.0).collect()
    }

    fn volume(&self) -> f64 {
        self.sizes.iter().map(|&size| f64::from(size).powi(3)).sum()
    }

    fn mesh(&self, request: &Reconstruction) -> Mesh {
        let radii = self.radii();
        let cloud = Cloud::new(&self.positions).with("radius", &radii);
        request.run(&cloud).unwrap().to_mesh().unwrap()
    }
}

const JITTER: f64 = 0.3;
const WIDTH: f64 = 64.0;
const DEPTH: f64 = 24.0;

fn request() -> Reconstruction {
    Reconstruction::new()
}

/// The bias and the RMS error of the water level in a range of x, away from the pool's edges. Both
/// are in units of `size`.
fn level(mesh: &Mesh, [from, to]: [f64; 2], size: f64) -> [f64; 2] {
    let is_there = |p: &&[f64; 3]| {
        (from..to).contains(&p[0]) && (10.0..38.0).contains(&p[1]) && p[2] > DEPTH - 1.5 * size
    };
    let heights: Vec<f64> =
        mesh.positions.iter().filter(is_there).map(|p| (p[2] - DEPTH) / size).collect();
    assert!(heights.len() > 100);
    let mean = heights.iter().sum::<f64>() / heights.len() as f64;
    let variance = heights.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / heights.len() as f64;
    [mean, variance.sqrt()]
}

#[test]
fn pools_of_several_particle_sizes_have_level_surfaces() {
    let sizes = [1.0, 2.0, 4.0];
    let water = Sized::pools(&sizes);
    let mesh = water.mesh(&request());
    assert_eq!(watertight::defect(&mesh), None);
    let found = measure(&mesh);
    assert_eq!(found.components, 1);
    assert!((found.volume.unwrap() / water.volume() - 1.0).abs() < 0.03);
    for (i, size) in sizes.into_iter().enumerate() {
        let (first, margin) = (i as f64 * WIDTH, 2.0 * size.max(2.0));
        let [bias, rms] = level(&mesh, [first + margin, first + WIDTH - margin], size);
        assert!(bias.abs() < 0.06 && rms < 0.07, "size {size}: {bias} {rms}");
    }
    for (i, size) in sizes.into_iter().enumerate().skip(1) {
        let seam = i as f64 * WIDTH;
        let [bias, rms] = level(&mesh, [seam - 2.0 * size, seam + 2.0 * size], size);
        assert!(bias.abs() < 0.1 && rms < 0.07, "seam {i}: {bias} {rms}");
    }
    // If sizes are ignored, the cells are too fine for the coarse water, so its surface falls
    // apart.
    let one = measure(&water.mesh(&request().size("none")));
    assert!(one.components > 10 && one.volume.unwrap() < 0.7 * water.volume());
}

#[test]
fn a_lone_particle_of_any_size_keeps_about_its_volume() {
    for cell in [0.25, 0.5, 0.667] {
        let sizes: Vec<f32> = (1..=8).map(|size| size as f32).collect();
        let positions =
            sizes.iter().map(|&s| f64::from(s)).map(|s| [30.0 * s, 0.13 * s, 0.31 * s]).collect();
        let mesh = Sized { positions, sizes }.mesh(&request().cell(cell));
        assert_eq!(watertight::defect(&mesh), None);
        assert_eq!(measure(&mesh).components, 8, "cells of {cell}");
        for size in 1..=8 {
            let size = f64::from(size);
            let of_drop = |corner: &usize| (mesh.positions[*corner][0] - 30.0 * size).abs() < 15.0;
            let volume: f64 = mesh
                .triangles
                .iter()
                .map(|triangle| triangle.map(|corner| corner as usize))
                .filter(|triangle| of_drop(&triangle[0]))
                .map(|triangle| {
                    let [a, b, c] = triangle.map(|corner| DVec3::from(mesh.positions[corner]));
                    a.dot(b.cross(c)) / 6.0
                })
                .sum();
            let share = volume / size.powi(3);
            assert!((0.7..1.3).contains(&share), "size {size} in cells of {cell}: {share}");
        }
    }
}

#[test]
fn a_sheet_of_several_sizes_has_about_the_volume_of_its_particles() {
    let mut random = Random::new(29);
    let mut sheet = Sized::default();
    let mut x: f64 = 0.0;
    // The sizes grow from 1 to 1.9 along x, and neighbours are 1.3 sizes apart.
    while x < 50.0 {
        let size = 1.0 + 0.9 * x / 50.0;
        for row in 0..(36.0 / (1.3 * size)) as u32 {
            let place = [x, 1.3 * size * f64::from(row), 0.0];
            sheet.positions.push(place.map(|p| p + 0.2 * size * (random.unit() - 0.5)));
            sheet.sizes.push(size as f32);
        }
        x += 1.3 * size;
    }
    for cell in [0.5, 0.25] {
        let found = measure(&sheet.mesh(&request().cell(cell)));
        assert_eq!((found.components, found.genus), (1, Some(0)), "cells of {cell}");
        let volume = found.volume.unwrap() / sheet.volume();
        assert!((0.85..1.3).contains(&volume), "cells of {cell}: {volume}");
    }
}

#[test]
fn mixed_particle_sizes_leave_no_bubbles() {
    // Each cube contains either one large particle or eight small particles.
    let mut random = Random::new(9);
    let mut water = Sized::default();
    for i in 0..24 * 24 * 12 {
        let lo = [i % 24, i / 24 % 24, i / (24 * 24)].map(|c| 2.0 * f64::from(c));
        let size = if random.unit() < 0.5 { 1.0 } else { 2.0 };
        water = water.with([lo, lo.map(|x| x + 2.0)], size, &mut random);
    }
    let mesh = water.mesh(&request());
    assert_eq!(watertight::defect(&mesh), None);
    let found = measure(&mesh);
    assert_eq!(found.components, 1);
    assert!((found.volume.unwrap() / water.volume() - 1.0).abs() < 0.03);
    let [bias, rms] = level(&mesh, [10.0, 38.0], 2.0);
    assert!(bias.abs() < 0.06 && rms < 0.08, "{bias} {rms}");
}

#[test]
fn sized_meshes_are_independent_of_order_threads_memory_and_size_unit() {
    let water = Sized::pools(&[1.0, 3.0]);
    let radii = water.radii();
    let heat: Vec<f32> = water.positions.iter().map(|p| p[0] as f32).collect();
    let cloud = Cloud::new(&water.positions).with("radius", &radii).with("heat", &heat);
    let plain = request().attributes(["heat"]).normals(true);
    let mesh = |request: &Reconstruction| request.run(&cloud).unwrap().to_mesh().unwrap();
    let expected = mesh(&plain);
    for request in [
        plain.clone().threads(1),
        plain.clone().memory(MemoryBudget(16 << 20)),
        plain.clone().size("radius"),
    ] {
        assert!(mesh(&request) == expected);
    }
    // Reverse the particles, and give their sizes as other attributes with the same meaning.
    let reversed = |values: &[f32]| values.iter().rev().copied().collect::<Vec<_>>();
    let positions: Vec<[f64; 3]> = water.positions.iter().rev().copied().collect();
    let (heat, diameters) = (reversed(&heat), reversed(&water.sizes));
    let masses: Vec<f32> = diameters.iter().map(|d| d * d * d * 1000.0).collect();
    let density = vec![1000.0; masses.len()];
    let cloud = Cloud::new(&positions)
        .with("heat", &heat)
        .with("diameter", &diameters)
        .with("mass", &masses)
        .with("rho", &density);
    let by = |size: &str| plain.clone().size(size).run(&cloud).unwrap().to_mesh().unwrap();
    assert!(by("diameter") == expected);
    assert!(by("mass") == expected);
}

#[test]
fn attributes_of_sized_particles_come_from_nearby_particles() {
    let water = Sized::pools(&[1.0, 4.0]);
    let (radii, heat) = (water.radii(), water.sizes.clone());
    let cloud = Cloud::new(&water.positions).with("radius", &radii).with("heat", &heat);
    let mesh = request().attributes(["heat"]).run(&cloud).unwrap().to_mesh().unwrap();
    for (position, heat) in mesh.positions.iter().zip(&mesh.attributes[0].values) {
        assert!((0.99..=4.01).contains(heat), "{heat} at {position:?}");
        if position[0] > WIDTH + 12.0 {
            assert_eq!(*heat, 4.0, "{position:?}");
        }
    }
}

#[test]
fn attributes_at_walls_of_coarse_water_come_from_nearby_particles() {
    let water = Sized::pools(&[1.0, 4.0]);
    let radii = water.radii();
    let height: Vec<f32> = water.positions.iter().map(|[.., z]| *z as f32).collect();
    let cloud = Cloud::new(&water.positions).with("radius", &radii).with("height", &height);
    let open = f64::INFINITY;
    // The floor is at a face of the coarse water's wide cells, or between two such faces.
    for floor in [0.0, -0.3, -0.6, -1.1, -1.6] {
        let request = request().attributes(["height"]).domain([-open, -open, floor], [open; 3]);
        let mesh = request.run(&cloud).unwrap().to_mesh().unwrap();
        assert_eq!(watertight::defect(&mesh), None);
        for (position, height) in mesh.positions.iter().zip(&mesh.attributes[0].values) {
            let away = f64::from(*height) - position[2];
            assert!(away.abs() < 6.0, "floor at {floor}: {height} at {position:?}");
        }
    }
}

#[test]
fn scaled_radii_are_corrected_by_the_density_of_the_fluid() {
    let water = Sized::pools(&[1.0, 2.0]);
    let radii: Vec<f32> = water.sizes.iter().map(|size| 0.3 * size).collect();
    let cloud = Cloud::new(&water.positions).with("pscale", &radii);
    let surface = request().run(&cloud).unwrap();
    let (spacing, source) = surface.report().cells.as_ref().unwrap().spacing.clone().unwrap();
    assert!((spacing - 1.0).abs() < 0.02, "{spacing}");
    assert_eq!(source, SpacingSource::Sizes("pscale".into()));
    let volume = measure(&surface.to_mesh().unwrap()).volume.unwrap();
    assert!((volume / water.volume() - 1.0).abs() < 0.04);
}

#[test]
fn smoothing_lengths_of_files_without_densities_are_scaled_to_sizes() {
    let water = Sized::pools(&[1.0, 2.0]);
    let masses: Vec<f32> = water.sizes.iter().map(|size| size.powi(3)).collect();
    for times in [1.2348, 2.4] {
        let lengths: Vec<f32> = water.sizes.iter().map(|size| times * size).collect();
        let cloud =
            Cloud::new(&water.positions).with("Masses", &masses).with("SmoothingLengths", &lengths);
        let surface = request().run(&cloud).unwrap();
        let (spacing, source) = surface.report().cells.as_ref().unwrap().spacing.clone().unwrap();
        assert!((spacing - 1.0).abs() < 0.03, "{times}: {spacing}");
        assert_eq!(source, SpacingSource::Sizes("SmoothingLengths".into()));
        let volume = measure(&surface.to_mesh().unwrap()).volume.unwrap();
        assert!((volume / water.volume() - 1.0).abs() < 0.04, "{times}: {volume}");
    }
}

#[test]
fn wrong_sizes_in_shallow_water_are_contradicted_by_the_neighbours() {
    for (times, depth, is_wrong) in
        [(1.0, 1.0, false), (1.0, 4.0, false), (3.0, 1.0, true), (3.0, 4.0, true), (0.2, 1.0, true)]
    {
        let mut random = Random::new(5);
        let fine = Sized::default().with([[0.0; 3], [40.0, depth, 40.0]], 1.0, &mut random);
        let coarse = [[40.0, 0.0, 0.0], [80.0, depth.max(2.0), 40.0]];
        let water = fine.with(coarse, 2.0, &mut random);
        let radii: Vec<f32> = water.sizes.iter().map(|size| times * size / 2.0).collect();
        let cloud = Cloud::new(&water.positions).with("radius", &radii);
        let surface = request().run(&cloud).unwrap();
        let warnings = &surface.report().cells.as_ref().unwrap().warnings;
        let contradicted = warnings.iter().find_map(|warning| match warning {
            SpacingWarning::SizesContradicted { sizes, found, .. } => Some((sizes[0], found)),
            _ => None,
        });
        assert_eq!(contradicted.is_some(), is_wrong, "{times}, {depth}: {warnings:?}");
        if let Some((finest, found)) = contradicted {
            assert!((finest / f64::from(times) - 1.0).abs() < 1e-6, "{finest}");
            assert!((0.8..2.5).contains(found), "{found}");
        }
    }
}

#[test]
fn masses_that_differ_give_sizes_but_equal_masses_do_not() {
    let water = Sized::pools(&[1.0, 2.0]);
    let densities: Vec<f32> =
        (0..water.sizes.len()).map(|i| if i % 2 == 0 { 900.0 } else { 1100.0 }).collect();
    let volumes = water.sizes.iter().map(|size| size.powi(3));
    let masses: Vec<f32> = volumes.zip(&densities).map(|(volume, rho)| volume * rho).collect();
    let names = |masses: &[f32], densities: &[f32], size: Option<&str>| {
        let cloud =
            Cloud::new(&water.positions).with("Masses", masses).with("Densities", densities);
        let request = size.map_or(request(), |size| request().size(size));
        request.run(&cloud).unwrap().to_mesh().unwrap()
    };
    let found = names(&masses, &densities, None);
    assert!(found == names(&masses, &densities, Some("Masses")));
    assert!((measure(&found).volume.unwrap() / water.volume() - 1.0).abs() < 0.04);
    // In a gas, particles of equal mass have different volumes.
    let (equal, gas) = (vec![1.0; masses.len()], masses);
    assert!(names(&equal, &gas, None) == names(&equal, &gas, Some("none")));
}

#[test]
fn particles_of_one_size_give_the_same_mesh_as_without_sizes() {
    let water = Sized::pools(&[1.0]);
    let mut radii = water.radii();
    // Sizes that differ by less than 10 % count as equal.
    radii.iter_mut().step_by(3).for_each(|radius| *radius *= 1.08);
    let cloud = Cloud::new(&water.positions).with("radius", &radii);
    let with = request().run(&cloud).unwrap().to_mesh().unwrap();
    assert!(with == request().run(&water.positions).unwrap().to_mesh().unwrap());
    let spacing = request().spacing(1.0);
    let other = Sized { sizes: [1.0, 9.0].repeat(radii.len() / 2), ..water.clone() };
    let given = other.mesh(&spacing);
    assert!(
        given == spacing.run(&water.positions).unwrap().to_mesh().unwrap(),
        "with a given spacing, sizes must have no effect"
    );
}

#[test]
fn invalid_and_unusually_large_sizes_are_counted() {
    let water = Sized::pools(&[1.0, 2.0]);
    let mut radii = water.radii();
    (radii[0], radii[1], radii[2], radii[3]) = (0.0, f32::NAN, -1.0, 1e6);
    let cloud = Cloud::new(&water.positions).with("radius", &radii);
    let surface = request().run(&cloud).unwrap();
    let found = surface.report().warnings.iter().find_map(|warning| match warning {
        Warning::Spacing(SpacingWarning::Sizes { invalid, larger, usual, .. }) => {
            Some((*invalid, *larger, *usual))
        }
        _ => None,
    });
    assert_eq!(found, Some((3, 1, 1.0)));
}

#[test]
fn attributes_and_settings_that_cannot_define_sizes_are_refused() {
    let water = Sized::pools(&[1.0, 2.0]);
    let (radii, vectors) = (water.radii(), water.positions.iter().map(|_| [0.0_f32; 3]));
    let vectors: Vec<[f32; 3]> = vectors.collect();
    let nothing = vec![0.0_f32; radii.len()];
    let cloud = Cloud::new(&water.positions)
        .with("radius", &radii)
        .with("velocity", &vectors)
        .with("mass", &radii)
        .with("width", &nothing);
    let fault = |name: &str| match request().size(name).run(&cloud) {
        Err(Error::Sizes { fault, .. }) => fault,
        other => panic!("{name}: {other:?}"),
    };
    assert!(matches!(fault("depth"), SizeFault::NoAttribute { known, .. } if known.len() == 4));
    assert!(matches!(fault("velocity"), SizeFault::Components { components: 3, .. }));
    assert!(matches!(fault("mass"), SizeFault::NoDensity { .. }));
    assert!(matches!(fault("width"), SizeFault::NoSize { .. }));
    let both = request().size("radius").spacing(1.0);
    let Err(Error::SettingConflict(conflict)) = both.run(&cloud) else { panic!("spacing") };
    assert_eq!(conflict.setting.name(), "size");
    assert!(matches!(&conflict.with, Conflict::Setting(setting) if setting.name() == "spacing"));
}

#[test]
fn a_packed_frame_of_sizes_has_the_surface_of_its_particles() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sizes.mnf");
    let pools = Sized::pools(&[1.0, 2.0, 4.0]);
    let (boxed, faces) = pools_in_a_box();
    let walls = ([0.0; 3], [3.0 * WIDTH, WIDTH, f64::INFINITY]);
    let cases = [
        ("open", &pools, request()),
        ("walls", &pools, request().domain(walls.0, walls.1)),
        ("a periodic box", &boxed, request().periodic(faces)),
    ];
    for (what, water, request) in cases {
        let radii = water.radii();
        let cloud = Cloud::new(&water.positions).with("radius", &radii);
        let frame = request.sample(&cloud).unwrap();
        let packed = frame.pack(request.packed_output(&path, Replace::Allow).unwrap()).unwrap();
        assert!(packed.cells > 0 && packed.bricks > 0, "{what}: {packed:?}");
        let again = |by: Reconstruction| {
            let surface = by.run_file(&path).unwrap();
            text_of_obj(&surface.to_mesh().unwrap())
        };
        let meshed =
            |by: &Reconstruction| text_of_obj(&frame.surface_by(by).unwrap().to_mesh().unwrap());
        let expected = text_of_obj(&frame.surface().unwrap().to_mesh().unwrap());
        // The packed frame contains the walls and the periodic box.
        assert!(again(Reconstruction::new().threads(1)) == expected, "{what}");
        let little = Reconstruction::new().memory(MemoryBudget(24 << 20)).scratch(folder.path());
        assert!(again(little.clone().threads(2)) == expected, "{what}, little memory");
        if what == "open" {
            let smooth = request.clone().smooth(1.2);
            let found = again(little.smooth(1.2));
            assert!(found == meshed(&smooth), "the surfaces differ");
            assert!(found != expected, "the smoothing must have an effect");
        }
    }
}

#[test]
fn settings_that_need_one_size_refuse_particles_of_several_sizes() {
    let water = Sized::pools(&[1.0, 2.0]);
    let radii = water.radii();
    let cloud = Cloud::new(&water.positions).with("radius", &radii);
    let needs_one = |error: Error, name: &str| {
        let Error::SettingConflict(conflict) = error else { panic!("{name}: {error}") };
        assert_eq!(conflict.setting.name(), name);
        assert!(
            matches!(&conflict.with, Conflict::SeveralSizes { attribute } if attribute == "radius")
        );
    };
    for (request, name) in [
        (request().method(KernelMethod::ZhuBridson), "method"),
        (request().indicator(IndicatorKind::Counting), "indicator"),
    ] {
        needs_one(request.run(&cloud).unwrap_err(), name);
        request.size("none").run(&cloud).unwrap();
    }
}

/// Two pools next to each other along x, in a periodic box. Coordinates are multiples of 2^-10, so
/// that copies of particles are exact.
fn pools_in_a_box() -> (Sized, Faces) {
    let mut random = Random::new(21);
    // Along y, the box has almost the minimum width.
    let edges = [116.0, 58.0];
    let mut water = Sized::default()
        .with([[0.0; 3], [edges[0] / 2.0, edges[1], 12.0]], 1.0, &mut random)
        .with([[edges[0] / 2.0, 0.0, 0.0], [edges[0], edges[1], 12.0]], 2.0, &mut random);
    for position in &mut water.positions {
        *position = position.map(|x| (x * 1024.0).floor() / 1024.0);
    }
    (water, [Some([0.0, edges[0]]), Some([0.0, edges[1]]), None])
}

#[test]
fn in_a_periodic_box_sized_particles_have_the_surface_of_explicit_copies() {
    let (water, faces) = pools_in_a_box();
    let radii = water.radii();
    let cloud = Cloud::new(&water.positions).with("radius", &radii);
    let calibrated = request().periodic(faces).run(&cloud).unwrap().report().calibration.unwrap();
    let positions = repeated(&water.positions, faces);
    let all = Sized { positions, sizes: water.sizes.repeat(9) };
    let around = all.mesh(&request().calibrated(calibrated).normals(true));
    for (ends, margin) in [(PeriodicMesh::Cut, 1.0), (PeriodicMesh::Overlap, 0.0)] {
        let request = request().periodic(faces).periodic_mesh(ends).normals(true);
        let mesh = water.mesh(&request);
        assert_eq!(watertight::defect(&mesh), None);
        let [found, expected] = [&mesh, &around].map(|mesh| triangles_within(mesh, faces, margin));
        let both = found.intersection(&expected).count();
        assert!(
            expected.len() > 25_000 && found == expected,
            "{ends:?}: {both} of {} and {} triangles",
            found.len(),
            expected.len()
        );
        let (positions, count) = unwrapped(&water.positions, faces);
        let outside = Sized { positions, sizes: water.sizes.clone() };
        assert!(count > 100 && outside.mesh(&request) == mesh, "{ends:?}: {count} outside");
        assert!(water.mesh(&request.threads(1).memory(MemoryBudget(24 << 20))) == mesh);
    }
    let narrow = request().periodic([Some([0.0, 112.0]), Some([0.0, 50.0]), None]);
    let error = narrow.skip_invalid(true).run(&cloud).unwrap_err();
    assert!(matches!(error, Error::Periodic(PeriodicError::Narrow { axis: 'y', .. })), "{error}");
}

#[test]
fn sized_water_ends_at_solids_and_keeps_its_level_up_to_them() {
    let radius = 9.0;
    // Put balls into fine water, into coarse water, and at the seam between them.
    let centres = [[20.0, 20.0], [80.0, 20.0], [48.0, 44.0]].map(|[x, y]| [x, y, DEPTH]);
    let from_solid = |p: [f64; 3]| {
        let from = |centre: &[f64; 3]| DVec3::from(p).distance(DVec3::from(*centre)) - radius;
        centres.iter().map(from).fold(f64::MAX, f64::min)
    };
    let mut random = Random::new(8);
    let all = Sized::default().with([[0.0; 3], [48.0, 64.0, DEPTH]], 1.0, &mut random).with(
        [[48.0, 0.0, 0.0], [96.0, 64.0, DEPTH]],
        2.0,
        &mut random,
    );
    let mut water = Sized::default();
    for (position, size) in all.positions.iter().zip(&all.sizes) {
        if from_solid(*position) > 0.0 {
            water.positions.push(*position);
            water.sizes.push(*size);
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let balls = centres.map(|centre| moved(&sphere(radius, 5), centre));
    let solids: Vec<String> = (0..3)
        .map(|i| {
            let path = folder.path().join(format!("ball{i}.obj"));
            std::fs::write(&path, text_of_obj(&balls[i])).unwrap();
            path.to_str().unwrap().to_owned()
        })
        .collect();
    let plain = request().domain([0.0; 3], [96.0, 64.0, f64::INFINITY]);
    let at_solids = plain.solids(&solids).solid_offset(0.0);
    for cell in [0.25, 0.5] {
        let mesh = water.mesh(&at_solids.clone().cell(cell));
        assert_eq!(watertight::defect(&mesh), None);
        assert_eq!(measure(&mesh).components, 1);
        for (centre, size) in centres.into_iter().zip([1.0, 2.0, 2.0]) {
            let from = |p: &[f64; 3]| DVec3::from(*p).distance(DVec3::from(centre)) - radius;
            let under = |p: &&[f64; 3]| p[2] < DEPTH - 2.0 * size && from(p).abs() < 0.5;
            let errors: Vec<f64> = mesh.positions.iter().filter(under).map(from).collect();
            let [bias, rms] = mean_and_rms(&errors);
            assert!(bias.abs() < 0.02 && rms < 0.04, "cells {cell}, {centre:?}: {bias} {rms}");
            // Measure the water level next to the ball, whose equator is at the contact line.
            let beside = |p: &&[f64; 3]| {
                (p[2] - DEPTH).abs() < 1.5 * size && (0.5 * size..2.0 * size).contains(&from(p))
            };
            let level: Vec<f64> =
                mesh.positions.iter().filter(beside).map(|p| (p[2] - DEPTH) / size).collect();
            let [bias, rms] = mean_and_rms(&level);
            assert!(bias.abs() < 0.05 && rms < 0.1, "level {cell}, {centre:?}: {bias} {rms}");
        }
        let with_less = at_solids.clone().cell(cell).threads(1).memory(MemoryBudget(40 << 20));
        assert!(water.mesh(&with_less) == mesh);
    }
}

#[test]
fn walls_are_found_with_the_spacing_of_the_particles_at_them() {
    for (sizes, jitter) in [
        ([1.0, 2.0], 0.3),
        ([1.0, 3.0], 0.3),
        ([2.0, 1.0], 0.3),
        ([1.0, 1.4], 0.1),
        ([1.0, 2.0], 0.0),
    ] {
        let mut water = Sized::default();
        let all = Sized::jittered_pools(&sizes, jitter);
        for (&at, &size) in all.positions.iter().zip(&all.sizes) {
            if at[2] < 18.0 + 2.0 * (at[0] / 6.0).sin() + 2.0 * (at[1] / 5.0).cos() {
                water.positions.push(at);
                water.sizes.push(size);
            }
        }
        let radii = water.radii();
        let cloud = Cloud::new(&water.positions).with("radius", &radii);
        let surface = request().find_domain().run(&cloud).unwrap();
        let [lo, hi] = surface.report().facts.domain.expect("walls are found").walls();
        // The width of each pool is rounded to a multiple of the size of its particles.
        let [first, last] = sizes;
        let larger = first.max(last);
        let wide = [first, last].map(|size| (WIDTH / size).round() * size);
        for (at, expected, size) in [
            (lo.x, 0.0, first),
            (hi.x, WIDTH + wide[1], last),
            (lo.y, 0.0, larger),
            (hi.y, wide[0].max(wide[1]), larger),
            (lo.z, 0.0, larger),
        ] {
            assert!((at - expected).abs() < 0.3 * size, "{sizes:?}: {lo} {hi}, not {expected}");
        }
        assert_eq!(hi.z, f64::INFINITY);
    }
}

#[test]
fn sized_particles_in_parts_give_the_mesh_of_a_single_run() {
    let folder = tempfile::tempdir().unwrap();
    let [input, output, ball] =
        ["water.csv", "water.ply", "ball.obj"].map(|name| folder.path().join(name));
    // Put balls at a seam, and into the coarsest water.
    let balls = [[64.0, 40.0, DEPTH], [150.0, 30.0, DEPTH - 4.0]];
    let [one, other] = balls.map(|centre| moved(&sphere(8.0, 3), centre));
    std::fs::write(&ball, text_of_obj(&union(&one, &other))).unwrap();
    let (in_box, faces) = pools_in_a_box();
    // Make the water so long that some parts do not need all of it.
    let mut random = Random::new(17);
    let long = [[64.0, 0.0, 0.0], [384.0, 32.0, 16.0]];
    let two = Sized::default().with([[0.0; 3], [64.0, 32.0, 16.0]], 1.0, &mut random);
    let two = two.with(long, 2.0, &mut random);
    let more = [[3.0 * WIDTH, 0.0, 0.0], [9.0 * WIDTH, WIDTH, DEPTH]];
    let three = Sized::pools(&[1.0, 2.0, 4.0]).with(more, 4.0, &mut random);
    let plain = request().attributes(["heat"]).normals(true);
    let at_solid = plain.clone().solids([ball.to_str().unwrap()]).solid_offset(0.0);
    for (water, request) in [
        (&two, plain.clone().memory(MemoryBudget(64 << 20))),
        (&in_box, plain.periodic(faces)),
        (&three, at_solid),
    ] {
        let rows = water.positions.iter().zip(water.radii());
        let rows = rows.map(|([x, y, z], radius)| format!("{x},{y},{z},{radius},{x}\n"));
        let table = "x,y,z,radius,heat\n".to_owned() + &rows.collect::<String>();
        std::fs::write(&input, table).unwrap();
        let whole = request.open(&input).unwrap().sample().unwrap().surface().unwrap();
        let whole = whole.to_mesh().unwrap();
        let parts = request.parts(&input, &output, 5);
        let plan = parts.plan().unwrap();
        // Compare parts with the largest part and not with the input, because periodic images also
        // count as particles.
        let all = plan.parts.iter().map(|share| share.kept).max().unwrap();
        assert!(
            plan.parts.iter().any(|share| share.kept < all),
            "all parts keep the same number of particles"
        );
        (0..5).for_each(|part| drop(parts.part(part).unwrap()));
        assert!(parts.merge().unwrap().to_mesh().unwrap() == whole);
        std::fs::remove_dir_all(parts.folder()).unwrap();
    }
}

/// The mean and the root mean square of errors.
fn mean_and_rms(errors: &[f64]) -> [f64; 2] {
    assert!(errors.len() > 50, "{} vertices", errors.len());
    let count = errors.len() as f64;
    let squares: f64 = errors.iter().map(|error| error * error).sum();
    [errors.iter().sum::<f64>() / count, (squares / count).sqrt()]
}

/// A lake of coarse particles that contains a pool of fine particles, and a drop of coarse
/// particles above it.
fn lake(ratio: f64, random: &mut Random) -> Sized {
    let edge = 80.0 * ratio;
    let mut water = Sized::default().with([[0.0; 3], [edge, edge, 8.0 * ratio]], ratio, random);
    let pool = [[10.0, 12.0, 8.0 * ratio - 9.0], [26.0, 30.0, 8.0 * ratio]];
    let is_outside = |p: &[f64; 3]| (0..3).any(|a| p[a] < pool[0][a] || p[a] > pool[1][a]);
    let kept: Vec<bool> = water.positions.iter().map(is_outside).collect();
    let mut keep = kept.iter();
    water.positions.retain(|_| *keep.next().unwrap());
    let mut keep = kept.iter();
    water.sizes.retain(|_| *keep.next().unwrap());
    let water = water.with(pool, 1.0, random);
    let drop = [0.6 * edge, 0.7 * edge, 14.0 * ratio];
    water.with([drop, drop.map(|x| x + 2.0 * ratio)], ratio, random)
}

#[test]
fn cells_follow_particle_sizes_and_the_mesh_has_no_gaps() {
    for (ratio, cell) in [(2.0, 0.5), (4.0, 0.667), (2.9, 0.4)] {
        let water = lake(ratio, &mut Random::new(21));
        // These walls are not on cell faces.
        let walls = [[-0.37, -0.21, 0.13], [75.3 * ratio, f64::INFINITY, f64::INFINITY]];
        for request in [request(), request().domain(walls[0], walls[1])] {
            let mesh = water.mesh(&request.clone().cell(cell).normals(true));
            assert_eq!(watertight::defect(&mesh), None, "ratio {ratio}, cells of {cell}");
            let found = measure(&mesh);
            assert_eq!(found.components, 2);
            // If all cells were as small as the finest cells, the top and the bottom of the lake
            // would have more than `finest` triangles.
            let finest = 4.0 * (75.0 * ratio / cell).powi(2);
            assert!((mesh.triangles.len() as f64) < 0.6 * finest, "{}", mesh.triangles.len());
            // Normals must point to the outer side of the triangles, even at seams.
            let normals = mesh.normals.as_ref().unwrap();
            let mut against = 0;
            for triangle in &mesh.triangles {
                let corners = triangle.map(|corner| corner as usize);
                let [a, b, c] = corners.map(|corner| DVec3::from(mesh.positions[corner]));
                let face = (b - a).cross(c - a).normalize_or_zero();
                let normal = corners.map(|corner| DVec3::from(normals[corner].map(f64::from)));
                against += usize::from(face.dot(normal.iter().sum()) < 0.0);
            }
            assert!(against * 2000 < mesh.triangles.len(), "{against} normals point inwards");
        }
    }
}

#[test]
fn cells_of_several_levels_are_independent_of_order_threads_and_memory() {
    let water = lake(3.0, &mut Random::new(22));
    let walls = [[-0.37, -0.21, 0.13], [233.3, f64::INFINITY, f64::INFINITY]];
    let request = request().domain(walls[0], walls[1]).normals(true);
    let mesh = water.mesh(&request);
    let turned = Sized {
        positions: water.positions.iter().rev().copied().collect(),
        sizes: water.sizes.iter().rev().copied().collect(),
    };
    let with_less = request.clone().threads(1).memory(MemoryBudget(28 << 20));
    assert!(turned.mesh(&with_less) == mesh);
    let simplified = water.mesh(&request.simplify(0.1));
    assert_eq!(watertight::defect(&simplified), None);
    assert!(simplified.triangles.len() * 3 < mesh.triangles.len());
    let with_less = with_less.memory(MemoryBudget(48 << 20)).simplify(0.1);
    assert!(turned.mesh(&with_less) == simplified);
    // Simplified surfaces must also be closed if the surface lies at the border of chunks, with no
    // surface in the chunks below.
    let mut random = Random::new(23);
    let deep = Sized::default().with([[0.0, 0.0, -71.0], [128.0, 128.0, 33.0]], 2.0, &mut random);
    let deep = deep.with([[10.0, 12.0, 33.0], [26.0, 30.0, 37.0]], 1.0, &mut random);
    let simplified_lake = deep.mesh(&super::sizes::request().simplify(0.1));
    assert_eq!(watertight::defect(&simplified_lake), None);
    let [whole, less] = [&mesh, &simplified].map(|mesh| measure(mesh).volume.unwrap());
    assert!((less / whole - 1.0).abs() < 0.003, "{less} of {whole}");
    assert!((whole / water.volume() - 1.0).abs() < 0.03);
}

#[test]
fn a_small_ball_in_coarse_water_keeps_its_surface() {
    let mut random = Random::new(3);
    let coarse = Sized::default().with([[0.0; 3], [96.0, 96.0, 32.0]], 4.0, &mut random);
    let fine = Sized::default().with([[36.0, 36.0, 44.0], [60.0, 60.0, 68.0]], 1.0, &mut random);
    let mut all = coarse.clone();
    for (position, size) in fine.positions.iter().zip(&fine.sizes) {
        let from = DVec3::from(*position).distance(DVec3::new(48.0, 48.0, 56.0));
        if from < 10.0 {
            all.positions.push(*position);
            all.sizes.push(*size);
        }
    }
    let mesh = all.mesh(&request());
    assert_eq!(watertight::defect(&mesh), None);
    let found = measure(&mesh);
    assert_eq!(found.components, 2);
    assert!((found.volume.unwrap() / all.volume() - 1.0).abs() < 0.05);
    let ball = 4.0 / 3.0 * PI * 1000.0;
    assert!((all.volume() - coarse.volume()) / ball > 0.9);
}
