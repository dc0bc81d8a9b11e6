//! The field of particles of several sizes, on blocks in a thread's memory.

use std::rc::Rc;
use std::sync::Arc;

use glam::IVec3;

use crate::brick::Block;
use crate::field::blur::{Weights, blur};
use crate::field::distance::{
    DistanceFilters, away, halo_in_cells, outlying, outlying_part, refined, spread, wide_cells,
};
use crate::field::indicator::{GHOST_LAYER, WideCells};
use crate::field::recipe::{Recipe, ThinShares, WideFields, surfaces_and_bulk, thin_shares};
use crate::field::sizes::{
    OctaveDrops, SizedClouds, WHOLE, averaging, finer_spacings, growth, mixed, share,
};
use crate::grid::units::{Isovalue, SheetStretch, Smooth};
use crate::grid::{BLOCK, CellBox, Mirror};
use crate::surface::solid::Solid;

use super::fields::{Blocks, CUT, cut_by, refined_from};

/// Computes the field of clouds of several sizes.
#[derive(Debug)]
pub struct SizedField<'a> {
    clouds: &'a SizedClouds,
    /// A solid that cuts the field, if there is one.
    solid: Option<Arc<Solid>>,
    /// The recipe and the filters for the first octave of `clouds`, and those for all other
    /// octaves. Drops are refined in all octaves except the finest octave of the frame.
    recipes: [(Recipe, DistanceFilters); 2],
    /// The filter that averages sizes, in wide cells of an octave.
    averaging: Weights,
    /// The growth of the radius of drops within an octave, in units of distance.
    growth: i32,
}

/// The side of the surface on which a whole box of cells lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BoxSide {
    /// The box is inside the fluid.
    Inside,
    /// The box is outside the fluid.
    Outside,
}

/// The surfaces of an octave on its wide cells. Distances are in the octave's spacings.
struct OctaveSurface {
    /// The calm surface, from which drops stand out.
    calm: Block,
    /// The fine surface.
    fine: Block,
    /// The bulk's surface.
    bulk: Block,
}

impl OctaveSurface {
    /// Fields without a surface.
    fn none(wide: CellBox) -> Self {
        let [calm, fine, bulk] = [(); 3].map(|()| Block::zero(wide));
        Self { calm, fine, bulk }
    }
}

/// The drops of an octave, in its own cells.
struct OctaveShares {
    octave: usize,
    /// A box of the finest cells that contains all cells in which particles stand out.
    part: CellBox,
    /// The distance by which nearby particles lie outside the calm surface, sampled in wide cells.
    outlying: Block,
    /// The shares of drops and sheets, in cells of the drops' level.
    thin: ThinShares<Block>,
}

impl<'a> SizedField<'a> {
    /// Prepares the field of `clouds`. `plateau` must be measured for clouds with the usual
    /// amounts, which are twice the amounts of `clouds`.
    #[must_use]
    pub fn new(
        clouds: &'a SizedClouds,
        smooth: Smooth,
        sheets: SheetStretch,
        solid: Option<Arc<Solid>>,
        plateau: u16,
    ) -> Self {
        let spacing = clouds.octave(0).facts.spacing_cells_or_one();
        let finest = DistanceFilters::new(smooth, sheets, spacing);
        let coarser = finest.clone().refining(sheets, spacing);
        let first = if clouds.is_finest() { finest } else { coarser.clone() };
        let recipes = [first, coarser].map(|distances| {
            let distances = distances.of_half_amounts().with_plateau(plateau / 2);
            (Recipe::of_distances(distances.clone()), distances)
        });
        let averaging = averaging(clouds.wide_cells());
        Self { clouds, solid, recipes, averaging, growth: growth(spacing) }
    }

    /// The isovalue of the surface.
    #[must_use]
    pub fn iso(&self) -> Isovalue {
        self.recipes[0].0.iso
    }

    /// The recipe of the first octave of the clouds.
    #[must_use]
    pub fn recipe(&self) -> &Recipe {
        &self.recipes[0].0
    }

    /// The maximum distance from a surface to the nearest particle, in cells of the particle's
    /// octave.
    #[must_use]
    pub fn reach(&self) -> i32 {
        self.clouds.octave(0).dif.ghost_layer() + self.distances(0).reach()
    }

