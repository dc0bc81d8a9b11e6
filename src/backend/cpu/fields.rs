//! Applies the recipe to blocks in a thread's memory.

use std::rc::Rc;

use glam::IVec3;

use crate::brick::Block;
use crate::field::blur::{Weights, blur, blur_of_few, blur_while};
use crate::field::detail::{lost, raise};
use crate::field::distance::{
    Bulk, Depths, DistanceFilters, Drops, InsideBricks, NONE, StandsOut, UNITS, Width, depths,
    greatest_of, joined, mixed, outlying, outlying_part, quotient, refined, spread, wide_cells,
};
use crate::field::indicator::SampledDif;
use crate::field::recipe::{
    Fields, Filters, Recipe, ThinShares, WideFields, bulk, joined as joined_fields,
};
use crate::field::sheets::{Loose, SheetFields, Sheets, blend, holds_any, loose, sheets};
use crate::field::solid::{FARTHEST, STEPS, SolidFill, WHOLE, cut, outside};
use crate::grid::units::Isovalue;
use crate::grid::{CellBox, Mirror};
use crate::surface::solid::Solid;

/// Number of samples that are tested at a time. A test of a block stops after the first such piece
/// that decides it.
const PIECE: usize = 1 << 10;

/// A block is sparse if at most one in `SPARSE_RATIO` samples is nonzero.
const SPARSE_RATIO: usize = 8;

fn minimum(samples: &[u16]) -> u16 {
    samples.iter().fold(u16::MAX, |minimum, &sample| minimum.min(sample))
}

/// Computes the final field of a frame on `cells`.
#[must_use]
pub fn field(recipe: &Recipe, sampled: &SampledDif, cells: CellBox) -> Block {
    let field = recipe.apply(&mut Blocks::new(recipe, sampled, cells, FieldUse::Everywhere)).ok();
    field.map(|field| Rc::unwrap_or_clone(field.block)).expect("a whole field never stops early")
}

/// Computes the final field on each of `boxes` in turn. The boxes are near each other. The result
/// for a box is `None` if it turns out, before the field is complete, that no surface can pass
/// through the box. The flag of each box says whether the box is away from walls. The boxes share
/// intermediate results if this saves work, and if the results fit into `most_bytes`. `solid` must
/// be set if a solid is near any of the boxes; it cuts the fields.
pub(super) fn cut_fields<'a>(
    recipe: &'a Recipe,
    sampled: &'a SampledDif,
    solid: Option<&'a Solid>,
    boxes: &'a [(CellBox, bool)],
    most_bytes: u64,
) -> Box<dyn Iterator<Item = Option<Block>> + 'a> {
    let boxes = boxes.iter().map(|&(cells, away_from_walls)| {
        (cells, FieldUse::NearSurface { iso: recipe.iso, away_from_walls })
    });
    let blocks =
        move |cells, field_use| Blocks { solid, ..Blocks::new(recipe, sampled, cells, field_use) };
    let block = move |field: Result<BlockField, StopSignal>| {
        let mut block = Rc::unwrap_or_clone(field.ok()?.block);
        solid.into_iter().for_each(|solid| cut_by(solid, sampled, &mut block));
        Some(block)
    };
    let Filters::Distances(distances) = &recipe.filters else {
        return Box::new(
            boxes.map(move |(cells, field_use)| block(recipe.apply(&mut blocks(cells, field_use)))),
        );
    };
    let volume = |cells: CellBox| wide_volume(distances, cells);
    let all =
        boxes.clone().map(|(cells, _)| cells).fold(CellBox::EMPTY, |all, cells| all.union(&cells));
    let filled = |_: &Solid| {
        let fill = fill(sampled, distances.level);
        let around = distances.wide_halo() + fill.reach();
        fill.bytes(distances.wide_cells(all).grown(around, around))
    };
    let bytes = distances.bulk_bytes(distances.wide_cells(all)) + solid.map_or(0, filled);
    let fits = bytes <= most_bytes;
    let separate: usize = boxes.clone().map(|(cells, _)| volume(cells)).sum();
    let shares_wide = fits && volume(all) <= separate;
    let made = move |cells, field_use| bulk(distances, &mut blocks(cells, field_use)).ok();
    let wide_of_all = if shares_wide {
        made(all, FieldUse::NearSurface { iso: recipe.iso, away_from_walls: solid.is_none() })
    } else {
        None
    };
    let field = move |(cells, field_use)| {
        let wide = if shares_wide { wide_of_all.clone() } else { made(cells, field_use) };
        block(joined_fields(distances, &mut blocks(cells, field_use), wide?))
    };
    Box::new(boxes.map(field))
}

