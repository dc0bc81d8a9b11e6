//! A level set as dense bricks in memory.

use std::io;

use rayon::prelude::*;

use crate::surface::mesh::source::{Lattice, MeshSource};

use super::{BAND, Leaf, VOXELS, for_each_part, lattice_of};

/// The signed distances of the voxels of a grid from a surface, in bricks of 8³ voxels. A brick is
/// stored only if one of its voxels is less than three voxels from the surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// The position of the voxel with the coordinates (0, 0, 0), in the particles' unit of length.
    pub origin: [f64; 3],
    /// The distance between neighbouring voxels.
    pub voxel_size: f64,
    /// The coordinates of the first voxel of each brick, in ascending order.
    pub corners: Vec<[i32; 3]>,
    /// The distances of the 512 voxels of each brick, with z varying fastest. They are in the
    /// particles' unit of length, and negative inside. Where the surface is more than three voxels
    /// away, their magnitude is three voxels.
    pub distances: Vec<f32>,
}

impl Volume {
    /// The level set of a closed mesh.
    ///
    /// # Errors
    /// The errors of [`for_each_part`]; an error if the work is cancelled; and
    /// [`io::ErrorKind::InvalidInput`] for a mesh with triangles but without a lattice.
    pub fn of(mesh: &dyn MeshSource) -> io::Result<Self> {
        let lattice = lattice_of(&mesh.outline()).ok_or(io::ErrorKind::InvalidInput)?;
        let mut leaves: Vec<Leaf> = Vec::new();
        for_each_part(mesh, lattice, None, |part| {
            let of_block = |leaves| {
                mesh.go_on()?;
                Ok(leaves)
            };
            part.for_each_block(of_block, |of_block: Vec<Leaf>| {
                leaves.extend(of_block);
                Ok(())
            })
        })?;
        leaves.par_sort_unstable_by_key(|leaf| leaf.corner.to_array());
        let Lattice { origin, step: voxel_size } = lattice;
        let mut distances = Vec::new();
        let count = leaves.len().saturating_mul(VOXELS);
        distances.try_reserve_exact(count).map_err(|_| io::ErrorKind::OutOfMemory)?;
        distances.resize(count, 0.0);
        let bricks = distances.par_chunks_exact_mut(VOXELS).zip(&leaves);
        bricks.for_each(|(brick, leaf)| put_distances(brick, leaf, voxel_size as f32));
        let corners = leaves.iter().map(|leaf| leaf.corner.to_array()).collect();
        Ok(Self { origin, voxel_size, corners, distances })
    }
}

fn put_distances(brick: &mut [f32], leaf: &Leaf, voxel_size: f32) {
    let mut known = leaf.distances.iter();
    for (i, distance) in brick.iter_mut().enumerate() {
        let voxels = if leaf.active[i / 64] >> (i % 64) & 1 == 1 {
            *known.next().expect("one distance for each active voxel")
        } else if leaf.is_inside(i) {
            -BAND
        } else {
            BAND
        };
        *distance = voxels * voxel_size;
    }
}