    /// The distance, in cells of the coarsest octave, within which particles affect the surface.
    #[must_use]
    pub fn halo(smooth: Smooth, sheets: SheetStretch, spacing_cells: f64) -> i32 {
        let averaging = averaging(WideCells::of_spacing(spacing_cells)).reach();
        let finest = DistanceFilters::new(smooth, sheets, spacing_cells);
        let coarser = finest.clone().refining(sheets, spacing_cells);
        let of = |distances: &DistanceFilters| {
            let DistanceFilters { level, near, drops_level, .. } = *distances;
            // Surfaces are also computed on the surrounding wide cells whose drops can reach the
            // requested cells. The surfaces and the density of coarser octaves are interpolated
            // from wide cells. The filters for sizes and for distances start from these wide cells.
            let wide = 2 + 2 * near + distances.widest_halo().max(averaging);
            halo_in_cells(level, wide).max(halo_in_cells(drops_level, 2 + distances.drops_halo()))
        };
        of(&finest).max(of(&coarser)) + GHOST_LAYER
    }

    /// The maximum memory, in bytes, that a thread needs to compute the field of neighbouring
    /// blocks in a frame with `octaves` octaves.
    #[must_use]
    pub fn block_bytes(
        smooth: Smooth,
        sheets: SheetStretch,
        spacing_cells: f64,
        octaves: usize,
    ) -> u64 {
        /// Number of fields that are kept for each octave: its three surfaces.
        const FIELDS: usize = 3;
        let distances = DistanceFilters::new(smooth, sheets, spacing_cells);
        let blocks = CellBox { lo: IVec3::NEG_ONE, hi: IVec3::splat(2 * BLOCK + 2) };
        let near = 2 * distances.near;
        let wide =
            |octave: usize| wide_cells(octave as u32 + distances.level, blocks).grown(near, near);
        let surface_bytes = |octave| (FIELDS * wide(octave).volume() * size_of::<u16>()) as u64;
        distances.block_bytes()
            + distances.bulk_bytes(wide(0))
            + (0..octaves).map(surface_bytes).sum::<u64>()
    }

    /// The maximum distance, in wide cells, from a drop to the nearest particle of its octave. The
    /// largest drops of an octave are twice as large as the smallest.
    fn near(&self) -> i32 {
        2 * self.distances(0).near
    }

    fn distances(&self, octave: usize) -> &DistanceFilters {
        &self.recipes[octave.min(1)].1
    }

    /// The cells of an octave whose centres surround `finest`, a box of the finest cells.
    fn cells(&self, octave: usize, finest: CellBox) -> CellBox {
        wide_cells(octave as u32, finest)
    }

    /// The wide cells of an octave from which the field on `finest`, a box of the finest cells, is
    /// computed. They include the surrounding wide cells whose drops are near.
    fn wide(&self, octave: usize, finest: CellBox) -> CellBox {
        let level = octave as u32 + self.distances(octave).level;
        wide_cells(level, finest).grown(self.near(), self.near())
    }

    /// The mirror at walls, in cells 2^`level` times as wide as the finest.
    fn mirror(&self, level: u32) -> Option<Mirror> {
        self.clouds.octave(0).facts.mirror(level)
    }

    /// Computes the final field on each of `boxes` in turn; `None` for a box through which no
    /// surface can pass. The boxes consist of the finest cells and are near each other. The flag of
    /// each box says whether the box is away from walls. The boxes share the surfaces of octaves if
    /// this saves work; sharing does not affect the samples.
    pub fn on_each(&self, boxes: Vec<(CellBox, bool)>) -> impl Iterator<Item = Option<Block>> {
        let no_surfaces = || self.no_surfaces();
        let all = boxes.iter().fold(CellBox::EMPTY, |all, (cells, _)| all.union(cells));
        let separate: usize = boxes.iter().map(|(cells, _)| self.volume(*cells)).sum();
        let shares_surfaces = self.volume(all) <= separate;
        let mut shared = no_surfaces();
        boxes.into_iter().map(move |(cells, away_from_walls)| {
            if shares_surfaces {
                self.on((cells, all), away_from_walls, &mut shared).ok()
            } else {
                self.on((cells, cells), away_from_walls, &mut no_surfaces()).ok()
            }
        })
    }

    /// Computes the final field on `cells`, a box of the finest cells, as
    /// [`on_each`](Self::on_each) does.
    ///
    /// # Errors
    /// [`BoxSide`] if no surface can pass through the box.
    pub fn crossed_on(&self, cells: CellBox, away_from_walls: bool) -> Result<Block, BoxSide> {
        self.on((cells, cells), away_from_walls, &mut self.no_surfaces())
    }

