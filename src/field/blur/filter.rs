//! A stage between the DIF and the field, as far as others have to know it.

use super::Weights;

/// A stage that states its reach, its weights and its memory.
pub trait Filter {
    /// How far from a cell its input decides its output, in cells.
    fn halo(&self) -> i32;

    /// How far from a full cell its output can be other than 0, in cells.
    fn reach(&self) -> i32 {
        self.halo()
    }

    /// The weights that it needs.
    fn weights(&self) -> &[Weights];

    /// Fields of a block that are there at once while it runs, its input and its output among them.
    fn fields(&self) -> FieldCount;
}

/// Fields of a block that are there at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FieldCount {
    /// Fields in the memory of a thread.
    pub host: u64,
    /// Fields in buffers of a device, which are used again as soon as nobody refers to them.
    pub device: u64,
}
