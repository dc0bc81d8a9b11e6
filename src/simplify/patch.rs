//! One patch of a surface, simplified within a distance.
//!
//! meshoptimizer collapses edges by a quadric error, which is a mean, and keeps patches closed but not quite
//! manifold. So what it returns is looked over: where it lies too far off it is mended, and where it does not hang
//! together it is done again, with the offenders and their neighbours locked.

use glam::Vec3;
use meshopt::{SimplifyOptions, VertexDataAdapter, simplify_with_locks};

use super::mend::{Mending, find_homes};
use super::near::Near;
use super::surface::Surface;
use super::topology::{Outside, Topology};

/// The quadric error asked of meshoptimizer, over the distance allowed: where the fewest triangles remain. For each time
/// that a patch is tried; the last asks for less, before the patch is left as it is.
const QUADRIC_SHARES: [f32; 5] = [0.75, 0.75, 0.75, 0.75, 0.3];

/// A part of a surface. Its border, where other parts go on, stays as it is.
#[derive(Clone, Copy)]
pub struct Patch<'a> {
    /// In cells; no two alike.
    pub positions: &'a [Vec3],
    /// The surface that the result must not leave.
    pub reference: &'a [[u32; 3]],
    /// What is to be simplified.
    pub triangles: &'a [[u32; 3]],
    /// For each vertex whether it may be used again: it was of the surface, and no triangle has it now.
    pub is_free: &'a dyn Fn(u32) -> bool,
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
        let surface = |triangles: &[[u32; 3]]| Surface::new(self.positions, triangles.to_vec()).ok();
        let reference = surface(self.reference)?;
        let own = if self.reference == self.triangles { None } else { Some(surface(self.triangles)?) };
        let before = own.as_ref().unwrap_or(&reference);
        let topology = Topology::of(before, self.outside);
        let (points, normals) = (Near::points(self.positions), reference.vertex_normals());
        let mut homes_before: Vec<u32> =
            (0..self.positions.len() as u32).map(|vertex| before.at(vertex)).collect();
        if own.is_some() {
            find_homes(&reference, before, &normals, distance, &mut homes_before);
        }
        let mending = Mending {
            topology: &topology,
            reference: &reference,
            before,
            homes_before: &homes_before,
            points: &points,
            normals: &normals,
            is_free: self.is_free,
            distance,
        };
        let mut locked = topology.border.clone();
        self.pinned.iter().for_each(|&vertex| locked[vertex as usize] = true);
        for (rings, share) in (1..).zip(QUADRIC_SHARES) {
            let mut collapsed = self.collapsed(&locked, share * distance);
            topology.restore_components(self.triangles, &mut collapsed);
            let mended = Surface::new(self.positions, collapsed).and_then(|surface| mending.mend(surface));
            let offenders = match &mended {
                Ok(surface) => {
                    let mut offenders = topology.offenders(before, surface);
                    offenders.extend(mending.strays(surface));
                    offenders
                }
                Err(failed) => failed.clone(),
            };
            match mended {
                Ok(surface) if offenders.is_empty() => return Some(surface.triangles),
                _ => self.lock_rings(&offenders, rings, &mut locked),
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

    /// Locks `vertices` and those around them, so many rings.
    fn lock_rings(&self, vertices: &[u32], rings: usize, locked: &mut [bool]) {
        let mut near = vec![false; self.positions.len()];
        vertices.iter().for_each(|&vertex| near[vertex as usize] = true);
        for _ in 0..rings {
            let touched = self.triangles.iter().filter(|triangle| triangle.iter().any(|&v| near[v as usize]));
            let ring: Vec<u32> = touched.flatten().copied().collect();
            ring.into_iter().for_each(|vertex| near[vertex as usize] = true);
        }
        locked.iter_mut().zip(near).for_each(|(locked, near)| *locked |= near);
    }
}
