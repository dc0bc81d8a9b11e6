//! The field of spray, computed drop by drop and only around the surface of each drop.

use std::rc::Rc;

use glam::IVec3;

use crate::brick::Block;
use crate::field::distance::{DistanceFilters, wide_cells};
use crate::field::indicator::SampledDif;
use crate::field::recipe::{
    Fields, Filters, Recipe, ThinShares, WideFields, bulk, sheets, with_drops,
};
use crate::grid::{CellBox, TILE};

use super::fields::{BlockField, Blocks, FieldUse, refined_from, wide_volume};

/// In spray, the boxes around full cells take at most 1 / `SPARSE_RATIO` of the volume.
const SPARSE_RATIO: usize = 16;
/// The cost of a wide cell of other fluid, as a multiple of the cost of a wide cell within reach of
/// a drop.
const COST_RATIO: usize = 10;

/// Number of cells around the inside of a drop for which the drop's field is needed: a vertex lies
/// between an inside cell and its neighbour, and normals need one more cell.
const AROUND: i32 = 2;

/// The field around the surface of a group of particles, which may be several drops.
pub(super) struct DropField {
    /// A box around the cells that are inside the fluid.
    inside: CellBox,
    /// The field on the box `inside` and the cells around it.
    field: Block,
}

/// Computes the field of spray, one group of particles at a time.
pub(super) struct SprayMaker<'a> {
    recipe: &'a Recipe,
    distances: &'a DistanceFilters,
    sampled: &'a SampledDif,
    /// The requested cells.
    cells: CellBox,
    /// For each group of particles that can have a surface in `cells`, a box around its full cells.
    groups: Vec<CellBox>,
}

/// Joins `drops` into one field, on the part of `cells` in which dual cells can have a surface;
/// `None` if there is no surface. Like `cells`, this part consists of whole tiles. If `walls` do
/// not cover `cells`, the part is all of `cells`.
pub(super) fn field(drops: &[DropField], cells: CellBox, walls: Option<CellBox>) -> Option<Block> {
    let inside = drops.iter().map(|drop| drop.inside.intersection(&cells));
    let inside = inside.filter(|inside| !inside.is_empty());
    let inside = inside.fold(CellBox::EMPTY, |all, inside| all.union(&inside));
    if inside.is_empty() {
        return None;
    }
    let tiles = IVec3::splat(TILE);
    let near = inside.grown(AROUND + 1, AROUND + 1).intersection(&cells);
    let part = CellBox {
        lo: cells.lo + (near.lo - cells.lo) / tiles * tiles,
        hi: cells.hi - (cells.hi - near.hi) / tiles * tiles,
    };
    let covered = walls.is_none_or(|walls| walls.covers(&cells));
    let mut field = Block::zero(if covered { part } else { cells });
    for DropField { field: drop, .. } in drops {
        let part = drop.cells().intersection(&field.cells());
        if !part.is_empty() {
            field.put_part(part, drop.cells(), drop.samples(), |_, sample| sample);
        }
    }
    Some(field)
}

/// The wide fields around a group, and the blocks that compute finer fields from them.
struct NearGroup<'a> {
    bulk: BlockField,
    outlying: BlockField,
    blocks: Blocks<'a>,
}

impl<'a> SprayMaker<'a> {
    /// Prepares the field on `cells`; `None` if the fluid is not spray, if computing the whole
    /// field is cheaper than computing it group by group, or if the fields of the groups need more
    /// than `most_bytes`.
    pub(super) fn new(
        recipe: &'a Recipe,
        sampled: &'a SampledDif,
        cells: CellBox,
        most_bytes: u64,
    ) -> Option<Self> {
        let Filters::Distances(distances) = &recipe.filters else { return None };
        if SPARSE_RATIO * sampled.dif.full_volume(cells) > cells.volume() {
            return None;
        }
        let reach = reach(distances, sampled);
        let around = |full: CellBox| full.grown(reach, reach);
        let mut groups = sampled.dif.groups_near(cells, reach);
        groups.retain(|&full| !around(full).intersection(&cells).is_empty());
        let cost = |&full: &CellBox| {
            let volume = wide_volume(distances, around(full));
            let sparse = SPARSE_RATIO * distances.wide_cells(full).volume() <= volume;
            if sparse { volume / COST_RATIO } else { volume }
        };
        let is_cheaper = groups.iter().map(cost).sum::<usize>() <= wide_volume(distances, cells);
        let bytes: usize =
            groups.iter().map(|&full| around(full).volume() * size_of::<u16>()).sum();
        let fits = bytes as u64 <= most_bytes;
        (is_cheaper && fits).then_some(Self { recipe, distances, sampled, cells, groups })
    }

    /// Computes the fields of all groups that have a surface.
    pub(super) fn drops(&self) -> Vec<DropField> {
        let least = self.distances.drops.least_share();
        self.groups.iter().filter_map(|&full| self.drops_of(full, least)).collect()
    }

