//! The stages on a Vulkan device.
//!
//! Work runs in batches: from bins to pages, and from regions of blocks to surfaces. Two batches
//! are in flight, so that the host prepares one and reads another while the device computes. The
//! DIF stays on the device between the two stages if it fits. Work that exceeds the device's memory
//! is retried in smaller batches, and finally on the CPU; if the device is lost, the CPU does the
//! remaining work. The device and the CPU produce the same bytes.

mod bins;
mod blocks;
mod constants;
mod contouring;
mod fields;
mod frame;
mod grids;
mod lane;
mod pipelines;
mod remote;
mod resident;
mod wide;

use std::io;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use crate::brick::vulkan::DeviceBins;
use crate::brick::{Bins, DifField, Pages};
use crate::field::indicator::PageRule;
use crate::grid::CellBox;
use crate::grid::units::MemoryBudget;
use crate::surface::mesh::BlockMesh;
use crate::system::control::Meter;
use crate::vulkan::{Device, VulkanError};

use super::cpu::CpuStages;
use super::{Executor, REGIONS_PER_CALL, Stages, Surfaces, Take, Work};
use bins::{DeviceFrameError, PlacedPages, bin_bytes};
pub use blocks::DeviceSurfaces;
use frame::{DeviceFrame, DeviceState, FrameBuffers, LANES};
use lane::HEADROOM;
use pipelines::{Pipelines, page_bytes};

/// Maximum bytes of a batch.
const LARGEST_BATCH: u64 = 128 << 20;
/// Bytes of host memory that a driver takes.
const DRIVER_BYTES: u64 = 96 << 20;
/// The most host memory, in bytes, that a frame needs if the device has its own memory.
pub(super) const MOST_HOST_BYTES: u64 = LANES as u64 * LARGEST_BATCH + DRIVER_BYTES;

/// A Vulkan device with all shaders compiled.
#[derive(Debug)]
pub struct Vulkan {
    device: Device,
    pipelines: Arc<Pipelines>,
    reusable: Arc<Mutex<FrameBuffers>>,
}

/// The memory limits of a frame.
#[derive(Debug, Clone, Copy)]
struct FrameBudget {
    /// Maximum bytes of a batch, on the device and in the staging buffer on the host.
    batch: u64,
    /// Maximum bytes of the DIF, if it stays on the device.
    resident: u64,
    /// Bytes of host memory that the frame needs.
    host: u64,
}

impl Vulkan {
    /// Compiles the shaders for a device.
    ///
    /// # Errors
    /// [`VulkanError`] if the driver rejects a shader.
    pub fn new(device: Device) -> Result<Self, VulkanError> {
        let pipelines = Arc::new(Pipelines::new(&device)?);
        Ok(Self { device, pipelines, reusable: Arc::default() })
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Frees the memory that is kept for the next frame.
    pub fn release(&self) {
        *self.reusable.lock().unwrap_or_else(PoisonError::into_inner) = FrameBuffers::default();
    }

    /// Divides the device's memory and the memory budget of the host.
    fn frame_budget(&self, budget: MemoryBudget) -> FrameBudget {
        let own = self.device.memory().unwrap_or(u64::MAX);
        if self.device.shares_host_memory() {
            let total = own.min(budget.0 / 4);
            let batch = (total / 2 / LANES as u64 / (HEADROOM + 1) * HEADROOM).min(LARGEST_BATCH);
            FrameBudget { batch, resident: total / 2, host: total + DRIVER_BYTES }
        } else {
            let batch = (own / 4 / LANES as u64).min(budget.0 / 8).min(LARGEST_BATCH);
            FrameBudget { batch, resident: own / 2, host: LANES as u64 * batch + DRIVER_BYTES }
        }
    }
}

impl Vulkan {
    fn start_frame(&self, budget: MemoryBudget) -> Arc<DeviceFrame> {
        let limits = self.frame_budget(budget);
        let state = DeviceState {
            lanes: Vec::new(),
            batch_bytes: limits.batch,
            resident_bytes: limits.resident,
            wide_bytes: 0,
            on_cpu: false,
            warnings: Vec::new(),
            done: Work::default(),
        };
        let (device, pipelines, reusable) =
            (self.device.clone(), Arc::clone(&self.pipelines), Arc::clone(&self.reusable));
        Arc::new(DeviceFrame::new(device, pipelines, reusable, state))
    }