    /// An empty slot for the surface of each octave.
    fn no_surfaces(&self) -> Vec<Option<OctaveSurface>> {
        (0..self.clouds.octaves()).map(|_| None).collect()
    }

    /// The total number of wide cells, over all octaves, from which the surfaces on `cells` are
    /// computed. `cells` is a box of the finest cells.
    fn volume(&self, cells: CellBox) -> usize {
        let around = |octave| {
            let halo = self.distances(octave).wide_halo();
            self.wide(octave, cells).grown(halo, halo)
        };
        (0..self.clouds.octaves()).map(|octave| around(octave).volume()).sum()
    }

    /// Computes the final field on `cells`, with octave surfaces on the box `around`, which
    /// contains `cells`. If no surface can pass through `cells`, returns whether these cells are
    /// inside or outside the fluid.
    fn on(
        &self,
        (cells, around): (CellBox, CellBox),
        away_from_walls: bool,
        surfaces: &mut [Option<OctaveSurface>],
    ) -> Result<Block, BoxSide> {
        // A solid cuts the field, so there may be a surface even if all cells are inside the fluid.
        let is_at_solid = || self.solid.as_deref().is_some_and(|solid| self.is_at(solid, cells));
        let away_from_walls = away_from_walls && !is_at_solid();
        self.make(surfaces, 0, around);
        let bulk = self.bulk(surfaces, cells);
        // Drops only add to the inside of the fluid, so if all cells are inside, no drop has a
        // surface.
        let threshold = self.iso().threshold();
        if away_from_walls && bulk.samples().iter().all(|&sample| sample > threshold) {
            return Err(BoxSide::Inside);
        }
        let drops = self.all_drops(surfaces, (cells, around));
        if bulk.samples().iter().all(|&sample| sample <= threshold)
            && !drops.iter().any(|drops| self.has_inside(drops))
        {
            return Err(BoxSide::Outside);
        }
        Ok(self.joined(&bulk, drops, cells))
    }

    /// Computes the final field on `cells`, a box of the finest cells, even if no surface passes
    /// through the box. If the box lies beyond a wall, the field also covers the nearest cells
    /// within the wall.
    #[must_use]
    pub fn everywhere_on(&self, cells: CellBox) -> Block {
        let cells = cells.with_nearest_of(self.clouds.octave(0).facts.walls());
        let mut surfaces = self.no_surfaces();
        self.make(&mut surfaces, 0, cells);
        let bulk = self.bulk(&surfaces, cells);
        let drops = self.all_drops(&mut surfaces, (cells, cells));
        self.joined(&bulk, drops, cells)
    }

    /// The bulk's surface for `cells`, a box of the finest cells. The first of `surfaces` must
    /// already be computed.
    fn bulk(&self, surfaces: &[Option<OctaveSurface>], cells: CellBox) -> Block {
        let first = surfaces[0].as_ref().expect("the caller made the first octave's surface");
        first.bulk.part(self.wide(0, cells))
    }

    /// Computes the drops of all octaves, from the coarsest to the finest.
    fn all_drops(
        &self,
        surfaces: &mut [Option<OctaveSurface>],
        (cells, around): (CellBox, CellBox),
    ) -> Vec<OctaveShares> {
        let octaves = (0..surfaces.len()).rev();
        octaves.filter_map(|octave| self.drops(octave, surfaces, (cells, around))).collect()
    }

    /// Joins the bulk and its drops into a field, and cuts the field by the solid.
    fn joined(&self, bulk: &Block, drops: Vec<OctaveShares>, cells: CellBox) -> Block {
        let mut field = refined(bulk, self.distances(0).level, cells);
        for drops in drops {
            field = self.with_drops(field, &drops);
        }
        field.mirror(self.clouds.octave(0).facts.mesh_mirror(0));
        let solid = self.solid.as_deref().filter(|solid| self.is_at(solid, cells));
        solid.into_iter().for_each(|solid| cut_by(solid, self.clouds.octave(0), &mut field));
        field
    }

    /// Whether `solid`, including its offset, may cut the field on `cells`, a box of the finest
    /// cells.
    fn is_at(&self, solid: &Solid, cells: CellBox) -> bool {
        let facts = &self.clouds.octave(0).facts;
        let offset = solid.offset().abs() * facts.spacing_cells_or_one();
        let further = offset.ceil() as i32 + CUT;
        let around = cells.grown(further, further);
        solid.is_near(&facts.grid, facts.periodic.as_ref(), 0, around)
    }

