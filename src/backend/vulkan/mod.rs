//! The stages on a Vulkan device.
//!
//! Work goes in batches: bins to pages, regions of blocks to surfaces. Two are in flight, so that the host
//! prepares one and reads another while the device computes. The DIF stays on the device between the two
//! where it fits. What the device has no memory for is tried again in smaller batches, and on the processor at
//! last; so is everything once the device is lost. Bytes are the same wherever they are computed.

mod bins;
mod blocks;
mod fields;
mod grids;
mod lane;

use std::io;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use glam::IVec3;
use hashbrown::HashMap;

use crate::brick::vulkan::{DeviceBins, GATHER, page_words};
use crate::brick::{Bins, PageShape, Pages};
use crate::grid::{CellBox, MortonKey};
use crate::mesh::BlockMesh;
use crate::stage::blur::vulkan::BLUR;
use crate::stage::detail::vulkan::{GREATER, LOST};
use crate::stage::distance::vulkan::{
    DEPTHS_OF, JOIN, Kernels as Distance, LOOK, MIX, OUTLYING, QUOTIENT, REFINE, SPREAD,
};
use crate::stage::dual_mc::vulkan::{BASES, EMIT, Kernels as DualMc, SIGNS, TILES};
use crate::stage::indicator::PageRule;
use crate::stage::indicator::vulkan::{CLOUDS, INDICATE, Kernels as Indicators};
use crate::units::MemoryBudget;
use crate::vulkan::{Buffer, Device, Kernel, Place, VulkanError};

use super::{Backend, Cpu, Stages, Surfaces, Work};
use bins::bin_bytes;
pub use blocks::DeviceSurfaces;
use fields::Constants;
use lane::{HEADROOM, Lane};

/// Batches in flight.
const LANES: usize = 2;
/// Bins and blocks of a batch at the most.
const BIN_BATCH: usize = 4096;
/// Particles of a batch of several bins at the most: drivers give up on a device that is at work for some two seconds on end.
const PARTICLE_BATCH: usize = 4 << 20;
const BLOCK_BATCH: usize = 1024;
/// Bytes of a batch at the most, and at which the processor takes over.
const LARGEST_BATCH: u64 = 128 << 20;
const SMALLEST_BATCH: u64 = 1 << 20;
/// What a driver takes of the host's memory.
const DRIVER: u64 = 96 << 20;

/// A Vulkan device with all kernels ready.
#[derive(Debug)]
pub struct Vulkan {
    device: Device,
    kernels: Arc<Kernels>,
    kept: Arc<Mutex<Kept>>,
    shares_host_memory: bool,
}

#[derive(Debug)]
struct Kernels {
    indicate: Indicators,
    gather: Arc<Kernel>,
    blur: Arc<Kernel>,
    lost: Arc<Kernel>,
    greater: Arc<Kernel>,
    distance: Distance,
    dual_mc: DualMc,
}

/// What is kept on the device between frames.
#[derive(Debug, Default)]
struct Kept {
    lanes: Vec<Lane>,
    /// Room for the pages of a frame.
    pages: Option<Arc<Buffer>>,
    constants: Constants,
}

/// Bytes that a frame may take.
#[derive(Debug, Clone, Copy)]
struct Shares {
    /// A batch, on the device and what is staged for it on the host.
    batch: u64,
    /// The DIF, where it stays on the device.
    resident: u64,
    /// All that is in the host's memory.
    host: u64,
}

