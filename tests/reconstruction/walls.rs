//! Tests of water in tanks with walls at any position between the faces of cells.

use meniscus::Reconstruction;
use meniscus::internals::brick::BrickSide;
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::frame::Sampling;

use crate::common::{fill, reconstruct, sampling, splashes, surfacing, uneven_tank};

/// Half the width of the pool.
const HALF: f64 = 12.0;

/// The mean height of the water near the side walls, and far from them. The walls and the water are
/// shifted by `shift`.
fn levels(cell: f64, shift: f64, seed: u64) -> [f64; 2] {
    let water = fill(HALF, 1.0, 0.3, seed, |p| p.y < -4.0);
    let water: Vec<_> = water.into_iter().map(|p| p.map(|x| x + shift)).collect();
    let [lo, hi] = [shift - HALF, shift + HALF];
    let tank = Reconstruction::new().spacing(1.0).cell_size(cell);
    let mesh = tank.domain([lo; 3], [hi, f64::INFINITY, hi]).run(&water[..]).unwrap();
    let mesh = mesh.to_mesh().unwrap();
    let mut heights = [Vec::new(), Vec::new()];
    for [x, y, z] in mesh.positions {
        let [x, z] = [x, z].map(|at| HALF - (at - shift).abs());
        if y > lo + HALF / 2.0 && x > cell && z > cell {
            heights[usize::from(x.min(z) > 4.0)].push(y - shift);
        }
    }
    heights.map(|all| all.iter().sum::<f64>() / all.len() as f64)
}

#[test]
fn the_level_beside_a_wall_is_independent_of_the_cells() {
    for cell in [0.5, 1.0] {
        for phase in [0.0, 0.3, 0.499, 0.501, 0.75] {
            let seeds = 3;
            let apart = (0..seeds).map(|seed| {
                let [near, far] = levels(cell, phase * cell, seed);
                near - far
            });
            let mean = apart.sum::<f64>() / seeds as f64;
            assert!(mean.abs() < 0.04, "cells of {cell}, {phase} above a face: {mean}");
        }
    }
}

#[test]
fn meshes_in_a_tank_are_independent_of_the_bricks() {
    let particles = splashes(7);
    let mesh = |side| {
        let mut sampling =
            Sampling { method: IndicatorKind::Cloud.into(), spacing: Some(0.8), ..sampling() };
        (sampling.side, sampling.domain) = (side, Some(uneven_tank(&sampling.grid)));
        reconstruct(&particles[..], &sampling, &surfacing()).1.mesh
    };
    let expected = mesh(BrickSide::Eight);
    for side in [BrickSide::Four, BrickSide::Sixteen] {
        assert!(mesh(side) == expected, "{side:?}");
    }
}

#[test]
fn the_floor_of_a_tank_is_flat_wherever_it_lies_between_cell_faces() {
    for phase in [0.0, 0.3, 0.45, 0.499, 0.501, 0.75] {
        let floor = 0.25 * phase;
        let mut dents = 0;
        for seed in 0..3 {
            let water = fill(HALF, 2.0, 0.5, seed, |p| p.y > 0.0 && p.y < 5.0);
            let water: Vec<_> = water.into_iter().map(|[x, y, z]| [x, y + floor, z]).collect();
            let tank = Reconstruction::new().spacing(0.5).cell_size(0.25);
            let tank = tank.domain([-HALF, floor, -HALF], [HALF, f64::INFINITY, HALF]);
            let mesh = tank.run(&water[..]).unwrap().to_mesh().unwrap();
            let is_dent = |&&[x, y, z]: &&[f64; 3]| {
                let height = y - floor;
                x.abs().max(z.abs()) < HALF - 0.7 && height > 0.01 && height < 2.0
            };
            dents += mesh.positions.iter().filter(is_dent).count();
        }
        assert!(dents < 20, "{dents} vertices in dents of a floor {phase} cells above a face");
    }
}
