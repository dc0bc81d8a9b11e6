//! Requests: the parameters for sampling a frame and for extracting its surface.

use std::sync::Arc;

use glam::IVec3;

use crate::backend::SizedField;
use crate::baselines::KernelMethod;
use crate::brick::{BrickSide, InvalidParticles};
use crate::field::blur::{Filter, Smoothing};
use crate::field::calibration::{
    Calibration, MeasuredCalibration, TooFine, calibrate, check_cell_size_for,
};
use crate::field::distance::{BULK_GAIN, DistanceFilters, InsideBricks};
use crate::field::indicator::{IndicatorKind, SampledDif, WideCells};
use crate::field::recipe::{Detail, Filters, PaperFilters, Recipe};
use crate::field::sizes::{FinerBlocks, Octaves};
use crate::field::solid::SolidFill;
use crate::frame::estimate::Extraction;
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

/// Sizes of particles, and the attributes that contain them.
#[derive(Debug, Clone, PartialEq)]
pub struct SizedParticles {
    /// The sizes.
    pub sizes: Sizes,
    /// The attributes.
    pub columns: SizeAttributes,
    /// The blocks near finer particles in the whole frame; `None` if the particles are the whole
    /// frame.
    pub finer: Option<FinerBlocks>,
}

/// The parameters for sampling a frame.
#[derive(Debug, Clone)]
pub struct Sampling {
    /// The grid of cells.
    pub grid: Grid,
    /// Walls, if the fluid is in a tank.
    pub domain: Option<Domain>,
    /// The periodic box, if there is one.
    pub periodic: Option<Periodic>,
    /// The method that computes the field.
    pub method: Method,
    /// Treatment of particles whose positions are not finite or too far from the grid's origin.
    pub invalid: InvalidParticles,
    /// The brick size of the DIF.
    pub side: BrickSide,
    /// The indices of the attributes to carry to the vertices.
    pub carried: Vec<usize>,
    /// The kinds of attributes, if they were determined on another frame for all frames.
    pub kinds: Vec<SettledKind>,
    /// The particles' spacing, if known: a packed frame stores it, and kernels need it. If
    /// particles have several sizes, this is the smallest size.
    pub spacing: Option<f64>,
    /// The sizes of the particles, if they differ; only for clouds.
    pub sizes: Option<SizedParticles>,
    /// The memory, folders and backend of the frame.
    pub resources: Resources,
}

impl Sampling {
    /// Checks the request as far as possible without a field.
    pub fn check_fit(&self, surfacing: &Surfacing) -> Result<(), FrameError> {
        match self.method {
            Method::Indicator { kind, mean } => {
                Ok(surfacing.check_cell_size(kind, mean, self.spacing, &self.grid)?)
            }
            Method::Kernels(_) => kernel_spacing(self.spacing, &self.grid).map(drop),
        }
    }

    /// Sets the sizes of the particles, if they have several sizes.
    ///
    /// # Errors
    /// [`SizeFault`] if an attribute with the sizes is missing.
    pub fn sized(
        self,
        sizes: Option<&Sizes>,
        particles: &dyn Particles,
    ) -> Result<Self, SizeFault> {
        let sized = |sizes: &Sizes| {
            let columns = sizes.columns(particles.attributes())?;
            Ok(SizedParticles { sizes: sizes.clone(), columns, finer: None })
        };
        Ok(Self { sizes: sizes.map(sized).transpose()?, ..self })
    }

    /// Sets the blocks near finer particles in the whole frame, if the particles are only a part of
    /// the frame and have several sizes.
    #[must_use]
    pub fn with_finer(mut self, finer: &FinerBlocks) -> Self {
        self.sizes.iter_mut().for_each(|sized| sized.finer = Some(finer.clone()));
        self
    }

    /// The indices of the attributes that are sorted with the particles: first the attributes for
    /// the vertices, then those with the sizes.
    #[must_use]
    pub fn sorted_attributes(&self) -> Vec<usize> {
        let sizes = self.sizes.iter().flat_map(|sized| sized.columns.numbers());
        self.carried.iter().copied().chain(sizes).collect()
    }

