//! A frame whose particles have several sizes.

use crate::backend::{BoxSide, SizedField};
use crate::brick::{Bins, Block, FrameFacts};
use crate::field::blur::Smoothing;
use crate::field::calibration::Calibration;
use crate::field::indicator::{CloudWalls, Indicator, IndicatorKind};
use crate::field::sizes::{
    BlockLevels, FinerBlocks, Layer, LayerPages, Octaves, SIDE, SampledOctaves, SizedClouds,
    in_finer_spacings,
};
use crate::frame::estimate::{MemoryEstimate, MemoryPlan};
use crate::grid::units::Isovalue;
use crate::grid::{BlockLevel, CellBox, LevelRegion, Mirror};
use crate::particles::sizes::Sizes;
use crate::surface::dual_mc::levels::{LevelField, LevelFields, cells_by_level, mixed_block_mesh};
use crate::surface::dual_mc::{Normals, block_mesh, dual_cells};
use crate::surface::mesh::BlockMesh;
use crate::system::control::Meter;

use super::sink::FieldSink;
use super::surface::{ExtractableField, cube_by_cube};
use super::{FrameError, Resources, SizedParticles, Surfacing};

/// The clouds (samples of the cloud indicator) of a frame's particles, for each octave of the
/// particles' sizes.
#[derive(Debug)]
pub(super) struct SampledSizes {
    pub(super) sampled: SampledOctaves,
    /// For each level of cells, the clouds of all octaves. Entry k has octave k as its first
    /// octave.
    clouds: Vec<SizedClouds>,
    /// For each level from 1 up, the blocks near particles of the next finer octave. They determine
    /// the levels of cells.
    finer: FinerBlocks,
    levels: BlockLevels,
}

/// Edge, in blocks, of a cube of blocks that are meshed together.
const BLOCKS_TOGETHER: i32 = 2;
/// Maximum number of bins whose pages are computed together, all of the same octave.
const BINS_PER_BATCH: usize = 1 << 7;

impl SampledSizes {
    /// Computes the clouds of particles whose last attributes are their sizes.
    pub(super) fn sample(
        bins: &Bins,
        facts: FrameFacts,
        sized: &SizedParticles,
        plan: MemoryPlan,
        estimate: &MemoryEstimate,
        resources: &Resources,
    ) -> Result<Self, FrameError> {
        let octaves = SampledOctaves::octaves(&facts, sized.sizes.coarsest);
        let octaves = octaves.ok_or(FrameError::NoSpacing)?;
        let in_scratch = resources.scratch_error();
        let shape = Octaves::INDICATOR.shape(SIDE);
        let size = |numbers: &[f32]| match numbers {
            [.., mass, density] if sized.columns.density.is_some() => {
                sized.sizes.of(*mass, *density)
            }
            [.., size] => sized.sizes.of(*size, 1.0),
            [] => sized.sizes.usual,
        };
        let layer = |octave: usize| {
            let facts = facts.in_octave(octave as u32);
            let pages = LayerPages::new(bins, octaves, octave, CloudWalls::of(&facts), &size);
            let sink = || FieldSink::new(plan, estimate, shape, &resources.scratch);
            let mut sinks = [sink().map_err(&in_scratch)?, sink().map_err(&in_scratch)?];
            for first in (0..pages.bins()).step_by(BINS_PER_BATCH) {
                resources.go_on()?;
                let groups = first..pages.bins().min(first + BINS_PER_BATCH);
                let (volumes, fractions) = pages.pages(groups).map_err(&in_scratch)?;
                for (sink, pages) in sinks.iter_mut().zip([volumes, fractions]) {
                    sink.push(pages, shape).map_err(&in_scratch)?;
                }
            }
            let [volume, fraction] =
                sinks.map(|sink| sink.finish(facts, Indicator::Cloud, shape).map_err(&in_scratch));
            Ok::<Layer, FrameError>(Layer { volume: volume?, fraction: fraction? })
        };
        let layers = (0..octaves.count).map(layer).collect::<Result<_, _>>()?;
        let Sizes { coarsest, density, .. } = sized.sizes;
        let sampled = SampledOctaves { facts, clouds: SizedClouds::new(layers), coarsest, density };
        Ok(Self::new(sampled, sized.finer.as_ref()))
    }

