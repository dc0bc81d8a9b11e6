//! The pieces that a mesh is in, each with its volume.

use glam::DVec3;
use meniscus::internals::surface::mesh::Mesh;
use petgraph::unionfind::UnionFind;

/// What of a mesh shares vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// Less than 0 for a bubble.
    pub volume: f64,
    pub lo: DVec3,
    pub hi: DVec3,
}

impl Piece {
    pub fn centre(&self) -> DVec3 {
        (self.lo + self.hi) / 2.0
    }
}

/// The pieces, and which of them each vertex is of; vertices that no triangle uses are of none.
pub fn pieces(mesh: &Mesh) -> (Vec<Piece>, Vec<Option<usize>>) {
    let mut joined = UnionFind::<u32>::new(mesh.positions.len());
    for &[a, b, c] in &mesh.triangles {
        joined.union(a, b);
        joined.union(a, c);
    }
    let roots = joined.into_labeling();
    let mut numbers = vec![None; mesh.positions.len()];
    let mut pieces = Vec::new();
    for triangle in &mesh.triangles {
        let number = *numbers[roots[triangle[0] as usize] as usize].get_or_insert_with(|| {
            pieces.push(Piece { volume: 0.0, lo: DVec3::INFINITY, hi: DVec3::NEG_INFINITY });
            pieces.len() - 1
        });
        let piece: &mut Piece = &mut pieces[number];
        // As seen from a corner of the piece, so that digits are kept.
        let origin = DVec3::from(mesh.positions[roots[triangle[0] as usize] as usize]);
        let [a, b, c] = triangle.map(|vertex| DVec3::from(mesh.positions[vertex as usize]));
        piece.volume += (a - origin).dot((b - origin).cross(c - origin)) / 6.0;
        piece.lo = piece.lo.min(a).min(b).min(c);
        piece.hi = piece.hi.max(a).max(b).max(c);
    }
    let of_vertices = roots.iter().map(|&root| numbers[root as usize]).collect();
    (pieces, of_vertices)
}

/// Pieces, bubbles and volume of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Count {
    pub pieces: usize,
    pub bubbles: usize,
    pub volume: f64,
}

impl Count {
    pub fn of<'a>(pieces: impl IntoIterator<Item = &'a Piece>) -> Self {
        let none = Self { pieces: 0, bubbles: 0, volume: 0.0 };
        pieces.into_iter().fold(none, |count, piece| {
            let bubble = usize::from(piece.volume < 0.0);
            Self {
                pieces: count.pieces + 1 - bubble,
                bubbles: count.bubbles + bubble,
                volume: count.volume + piece.volume,
            }
        })
    }

    pub fn text(&self) -> String {
        format!("{}, {}", self.pieces, self.bubbles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::meshes::{cuboid, moved, union};

    #[test]
    fn a_box_with_a_bubble_beside_another_are_two_pieces_and_a_bubble() {
        let mut bubble = cuboid([1.0; 3], [2.0; 3]);
        bubble.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
        let hollow = union(&cuboid([0.0; 3], [3.0; 3]), &bubble);
        let mesh = union(&hollow, &moved(&cuboid([0.0; 3], [1.0; 3]), [7.0, 0.0, 0.0]));
        let (found, of_vertices) = pieces(&mesh);
        let volumes: Vec<f64> = found.iter().map(|piece| piece.volume.round()).collect();
        assert_eq!(volumes, [27.0, -1.0, 1.0]);
        assert_eq!(found[2].centre(), DVec3::new(7.5, 0.5, 0.5));
        assert_eq!([of_vertices[0], of_vertices[8], of_vertices[16]], [Some(0), Some(1), Some(2)]);
        let count = Count::of(&found);
        assert_eq!((count.text().as_str(), count.volume.round()), ("2, 1", 27.0));
    }
}
