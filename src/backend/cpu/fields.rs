//! The recipe on blocks in the memory of a thread.

use std::rc::Rc;

use crate::brick::Block;
use crate::grid::CellBox;
use crate::recipe::{Detail, Fields, Recipe};
use crate::stage::adaptive::{blend, occupancy, spread};
use crate::stage::blur::{Kernel, blur_while};
use crate::stage::detail::{lost, raise};
use crate::stage::indicator::SampledDif;
use crate::units::Isovalue;

/// Samples that are looked at before it is asked whether that was enough.
const PIECE: usize = 1 << 10;

fn maximum(samples: &[u16]) -> u16 {
    samples.iter().fold(0, |maximum, &sample| maximum.max(sample))
}

fn minimum(samples: &[u16]) -> u16 {
    samples.iter().fold(u16::MAX, |minimum, &sample| minimum.min(sample))
}

/// The final field on `cells` of a frame.
#[must_use]
pub fn field(recipe: &Recipe, sampled: &SampledDif, cells: CellBox) -> Block {
    field_while(recipe, sampled, cells, &|_| true).expect("nothing stops it")
}

/// The final field on `cells` where the surface can pass between them, as far as can be told before there is a field.
pub(super) fn cut_field(
    recipe: &Recipe,
    sampled: &SampledDif,
    cells: CellBox,
    away_from_walls: bool,
) -> Option<Block> {
    field_while(recipe, sampled, cells, &|block| may_cut(recipe, block, away_from_walls))
}

/// Whether the surface can pass between cells whose field this decides: the DIF, or what smoothing has come to.
fn may_cut(recipe: &Recipe, block: &Block, away_from_walls: bool) -> bool {
    // A weighted mean lies on the same side as all that it is made of. In an adaptive blur every full cell
    // can be inside. All inside is no surface only away from walls.
    let threshold = recipe.iso.threshold();
    let least = if recipe.filters.detail() == Detail::Adaptive { 0 } else { threshold };
    let mut pieces = block.samples().chunks(PIECE);
    let any_inside = pieces.clone().any(|piece| maximum(piece) > least);
    any_inside && (!away_from_walls || pieces.any(|piece| minimum(piece) <= threshold))
}

/// The field as long as `goes_on` says so of the DIF, and where nothing brings details back of what smoothing has come to.
fn field_while(
    recipe: &Recipe,
    SampledDif { facts, dif, .. }: &SampledDif,
    cells: CellBox,
    goes_on: &dyn Fn(&Block) -> bool,
) -> Option<Block> {
    let (halo, walls) = (recipe.filters.halo(), facts.walls());
    let dif = dif.gather_within(cells.grown(halo, halo), walls);
    if !goes_on(&dif) {
        return None;
    }
    let plain = recipe.filters.detail() == Detail::Smoothed;
    let goes_on = |smooth: &Block| !plain || goes_on(smooth);
    recipe.apply(&mut Blocks { walls, goes_on: &goes_on }, Rc::new(dif)).ok().map(Rc::unwrap_or_clone)
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
