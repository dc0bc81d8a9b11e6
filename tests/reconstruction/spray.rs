//! Tests of spray, which is meshed drop by drop. The mesh must be the same as if complete blocks
//! were meshed.

use glam::DVec3;
use meniscus::internals::backend::{Cpu, Executor, Surfaces, field};
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::frame::{Engine, Normals, Sampling, Surfacing};
use meniscus::internals::grid::units::{MemoryBudget, SheetStretch};
use meniscus::internals::grid::{Domain, PeriodicMesh};
use meniscus::internals::surface::dual_mc::block_mesh;
use meniscus::internals::system::timings::Timings;

use crate::common::device::contoured;
use crate::common::scene::Random;
use crate::common::{dif, recipe, sampling, surfacing};

/// Random particles, on average `apart` spacings apart, with a pair, a clump and a filament.
fn spray(apart: f64, random: &mut Random) -> Vec<[f64; 3]> {
    let edge = 5.0 * apart;
    let mut particles: Vec<[f64; 3]> =
        (0..125).map(|_| [(); 3].map(|()| edge * (random.unit() - 0.5))).collect();
    particles.extend([[0.1, 0.2, 0.3], [1.4, 0.4, 0.2]]);
    particles.extend((0..12).map(|_| [(); 3].map(|()| 0.3 * edge + random.unit())));
    particles.extend((0..9).map(|i| [1.3 * f64::from(i), -0.25 * edge, 0.4 * f64::from(i)]));
    particles
}

#[test]
fn the_drop_by_drop_mesh_of_spray_equals_the_mesh_of_the_whole_field() {
    for (apart, spacing, normals, walls) in [
        (4.0, 2.0, Normals::None, false),
        (8.0, 1.0, Normals::Gradient, false),
        (10.0, 2.0, Normals::Gradient, true),
        (7.0, 4.0, Normals::None, true),
        (12.0, 4.0, Normals::Gradient, false),
        (20.0, 2.0, Normals::Gradient, false),
        (9.0, 1.5, Normals::Gradient, true),
        (40.0, 1.0, Normals::Gradient, false),
        (40.0, 1.5, Normals::None, true),
        (10.0, 3.0, Normals::Gradient, false),
        (8.0, 6.0, Normals::None, true),
    ] {
        let mut random = Random::new(23);
        let particles = spray(apart, &mut random);
        let mut particles: Vec<[f64; 3]> =
            particles.iter().map(|p| p.map(|x| x * spacing)).collect();
        // A dense clump at the face of a bin fills cells of the next bin.
        particles.extend((0..60).map(|_| [15.99 - 0.01 * random.unit(), 8.5, 8.5]));
        let method = IndicatorKind::Cloud.into();
        let mut sampling = Sampling { method, spacing: Some(spacing), ..sampling() };
        if walls {
            // Walls cut drops in half.
            let half = DVec3::splat((2.0 * apart * spacing).floor());
            sampling.domain = Domain::new(&sampling.grid, -half, half).ok();
        }
        let sheets = SheetStretch::DEFAULT;
        let surfacing = Surfacing { sheets, normals, ..surfacing() };
        let frame = Engine::sample(&particles, &sampling, &mut Timings::default()).unwrap();
        let (recipe, _) = recipe(&frame, &surfacing);
        let sampled = dif(&frame);
        let periodic_mesh = PeriodicMesh::Cut;
        let surfaces = Surfaces { sampled, recipe: &recipe, solid: None, normals, periodic_mesh };
        let regions = surfaces.regions();
        let stages = Cpu.start(MemoryBudget(1 << 30));
        let meshes = contoured(&*stages, &surfaces, &regions);
        assert!(meshes.iter().flatten().count() >= 8);
        let domain = sampling.domain.map(|domain| domain.cells());
        for (mesh, region) in meshes.into_iter().zip(regions) {
            let whole = field(&recipe, sampled, normals.cells(region));
            let expected = block_mesh(&whole, region, recipe.iso, normals, domain);
            assert!(
                mesh == expected,
                "{apart} spacings of {spacing} cells apart, in {region:?}, walls: {walls}"
            );
        }
    }
}
