//! Backends for the stages of a frame: the CPU or a Vulkan device. Both backends produce the same
//! bytes.

pub mod choice;
mod cpu;
mod vulkan;
mod wgsl;

pub use choice::Backend;
pub use cpu::{BoxSide, Cpu, SizedField, field};
pub use vulkan::{DeviceSurfaces, ResidentFrame, Vulkan};
pub use wgsl::wgsl_constants;

use std::fmt::Debug;
use std::io;
use std::ops::Range;
use std::sync::Arc;

use glam::IVec3;
use rayon::prelude::*;

use crate::brick::{Bins, DifField, Pages};
use crate::field::indicator::{PageRule, SampledDif};
use crate::field::recipe::{Filters, Recipe};
use crate::grid::units::MemoryBudget;
use crate::grid::{BLOCK, CellBox, Mirror, PeriodicMesh};
use crate::surface::dual_mc::{Normals, dual_cells};
use crate::surface::mesh::BlockMesh;
use crate::surface::solid::Solid;
use crate::system::control::Meter;
use crate::vulkan::Device;

/// The part of a [`Backend`] that is specific to the CPU or a device: it starts frames.
pub trait Executor: Debug + Send + Sync {
    /// Returns the name of the CPU or device, for display.
    fn name(&self) -> String;

    /// Returns the device; `None` for the CPU.
    fn device(&self) -> Option<&Device> {
        None
    }

    /// Whether several frames can be computed in parallel, each on a subset of the threads.
    fn divides(&self) -> bool;

    /// Additional bytes of the host's memory that a frame needs under `budget`.
    fn host_bytes(&self, budget: MemoryBudget) -> u64;

    /// Starts a frame. When the frame is dropped, its device memory is freed or kept for the next
    /// frame.
    fn start(&self, budget: MemoryBudget) -> Box<dyn Stages>;
}

/// The stages of one frame.
pub trait Stages: Debug + Send + Sync {
    /// Computes the field of all bins. The particles must be in memory. The field may stay on the
    /// device; the host then fetches samples on demand.
    fn field(&self, bins: &Arc<Bins>, rule: &PageRule, meter: &Meter<'_>) -> io::Result<DifField> {
        Ok(DifField::in_memory(
            rule.shape(),
            self.indicate(bins, 0..bins.keys().len(), rule, meter)?,
        ))
    }

    /// Computes the pages of a range of bins. `meter` counts the finished bins.
    ///
    /// # Errors
    /// If particles are in a scratch file that cannot be read, or if `meter` is cancelled.
    fn indicate(
        &self,
        bins: &Bins,
        range: Range<usize>,
        rule: &PageRule,
        meter: &Meter<'_>,
    ) -> io::Result<Pages>;

    /// Computes the surfaces of `regions`, and passes them to `take`, in order and in batches. A
    /// region without a surface gives `None`. A device computes later batches while `take` runs.
    /// `meter` counts the regions. After a cancel, the results must not be used.
    fn contour(
        &self,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
        meter: &Meter<'_>,
        take: &mut Take<'_>,
    ) -> io::Result<()>;

    /// Returns descriptions of the device failures so far. The work that failed was repeated with
    /// less device memory or on the CPU.
    fn warnings(&self) -> Vec<String>;

    /// Returns the work that a device has done so far; the CPU did all other work.
    fn on_device(&self) -> Work;
}

/// A callback that takes the surfaces of consecutive regions.
pub type Take<'a> = dyn FnMut(Vec<Option<BlockMesh>>) -> io::Result<()> + 'a;

/// Number of bins per CPU thread for which pages are computed between two checks for a cancel.
const BINS_PER_THREAD: usize = 64;

/// Maximum number of regions whose surfaces are passed to [`Take`] in one call.
pub const REGIONS_PER_CALL: usize = 1024;

/// The work done on a frame: the numbers of finished bins and regions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Number of bins whose pages were computed.
    pub pages: usize,
    /// Number of regions whose surfaces were computed, including empty surfaces.
    pub regions: usize,
}

/// A sampled frame and the recipe of its surface.
#[derive(Debug, Clone, Copy)]
pub struct Surfaces<'a> {
    /// The sampled frame.
    pub sampled: &'a SampledDif,
    /// The recipe that computes the field from the DIF of `sampled`.
    pub recipe: &'a Recipe,
    /// Solids that cut the field, if there are any.
    pub solid: Option<&'a Solid>,
    /// Whether vertices get normals.
    pub normals: Normals,
    /// How the mesh ends at periodic faces.
    pub periodic_mesh: PeriodicMesh,
}

impl Surfaces<'_> {
    /// The parts of blocks that the surface can pass through, in Morton order.
    pub fn regions(&self) -> Vec<CellBox> {
        // A dual cell extends one cell up from its lowest corner, so the lowest dual cells at a
        // wall begin one cell below the cells within the walls.
        let dif = &self.sampled.dif;
        let reach = dif.ghost_layer() + self.recipe.filters.reach();
        let walls = self.mesh_walls();
        let within = walls.map(|walls| walls.grown(1, 0));
        let cut = |cells: CellBox| within.map_or(cells, |within| cells.intersection(&within));
        // If the mesh ends at periodic faces, it has a surface at these faces, even deep in the
        // fluid.
        let faces = walls.filter(|_| self.sampled.facts.periodic.is_some());
        let not_inside = |cells: CellBox| match faces {
            Some(faces) if !faces.covers(&dual_cells(cells)) => cells,
            _ if self.is_at_solid(cells) => cells,
            _ => self.recipe.filters.not_inside(cells),
        };
        let regions = dif.regions(reach + 1, reach);
        let regions =
            regions.into_par_iter().map(cut).filter(|cells| !cells.is_empty()).map(not_inside);
        regions.filter(|cells| !cells.is_empty()).collect()
    }

    /// Whether a solid may affect the surface in `region`, because the solid overlaps the cells
    /// from which the region's field is computed.
    fn is_at_solid(&self, region: CellBox) -> bool {
        let Filters::Distances(distances) = &self.recipe.filters else { return false };
        let wide = distances.wide_cells(self.normals.cells(region));
        // The fluid ends at the distance `offset` from the solid, so the solid affects cells that
        // far away.
        let facts = &self.sampled.facts;
        let is_near = |solid: &&Solid| {
            let offset = solid.offset().abs() * facts.spacing_cells_or_one();
            let further = distances.widest_halo().max(offset.ceil() as i32) + 4;
            let around = wide.grown(further, further);
            solid.is_near(&facts.grid, facts.periodic.as_ref(), distances.level, around)
        };
        self.solid.filter(is_near).is_some()
    }

    /// Computes the wide cells from which samples are gathered. Without this call, several threads
    /// could compute the same wide cells at the same time.
    fn prepare(&self) {
        if let Filters::Distances(distances) = &self.recipe.filters {
            let _wide = self.sampled.wide(distances.level.max(distances.drops_level));
        }
    }

    /// The mirror at the walls of the field.
    fn mirror(&self) -> Option<Mirror> {
        self.sampled.facts.mirror(0)
    }

    /// The cells of the mesh: within walls and, for a cut mesh, between the periodic faces.
    fn mesh_walls(&self) -> Option<CellBox> {
        self.sampled.facts.mesh_walls(self.periodic_mesh).map(|walls| walls.cells())
    }
}

/// The cube of eight blocks that contains a region's block.
fn parent(region: &CellBox) -> IVec3 {
    region.lo.div_euclid(IVec3::splat(2 * BLOCK))
}
