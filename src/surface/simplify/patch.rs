//! One patch of a surface, simplified within a distance.

use glam::Vec3A;

use super::collapse::{Measure, find_homes};
use super::surface::{NONE, Outgoing, Surface};
use super::topology::{Outside, Topology};

/// A part of a surface. Its border, where other parts go on, stays as it is.
#[derive(Clone, Copy)]
pub struct Patch<'a> {
    /// The places of the vertices in cells; no two alike.
    pub positions: &'a [Vec3A],
    /// The surface that the result must not leave.
    pub reference: &'a [[u32; 3]],
    /// The triangles to be simplified.
    pub triangles: &'a [[u32; 3]],
    /// Vertices that stay, besides those of the border.
    pub pinned: &'a [u32],
    /// The kind of triangles beyond the border.
    pub outside: Outside,
}

impl<'a> Patch<'a> {
    /// Simplifies it: every sample of the result is within `distance` cells of the reference, and every vertex
    /// of `positions` that was within as much of `triangles` is of the result.
    #[inline(never)]
    pub fn simplified(&self, distance: f32) -> Vec<[u32; 3]> {
        let vertices = self.positions.len();
        let outgoing = Outgoing::of(vertices, self.reference);
        let reference = Surface::new(self.positions, self.reference.to_vec(), &outgoing);
        let normals = reference.vertex_normals();
        let surface = if self.reference == self.triangles {
            reference.clone()
        } else {
            let own = Outgoing::of(vertices, self.triangles);
            let mut surface = Surface::new(self.positions, self.triangles.to_vec(), &own);
            find_homes(&reference, &mut surface, &normals, distance);
            surface
        };
        let topology = Topology::of(&surface, self.outside);
        let mut locked = topology.border.clone();
        self.pinned.iter().for_each(|&vertex| locked[vertex as usize] = true);
        let (reference, outgoing) = (&reference, &outgoing);
        let measure = Measure { topology: &topology, reference, outgoing, normals: &normals, distance };
        let triangles = measure.collapse(surface, &locked).triangles;
        triangles.into_iter().filter(|corners| corners[0] != NONE).collect()
    }
}