/// The filters that continue clouds into solids, on cells 2^`level` times as wide.
fn fill(sampled: &SampledDif, level: u32) -> SolidFill {
    SolidFill::new(f64::from(1_u32 << level) / sampled.facts.spacing_cells_or_one())
}

/// The share of each cell's cloud that is outside `solid`, for `cells` and for all cells within
/// `reach` of them; `None` if the solid is not near. `cells` are 2^`level` times as wide as the
/// grid's cells.
fn outside_of(
    solid: &Solid,
    sampled: &SampledDif,
    level: u32,
    cells: CellBox,
    reach: i32,
) -> Option<Block> {
    let (grid, periodic) = (&sampled.facts.grid, sampled.facts.periodic.as_ref());
    // A cell's cloud reaches beyond the cell, so the test includes a margin of two cells.
    if !solid.is_near(grid, periodic, level, cells.grown(2, 2)) {
        return None;
    }
    let width = grid.cell_size() * f64::from(1_u32 << level);
    let cells = cells.grown(reach, reach);
    let distances = solid.distances(grid, periodic, level, cells, width / STEPS, FARTHEST);
    let mut shares = outside(&distances);
    shares.mirror(sampled.facts.mirror(level));
    Some(shares)
}

/// The distance, in cells, up to which the field is cut beyond a solid's offset. It is large enough
/// for normals, which use two cells beyond a vertex's cell.
pub(super) const CUT: i32 = 3;

/// Cuts `field` by a solid.
pub(super) fn cut_by(solid: &Solid, sampled: &SampledDif, field: &mut Block) {
    let facts = &sampled.facts;
    let (cell, spacing) = (facts.grid.cell_size(), facts.spacing.unwrap_or(facts.grid.cell_size()));
    let offset = solid.offset() * UNITS;
    let most = (offset.abs() + f64::from(CUT) * cell / spacing * UNITS)
        .ceil()
        .min(f64::from(i16::MAX)) as i16;
    let (grid, periodic, step) = (&facts.grid, facts.periodic.as_ref(), spacing / UNITS);
    let mut distances = solid.distances(grid, periodic, 0, field.cells(), step, most);
    distances.mirror(facts.mesh_mirror(0));
    cut(field, &distances, offset.round() as i32, most);
}

/// The number of wide cells from which the field on `cells` is computed.
pub(super) fn wide_volume(distances: &DistanceFilters, cells: CellBox) -> usize {
    let halo = distances.wide_halo();
    distances.wide_cells(cells).grown(halo, halo).volume()
}

/// The cells whose interpolated samples depend on any of the cells `wide`, which are 2^`level`
/// times as wide.
pub(super) fn refined_from(level: u32, wide: CellBox) -> CellBox {
    if wide.is_empty() {
        return wide;
    }
    let further = i32::from(level > 0);
    let CellBox { lo, hi } = wide.grown(further, further);
    CellBox { lo: lo << level, hi: hi << level }
}

/// The part of a field that is needed.
#[derive(Clone, Copy)]
pub(super) enum FieldUse {
    /// The whole field.
    Everywhere,
    /// The field only if the surface at this isovalue can pass through it.
    NearSurface { iso: Isovalue, away_from_walls: bool },
}

impl FieldUse {
    /// Whether a surface can pass between cells if their field consists of weighted means of the
    /// samples in `block`.
    fn may_cut(self, block: &Block) -> bool {
        let Self::NearSurface { iso, away_from_walls } = self else { return true };
        // If all samples are on one side of the isovalue, so are their weighted means, and there is
        // no surface between cells. If all are inside, there can still be a surface at a wall.
        let threshold = iso.threshold();
        let mut pieces = block.samples().chunks(PIECE);
        let any_inside = pieces.clone().any(|piece| greatest_of(piece) > threshold);
        any_inside && (!away_from_walls || pieces.any(|piece| minimum(piece) <= threshold))
    }

