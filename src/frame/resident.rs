//! One frame on a device from end to end, for programs whose particles are there already: a buffer
//! of positions in, buffers of vertices and indices out.
//!
//! The device can be a caller's own ([`Device::adopt`]), and so can the buffer
//! ([`Device::external_buffer`]): those two calls state what the caller must hold to, everything
//! here is safe. The host sees where the DIF is not 0, to find the blocks that the surface can pass
//! through, and of the frame that it calibrates on a part of it; neither the particles nor the
//! mesh. The mesh is that of the other backends, with positions rounded to f32.
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

/// Bytes of a vertex, three f32, and of a triangle, three u32.
const ROW: u64 = 12;

/// How a frame is sampled, and how a surface is drawn through it.
#[derive(Debug, Clone)]
pub struct DeviceRequest {
    /// The grid of cells.
    pub grid: Grid,
    /// Walls, if the fluid is in a tank.
    pub domain: Option<Domain>,
    /// The indicator that makes the field.
    pub indicator: IndicatorKind,
    /// `mu0`, for counting; measured on the frame where it is `None`.
    pub mean: Option<MeanCount>,
    /// Treatment of particles that are not finite or too far away.
    pub invalid: InvalidParticles,
    /// The particles' spacing, in the unit of the positions; a cell's edge where it is not known.
    pub spacing: Option<f64>,
    /// How the surface is drawn; normals are not made.
    pub surfacing: Surfacing,
    /// The calibration of another frame of the simulation; measured on this one where it is `None`,
    /// which takes longer.
    pub calibration: Option<Calibration>,
}

/// Semaphores that a call waits for and signals, and buffers that the surface goes to. By default
/// none.
#[derive(Debug, Clone, Copy, Default)]
pub struct Exchange<'a> {
    /// Moments from which on the positions are there. Passed whatever the call returns: one that is
    /// made again has nothing to wait for.
    pub wait: &'a [SemaphorePoint],
    /// Moments that are signalled when the surface is there: the call does not wait for that. Not
    /// signalled after an error.
    pub signal: &'a [SemaphorePoint],
    /// Buffers for positions and indices, of the device that the pipeline is of.
    pub into: Option<[&'a View; 2]>,
}

/// A surface on the device. Its buffers can be bound as storage, vertex and index buffers, and live
/// as long as this, which when it is dropped waits until they are written.
#[derive(Debug)]
pub struct ResidentSurface {
    /// The vertices' positions, three f32 each.
    pub positions: View,
    /// The number of vertices.
    pub vertices: u32,
    /// The triangles' vertices, three u32 each, counter-clockwise seen from outside of the fluid.
    pub indices: View,
    /// The number of triangles.
    pub triangles: u32,
    /// The isovalue, at which the surface is drawn: given, measured, or [`Isovalue::NO_DISTANCE`]
    /// for clouds.
    pub iso: Isovalue,
    /// The calibration that it was drawn by, for the other frames of a simulation.
    pub calibration: Calibration,
    /// The measurements for that, unless it was given.
    pub measured: Option<MeasuredCalibration>,
    /// Counts of particles, by what became of them.
    pub census: Census,
    /// The last work on it.
    work: Batch,
}

impl ResidentSurface {
    /// Waits until its buffers are written.
    ///
    /// # Errors
    /// Those of the device.
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
    /// Compiles all shaders for a device, opened here or adopted.
    ///
    /// # Errors
    /// [`VulkanError`] where the driver refuses a shader.
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

    /// Gives back the memory that is kept for the next frame. What was drawn stays.
    pub fn release(&self) {
        self.vulkan.release();
    }

    /// Does something, and again without what is kept for the next frame where there is no memory
    /// for it beside that.
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

    /// The surface of the particles at `positions`, which may be in several buffers and are not
    /// changed.
    ///
    /// Returns when the device is done. Nothing else may write the positions during the call.
    ///
    /// # Errors
    /// [`FrameError`].
    pub fn surface(
        &self,
        positions: &[DevicePositions],
        settings: &DeviceRequest,
    ) -> Result<ResidentSurface, FrameError> {
        // SAFETY: there is no semaphore.
        let mut surface =
            unsafe { self.surface_between(positions, settings, &Exchange::default()) }?;
        surface.wait()?;
        Ok(surface)
    }

    /// Draws the surface in the course of what else the device does: on the device it waits for the
    /// positions, and tells when the surface is there. The host waits meanwhile for what it has to
    /// know to go on, but not for the last triangles, some four million at the most.
    ///
    /// # Errors
    /// [`FrameError`]; [`FrameError::NoSpace`] where the caller's buffers are too small, and says
    /// what is needed.
    ///
    /// # Panics
    /// If the caller's buffers are of another device.
    ///
    /// # Safety
    /// The semaphores are the device's, and alive until the device has passed them. What is waited
    /// for is submitted already.
    pub unsafe fn surface_between(
        &self,
        positions: &[DevicePositions],
        settings: &DeviceRequest,
        exchange: &Exchange<'_>,
    ) -> Result<ResidentSurface, FrameError> {
        let mut work = self.vulkan.device().batch(Queue::Compute)?;
        if !exchange.wait.is_empty() {
            work.begin()?;
            // All that follows on the queue comes after it.
            // SAFETY: the caller vouches for the semaphores.
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
                // What did not come makes no measurement.
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
            return Err(FrameError::no_surface(&recipe));
        }

        let (iso, census) = (recipe.iso, census);
        // What the field took can be given back.
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
        // SAFETY: the caller vouches for the semaphores.
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

/// Particles in order of their bins on a device.
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
