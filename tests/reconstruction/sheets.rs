//! Tests of stretched sheets and filaments of particles.

use std::f64::consts::TAU;
use std::ops::Range;

use glam::{DMat3, DVec3};
use meniscus::Reconstruction;
use meniscus::mesh::{Measures, measure};

use crate::common::scene::Random;
use crate::common::watertight;

/// Number of particles along an edge of a sheet.
const EDGE: u32 = 14;

/// A jittered sheet that is rotated against the grid, and stretched along both of its axes.
///
/// Stretching brings the layers closer together. Jitter moves every particle by up to a fifth of a
/// spacing along each axis.
fn sheet(layers: u32, stretch: f64, random: &mut Random) -> Vec<[f64; 3]> {
    let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.5 + random.unit(), random.unit(), 0.3);
    let mut particles = Vec::new();
    for layer in 0..layers {
        for i in 0..EDGE * EDGE {
            let place = [i % EDGE, layer, i / EDGE].map(f64::from);
            let scale = DVec3::new(stretch, stretch.powi(-2), stretch);
            let jitter = DVec3::from([(); 3].map(|()| 0.4 * random.unit() - 0.2));
            particles.push((turn * (DVec3::from(place) * scale + jitter)).to_array());
        }
    }
    particles
}

/// A round film of particles on the plane y = 0, with jittered layers that are stretched along the
/// plane. Stretching brings the layers closer together.
pub fn film(layers: u32, stretch: f64, random: &mut Random) -> Vec<[f64; 3]> {
    const RADIUS: f64 = 9.0;
    let (sin, cos) = random.unit().sin_cos();
    let edge = (2.0 * RADIUS / stretch).ceil() as u32 + 1;
    let mut particles = Vec::new();
    for i in 0..edge * edge * layers {
        let [x, z] = [i % edge, i / edge % edge].map(|k| f64::from(k) * stretch - RADIUS);
        let [to_x, to_y, to_z] = [(); 3].map(|()| 0.4 * random.unit() - 0.2);
        let y = (f64::from(i / (edge * edge)) + 0.5 + to_y) / (stretch * stretch);
        if x * x + z * z < RADIUS * RADIUS {
            let (x, z) = (x + to_x, z + to_z);
            particles.push([x * cos - z * sin, y, x * sin + z * cos]);
        }
    }
    particles
}

/// For each film, the number of layers and the factor by which it is stretched.
pub const FILMS: [(u32, f64); 6] = [(1, 1.0), (1, 1.2), (1, 1.4), (1, 1.6), (2, 1.0), (2, 1.4)];

/// Checks that the surface of a film is a single piece without holes, and that the ratio of its
/// volume to the volume of the particles is in `ratios`.
pub fn assert_whole(
    request: &Reconstruction,
    particles: &[[f64; 3]],
    ratios: Range<f64>,
    what: &str,
) {
    let found = measures_of(request, particles);
    assert_eq!((found.components, found.genus), (1, Some(0)), "{what}");
    let volume = found.volume.unwrap() / particles.len() as f64;
    assert!(ratios.contains(&volume), "{what}: {volume}");
}

fn measured(particles: &[[f64; 3]], cell: f64, sheets: f64) -> Measures {
    measures_of(&of_cells(cell).sheets(sheets), particles)
}

fn measures_of(request: &Reconstruction, particles: &[[f64; 3]]) -> Measures {
    let mesh = request.run(particles).unwrap().to_mesh().unwrap();
    assert_eq!(watertight::defect(&mesh), None);
    measure(&mesh)
}

pub fn of_cells(cell: f64) -> Reconstruction {
    Reconstruction::new().spacing(1.0).cell_size(cell)
}

#[test]
fn sheets_stretched_to_1_9_spacings_stay_whole_and_keep_their_volume() {
    // Each sheet has a number of layers, a stretch, and, for cells of 0.5 and of 0.25 spacings, the
    // largest allowed ratio of the surface's volume to the particles' volume.
    let sheets = [
        (1, 1.0, [1.3, 1.3]),
        (1, 1.08, [1.3, 1.2]),
        (1, 1.3, [1.4, 1.2]),
        (1, 1.6, [2.1, 1.2]),
        (1, 1.9, [2.9, 1.6]),
        (2, 1.4, [1.4, 1.3]),
        (2, 1.9, [1.5, 1.2]),
    ];
    for (layers, stretch, most) in sheets {
        for (cell, most) in [0.5, 0.25].into_iter().zip(most) {
            let particles = sheet(layers, stretch, &mut Random::new(7));
            let found = measured(&particles, cell, 2.15);
            let what = format!("{layers} layers stretched {stretch} times in cells of {cell}");
            assert_eq!((found.components, found.genus), (1, Some(0)), "{what}");
            let volume = found.volume.unwrap() / particles.len() as f64;
            assert!((0.8..most).contains(&volume), "{what}: {volume}");
        }
    }
    let torn = measured(&sheet(1, 1.5, &mut Random::new(7)), 0.25, 0.0);
    assert!(torn.genus > Some(20), "{torn:?}");
}

