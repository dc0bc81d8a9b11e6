//! The star of a vertex: the triangles around it, for every vertex of a mesh at once.

/// Whether a triangle names three different vertices that exist.
#[must_use]
pub fn is_sound([a, b, c]: [u32; 3], vertices: usize) -> bool {
    [a, b, c].iter().all(|&v| (v as usize) < vertices) && a != b && b != c && c != a
}

/// For every vertex the edges across from it, in the order of the triangles: `[b, c]` for triangle a, b, c
/// seen from a. Unsound triangles are left out.
///
/// 24 bytes a triangle and 8 a vertex; two passes over the triangles, one over the vertices.
#[derive(Debug)]
pub struct Stars {
    ends: Vec<usize>,
    across: Vec<[u32; 2]>,
}

impl Stars {
    /// Gathers the stars of so many vertices.
    #[must_use]
    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let sound = || triangles.iter().filter(|&&t| is_sound(t, vertices));
        let mut ends = vec![0; vertices];
        for &vertex in sound().flatten() {
            ends[vertex as usize] += 1;
        }
        // Counts become starts, and starts become ends as the stars fill up.
        let mut total = 0;
        for end in &mut ends {
            total += std::mem::replace(end, total);
        }
        let mut across = vec![[0; 2]; total];
        for &[a, b, c] in sound() {
            for (vertex, edge) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
                let end = &mut ends[vertex as usize];
                across[*end] = edge;
                *end += 1;
            }
        }
        Self { ends, across }
    }

    /// The edges across from `vertex`.
    #[must_use]
    pub fn of(&self, vertex: usize) -> &[[u32; 2]] {
        let start = vertex.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.across[start..self.ends[vertex]]
    }

    /// Number of vertices, those without triangles included.
    #[must_use]
    pub fn vertices(&self) -> usize {
        self.ends.len()
    }
}
