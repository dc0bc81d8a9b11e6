//! The stages on the processor's cores.

use std::io;
use std::ops::Range;

use rayon::prelude::*;

use crate::brick::{Bins, Pages};
use crate::grid::CellBox;
use crate::mesh::BlockMesh;
use crate::stage::dual_mc::{Normals, contour, normals};
use crate::stage::indicator::{PageRule, indicate};
use crate::units::MemoryBudget;

use super::{Backend, Stages, Surfaces, Work};

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
        regions.par_iter().map(|&region| block_mesh(surfaces, region)).collect()
    }

    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }

    fn on_device(&self) -> Work {
        Work::default()
    }
}

fn block_mesh(surfaces: &Surfaces<'_>, region: CellBox) -> Option<BlockMesh> {
    let &Surfaces { dif, recipe, domain, .. } = surfaces;
    let walls = surfaces.walls();
    let dif = recipe.gather(dif, surfaces.field(region), domain);
    let away_from_walls = walls.is_none_or(|walls| walls.covers(&surfaces.dual(region)));
    let field = recipe.cut_field(dif, domain, away_from_walls)?;
    let mut mesh = contour(&field, region, recipe.iso, walls);
    if mesh.tiles.is_empty() {
        return None;
    }
    if surfaces.normals == Normals::Gradient {
        mesh.normals = normals(&field, &mesh, recipe.iso.into(), walls);
    }
    Some(mesh)
}
