//! One frame on a device: its memory there, and the recovery from failures.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::backend::Work;
use crate::brick::PageShape;
use crate::grid::MortonKey;
use crate::vulkan::{Buffer, BufferKind, Device, VulkanError};

use super::constants::Constants;
use super::lane::{HEADROOM, Lane};
use super::pipelines::{Pipelines, page_bytes};
use super::resident::{PageReader, ResidentPages};

/// Number of batches in flight.
pub(super) const LANES: usize = 2;
/// Minimum size of a batch, in bytes. If even smaller batches are needed, the CPU takes over.
const SMALLEST_BATCH: u64 = 1 << 20;

/// Buffers and constants that stay on the device between frames.
#[derive(Debug, Default)]
pub(super) struct FrameBuffers {
    lanes: Vec<Lane>,
    /// Buffers for the pages of a frame, followed by buffers for the pages of its wider cells.
    pages: VecDeque<Arc<Buffer>>,
    pub(super) constants: Constants,
}

/// One frame on the device.
#[derive(Debug)]
pub(super) struct DeviceFrame {
    pub(super) device: Device,
    pub(super) pipelines: Arc<Pipelines>,
    pub(super) reusable: Arc<Mutex<FrameBuffers>>,
    pub(super) state: Mutex<DeviceState>,
    /// Fields whose pages are on the device, by level: the cells of level k are 2^k times as wide
    /// as the grid's cells.
    residents: Mutex<Vec<Arc<ResidentPages>>>,
    pub(super) reader: PageReader,
}

impl DeviceFrame {
    pub(super) fn new(
        device: Device,
        pipelines: Arc<Pipelines>,
        reusable: Arc<Mutex<FrameBuffers>>,
        state: DeviceState,
    ) -> Self {
        let (residents, reader) = (Mutex::default(), PageReader::default());
        Self { device, pipelines, reusable, state: Mutex::new(state), residents, reader }
    }

    pub(super) fn state(&self) -> MutexGuard<'_, DeviceState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// All fields on the device.
    pub(super) fn residents(&self) -> MutexGuard<'_, Vec<Arc<ResidentPages>>> {
        self.residents.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The field in cells 2^`level` times as wide, if its pages are on the device.
    pub(super) fn resident(&self, level: usize) -> Option<Arc<ResidentPages>> {
        self.residents().get(level).cloned()
    }

    /// Drops all fields on the device; returns whether there were any.
    pub(super) fn forget_residents(&self) -> bool {
        !std::mem::take(&mut *self.residents()).is_empty()
    }

    /// Adds the field of `level`, whose cells are 2^`level` times as wide, after removing the
    /// fields of this and higher levels.
    pub(super) fn add_resident(&self, level: usize, resident: ResidentPages) {
        let mut residents = self.residents();
        residents.truncate(level);
        residents.push(Arc::new(resident));
    }

    pub(super) fn reusable(&self) -> MutexGuard<'_, FrameBuffers> {
        self.reusable.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes existing lanes if they are not too large for this frame, or makes new lanes.
    pub(super) fn make_lanes(&self, state: &mut DeviceState) -> Result<(), VulkanError> {
        while state.lanes.len() < LANES {
            let mut reusable = self.reusable();
            // Lanes are reused in order, because the first lane has the largest buffers.
            let known = (!reusable.lanes.is_empty()).then(|| reusable.lanes.remove(0));
            drop(reusable);
            let fitting = known.filter(|lane| lane.bytes() <= 2 * state.batch_bytes);
            let lane = fitting.map_or_else(|| Lane::new(&self.device), Ok)?;
            state.lanes.push(lane);
        }
        Ok(())
    }

    /// Makes a buffer for the pages of all bins if the pages fit. Drops the pages of other bins.
    pub(super) fn make_resident(
        &self,
        state: &mut DeviceState,
        keys: &[MortonKey],
        shape: PageShape,
    ) {
        let known = self.resident(0).is_some_and(|resident| {
            resident.numbers.len() == keys.len() && resident.numbers.contains_key(&keys[0].coord())
        });
        if known {
            return;
        }
        self.forget_residents();
        // A buffer is allocated only for the first run of bins. If there are several runs, the
        // pages do not stay on the device, because no buffer contains the pages of all runs.
        let most = std::mem::take(&mut state.resident_bytes);
        if let Some(pages) = self.page_buffer(state, keys.len() as u64 * page_bytes(shape), most) {
            let numbers = keys.iter().map(|key| key.coord()).zip(0..).collect();
            state.wide_bytes = most - pages.bytes().min(most);
            self.add_resident(0, ResidentPages { pages, numbers });
        }
    }