    /// Whether filters can produce a surface from `block`: if all samples are 0, there is no
    /// surface.
    fn may_show_any(self, block: &Block) -> bool {
        matches!(self, Self::Everywhere)
            || block.samples().chunks(PIECE).any(|piece| greatest_of(piece) > 0)
    }

    /// Whether a surface can pass through `cells`, according to the distances on wide cells. If
    /// `drops` is true, drops can add to the inside.
    fn may_show(self, bulk: &Block, cells: CellBox, drops: bool) -> bool {
        let Self::NearSurface { away_from_walls, iso } = self else { return true };
        let threshold = iso.threshold();
        let any = |is: fn(u16, u16) -> bool| {
            bulk.rows(cells).any(|(_, row)| row.iter().any(|&sample| is(sample, threshold)))
        };
        (drops || any(|sample, threshold| sample > threshold))
            && (!away_from_walls || any(|sample, threshold| sample <= threshold))
    }
}

/// Gathers a density in cells 2^level times as wide.
pub(super) type Density<'a> = &'a dyn Fn(u32, CellBox) -> Block;

/// Computes the fields of a recipe on blocks of cells.
pub(super) struct Blocks<'a> {
    sampled: &'a SampledDif,
    /// The density of all particles, if `sampled` has only some of the particles.
    density: Option<Density<'a>>,
    /// A solid that may be near, if there is one.
    solid: Option<&'a Solid>,
    /// The share of each cell's cloud that is outside the solid; `None` if clouds have not been
    /// continued into a solid.
    outside: Option<Rc<Block>>,
    /// The requested cells of the field.
    cells: CellBox,
    /// The part of `cells` for which samples are gathered.
    pub(super) wanted: CellBox,
    field_use: FieldUse,
    /// Whether the field consists of weighted means of the gathered samples, so that these samples
    /// can show that no surface passes through the cells.
    is_mean: bool,
    /// Whether almost all samples are 0.
    sparse: bool,
    /// The distance by which nearby particles lie outside the calm surface, sampled in the grid's
    /// cells, and the greatest distance at which no particle stands out; `None` if this field has
    /// not been computed in the grid's cells.
    near: Option<(Rc<Block>, u16)>,
}

impl<'a> Blocks<'a> {
    /// Prepares the fields of an octave on `cells` of this octave, from the density of all
    /// particles.
    pub(super) fn of_density(
        recipe: &Recipe,
        sampled: &'a SampledDif,
        density: Density<'a>,
        solid: Option<&'a Solid>,
        cells: CellBox,
    ) -> Self {
        let density = Some(density);
        Self { density, solid, ..Self::new(recipe, sampled, cells, FieldUse::Everywhere) }
    }

    fn new(recipe: &Recipe, sampled: &'a SampledDif, cells: CellBox, field_use: FieldUse) -> Self {
        // The paper's filters compute weighted means of the DIF only if they do not recover
        // details.
        let is_mean = matches!(&recipe.filters, Filters::Paper(paper) if paper.recovery.is_none());
        let (density, solid, outside) = (None, None, None);
        Self {
            sampled,
            density,
            solid,
            outside,
            cells,
            wanted: cells,
            field_use,
            is_mean,
            sparse: false,
            near: None,
        }
    }

    /// Prepares the fields of samples that are almost all 0.
    pub(super) fn of_sparse(
        recipe: &Recipe,
        sampled: &'a SampledDif,
        cells: CellBox,
        field_use: FieldUse,
    ) -> Self {
        Self { sparse: true, ..Self::new(recipe, sampled, cells, field_use) }
    }
}

/// A field, and the level that gives the width of its cells.
#[derive(Clone)]
pub(super) struct BlockField {
    pub(super) block: Rc<Block>,
    pub(super) level: u32,
    /// The cells with nonzero samples, x fastest, if they are known and few.
    full: Option<Rc<[IVec3]>>,
}

impl BlockField {
    pub(super) fn new(block: Block, level: u32) -> Self {
        Self { block: Rc::new(block), level, full: None }
    }
}

