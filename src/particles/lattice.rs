//! Detects particles on a lattice whose step divides the cells' edge, and finds a grid origin that
//! suits the lattice.
//!
//! Simulations often start with particles on a lattice. If its step divides the cells' edge,
//! particles have the same positions in all cells. With one particle per cell, theta, the sample of
//! the symmetry indicator, can then be anything from 0 (if particles are on corners of cells) to 1
//! (if particles are in the centres of cells). A few frames later, the same fluid is disordered.
//! Its mean theta, over all offsets u from the centre of a cell of edge 1, is 1 - 2 E|u| / sqrt 3 =
//! 0.445. If the origin gives the lattice exactly this theta, measurements on the first frame hold
//! for all frames. With this origin, the lattice is also far from cell faces, where rounding errors
//! would move particles to neighbouring cells.

use std::f64::consts::TAU;

use glam::DVec3;
use rayon::prelude::*;

use crate::particles::Particles;

/// Maximum number of lattice steps per cell edge. Lattices with smaller steps are not tried.
const DIVISIONS: u32 = 4;
/// Number of places into which a lattice step is divided. Positions are rounded to places.
const PLACES: usize = 256;
/// The place with theta = 0.445 for one particle per cell. Along each axis, it is 0.277 of a step
/// away from the middle.
const TARGET_PLACE: f64 = 57.0;
/// Each position within a lattice step is mapped to an angle. Positions count as equal if the mean
/// of their unit vectors is longer than this. Jitter with a standard deviation of 0.19 steps gives
/// a length of 0.5.
const COHERENT: f64 = 0.5;
/// Scale of the integer cosines. Integer sums do not depend on order or threads.
const COSINE_SCALE: f64 = 32768.0;
const CHUNK: usize = 1 << 12;

/// The origin nearest to `origin` that suits a lattice of particles in cells of edge `cell_size`;
/// `None` if there is no lattice along any axis, or its step does not divide the cells' edge.
pub fn lattice_origin(particles: &dyn Particles, origin: DVec3, cell_size: f64) -> Option<DVec3> {
    (1..=DIVISIONS).find_map(|divisions| {
        let step = cell_size / f64::from(divisions);
        let places = places(particles, origin, step);
        let coherent = places.iter().any(Option::is_some);
        coherent.then(|| {
            let shift = |place: Option<f64>| {
                let turn = place.map_or(0.0, |place| (place - TARGET_PLACE) / PLACES as f64);
                (turn - turn.round()) * step
            };
            origin + DVec3::from(places.map(shift))
        })
    })
}

/// The place of the particles within a lattice step along each axis; `None` for an axis along which
/// the particles do not share a place.
fn places(particles: &dyn Particles, origin: DVec3, step: f64) -> [Option<f64>; 3] {
    let circle: Vec<[i64; 2]> = (0..PLACES)
        .map(|place| {
            let angle = TAU * place as f64 / PLACES as f64;
            [libm::cos(angle), libm::sin(angle)].map(|x| (x * COSINE_SCALE).round() as i64)
        })
        .collect();
    let of_chunk = |chunk: usize| {
        let first = chunk * CHUNK;
        let mut positions = vec![[0.0; 3]; CHUNK.min(particles.len() - first)];
        particles.positions(first, &mut positions);
        particles.release(first..first + positions.len());
        let mut sums = [[0i64; 3]; 3];
        for position in positions {
            let steps = (DVec3::from(position) - origin) / step;
            if !steps.is_finite() {
                continue;
            }
            for (sum, x) in sums.iter_mut().zip(steps.to_array()) {
                // Rounding errors can move a particle at a multiple of the step to either side of
                // the multiple. Rounding to the nearest place gives place 0 in both cases.
                let place = ((x - x.floor()) * PLACES as f64).round() as usize % PLACES;
                let [cos, sin] = circle[place];
                sum[0] += cos;
                sum[1] += sin;
                sum[2] += 1;
            }
        }
        sums
    };
    let sums = (0..particles.len().div_ceil(CHUNK)).into_par_iter().map(of_chunk).reduce(
        || [[0; 3]; 3],
        |a, b| std::array::from_fn(|axis| std::array::from_fn(|i| a[axis][i] + b[axis][i])),
    );
    sums.map(|[cos, sin, count]| {
        let (cos, sin) = (cos as f64, sin as f64);
        let coherent = libm::hypot(cos, sin) > COHERENT * COSINE_SCALE * count as f64;
        coherent.then(|| (libm::atan2(sin, cos) / TAU * PLACES as f64).round())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lattice(step: f64, at: [f64; 3]) -> Vec<[f64; 3]> {
        (0..1000)
            .map(|i| [i % 10, i / 10 % 10, i / 100])
            .map(|c| std::array::from_fn(|axis| at[axis] + step * f64::from(c[axis])))
            .collect()
    }

    #[test]
    fn the_origin_moves_any_lattice_to_the_target_place() {
        for (per_cell, at) in
            [(1.0, [0.0; 3]), (1.0, [0.5; 3]), (2.0, [0.25, -0.5, 7.1]), (3.0, [1e-9; 3])]
        {
            let step = 0.05 / per_cell;
            let particles = lattice(step, at.map(|x| x * step));
            let origin = lattice_origin(&particles, DVec3::ZERO, 0.05).unwrap();
            assert!(origin.abs().max_element() <= step / 2.0);
            for p in &particles {
                for x in ((DVec3::from(*p) - origin) / step).to_array() {
                    assert!(
                        (x - x.floor() - TARGET_PLACE / 256.0).abs() < 0.003,
                        "{per_cell} {at:?}: {x}"
                    );
                }
            }
        }
    }

    #[test]
    fn other_lattice_steps_and_disorder_keep_the_origin() {
        assert_eq!(lattice_origin(&lattice(0.0391, [0.0; 3]), DVec3::ZERO, 0.05), None);
        let mut state = 1u64;
        let mut unit = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 31)
        };
        let random: Vec<[f64; 3]> = (0..2000).map(|_| [unit(), unit(), unit()]).collect();
        assert_eq!(lattice_origin(&random, DVec3::ZERO, 0.05), None);
    }
}
