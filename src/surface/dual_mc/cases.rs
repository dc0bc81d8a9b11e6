//! The marching-cubes table, derived from one rule.
//!
//! If a face has two inside corners and these are diagonally opposite, the surface cuts each of the
//! two corners off. Both cells that share the face see the same four signs, so both have the same
//! segments, and no face is ever open. The segments around a cell form closed loops, and each
//! crossed edge is on one loop. A fan of triangles fills each loop. The apex of the fan is chosen
//! so that no diagonal from the apex is in a face of the cell. Each diagonal is then an edge of
//! this cell's triangles only, and the mesh is a 2-manifold.
//!
//! Where cells of two levels touch, several corners of a dual cell can be in one wide cell, and
//! several edges of the dual cell then count as one edge (Schaefer and Warren 2004). The loops are
//! then shorter, and the rule holds for the faces that remain.

use std::sync::LazyLock;

use glam::IVec3;

use crate::grid::corner_offset;

/// An edge of a dual cell, from `corner` along `axis`. Corners are numbered x + 2 y + 4 z.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CellEdge {
    /// The lower end.
    pub corner: u8,
    /// The axis: 0, 1 or 2 for x, y or z.
    pub axis: u8,
}

impl CellEdge {
    /// The lower end, relative to the cell's lowest corner.
    #[inline]
    pub fn offset(self) -> IVec3 {
        corner_offset(self.corner.into())
    }
}

/// The triangles of one combination of signs, counter-clockwise as seen from outside the fluid.
/// Each corner is given by the edge on which its vertex lies.
pub type Triangles = Vec<[CellEdge; 3]>;

/// The triangles for every combination of inside corners. The index has one bit per corner.
pub static TABLE: LazyLock<[Triangles; 256]> =
    LazyLock::new(|| std::array::from_fn(|case| triangles(case as u8)));

fn triangles(case: u8) -> Triangles {
    loops(case).iter().flat_map(|polygon| fan(polygon, share_face)).collect()
}

/// The corners of a dual cell that are in wide cells, and the axes along which they share a wide
/// cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JoinedCorners {
    /// The corners in wide cells, one bit per corner.
    pub wide: u8,
    /// The axes along which the lower and the upper corners are in the same wide cell, one bit per
    /// axis.
    pub axes: u8,
}

impl JoinedCorners {
    /// The lowest corner that is in the same cell as `corner`.
    fn corner(self, corner: u8) -> u8 {
        if self.wide >> corner & 1 == 1 { corner & !self.axes } else { corner }
    }

    /// The edge that stands for all edges between the same two cells. Its ends are the lowest
    /// corner in each of the two cells.
    fn edge(self, edge: CellEdge) -> (u8, u8) {
        (self.corner(edge.corner), self.corner(edge.corner | 1 << edge.axis))
    }

    /// Whether two edges, or any edges that join the same pairs of cells, are in a common face.
    fn share_face(self, a: CellEdge, b: CellEdge) -> bool {
        let same = |edge| edges().filter(move |&other| self.edge(other) == self.edge(edge));
        same(a).any(|a| same(b).any(|b| share_face(a, b)))
    }

    /// The triangles of a combination of inside corners. Corners in the same cell must be on the
    /// same side.
    #[must_use]
    pub fn triangles(self, case: u8) -> Triangles {
        let joined = |polygon: &Vec<CellEdge>| {
            let mut polygon = polygon.clone();
            polygon.dedup_by_key(|edge| self.edge(*edge));
            while polygon.len() > 1
                && self.edge(polygon[0]) == self.edge(polygon[polygon.len() - 1])
            {
                polygon.pop();
            }
            // A loop through only two edges has no area.
            if polygon.len() < 3 { Vec::new() } else { fan(&polygon, |a, b| self.share_face(a, b)) }
        };
        loops(case).iter().flat_map(joined).collect()
    }
}

/// All edges of a cell.
fn edges() -> impl Iterator<Item = CellEdge> {
    (0..8_u8).flat_map(|corner| {
        let axes = (0..3_u8).filter(move |axis| corner >> axis & 1 == 0);
        axes.map(move |axis| CellEdge { corner, axis })
    })
}

/// The corners of each face in cyclic order, counter-clockwise as seen from outside the cell.
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

/// The closed loops of the surface in a cell, as lists of crossed edges, counter-clockwise as seen
/// from outside the fluid.
fn loops(case: u8) -> Vec<Vec<CellEdge>> {
    let inside = |corner: u8| case >> corner & 1 == 1;
    // Go around each face, as seen from outside the cell, and cut off each run of inside corners:
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

/// Triangles that fill a loop. `share_face` returns whether two edges are in a common face.
fn fan(polygon: &[CellEdge], share_face: impl Fn(CellEdge, CellEdge) -> bool) -> Triangles {
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

    /// All ways in which cells of two levels can meet in a dual cell, each with all possible sets
    /// of inside corners.
    fn joined_cases() -> impl Iterator<Item = (JoinedCorners, u8)> {
        let of = |axes: u8| (1..255_u8).map(move |wide| JoinedCorners { wide, axes });
        let whole = |joined: &JoinedCorners| {
            // If one of the corners that share a cell is in a wide cell, all of them are.
            (0..8_u8).filter(|corner| joined.wide >> corner & 1 == 1).all(|corner| {
                (0..3).all(|axis| {
                    joined.axes >> axis & 1 == 0 || joined.wide >> (corner ^ 1 << axis) & 1 == 1
                })
            })
        };
        let possible = |&(joined, case): &(JoinedCorners, u8)| {
            (0..8).all(|corner| case >> corner & 1 == case >> joined.corner(corner) & 1)
        };
        let cases = |joined| (0..=255_u8).map(move |case| (joined, case));
        (0..8).flat_map(of).filter(whole).flat_map(cases).filter(possible)
    }

    #[test]
    fn where_levels_meet_a_cells_triangles_have_no_diagonal_in_a_face() {
        let mut seen = 0;
        for (joined, case) in joined_cases() {
            // For each pair of edges that a side of a triangle joins, whether both are in a common
            // face.
            let mut sides = std::collections::BTreeMap::new();
            for triangle in joined.triangles(case) {
                let corners = triangle.map(|edge| joined.edge(edge));
                assert!(corners[0] != corners[1] && corners[1] != corners[2]);
                assert!(corners[2] != corners[0]);
                for i in 0..3 {
                    let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
                    let key = (joined.edge(a), joined.edge(b));
                    *sides.entry(key).or_insert((0, joined.share_face(a, b))) =
                        (1, joined.share_face(a, b));
                }
            }
            for (&(a, b), &(_, in_face)) in &sides {
                // A side that occurs in only one direction is on the border of the cell's surface,
                // and thus in a face. A side that occurs in both directions is inside the cell.
                let inner = sides.contains_key(&(b, a));
                assert_eq!(inner, !in_face, "{joined:?}, case {case:08b}: {a:?} {b:?}");
                seen += 1;
            }
        }
        assert!(seen > 1000, "{seen}");
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