    /// The largest size, if the particles have several sizes.
    #[must_use]
    pub fn coarsest(&self) -> Option<f64> {
        self.sizes.as_ref().map(|sized| sized.sizes.coarsest)
    }

    /// The number of octaves of the particles' sizes. `coarsest` is the largest size, if the
    /// particles have several sizes.
    fn octaves(&self, coarsest: Option<f64>) -> usize {
        let cell = self.grid.cell_size();
        let sizes = self.spacing.zip(coarsest);
        sizes.map_or(1, |(finest, coarsest)| Octaves::new(finest, coarsest, cell).count)
    }

    /// The cells whose particles affect a block's mesh, for an indicator. Kernels are not
    /// supported. `coarsest` is the largest size, if the particles have several sizes.
    pub fn deciding_cells(
        &self,
        kind: IndicatorKind,
        surfacing: &Surfacing,
        coarsest: Option<f64>,
    ) -> DecidingCells {
        // `block` is a block of the widest cells, with its lowest corner at the origin. If there
        // are several levels, it is enlarged by four of the widest cells on each side, because dual
        // cells and normals use cells beyond its faces.
        let widest = if self.periodic.is_some() { 0 } else { self.octaves(coarsest) - 1 };
        let further = if widest == 0 { 0 } else { 4 << widest };
        let block = CellBox::cube(IVec3::ZERO, BLOCK << widest).grown(further, further);
        let cells = surfacing.normals.cells(block);
        let [field, halo] = surfacing.halos(kind, self.spacing, coarsest, &self.grid);
        let of_field = if coarsest.is_some() {
            cells.grown(field, field)
        } else {
            let filters = surfacing.filters(kind, self.spacing, &self.grid);
            // A particle also affects the cells around its own.
            let ghost_layer = kind.shape(self.side).ghost_layer;
            let further = ghost_layer + surfacing.fill_reach(self.spacing, &self.grid);
            filters.input_cells(cells).grown(further, further)
        };
        let of_attributes = if self.carried.is_empty() {
            CellBox::EMPTY
        } else {
            dual_cells(block).grown(halo, halo)
        };
        DecidingCells::new(of_field.union(&of_attributes))
    }
}

/// The width, in spacings, of the Gaussian that smooths attributes if the indicator is cloud.
const ATTRIBUTE_SMOOTHING: f64 = 0.8;

/// The parameters for extracting a surface. Kernels use only `normals` and `periodic_mesh`.
#[derive(Debug, Clone)]
pub struct Surfacing {
    /// The smoothing width; only for clouds.
    pub smooth: Smooth,
    /// The stretch at which sheets tear; only for clouds.
    pub sheets: SheetStretch,
    /// The Gaussian's width; if `None`, it follows from the frame's spacing. `sigma`, `iso` and
    /// `detail` apply only to counting and symmetry.
    pub sigma: Option<Sigma>,
    /// The isovalue; if `None`, a fraction of the frame's plateau.
    pub iso: Option<Isovalue>,
    /// The treatment of details that smoothing removes.
    pub detail: Detail,
    /// Whether vertices get normals.
    pub normals: Normals,
    /// How the mesh ends at the faces of a periodic box.
    pub periodic_mesh: PeriodicMesh,
    /// Whether the fluid ends at solids, which may be read later; only for clouds.
    pub at_solids: bool,
    /// The solids, once they are read.
    pub solid: Option<Arc<Solid>>,
}

impl Surfacing {
    /// A surface with the default smoothing for the frame's spacing, and without optional features
    /// such as normals or solids.
    pub const PLAIN: Self = Self {
        smooth: Smooth::DEFAULT,
        sheets: SheetStretch::DEFAULT,
        sigma: None,
        iso: None,
        detail: Detail::Smoothed,
        normals: Normals::None,
        periodic_mesh: PeriodicMesh::Cut,
        at_solids: false,
        solid: None,
    };

