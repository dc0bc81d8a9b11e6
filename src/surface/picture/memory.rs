//! Memory that a picture may take.

use super::error::PictureError;

/// Memory for a mesh.
pub(super) enum Memory {
    /// Room for the whole mesh, whatever it takes.
    Whole,
    /// No more than for batches of so many bytes.
    Batches(u64),
}

/// Memory that may be used, and what of it is taken.
pub(super) struct Budget {
    used: u64,
    allowed: u64,
}

impl Budget {
    /// Takes a part of the bytes that may be used.
    pub(super) fn new(used: u64, allowed: u64) -> Self {
        Self { used, allowed }
    }

    /// Makes sure that so many bytes more may be used.
    pub(super) fn check(&self, bytes: u64) -> Result<(), PictureError> {
        let Self { used, allowed } = *self;
        let needed = used + bytes;
        if needed <= allowed { Ok(()) } else { Err(PictureError::Memory { needed, allowed }) }
    }
}
