//! Facts of a frame beside its field.

use crate::grid::{CellBox, Domain, Grid, Periodic, PeriodicMesh};

use super::Census;

/// Facts of a frame, whatever its field is made by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameFacts {
    /// Where the cells are.
    pub grid: Grid,
    /// Walls, if the fluid is in a tank.
    pub domain: Option<Domain>,
    /// The box that repeats itself, if one does: images of the particles beyond its faces are
    /// binned as well.
    pub periodic: Option<Periodic>,
    /// Numbers of particles: in bins, and left out. Images do not count.
    pub census: Census,
    /// The particles' spacing in the unit of the grid, where it is known.
    pub spacing: Option<f64>,
}

impl FrameFacts {
    /// The cells within the walls, if there are any.
    #[must_use]
    pub fn walls(&self) -> Option<CellBox> {
        self.domain.as_ref().map(Domain::cells)
    }

    /// The walls at which the mesh ends, whatever the field sees beyond them.
    #[must_use]
    pub fn mesh_walls(&self, mesh: PeriodicMesh) -> Option<Domain> {
        match &self.periodic {
            None => self.domain,
            Some(periodic) => periodic.mesh_walls(self.domain, mesh),
        }
    }

    /// The cells in which a particle is itself, and not an image of another; `None` where there are
    /// no images.
    #[must_use]
    pub fn own_cells(&self) -> Option<CellBox> {
        self.periodic.as_ref().map(Periodic::cells)
    }

    /// The particles' spacing in cells, where it is known.
    #[must_use]
    pub fn spacing_cells(&self) -> Option<f64> {
        self.spacing.map(|spacing| spacing / self.grid.cell_size())
    }

    /// The particles' spacing in cells; one, where it is not known.
    #[must_use]
    pub fn spacing_cells_or_one(&self) -> f64 {
        self.spacing_cells().unwrap_or(1.0)
    }
}
