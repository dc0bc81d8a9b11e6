//! What a frame may take of the machine, and what is done within it.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use crate::backend::{Backend, Cpu};
use crate::laps::Laps;
use crate::mesh::source::MeshSource;
use crate::scratch::free_bytes;
use crate::simplify::{Reduction, Simplified, simplify};
use crate::stitch::Stitched;
use crate::units::MemoryBudget;

use super::FrameError;

/// What a frame may take of the machine.
#[derive(Debug, Clone)]
pub struct Resources {
    /// Memory that may be resident at once.
    pub budget: MemoryBudget,
    /// The folder for what exceeds it.
    pub scratch: PathBuf,
    /// What the stages run on.
    pub backend: Arc<dyn Backend>,
}

impl Resources {
    /// Of the processor.
    #[must_use]
    pub fn new(budget: MemoryBudget, scratch: PathBuf) -> Self {
        Self { budget, scratch, backend: Arc::new(Cpu) }
    }

    /// What a reduction leaves of a surface; triangles beyond so many bytes go to scratch files.
    ///
    /// # Errors
    /// [`FrameError::NothingLeft`], and [`FrameError::Scratch`] where scratch files fail.
    pub fn simplify(
        &self,
        surface: Stitched,
        reduction: &Reduction,
        bytes: u64,
        laps: &mut Laps,
    ) -> Result<Simplified, FrameError> {
        let simplified = simplify(surface, reduction, bytes, &self.scratch).map_err(self.scratch_error())?;
        laps.lap("simplify");
        if simplified.triangle_count() == 0 {
            return Err(FrameError::NothingLeft { dropped: simplified.components_dropped() });
        }
        Ok(simplified)
    }

    /// Bytes that the backend takes of the machine's memory.
    pub(super) fn host_bytes(&self) -> u64 {
        self.backend.host_bytes(self.budget)
    }

    /// Refuses to begin what would fill the disk.
    pub(super) fn check_room(&self, needed: u64) -> Result<(), FrameError> {
        if needed == 0 {
            return Ok(());
        }
        let folder = &self.scratch;
        let free = free_bytes(folder).map_err(self.scratch_error())?;
        if needed > free {
            return Err(FrameError::NoRoom { folder: folder.clone(), needed, free });
        }
        Ok(())
    }

    pub(super) fn scratch_error(&self) -> impl Fn(io::Error) -> FrameError + '_ {
        |fault| FrameError::Scratch { folder: self.scratch.clone(), fault }
    }
}
