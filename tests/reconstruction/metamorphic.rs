//! Metamorphic tests: a frame that is moved, mirrored, scaled, repeated or computed differently
//! gives the corresponding mesh.
//!
//! `MENISCUS_RELATIONS=500` tries 500 frames, and `MENISCUS_RELATION=77` repeats number 77.

use glam::DVec3;
use meniscus::internals::field::calibration::Calibration;
use meniscus::internals::grid::BLOCK;
use meniscus::mesh::Mesh;
use meniscus::{IndicatorKind, MemoryBudget, Reconstruction, Surface};

use crate::common::periodic::{repeated, triangles_within};
use crate::common::scene::Random;
use crate::common::{shuffle, watertight};

/// Default number of frames to try.
const FRAMES: u64 = 4;

/// Edge of a cell, in spacings. All lengths have few binary digits, so that they are exact.
const CELL: f64 = 0.5;
/// Number of coordinate steps per spacing. Particles are at half steps, so that no particle lies on
/// a cell face.
const STEPS: f64 = 64.0;
/// Maximum distance between corresponding vertices, in spacings. It is nonzero because positions
/// are rounded.
const NEAR: f64 = 1e-9;
/// Maximum distance between corresponding vertices of mirrored meshes, in spacings. Positions in a
/// cell are rounded down, which moves the surface where the field is nearly flat, such as at the
/// rims of sheets.
const NEAR_IN_MIRROR: f64 = 0.1;

/// Water at spacing 1 within 6 spacings of the origin: a pool, a ball or two, and spray.
fn water(random: &mut Random) -> Vec<DVec3> {
    let (pool, hole) = (random.bits().is_multiple_of(2), random.bits().is_multiple_of(2));
    let mut unit = || random.unit();
    let balls: Vec<(DVec3, f64)> = (0..2)
        .map(|_| (DVec3::new(unit(), unit(), unit()) * 5.0 - 2.5, 1.5 + 1.5 * unit()))
        .collect();
    let is_wet = |p: DVec3| {
        let in_ball = balls.iter().any(|(centre, radius)| p.distance(*centre) < *radius);
        let in_pool = pool && (-5.0..-2.5).contains(&p.y) && p.x.abs().max(p.z.abs()) < 5.0;
        in_ball || in_pool && !(hole && p.x.hypot(p.z) < 2.0)
    };
    let mut particles = Vec::new();
    for x in -6..6 {
        for y in -6..6 {
            for z in -6..6 {
                let jitter = DVec3::new(unit(), unit(), unit());
                let p = DVec3::new(x.into(), y.into(), z.into()) + jitter;
                if is_wet(p) || unit() < 0.01 {
                    particles.push(((STEPS * p).floor() + 0.5) / STEPS);
                }
            }
        }
    }
    particles
}

fn arrays(particles: impl IntoIterator<Item = DVec3>) -> Vec<[f64; 3]> {
    particles.into_iter().map(|p| p.to_array()).collect()
}

/// A frame, the request for its surface, and its mesh.
struct Frame {
    seed: u64,
    particles: Vec<DVec3>,
    request: Reconstruction,
    mesh: Mesh,
    calibration: Calibration,
}

impl Frame {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed.wrapping_mul(0x9e37_79b9).wrapping_add(11));
        let particles = water(&mut random);
        let kinds = [IndicatorKind::Cloud, IndicatorKind::Cloud, IndicatorKind::Counting];
        let request = Reconstruction::new()
            .spacing(1.0)
            .cell_size(CELL)
            .origin([0.0; 3])
            .indicator(kinds[(random.bits() % 3) as usize])
            .threads(1);
        let surface = request.run(&arrays(particles.clone())).unwrap();
        let calibration = surface.report().calibration.unwrap();
        // Fix the calibration, because its measurement depends on the orientation of the frame.
        let request = request.calibrated(calibration);
        Self { seed, particles, request, mesh: surface.to_mesh().unwrap(), calibration }
    }

    fn of(&self, request: &Reconstruction, particles: &[[f64; 3]], what: &str) -> Mesh {
        let surface: Surface =
            request.run(particles).unwrap_or_else(|error| panic!("{}, {what}: {error}", self.seed));
        let mesh = surface.to_mesh().unwrap();
        assert_eq!(watertight::defect(&mesh), None, "frame {}, {what}", self.seed);
        mesh
    }

    /// Reconstructs the particles after moving each with `place`.
    fn moved(&self, what: &str, place: impl Fn(DVec3) -> DVec3) -> Mesh {
        self.of(&self.request, &arrays(self.particles.iter().map(|&p| place(p))), what)
    }

    /// Checks that a mesh has the frame's vertices, moved by `place` and in any order.
    fn assert_placed(&self, found: &Mesh, near: f64, what: &str, place: impl Fn(DVec3) -> DVec3) {
        let expected = self.mesh.positions.iter().map(|&p| place(p.into()));
        assert_same_places(found, expected, near, &format!("frame {}, {what}", self.seed));
        let [found, own] = [volume(found), volume(&self.mesh)];
        assert!((found - own).abs() < 1e-3 * own, "frame {}, {what}: {found}, {own}", self.seed);
    }
}

