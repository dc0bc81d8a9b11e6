//! The paper from the DIF to the field, once: smooth, and bring back the details.

use std::convert::Infallible;
use std::rc::Rc;

use crate::brick::{Block, DifField};
use crate::grid::{CellBox, Domain};
use crate::stage::blur::{Kernel, Smoothing, filter};
use crate::stage::detail::{lost, raise};
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

    /// The paper, from the DIF to the field, wherever fields are kept.
    ///
    /// # Errors
    /// Those of `fields`.
    pub fn apply<F: Fields>(&self, fields: &mut F, dif: F::Field) -> Result<F::Field, F::Error> {
        let kept = self.detail.as_ref().map(|kernel| (kernel, dif.clone()));
        let mut kernels = self.smoothing.filters().iter();
        let smooth = kernels.try_fold(dif, |field, kernel| fields.blur(field, kernel))?;
        let Some((kernel, dif)) = kept else { return Ok(smooth) };
        let lost = fields.lost(dif, &smooth, self.iso)?;
        let fine = fields.blur(lost, kernel)?;
        fields.greater(fine, smooth)
    }

    /// The field, from a DIF that is larger by [`halo`](Self::halo) on every side.
    #[must_use]
    pub fn field(&self, dif: Block, domain: Option<&Domain>) -> Block {
        let mut blocks = Blocks { walls: domain.map(Domain::cells) };
        match self.apply(&mut blocks, Rc::new(dif)) {
            Ok(field) => Rc::unwrap_or_clone(field),
            Err(never) => match never {},
        }
    }
}

/// Where fields are kept, and the filters on them. A clone of a field is the same field.
#[allow(clippy::missing_errors_doc, reason = "whatever Error is")]
pub trait Fields {
    /// Samples of a box of cells.
    type Field: Clone;
    /// What can go wrong.
    type Error;

    /// One separable filter (section 4.2); at a wall it sees the edge cells repeated.
    fn blur(&mut self, field: Self::Field, kernel: &Kernel) -> Result<Self::Field, Self::Error>;

    /// theta_bar (section 6.2).
    fn lost(
        &mut self,
        dif: Self::Field,
        smooth: &Self::Field,
        iso: Isovalue,
    ) -> Result<Self::Field, Self::Error>;

    /// Of two fields the greater, cell by cell.
    fn greater(&mut self, field: Self::Field, other: Self::Field) -> Result<Self::Field, Self::Error>;
}

/// Fields in blocks.
struct Blocks {
    walls: Option<CellBox>,
}

impl Fields for Blocks {
    type Field = Rc<Block>;
    type Error = Infallible;

    fn blur(&mut self, field: Rc<Block>, kernel: &Kernel) -> Result<Rc<Block>, Infallible> {
        Ok(Rc::new(filter(&field, kernel, self.walls)))
    }

    fn lost(&mut self, dif: Rc<Block>, smooth: &Rc<Block>, iso: Isovalue) -> Result<Rc<Block>, Infallible> {
        Ok(Rc::new(lost(&dif, smooth, iso)))
    }

    fn greater(&mut self, mut field: Rc<Block>, other: Rc<Block>) -> Result<Rc<Block>, Infallible> {
        raise(Rc::make_mut(&mut field), &other);
        Ok(field)
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