/// The full cells that lie in `cells`.
fn within(full: &[IVec3], cells: CellBox) -> Rc<[IVec3]> {
    full.iter().copied().filter(|&cell| cells.contains(cell)).collect()
}

/// A signal to stop early, because there is no surface.
pub(super) struct StopSignal;

impl Blocks<'_> {
    fn mirror(&self, level: u32) -> Option<Mirror> {
        self.sampled.facts.mirror(level)
    }

    fn gathered(&self, level: u32, cells: CellBox) -> Block {
        match self.density {
            Some(density) => density(level, cells),
            None => self.sampled.wide(level).gather_mirrored(cells, self.mirror(level)),
        }
    }

    fn field(&self, mut block: Block, level: u32) -> BlockField {
        block.mirror(self.mirror(level));
        BlockField::new(block, level)
    }

    /// Gathers samples that are almost all 0, and finds the full cells.
    fn gathered_sparse(&self, level: u32, cells: CellBox) -> BlockField {
        let most = cells.volume() / SPARSE_RATIO;
        let samples = self.sampled.wide(level);
        let (block, full) = match self.mirror(level) {
            Some(mirror) if !mirror.cells().covers(&cells) => {
                let block = samples.gather_mirrored(cells, Some(mirror));
                let full = block.full_cells(most);
                (block, full)
            }
            _ => samples.gather_few(cells, most),
        };
        BlockField { full: full.map(Rc::from), ..BlockField::new(block, level) }
    }
}