/// Checks that a mesh has a vertex near each of these positions, and no others.
fn assert_same_places(
    mesh: &Mesh,
    expected: impl IntoIterator<Item = DVec3>,
    within: f64,
    what: &str,
) {
    let by_x = |places: &mut dyn Iterator<Item = DVec3>| {
        let mut all: Vec<DVec3> = places.collect();
        all.sort_by(|a, b| a.x.total_cmp(&b.x));
        all
    };
    let found = by_x(&mut mesh.positions.iter().map(|&p| p.into()));
    let expected = by_x(&mut expected.into_iter());
    let alone = |some: &[DVec3], others: &[DVec3]| -> Vec<DVec3> {
        let has_near = |p: &DVec3| {
            let from = others.partition_point(|other| other.x < p.x - within);
            let mut near = others[from..].iter().take_while(|other| other.x <= p.x + within);
            near.any(|other| other.distance(*p) < within)
        };
        some.iter().copied().filter(|p| !has_near(p)).collect()
    };
    // In a mirrored mesh, a cell that is almost on the surface can change sides, which also changes
    // the vertices around the cell.
    let most = if within > NEAR { expected.len() / 100 } else { 0 };
    for alone in [alone(&found, &expected), alone(&expected, &found)] {
        assert!(alone.len() <= most, "{what}: vertices without a near counterpart: {alone:?}");
    }
    let apart = found.len().abs_diff(expected.len());
    assert!(apart <= most, "{what}: {} and {} vertices", found.len(), expected.len());
}

fn volume(mesh: &Mesh) -> f64 {
    let corner = |v: u32| DVec3::from(mesh.positions[v as usize]);
    let of = |t: &[u32; 3]| corner(t[0]).dot(corner(t[1]).cross(corner(t[2]))) / 6.0;
    mesh.triangles.iter().map(of).sum()
}

fn moving_a_frame_by_whole_blocks_moves_its_mesh(frame: &Frame, random: &mut Random) {
    let mut blocks = || (random.bits() % 256) as f64 - 128.0;
    let by = f64::from(BLOCK) * CELL * DVec3::new(blocks(), blocks(), blocks());
    let found = frame.moved("moved", |p| p + by);
    assert_eq!(found.triangles.len(), frame.mesh.triangles.len(), "frame {}", frame.seed);
    frame.assert_placed(&recentred(found, by), NEAR, "moved", |p| p);
}

/// Moves a mesh back to the origin, where its volume is computed more precisely.
fn recentred(mut mesh: Mesh, by: DVec3) -> Mesh {
    mesh.positions.iter_mut().for_each(|p| *p = (DVec3::from(*p) - by).to_array());
    mesh
}

fn the_order_of_particles_does_not_change_the_mesh(frame: &Frame, random: &mut Random) {
    let mut particles = arrays(frame.particles.clone());
    shuffle(&mut particles, random);
    assert!(frame.of(&frame.request, &particles, "shuffled") == frame.mesh, "{}", frame.seed);
}

fn a_mirrored_frame_has_the_mirrored_mesh(frame: &Frame, random: &mut Random) {
    let mut sign = DVec3::ONE;
    sign[(random.bits() % 3) as usize] = -1.0;
    let found = frame.moved("mirrored", |p| sign * p);
    frame.assert_placed(&found, NEAR_IN_MIRROR, "mirrored", |p| sign * p);
}