    /// Computes the field of the group whose full cells lie in the box `full`; `None` if the group
    /// has no surface. A cell is in a drop if its share is at least `least`.
    fn drops_of(&self, full: CellBox, least: u16) -> Option<DropField> {
        let Self { recipe, distances, sampled, .. } = *self;
        let DistanceFilters { level, stands_out, drops_level, ref drops, .. } = *distances;
        let near = self.near_particles(full)?;
        let cells = near.intersection(&self.cells);
        if cells.is_empty() {
            return None;
        }
        let around = near.grown(AROUND, AROUND).intersection(&self.cells);
        let NearGroup { bulk, outlying, mut blocks } = self.near_group(around)?;
        let threshold = recipe.iso.threshold();
        let mut inside = refined_from(level, bulk.block.box_of(|sample| sample > threshold));
        let (mut thin, mut standing_out) = (None, CellBox::EMPTY);
        if blocks.narrowed(&outlying, level, stands_out.begin()) {
            standing_out = blocks.wanted;
            let sheets = sheets(distances, &mut blocks).ok()?;
            if sheets.is_none() {
                // Without sheets, only the drops of this group's particles are computed here. The 2
                // consists of one cell for clouds and one for interpolation.
                let reach = (drops.spread.reach() + 2) << drops_level;
                blocks.wanted = standing_out.intersection(&full.grown(reach, reach));
            }
            if !blocks.wanted.is_empty() {
                thin = with_drops(distances, &mut blocks, sheets).ok();
            }
        }
        if let Some(ThinShares { shares, .. }) = &thin {
            let shown = shares.block.box_of(|share| share >= least);
            inside = inside.union(&refined_from(drops_level, shown));
        }
        inside = inside.intersection(&cells);
        if inside.is_empty() {
            return None;
        }
        // At walls, the field is computed on all of `around`, which includes the cells whose mirror
        // images are needed.
        let covered = sampled.facts.walls().is_none_or(|walls| walls.covers(&around));
        let part =
            if covered { inside.grown(AROUND, AROUND).intersection(&around) } else { around };
        blocks.wanted = part;
        let mut field = blocks.refined(bulk, 0).ok()?;
        blocks.wanted = part.intersection(&standing_out);
        if !blocks.wanted.is_empty() {
            let needed = wide_cells(drops_level, blocks.wanted);
            // Without sheets, the shares were computed only around the group's own drops. If the
            // bulk has a surface farther away, they are computed again for all needed cells.
            let large_enough = thin.filter(|thin| thin.shares.block.cells().covers(&needed));
            let thin = large_enough.map_or_else(|| with_drops(distances, &mut blocks, None), Ok);
            let ThinShares { shares, certainty } = thin.ok()?;
            let near = blocks.refined(outlying, 0).ok()?;
            let shares = blocks.refined(shares, 0).ok()?;
            let certainty =
                certainty.map(|certainty| blocks.refined(certainty, 0)).transpose().ok()?;
            let thin = ThinShares { shares, certainty };
            field = blocks.joined(field, near, thin, (drops, &stands_out)).ok()?;
        }
        Some(DropField { inside, field: Rc::unwrap_or_clone(field.block) })
    }

    /// A box of the cells within reach of a group's particles; at walls, a larger box. The group
    /// can add only cells of this box to the inside of the fluid. `None` if the group has no
    /// particles.
    fn near_particles(&self, full: CellBox) -> Option<CellBox> {
        let DistanceFilters { level, near, least, .. } = *self.distances;
        // Clouds at the faces of a bin reach into the ghost layer around the bin.
        let ghosts = self.sampled.dif.ghost_layer();
        let around = self.distances.wide_cells(full.grown(ghosts, ghosts));
        let clouds = self.sampled.wide(level).gather(around);
        let particles = clouds.box_of(|sample| sample >= least);
        if particles.is_empty() {
            return None;
        }
        let cells = refined_from(level, particles.grown(near, near));
        let covered = |walls: CellBox| walls.covers(&cells.grown(AROUND, AROUND));
        if self.sampled.facts.walls().is_none_or(covered) {
            return Some(cells);
        }
        let reach = reach(self.distances, self.sampled);
        Some(full.grown(reach, reach))
    }

    /// Computes the wide fields around `cells`; `None` if no particle is near.
    fn near_group(&self, cells: CellBox) -> Option<NearGroup<'a>> {
        let Self { recipe, distances, sampled, .. } = *self;
        let DistanceFilters { level, near, least, .. } = *distances;
        let wide = distances.wide_cells(cells);
        let mirror = sampled.facts.mirror(level);
        let clouds = sampled.wide(level).gather_mirrored(wide.grown(near, near), mirror);
        let needed = clouds.box_of(|sample| sample >= least).grown(near, near).intersection(&wide);
        if needed.is_empty() {
            return None;
        }
        // The grid cells between the centres of the outermost needed wide cells.
        let further = i32::from(level > 0);
        let between =
            CellBox { lo: (needed.lo + further) << level, hi: (needed.hi - further) << level };
        let mut blocks = Blocks::of_sparse(recipe, sampled, between, FieldUse::Everywhere);
        let WideFields { bulk, outlying } = bulk(distances, &mut blocks).ok()?;
        // Wide cells that are not needed have no particle nearby, so their samples are 0.
        let padded = |BlockField { block, level, .. }: BlockField| {
            let mut padded = Block::zero(wide);
            padded.put_part(needed, block.cells(), block.samples(), |_, sample| sample);
            padded.mirror(mirror);
            BlockField::new(padded, level)
        };
        let blocks = Blocks::of_sparse(recipe, sampled, cells, FieldUse::Everywhere);
        Some(NearGroup { bulk: padded(bulk), outlying: padded(outlying), blocks })
    }
}

/// The distance, in cells, from full cells beyond which there is no surface.
fn reach(distances: &DistanceFilters, sampled: &SampledDif) -> i32 {
    sampled.dif.ghost_layer() + distances.reach() + 1
}
