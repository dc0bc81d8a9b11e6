//! The paper from the DIF to the field, once: smooth, and bring back or spare the details.

use std::rc::Rc;

use crate::brick::{Block, DifField};
use crate::grid::{CellBox, Domain};
use crate::stage::adaptive::{Adaptive, blend, occupancy, spread};
use crate::stage::blur::{Kernel, Smoothing, blur_while};
use crate::stage::detail::{lost, raise};
use crate::units::Isovalue;

/// Everything between the DIF and the isosurface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipe {
    /// Section 4.2.
    pub smoothing: Smoothing,
    /// What becomes of details.
    pub details: Details,
    /// Where the surface is.
    pub iso: Isovalue,
}

/// What becomes of details that smoothing loses.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Details {
    #[allow(missing_docs)]
    Smoothed,
    /// By the second Gaussian of section 6.2.
    Recovered(Kernel),
    /// By an adaptive blur.
    Spared(Adaptive),
}

impl Details {
    /// How far from a cell the smoothed DIF decides its field.
    #[must_use]
    pub fn halo(&self) -> i32 {
        match self {
            Self::Smoothed => 0,
            Self::Recovered(kernel) => kernel.reach(),
            Self::Spared(adaptive) => adaptive.near,
        }
    }
}

impl Recipe {
    /// How far from a full cell the field can be other than 0.
    #[must_use]
    pub fn reach(&self) -> i32 {
        let details = match &self.details {
            Details::Smoothed => 0,
            Details::Recovered(kernel) => kernel.reach(),
            Details::Spared(adaptive) => adaptive.fine.reach(),
        };
        self.smoothing.reach().max(details)
    }

    /// How far from a cell the DIF decides its field: the sum of the reaches of all steps.
    #[must_use]
    pub fn halo(&self) -> i32 {
        self.smoothing.reach() + self.details.halo()
    }

    /// Whether the surface can pass between cells whose field this decides: the DIF, or what smoothing has come to.
    fn may_cut(&self, block: &Block, away_from_walls: bool) -> bool {
        // A weighted mean lies on the same side as all that it is made of. In an adaptive blur every full cell
        // can be inside. All inside is no surface only away from walls.
        let threshold = self.iso.threshold();
        let least = if matches!(self.details, Details::Spared(_)) { 0 } else { threshold };
        let mut pieces = block.samples().chunks(PIECE);
        let any_inside = pieces.clone().any(|piece| maximum(piece) > least);
        any_inside && (!away_from_walls || pieces.any(|piece| minimum(piece) <= threshold))
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
        let smooth = |fields: &mut F, dif: F::Field| {
            self.smoothing.filters().iter().try_fold(dif, |field, kernel| fields.blur(field, kernel))
        };
        match &self.details {
            Details::Smoothed => smooth(fields, dif),
            Details::Recovered(kernel) => {
                let smooth = smooth(fields, dif.clone())?;
                let lost = fields.lost(dif, &smooth, self.iso)?;
                let fine = fields.blur(lost, kernel)?;
                fields.greater(fine, smooth)
            }
            Details::Spared(adaptive) => {
                let smooth = smooth(fields, dif.clone())?;
                let occupancy = fields.occupancy(dif, adaptive.least)?;
                let fine = fields.blur(occupancy, &adaptive.fine)?;
                let near = fields.spread(&smooth, adaptive.near)?;
                fields.blend(fine, smooth, near, self.iso)
            }
        }
    }

    /// The field, from a DIF that is larger by [`halo`](Self::halo) on every side.
    #[must_use]
    pub fn field(&self, dif: Block, domain: Option<&Domain>) -> Block {
        self.field_while(dif, domain, &|_| true).expect("nothing stops it")
    }

    /// The same where the surface can pass between its cells, as far as can be told before there is a field.
    #[must_use]
    pub fn cut_field(&self, dif: Block, domain: Option<&Domain>, away_from_walls: bool) -> Option<Block> {
        if !self.may_cut(&dif, away_from_walls) {
            return None;
        }
        match self.details {
            Details::Smoothed => {
                self.field_while(dif, domain, &|smooth| self.may_cut(smooth, away_from_walls))
            }
            _ => Some(self.field(dif, domain)),
        }
    }

    fn field_while(
        &self,
        dif: Block,
        domain: Option<&Domain>,
        goes_on: &dyn Fn(&Block) -> bool,
    ) -> Option<Block> {
        let mut blocks = Blocks { walls: domain.map(Domain::cells), goes_on };
        self.apply(&mut blocks, Rc::new(dif)).ok().map(Rc::unwrap_or_clone)
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

    /// 1 in every full cell, whose theta is not less than `least`.
    fn occupancy(&mut self, dif: Self::Field, least: u16) -> Result<Self::Field, Self::Error>;

    /// The greatest sample within `reach` cells along each axis; at a wall it sees the edge cells repeated.
    fn spread(&mut self, field: &Self::Field, reach: i32) -> Result<Self::Field, Self::Error>;

    /// The field of an adaptive blur, from the blurred occupancy, the smoothed DIF and the greatest of that near by.
    fn blend(
        &mut self,
        fine: Self::Field,
        smooth: Self::Field,
        near: Self::Field,
        iso: Isovalue,
    ) -> Result<Self::Field, Self::Error>;
}

/// Samples that are looked at before it is asked whether that was enough.
const PIECE: usize = 1 << 10;

fn maximum(samples: &[u16]) -> u16 {
    samples.iter().fold(0, |maximum, &sample| maximum.max(sample))
}

fn minimum(samples: &[u16]) -> u16 {
    samples.iter().fold(u16::MAX, |minimum, &sample| minimum.min(sample))
}

/// Fields in blocks.
struct Blocks<'a> {
    walls: Option<CellBox>,
    /// Asked after each axis of a blur.
    goes_on: &'a dyn Fn(&Block) -> bool,
}

/// A blur did not go on.
struct Stopped;

impl Fields for Blocks<'_> {
    type Field = Rc<Block>;
    type Error = Stopped;

    fn blur(&mut self, field: Rc<Block>, kernel: &Kernel) -> Result<Rc<Block>, Stopped> {
        blur_while(Rc::unwrap_or_clone(field), kernel, self.walls, self.goes_on).map(Rc::new).ok_or(Stopped)
    }

    fn lost(&mut self, dif: Rc<Block>, smooth: &Rc<Block>, iso: Isovalue) -> Result<Rc<Block>, Stopped> {
        Ok(Rc::new(lost(&dif, smooth, iso)))
    }

    fn greater(&mut self, mut field: Rc<Block>, other: Rc<Block>) -> Result<Rc<Block>, Stopped> {
        raise(Rc::make_mut(&mut field), &other);
        Ok(field)
    }

    fn occupancy(&mut self, dif: Rc<Block>, least: u16) -> Result<Rc<Block>, Stopped> {
        Ok(Rc::new(occupancy(Rc::unwrap_or_clone(dif), least)))
    }

    fn spread(&mut self, field: &Rc<Block>, reach: i32) -> Result<Rc<Block>, Stopped> {
        let mut near = spread(Block::clone(field), reach);
        if let Some(walls) = self.walls {
            near.repeat_edges(walls);
        }
        Ok(Rc::new(near))
    }

    fn blend(
        &mut self,
        fine: Rc<Block>,
        smooth: Rc<Block>,
        near: Rc<Block>,
        iso: Isovalue,
    ) -> Result<Rc<Block>, Stopped> {
        Ok(Rc::new(blend(&fine, &smooth, Rc::unwrap_or_clone(near), iso)))
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
