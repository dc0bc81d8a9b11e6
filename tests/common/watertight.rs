//! Checks, directly by definition and without the library, that a mesh is closed, oriented and
//! manifold.

use std::collections::HashMap;

use meniscus::internals::surface::mesh::Mesh;

/// Describes a defect of a mesh. Returns `None` for a closed, oriented 2-manifold whose vertices
/// are all used, finite and distinct.
pub fn defect(mesh: &Mesh) -> Option<String> {
    let count = mesh.positions.len();
    if let Some(at) = mesh.positions.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        return Some(format!("vertex {at} has a coordinate that is not finite"));
    }
    // For each vertex, maps the next corner of each of its triangles to the corner after it.
    // Following this map leads around the vertex, from triangle to triangle.
    let mut around: Vec<HashMap<u32, u32>> = vec![HashMap::new(); count];
    for (number, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        if [a, b, c].iter().any(|&v| v as usize >= count) {
            return Some(format!("triangle {number} refers to a missing vertex"));
        }
        if a == b || b == c || c == a {
            return Some(format!("triangle {number} has the same vertex twice"));
        }
        for [v, from, to] in [[a, b, c], [b, c, a], [c, a, b]] {
            if around[v as usize].insert(from, to).is_some() {
                return Some(format!("two triangles have the directed edge from {v} to {from}"));
            }
        }
    }
    for (vertex, next) in around.iter().enumerate() {
        let Some(&first) = next.keys().next() else {
            return Some(format!("no triangle uses vertex {vertex}"));
        };
        let (mut at, mut steps) = (first, 0);
        loop {
            let Some(&to) = next.get(&at) else {
                return Some(format!("an edge of vertex {vertex} has a triangle on one side only"));
            };
            (at, steps) = (to, steps + 1);
            if at == first {
                break;
            }
            if steps > next.len() {
                return Some(format!("the triangles of vertex {vertex} do not form a closed fan"));
            }
        }
        if steps != next.len() {
            return Some(format!("the triangles of vertex {vertex} form several separate fans"));
        }
    }
    None
}