impl Vulkan {
    /// Compiles the kernels for a device.
    ///
    /// # Errors
    /// [`VulkanError`] where the driver refuses one.
    pub fn new(device: Device) -> Result<Self, VulkanError> {
        #[rustfmt::skip]
        let [
            indicate, clouds, gather, blur, lost, greater,
            depths, mix, outlying, spread, look, refine, quotient, join,
            signs, tiles, bases, emit,
        ] = device.kernels([
            &INDICATE, &CLOUDS, &GATHER, &BLUR, &LOST, &GREATER,
            &DEPTHS_OF, &MIX, &OUTLYING, &SPREAD, &LOOK, &REFINE, &QUOTIENT, &JOIN,
            &SIGNS, &TILES, &BASES, &EMIT,
        ])?;
        let kernels = Kernels {
            indicate: Indicators { indicate, clouds },
            gather,
            blur,
            lost,
            greater,
            distance: Distance { depths, mix, outlying, spread, look, refine, quotient, join },
            dual_mc: DualMc { signs, tiles, bases, emit },
        };
        let shares_host_memory = device.shares_host_memory();
        Ok(Self { device, kernels: Arc::new(kernels), kept: Arc::default(), shares_host_memory })
    }

    /// The device.
    #[must_use]
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Gives back the memory that is kept for the next frame.
    pub fn release(&self) {
        *self.kept.lock().unwrap_or_else(PoisonError::into_inner) = Kept::default();
    }

    fn shares(&self, budget: MemoryBudget) -> Shares {
        let own = self.device.memory().unwrap_or(u64::MAX);
        if self.shares_host_memory {
            let total = own.min(budget.0 / 4);
            let batch = (total / 2 / LANES as u64 / (HEADROOM + 1) * HEADROOM).min(LARGEST_BATCH);
            Shares { batch, resident: total / 2, host: total + DRIVER }
        } else {
            let batch = (own / 4 / LANES as u64).min(budget.0 / 8).min(LARGEST_BATCH);
            Shares { batch, resident: own / 2, host: LANES as u64 * batch + DRIVER }
        }
    }
}

impl Vulkan {
    fn start_frame(&self, budget: MemoryBudget) -> DeviceFrame {
        let shares = self.shares(budget);
        let state = State {
            lanes: Vec::new(),
            batch_bytes: shares.batch,
            resident_bytes: shares.resident,
            resident: None,
            on_cpu: false,
            warnings: Vec::new(),
            done: Work::default(),
        };
        let (device, kernels, kept) =
            (self.device.clone(), Arc::clone(&self.kernels), Arc::clone(&self.kept));
        DeviceFrame { device, kernels, kept, state: Mutex::new(state) }
    }

    /// A frame whose particles and whose surface stay on the device.
    #[must_use]
    pub fn start_resident(&self) -> ResidentFrame {
        ResidentFrame(self.start_frame(MemoryBudget(u64::MAX)))
    }
}

/// A frame whose particles and whose surface stay on the device; the DIF is on the host as well.
#[derive(Debug)]
pub struct ResidentFrame(DeviceFrame);

impl ResidentFrame {
    /// The pages of all bins.
    ///
    /// # Errors
    /// Those of the device.
    pub fn indicate(&self, bins: &DeviceBins, rule: &PageRule) -> Result<Pages, VulkanError> {
        let mut state = self.0.state.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            match self.0.indicate_resident(&mut state, bins, rule) {
                Err(error @ VulkanError::OutOfMemory { .. }) if state.resident.is_some() => {
                    self.0.recover(&mut state, &error);
                }
                done => return done,
            }
        }
    }

    /// The surfaces of all blocks; in smaller batches where memory is exhausted.
    ///
    /// # Errors
    /// Those of the device.
    pub fn contour(&self, surfaces: &Surfaces<'_>) -> Result<DeviceSurfaces, VulkanError> {
        let mut state = self.0.state.lock().unwrap_or_else(PoisonError::into_inner);
        let regions = surfaces.regions();
        loop {
            match self.0.collect_batches(&mut state, surfaces, &regions) {
                Err(error @ VulkanError::OutOfMemory { .. }) => {
                    self.0.recover(&mut state, &error);
                    if state.on_cpu {
                        return Err(error);
                    }
                }
                done => return done,
            }
        }
    }
}

impl Backend for Vulkan {
    fn name(&self) -> String {
        format!("Vulkan, {}", self.device.name())
    }

    fn device(&self) -> Option<&Device> {
        Some(&self.device)
    }