impl Fields for Blocks<'_> {
    type Field = BlockField;
    type Error = StopSignal;

    fn samples(&mut self, level: u32, halo: i32) -> Result<BlockField, StopSignal> {
        let cells = wide_cells(level, self.wanted).grown(halo, halo);
        let field = if self.sparse {
            self.gathered_sparse(level, cells)
        } else {
            BlockField::new(self.gathered(level, cells), level)
        };
        let may_have_surface = if self.is_mean {
            self.field_use.may_cut(&field.block)
        } else {
            self.field_use.may_show_any(&field.block)
        };
        if may_have_surface { Ok(field) } else { Err(StopSignal) }
    }

    fn filled(&mut self, clouds: &BlockField, scale: u32) -> Result<BlockField, StopSignal> {
        let (level, cells) = (clouds.level, clouds.block.cells());
        let Some(solid) = self.solid else { return Ok(clouds.clone()) };
        let fill = fill(self.sampled, level);
        let shares = outside_of(solid, self.sampled, level, cells, fill.reach());
        let Some(shares) = shares else { return Ok(clouds.clone()) };
        let clouds = self.gathered(level, shares.cells());
        let filled = fill.filled((&clouds, scale), &shares, cells, self.mirror(level));
        self.outside = Some(Rc::new(shares));
        Ok(BlockField::new(filled, level))
    }

    fn blur(
        &mut self,
        BlockField { block, level, full }: BlockField,
        weights: &Weights,
    ) -> Result<BlockField, StopSignal> {
        let mirror = self.mirror(level);
        if let Some(full) = full {
            let cells = block.cells().grown(-weights.reach(), -weights.reach());
            return Ok(BlockField::new(blur_of_few(&block, &full, weights, cells, mirror), level));
        }
        let may_have_surface = |smooth: &Block| !self.is_mean || self.field_use.may_cut(smooth);
        let block = blur_while(Rc::unwrap_or_clone(block), weights, mirror, may_have_surface);
        block.map(|block| BlockField::new(block, level)).ok_or(StopSignal)
    }

    fn lost(
        &mut self,
        dif: BlockField,
        smooth: &BlockField,
        iso: Isovalue,
    ) -> Result<BlockField, StopSignal> {
        Ok(BlockField::new(lost(&dif.block, &smooth.block, iso), dif.level))
    }

    fn greater(
        &mut self,
        mut field: BlockField,
        other: BlockField,
    ) -> Result<BlockField, StopSignal> {
        raise(Rc::make_mut(&mut field.block), &other.block);
        Ok(field)
    }

    fn depths(&mut self, by: &Bulk, clouds: BlockField) -> Result<Depths<BlockField>, StopSignal> {
        let BlockField { ref block, level, ref full } = clouds;
        // `cells` are the cells for which the widest filter has all of its taps. If few cells are
        // full, all three filters compute only `cells`.
        let cells = block.cells().grown(-by.reach(), -by.reach());
        let share = |width: &Width| {
            let (weights, mirror) = (&width.weights, self.mirror(level));
            match full {
                Some(full) => blur_of_few(block, full, weights, cells, mirror),
                None => blur(Block::clone(block), weights, mirror),
            }
        };
        let shares = [0, 1, 2].map(|i: usize| share(&by.widths[i]));
        drop(clouds);
        let Depths { calm, fine, apart } = depths(by, shares.each_ref());
        let [calm, fine, apart] = [calm, fine, apart].map(|block| BlockField::new(block, level));
        Ok(Depths { calm, fine, apart })
    }

    fn mixed(
        &mut self,
        by: &Bulk,
        inside: &InsideBricks,
        Depths { calm, fine, apart }: Depths<BlockField>,
        near: &BlockField,
    ) -> Result<BlockField, StopSignal> {
        let level = calm.level;
        let depths = Depths { calm: calm.block, fine: fine.block, apart: apart.block };
        let mut block = mixed(by, &depths, &near.block);
        inside.raise(&mut block);
        Ok(BlockField::new(block, level))
    }

    fn outlying(
        &mut self,
        [calm, fine]: [&BlockField; 2],
        clouds: BlockField,
        by: (u16, &StandsOut),
    ) -> Result<BlockField, StopSignal> {
        let mut block = outlying([&calm.block, &fine.block], &clouds.block, by);
        // The bulk continues into solids, although there are no particles in them. Cells in a solid
        // must therefore not have the sample `NONE`.
        let outside = self.outside.take().map(|outside| outside.part(block.cells()));
        let shares = outside.iter().flat_map(|outside| outside.samples());
        for (sample, _) in
            block.samples_mut().iter_mut().zip(shares).filter(|(_, share)| **share < WHOLE / 2)
        {
            *sample = (*sample).max(NONE + 1);
        }
        Ok(BlockField::new(block, calm.level))
    }

    fn spread(
        &mut self,
        BlockField { block, level, .. }: BlockField,
        reach: i32,
    ) -> Result<BlockField, StopSignal> {
        Ok(self.field(spread(Rc::unwrap_or_clone(block), reach), level))
    }

    fn probe(
        &mut self,
        wide: &WideFields<BlockField>,
        level: u32,
        begin: u16,
    ) -> Result<(), StopSignal> {
        // The field of a cell is a weighted mean of wide cells, so the wide cells decide whether
        // these cells can have a surface.
        let cells = wide_cells(level, self.cells);
        let drops = !outlying_part(&wide.outlying.block, cells, begin).is_empty();
        if self.field_use.may_show(&wide.bulk.block, cells, drops) {
            Ok(())
        } else {
            Err(StopSignal)
        }
    }

    fn refined(&mut self, wide: BlockField, level: u32) -> Result<BlockField, StopSignal> {
        let cells = wide_cells(level, self.wanted);
        Ok(self.field(refined(&wide.block, wide.level - level, cells), level))
    }

    fn narrowed(&mut self, near: &BlockField, level: u32, begin: u16) -> bool {
        let part = outlying_part(&near.block, wide_cells(level, self.wanted), begin);
        self.wanted = self.wanted.intersection(&refined_from(level, part));
        self.near = (level == 0).then(|| (Rc::clone(&near.block), begin));
        !part.is_empty()
    }

    fn quotient(
        &mut self,
        clouds: BlockField,
        around: &Weights,
        bits: u32,
    ) -> Result<BlockField, StopSignal> {
        let BlockField { block, level, full } = clouds;
        let Some(full) = full else {
            let around = blur(Block::clone(&block), around, self.mirror(level));
            return Ok(BlockField::new(quotient(&block, &around, bits), level));
        };
        // A quotient is 0 where the clouds are 0, so only the box around the full cells is
        // computed.
        let cells = block.cells().grown(-around.reach(), -around.reach());
        let inner = within(&full, cells);
        let part =
            inner.iter().fold(CellBox::EMPTY, |all, &cell| all.union(&CellBox::cube(cell, 1)));
        let mut quotients = Block::zero(cells);
        if !part.is_empty() {
            let around = blur_of_few(&block, &full, around, part, self.mirror(level));
            quotients.put(&quotient(&block, &around, bits));
        }
        Ok(BlockField { full: Some(inner), ..BlockField::new(quotients, level) })
    }

    fn may_hold(&mut self, sheets: &Sheets, clouds: &BlockField) -> bool {
        holds_any(sheets, &clouds.block)
    }

    fn loose(
        &mut self,
        clouds: BlockField,
        smooth: BlockField,
        scale: u32,
    ) -> Result<Loose<BlockField>, StopSignal> {
        let level = clouds.level;
        let Loose { clouds: block, weights } =
            loose(&clouds.block, Rc::unwrap_or_clone(smooth.block), scale);
        let cells = block.cells();
        let full = clouds.full.map(|full| within(&full, cells));
        Ok(Loose {
            clouds: BlockField { full, ..BlockField::new(block, level) },
            weights: weights.map(|weights| BlockField::new(weights, level)),
        })
    }

    fn divided(
        &mut self,
        field: BlockField,
        by: BlockField,
        bits: u32,
    ) -> Result<BlockField, StopSignal> {
        Ok(BlockField::new(quotient(&field.block, &by.block, bits), field.level))
    }

    fn sheets(
        &mut self,
        by: &Sheets,
        wide: BlockField,
        level: u32,
    ) -> Result<Option<SheetFields<BlockField>>, StopSignal> {
        let reach = by.average.reach();
        let cells = wide_cells(level, self.wanted).grown(reach, reach);
        let around = |(near, begin): &(Rc<Block>, u16)| {
            // Interpolation spreads the value of a cell to the narrower cells in its neighbours.
            let reach = by.average.reach() + i32::from(level > 0);
            let mut needed = Block::zero(cells.grown(reach, reach));
            for ([y, z], row) in near.rows(self.wanted) {
                for (x, _) in (self.wanted.lo.x..).zip(row).filter(|&(_, near)| near > begin) {
                    let place = needed.index(IVec3::new(x, y, z) >> level);
                    needed.samples_mut()[place] = 1;
                }
            }
            spread(needed, reach)
        };
        let step = by.numbers.step;
        let mut density_cells = cells.grown(step, step);
        // There are no sheets where the density is low, so sheets are computed only around denser
        // cells.
        if self.mirror(level).is_none_or(|mirror| mirror.cells().covers(&density_cells)) {
            let least = by.least_density();
            let dense = wide.block.box_of(|sample| sample >= least);
            let dense = refined_from(wide.level - level, dense).intersection(&cells);
            if dense.is_empty() {
                return Ok(None);
            }
            density_cells = dense.grown(step, step);
        }
        let density = self.field(refined(&wide.block, wide.level - level, density_cells), level);
        let needed = self.near.as_ref().map(around);
        let found = sheets(by, &density.block, cells, needed.as_ref());
        Ok(found.map(|SheetFields { shares, certainty }| SheetFields {
            shares: self.field(shares, level),
            certainty: self.field(certainty, level),
        }))
    }

    fn blended(
        &mut self,
        drops: BlockField,
        sheets: BlockField,
        certainty: &BlockField,
    ) -> Result<BlockField, StopSignal> {
        let block = Rc::unwrap_or_clone(drops.block);
        Ok(self.field(blend(block, &sheets.block, &certainty.block), drops.level))
    }

    fn joined(
        &mut self,
        bulk: BlockField,
        near: BlockField,
        ThinShares { shares, certainty }: ThinShares<BlockField>,
        (drops, stands_out): (&Drops, &StandsOut),
    ) -> Result<BlockField, StopSignal> {
        let certainty = certainty.as_ref().map(|certainty| &*certainty.block);
        let block = Rc::unwrap_or_clone(bulk.block);
        let block = joined(block, &near.block, &shares.block, certainty, drops, stands_out);
        Ok(BlockField::new(block, bulk.level))
    }
}