    /// A buffer of at least `bytes` for the pages of the next field; `None` if `bytes` exceeds
    /// `most`, or if the memory cannot be allocated.
    pub(super) fn page_buffer(
        &self,
        state: &mut DeviceState,
        bytes: u64,
        most: u64,
    ) -> Option<Arc<Buffer>> {
        let most = most.min(self.device.limits().storage_range);
        if bytes > most {
            return None;
        }
        let known = self.reusable().pages.pop_front();
        let fitting = known.filter(|pages| (bytes..=most).contains(&pages.bytes()));
        let with_headroom =
            (bytes + bytes / HEADROOM).min(most).min(self.device.limits().allocation).max(bytes);
        let made = |bytes| self.device.buffer(BufferKind::Device, bytes);
        match fitting.map_or_else(|| made(with_headroom).or_else(|_| made(bytes)), Ok) {
            Ok(pages) => Some(pages),
            Err(error) => {
                state
                    .warn(format!("{error}; sending the field to the device again for each batch"));
                None
            }
        }
    }

    /// Recovers from a failure. If memory is exhausted, the work continues without fields that stay
    /// on the device or, if there are no such fields, in smaller batches. If batches are already
    /// minimal, or after any other kind of failure, the work continues on the CPU.
    pub(super) fn recover(&self, state: &mut DeviceState, error: &VulkanError) {
        state.lanes.clear();
        *self.reusable() = FrameBuffers::default();
        let had_residents = self.forget_residents();
        state.recover(error, had_residents);
    }
}

impl Drop for DeviceFrame {
    /// Keeps the lanes and the page buffers for the next frame, unless the CPU took over.
    fn drop(&mut self) {
        let state = self.state.get_mut().unwrap_or_else(PoisonError::into_inner);
        if state.on_cpu {
            return;
        }
        let mut reusable = self.reusable.lock().unwrap_or_else(PoisonError::into_inner);
        reusable.lanes.append(&mut state.lanes);
        reusable.lanes.truncate(LANES);
        let residents = self.residents.get_mut().unwrap_or_else(PoisonError::into_inner);
        if !residents.is_empty() {
            reusable.pages = residents.iter().map(|resident| Arc::clone(&resident.pages)).collect();
        }
    }
}

#[derive(Debug)]
pub(super) struct DeviceState {
    pub(super) lanes: Vec<Lane>,
    pub(super) batch_bytes: u64,
    /// Maximum bytes of a frame's pages on the device, until the buffer for them is allocated; then
    /// 0.
    pub(super) resident_bytes: u64,
    /// Bytes that remain for pages of wider cells, after the buffer for the frame's pages is
    /// allocated.
    pub(super) wide_bytes: u64,
    /// Whether the CPU does the remaining work, because the device is lost or has too little
    /// memory.
    pub(super) on_cpu: bool,
    pub(super) warnings: Vec<String>,
    /// The work that the device did.
    pub(super) done: Work,
}

impl DeviceState {
    fn recover(&mut self, error: &VulkanError, had_residents: bool) {
        let exhausted = matches!(error, VulkanError::OutOfMemory { .. });
        (self.resident_bytes, self.wide_bytes) = (0, 0);
        if exhausted && had_residents {
            self.warn(format!("{error}; sending the field to the device again for each batch"));
        } else if exhausted && self.batch_bytes / 2 >= SMALLEST_BATCH {
            self.batch_bytes /= 2;
            self.warn(format!(
                "{error}; continuing in batches of {}",
                bytesize::ByteSize(self.batch_bytes)
            ));
        } else {
            self.on_cpu = true;
            self.warn(format!("{error}; continuing on the CPU"));
        }
    }

    pub(super) fn warn(&mut self, warning: String) {
        self.warnings.push(warning);
    }
}
