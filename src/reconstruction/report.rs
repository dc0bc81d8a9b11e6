//! A report on a surface: how it was sampled, measured and reduced.

use crate::backend::Work;
use crate::brick::FrameFacts;
use crate::field::calibration::{Calibrated, Calibration};
use crate::field::indicator::Indicator;
use crate::frame::{Engine, Method, Surfacing};
use crate::surface::simplify::TooSmall;
use crate::system::timings::Timings;

use super::Cells;
use super::warning::{Warning, of_frame};

/// A report on a surface: how it was sampled, measured and reduced.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Report {
    /// The cells that were chosen, unless the frame was packed, or is one of a simulation.
    pub cells: Option<Cells>,
    /// Whether the grid was moved to suit particles on a lattice.
    pub moved: bool,
    /// The grid, its walls, the spacing, and counts of particles by what became of them.
    pub facts: FrameFacts,
    /// The indicator that made the field; `None` for kernels.
    pub indicator: Option<Indicator>,
    /// The width in spacings that makes the water calm, for clouds.
    pub smooth: Option<f64>,
    /// The width of the Gaussian in cells, for the paper's indicators.
    pub sigma: Option<f64>,
    /// The calibration that the surface was drawn by; `None` for kernels.
    pub calibration: Option<Calibration>,
    /// The isovalue of kernels, where the method leaves a choice.
    pub kernel_iso: Option<f64>,
    /// The measurements on the frame, unless the calibration was given or a kernel method needs
    /// none.
    pub measured: Option<Calibrated>,
    /// Particles that are in no surface, at the least.
    pub lost: u64,
    /// Components that were left out, where any were to be.
    pub too_small: Option<TooSmall>,
    /// Triangles before simplifying and leaving out.
    pub whole_triangles: u64,
    /// Doubts about the surface, or about the request for it.
    pub warnings: Vec<Warning>,
    /// The processor, or the device by its name.
    pub backend: String,
    /// The work that a device did.
    pub on_device: Work,
    /// Threads that it was made by.
    pub threads: usize,
    /// How long each stage took.
    pub timings: Timings,
}

impl Report {
    /// A report on a frame that is not drawn yet.
    pub(crate) fn of(engine: &Engine, surfacing: &Surfacing) -> Self {
        let indicator = engine.dif().map(|sampled| sampled.indicator);
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

    /// A report on a frame of which nothing but this is known yet.
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

    /// Whether clouds make the field.
    #[must_use]
    pub fn is_clouds(&self) -> bool {
        self.indicator == Some(Indicator::Cloud)
    }

    /// The isovalue of the surface, where it is drawn by one.
    #[must_use]
    pub fn isovalue(&self) -> Option<f64> {
        self.calibration.and_then(|known| known.iso()).map(|iso| iso.value()).or(self.kernel_iso)
    }
}
