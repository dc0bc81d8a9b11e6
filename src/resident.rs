//! One frame on a device from end to end, for programs whose particles are there already: a buffer of positions
//! in, buffers of vertices and indices out.
//!
//! The device can be a caller's own ([`Device::adopt`]), and so can the buffer ([`Device::foreign_buffer`]): those two
//! calls state what the caller must hold to, everything here is safe. The host sees the DIF, to measure the isovalue
//! and to find the blocks that the surface can pass through, and neither the particles nor the mesh. The mesh is that
//! of the other backends, with positions rounded to f32.
//!
//! [`Device::adopt`]: crate::vulkan::Device::adopt
//! [`Device::foreign_buffer`]: crate::vulkan::Device::foreign_buffer

use std::sync::Arc;

use thiserror::Error;

use crate::backend::{ResidentFrame, Surfaces, Vulkan};
use crate::brick::vulkan::{BinKernels, DeviceBinError, DeviceGrid, DevicePositions, bin};
use crate::brick::{BinError, Census, DifField, InvalidParticles, sampled_bins};
use crate::grid::{Domain, Grid};
use crate::plateau::{self, Plateau, SampledDif, TooFine};
use crate::stage::detail::Detail;
use crate::stage::dual_mc::Normals;
use crate::stage::indicator::{Indicator, PageRule};
use crate::stitch::vulkan::{MeshLayout, StitchBuffers, StitchKernels, stitch, table};
use crate::units::{Isovalue, Sigma, UnitError};
use crate::vulkan::{Buffer, Device, Place, Queue, View, VulkanError};

/// Bytes of a vertex, three f32, and of a triangle, three u32.
const ROW: u64 = 12;

/// How a frame is sampled, and how a surface is drawn through it.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Cells.
    pub grid: Grid,
    /// Walls, if the fluid is in a tank.
    pub domain: Option<Domain>,
    /// The DIF.
    pub indicator: Indicator,
    /// What to do with particles that are not finite or too far away.
    pub invalid: InvalidParticles,
    /// The particles' spacing, in the unit of the positions; a cell's edge where it is not known.
    pub spacing: Option<f64>,
    /// The Gaussian's width.
    pub sigma: Sigma,
    /// Section 6.2, or not.
    pub detail: Detail,
    /// The isovalue; a share of the frame's plateau where it is `None`.
    pub iso: Option<Isovalue>,
}

/// A surface on the device. Its buffers can be bound as storage, vertex and index buffers, and live as long as this.
#[derive(Debug)]
pub struct ResidentSurface {
    /// Three f32 a vertex.
    pub positions: Arc<Buffer>,
    /// How many vertices there are.
    pub vertices: u32,
    /// Three u32 a triangle, counter-clockwise seen from outside of the fluid.
    pub indices: Arc<Buffer>,
    /// How many triangles there are.
    pub triangles: u32,
    /// Given or measured.
    pub iso: Isovalue,
    /// The field's interior, measured whether or not the isovalue was given.
    pub plateau: Plateau,
    /// What became of the particles.
    pub census: Census,
}

