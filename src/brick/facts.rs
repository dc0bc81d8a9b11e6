//! Facts about a frame, in addition to its field.

use crate::grid::{CellBox, Domain, Grid, Mirror, Periodic, PeriodicMesh};

use super::Census;

/// Facts about a frame, for any method of reconstruction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameFacts {
    /// The grid of cells.
    pub grid: Grid,
    /// Walls, if the fluid is in a tank.
    pub domain: Option<Domain>,
    /// The periodic box, if there is one. Binning includes the images of the particles, which lie
    /// beyond the faces of the box.
    pub periodic: Option<Periodic>,
    /// Numbers of binned and skipped particles, not counting images.
    pub census: Census,
    /// The particles' spacing, in the grid's unit of length, if it is known.
    pub spacing: Option<f64>,
}

impl FrameFacts {
    /// The facts for the grid of octave number `octave`, whose spacing and cells are 2^`octave`
    /// times as large.
    #[must_use]
    pub fn in_octave(&self, octave: u32) -> Self {
        Self {
            grid: self.grid.in_wider_cells(octave),
            domain: self.domain.map(|domain| domain.in_wider_cells(octave)),
            periodic: self.periodic.map(|periodic| periodic.in_wider_cells(octave)),
            spacing: self.spacing.map(|spacing| spacing * f64::from(1_u32 << octave)),
            ..*self
        }
    }

    /// The cells within the walls; `None` without walls.
    #[must_use]
    pub fn walls(&self) -> Option<CellBox> {
        self.domain.as_ref().map(Domain::cells)
    }

    /// The mirror at the walls, for filters in cells 2^`level` times as wide; `None` without walls.
    #[must_use]
    pub fn mirror(&self, level: u32) -> Option<Mirror> {
        self.domain.map(|domain| domain.mirror().in_wider_cells(level))
    }

    /// The mirror for the field from which the mesh is computed, in cells 2^`level` times as wide.
    /// The planes of this mirror are the outer faces of the cells within the walls, so a ghost
    /// point beyond a wall has the sample of the cell before the wall.
    #[must_use]
    pub fn mesh_mirror(&self, level: u32) -> Option<Mirror> {
        self.walls().map(|walls| Mirror::new(walls.in_wider_cells(level)))
    }

    /// The walls at which the mesh ends; the field may extend beyond them.
    #[must_use]
    pub fn mesh_walls(&self, mesh: PeriodicMesh) -> Option<Domain> {
        match &self.periodic {
            None => self.domain,
            Some(periodic) => periodic.mesh_walls(self.domain, mesh),
        }
    }

    /// The cells that contain the particles themselves rather than images; `None` if there are no
    /// images.
    #[must_use]
    pub fn own_cells(&self) -> Option<CellBox> {
        self.periodic.as_ref().map(Periodic::cells)
    }

    /// The particles' spacing in cells, if it is known.
    #[must_use]
    pub fn spacing_cells(&self) -> Option<f64> {
        self.spacing.map(|spacing| spacing / self.grid.cell_size())
    }

    /// The particles' spacing in cells; 1 if it is not known.
    #[must_use]
    pub fn spacing_cells_or_one(&self) -> f64 {
        self.spacing_cells().unwrap_or(1.0)
    }
}
