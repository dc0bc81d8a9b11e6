//! Cell sums: the number of particles in each cell of a bin, and the sum of their offsets.

use crate::grid::BIN;

/// Number of cells in a row.
const ROW: usize = BIN as usize;
const ROWS: usize = ROW * ROW;
const CELLS: usize = ROW * ROWS;

/// Sums for the cells of one bin, x fastest. The sums are integers, which f64 represents exactly up
/// to 2^53, so the order of addition does not matter.
#[derive(Debug)]
pub struct CellSums {
    /// For each cell: the number N of particles, and the sum S of their offsets along x, y and z.
    cells: Box<[[f64; 4]]>,
    /// A bit for each row along x, set if the row contains particles. Only rows whose bit is set
    /// are valid in `cells`.
    rows: [u64; ROWS / 64],
}

impl Default for CellSums {
    fn default() -> Self {
        Self { cells: vec![[0.0; 4]; CELLS].into(), rows: [0; ROWS / 64] }
    }
}

impl CellSums {
    /// Replaces the sums with those of `particles`. Each particle is given by its cell and its
    /// offset in the cell.
    pub fn accumulate(&mut self, particles: impl Iterator<Item = (usize, [u32; 3])>) {
        self.rows = [0; ROWS / 64];
        let (rows, _) = self.cells.as_chunks_mut::<ROW>();
        for (cell, [x, y, z]) in particles {
            let row = cell / ROW % ROWS;
            let (word, bit) = (&mut self.rows[row / 64], 1 << (row % 64));
            if *word & bit == 0 {
                *word |= bit;
                rows[row] = [[0.0; 4]; ROW];
            }
            let add = [1, x, y, z].map(f64::from);
            rows[row][cell % ROW].iter_mut().zip(add).for_each(|(sum, add)| *sum += add);
        }
    }

    /// The rows that contain particles, each with its number and with N and S of its cells.
    #[inline(always)]
    pub fn rows(&self) -> impl Iterator<Item = (usize, &[[f64; 4]; ROW])> {
        let (rows, _) = self.cells.as_chunks::<ROW>();
        set_bits(self.rows).map(|row| (row, &rows[row]))
    }
}

/// The indices of the set bits in `words`.
#[inline(always)]
fn set_bits(words: [u64; ROWS / 64]) -> impl Iterator<Item = usize> {
    (0..ROWS).step_by(64).zip(words).flat_map(|(first, mut word)| {
        std::iter::from_fn(move || {
            let bit = word.trailing_zeros() as usize;
            (word != 0).then(|| {
                word &= word - 1;
                first + bit
            })
        })
    })
}