    fn divides(&self) -> bool {
        false
    }

    fn host_bytes(&self, budget: MemoryBudget) -> u64 {
        self.shares(budget).host
    }

    fn start(&self, budget: MemoryBudget) -> Box<dyn Stages> {
        Box::new(self.start_frame(budget))
    }
}

/// One frame on the device.
#[derive(Debug)]
struct DeviceFrame {
    device: Device,
    kernels: Arc<Kernels>,
    kept: Arc<Mutex<Kept>>,
    state: Mutex<State>,
}

impl DeviceFrame {
    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes lanes that were kept, if they are not too large for this frame, or makes them.
    fn make_lanes(&self, state: &mut State) -> Result<(), VulkanError> {
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
    fn make_resident(&self, state: &mut State, keys: &[MortonKey], shape: PageShape) {
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
    fn recover(&self, state: &mut State, error: &VulkanError) {
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
struct State {
    lanes: Vec<Lane>,
    batch_bytes: u64,
    resident_bytes: u64,
    resident: Option<Resident>,
    /// Once the device is lost or too small.
    on_cpu: bool,
    warnings: Vec<String>,
    /// By the device.
    done: Work,
}

/// The pages of the frame's bins in one buffer.
#[derive(Debug)]
struct Resident {
    pages: Arc<Buffer>,
    numbers: HashMap<IVec3, u32>,
}

impl Stages for DeviceFrame {
    fn indicate(&self, bins: &Bins, range: Range<usize>, rule: &PageRule) -> io::Result<Pages> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let mut pages = Pages::with_capacity(range.len());
        let shape = rule.shape();
        while !state.on_cpu && pages.len() < range.len() {
            let begin = range.start + pages.len();
            let room = state.batch_bytes.min(self.device.limits().storage_range);
            let end =
                (begin..range.end).find(|&bin| bin_bytes(bins.count(bin), shape) > room).unwrap_or(range.end);
            if end == begin {
                // A bin too large for any batch. Without its page the others are of no use on the device.
                (state.resident, state.resident_bytes) = (None, 0);
                pages.extend(Cpu.indicate(bins, begin..begin + 1, rule)?);
                continue;
            }
            let outcome = self.indicate_batches(&mut state, bins, begin..end, rule, &mut pages);
            state.done.pages += range.start + pages.len() - begin;
            match outcome {
                Ok(()) => {}
                Err(Fault::Scratch(error)) => return Err(error),
                Err(Fault::Device(error)) => self.recover(&mut state, &error),
            }
        }
        if pages.len() < range.len() {
            // Without the pages of these bins the others are of no use.
            state.resident = None;
            pages.extend(Cpu.indicate(bins, range.start + pages.len()..range.end, rule)?);
        }
        Ok(pages)
    }

    fn contour(&self, surfaces: &Surfaces<'_>, regions: &[CellBox]) -> Vec<Option<BlockMesh>> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let mut meshes = Vec::with_capacity(regions.len());
        while !state.on_cpu && meshes.len() < regions.len() {
            let begin = meshes.len();
            let outcome = self.contour_batches(&mut state, surfaces, &regions[begin..], &mut meshes);
            state.done.regions += meshes.len() - begin;
            if let Err(error) = outcome {
                self.recover(&mut state, &error);
            }
        }
        let left = &regions[meshes.len()..];
        if !left.is_empty() {
            meshes.extend(Cpu.contour(surfaces, left));
        }
        meshes
    }

    fn warnings(&self) -> Vec<String> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).warnings.clone()
    }

    fn on_device(&self) -> Work {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).done
    }
}

enum Fault {
    Device(VulkanError),
    Scratch(io::Error),
}

impl From<VulkanError> for Fault {
    fn from(error: VulkanError) -> Self {
        Self::Device(error)
    }
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

/// Bytes of a page on the device.
fn page_bytes(shape: PageShape) -> u64 {
    4 * u64::from(page_words(shape))
}
