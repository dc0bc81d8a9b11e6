//! Requests: how a frame is sampled, and how a surface is drawn through it.

use std::sync::Arc;

use glam::IVec3;

use crate::baselines::KernelMethod;
use crate::brick::{BrickSide, InvalidParticles};
use crate::field::blur::{Filter, Smoothing};
use crate::field::calibration::{
    Calibration, MeasuredCalibration, TooFine, calibrate, refuse_too_fine_for,
};
use crate::field::distance::{BULK_GAIN, DistanceFilters, InsideBricks};
use crate::field::indicator::{IndicatorKind, SampledDif, WideCells};
use crate::field::recipe::{Detail, Filters, PaperFilters, Recipe};
use crate::field::solid::SolidFill;
use crate::frame::estimate::Drawing;
use crate::grid::stretch::DecidingCells;
use crate::grid::units::{Isovalue, MeanCount, SheetStretch, Sigma, Smooth};
use crate::grid::{BLOCK, CellBox, Domain, Grid, Periodic, PeriodicMesh};
use crate::particles::Particles;
use crate::particles::kind::SettledKind;
use crate::particles::sizes::{SizeAttributes, SizeFault, Sizes};
use crate::surface::dual_mc::{Normals, dual_cells};
use crate::surface::solid::Solid;
use crate::system::control::Control;

use super::kernels::{attribute_smoothing, kernel_spacing};
use super::{FrameError, Method, Resources};

/// Sizes of particles, and the attributes that tell them.
#[derive(Debug, Clone, PartialEq)]
pub struct SizedParticles {
    /// The sizes.
    pub sizes: Sizes,
    /// The attributes.
    pub columns: SizeAttributes,
}

/// How a frame is sampled.
#[derive(Debug, Clone)]
pub struct Sampling {
    /// Cells.
    pub grid: Grid,
    /// Walls, if the fluid is in a tank.
    pub domain: Option<Domain>,
    /// The box that repeats itself, if one does.
    pub periodic: Option<Periodic>,
    /// How the field is made.
    pub method: Method,
    /// Treatment of particles that are not finite or too far away.
    pub invalid: InvalidParticles,
    /// How a DIF is stored.
    pub side: BrickSide,
    /// The numbers of the attributes to carry to the vertices.
    pub carried: Vec<usize>,
    /// The kinds of attributes that another frame has settled for all.
    pub kinds: Vec<SettledKind>,
    /// The particles' spacing, where it is known: a packed frame keeps it, and kernels have to know
    /// it. Of particles of several sizes the smallest.
    pub spacing: Option<f64>,
    /// The sizes of the particles, where they have several; of clouds alone.
    pub sizes: Option<SizedParticles>,
    /// Memory, folders and backend that the frame may use.
    pub resources: Resources,
}

impl Sampling {
    /// Refuses what no field can be made with, or no surface be drawn, as far as it is known before
    /// there is a field.
    pub fn refuse_unfit(&self, surfacing: &Surfacing) -> Result<(), FrameError> {
        match self.method {
            Method::Indicator { kind, mean } => {
                Ok(surfacing.refuse_too_fine(kind, mean, self.spacing, &self.grid)?)
            }
            Method::Kernels(_) => kernel_spacing(self.spacing, &self.grid).map(drop),
        }
    }

    /// Sampling of particles of several sizes, if there are `sizes`.
    ///
    /// # Errors
    /// [`SizeFault`] if an attribute with the sizes is missing.
    pub fn sized(
        self,
        sizes: Option<&Sizes>,
        particles: &(impl Particles + ?Sized),
    ) -> Result<Self, SizeFault> {
        let sized = |sizes: &Sizes| {
            let columns = sizes.columns(particles.attributes())?;
            Ok(SizedParticles { sizes: sizes.clone(), columns })
        };
        Ok(Self { sizes: sizes.map(sized).transpose()?, ..self })
    }

    /// The numbers of the attributes that are sorted with the particles: those that go to the
    /// vertices, and then those that tell sizes.
    #[must_use]
    pub fn sorted_attributes(&self) -> Vec<usize> {
        let sizes = self.sizes.iter().flat_map(|sized| sized.columns.numbers());
        self.carried.iter().copied().chain(sizes).collect()
    }

    /// The cells whose particles decide a block's mesh, by an indicator. No kernel is asked for
    /// here.
    pub fn sight(&self, kind: IndicatorKind, surfacing: &Surfacing) -> DecidingCells {
        let block = CellBox::cube(IVec3::ZERO, BLOCK);
        let filters = surfacing.filters(kind, self.spacing, &self.grid);
        // A particle leaves something in the cells around its own.
        let ghost_layer = kind.shape(self.side).ghost_layer;
        let further = ghost_layer + surfacing.fill_reach(self.spacing, &self.grid);
        let of_field = filters.seen(surfacing.normals.cells(block)).grown(further, further);
        let halo = surfacing.attribute_smoothing(kind, self.spacing, &self.grid).halo();
        let of_attributes = if self.carried.is_empty() {
            CellBox::EMPTY
        } else {
            dual_cells(block).grown(halo, halo)
        };
        DecidingCells::new(of_field.union(&of_attributes))
    }
}