    /// Checks, from the particles' spacing and before there is a DIF, that the cells are not too
    /// fine for the surface. If the spacing is unknown, there is no check.
    ///
    /// # Errors
    /// [`TooFine`].
    pub fn check_cell_size(
        &self,
        kind: IndicatorKind,
        mean: Option<MeanCount>,
        spacing: Option<f64>,
        grid: &Grid,
    ) -> Result<(), TooFine> {
        let Some(known) = spacing else { return Ok(()) };
        let sigma = |cell_size| self.width(spacing, cell_size);
        check_cell_size_for(kind, mean, known, grid.cell_size(), sigma)
    }

    /// The Gaussian's width, given or derived from the spacing and the cell size.
    #[must_use]
    pub fn width(&self, spacing: Option<f64>, cell_size: f64) -> Sigma {
        let cells = |spacing: f64| spacing / cell_size;
        self.sigma.unwrap_or_else(|| Sigma::at_least_a_cell(spacing.map(cells)))
    }

    /// The filters for an indicator. For clouds, an unknown spacing is assumed to be one cell.
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

    /// The additional reach, in cells beyond the halo of the field, within which particles affect
    /// the continuation of the fluid into a solid; 0 without a solid.
    fn fill_reach(&self, spacing: Option<f64>, grid: &Grid) -> i32 {
        if !self.at_solids {
            return 0;
        }
        let wide = wide_cells(spacing, grid);
        (SolidFill::new(wide.edge).reach() + 1) << wide.level
    }

    /// Memory, in bytes, of the solids that were read.
    #[must_use]
    pub fn solid_bytes(&self) -> u64 {
        self.solid.as_ref().map_or(0, |solid| solid.bytes())
    }

    /// Memory, in bytes, for continuing the clouds of the fluid into a solid.
    fn fill_bytes(&self, filters: &Filters, spacing: Option<f64>, grid: &Grid) -> u64 {
        let Filters::Distances(distances) = filters else { return 0 };
        let further = self.fill_reach(spacing, grid);
        if further == 0 {
            return 0;
        }
        let blocks = CellBox { lo: IVec3::NEG_ONE, hi: IVec3::splat(2 * BLOCK + 2) };
        let wide = distances.wide_cells(blocks.grown(further, further));
        let fill = SolidFill::new(wide_cells(spacing, grid).edge);
        fill.bytes(wide.grown(distances.widest_halo(), distances.widest_halo()))
    }

    /// The quantities that determine the memory of the surface stages. `coarsest` is the largest
    /// size, if the particles have several sizes, and `components` lists the number of components
    /// of each attribute.
    pub(super) fn extraction(
        &self,
        method: Method,
        spacing: Option<f64>,
        coarsest: Option<f64>,
        grid: &Grid,
        components: Vec<usize>,
    ) -> Extraction {
        let spacing_cells = spacing.map(|spacing| spacing / grid.cell_size());
        let plain = Extraction {
            // Dual cells need one more cell upwards, and normals need one more cell in both
            // directions.
            block_bytes: KernelMethod::CELL_BYTES * ((BLOCK + 3) as u64).pow(3),
            carried_halo: attribute_smoothing(spacing.unwrap_or(0.0) / grid.cell_size()).halo(),
            keeps_details: false,
            spacing_cells,
            levels: 1,
            wide_levels: 0,
            normals: self.normals == Normals::Gradient,
            components,
        };
        let Some(kind) = method.indicator() else { return plain };
        let filters = self.filters(kind, spacing, grid);
        let (levels, block_bytes) = match spacing.zip(coarsest) {
            Some((finest, coarsest)) => {
                let cells = finest / grid.cell_size();
                let octaves = Octaves::new(finest, coarsest, grid.cell_size()).count;
                let bytes = SizedField::block_bytes(self.smooth, self.sheets, cells, octaves);
                (octaves, bytes)
            }
            None => (1, filters.block_bytes()),
        };
        Extraction {
            block_bytes: block_bytes + self.fill_bytes(&filters, spacing, grid),
            carried_halo: self.halos(kind, spacing, coarsest, grid)[1],
            keeps_details: filters.keeps_details(),
            levels,
            wide_levels: match kind {
                IndicatorKind::Cloud => WideCells::of_spacing(spacing_cells.unwrap_or(1.0)).level,
                IndicatorKind::Counting | IndicatorKind::Symmetry => 0,
            },
            ..plain
        }
    }