#[test]
fn curved_sheets_and_distant_layers_stay_whole() {
    const RADIUS: f64 = 6.0;
    let mut random = Random::new(5);
    let mut jittered = |place: DVec3, most: f64| {
        let jitter = DVec3::from([(); 3].map(|()| 2.0 * most * random.unit() - most));
        (place + jitter).to_array()
    };
    // Golden angles spread the particles of a shell evenly, 1.6 spacings apart.
    let count = (2.0 * TAU * RADIUS * RADIUS / (1.6 * 1.6)) as u32;
    let shell: Vec<[f64; 3]> = (0..count)
        .map(|i| {
            let i = f64::from(i) + 0.5;
            let height = 1.0 - 2.0 * i / f64::from(count);
            let (sin, cos) = (2.399_963 * i).sin_cos();
            let across = (1.0 - height * height).sqrt();
            jittered(RADIUS * DVec3::new(across * cos, across * sin, height), 0.1)
        })
        .collect();
    // A shell has an outer and an inner surface.
    let found = measured(&shell, 0.25, 2.15);
    assert_eq!((found.components, found.genus), (2, Some(0)), "a shell");

    let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.7, 0.4, 0.3);
    let layers: Vec<[f64; 3]> = (0..2 * EDGE * EDGE)
        .map(|i| {
            let [x, y, z] = [i % EDGE, i / EDGE % EDGE, i / (EDGE * EDGE)].map(f64::from);
            jittered(turn * DVec3::new(1.5 * x, 1.5 * y, z), 0.15)
        })
        .collect();
    let found = measured(&layers, 0.25, 2.15);
    assert_eq!((found.components, found.genus), (1, Some(0)), "two layers a spacing apart");
}

#[test]
fn a_sheet_stretched_beyond_the_limit_breaks_into_drops() {
    let particles = sheet(1, 2.6, &mut Random::new(3));
    let found = measured(&particles, 0.25, 2.15);
    assert!(found.components > particles.len() * 9 / 10, "{}", found.components);
    let volume = found.volume.unwrap() / particles.len() as f64;
    assert!((0.7..1.1).contains(&volume), "{volume}");
    // A few particles at the corners of the sheet may remain drops.
    assert!(measured(&particles, 0.25, 3.0).components < 10);
}

#[test]
fn joining_sheets_neither_connects_nor_shrinks_drops_of_spray() {
    for (apart, cell) in [(3.0, 0.5), (4.0, 0.5), (3.0, 0.4), (3.0, 0.25)] {
        let mut random = Random::new(11);
        let edge = 10.0 * apart;
        let spray: Vec<[f64; 3]> =
            (0..1000).map(|_| [(); 3].map(|()| edge * random.unit())).collect();
        let [with, without] = [2.15, 0.0].map(|sheets| measured(&spray, cell, sheets));
        let range = without.components * 9 / 10..=without.components * 51 / 50;
        let what = format!("{apart}, {cell}: {with:?} instead of {without:?}");
        assert!(range.contains(&with.components), "{what}");
        let volume = with.volume.unwrap() / without.volume.unwrap();
        assert!((0.9..1.1).contains(&volume), "{what}");
    }
}

#[test]
fn stretched_filaments_stay_connected_and_keep_their_volume() {
    let along = DVec3::new(0.6, 0.48, 0.64);
    for stretch in [1.0, 1.4, 1.8, 2.1] {
        let particles: Vec<[f64; 3]> =
            (0..20).map(|i| (along * f64::from(i) * stretch).to_array()).collect();
        let found = measured(&particles, 0.25, 2.15);
        assert_eq!((found.components, found.genus), (1, Some(0)), "{stretch}");
        let volume = found.volume.unwrap() / 20.0;
        assert!((0.9..1.1).contains(&volume), "{stretch}: {volume}");
    }
}

