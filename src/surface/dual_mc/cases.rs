//! The marching-cubes table, derived from one rule.
//!
//! On a face whose two inside corners are diagonal, the surface cuts each of them off. Both cells
//! that share the face see the same four signs, so both have the same segments, and no face is ever
//! open. The segments around a cell form closed loops, and each crossed edge is on one loop. A loop
//! becomes a fan around an apex none of whose diagonals is in a face of the cell. Each diagonal is
//! then an edge of this cell's triangles only, and the mesh is a 2-manifold.

use std::sync::LazyLock;

use glam::IVec3;

/// An edge of a dual cell, from `corner` along `axis`. Corners are numbered x + 2 y + 4 z.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CellEdge {
    /// The lower end.
    pub corner: u8,
    /// 0, 1, 2 for x, y, z.
    pub axis: u8,
}

impl CellEdge {
    /// The lower end, relative to the cell's lowest corner.
    #[inline]
    pub fn offset(self) -> IVec3 {
        let corner = i32::from(self.corner);
        IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2)
    }
}

/// The triangles of one combination of signs, as edges, counter-clockwise seen from outside of the
/// fluid.
pub type Triangles = Vec<[CellEdge; 3]>;

/// The triangles for every combination of inside corners, one bit per corner.
pub static TABLE: LazyLock<[Triangles; 256]> =
    LazyLock::new(|| std::array::from_fn(|case| triangles(case as u8)));

fn triangles(case: u8) -> Triangles {
    loops(case).iter().flat_map(|polygon| fan(polygon)).collect()
}

/// The corners of each face in cyclic order, counter-clockwise seen from outside of the cell.
fn faces() -> impl Iterator<Item = [u8; 4]> {
    (0..3).flat_map(|axis: u8| {
        let (u, v, n) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3), 1 << axis);
        [[0, v, u | v, u], [n, n | u, n | u | v, n | v]]
    })
}

/// The edge between two adjacent corners.
fn edge(a: u8, b: u8) -> CellEdge {
    CellEdge { corner: a & b, axis: (a ^ b).trailing_zeros() as u8 }
}

/// The closed loops of the surface in a cell, as lists of crossed edges, counter-clockwise seen
/// from outside of the fluid.
fn loops(case: u8) -> Vec<Vec<CellEdge>> {
    let inside = |corner: u8| case >> corner & 1 == 1;
    // Go around each face, seen from outside of the cell, and cut off each run of inside corners:
    // from the edge at which the run starts to the edge at which it ends.
    let mut segments = Vec::new();
    for face in faces() {
        for start in 0..4 {
            if !inside(face[start]) && inside(face[(start + 1) % 4]) {
                let run = (2..)
                    .find(|i| !inside(face[(start + i) % 4]))
                    .expect("the run ends at its start");
                let enter = edge(face[start], face[(start + 1) % 4]);
                let leave = edge(face[(start + run - 1) % 4], face[(start + run) % 4]);
                segments.push((enter, leave));
            }
        }
    }
    let mut loops = Vec::new();
    while let Some((first, mut at)) = segments.pop() {
        let mut polygon = vec![first];
        while at != first {
            polygon.push(at);
            let next =
                segments.iter().position(|s| s.0 == at).expect("a crossed edge lies on two faces");
            at = segments.swap_remove(next).1;
        }
        loops.push(polygon);
    }
    loops
}

/// Whether two edges of the cell are in a common face.
fn share_face(a: CellEdge, b: CellEdge) -> bool {
    let corners = |e: CellEdge| [e.corner, e.corner | 1 << e.axis];
    faces().any(|face| corners(a).iter().chain(&corners(b)).all(|corner| face.contains(corner)))
}

/// Triangles that fill a loop.
fn fan(polygon: &[CellEdge]) -> Triangles {
    let len = polygon.len();
    let at = |i: usize| polygon[i % len];
    let apex = (0..len)
        .find(|&apex| (2..len - 1).all(|i| !share_face(at(apex), at(apex + i))))
        .expect("every loop has an apex whose diagonals avoid the faces");
    (1..len - 1).map(|i| [at(apex), at(apex + i), at(apex + i + 1)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_has_at_most_five_triangles() {
        let sizes: Vec<usize> = TABLE.iter().map(Vec::len).collect();
        assert_eq!(sizes.iter().max(), Some(&5));
        assert_eq!((sizes[0], sizes[255]), (0, 0));
        assert!(sizes[1..255].iter().all(|&n| n > 0));
    }

    #[test]
    fn every_case_uses_exactly_its_crossed_edges() {
        for (case, triangles) in TABLE.iter().enumerate() {
            for corner in 0..8_u8 {
                for axis in (0..3_u8).filter(|axis| corner >> axis & 1 == 0) {
                    let crossed = case >> corner & 1 != case >> (corner | 1 << axis) & 1;
                    let used = triangles.iter().flatten().any(|&e| e == CellEdge { corner, axis });
                    assert_eq!(crossed, used, "case {case}, corner {corner}, axis {axis}");
                }
            }
        }
    }

    #[test]
    fn a_single_inside_corner_has_one_outward_facing_triangle() {
        for corner in 0..8_u8 {
            let [triangle] = TABLE[1 << corner][..] else { panic!("one triangle") };
            let at = |e: CellEdge| {
                let bit =
                    |a: u8| f64::from(e.corner >> a & 1) + if e.axis == a { 0.5 } else { 0.0 };
                glam::DVec3::new(bit(0), bit(1), bit(2))
            };
            let [a, b, c] = triangle.map(at);
            let inside = glam::DVec3::new(
                f64::from(corner & 1),
                f64::from(corner >> 1 & 1),
                f64::from(corner >> 2),
            );
            assert!((b - a).cross(c - a).dot(a - inside) > 0.0, "corner {corner}");
        }
    }
}
