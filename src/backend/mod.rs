//! Backends for the stages of a frame: the processor's cores, or a Vulkan device. Both give the
//! same bytes.

pub mod choice;
mod cpu;
mod vulkan;
mod wgsl;

pub use choice::Backend;
pub use cpu::{Cpu, SizedField, field};
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
use crate::grid::{BLOCK, CellBox, PeriodicMesh};
use crate::surface::dual_mc::{Normals, dual_cells};
use crate::surface::mesh::BlockMesh;
use crate::surface::solid::Solid;
use crate::system::control::Meter;
use crate::vulkan::Device;

/// Starts frames on the processor or a device: the part of a [`Backend`] that differs between them.
pub trait Executor: Debug + Send + Sync {
    /// Returns the name of the processor or device, for people.
    fn name(&self) -> String;

    /// Returns the device, unless frames run on the processor.
    fn device(&self) -> Option<&Device> {
        None
    }

    /// Whether frames can be computed side by side, each by a share of the threads.
    fn divides(&self) -> bool;

    /// Bytes of the host's memory that a frame takes under `budget`, besides what every frame
    /// takes.
    fn host_bytes(&self, budget: MemoryBudget) -> u64;

    /// Starts a frame. What it keeps on a device goes with it.
    fn start(&self, budget: MemoryBudget) -> Box<dyn Stages>;
}

/// The stages of one frame.
pub trait Stages: Debug + Send + Sync {
    /// The field of all bins, whose particles are in memory. It may stay where it was made: what
    /// the host wants of it comes when it does.
    fn field(&self, bins: &Arc<Bins>, rule: &PageRule, meter: &Meter<'_>) -> io::Result<DifField> {
        Ok(DifField::in_memory(
            rule.shape(),
            self.indicate(bins, 0..bins.keys().len(), rule, meter)?,
        ))
    }

    /// The pages of a range of bins, which `meter` counts.
    ///
    /// # Errors
    /// Where particles are in a scratch file that cannot be read, and where `meter` does not go on.
    fn indicate(
        &self,
        bins: &Bins,
        range: Range<usize>,
        rule: &PageRule,
        meter: &Meter<'_>,
    ) -> io::Result<Pages>;

    /// The surfaces through some regions of blocks, each `None` where there is none: `take` takes
    /// them in order, in the batches in which they are made, while others are in progress. `meter`
    /// counts the regions; once it does not go on, what is taken is worth nothing.
    fn contour(
        &self,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
        meter: &Meter<'_>,
        take: &mut Take<'_>,
    ) -> io::Result<()>;

    /// Failures so far that were made good.
    fn warnings(&self) -> Vec<String>;

    /// How much of the work so far a device did: all of it, unless the processor had to stand in
    /// for one, or there is none.
    fn on_device(&self) -> Work;
}

/// Takes the surfaces of regions that follow one another.
pub type Take<'a> = dyn FnMut(Vec<Option<BlockMesh>>) -> io::Result<()> + 'a;

/// Bins that each thread of the processor makes pages of between two looks at whether to go on.
const BINS_A_THREAD: usize = 64;

/// Regions whose surfaces are handed on together, at the most.
pub const REGIONS_TOGETHER: usize = 1024;

/// An amount of a frame's work: bins and regions that were done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Bins that got their pages.
    pub pages: usize,
    /// Regions that got their surfaces, if they have any.
    pub regions: usize,
}

/// A sampled frame and the recipe of its surface.
#[derive(Debug, Clone, Copy)]
pub struct Surfaces<'a> {
    /// The frame.
    pub sampled: &'a SampledDif,
    /// From its DIF to the field.
    pub recipe: &'a Recipe,
    /// Solids that cut the field, if there are any.
    pub solid: Option<&'a Solid>,
    /// Whether vertices get normals.
    pub normals: Normals,
    /// Where the mesh ends at periodic faces.
    pub periodic_mesh: PeriodicMesh,
}

impl Surfaces<'_> {
    /// The parts of blocks in which dual cells can be mixed, in Morton order.
    pub fn regions(&self) -> Vec<CellBox> {
        // A dual cell reaches one cell up from its lowest corner.
        let dif = &self.sampled.dif;
        let reach = dif.ghost_layer() + self.recipe.filters.reach();
        let walls = self.mesh_walls();
        let within = walls.map(|walls| walls.grown(1, 0));
        let cut = |cells: CellBox| within.map_or(cells, |within| cells.intersection(&within));
        // Behind a face that cuts it, a fluid is deep however near that is.
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

    /// Whether a solid may decide the surface through a region: it is among the cells that its
    /// field is made of.
    fn is_at_solid(&self, region: CellBox) -> bool {
        let Filters::Distances(distances) = &self.recipe.filters else { return false };
        let wide = distances.wide_cells(self.normals.cells(region));
        // Beyond a solid that fills, fluid ends as far away as it is offset.
        let facts = &self.sampled.facts;
        let is_near = |solid: &&Solid| {
            let offset = solid.offset().abs() * facts.spacing_cells_or_one();
            let further = distances.wide_halo().max(offset.ceil() as i32) + 4;
            solid.is_near(&facts.grid, distances.level, wide.grown(further, further))
        };
        self.solid.filter(is_near).is_some()
    }

    /// Has all fields made that samples are cut out of.
    fn prepare(&self) {
        if let Filters::Distances(distances) = &self.recipe.filters {
            let _made = self.sampled.wide(distances.level.max(distances.drops_level));
        }
    }

    /// The cells within walls, beyond which the field repeats its edge cells.
    fn walls(&self) -> Option<CellBox> {
        self.sampled.facts.walls()
    }

    /// The cells of which a surface is drawn: within walls, and between the periodic faces that cut
    /// it.
    fn mesh_walls(&self) -> Option<CellBox> {
        self.sampled.facts.mesh_walls(self.periodic_mesh).map(|walls| walls.cells())
    }
}

/// Where the eight blocks are of which a region's is one.
fn parent(region: &CellBox) -> IVec3 {
    region.lo.div_euclid(IVec3::splat(2 * BLOCK))
}
