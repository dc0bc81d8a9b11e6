//! One frame on a device from start to end, for programs whose particles are on the device. The
//! input is a buffer of positions; the outputs are buffers of vertices and indices.
//!
//! The caller can supply its own device ([`Device::adopt`]) and its own buffers
//! ([`Device::external_buffer`]). The documentation of these two functions states the caller's
//! obligations. The host reads neither the particles nor the mesh. It reads which parts of the DIF
//! are nonzero, to find the blocks that the surface can pass through. If the calibration is
//! measured on the frame, the host also reads a part of the DIF. The mesh is the same as that of
//! other backends, except that positions are rounded to f32.
//!
//! [`Device::adopt`]: crate::vulkan::Device::adopt
//! [`Device::external_buffer`]: crate::vulkan::Device::external_buffer

use crate::backend::{ResidentFrame, Surfaces, Vulkan};
use crate::brick::vulkan::{BinPipelines, DeviceBins, DeviceGrid, DevicePositions, bin};
use crate::brick::{Census, DifField, FrameFacts, InvalidParticles};
use crate::field::calibration::{
    BinnedFrame, Calibration, Fullness, MeasuredCalibration, indicate,
};
use crate::field::indicator::{IndicatorKind, PageRule, SampledDif};
use crate::grid::units::{Isovalue, MeanCount};
use crate::grid::{Domain, Grid};
use crate::surface::dual_mc::Normals;
use crate::surface::stitch::vulkan::{MeshLayout, StitchBuffers, StitchPipelines, stitch, table};
use crate::vulkan::{Batch, BufferKind, Device, Queue, SemaphorePoint, View, VulkanError};

use super::{FrameError, Surfacing};

/// Bytes of a vertex (three f32), and of a triangle (three u32).
const ROW: u64 = 12;

/// The parameters for sampling a frame and for extracting its surface.
#[derive(Debug, Clone)]
pub struct DeviceRequest {
    /// The grid of cells.
    pub grid: Grid,
    /// Walls, if the fluid is in a tank.
    pub domain: Option<Domain>,
    /// The indicator from which the field is computed.
    pub indicator: IndicatorKind,
    /// `mu0`, for counting; if `None`, it is measured on the frame.
    pub mean: Option<MeanCount>,
    /// Treatment of particles whose positions are not finite or too far from the grid's origin.
    pub invalid: InvalidParticles,
    /// The particles' spacing, in the unit of the positions; if `None`, it is assumed to be one
    /// cell.
    pub spacing: Option<f64>,
    /// The parameters of the surface; normals are not supported.
    pub surfacing: Surfacing,
    /// The calibration of another frame of the simulation; if `None`, it is measured on this frame,
    /// which takes longer.
    pub calibration: Option<Calibration>,
}

/// Semaphores that a call of [`Pipeline::surface_between`] waits for and signals, and buffers for
/// the surface. Empty by default.
#[derive(Debug, Clone, Copy, Default)]
pub struct Exchange<'a> {
    /// Semaphores to wait for before the positions are read. The device waits for them even if the
    /// call fails, so a second call must not wait for a binary semaphore again.
    pub wait: &'a [SemaphorePoint],
    /// Semaphores to signal when the surface is complete. The call may return before the device
    /// signals them. After an error, they are not signalled.
    pub signal: &'a [SemaphorePoint],
    /// Buffers for positions and indices, on the device of the pipeline.
    pub into: Option<[&'a View; 2]>,
}

/// A surface on the device. Its buffers can be bound as storage, vertex and index buffers, and live
/// as long as this object. Dropping this object waits until the buffers are written.
#[derive(Debug)]
pub struct ResidentSurface {
    /// The vertices' positions, three f32 each.
    pub positions: View,
    /// The number of vertices.
    pub vertices: u32,
    /// The triangles' vertices, three u32 each, counter-clockwise when seen from outside the fluid.
    pub indices: View,
    /// The number of triangles.
    pub triangles: u32,
    /// The isovalue of the surface: given, measured, or [`Isovalue::ZERO_DISTANCE`] for clouds.
    pub iso: Isovalue,
    /// The calibration of the surface, for the other frames of a simulation.
    pub calibration: Calibration,
    /// The values measured for the calibration; `None` if the caller supplied the calibration.
    pub measured: Option<MeasuredCalibration>,
    /// Counts of binned and skipped particles.
    pub census: Census,
    /// The last commands for this surface.
    work: Batch,
}

