//! Checks that keep the mesh around a patch a closed, oriented 2-manifold.
//!
//! All is decided at the patch's own vertices. Patches share no vertices but those of their borders, which stay, so a new
//! edge can only meet its like among the triangles between them: an edge between two vertices of the border is a chord,
//! and there may be one outside.

use glam::Vec3A;

use super::surface::Surface;

/// The triangles around a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outside {
    /// Triangles as marching cubes made them: each lies in one dual cell.
    DualCells,
    /// Triangles of any size.
    Simplified,
}

impl Outside {
    fn may_join(self, p: Vec3A, q: Vec3A) -> bool {
        match self {
            Self::Simplified => true,
            Self::DualCells => {
                // Dual cells reach from centre to centre; positions are rounded.
                let slack = 1e-3;
                let [lo, hi] = [p.min(q) - 0.5, p.max(q) - 0.5];
                hi.cmple((lo + slack).floor() + (1.0 + slack)).all()
            }
        }
    }
}

/// The topology that a patch must keep.
pub struct Topology {
    /// The vertices on the border, which other patches use, too.
    pub border: Vec<bool>,
    /// Vertices on the border whose triangles form more than one fan.
    pinched: Vec<bool>,
    outside: Outside,
}

impl Topology {
    /// Examines a patch that is oriented, and manifold but for its border.
    pub fn of(patch: &Surface, outside: Outside) -> Self {
        let mut fans = vec![0_u8; patch.positions.len()];
        for triangle in 0..patch.triangles.len() as u32 {
            for [from, _] in patch.open_edges(triangle) {
                fans[from as usize] += 1;
            }
        }
        let with = |least: u8| fans.iter().map(|&count| count >= least).collect();
        Self { border: with(1), pinched: with(2), outside }
    }

    /// Whether not all triangles around a vertex are known from one of them.
    pub fn is_pinched(&self, vertex: u32) -> bool {
        self.pinched[vertex as usize]
    }

    /// Whether there may be an edge between the two outside of the patch.
    pub fn is_chord(&self, patch: &Surface, a: u32, b: u32) -> bool {
        let [p, q] = [a, b].map(|vertex| patch.positions[vertex as usize]);
        self.border[a as usize] && self.border[b as usize] && self.outside.may_join(p, q)
    }
}
