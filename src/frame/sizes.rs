//! A frame of particles of several sizes.

use crate::backend::SizedField;
use crate::brick::{Bins, Block, FrameFacts};
use crate::field::blur::Smoothing;
use crate::field::calibration::{Calibration, MeasuredCalibration, Plateau};
use crate::field::distance::UNITS;
use crate::field::indicator::{Indicator, IndicatorKind};
use crate::field::sizes::{Layer, LayerPages, Octaves, SIDE, SizedClouds};
use crate::frame::estimate::{MemoryEstimate, MemoryPlan};
use crate::grid::CellBox;
use crate::surface::dual_mc::{block_mesh, dual_cells};

use super::sink::FieldSink;
use super::surface::{ExtractableField, cube_by_cube};
use super::{FrameError, Resources, SizedParticles, Surfacing};

/// The clouds of a frame's particles, by octaves of their sizes.
#[derive(Debug)]
pub(super) struct SampledSizes {
    pub(super) facts: FrameFacts,
    clouds: SizedClouds,
    /// The particles' volume per cubed unit deep in the fluid, if it is known.
    density: Option<f64>,
}

/// Edge of a cube of blocks that are meshed together, in blocks.
const BLOCKS_TOGETHER: i32 = 2;
/// Bins of an octave per batch of pages.
const TOGETHER: usize = 1 << 7;

impl SampledSizes {
    /// Makes the clouds of particles whose last attributes are their sizes.
    pub(super) fn sample(
        bins: &Bins,
        facts: FrameFacts,
        sized: &SizedParticles,
        plan: MemoryPlan,
        estimate: &MemoryEstimate,
        resources: &Resources,
    ) -> Result<Self, FrameError> {
        let finest = facts.spacing.ok_or(FrameError::NoSpacing)?;
        let octaves = Octaves::new(finest, sized.sizes.coarsest, facts.grid.cell_size());
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
            let facts = in_octave(&facts, octave as u32);
            let pages = LayerPages::new(bins, octaves, octave, facts.walls(), &size);
            let sink = || FieldSink::new(plan, estimate, shape, &resources.scratch);
            let mut sinks = [sink().map_err(&in_scratch)?, sink().map_err(&in_scratch)?];
            for first in (0..pages.bins()).step_by(TOGETHER) {
                resources.go_on()?;
                let groups = first..pages.bins().min(first + TOGETHER);
                let (volumes, fractions) = pages.pages(groups).map_err(&in_scratch)?;
                for (sink, pages) in sinks.iter_mut().zip([volumes, fractions]) {
                    sink.push(pages, shape).map_err(&in_scratch)?;
                }
            }
            let coarser = (octaves.count - 1 - octave) as u32;
            let [volume, fraction] = sinks.map(|sink| {
                let field = sink.finish(facts, Indicator::Cloud, shape);
                Ok::<_, FrameError>(field.map_err(&in_scratch)?.with_more_levels(coarser))
            });
            Ok::<Layer, FrameError>(Layer { volume: volume?, fraction: fraction? })
        };
        let layers = (0..octaves.count).map(layer).collect::<Result<_, _>>()?;
        Ok(Self { facts, clouds: SizedClouds::new(layers), density: sized.sizes.density })
    }

    /// The calibration of this frame, from its density.
    pub(super) fn calibrated(&self) -> MeasuredCalibration {
        let nominal = Plateau::nominal(self.facts.spacing_cells_or_one());
        let value = (nominal * self.density.unwrap_or(1.0)).round() as u16;
        let plateau = match self.density {
            Some(_) => Plateau::Interior { median: value, lowest: value },
            None => Plateau::Shallow { expected: value },
        };
        let step_cells = self.facts.spacing_cells_or_one() / UNITS;
        MeasuredCalibration {
            calibration: Calibration::Clouds { plateau: value },
            plateau,
            step_cells,
        }
    }

    /// The field from which the surface is extracted.
    pub(super) fn extracted(
        &self,
        surfacing: &Surfacing,
        calibration: &Calibration,
    ) -> ExtractableField<'_> {
        let &Surfacing { smooth, sheets, normals, periodic_mesh, .. } = surfacing;
        let plateau = match *calibration {
            Calibration::Clouds { plateau } => plateau,
            Calibration::Indicator { .. } => self.calibrated().plateau.value(),
        };
        let field = SizedField::new(&self.clouds, smooth, sheets, surfacing.solid.clone(), plateau);
        let iso = field.iso();
        let walls = self.facts.mesh_walls(periodic_mesh).map(|walls| walls.cells());
        let within = walls.map(|walls| walls.grown(1, 0));
        let cut = |cells: CellBox| within.map_or(cells, |within| cells.intersection(&within));
        let regions = self.clouds.regions(field.reach()).into_iter().map(cut);
        // The filters use cells beyond a periodic face, but the mesh ends there.
        let faces = walls.filter(|_| self.facts.periodic.is_some());
        ExtractableField {
            regions: regions.filter(|cells| !cells.is_empty()).collect(),
            crossings: iso.into(),
            attribute_smoothing: self.attribute_smoothing(surfacing),
            nothing: FrameError::no_surface(field.recipe()),
            contour: cube_by_cube(BLOCKS_TOGETHER, move |regions, meter| {
                let away = |region| walls.is_none_or(|walls| walls.covers(&dual_cells(region)));
                let boxes = regions.iter().map(|&region| (normals.cells(region), away(region)));
                let fields = field.on_each(boxes.collect());
                let mesh = |(&region, field): (&CellBox, Option<Block>)| {
                    meter.add(1);
                    let mut field = field?;
                    faces.into_iter().for_each(|faces| field.repeat_edges(faces));
                    block_mesh(&field, region, iso, normals, walls)
                };
                let regions = regions.iter().take_while(|_| meter.goes_on());
                Ok(regions.zip(fields).filter_map(mesh).collect())
            }),
        }
    }

    /// Attributes are smoothed as widely as the coarsest particles need.
    fn attribute_smoothing(&self, surfacing: &Surfacing) -> Smoothing {
        let spacing = self.facts.spacing.map(|spacing| spacing * self.coarsest());
        surfacing.attribute_smoothing(IndicatorKind::Cloud, spacing, &self.facts.grid)
    }

    /// The spacing of the coarsest octave over that of the finest.
    pub(super) fn coarsest(&self) -> f64 {
        f64::from(1_u32 << (self.clouds.octaves() - 1))
    }
}

/// The facts of a frame on the grid of an octave.
fn in_octave(facts: &FrameFacts, octave: u32) -> FrameFacts {
    FrameFacts {
        grid: facts.grid.in_wider_cells(octave),
        domain: facts.domain.map(|domain| domain.in_wider_cells(octave)),
        periodic: facts.periodic.map(|periodic| periodic.in_wider_cells(octave)),
        spacing: facts.spacing.map(|spacing| spacing * f64::from(1_u32 << octave)),
        ..*facts
    }
}
