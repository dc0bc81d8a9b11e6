//! Coarse copies of meshes, for small pictures: all vertices in a cell of a lattice are merged into
//! one vertex.
//!
//! Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes", 1993.

use std::collections::HashMap;
use std::io;

use super::Mesh;
use super::source::{Corners, MeshSource};

/// Bytes of memory that [`clustered`] needs for each vertex of the mesh.
pub const BYTES_PER_VERTEX: u64 = size_of::<u32>() as u64;

/// A coarser copy of `mesh`. The longest edge of its bounding box, from `lo` to `hi`, is divided
/// into `cells` cells, and the vertices in each cell are merged into one vertex at their mean.
/// The copy has no triangles with two equal corners, no normals and no attributes.
///
/// # Errors
/// If the mesh cannot be read from its scratch file.
pub fn clustered(mesh: &dyn MeshSource, [lo, hi]: Corners, cells: u32) -> io::Result<Mesh> {
    let extent = (0..3).map(|axis| hi[axis] - lo[axis]).fold(0.0, f64::max);
    let step = if extent > 0.0 { extent / f64::from(cells) } else { 1.0 };
    let cell = |p: [f64; 3]| -> [u32; 3] {
        std::array::from_fn(|axis| ((p[axis] - lo[axis]) / step) as u32)
    };
    let mut clusters: HashMap<[u32; 3], u32> = HashMap::new();
    let mut sums: Vec<([f64; 3], f64)> = Vec::new();
    let mut cluster_of: Vec<u32> = Vec::with_capacity(mesh.vertex_count() as usize);
    for piece in 0..mesh.pieces() {
        for &p in mesh.vertices(piece)?.positions.iter() {
            let cluster = *clusters.entry(cell(p)).or_insert(sums.len() as u32);
            if cluster as usize == sums.len() {
                sums.push(([0.0; 3], 0.0));
            }
            let (sum, count) = &mut sums[cluster as usize];
            (0..3).for_each(|axis| sum[axis] += p[axis] - lo[axis]);
            *count += 1.0;
            cluster_of.push(cluster);
        }
    }
    let mut triangles = Vec::new();
    for piece in 0..mesh.pieces() {
        let merged = mesh.triangles(piece)?.into_iter();
        let merged = merged.map(|corners| corners.map(|vertex| cluster_of[vertex as usize]));
        triangles.extend(merged.filter(|[a, b, c]| a != b && b != c && c != a));
    }
    let mean = |(sum, count): ([f64; 3], f64)| -> [f64; 3] {
        std::array::from_fn(|axis| lo[axis] + sum[axis] / count)
    };
    let positions = sums.into_iter().map(mean).collect();
    Ok(Mesh { positions, triangles, ..Mesh::default() })
}

#[cfg(test)]
mod tests {
    use super::super::source::bounds_of;
    use super::*;

    /// A square of 64 x 64 vertices, one unit apart.
    fn square() -> Mesh {
        let n = 64_u32;
        let corner = |x: u32, y: u32| y * n + x;
        let positions = (0..n * n).map(|i| [f64::from(i % n), f64::from(i / n), 5.0]).collect();
        let cells = (0..(n - 1) * (n - 1)).map(|i| (i % (n - 1), i / (n - 1)));
        let two = |(x, y): (u32, u32)| {
            let [a, b] = [corner(x, y), corner(x + 1, y)];
            let [c, d] = [corner(x, y + 1), corner(x + 1, y + 1)];
            [[a, b, d], [a, d, c]]
        };
        Mesh { positions, triangles: cells.flat_map(two).collect(), ..Mesh::default() }
    }

    #[test]
    fn a_clustered_mesh_has_at_most_one_vertex_per_cell() {
        let mesh = square();
        let bounds = bounds_of(&mesh.positions).unwrap();
        let coarse = clustered(&mesh, bounds, 8).unwrap();
        assert!((64..=81).contains(&coarse.positions.len()), "{}", coarse.positions.len());
        assert!(coarse.positions.iter().all(|p| p[2] == 5.0));
        assert!((98..=300).contains(&coarse.triangles.len()), "{}", coarse.triangles.len());
        let named = coarse.triangles.as_flattened().iter().max().unwrap();
        assert!((*named as usize) < coarse.positions.len());
        // A lattice finer than the mesh leaves the mesh unchanged.
        let same = clustered(&mesh, bounds, 1000).unwrap();
        assert_eq!((same.positions, same.triangles), (mesh.positions, mesh.triangles));
    }

    #[test]
    fn clustered_points_and_empty_meshes_have_no_triangles() {
        let point =
            Mesh { positions: vec![[1.0; 3]; 3], triangles: vec![[0, 1, 2]], ..Mesh::default() };
        let coarse = clustered(&point, [[1.0; 3]; 2], 8).unwrap();
        assert_eq!((coarse.positions.len(), coarse.triangles.len()), (1, 0));
        assert_eq!(clustered(&Mesh::default(), [[0.0; 3]; 2], 8).unwrap(), Mesh::default());
    }
}