impl ResidentSurface {
    /// Waits until the buffers are written.
    ///
    /// # Errors
    /// [`VulkanError`] if the device fails.
    pub fn wait(&mut self) -> Result<(), VulkanError> {
        self.work.wait()
    }
}

/// All shaders from positions to a mesh, compiled once for all frames.
#[derive(Debug)]
pub struct Pipeline {
    vulkan: Vulkan,
    bin: BinPipelines,
    stitch: StitchPipelines,
    table: View,
}

impl Pipeline {
    /// Compiles all shaders for a device, which meniscus may have opened or adopted.
    ///
    /// # Errors
    /// [`VulkanError`] if the driver rejects a shader.
    pub fn new(device: &Device) -> Result<Self, VulkanError> {
        let mut batch = device.batch(Queue::Compute)?;
        batch.begin()?;
        let table = batch.store(&table())?;
        batch.submit(&[])?;
        batch.wait()?;
        Ok(Self {
            vulkan: Vulkan::new(device.clone())?,
            bin: BinPipelines::new(device)?,
            stitch: StitchPipelines::new(device)?,
            table,
        })
    }

    /// Frees the memory that is kept for the next frame. Finished surfaces stay valid.
    pub fn release(&self) {
        self.vulkan.release();
    }

    /// Runs `act`. If it runs out of memory, frees the memory that is kept for the next frame, and
    /// runs `act` again.
    fn with_room<T, E: Into<FrameError>>(
        &self,
        act: impl Fn() -> Result<T, E>,
    ) -> Result<T, FrameError> {
        match act().map_err(E::into) {
            Err(FrameError::Vulkan(VulkanError::OutOfMemory { .. })) => {
                self.release();
                act().map_err(E::into)
            }
            done => done,
        }
    }

    /// Makes the surface of the particles at `positions`, which may be in several buffers and are
    /// not changed.
    ///
    /// Returns when the device is done. Nothing else may write the positions during the call.
    ///
    /// # Errors
    /// [`FrameError`] for invalid particles, if there is no surface, or if the device fails.
    pub fn surface(
        &self,
        positions: &[DevicePositions],
        settings: &DeviceRequest,
    ) -> Result<ResidentSurface, FrameError> {
        // SAFETY: the default exchange has no semaphores, which are the only unsafe part.
        let mut surface =
            unsafe { self.surface_between(positions, settings, &Exchange::default()) }?;
        surface.wait()?;
        Ok(surface)
    }

