//! The stages on the CPU.

mod fields;
mod sizes;
mod spray;

pub use fields::field;
pub use sizes::{BoxSide, SizedField};

use std::io;
use std::ops::Range;

use glam::IVec3;
use rayon::prelude::*;

use crate::brick::{Bins, Pages};
use crate::field::indicator::{PageRule, indicate};
use crate::grid::units::MemoryBudget;
use crate::grid::{BLOCK, CellBox, Mirror};
use crate::surface::dual_mc::{block_mesh, dual_cells};
use crate::surface::mesh::BlockMesh;
use crate::system::control::Meter;

use super::{BINS_PER_THREAD, Executor, REGIONS_PER_CALL, Stages, Surfaces, Take, Work};
use fields::cut_fields;
use spray::SprayMaker;

/// All threads together use at most 1 / `GROUP_SHARE` of the memory budget for meshing groups of
/// neighbouring blocks.
const GROUP_SHARE: u64 = 8;

/// Edge, in blocks, of the cubes of blocks that are meshed together. Spray has larger cubes than
/// other fluid.
const BLOCKS_OF_SPRAY: i32 = 8;
const BLOCKS_OF_FLUID: i32 = 2;

/// The CPU, with all threads of the caller's thread pool.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cpu;

impl Executor for Cpu {
    fn name(&self) -> String {
        format!("CPU, {} threads", rayon::current_num_threads())
    }

    fn divides(&self) -> bool {
        true
    }

    fn host_bytes(&self, _: MemoryBudget) -> u64 {
        0
    }

    fn start(&self, budget: MemoryBudget) -> Box<dyn Stages> {
        let group_bytes = budget.0 / GROUP_SHARE / rayon::current_num_threads() as u64;
        Box::new(CpuStages { group_bytes })
    }
}

/// The stages of a frame on the CPU.
#[derive(Debug, Clone, Copy)]
pub(super) struct CpuStages {
    /// Maximum number of bytes that each thread may take to mesh a group of neighbouring blocks; if
    /// 0, each block is meshed separately.
    group_bytes: u64,
}

impl CpuStages {
    /// The stages for work that a device cannot do. They mesh each block separately, which takes
    /// the least memory.
    pub(super) const STAND_IN: Self = Self { group_bytes: 0 };
}

impl Stages for CpuStages {
    fn indicate(
        &self,
        bins: &Bins,
        range: Range<usize>,
        rule: &PageRule,
        meter: &Meter<'_>,
    ) -> io::Result<Pages> {
        let mut pages = Pages::with_capacity(range.len());
        let step = BINS_PER_THREAD * rayon::current_num_threads();
        for first in range.clone().step_by(step) {
            meter.go_on()?;
            let batch = first..range.end.min(first + step);
            pages.extend(indicate(bins, batch.clone(), rule)?);
            meter.add(batch.len());
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
        let of_group = |RegionGroup { regions, spray }: RegionGroup<'_>| match spray {
            Some(spray) => meshes_of_spray(surfaces, regions, &spray, meter),
            None => meshes(surfaces, regions, meter, self.group_bytes),
        };
        regions.chunks(REGIONS_PER_CALL).try_for_each(|regions| {
            let groups = self.groups(surfaces, regions);
            take(groups.into_par_iter().flat_map_iter(of_group).collect())
        })
    }

    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }

    fn on_device(&self) -> Work {
        Work::default()
    }
}

/// Regions that are meshed together.
struct RegionGroup<'a> {
    regions: &'a [CellBox],
    /// Computes the fields of these regions if they are spray.
    spray: Option<SprayMaker<'a>>,
}

