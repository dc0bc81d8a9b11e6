//! Memory, folders and backend of a frame.

use std::io;
use std::path::PathBuf;

use crate::backend::Backend;
use crate::grid::units::MemoryBudget;
use crate::system::control::Control;
use crate::system::scratch::free_bytes;

use super::FrameError;

/// The resources of the machine that a frame may use.
#[derive(Debug, Clone)]
pub struct Resources {
    /// Maximum memory that may be resident at once.
    pub budget: MemoryBudget,
    /// The folder for data that exceeds the budget.
    pub scratch: PathBuf,
    /// The backend that the stages run on.
    pub backend: Backend,
    /// Reports progress to the caller, and lets the caller cancel the work.
    pub control: Control,
}

impl Resources {
    /// Creates resources with the CPU as the backend.
    pub fn new(budget: MemoryBudget, scratch: PathBuf) -> Self {
        Self { budget, scratch, backend: Backend::cpu(), control: Control::default() }
    }

    /// Host memory, in bytes, that the backend uses.
    pub(super) fn host_bytes(&self) -> u64 {
        self.backend.executor().host_bytes(self.budget)
    }

    /// Returns an error if the disk of the scratch folder has less than `needed` free bytes.
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

    /// Returns an error if the caller has cancelled.
    pub(crate) fn go_on(&self) -> Result<(), FrameError> {
        Ok(self.control.cancel.go_on()?)
    }

    pub(super) fn scratch_error(&self) -> impl Fn(io::Error) -> FrameError + '_ {
        |fault| FrameError::Scratch { folder: self.scratch.clone(), fault }
    }
}