/// How wide a Gaussian smooths the attributes of clouds, in spacings.
const ATTRIBUTES_SMOOTHED: f64 = 0.8;

/// How a surface is drawn through a frame. For kernels only the normals have a meaning.
#[derive(Debug, Clone)]
pub struct Surfacing {
    /// How calm the water is; of clouds alone.
    pub smooth: Smooth,
    /// How far sheets are stretched until they tear; of clouds alone.
    pub sheets: SheetStretch,
    /// The Gaussian's width; that of the frame's spacing where it is `None`. Of the paper's
    /// indicators, as the next two.
    pub sigma: Option<Sigma>,
    /// The isovalue; a share of the frame's plateau where it is `None`.
    pub iso: Option<Isovalue>,
    /// How details are treated that smoothing loses.
    pub detail: Detail,
    /// Normals on the vertices, or not.
    pub normals: Normals,
    /// Where the mesh ends at the faces of a periodic box.
    pub periodic_mesh: PeriodicMesh,
    /// Solids that the fluid ends at, if there are any; of clouds alone.
    pub solid: Option<Arc<Solid>>,
}

impl Surfacing {
    /// A surface as smooth as the frame's spacing says, and nothing else.
    pub const PLAIN: Self = Self {
        smooth: Smooth::DEFAULT,
        sheets: SheetStretch::DEFAULT,
        sigma: None,
        iso: None,
        detail: Detail::Smoothed,
        normals: Normals::None,
        periodic_mesh: PeriodicMesh::Cut,
        solid: None,
    };

    /// Refuses cells that are too fine for it, as far as the particles' spacing tells before there
    /// is a DIF.
    ///
    /// # Errors
    /// [`TooFine`].
    pub fn refuse_too_fine(
        &self,
        kind: IndicatorKind,
        mean: Option<MeanCount>,
        spacing: Option<f64>,
        grid: &Grid,
    ) -> Result<(), TooFine> {
        let Some(known) = spacing else { return Ok(()) };
        let sigma = |cell_size| self.width(spacing, cell_size);
        refuse_too_fine_for(kind, mean, known, grid.cell_size(), sigma)
    }

    /// The Gaussian's width, asked for or not, for particles so far apart in cells of a size.
    #[must_use]
    pub fn width(&self, spacing: Option<f64>, cell_size: f64) -> Sigma {
        let cells = |spacing: f64| spacing / cell_size;
        self.sigma.unwrap_or_else(|| Sigma::at_least_a_cell(spacing.map(cells)))
    }

    /// Clouds of particles whose spacing is not known are taken to be those of particles a cell
    /// apart.
    fn filters(&self, kind: IndicatorKind, spacing: Option<f64>, grid: &Grid) -> Filters {
        match kind {
            IndicatorKind::Cloud => {
                let cells = spacing.map_or(1.0, |spacing| spacing / grid.cell_size());
                Filters::Distances(Box::new(DistanceFilters::new(self.smooth, self.sheets, cells)))
            }
            IndicatorKind::Symmetry | IndicatorKind::Counting => {
                let sigma = self.width(spacing, grid.cell_size());
                Filters::Paper(PaperFilters::new(kind, sigma, self.detail))
            }
        }
    }

    /// How far particles beyond the halo of the field influence its continuation into a solid, in
    /// cells; 0 without a solid.
    fn fill_reach(&self, spacing: Option<f64>, grid: &Grid) -> i32 {
        if self.solid.is_none() {
            return 0;
        }
        let wide = WideCells::of_spacing(spacing.map_or(1.0, |spacing| spacing / grid.cell_size()));
        (SolidFill::new(wide.edge).reach() + 1) << wide.level
    }

    /// Bytes that clouds take while they are continued into a solid.
    fn fill_bytes(&self, filters: &Filters, spacing: Option<f64>, grid: &Grid) -> u64 {
        let Filters::Distances(distances) = filters else { return 0 };
        let further = self.fill_reach(spacing, grid);
        if further == 0 {
            return 0;
        }
        let blocks = CellBox { lo: IVec3::NEG_ONE, hi: IVec3::splat(2 * BLOCK + 2) };
        let wide = distances.wide_cells(blocks.grown(further, further));
        SolidFill::bytes(wide.grown(distances.wide_halo(), distances.wide_halo()))
    }