    /// Determines the levels of cells for sampled clouds from `finer`, or from the clouds if
    /// `finer` is `None`. In a periodic box, there is only one level.
    pub(super) fn new(sampled: SampledOctaves, finer: Option<&FinerBlocks>) -> Self {
        let clouds = &sampled.clouds;
        let finer = match (finer, sampled.facts.periodic) {
            // In a periodic box, all cells have the same width, because cells must match at
            // opposite faces.
            (_, Some(_)) => FinerBlocks::new(),
            (Some(finer), None) => finer.clone(),
            (None, None) => clouds.finer_blocks(),
        };
        let levels = BlockLevels::new(&finer);
        let clouds = (0..levels.count()).map(|level| clouds.from_octave(level)).collect();
        Self { sampled, clouds, finer, levels }
    }

    /// The field from which the surface is extracted.
    pub(super) fn extracted(
        &self,
        surfacing: &Surfacing,
        calibration: &Calibration,
    ) -> ExtractableField<'_> {
        let &Surfacing { smooth, sheets, normals, periodic_mesh, .. } = surfacing;
        let levels = &self.levels;
        let plateau = match *calibration {
            Calibration::Clouds { plateau } => plateau,
            Calibration::Indicator { .. } => self.sampled.calibrated().plateau.value(),
        };
        let facts = &self.sampled.facts;
        let walls = facts.mesh_walls(periodic_mesh).map(|walls| walls.cells());
        let of_level = |(level, clouds)| FieldOfLevel {
            field: SizedField::new(clouds, smooth, sheets, surfacing.solid.clone(), plateau),
            walls: walls.map(|walls| walls.in_wider_cells(level)),
        };
        let fields: Vec<_> = (0..).zip(&self.clouds).map(of_level).collect();
        let FieldOfLevel { field, .. } = &fields[0];
        let iso = field.iso();
        let cut = |region: LevelRegion| {
            let LevelRegion { level, cells } = region;
            // At a wall, wide cells can extend further than the narrow cells that touch them.
            let touches_wide = levels.of(level, region.block()).wider != 0;
            let within = if touches_wide {
                let wider = walls.map(|walls| walls.in_wider_cells(u32::from(level) + 1));
                wider.map(|wider| wider.in_narrower_cells(1))
            } else {
                walls.map(|walls| walls.in_wider_cells(level.into()))
            };
            let cut = |within: CellBox| cells.intersection(&within.grown(1, 0));
            LevelRegion { level, cells: within.map_or(cells, cut) }
        };
        let boxes = self.clouds[0].surface_boxes(field.reach());
        // Wide cells at a wall can extend beyond the wall, so the boxes get a margin.
        let beyond = 1 << levels.count();
        let near = walls.map(|walls| walls.grown(beyond, beyond));
        let boxes = boxes.map(|cells| near.map_or(cells, |near| cells.intersection(&near)));
        let regions = levels.regions(boxes.filter(|cells| !cells.is_empty())).into_iter();
        let regions = regions.map(cut).filter(|region| !region.cells.is_empty()).collect();
        // The filters use cells beyond a periodic face, but the mesh ends at the face.
        let faces = walls.filter(|_| facts.periodic.is_some());
        ExtractableField {
            regions,
            crossings: iso.into(),
            attribute_smoothing: self.attribute_smoothings(surfacing),
            empty_error: FrameError::no_surface(field.recipe(), surfacing.solid.as_deref()),
            contour: cube_by_cube(BLOCKS_TOGETHER, move |regions, meter| {
                let mut meshes = Vec::new();
                let is_uniform =
                    |region: &LevelRegion| levels.of(region.level, region.block()).is_uniform();
                // All regions of a cube have the same level.
                for regions in regions.chunk_by(|a, b| is_uniform(a) && is_uniform(b)) {
                    let of_level = &fields[usize::from(regions[0].level)];
                    if is_uniform(&regions[0]) {
                        let found = of_level.meshes(regions, faces, (iso, normals), meter);
                        meshes.extend(found.into_iter().flatten());
                    } else if meter.goes_on() {
                        meter.add(1);
                        let own = levels.seams(regions[0]).into_iter().chain([regions[0]]);
                        let own = own
                            .filter_map(|region| mixed_mesh(levels, &fields, region, iso, normals));
                        meshes.extend(own);
                    }
                }
                Ok(meshes)
            }),
        }
    }

    /// For each level of cells, the smoothing of attributes. It is as wide as the coarsest
    /// particles require.
    fn attribute_smoothings(&self, surfacing: &Surfacing) -> Vec<Smoothing> {
        let FrameFacts { grid, spacing, .. } = self.sampled.facts;
        let spacing = spacing.map(|spacing| spacing * self.coarsest());
        let grids = (0..self.levels.count() as u32).map(|level| grid.in_wider_cells(level));
        grids
            .map(|grid| surfacing.attribute_smoothing(IndicatorKind::Cloud, spacing, &grid))
            .collect()
    }

    /// The ratio of the coarsest octave's spacing to the finest octave's spacing.
    pub(super) fn coarsest(&self) -> f64 {
        f64::from(1_u32 << (self.clouds[0].octaves() - 1))
    }

    /// For each level from 1 up, the blocks near particles of the next finer octave.
    pub(super) fn finer_blocks(&self) -> &FinerBlocks {
        &self.finer
    }
}