    /// Makes the surface as a part of the caller's work on the device. The device waits for the
    /// semaphores `wait` of `exchange` before it reads the positions, and signals the semaphores
    /// `signal` when the surface is complete. The host waits for the intermediate results that it
    /// needs, but not for the last submission, which writes at most about four million triangles.
    ///
    /// # Errors
    /// The errors of [`surface`](Self::surface), and [`FrameError::NoSpace`], with the required
    /// size, if the caller's buffers are too small.
    ///
    /// # Panics
    /// If the caller's buffers are on another device.
    ///
    /// # Safety
    /// The semaphores must belong to the device, and must live until the device has waited for them
    /// or signalled them. The work that signals the semaphores in `wait` must have been submitted
    /// before the call.
    pub unsafe fn surface_between(
        &self,
        positions: &[DevicePositions],
        settings: &DeviceRequest,
        exchange: &Exchange<'_>,
    ) -> Result<ResidentSurface, FrameError> {
        let mut work = self.vulkan.device().batch(Queue::Compute)?;
        if !exchange.wait.is_empty() {
            work.begin()?;
            // All later work on the queue runs after this submission. SAFETY: the caller guarantees
            // the conditions on the semaphores.
            unsafe { work.submit_between(&[], exchange.wait, &[]) }?;
        }
        let &DeviceRequest { grid, domain, invalid, spacing, ref surfacing, calibration, .. } =
            settings;
        let (kind, mean) = (settings.indicator, settings.mean);
        let device = self.vulkan.device();
        let binned = || {
            bin(device, &self.bin, positions, &grid, domain.as_ref(), invalid, usize::MAX)
                .map_err(FrameError::from)
        };
        let bins = self.with_room(binned)?;
        let census = bins.census;
        if census.binned == 0 {
            return Err(FrameError::NoParticles(census));
        }
        let frame = self.vulkan.start_resident();
        let facts = FrameFacts { grid, domain, periodic: None, census, spacing };
        let side = kind.brick_side();
        let binned = ResidentBins { frame: &frame, bins };
        let (indicator, stored) = indicate(binned, &facts, kind, mean, side)?;
        let sampled = SampledDif::new(facts, indicator, stored);
        let (calibration, measured) = match calibration {
            Some(known) => (known, None),
            None => {
                // After a failed download, the measurement is meaningless, so the frame is checked
                // first.
                let measured = surfacing.calibrate(&sampled);
                frame.check()?;
                let measured = measured?;
                (measured.calibration, Some(measured))
            }
        };
        if !calibration.suits(kind) {
            return Err(FrameError::OtherIndicator);
        }
        let recipe = surfacing.recipe(&sampled, &calibration);
        let periodic_mesh = surfacing.periodic_mesh;
        let surfaces = Surfaces {
            sampled: &sampled,
            recipe: &recipe,
            solid: None,
            normals: Normals::None,
            periodic_mesh,
        };
        let parts = frame.contour(&surfaces)?;
        frame.check()?;
        if parts.blocks.is_empty() {
            return Err(FrameError::no_surface(&recipe, None));
        }

        let (iso, census) = (recipe.iso, census);
        // From here on, the memory of the field can be reused.
        drop((sampled, frame));
        let layout = MeshLayout::new(&parts.blocks).ok_or(FrameError::TooManyVertices)?;
        let written = parts.written().to_vec();
        let (vertices, triangles) = (layout.vertices(), layout.triangles());
        let [position_bytes, index_bytes] = [vertices, triangles].map(|rows| ROW * u64::from(rows));
        let [positions, indices] = match exchange.into {
            None => [
                self.with_room(|| device.buffer(BufferKind::Device, position_bytes))?.whole(),
                self.with_room(|| device.buffer(BufferKind::Device, index_bytes))?.whole(),
            ],
            Some([positions, indices]) => {
                if positions.bytes() < position_bytes || indices.bytes() < index_bytes {
                    return Err(FrameError::NoSpace { vertices, triangles });
                }
                [positions.part(0, position_bytes), indices.part(0, index_bytes)]
            }
        };
        work.begin()?;
        let buffers = StitchBuffers {
            grid: work.store(&[DeviceGrid::new(&grid, domain.as_ref())])?,
            blocks: work.store(layout.blocks())?,
            tiles: parts.tiles,
            ends: parts.ends,
            table: self.table.clone(),
            begins: self
                .with_room(|| device.buffer(BufferKind::Device, 8 * u64::from(layout.tiles())))?
                .whole(),
            positions: positions.clone(),
            indices: indices.clone(),
        };
        stitch(device, (&mut work, &written), &self.stitch, &layout, iso, &buffers)?;
        // SAFETY: the caller guarantees the conditions on the semaphores.
        unsafe { work.submit_between(&[], &[], exchange.signal) }?;
        Ok(ResidentSurface {
            positions,
            vertices,
            indices,
            triangles,
            iso,
            calibration,
            measured,
            census,
            work,
        })
    }
}

/// Particles on a device, sorted by bin.
struct ResidentBins<'a> {
    frame: &'a ResidentFrame,
    bins: DeviceBins,
}

impl BinnedFrame for ResidentBins<'_> {
    type Made = DifField;
    type Error = FrameError;

    fn make_pages(self, rule: &PageRule) -> Result<(Fullness, DifField), FrameError> {
        let field = self.frame.indicate(&self.bins, rule)?;
        let full =
            Fullness { particles: self.bins.census.binned as u64, cells: field.full_cells() };
        Ok((full, field))
    }
}
