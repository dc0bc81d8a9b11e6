//! One frame on a device: what it holds there, and what becomes of that when something fails.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use glam::IVec3;
use hashbrown::HashMap;

use crate::backend::Work;
use crate::brick::PageShape;
use crate::grid::MortonKey;
use crate::vulkan::{Buffer, Device, Place, VulkanError};

use super::constants::Constants;
use super::kernels::{Kernels, page_bytes};
use super::lane::{HEADROOM, Lane};

/// Batches in flight.
pub(super) const LANES: usize = 2;
/// Bytes of a batch at which the processor takes over.
const SMALLEST_BATCH: u64 = 1 << 20;

/// What is kept on the device between frames.
#[derive(Debug, Default)]
pub(super) struct Kept {
    lanes: Vec<Lane>,
    /// Room for the pages of a frame.
    pages: Option<Arc<Buffer>>,
    pub(super) constants: Constants,
}

/// One frame on the device.
#[derive(Debug)]
pub(super) struct DeviceFrame {
    pub(super) device: Device,
    pub(super) kernels: Arc<Kernels>,
    pub(super) kept: Arc<Mutex<Kept>>,
    pub(super) state: Mutex<State>,
}

impl DeviceFrame {
    pub(super) fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes lanes that were kept, if they are not too large for this frame, or makes them.
    pub(super) fn make_lanes(&self, state: &mut State) -> Result<(), VulkanError> {
        while state.lanes.len() < LANES {
            let mut kept = self.kept();
            // In their order: the first to be used has grown.
            let known = (!kept.lanes.is_empty()).then(|| kept.lanes.remove(0));
            drop(kept);
            let fitting = known.filter(|lane| lane.bytes() <= 2 * state.batch_bytes);
            let lane = fitting.map_or_else(|| Lane::new(&self.device), Ok)?;
            state.lanes.push(lane);
        }
        Ok(())
    }

    /// Makes room for the pages of all bins, unless they are too many; pages of other bins are forgotten.
    pub(super) fn make_resident(&self, state: &mut State, keys: &[MortonKey], shape: PageShape) {
        let count = keys.len();
        let bytes = count as u64 * page_bytes(shape);
        let known = state.resident.as_ref().is_some_and(|resident| {
            resident.numbers.len() == count && resident.numbers.contains_key(&keys[0].coord())
        });
        if known {
            return;
        }
        state.resident = None;
        let most = state.resident_bytes.min(self.device.limits().storage_range);
        if bytes <= most {
            let numbers = keys.iter().map(|key| key.coord()).zip(0..).collect();
            let kept = self.kept().pages.take();
            let fits = |pages: &Arc<Buffer>| (bytes..=most).contains(&pages.bytes());
            let with_headroom = (bytes + bytes / HEADROOM).min(most);
            let made = kept.filter(fits).map_or_else(|| self.device.buffer(Place::Device, with_headroom), Ok);
            match made {
                Ok(pages) => state.resident = Some(Resident { pages, numbers }),
                Err(error) => state.warn(format!("{error}; the field is sent anew for every batch")),
            }
        }
        // Only once: runs of bins that follow one another do not fit together.
        state.resident_bytes = 0;
    }

    /// After a failure: smaller batches where memory is exhausted, the processor where that does not help.
    pub(super) fn recover(&self, state: &mut State, error: &VulkanError) {
        state.lanes.clear();
        *self.kept() = Kept::default();
        state.recover(error);
    }
}

impl Drop for DeviceFrame {
    /// Keeps what the next frame can use.
    fn drop(&mut self) {
        let state = self.state.get_mut().unwrap_or_else(PoisonError::into_inner);
        if state.on_cpu {
            return;
        }
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.lanes.append(&mut state.lanes);
        kept.lanes.truncate(LANES);
        if let Some(Resident { pages, .. }) = state.resident.take() {
            kept.pages = Some(pages);
        }
    }
}

#[derive(Debug)]
pub(super) struct State {
    pub(super) lanes: Vec<Lane>,
    pub(super) batch_bytes: u64,
    pub(super) resident_bytes: u64,
    pub(super) resident: Option<Resident>,
    /// Once the device is lost or too small.
    pub(super) on_cpu: bool,
    pub(super) warnings: Vec<String>,
    /// By the device.
    pub(super) done: Work,
}

/// The pages of the frame's bins in one buffer.
#[derive(Debug)]
pub(super) struct Resident {
    pub(super) pages: Arc<Buffer>,
    pub(super) numbers: HashMap<IVec3, u32>,
}

impl State {
    fn recover(&mut self, error: &VulkanError) {
        let exhausted = matches!(error, VulkanError::OutOfMemory { .. });
        if exhausted && self.resident.take().is_some() {
            self.resident_bytes = 0;
            self.warn(format!("{error}; the field is sent anew for every batch"));
        } else if exhausted && self.batch_bytes / 2 >= SMALLEST_BATCH {
            self.batch_bytes /= 2;
            self.warn(format!("{error}; going on in batches of {}", bytesize::ByteSize(self.batch_bytes)));
        } else {
            self.resident = None;
            self.on_cpu = true;
            self.warn(format!("{error}; going on on the CPU"));
        }
    }

    fn warn(&mut self, warning: String) {
        self.warnings.push(warning);
    }
}
