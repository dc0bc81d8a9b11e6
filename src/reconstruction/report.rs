//! A report on a surface: how it was sampled, measured and reduced.

use std::mem::take;

use crate::backend::Work;
use crate::brick::FrameFacts;
use crate::field::calibration::{Calibration, MeasuredCalibration};
use crate::field::indicator::Indicator;
use crate::frame::{Engine, Method, Surfacing};
use crate::surface::simplify::TooSmall;
use crate::system::timings::Timings;

use super::Cells;
use super::warning::{Warning, of_frame, with_spacing_warnings};

/// A report on a surface: how it was sampled, measured and reduced.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Report {
    /// The chosen cells; `None` for packed frames and frames of a simulation.
    pub cells: Option<Cells>,
    /// Whether the grid was moved because the particles are on a lattice.
    pub moved: bool,
    /// The grid, its walls, the spacing, and counts of used and skipped particles.
    pub facts: FrameFacts,
    /// The indicator; `None` for kernel methods.
    pub indicator: Option<Indicator>,
    /// The smoothing width in spacings, for clouds.
    pub smooth: Option<f64>,
    /// The standard deviation of the Gaussian in cells, for counting and symmetry.
    pub sigma: Option<f64>,
    /// The calibration of the surface; `None` for kernel methods.
    pub calibration: Option<Calibration>,
    /// The isovalue, if the method is a kernel method with an isovalue.
    pub kernel_iso: Option<f64>,
    /// The values measured for the calibration; `None` if the caller supplied it, or for kernel
    /// methods.
    pub measured: Option<MeasuredCalibration>,
    /// Lower bound on the number of particles outside the surface.
    pub lost: u64,
    /// Components that were left out; `None` if the mesh was not simplified and no limit was set.
    pub too_small: Option<TooSmall>,
    /// Triangles before simplification and the removal of components.
    pub whole_triangles: u64,
    /// Warnings about the surface or the request.
    pub warnings: Vec<Warning>,
    /// The CPU, or the name of the device.
    pub backend: String,
    /// Counts of the work that a device did.
    pub on_device: Work,
    /// Number of threads.
    pub threads: usize,
    /// Time of each stage.
    pub timings: Timings,
}

impl Report {
    /// A report on a frame whose surface has not been made yet.
    pub(crate) fn of(engine: &Engine, surfacing: &Surfacing) -> Self {
        let indicator = engine.indicator();
        let kernel_iso = match engine.method() {
            Method::Kernels(kernels) => kernels.iso(),
            Method::Indicator { .. } => None,
        };
        Self {
            kernel_iso,
            warnings: of_frame(engine),
            ..Self::of_facts(*engine.facts(), indicator, surfacing, engine.backend())
        }
    }

    /// A report that contains only the given facts.
    pub(crate) fn of_facts(
        facts: FrameFacts,
        indicator: Option<Indicator>,
        surfacing: &Surfacing,
        backend: String,
    ) -> Self {
        let clouds = indicator == Some(Indicator::Cloud);
        let of_paper = indicator.filter(|_| !clouds);
        Self {
            cells: None,
            moved: false,
            indicator,
            smooth: clouds.then(|| surfacing.smooth.spacings()),
            sigma: of_paper.map(|_| surfacing.width(facts.spacing, facts.grid.cell_size()).cells()),
            calibration: None,
            kernel_iso: None,
            measured: None,
            lost: 0,
            too_small: None,
            whole_triangles: 0,
            warnings: Vec::new(),
            backend,
            on_device: Work::default(),
            threads: rayon::current_num_threads(),
            timings: Timings::default(),
            facts,
        }
    }

    /// Adds the chosen cells, with the warnings about their spacing.
    pub(crate) fn add_cells(&mut self, cells: Option<Cells>, moved: bool) {
        self.warnings = with_spacing_warnings(cells.as_ref(), take(&mut self.warnings));
        (self.cells, self.moved) = (cells, moved);
    }

    /// Whether the field is computed from clouds.
    #[must_use]
    pub fn is_clouds(&self) -> bool {
        self.indicator == Some(Indicator::Cloud)
    }

    /// The isovalue of the surface; `None` for clouds.
    #[must_use]
    pub fn isovalue(&self) -> Option<f64> {
        self.calibration.and_then(|known| known.iso()).map(|iso| iso.value()).or(self.kernel_iso)
    }
}
