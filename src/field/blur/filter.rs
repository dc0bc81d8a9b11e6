//! A stage between the DIF and the field, with the properties that other modules need.

use super::Weights;

/// A stage that states its reach, its weights and its memory.
pub trait Filter {
    /// The distance, in cells, within which input cells affect an output cell.
    fn halo(&self) -> i32;

    /// The maximum distance, in cells, from a nonzero cell of the output to the nearest full cell
    /// of the input.
    fn reach(&self) -> i32 {
        self.halo()
    }

    /// The weights of the filter.
    fn weights(&self) -> &[Weights];

    /// The number of fields of a block that exist at once while the filter runs, including its
    /// input and its output.
    fn fields(&self) -> FieldCount;
}

/// A number of fields of a block that exist at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FieldCount {
    /// Number of fields in the memory of a thread.
    pub host: u64,
    /// Number of fields in buffers of a device; a buffer is reused as soon as no field refers to
    /// it.
    pub device: u64,
}