    /// Starts a frame whose particles and surface stay on the device.
    pub fn start_resident(&self) -> ResidentFrame {
        ResidentFrame(self.start_frame(MemoryBudget(u64::MAX)))
    }
}

/// A frame whose particles and surface stay on the device. Its DIF also stays there if it fits.
#[derive(Debug)]
pub struct ResidentFrame(Arc<DeviceFrame>);

impl ResidentFrame {
    /// Computes the field of all bins, in smaller batches if memory is exhausted. Downloads of a
    /// field that stays on the device can fail later: see [`check`](Self::check).
    ///
    /// # Errors
    /// [`VulkanError`] if the device fails, or has too little memory even for small batches.
    pub fn indicate(&self, bins: &DeviceBins, rule: &PageRule) -> Result<DifField, VulkanError> {
        let mut state = self.0.state();
        let made = loop {
            match self.0.indicate_resident(&mut state, bins, rule) {
                Err(error @ VulkanError::OutOfMemory { .. }) => {
                    self.0.recover(&mut state, &error);
                    if state.on_cpu {
                        return Err(error);
                    }
                }
                done => break done?,
            }
        };
        Ok(match made {
            PlacedPages::Host(pages) => DifField::in_memory(rule.shape(), pages),
            PlacedPages::Device(infos) => remote::of_resident(&self.0, infos, rule.shape()),
        })
    }

    /// Checks that all downloads of the field succeeded.
    ///
    /// # Errors
    /// The error of the first download that failed.
    pub fn check(&self) -> Result<(), VulkanError> {
        self.0.reader.failed().map_or(Ok(()), Err)
    }

    /// Computes the surfaces of all blocks, in smaller batches if memory is exhausted.
    ///
    /// # Errors
    /// [`VulkanError`] if the device fails, or has too little memory even for small batches.
    pub fn contour(&self, surfaces: &Surfaces<'_>) -> Result<DeviceSurfaces, VulkanError> {
        let regions = surfaces.regions();
        surfaces.prepare();
        let mut state = self.0.state();
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

impl Executor for Vulkan {
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
        self.frame_budget(budget).host
    }

    fn start(&self, budget: MemoryBudget) -> Box<dyn Stages> {
        Box::new(self.start_frame(budget))
    }
}

impl Stages for Arc<DeviceFrame> {
    /// Keeps the field on the device if it fits. The field goes to the host if the device shares
    /// the host's memory. It also goes to the host if the pages take less memory than the
    /// particles. While a field is on the device, the host must keep the particles, so that the CPU
    /// can recompute pages after a failure.
    fn field(&self, bins: &Arc<Bins>, rule: &PageRule, meter: &Meter<'_>) -> io::Result<DifField> {
        let (count, shape) = (bins.keys().len(), rule.shape());
        let particles: usize = (0..count).map(|bin| bins.count(bin)).sum();
        if count as u64 * page_bytes(shape) >= (particles * size_of::<u64>()) as u64 {
            let mut state = self.state();
            match self.indicate_on_device(&mut state, bins, rule, meter) {
                Ok(Some(infos)) => return Ok(remote::of_bins(self, infos, bins, rule)),
                Ok(None) => {}
                Err(DeviceFrameError::Host(error)) => return Err(error),
                Err(DeviceFrameError::Device(error)) => self.recover(&mut state, &error),
            }
        }
        Ok(DifField::in_memory(shape, self.indicate(bins, 0..count, rule, meter)?))
    }