/// The field, in the cells of one level.
struct FieldOfLevel<'a> {
    field: SizedField<'a>,
    /// The cells within the walls of the mesh.
    walls: Option<CellBox>,
}

impl FieldOfLevel<'_> {
    /// Meshes `regions` of blocks whose dual cells all have this level.
    fn meshes(
        &self,
        regions: &[LevelRegion],
        faces: Option<CellBox>,
        (iso, normals): (Isovalue, Normals),
        meter: &Meter<'_>,
    ) -> Vec<Option<BlockMesh>> {
        let walls = self.walls;
        let is_within_walls = |region| walls.is_none_or(|walls| walls.covers(&dual_cells(region)));
        let of =
            |region: &LevelRegion| (normals.cells(region.cells), is_within_walls(region.cells));
        let fields = self.field.on_each(regions.iter().map(of).collect());
        let mesh = |(region, field): (&LevelRegion, Option<Block>)| {
            meter.add(1);
            let mut field = field?;
            field.mirror(faces.map(Mirror::new));
            let mesh = block_mesh(&field, region.cells, iso, normals, walls)?;
            let level = BlockLevel { level: region.level, ..BlockLevel::default() };
            Some(BlockMesh { level, ..mesh })
        };
        let regions = regions.iter().take_while(|_| meter.goes_on());
        regions.zip(fields).map(mesh).collect()
    }

    /// The field on `cells`, or the side of the surface on which all of these cells lie.
    fn on(&self, cells: CellBox) -> Result<Block, BoxSide> {
        let is_within_walls = self.walls.is_none_or(|walls| walls.covers(&cells));
        self.field.crossed_on(cells.with_nearest_of(self.walls), is_within_walls)
    }

    /// Returns `field`. If it was not computed, because all of `cells` lie on one side of the
    /// surface, computes it now.
    fn completed(&self, field: Result<Block, BoxSide>, cells: CellBox) -> LevelField {
        let field = field.unwrap_or_else(|_| self.field.everywhere_on(cells));
        LevelField { field, walls: self.walls }
    }
}

/// The mesh of `region`, which is in a block whose dual cells have several levels.
fn mixed_mesh(
    levels: &BlockLevels,
    fields: &[FieldOfLevel<'_>],
    region: LevelRegion,
    iso: Isovalue,
    normals: Normals,
) -> Option<BlockMesh> {
    let (block, LevelRegion { level, cells }) = (region.block(), region);
    let of_block = levels.of(level, block);
    let [own, wide] = cells_by_level(block, of_block, cells);
    if own.is_empty() {
        return None;
    }
    // Gradient normals use samples one cell around both ends of an edge.
    let further = i32::from(normals == Normals::Gradient);
    let of_own = &fields[usize::from(level)];
    let of_wide = fields.get(usize::from(level) + 1).filter(|_| !wide.is_empty());
    let own = own.grown(further, further);
    let wide = if of_wide.is_some() { wide.grown(further, further) } else { wide };
    let found = of_own.on(own);
    let found_wide = of_wide.map(|of_wide| of_wide.on(wide));
    let sides = [Some(&found), found_wide.as_ref()].into_iter().flatten();
    if let Some(Some(_)) =
        sides.map(|found| found.as_ref().err()).reduce(|a, b| a.filter(|_| a == b))
    {
        return None;
    }
    let fields = LevelFields {
        own: of_own.completed(found, own),
        wide: of_wide.zip(found_wide).map(|(of_wide, found)| of_wide.completed(found, wide)),
        narrowed: in_finer_spacings,
    };
    mixed_block_mesh(&fields, (block, of_block), cells, iso, normals)
}