fn scaling_by_a_power_of_two_scales_each_vertex_exactly(frame: &Frame, random: &mut Random) {
    let scale = 2_f64.powi((random.bits() % 40) as i32 - 20);
    let request = frame.request.clone().spacing(scale).cell_size(CELL * scale);
    let particles = arrays(frame.particles.iter().map(|&p| p * scale));
    let found = frame.of(&request, &particles, "scaled");
    let expected: Vec<_> = frame.mesh.positions.iter().map(|p| p.map(|x| x * scale)).collect();
    assert!(found.positions == expected, "frame {} by {scale}", frame.seed);
    assert!(found.triangles == frame.mesh.triangles, "frame {} by {scale}", frame.seed);
}

fn two_distant_copies_give_two_copies_of_the_mesh(frame: &Frame, random: &mut Random) {
    let mut away = DVec3::ZERO;
    away[(random.bits() % 3) as usize] = 3.0 * f64::from(BLOCK) * CELL;
    let both = frame.particles.iter().flat_map(|&p| [p - away, p + away]);
    let found = frame.of(&frame.request, &arrays(both), "twice");
    assert_eq!(found.triangles.len(), 2 * frame.mesh.triangles.len(), "frame {}", frame.seed);
    let places = frame.mesh.positions.iter().map(|&p| DVec3::from(p));
    let expected = places.flat_map(|p| [p - away, p + away]);
    assert_same_places(&found, expected, NEAR, &format!("frame {}, twice", frame.seed));
}

fn a_periodic_box_has_the_mesh_of_repeated_particles(frame: &Frame, random: &mut Random) {
    let mut faces = [None; 3];
    faces[(random.bits() % 3) as usize] = Some([-16.0, 16.0]);
    let particles = arrays(frame.particles.clone());
    let periodic = frame.request.clone().periodic(faces);
    let found = frame.of(&periodic, &particles, "periodic");
    let expected = frame.of(&frame.request, &repeated(&particles, faces), "repeated");
    // Ignore triangles near the faces, where the cut closes the periodic mesh.
    let [found, expected] = [found, expected].map(|mesh| triangles_within(&mesh, faces, 1.5));
    assert!(found == expected && !found.is_empty(), "frame {}", frame.seed);
}

fn threads_and_memory_do_not_change_the_mesh(frame: &Frame, _: &mut Random) {
    let particles = arrays(frame.particles.clone());
    let small = MemoryBudget(16 << 20);
    for request in [
        frame.request.clone().threads(3),
        frame.request.clone().memory(small),
        frame.request.clone().memory(small).threads(2),
    ] {
        assert!(
            frame.of(&request, &particles, "with other threads or memory") == frame.mesh,
            "{}",
            frame.seed
        );
    }
}

fn finer_cells_enclose_about_the_same_volume(frame: &Frame, _: &mut Random) {
    // Except for clouds, a calibration is only valid for one cell size.
    let Calibration::Clouds { .. } = frame.calibration else { return };
    let request = Reconstruction::new().spacing(1.0).origin([0.0; 3]).threads(2);
    let particles = arrays(frame.particles.clone());
    let [coarse, fine] = [CELL, CELL / 2.0].map(|cell| {
        let cells = request.clone().cell_size(cell);
        volume(&frame.of(&cells, &particles, "in other cells"))
    });
    assert!((fine / coarse - 1.0).abs() < 0.1, "frame {}: {coarse} and {fine}", frame.seed);
}

#[test]
fn transforming_a_frame_transforms_its_mesh() {
    let number =
        |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().expect("a number"));
    let seeds = match number("MENISCUS_RELATION") {
        Some(seed) => seed..seed + 1,
        None => 0..number("MENISCUS_RELATIONS").unwrap_or(FRAMES),
    };
    for seed in seeds {
        let (frame, mut random) = (Frame::new(seed), Random::new(seed.wrapping_add(1)));
        assert!(frame.mesh.triangles.len() > 100, "frame {seed} has almost no surface");
        let relations: [fn(&Frame, &mut Random); 8] = [
            moving_a_frame_by_whole_blocks_moves_its_mesh,
            the_order_of_particles_does_not_change_the_mesh,
            a_mirrored_frame_has_the_mirrored_mesh,
            scaling_by_a_power_of_two_scales_each_vertex_exactly,
            two_distant_copies_give_two_copies_of_the_mesh,
            a_periodic_box_has_the_mesh_of_repeated_particles,
            threads_and_memory_do_not_change_the_mesh,
            finer_cells_enclose_about_the_same_volume,
        ];
        relations.iter().for_each(|relation| relation(&frame, &mut random));
    }
}