    /// Computes the surface of an octave, mixed with the surfaces of coarser octaves, unless it is
    /// already computed.
    fn make(&self, surfaces: &mut [Option<OctaveSurface>], octave: usize, cells: CellBox) {
        if surfaces[octave].is_some() {
            return;
        }
        let wide = self.wide(octave, cells);
        if octave + 1 == surfaces.len() {
            surfaces[octave] = Some(self.own_surface(octave, cells));
            return;
        }
        let shares = self.coarser(octave, wide);
        let any = |is: fn(u16) -> bool| {
            shares.as_ref().is_none_or(|shares| shares.samples().iter().any(|&share| is(share)))
        };
        let own = (shares.is_some() && any(|share| share < 1 << 15))
            .then(|| self.own_surface(octave, cells));
        let next = any(|share| share > 0).then(|| {
            self.make(surfaces, octave + 1, cells);
            let OctaveSurface { calm, fine, bulk } =
                surfaces[octave + 1].as_ref().expect("`make` made this surface");
            let mirror = self.mirror(octave as u32 + self.distances(octave).level);
            [calm, fine, bulk].map(|field| {
                let mut field = finer_spacings(refined(field, 1, wide));
                // The mirror planes of the next octave can differ from those of this octave, so the
                // field is mirrored again.
                field.mirror(mirror);
                field
            })
        });
        surfaces[octave] = Some(match (own, next) {
            (Some(own), Some([calm, fine, bulk])) => {
                let shares = shares.expect("an octave with its own surface has shares");
                let mixed = |own: Block, next: &Block| mixed(own, next, &shares);
                OctaveSurface {
                    calm: mixed(own.calm, &calm),
                    fine: mixed(own.fine, &fine),
                    bulk: mixed(own.bulk, &bulk),
                }
            }
            (None, Some([calm, fine, bulk])) => OctaveSurface { calm, fine, bulk },
            (Some(own), None) => own,
            (None, None) => OctaveSurface::none(wide),
        });
    }

    /// The share of the density around the octave's wide cells `wide` that belongs to coarser
    /// octaves. A particle of the octave belongs in part to the next octave: the next octave's
    /// share is log2(s), where s is the particle's size divided by the smallest size of the octave.
    /// The result is `None` if neither this octave nor a finer octave has particles there.
    fn coarser(&self, octave: usize, wide: CellBox) -> Option<Block> {
        let level = self.distances(octave).level;
        let around = wide.grown(self.averaging.reach(), self.averaging.reach());
        if !self.clouds.may_hold(octave, level, around) {
            return None;
        }
        let above = self.averaged(octave, self.clouds.above(octave, level, around));
        let all = self.averaged(octave, self.clouds.density(octave, level, around));
        Some(share(&above, &all, WHOLE))
    }

    /// A density in wide cells of an octave, smoothed by the filter that averages sizes.
    fn averaged(&self, octave: usize, density: Block) -> Block {
        let mirror = self.mirror(octave as u32 + self.distances(octave).level);
        blur(density, &self.averaging, mirror)
    }

    /// Computes the surface with the filters of an octave, on the octave's wide cells.
    fn own_surface(&self, octave: usize, cells: CellBox) -> OctaveSurface {
        let (recipe, distances) = &self.recipes[octave.min(1)];
        let density = |level: u32, cells: CellBox| self.clouds.density(octave, level, cells);
        // `own` are the cells whose field is computed from exactly the wide cells `wide`.
        let wide = self.wide(octave, cells);
        let further = i32::from(distances.level > 0);
        let own = CellBox {
            lo: (wide.lo + further) << distances.level,
            hi: (wide.hi - further) << distances.level,
        };
        let sampled = self.clouds.octave(octave);
        let mut blocks = Blocks::of_density(recipe, sampled, &density, self.solid.as_deref(), own);
        let mirror = self.mirror(octave as u32 + distances.level);
        let on_wide = |block: &Block| {
            let mut block = block.part(wide);
            block.mirror(mirror);
            block
        };
        match surfaces_and_bulk(distances, &mut blocks) {
            Ok(([calm, fine], WideFields { bulk, .. })) => {
                let [calm, fine, bulk] = [calm, fine, bulk].map(|field| on_wide(&field.block));
                OctaveSurface { calm, fine, bulk }
            }
            Err(_) => OctaveSurface::none(wide),
        }
    }

