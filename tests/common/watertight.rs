//! Checks, directly by definition and without the library, that a mesh is closed, oriented and
//! manifold.

use std::collections::HashMap;

use meniscus::internals::surface::mesh::Mesh;

/// Describes a defect of a mesh. Returns `None` for a closed, oriented 2-manifold whose vertices
/// are all used, finite and distinct.
pub fn defect(mesh: &Mesh) -> Option<String> {
    let count = mesh.positions.len();
    if let Some(at) = mesh.positions.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        return Some(format!("vertex {at} is nowhere"));
    }
    // For each vertex and each edge from it, the third corner of the edge's triangle. Following
    // these corners leads around the vertex.
    let mut around: Vec<HashMap<u32, u32>> = vec![HashMap::new(); count];
    for (number, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        if [a, b, c].iter().any(|&v| v as usize >= count) {
            return Some(format!("triangle {number} names a vertex that is not there"));
        }
        if a == b || b == c || c == a {
            return Some(format!("triangle {number} has two corners alike"));
        }
        for [v, from, to] in [[a, b, c], [b, c, a], [c, a, b]] {
            if around[v as usize].insert(from, to).is_some() {
                return Some(format!("two triangles go along the edge from {v} to {from}"));
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
                return Some(format!("an edge from {vertex} has one side only"));
            };
            (at, steps) = (to, steps + 1);
            if at == first {
                break;
            }
            if steps > next.len() {
                return Some(format!("the triangles around vertex {vertex} do not go around it"));
            }
        }
        if steps != next.len() {
            return Some(format!(
                "vertex {vertex} joins surfaces that have nothing else in common"
            ));
        }
    }
    None
}
