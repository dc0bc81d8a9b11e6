//! One patch of a surface, simplified within a distance.
//!
//! meshoptimizer collapses edges by a quadric error, which is a mean, and keeps patches closed but not quite
//! manifold. So what it returns is looked over: where it lies too far off it is mended, and where it does not hang
//! together it is done again, with the offenders and their neighbours locked.

use std::cell::OnceCell;

use glam::Vec3;
use meshopt::{SimplifyOptions, VertexDataAdapter, simplify_with_locks};

use super::mend::{Mending, Ridges};
use super::near::Near;
use super::surface::Surface;
use super::topology::{Outside, Topology};

/// The quadric error asked of meshoptimizer, over the distance allowed: where the fewest triangles remain.
const QUADRIC_SHARE: f32 = 0.75;
/// How often a patch is tried before it is left as it is.
const TRIES: usize = 4;

/// A part of a surface. Its border, where other parts go on, stays as it is.
#[derive(Clone, Copy)]
pub struct Patch<'a> {
    /// In cells; no two alike.
    pub positions: &'a [Vec3],
    /// The surface that the result must not leave.
    pub reference: &'a [[u32; 3]],
    /// What is to be simplified.
    pub triangles: &'a [[u32; 3]],
    /// Vertices that stay, besides those of the border.
    pub pinned: &'a [u32],
    /// What goes on beyond its border.
    pub outside: Outside,
}

impl<'a> Patch<'a> {
    /// Simplifies it: every sample of the result is within `distance` cells of the reference, and every vertex
    /// of `positions` that was within as much of `triangles` is of the result.
    pub fn simplified(&self, distance: f32) -> Vec<[u32; 3]> {
        self.try_simplified(distance).unwrap_or_else(|| self.triangles.to_vec())
    }

    fn try_simplified(&'a self, distance: f32) -> Option<Vec<[u32; 3]>> {
        if self.triangles.is_empty() {
            return None;
        }
        let topology = Topology::of(self.positions, self.triangles, self.outside);
        let surface =
            |triangles: &[[u32; 3]]| Surface::new(self.positions, triangles.to_vec(), distance).ok();
        let reference = surface(self.reference)?;
        let lazy = OnceCell::new();
        let before = || lazy.get_or_init(|| surface(self.triangles).expect("a patch is oriented"));
        let (points, normals) = (Near::points(self.positions), reference.vertex_normals());
        let ridges = Ridges::of(&reference, distance);
        let mending = Mending {
            topology: &topology,
            reference: &reference,
            before: &before,
            points: &points,
            normals: &normals,
            ridges: &ridges,
            distance,
        };
        let mut locked = topology.border().to_vec();
        self.pinned.iter().for_each(|&vertex| locked[vertex as usize] = true);
        for _ in 0..TRIES {
            let mut collapsed = self.collapsed(&locked, QUADRIC_SHARE * distance);
            topology.restore_components(self.triangles, &mut collapsed);
            let mended =
                Surface::new(self.positions, collapsed, distance).and_then(|surface| mending.mend(surface));
            let offenders = match &mended {
                Ok(triangles) => topology.offenders(triangles),
                Err(failed) => failed.clone(),
            };
            match mended {
                Ok(triangles) if offenders.is_empty() => return Some(triangles),
                _ => self.lock_rings(&offenders, &mut locked),
            }
        }
        None
    }

    fn collapsed(&self, locked: &[bool], quadric_error: f32) -> Vec<[u32; 3]> {
        let positions = VertexDataAdapter::new(bytemuck::cast_slice(self.positions), size_of::<Vec3>(), 0)
            .expect("positions are whole");
        let options = SimplifyOptions::LockBorder | SimplifyOptions::ErrorAbsolute;
        let corners = self.triangles.as_flattened();
        let corners = simplify_with_locks(corners, &positions, locked, 0, quadric_error, options, None);
        bytemuck::cast_slice(&corners).to_vec()
    }

    /// Locks `vertices` and those next to them.
    fn lock_rings(&self, vertices: &[u32], locked: &mut [bool]) {
        let mut offends = vec![false; self.positions.len()];
        vertices.iter().for_each(|&vertex| offends[vertex as usize] = true);
        for triangle in self.triangles {
            if triangle.iter().any(|&vertex| offends[vertex as usize]) {
                triangle.iter().for_each(|&vertex| locked[vertex as usize] = true);
            }
        }
        vertices.iter().for_each(|&vertex| locked[vertex as usize] = true);
    }
}
