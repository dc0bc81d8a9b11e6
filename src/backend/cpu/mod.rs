//! The stages on the processor's cores.

mod fields;
mod sizes;

pub use fields::field;
pub use sizes::SizedField;

use std::io;
use std::ops::Range;

use rayon::prelude::*;

use crate::brick::{Bins, Pages};
use crate::field::indicator::{PageRule, indicate};
use crate::grid::CellBox;
use crate::grid::units::MemoryBudget;
use crate::surface::dual_mc::{block_mesh, dual_cells};
use crate::surface::mesh::BlockMesh;
use crate::system::control::Meter;

use super::{BINS_A_THREAD, Executor, REGIONS_TOGETHER, Stages, Surfaces, Take, Work, parent};
use fields::cut_fields;

/// Divisor of a budget, for what all threads together may take to mesh neighbouring blocks in one
/// go.
const SHARE: u64 = 8;

/// The processor: all threads of the pool that a call is made in.
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
        let together = budget.0 / SHARE / rayon::current_num_threads() as u64;
        Box::new(CpuStages { together })
    }
}

/// The stages of a frame on the processor.
#[derive(Debug, Clone, Copy)]
pub(super) struct CpuStages {
    /// Bytes that a thread may take to mesh neighbouring blocks in one go; 0 meshes each block by
    /// itself.
    together: u64,
}

impl CpuStages {
    /// Stands in for a device that fails: meshes each block by itself, which takes the least
    /// memory.
    pub(super) const STAND_IN: Self = Self { together: 0 };
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
        let step = BINS_A_THREAD * rayon::current_num_threads();
        for first in range.clone().step_by(step) {
            meter.go_on()?;
            let together = first..range.end.min(first + step);
            pages.extend(indicate(bins, together.clone(), rule)?);
            meter.add(together.len());
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
        // Neighbours follow one another along the Morton curve.
        let near = |a: &CellBox, b: &CellBox| self.together > 0 && parent(a) == parent(b);
        let of_group = |group| meshes(surfaces, group, meter, self.together);
        regions.chunks(REGIONS_TOGETHER).try_for_each(|regions| {
            let groups: Vec<_> = regions.chunk_by(near).collect();
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

/// The surfaces through some regions, which share what they can where that takes so many bytes at
/// the most.
fn meshes(
    surfaces: &Surfaces<'_>,
    regions: &[CellBox],
    meter: &Meter<'_>,
    together: u64,
) -> Vec<Option<BlockMesh>> {
    if !meter.goes_on() {
        return regions.iter().map(|_| None).collect();
    }
    let &Surfaces { sampled, recipe, normals, .. } = surfaces;
    let walls = surfaces.mesh_walls();
    let away = |region: CellBox| walls.is_none_or(|walls| walls.covers(&dual_cells(region)));
    let solid =
        surfaces.solid.filter(|_| regions.iter().any(|&region| surfaces.is_at_solid(region)));
    // Fluid that is all around ends at a solid.
    let away = |region| solid.is_none() && away(region);
    let boxes: Vec<_> =
        regions.iter().map(|&region| (normals.cells(region), away(region))).collect();
    let mut fields = cut_fields(recipe, sampled, solid, &boxes, together);
    let mesh = |&region: &CellBox| {
        let field = fields.next().filter(|_| meter.goes_on()).flatten();
        meter.add(1);
        let mut field = field?;
        // Beyond a periodic face is what the filters have to see, and the mesh must not.
        let cut = walls.filter(|_| sampled.facts.periodic.is_some());
        cut.into_iter().for_each(|faces| field.repeat_edges(faces));
        block_mesh(&field, region, recipe.iso, normals, walls)
    };
    regions.iter().map(mesh).collect()
}
