//! The paper from the DIF to the field, once: smooth, and bring back the details.

use crate::brick::{Block, DifField};
use crate::grid::{CellBox, Domain};
use crate::stage::blur::{Kernel, Smoothing};
use crate::stage::detail::recover;
use crate::units::Isovalue;

/// Everything between the DIF and the isosurface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipe {
    /// Section 4.2.
    pub smoothing: Smoothing,
    /// The second Gaussian of section 6.2, where details are to be recovered.
    pub detail: Option<Kernel>,
    /// Where the surface is.
    pub iso: Isovalue,
}

impl Recipe {
    /// How far from a full cell the field can be other than 0.
    #[must_use]
    pub fn reach(&self) -> i32 {
        self.smoothing.reach().max(self.detail_reach())
    }

    /// How far from a cell the DIF decides its field: the sum of the reaches of all steps.
    #[must_use]
    pub fn halo(&self) -> i32 {
        self.smoothing.reach() + self.detail_reach()
    }

    fn detail_reach(&self) -> i32 {
        self.detail.as_ref().map_or(0, Kernel::reach)
    }

    /// Cuts what the field of `cells` depends on out of the DIF.
    #[must_use]
    pub fn gather(&self, dif: &DifField, cells: CellBox, domain: Option<&Domain>) -> Block {
        gather(dif, cells.grown(self.halo(), self.halo()), domain)
    }

    /// The field, from a DIF that is larger by [`halo`](Self::halo) on every side.
    #[must_use]
    pub fn field(&self, dif: &Block, domain: Option<&Domain>) -> Block {
        let walls = domain.map(Domain::cells);
        let smooth = self.smoothing.apply(dif, walls);
        match &self.detail {
            None => smooth,
            Some(kernel) => {
                let mut field = recover(dif, &smooth, self.iso, kernel);
                if let Some(walls) = walls {
                    field.repeat_edges(walls);
                }
                field
            }
        }
    }
}

/// Cuts `cells` out of the DIF; beyond the walls of a domain the edge cells are repeated.
#[must_use]
pub fn gather(dif: &DifField, cells: CellBox, domain: Option<&Domain>) -> Block {
    let mut block = dif.gather(cells);
    if let Some(domain) = domain {
        block.repeat_edges(domain.cells());
    }
    block
}