    /// Computes the drops of an octave near `cells`, a box of the finest cells; `None` if no
    /// particle stands out.
    fn drops(
        &self,
        octave: usize,
        surfaces: &mut [Option<OctaveSurface>],
        (cells, around): (CellBox, CellBox),
    ) -> Option<OctaveShares> {
        let (recipe, distances) = &self.recipes[octave.min(1)];
        let DistanceFilters { level, least, stands_out, .. } = distances;
        let sampled = self.clouds.octave(octave);
        // First, find the octave's particles that lie outside the calm surface.
        let mirror = self.mirror(octave as u32 + level);
        let wide = self.wide(octave, cells);
        let clouds = sampled.wide(*level).gather_mirrored(wide, mirror);
        if clouds.samples().iter().all(|sample| sample < least) {
            return None;
        }
        self.make(surfaces, octave, around);
        let OctaveSurface { calm, fine, .. } = surfaces[octave].as_ref()?;
        let [calm, fine] = [calm, fine].map(|field| field.part(wide));
        let outlying = outlying([&calm, &fine], &clouds, (*least, stands_out));
        let mut outlying = spread(outlying, self.near());
        if outlying.samples().iter().all(|&sample| sample <= stands_out.begin()) {
            return None;
        }
        outlying.mirror(mirror);
        let wide_level = octave as u32 + level;
        let part = outlying_part(&outlying, wide_cells(wide_level, cells), stands_out.begin());
        let part = cells.intersection(&refined_from(wide_level, part));
        if part.is_empty() {
            return None;
        }
        let own = |level: u32, cells: CellBox| {
            sampled.wide(level).gather_mirrored(cells, self.mirror(octave as u32 + level))
        };
        let own_part = self.cells(octave, part);
        let mut blocks = Blocks::of_density(recipe, sampled, &own, self.solid.as_deref(), own_part);
        let ThinShares { shares, certainty } = thin_shares(distances, &mut blocks).ok()?;
        let thin = ThinShares {
            shares: Rc::unwrap_or_clone(shares.block),
            certainty: certainty.map(|certainty| Rc::unwrap_or_clone(certainty.block)),
        };
        Some(OctaveShares { octave, part, outlying, thin })
    }

    /// Whether the drops can add to the inside of the fluid.
    fn has_inside(&self, OctaveShares { octave, thin, .. }: &OctaveShares) -> bool {
        let drops = &self.distances(*octave).drops;
        let greatest = thin.shares.samples().iter().copied().max().unwrap_or(0);
        away(greatest, drops.width) < drops.radius + self.growth
    }

    /// Joins the drops of an octave to a field whose distances are in the finest spacings.
    fn with_drops(&self, field: Block, made: &OctaveShares) -> Block {
        let &OctaveShares { octave, part: cells, ref outlying, ref thin } = made;
        let DistanceFilters { level, drops_level, stands_out, drops, .. } = self.distances(octave);
        let of = octave as u32;
        let near = &refined(outlying, of + level, cells);
        let on_cells = |block: &Block| refined(block, of + drops_level, cells);
        let (shares, certainty) = (&on_cells(&thin.shares), thin.certainty.as_ref().map(on_cells));
        let certainty = certainty.as_ref();
        let (sizes, growth) = (self.sizes(octave, cells), self.growth);
        let sizes = sizes.as_ref();
        OctaveDrops { octave: of, near, shares, certainty, sizes, drops, growth, stands_out }
            .joined(field)
    }

    /// The mean logarithm of the sizes of an octave's particles around `cells`, a box of the finest
    /// cells; `None` if all particles of the octave have its smallest size.
    fn sizes(&self, octave: usize, cells: CellBox) -> Option<Block> {
        let level = self.distances(octave).level;
        let wide = wide_cells(octave as u32 + level, cells);
        let around = wide.grown(self.averaging.reach(), self.averaging.reach());
        let fractions = self.clouds.fractions(octave).filter(|all| !all.dif.infos().is_empty())?;
        let mirror = self.mirror(octave as u32 + level);
        let fractions = fractions.wide(level).gather_mirrored(around, mirror);
        let volumes = self.clouds.octave(octave).wide(level).gather_mirrored(around, mirror);
        let [fractions, volumes] = [fractions, volumes].map(|block| self.averaged(octave, block));
        Some(refined(&share(&fractions, &volumes, 0), octave as u32 + level, cells))
    }
}
