//! Fills bodies of fluid with particles at spacing 1, on a lattice that may be moved and rotated
//! relative to the grid, and jittered.
//!
//! A particle represents a cube of edge 1. By default, all lattice points inside the body are used,
//! so the particles have about the body's volume. With `inset` 0.5, the particles' spheres touch
//! the body's surface from inside. Then the particles have, on average over all positions of the
//! lattice, the volume of a body that is smaller by half a spacing on all sides.

use glam::{DQuat, DVec3, IVec3};
use rayon::prelude::*;

use crate::scene::Random;
use crate::shapes::Solid;

/// Edge of a block of lattice points. One depth query often shows that all points of a block are
/// inside the body, or that all are outside.
const BLOCK: i32 = 4;

/// The lattice of particles that fills a body.
#[derive(Debug, Clone, Copy)]
pub struct Lattice {
    /// Offset of the lattice from the grid, after the rotation.
    pub shift: DVec3,
    pub turn: DQuat,
    /// Maximum displacement of a particle along each axis.
    pub jitter: f64,
    /// Minimum depth of particles below the body's surface.
    pub inset: f64,
    pub seed: u64,
}

/// The particles that fill `solid`.
pub fn fill(solid: &Solid, lattice: &Lattice) -> Vec<[f64; 3]> {
    let Lattice { shift, turn, jitter, inset, seed } = *lattice;
    let middle = turn.inverse() * (solid.centre - shift);
    let reach = solid.radius + 1.0;
    let lo = (middle - reach).floor().as_ivec3().div_euclid(IVec3::splat(BLOCK));
    let hi = (middle + reach).ceil().as_ivec3().div_euclid(IVec3::splat(BLOCK)) + 1;
    let size = hi - lo;
    let blocks = (0..size.element_product()).into_par_iter();
    let of_block = |block: i32| {
        let first = BLOCK
            * (lo + IVec3::new(block % size.x, block / size.x % size.y, block / (size.x * size.y)));
        let centre = shift + turn * (first.as_dvec3() + f64::from(BLOCK) / 2.0);
        let depth = solid.depth(centre);
        let radius = (f64::from(BLOCK) / 2.0 + jitter) * 3_f64.sqrt();
        if depth < inset - radius {
            return Vec::new();
        }
        let mut random = Random::new(seed ^ ((block as u64) << 20));
        let places =
            (0..BLOCK.pow(3)).map(|i| IVec3::new(i % BLOCK, i / BLOCK % BLOCK, i / BLOCK.pow(2)));
        let particles = places.map(|place| {
            let off = DVec3::from([(); 3].map(|()| jitter * (2.0 * random.unit() - 1.0)));
            shift + turn * ((first + place).as_dvec3() + 0.5 + off)
        });
        let inside = |point: &DVec3| depth > inset + radius || solid.depth(*point) > inset;
        particles.filter(inside).map(DVec3::into).collect()
    };
    let particles: Vec<Vec<[f64; 3]>> = blocks.map(of_block).collect();
    particles.concat()
}

/// A box of jittered particles.
pub fn cuboid(lo: IVec3, hi: IVec3, jitter: f64, random: &mut Random) -> Vec<[f64; 3]> {
    let mut particles = Vec::new();
    for z in lo.z..hi.z {
        for y in lo.y..hi.y {
            for x in lo.x..hi.x {
                let off = DVec3::from([(); 3].map(|()| jitter * (2.0 * random.unit() - 1.0)));
                particles.push((DVec3::new(x.into(), y.into(), z.into()) + 0.5 + off).into());
            }
        }
    }
    particles
}

/// Point number `n` of a sequence that fills the unit cube evenly (R3, Roberts 2018).
pub fn unit_cube_point(n: usize) -> DVec3 {
    let step =
        DVec3::new(0.819_172_513_396_164_4, 0.671_043_606_703_789_3, 0.549_700_477_901_970_2);
    (0.5 + (n + 1) as f64 * step).fract()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::meshes::sphere;

    #[test]
    fn the_number_of_particles_matches_the_volume_of_the_inset_ball() {
        let ball = Solid::new("ball", sphere(1.0, 5), 20_000).unwrap();
        let radius = (20_000.0 * 0.75 / std::f64::consts::PI).cbrt();
        for (jitter, inset) in [(0.0, 0.0), (0.3, 0.0), (0.3, 0.5)] {
            let turn = DQuat::from_rotation_x(0.4);
            let lattice = Lattice { shift: unit_cube_point(1), turn, jitter, inset, seed: 7 };
            let expected = 20_000.0 * ((radius - inset) / radius).powi(3);
            let count = fill(&ball, &lattice).len() as f64;
            assert!((count / expected - 1.0).abs() < 0.01, "{count} particles, not {expected}");
        }
    }
}