/// Why there is no surface.
#[derive(Debug, Error)]
pub enum ResidentError {
    /// There is nothing to build a surface from.
    #[error("no particle can be binned: {0:?}")]
    NoParticles(Census),
    /// A particle that the grid cannot hold.
    #[error(transparent)]
    Bin(#[from] BinError),
    /// mu0 could not be measured.
    #[error("cannot measure mu0 on this frame: {0}")]
    MeanCount(#[source] UnitError),
    /// The field does not tell finely enough where the surface is.
    #[error(transparent)]
    TooFine(#[from] TooFine),
    /// The field exceeds the isovalue nowhere.
    #[error("the surface is empty: the field is nowhere above the isovalue {:.4}", .0.value())]
    NoSurface(Isovalue),
    /// 32 bits cannot number its vertices.
    #[error("the surface has more vertices or triangles than 32 bits can number; use a larger cell size")]
    TooManyVertices,
    /// The device failed, or has not enough memory.
    #[error(transparent)]
    Vulkan(#[from] VulkanError),
}

impl From<DeviceBinError> for ResidentError {
    fn from(error: DeviceBinError) -> Self {
        match error {
            DeviceBinError::Bin(error) => Self::Bin(error),
            DeviceBinError::Vulkan(error) => Self::Vulkan(error),
        }
    }
}

/// All kernels from positions to a mesh, compiled once for all frames.
#[derive(Debug)]
pub struct Pipeline {
    vulkan: Vulkan,
    bin: BinKernels,
    stitch: StitchKernels,
    table: View,
}

impl Pipeline {
    /// For a device, opened here or adopted.
    ///
    /// # Errors
    /// [`VulkanError`] where the driver refuses a kernel.
    pub fn new(device: &Device) -> Result<Self, VulkanError> {
        Ok(Self {
            vulkan: Vulkan::new(device.clone())?,
            bin: BinKernels::new(device)?,
            stitch: StitchKernels::new(device)?,
            table: device.uploaded(&table())?,
        })
    }

    /// The surface of the particles at `positions`, which may be in several buffers and are not changed.
    ///
    /// Returns when the device is done. Nothing else may write the positions during the call.
    ///
    /// # Errors
    /// [`ResidentError`].
    pub fn surface(
        &self,
        positions: &[DevicePositions],
        settings: &Settings,
    ) -> Result<ResidentSurface, ResidentError> {
        let Settings { grid, domain, indicator, invalid, spacing, sigma, detail, iso } = settings;
        let (domain, device) = (domain.as_ref(), self.vulkan.device());
        let bins = bin(device, &self.bin, positions, grid, domain, *invalid, usize::MAX)?;
        let census = bins.census;
        if census.binned == 0 {
            return Err(ResidentError::NoParticles(census));
        }
        let frame = self.vulkan.start_resident();
        let side = indicator.brick_side();
        let walls = domain.map(Domain::cells);
        let stored = |frame: &ResidentFrame, indicator: Indicator| {
            let pages = frame.indicate(&bins, &PageRule { indicator, side, walls })?;
            Ok::<_, VulkanError>(DifField::in_memory(indicator.shape(side), pages))
        };
        let measured = |indicator: Indicator, full_cells: u64| {
            indicator.measured(census.binned, full_cells).map_err(ResidentError::MeanCount)
        };
        let mut indicator = *indicator;
        if indicator.waits_for_mean() {
            // All are counted, but those tell that tell on the host.
            let counted = stored(&self.vulkan.start_resident(), Indicator::Counting { mean: None })?;
            debug_assert_eq!(counted.infos().len(), bins.keys.len(), "every bin has a page");
            let full_cells =
                |(bin, weight): (usize, f64)| weight * f64::from(counted.infos()[bin].full_count);
            let full_cells: f64 = sampled_bins(&bins.first).into_iter().map(full_cells).sum();
            indicator = measured(indicator, full_cells.round() as u64)?;
        }
        let stored = stored(&frame, indicator)?;
        drop(bins);
        let indicator = measured(indicator, stored.full_cells())?;
        let dif = indicator.decode(stored);
        let spacing = spacing.map(|spacing| spacing / grid.cell_size());
        let sampled = SampledDif { dif: &dif, indicator, domain, spacing };
        let (recipe, plateau) = plateau::recipe(&sampled, grid, *sigma, *detail, *iso)?;
        let surfaces = Surfaces { dif: &dif, recipe: &recipe, domain, normals: Normals::None };
        let parts = frame.contour(&surfaces)?;
        if parts.blocks.is_empty() {
            return Err(ResidentError::NoSurface(recipe.iso));
        }

        let layout = MeshLayout::new(&parts.blocks).ok_or(ResidentError::TooManyVertices)?;
        let rows = |count: u32| device.buffer(Place::Device, ROW * u64::from(count));
        let (positions, indices) = (rows(layout.vertices())?, rows(layout.triangles())?);
        let buffers = StitchBuffers {
            grid: device.uploaded(&[DeviceGrid::new(grid, domain)])?,
            blocks: device.uploaded(layout.blocks())?,
            tiles: parts.tiles,
            ends: parts.ends,
            table: self.table.clone(),
            begins: device.buffer(Place::Device, 8 * u64::from(layout.tiles()))?.whole(),
            positions: positions.whole(),
            indices: indices.whole(),
        };
        let mut batch = device.batch(Queue::Compute)?;
        batch.begin()?;
        batch.stage("stitch", positions.bytes() + indices.bytes());
        stitch(device, &mut batch, &self.stitch, &layout, recipe.iso, &buffers)?;
        batch.submit(&[])?;
        batch.wait()?;
        Ok(ResidentSurface {
            positions,
            vertices: layout.vertices(),
            indices,
            triangles: layout.triangles(),
            iso: recipe.iso,
            plateau,
            census,
        })
    }
}
