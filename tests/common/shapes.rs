//! Meshes with known properties.

// Each user of this file, such as `tools/evaluate`, needs only some of the functions.
#![allow(dead_code)]

use std::f64::consts::TAU;

use meniscus::internals::surface::mesh::{Mesh, VertexAttribute};

/// An axis-parallel box with 8 vertices and 12 triangles.
pub fn cuboid(low: [f64; 3], high: [f64; 3]) -> Mesh {
    let corner = |n: usize| {
        std::array::from_fn(|axis| if n >> axis & 1 == 1 { high[axis] } else { low[axis] })
    };
    let quads: [[u32; 4]; 6] =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let halves = |[a, b, c, d]: [u32; 4]| [[a, b, c], [a, c, d]];
    Mesh {
        positions: (0..8).map(corner).collect(),
        triangles: quads.into_iter().flat_map(halves).collect(),
        ..Mesh::default()
    }
}

/// A sphere of this radius: an octahedron whose triangles are split `depth` times and moved onto
/// the sphere.
pub fn sphere(radius: f64, depth: u32) -> Mesh {
    let mut mesh = cone(&[[1., 0., 0.], [0., 1., 0.], [-1., 0., 0.], [0., -1., 0.]], [0., 0., 1.]);
    let below = cone(&[[0., -1., 0.], [-1., 0., 0.], [0., 1., 0.], [1., 0., 0.]], [0., 0., -1.]);
    mesh.positions.push([0., 0., -1.]);
    // The rim of the lower cone runs in the opposite direction, so that its vertices 0 to 3 are the
    // sphere's vertices 3 to 0.
    mesh.triangles.extend(below.triangles.iter().map(|t| t.map(|v| if v < 4 { 3 - v } else { 5 })));
    for _ in 0..depth {
        mesh = split(&mesh);
    }
    for position in &mut mesh.positions {
        let length = position.iter().map(|x| x * x).sum::<f64>().sqrt();
        *position = position.map(|x| x / length * radius);
    }
    mesh
}

/// A cone without a base: one triangle from each edge of a closed rim to the apex, which is the
/// last vertex.
pub fn cone(rim: &[[f64; 3]], apex: [f64; 3]) -> Mesh {
    let n = rim.len() as u32;
    Mesh {
        positions: rim.iter().copied().chain([apex]).collect(),
        triangles: (0..n).map(|i| [i, (i + 1) % n, n]).collect(),
        ..Mesh::default()
    }
}

/// Splits every triangle into four.
fn split(mesh: &Mesh) -> Mesh {
    let mut edges: Vec<[u32; 2]> = mesh.triangles.iter().flat_map(|t| sides(*t)).collect();
    edges.sort_unstable();
    edges.dedup();
    let first = mesh.positions.len() as u32;
    let middle = |edge: [u32; 2]| first + edges.binary_search(&edge).expect("an edge") as u32;
    let mut positions = mesh.positions.clone();
    positions.extend(edges.iter().map(|&[a, b]| {
        let [a, b] = [a, b].map(|v| mesh.positions[v as usize]);
        std::array::from_fn(|axis| (a[axis] + b[axis]) / 2.0)
    }));
    let four = |&[a, b, c]: &[u32; 3]| {
        let [ab, bc, ca] = sides([a, b, c]).map(middle);
        [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
    };
    Mesh { positions, triangles: mesh.triangles.iter().flat_map(four).collect(), ..Mesh::default() }
}

fn sides([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)])
}

/// A torus of `around` times `across` quads, each of two triangles.
pub fn torus(around: u32, across: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..around {
        for j in 0..across {
            let (sin_i, cos_i) = (TAU * f64::from(i) / f64::from(around)).sin_cos();
            let (sin_j, cos_j) = (TAU * f64::from(j) / f64::from(across)).sin_cos();
            let from_axis = 1.0 + 0.4 * cos_j;
            mesh.positions.push([from_axis * cos_i, from_axis * sin_i, 0.4 * sin_j]);
            let id = |i: u32, j: u32| i % around * across + j % across;
            mesh.triangles.push([id(i, j), id(i + 1, j), id(i + 1, j + 1)]);
            mesh.triangles.push([id(i, j), id(i + 1, j + 1), id(i, j + 1)]);
        }
    }
    mesh
}

/// Combines two meshes into one.
pub fn union(one: &Mesh, other: &Mesh) -> Mesh {
    let first = one.positions.len() as u32;
    let shifted = other.triangles.iter().map(|t| t.map(|v| v + first));
    Mesh {
        positions: one.positions.iter().chain(&other.positions).copied().collect(),
        triangles: one.triangles.iter().copied().chain(shifted).collect(),
        ..Mesh::default()
    }
}

pub fn moved(mesh: &Mesh, by: [f64; 3]) -> Mesh {
    let mut mesh = mesh.clone();
    for position in &mut mesh.positions {
        *position = std::array::from_fn(|axis| position[axis] + by[axis]);
    }
    mesh
}

/// Adds normals that point away from the origin, velocities, and each vertex's number as a value.
pub fn with_attributes(mut mesh: Mesh) -> Mesh {
    let values = |f: fn(usize, &[f64; 3]) -> Vec<f32>| {
        mesh.positions.iter().enumerate().flat_map(|(n, p)| f(n, p)).collect::<Vec<_>>()
    };
    let velocity = values(|n, p| vec![p[0] as f32, -1.5, n as f32]);
    let number = values(|n, _| vec![n as f32]);
    mesh.normals = Some(
        mesh.positions
            .iter()
            .map(|p| {
                let length = p.iter().map(|x| x * x).sum::<f64>().sqrt();
                p.map(|x| (x / length) as f32)
            })
            .collect(),
    );
    mesh.attributes = vec![
        VertexAttribute::new("velocity", 3, velocity),
        VertexAttribute::new("number", 1, number),
    ];
    mesh
}