    fn indicate(
        &self,
        bins: &Bins,
        range: Range<usize>,
        rule: &PageRule,
        meter: &Meter<'_>,
    ) -> io::Result<Pages> {
        let mut state = self.state();
        let mut pages = Pages::with_capacity(range.len());
        let shape = rule.shape();
        while !state.on_cpu && pages.len() < range.len() {
            let begin = range.start + pages.len();
            let room = state.batch_bytes.min(self.device.limits().storage_range);
            let end = (begin..range.end)
                .find(|&bin| bin_bytes(bins.count(bin), shape) > room)
                .unwrap_or(range.end);
            if end == begin {
                // This bin is too large for any batch, so the CPU computes its page. The pages on
                // the device are dropped, because they lack this page.
                self.forget_residents();
                state.resident_bytes = 0;
                pages.extend(CpuStages::STAND_IN.indicate(bins, begin..begin + 1, rule, meter)?);
                continue;
            }
            let outcome =
                self.indicate_batches(&mut state, bins, begin..end, rule, meter, &mut pages);
            state.done.pages += range.start + pages.len() - begin;
            match outcome {
                Ok(()) => {}
                Err(DeviceFrameError::Host(error)) => return Err(error),
                Err(DeviceFrameError::Device(error)) => self.recover(&mut state, &error),
            }
        }
        if pages.len() < range.len() {
            // The CPU computes the pages of the remaining bins. The pages on the device are
            // dropped, because they lack these pages.
            self.forget_residents();
            let rest = range.start + pages.len()..range.end;
            pages.extend(CpuStages::STAND_IN.indicate(bins, rest, rule, meter)?);
        }
        Ok(pages)
    }

    fn contour(
        &self,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
        meter: &Meter<'_>,
        take: &mut Take<'_>,
    ) -> io::Result<()> {
        surfaces.prepare();
        if surfaces.solid.is_none() {
            return self.contour_away_from_solids(surfaces, regions, meter, take);
        }
        // The CPU computes the surfaces near solids, and the device computes all others. Both
        // backends produce the same bytes, so the surfaces match.
        for regions in regions.chunks(REGIONS_PER_CALL) {
            let (near, away): (Vec<CellBox>, Vec<CellBox>) =
                regions.iter().partition(|&&region| surfaces.is_at_solid(region));
            let (mut of_near, mut of_away) = (Vec::new(), Vec::new());
            let mut collect = |meshes: Vec<_>| {
                of_away.extend(meshes);
                Ok(())
            };
            self.contour_away_from_solids(surfaces, &away, meter, &mut collect)?;
            CpuStages::STAND_IN.contour(surfaces, &near, meter, &mut |meshes| {
                of_near.extend(meshes);
                Ok(())
            })?;
            meter.go_on()?;
            let (mut of_near, mut of_away) = (of_near.into_iter(), of_away.into_iter());
            let mut near = near.into_iter().peekable();
            let in_order = regions.iter().map(|region| match near.next_if_eq(region) {
                Some(_) => of_near.next().flatten(),
                None => of_away.next().flatten(),
            });
            take(in_order.collect())?;
        }
        Ok(())
    }

    fn warnings(&self) -> Vec<String> {
        let state = self.state();
        let mut warnings = state.warnings.clone();
        let failed = self.reader.failed().filter(|_| !state.on_cpu);
        warnings
            .extend(failed.map(|error| format!("{error}; repeating the device's work on the CPU")));
        warnings
    }

    fn on_device(&self) -> Work {
        self.state().done
    }
}

impl DeviceFrame {
    /// Computes the surfaces of `regions`, which no solid cuts, and passes them to `take`. If the
    /// device fails, the CPU computes the remaining surfaces.
    fn contour_away_from_solids(
        &self,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
        meter: &Meter<'_>,
        take: &mut Take<'_>,
    ) -> io::Result<()> {
        let mut state = self.state();
        let mut taken = 0;
        while !state.on_cpu && taken < regions.len() && meter.goes_on() {
            let begin = taken;
            let mut take_counted = |meshes: Vec<Option<BlockMesh>>| {
                taken += meshes.len();
                meter.add(meshes.len());
                take(meshes)
            };
            let outcome = self.contour_batches(
                &mut state,
                surfaces,
                &regions[begin..],
                meter,
                &mut take_counted,
            );
            state.done.regions += taken - begin;
            match outcome {
                Ok(()) => {}
                Err(DeviceFrameError::Host(error)) => return Err(error),
                Err(DeviceFrameError::Device(error)) => self.recover(&mut state, &error),
            }
        }
        CpuStages::STAND_IN.contour(surfaces, &regions[taken..], meter, take)
    }
}
