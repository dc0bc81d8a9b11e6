//! See `mod.rs` of this folder for the formula.

use crate::brick::Block;
use crate::grid::units::Isovalue;

/// theta_bar: the samples of `dif` where `smooth` is at most the isovalue, and 0 elsewhere.
///
/// # Panics
/// If `dif` does not cover `smooth`.
pub fn lost(dif: &Block, smooth: &Block, iso: Isovalue) -> Block {
    let mut lost = Block::zero(smooth.cells());
    let rows = dif.rows(smooth.cells()).zip(smooth.rows(smooth.cells()));
    let width = smooth.cells().size().x as usize;
    for (to, ((_, dif), (_, smooth))) in lost.samples_mut().chunks_exact_mut(width).zip(rows) {
        for ((to, &dif), &smooth) in to.iter_mut().zip(dif).zip(smooth) {
            *to = if smooth <= iso.threshold() { dif } else { 0 };
        }
    }
    lost
}

/// Sets `field` to the maximum of `field` and `other`.
///
/// # Panics
/// If `other` does not cover `field`.
pub fn raise(field: &mut Block, other: &Block) {
    let cells = field.cells();
    let width = cells.size().x as usize;
    for (to, (_, from)) in field.samples_mut().chunks_exact_mut(width).zip(other.rows(cells)) {
        to.iter_mut().zip(from).for_each(|(to, &from)| *to = (*to).max(from));
    }
}
