//! The stages on a Vulkan device.
//!
//! Work goes in batches: bins to pages, regions of blocks to surfaces. Two are in flight, so that the host
//! prepares one and reads another while the device computes. The DIF stays on the device between the two
//! where it fits. What the device has no memory for is tried again in smaller batches, and on the processor at
//! last; so is everything once the device is lost. Bytes are the same wherever they are computed.

mod bins;
mod blocks;
mod constants;
mod contouring;
mod fields;
mod frame;
mod grids;
mod kernels;
mod lane;
mod wide;

use std::io;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use crate::brick::vulkan::DeviceBins;
use crate::brick::{Bins, Pages};
use crate::grid::CellBox;
use crate::mesh::BlockMesh;
use crate::stage::indicator::PageRule;
use crate::units::MemoryBudget;
use crate::vulkan::{Device, VulkanError};

use super::{Backend, Cpu, Stages, Surfaces, Work};
use bins::{Fault, bin_bytes};
pub use blocks::DeviceSurfaces;
use frame::{DeviceFrame, Kept, LANES, State};
use kernels::Kernels;
use lane::HEADROOM;

/// Bytes of a batch at the most.
const LARGEST_BATCH: u64 = 128 << 20;
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
        let kernels = Arc::new(Kernels::new(&device)?);
        let shares_host_memory = device.shares_host_memory();
        Ok(Self { device, kernels, kept: Arc::default(), shares_host_memory })
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
    /// The pages of all bins; in smaller batches where memory is exhausted.
    ///
    /// # Errors
    /// Those of the device.
    pub fn indicate(&self, bins: &DeviceBins, rule: &PageRule) -> Result<Pages, VulkanError> {
        let mut state = self.0.state.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            match self.0.indicate_resident(&mut state, bins, rule) {
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