/// A pool six particles deep. A crown (a tube of one layer of particles) stands on it, and a
/// filament stands in the middle of the crown. The crown and the filament are stretched. All
/// particles are jittered and rotated against the grid.
fn splash(stretch: f64) -> Vec<[f64; 3]> {
    let mut random = Random::new(19);
    let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.7, 0.4, 0.3);
    let mut particles = Vec::new();
    let mut add = |place: DVec3, jitter: f64| {
        let off = DVec3::from([(); 3].map(|()| jitter * (2.0 * random.unit() - 1.0)));
        particles.push((turn * (place + off)).to_array());
    };
    for i in 0..30 * 30 * 6 {
        let place = [i % 30, i / 900, i / 30 % 30].map(f64::from);
        add(DVec3::from(place) - DVec3::new(14.5, 5.5, 14.5), 0.2);
    }
    let around = (TAU * 7.0 / stretch).round() as u32;
    for row in 0..(8.0 / stretch) as u32 {
        let height = (f64::from(row) + 0.5) * stretch;
        for i in 0..around {
            let (sin, cos) = (TAU * f64::from(i) / f64::from(around)).sin_cos();
            add(DVec3::new(7.0 * cos, height, 7.0 * sin), 0.2);
        }
        add(DVec3::new(0.3, height, -0.2), 0.1);
    }
    particles
}

#[test]
fn sheets_and_filaments_on_water_stay_connected_to_the_water() {
    for (stretch, cell) in [(1.0, 0.5), (1.3, 0.5), (1.3, 0.25), (1.6, 0.5), (1.6, 0.25)] {
        let particles = splash(stretch);
        let found = measured(&particles, cell, 2.15);
        assert_eq!((found.components, found.genus), (1, Some(0)), "{stretch}, cells of {cell}");
    }
    let torn = measured(&splash(1.6), 0.25, 0.0);
    assert!(torn.genus > Some(20), "{torn:?}");
}

#[test]
fn films_on_a_floor_stay_whole_at_several_floor_heights() {
    for (layers, stretch) in FILMS {
        for (cell, floor) in [(0.5, 0.0), (0.5, 0.37), (0.5, 0.75), (0.25, 0.0), (0.25, 0.25)] {
            let raised = |[x, y, z]: [f64; 3]| [x, y + floor, z];
            let film = film(layers, stretch, &mut Random::new(5));
            let particles: Vec<_> = film.into_iter().map(raised).collect();
            let open = f64::INFINITY;
            let request = of_cells(cell).origin([0.0; 3]).domain([-open, floor, -open], [open; 3]);
            let what = format!("{layers} layers, {stretch}, cells of {cell}, floor at {floor}");
            assert_whole(&request, &particles, 0.85..1.5, &what);
        }
    }
}

#[test]
fn the_height_of_the_floor_does_not_change_a_film() {
    let open = f64::INFINITY;
    for (layers, stretch) in FILMS {
        for cell in [0.5, 0.25] {
            let volume = |floor: f64| {
                let film = film(layers, stretch, &mut Random::new(5));
                let raised: Vec<_> = film.into_iter().map(|[x, y, z]| [x, y + floor, z]).collect();
                let request = of_cells(cell).domain([-open, floor, -open], [open; 3]);
                let what = format!("{layers} layers, {stretch}, cells of {cell}, floor at {floor}");
                assert_whole(&request, &raised, 0.9..1.3, &what);
                measures_of(&request, &raised).volume.unwrap()
            };
            let at_zero = volume(0.0);
            for floor in [0.07, 0.125, 0.25, 0.37, 0.85, -1.3] {
                let ratio = volume(floor) / at_zero;
                assert!((ratio - 1.0).abs() < 0.002, "{layers}, {stretch}, {cell}: {ratio}");
            }
        }
    }
}

#[test]
fn sheet_handling_does_not_change_lone_particles_and_bulk_fluid() {
    let mut random = Random::new(5);
    let apart = (0..27).map(|i| [i % 3, i / 3 % 3, i / 9].map(|x| 6.0 * f64::from(x)));
    let moved = |p: [f64; 3], random: &mut Random| p.map(|x| x + random.unit());
    let mut particles: Vec<[f64; 3]> = apart.map(|p| moved(p, &mut random)).collect();
    for i in 0..1000 {
        let place = [i % 10, i / 10 % 10, i / 100].map(|x| f64::from(x) - 30.0);
        particles.push(moved(place, &mut random));
    }
    let of = |sheets| {
        let request = Reconstruction::new().spacing(1.0).cell_size(0.5).sheets(sheets);
        request.run(&particles).unwrap().to_mesh().unwrap()
    };
    let (with, without) = (of(2.15), of(0.0));
    let volume = |mesh: &_| measure(mesh).volume.unwrap();
    assert_eq!(measure(&with).components, 28);
    assert!((volume(&with) / volume(&without) - 1.0).abs() < 0.002);
}