    /// Memory of the surface, for a spacing in cells and the components of its attributes.
    pub(super) fn drawing(
        &self,
        method: Method,
        spacing: Option<f64>,
        grid: &Grid,
        components: Vec<usize>,
    ) -> Drawing {
        let spacing_cells = spacing.map(|spacing| spacing / grid.cell_size());
        let plain = Drawing {
            // Dual cells reach one cell up, and normals one cell each way.
            block_bytes: KernelMethod::CELL_BYTES * ((BLOCK + 3) as u64).pow(3),
            carried_halo: attribute_smoothing(spacing.unwrap_or(0.0) / grid.cell_size()).halo(),
            keeps_details: false,
            spacing_cells,
            wide_levels: 0,
            normals: self.normals == Normals::Gradient,
            components,
        };
        let Some(kind) = method.indicator() else { return plain };
        let filters = self.filters(kind, spacing, grid);
        Drawing {
            block_bytes: filters.block_bytes() + self.fill_bytes(&filters, spacing, grid),
            carried_halo: self.attribute_smoothing(kind, spacing, grid).halo(),
            keeps_details: filters.keeps_details(),
            wide_levels: match kind {
                IndicatorKind::Cloud => WideCells::of_spacing(spacing_cells.unwrap_or(1.0)).level,
                IndicatorKind::Counting | IndicatorKind::Symmetry => 0,
            },
            ..plain
        }
    }

    /// How far beyond a periodic face particles tell of the surface before it, in cells.
    #[must_use]
    pub fn reach(&self, method: Method, spacing: Option<f64>, grid: &Grid) -> i32 {
        /// Cells beyond the face whose field is needed: a dual cell that goes across it, and
        /// normals there; and one for where in its cell the face is.
        const BEYOND: i32 = 3;
        let spacing_cells = spacing.map_or(1.0, |spacing| spacing / grid.cell_size());
        let [field, attributes] = match method {
            Method::Kernels(kernels) => {
                [kernels.reach(spacing_cells), attribute_smoothing(spacing_cells).halo()]
            }
            Method::Indicator { kind, .. } => [
                self.filters(kind, spacing, grid).halo(),
                self.attribute_smoothing(kind, spacing, grid).halo(),
            ],
        };
        field.max(attributes) + BEYOND
    }

    /// Returns the smoothing of attributes: the field's, or for clouds one of a width between drops
    /// and bulk.
    #[must_use]
    pub fn attribute_smoothing(
        &self,
        kind: IndicatorKind,
        spacing: Option<f64>,
        grid: &Grid,
    ) -> Smoothing {
        let cells = |spacing: f64| ATTRIBUTES_SMOOTHED * spacing / grid.cell_size();
        let sigma = match kind {
            IndicatorKind::Cloud => Sigma::at_least_a_cell(spacing.map(cells)),
            IndicatorKind::Symmetry | IndicatorKind::Counting => {
                self.width(spacing, grid.cell_size())
            }
        };
        Smoothing::new(kind, sigma)
    }

    /// Measures what a surface through a frame has to know.
    ///
    /// # Errors
    /// [`TooFine`] where the field does not tell finely enough where the surface is.
    pub fn calibrate(&self, frame: &SampledDif) -> Result<MeasuredCalibration, TooFine> {
        self.calibrate_for(frame, &Control::default())
    }

    /// Measures as [`calibrate`](Self::calibrate) does: `control` hears of the progress and can
    /// cancel, and what is measured then is worth nothing.
    pub fn calibrate_for(
        &self,
        frame: &SampledDif,
        control: &Control,
    ) -> Result<MeasuredCalibration, TooFine> {
        let filters = self.filters(frame.indicator.kind(), frame.facts.spacing, &frame.facts.grid);
        calibrate(frame, &filters, self.iso, control)
    }

    /// From the DIF of a frame to its surface, by what was measured on it or on another. The frame
    /// keeps the mu0 that its DIF was made by.
    #[must_use]
    pub fn recipe(&self, frame: &SampledDif, calibration: &Calibration) -> Recipe {
        let filters = self.filters(frame.indicator.kind(), frame.facts.spacing, &frame.facts.grid);
        match (filters, *calibration) {
            (Filters::Paper(paper), Calibration::Indicator { iso, .. }) => {
                Recipe::of_paper(paper, iso)
            }
            (Filters::Distances(distances), Calibration::Clouds { plateau }) => {
                let wide = frame.wide_cells();
                let samples = f64::from(plateau) / f64::from(1 << BULK_GAIN);
                let inside = InsideBricks::of(frame.wide(wide.level), wide.edge, samples);
                Recipe::of_distances(distances.with_plateau(plateau).skipping(inside))
            }
            _ => unreachable!("filters and calibration are of one indicator"),
        }
    }
}
