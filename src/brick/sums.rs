//! Cell sums: how many particles each cell of a bin holds, and the sum of their offsets.

use crate::grid::BIN;

const CELLS: usize = (BIN * BIN * BIN) as usize;

/// Sums for the cells of one bin, x fastest: integers, which doubles hold exactly up to 2^53, so that the order of
/// addition does not matter.
#[derive(Debug)]
pub struct CellSums {
    /// Per cell: the particles' number N, then the sum S of their offsets along x, y and z.
    cells: Box<[[f64; 4]]>,
}

impl Default for CellSums {
    fn default() -> Self {
        Self { cells: vec![[0.0; 4]; CELLS].into() }
    }
}

impl CellSums {
    /// Forgets what came before and adds up `particles`: cell, and offset in it.
    pub fn accumulate(&mut self, particles: impl Iterator<Item = (usize, [u32; 3])>) {
        self.cells.fill([0.0; 4]);
        for (cell, [x, y, z]) in particles {
            let sums = &mut self.cells[cell & (CELLS - 1)];
            let add = [1, x, y, z].map(f64::from);
            sums.iter_mut().zip(add).for_each(|(sum, add)| *sum += add);
        }
    }

    /// N and S of every cell.
    #[must_use]
    pub fn cells(&self) -> &[[f64; 4]] {
        &self.cells
    }
}
