//! The field of spray, drop by drop: only around the surface of each drop.

use std::rc::Rc;

use glam::IVec3;

use crate::brick::Block;
use crate::field::distance::DistanceFilters;
use crate::field::indicator::SampledDif;
use crate::field::recipe::{
    Fields, Filters, Recipe, ThinShares, WideFields, bulk, thin_shares, walls_at,
};
use crate::grid::{CellBox, TILE};

use super::fields::{BlockField, Blocks, FieldUse, refined_from, wide_volume};

/// Spray has particles in at most one of this many cells.
const FEW: usize = 16;
/// The cost of a wide cell of other fluid, as a multiple of the cost of a wide cell of spray.
const CHEAPER: usize = 4;

/// The distance from the inside of a drop within which its field is needed, in cells: a vertex lies
/// between an inside cell and its neighbour, and normals use one cell more.
const AROUND: i32 = 2;

/// The field around the surface of some particles of a bin, which may be several drops.
pub(super) struct DropField {
    /// A box around the inside cells.
    inside: CellBox,
    /// The field on that box and the cells around it.
    field: Block,
}

/// The boxes within `cells` that can contain a surface; `None` if making the whole field is cheaper
/// than making it drop by drop. There is no surface beyond the reach of particles.
pub(super) fn parts(
    recipe: &Recipe,
    sampled: &SampledDif,
    cells: CellBox,
    most_bytes: u64,
) -> Option<Vec<CellBox>> {
    let Filters::Distances(distances) = &recipe.filters else { return None };
    if FEW * sampled.dif.full_volume(cells) > cells.volume() {
        return None;
    }
    let reach = sampled.dif.ghost_layer() + distances.reach() + 1;
    let parts = sampled.dif.parts_near_groups(cells, reach);
    let cost = |part: &CellBox| {
        let full = distances.wide_cells(part.grown(-reach, -reach));
        let volume = wide_volume(distances, *part);
        if FEW * full.volume() <= volume { volume / CHEAPER } else { volume }
    };
    let bytes = parts.iter().map(|part| part.volume() * size_of::<u16>()).sum::<usize>() as u64;
    let pays = parts.iter().map(cost).sum::<usize>() <= wide_volume(distances, cells);
    (pays && bytes <= most_bytes).then_some(parts)
}

/// The drops in some [parts].
pub(super) fn drops(recipe: &Recipe, sampled: &SampledDif, parts: &[CellBox]) -> Vec<DropField> {
    let Filters::Distances(distances) = &recipe.filters else { return Vec::new() };
    let least_share = distances.drops.least_share();
    let drop = |&part: &CellBox| drop_in(recipe, distances, least_share, sampled, part);
    parts.iter().filter_map(drop).collect()
}

/// The field on the part of `cells` in which dual cells can have a surface; `None` if there is no
/// surface. Like `cells`, this part consists of whole tiles. If `walls` do not cover `cells`, the
/// part is all of `cells`.
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

/// The drops in a box of cells; `None` if there is no surface.
fn drop_in(
    recipe: &Recipe,
    distances: &DistanceFilters,
    least_share: u16,
    sampled: &SampledDif,
    cells: CellBox,
) -> Option<DropField> {
    let DistanceFilters { level, near, least, stands_out, drops_level, ref drops, .. } = *distances;
    let wide = distances.wide_cells(cells);
    let wide_walls = walls_at(level, sampled.facts.walls());
    let clouds = sampled.wide(level).gather_within(wide.grown(near, near), wide_walls);
    let needed = clouds.box_of(|sample| sample >= least).grown(near, near).intersection(&wide);
    if needed.is_empty() {
        return None;
    }
    // The cells between the middles of the needed wide cells.
    let further = i32::from(level > 0);
    let between =
        CellBox { lo: (needed.lo + further) << level, hi: (needed.hi - further) << level };
    let mut blocks = Blocks::of_few(recipe, sampled, between, FieldUse::Everywhere);
    let WideFields { bulk, outlying } = bulk(distances, &mut blocks).ok()?;
    // Farther cells have no particle nearby, so their samples are 0.
    let padded = |BlockField { block, level }: BlockField| {
        let mut all = Block::zero(wide);
        all.put_part(needed, block.cells(), block.samples(), |_, sample| sample);
        wide_walls.into_iter().for_each(|walls| all.repeat_edges(walls));
        BlockField { block: Rc::new(all), level }
    };
    let (bulk, outlying) = (padded(bulk), padded(outlying));

    let field_use = FieldUse::NearSurface { iso: recipe.iso, away_from_walls: false };
    let mut blocks = Blocks::of_few(recipe, sampled, cells, field_use);
    let threshold = recipe.iso.threshold();
    let mut inside = refined_from(level, bulk.block.box_of(|sample| sample > threshold));
    let mut shares = None;
    if blocks.narrowed(&outlying, level, stands_out.begin()) {
        let thin = thin_shares(distances, &mut blocks).ok()?;
        let shown = thin.shares.block.box_of(|share| share >= least_share);
        inside = inside.union(&refined_from(drops_level, shown));
        shares = Some((thin, blocks.wanted));
    }
    inside = inside.intersection(&cells);
    if inside.is_empty() {
        return None;
    }
    // Beyond walls edge cells are repeated, so they must be included.
    let covered = sampled.facts.walls().is_none_or(|walls| walls.covers(&cells));
    let around = inside.grown(AROUND, AROUND).intersection(&cells);
    blocks.wanted = if covered { around } else { cells };
    let mut field = blocks.refined(bulk, 0, 0).ok()?;
    if let Some((shares, thin)) = shares {
        blocks.wanted = blocks.wanted.intersection(&thin);
        if !blocks.wanted.is_empty() {
            let near = blocks.refined(outlying, 0, 0).ok()?;
            let ThinShares { shares, certainty } = shares;
            let shares = blocks.refined(shares, 0, 0).ok()?;
            let certainty =
                certainty.map(|certainty| blocks.refined(certainty, 0, 0)).transpose().ok()?;
            let thin = ThinShares { shares, certainty };
            field = blocks.joined(field, near, thin, (drops, &stands_out)).ok()?;
        }
    }
    Some(DropField { inside, field: Rc::unwrap_or_clone(field.block) })
}