impl CpuStages {
    /// Splits regions into groups of neighbours. Regions of spray form larger groups than other
    /// regions.
    fn groups<'a>(
        &self,
        surfaces: &'a Surfaces<'_>,
        regions: &'a [CellBox],
    ) -> Vec<RegionGroup<'a>> {
        // Regions are in Morton order, so the regions in a cube of blocks are consecutive.
        let cubes = |blocks: i32| {
            let cube = move |region: &CellBox| region.lo.div_euclid(IVec3::splat(blocks * BLOCK));
            move |a: &CellBox, b: &CellBox| self.group_bytes > 0 && cube(a) == cube(b)
        };
        let spray = |regions: &'a [CellBox]| {
            let cells = regions.iter().map(|&region| surfaces.normals.cells(region));
            let cells = cells.fold(CellBox::EMPTY, |all, cells| all.union(&cells));
            let Surfaces { recipe, sampled, .. } = *surfaces;
            let spray = SprayMaker::new(recipe, sampled, cells, self.group_bytes)?;
            let at_solid = regions.iter().any(|&region| surfaces.is_at_solid(region));
            (!at_solid).then_some(RegionGroup { regions, spray: Some(spray) })
        };
        let cubes_of_spray: Vec<_> = regions.chunk_by(cubes(BLOCKS_OF_SPRAY)).collect();
        let groups = cubes_of_spray.into_par_iter().flat_map_iter(|regions| match spray(regions) {
            Some(group) => vec![group],
            None => {
                let cubes = regions.chunk_by(cubes(BLOCKS_OF_FLUID));
                cubes
                    .map(|regions| spray(regions).unwrap_or(RegionGroup { regions, spray: None }))
                    .collect()
            }
        });
        groups.collect()
    }
}

/// Computes the surfaces of `regions`, which are spray.
fn meshes_of_spray(
    surfaces: &Surfaces<'_>,
    regions: &[CellBox],
    spray: &SprayMaker<'_>,
    meter: &Meter<'_>,
) -> Vec<Option<BlockMesh>> {
    if !meter.goes_on() {
        return regions.iter().map(|_| None).collect();
    }
    let &Surfaces { sampled, recipe, normals, .. } = surfaces;
    let walls = surfaces.mesh_walls();
    let drops = spray.drops();
    let mesh = |&region: &CellBox| {
        meter.add(1);
        let mut field = spray::field(&drops, normals.cells(region), walls)?;
        let region = normals.region(field.cells());
        // The filters used cells beyond periodic faces. The mesh ends at the faces, so the field is
        // mirrored there.
        let cut = walls.filter(|_| sampled.facts.periodic.is_some());
        field.mirror(cut.map(Mirror::new));
        block_mesh(&field, region, recipe.iso, normals, walls)
    };
    regions.iter().map(mesh).collect()
}

/// Computes the surfaces of `regions`. The regions share intermediate results if this saves work,
/// and if the results fit into `most_bytes`.
fn meshes(
    surfaces: &Surfaces<'_>,
    regions: &[CellBox],
    meter: &Meter<'_>,
    most_bytes: u64,
) -> Vec<Option<BlockMesh>> {
    if !meter.goes_on() {
        return regions.iter().map(|_| None).collect();
    }
    let &Surfaces { sampled, recipe, normals, .. } = surfaces;
    let walls = surfaces.mesh_walls();
    let away = |region: CellBox| walls.is_none_or(|walls| walls.covers(&dual_cells(region)));
    let solid =
        surfaces.solid.filter(|_| regions.iter().any(|&region| surfaces.is_at_solid(region)));
    // A solid cuts the field, so a block at a solid may have a surface even if all of its cells are
    // inside the fluid.
    let away = |region| solid.is_none() && away(region);
    let boxes: Vec<_> =
        regions.iter().map(|&region| (normals.cells(region), away(region))).collect();
    let mut fields = cut_fields(recipe, sampled, solid, &boxes, most_bytes);
    let mesh = |&region: &CellBox| {
        let field = fields.next().filter(|_| meter.goes_on()).flatten();
        meter.add(1);
        let mut field = field?;
        // The filters used cells beyond periodic faces. The mesh ends at the faces, so the field is
        // mirrored there.
        let cut = walls.filter(|_| sampled.facts.periodic.is_some());
        field.mirror(cut.map(Mirror::new));
        block_mesh(&field, region, recipe.iso, normals, walls)
    };
    regions.iter().map(mesh).collect()
}
