//! See the room's `mod.rs` for the formula.

use crate::brick::Block;
use crate::grid::CellBox;
use crate::stage::blur::{Kernel, blur};
use crate::units::Isovalue;

/// Brings back what `smooth` lost of `dif`, as far as `kernel` blurs it.
///
/// The result is smaller than `smooth` by the kernel's reach on every side. In a bounded domain the
/// cells beyond the walls must repeat the edge cells in both blocks, and do so in theta_bar too.
///
/// # Panics
/// If `dif` does not cover `smooth`.
#[must_use]
pub fn recover(dif: &Block, smooth: &Block, iso: Isovalue, kernel: &Kernel) -> Block {
    let mut lost = Block::zero(smooth.cells());
    let rows = dif.rows(smooth.cells()).zip(smooth.rows(smooth.cells()));
    let width = smooth.cells().size().x as usize;
    for (to, ((_, dif), (_, smooth))) in lost.samples_mut().chunks_exact_mut(width).zip(rows) {
        for ((to, &dif), &smooth) in to.iter_mut().zip(dif).zip(smooth) {
            *to = if smooth <= iso.threshold() { dif } else { 0 };
        }
    }
    let mut field = blur(&lost, kernel);
    take_greater(&mut field, smooth);
    field
}

fn take_greater(field: &mut Block, other: &Block) {
    let cells: CellBox = field.cells();
    let width = cells.size().x as usize;
    for (to, (_, from)) in field.samples_mut().chunks_exact_mut(width).zip(other.rows(cells)) {
        to.iter_mut().zip(from).for_each(|(to, &from)| *to = (*to).max(from));
    }
}
