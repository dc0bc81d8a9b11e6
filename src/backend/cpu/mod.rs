//! The stages on the processor's cores.

mod fields;

pub use fields::field;

use std::io;
use std::ops::Range;

use rayon::prelude::*;

use crate::brick::{Bins, Pages};
use crate::grid::CellBox;
use crate::mesh::BlockMesh;
use crate::stage::dual_mc::{block_mesh, dual_cells};
use crate::stage::indicator::{PageRule, indicate};
use crate::units::MemoryBudget;

use super::{Backend, Stages, Surfaces, Work};
use fields::cut_field;

/// All threads of the pool that a call is made in.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cpu;

impl Backend for Cpu {
    fn name(&self) -> String {
        format!("CPU, {} threads", rayon::current_num_threads())
    }

    fn divides(&self) -> bool {
        true
    }

    fn host_bytes(&self, _: MemoryBudget) -> u64 {
        0
    }

    fn start(&self, _: MemoryBudget) -> Box<dyn Stages> {
        Box::new(Self)
    }
}

impl Stages for Cpu {
    fn indicate(&self, bins: &Bins, range: Range<usize>, rule: &PageRule) -> io::Result<Pages> {
        indicate(bins, range, rule)
    }

    fn contour(&self, surfaces: &Surfaces<'_>, regions: &[CellBox]) -> Vec<Option<BlockMesh>> {
        regions.par_iter().map(|&region| mesh(surfaces, region)).collect()
    }

    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }

    fn on_device(&self) -> Work {
        Work::default()
    }
}

fn mesh(surfaces: &Surfaces<'_>, region: CellBox) -> Option<BlockMesh> {
    let &Surfaces { sampled, recipe, normals } = surfaces;
    let walls = surfaces.walls();
    let away_from_walls = walls.is_none_or(|walls| walls.covers(&dual_cells(region)));
    let field = cut_field(recipe, sampled, normals.cells(region), away_from_walls)?;
    block_mesh(&field, region, recipe.iso, normals, walls)
}