    /// How far beyond a periodic face, in cells, particles affect the surface inside the box.
    /// `coarsest` is the largest size, if the particles have several sizes.
    #[must_use]
    pub fn reach(
        &self,
        method: Method,
        spacing: Option<f64>,
        coarsest: Option<f64>,
        grid: &Grid,
    ) -> i32 {
        /// Number of cells beyond the face in which the field is needed: one for the dual cell
        /// across the face, one for normals, and one because the face can lie anywhere in its cell.
        const BEYOND: i32 = 3;
        let spacing_cells = spacing.map_or(1.0, |spacing| spacing / grid.cell_size());
        let [field, attributes] = match method {
            Method::Kernels(kernels) => {
                [kernels.reach(spacing_cells), attribute_smoothing(spacing_cells).halo()]
            }
            Method::Indicator { kind, .. } => self.halos(kind, spacing, coarsest, grid),
        };
        field.max(attributes) + BEYOND
    }

    /// The distances, in cells, within which particles affect the field and the attributes of a
    /// cell.
    fn halos(
        &self,
        kind: IndicatorKind,
        spacing: Option<f64>,
        coarsest: Option<f64>,
        grid: &Grid,
    ) -> [i32; 2] {
        let filled = self.fill_reach(spacing, grid);
        let sizes = spacing.zip(coarsest);
        let Some((finest, coarsest)) = sizes else {
            return [
                self.filters(kind, spacing, grid).halo() + filled,
                self.attribute_smoothing(kind, spacing, grid).halo(),
            ];
        };
        let cell = grid.cell_size();
        let coarser = Octaves::new(finest, coarsest, cell).count - 1;
        let widest = finest * f64::from(1_u32 << coarser);
        [
            (SizedField::halo(self.smooth, self.sheets, finest / cell) + filled) << coarser,
            self.attribute_smoothing(kind, Some(widest), grid).halo(),
        ]
    }

    /// Returns the smoothing of attributes. It is the smoothing of the field or, for clouds, a
    /// width between the width for drops and the width for the bulk.
    #[must_use]
    pub fn attribute_smoothing(
        &self,
        kind: IndicatorKind,
        spacing: Option<f64>,
        grid: &Grid,
    ) -> Smoothing {
        let cells = |spacing: f64| ATTRIBUTE_SMOOTHING * spacing / grid.cell_size();
        let sigma = match kind {
            IndicatorKind::Cloud => Sigma::at_least_a_cell(spacing.map(cells)),
            IndicatorKind::Symmetry | IndicatorKind::Counting => {
                self.width(spacing, grid.cell_size())
            }
        };
        Smoothing::new(kind, sigma)
    }

    /// Measures the calibration for a surface of a frame.
    ///
    /// # Errors
    /// [`TooFine`] if the field does not locate the surface precisely enough.
    pub fn calibrate(&self, frame: &SampledDif) -> Result<MeasuredCalibration, TooFine> {
        self.calibrate_for(frame, &Control::default())
    }

    /// Measures like [`calibrate`](Self::calibrate). Reports progress to `control`, which can also
    /// cancel the measurement. After a cancel, the result is meaningless.
    pub fn calibrate_for(
        &self,
        frame: &SampledDif,
        control: &Control,
    ) -> Result<MeasuredCalibration, TooFine> {
        let filters = self.filters(frame.indicator.kind(), frame.facts.spacing, &frame.facts.grid);
        calibrate(frame, &filters, self.iso, control)
    }

    /// The recipe from the DIF of a frame to its surface, with the calibration of this or another
    /// frame. The mu0 of the DIF does not change.
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

/// The wide cells for a spacing. An unknown spacing is assumed to be one cell.
fn wide_cells(spacing: Option<f64>, grid: &Grid) -> WideCells {
    WideCells::of_spacing(spacing.map_or(1.0, |spacing| spacing / grid.cell_size()))
}
