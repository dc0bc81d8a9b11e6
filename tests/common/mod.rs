//! Code that all tests share: random scenes, particles, files, the program, settings, and the
//! oracle.
#![allow(dead_code, reason = "each test program uses only some of these items")]

pub mod alone;
pub mod attributed;
pub mod dense;
pub mod device;
pub mod distances;
pub mod files;
pub mod particle_files;
pub mod periodic;
pub mod program;
#[path = "../../tools/bench/scene.rs"]
pub mod scene;
pub mod shapes;
pub mod watertight;

use glam::{DVec3, IVec3};
use meniscus::internals::brick::{Bins, BrickSide, Census, DifField, FrameFacts, InvalidParticles};
use meniscus::internals::field::calibration::MeasuredCalibration;
use meniscus::internals::field::indicator::{Indicator, IndicatorKind, SampledDif};
use meniscus::internals::field::recipe::Recipe;
use meniscus::internals::frame::{Engine, Resources, Sampling, Surfacing};
use meniscus::internals::grid::units::{Isovalue, MemoryBudget};
use meniscus::internals::grid::{Domain, Grid};
use meniscus::internals::particles::Particles;
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::system::timings::Timings;
use scene::Random;

pub const INDICATORS: [IndicatorKind; 3] =
    [IndicatorKind::Symmetry, IndicatorKind::Counting, IndicatorKind::Cloud];

/// Default settings of the tests: cells of edge 1, the grid's origin at 0, and the symmetry
/// indicator.
pub fn sampling() -> Sampling {
    Sampling {
        grid: Grid::new(DVec3::ZERO, 1.0).unwrap(),
        domain: None,
        periodic: None,
        method: IndicatorKind::Symmetry.into(),
        invalid: InvalidParticles::Refuse,
        side: BrickSide::Eight,
        carried: Vec::new(),
        kinds: Vec::new(),
        sizes: None,
        spacing: None,
        resources: Resources::new(MemoryBudget(8 << 30), std::env::temp_dir()),
    }
}

pub fn surfacing() -> Surfacing {
    Surfacing::PLAIN
}

/// A surface in memory.
pub struct Reconstructed {
    pub mesh: Mesh,
    pub iso: Isovalue,
}

/// The field of a frame, which must have been computed by an indicator.
pub fn dif(frame: &Engine) -> &SampledDif {
    frame.dif().expect("an indicator has sampled the frame")
}

/// A sampled frame with the given field, which has cells of edge 1 and no particles.
pub fn sampled(dif: DifField) -> SampledDif {
    let (grid, census) = (sampling().grid, Census::default());
    SampledDif::new(
        FrameFacts { grid, domain: None, periodic: None, census, spacing: None },
        Indicator::Symmetry,
        dif,
    )
}

/// Calibrates a frame, and returns the recipe of its field and the calibration.
pub fn recipe(frame: &Engine, surfacing: &Surfacing) -> (Recipe, MeasuredCalibration) {
    let measured = surfacing.calibrate(dif(frame)).unwrap();
    (surfacing.recipe(dif(frame), &measured.calibration), measured)
}

pub fn reconstruct(
    particles: &(impl Particles + ?Sized),
    sampling: &Sampling,
    surfacing: &Surfacing,
) -> (Engine, Reconstructed) {
    let mut timings = Timings::default();
    let frame = Engine::sample(&particles, sampling, &mut timings).unwrap();
    let calibrated = frame.calibrate(surfacing, None, &mut timings).unwrap();
    let iso = calibrated.measured().unwrap().calibration.iso().unwrap_or(Isovalue::ZERO_DISTANCE);
    let mesh = calibrated.surface(&mut timings).unwrap().to_mesh().unwrap();
    (frame, Reconstructed { mesh, iso })
}

/// The number of cells that contain particles.
pub fn full_cells(bins: &Bins) -> u64 {
    let of_bin = |bin: usize| {
        let contents = bins.contents(bin).unwrap();
        contents.particles().map(|(cell, _)| cell).collect::<std::collections::BTreeSet<_>>().len()
            as u64
    };
    (0..bins.keys().len()).map(of_bin).sum()
}

/// Blobs, a sheet and spray around the origin, about 40 cells across, with about two particles per
/// cell.
pub fn splashes(seed: u64) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    let mut particles = Vec::new();
    for _ in 0..4 {
        let centre = DVec3::new(random.unit(), random.unit(), random.unit()) * 24.0 - 12.0;
        let radius = 2.0 + 5.0 * random.unit();
        let count = (8.4 * radius.powi(3)) as usize;
        particles.extend(std::iter::repeat_with(|| ball(&mut random, centre, radius)).take(count));
    }
    particles.extend(
        (0..600).map(|_| [30.0 * random.unit() - 15.0, -14.3, 30.0 * random.unit() - 15.0]),
    );
    particles.extend((0..60).map(|_| std::array::from_fn(|_| 40.0 * random.unit() - 20.0)));
    shuffle(&mut particles, &mut random);
    particles
}

fn ball(random: &mut Random, centre: DVec3, radius: f64) -> [f64; 3] {
    loop {
        let p = DVec3::new(random.unit(), random.unit(), random.unit()) * 2.0 - 1.0;
        if p.length_squared() < 1.0 {
            return (centre + radius * p).to_array();
        }
    }
}

pub fn shuffle<T>(items: &mut [T], random: &mut Random) {
    for i in (1..items.len()).rev() {
        items.swap(i, (random.bits() % (i as u64 + 1)) as usize);
    }
}

/// Particles at the lattice points for which `inside` returns true. There are `per_axis` points
/// along a cell's edge. Each particle is moved along each axis by up to `jitter` spacings of the
/// lattice.
pub fn fill(
    half: f64,
    per_axis: f64,
    jitter: f64,
    seed: u64,
    inside: impl Fn(DVec3) -> bool,
) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    let steps = (half * per_axis) as i32;
    let mut particles = Vec::new();
    for z in -steps..steps {
        for y in -steps..steps {
            for x in -steps..steps {
                let lattice = (IVec3::new(x, y, z).as_dvec3() + 0.5) / per_axis;
                let shift = DVec3::new(random.unit(), random.unit(), random.unit()) - 0.5;
                if inside(lattice) {
                    particles.push((lattice + 2.0 * jitter / per_axis * shift).to_array());
                }
            }
        }
    }
    particles
}

/// A tank around the middle of [`splashes`], with walls between the faces of cells.
pub fn uneven_tank(grid: &Grid) -> Domain {
    Domain::new(grid, DVec3::new(-13.4, -14.8, -11.0), DVec3::new(12.3, 9.0, 13.6)).unwrap()
}

/// A tank around the middle of [`splashes`], with its walls on cell faces.
pub fn tank(grid: &Grid) -> Domain {
    Domain::new(grid, DVec3::new(-13.0, -15.0, -11.0), DVec3::new(12.0, 9.0, 14.0)).unwrap()
}
