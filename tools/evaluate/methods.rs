//! The compared methods of this library, all of which use the same grid.

use glam::DVec3;
use meniscus::internals::baselines::KernelMethod;
use meniscus::internals::brick::InvalidParticles;
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::frame::{
    self, Detail, Engine, FrameError, Normals, Resources, Sampling, Shortfall, Surfacing,
};
use meniscus::internals::grid::Grid;
use meniscus::internals::grid::units::{Isovalue, MemoryBudget, Sigma};
use meniscus::internals::particles::Particles;
use meniscus::internals::surface::stitch::StitchedSurface;
use meniscus::internals::system::timings::Timings;

use crate::Outcome;

/// A method for computing a surface from particles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Method {
    /// A discrete indicator function, smoothed and contoured.
    Dif { indicator: IndicatorKind, sigma: Sigmas, iso: Iso, detail: Detail },
    /// A kernel method.
    Kernels(KernelMethod),
}

/// The width of the Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sigmas {
    /// The spacing, but at least a cell.
    Auto,
    /// This many cells.
    Cells(f64),
}

/// The isovalue of the smoothed field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Iso {
    /// The library's default share of the interior plateau.
    Auto,
    /// A fixed value.
    At(f64),
}

pub const COUNTING: IndicatorKind = IndicatorKind::Counting;
pub const CLOUD: IndicatorKind = IndicatorKind::Cloud;

impl Method {
    pub const SYMMETRY: Self = Self::by_default(IndicatorKind::Symmetry, Detail::Smoothed);
    pub const COUNTING: Self = Self::by_default(COUNTING, Detail::Smoothed);
    pub const CLOUD: Self = Self::by_default(CLOUD, Detail::Smoothed);
    pub const MUELLER: Self = Self::Kernels(KernelMethod::Mueller { iso: KernelMethod::HALF });
    pub const ZHU_BRIDSON: Self = Self::Kernels(KernelMethod::ZhuBridson);
    pub const YU_TURK: Self = Self::Kernels(KernelMethod::YuTurk { iso: KernelMethod::HALF });
    /// Our method and the paper's five methods, with isovalues half-way between inside and outside.
    pub const ALL: &[Self] = &[
        Self::CLOUD,
        Self::SYMMETRY,
        Self::COUNTING,
        Self::MUELLER,
        Self::ZHU_BRIDSON,
        Self::YU_TURK,
    ];
    /// The methods of [`ALL`](Self::ALL), and four of them again with other isovalues: those of the
    /// paper, and those that suit a lattice of particles best.
    pub const WITH_OTHER_ISOVALUES: &[Self] = &[
        Self::CLOUD,
        Self::SYMMETRY,
        Self::COUNTING,
        Self::MUELLER,
        Self::ZHU_BRIDSON,
        Self::YU_TURK,
        Self::symmetry(1.0, Iso::At(0.1)),
        Self::counting(1.0, Iso::At(0.1)),
        Self::Kernels(KernelMethod::Mueller { iso: 0.65 }),
        Self::Kernels(KernelMethod::YuTurk { iso: 0.2 }),
    ];

    pub const fn symmetry(sigma: f64, iso: Iso) -> Self {
        Self::Dif {
            indicator: IndicatorKind::Symmetry,
            sigma: Sigmas::Cells(sigma),
            iso,
            detail: Detail::Smoothed,
        }
    }

    pub const fn counting(sigma: f64, iso: Iso) -> Self {
        Self::Dif {
            indicator: COUNTING,
            sigma: Sigmas::Cells(sigma),
            iso,
            detail: Detail::Smoothed,
        }
    }

    /// The symmetry and counting indicators with default settings, except for `detail`.
    pub fn detailed(detail: Detail) -> [Self; 2] {
        [IndicatorKind::Symmetry, COUNTING].map(|indicator| Self::by_default(indicator, detail))
    }

    const fn by_default(indicator: IndicatorKind, detail: Detail) -> Self {
        Self::Dif { indicator, sigma: Sigmas::Auto, iso: Iso::Auto, detail }
    }

    /// The method's name in tables.
    pub fn name(&self) -> String {
        match *self {
            Self::Dif { indicator, sigma, iso, detail } => {
                let filter = match sigma {
                    Sigmas::Auto => String::new(),
                    Sigmas::Cells(sigma) => format!(", sigma {sigma}"),
                };
                let at = match iso {
                    Iso::Auto => String::new(),
                    Iso::At(c) => format!(", c {c}"),
                };
                let detail = match detail {
                    Detail::Smoothed => "",
                    Detail::Recovered => ", details recovered",
                };
                format!("{}{filter}{at}{detail}", indicator.name())
            }
            Self::Kernels(KernelMethod::Mueller { iso }) => format!("Mueller, iso {iso}"),
            Self::Kernels(KernelMethod::ZhuBridson) => "Zhu-Bridson".into(),
            Self::Kernels(KernelMethod::YuTurk { iso }) => format!("Yu-Turk, iso {iso}"),
        }
    }

    /// The method's name in file names.
    pub fn slug(&self) -> String {
        self.name().to_lowercase().replace(", ", "-").replace(' ', "-")
    }

    /// Computes the surface of particles with this method.
    pub fn surface<P: Particles + ?Sized>(
        &self,
        particles: &P,
        grid: Grid,
        spacing: f64,
        normals: Normals,
        timings: &mut Timings,
    ) -> Result<StitchedSurface, FrameError> {
        let (method, surfacing): (frame::Method, _) = match *self {
            Self::Dif { indicator, sigma, iso, detail } => {
                (indicator.into(), Surfacing { detail, ..surfacing(sigma.value(), iso.value()) })
            }
            Self::Kernels(kernels) => (kernels.into(), Surfacing::PLAIN),
        };
        let frame = Engine::sample(&particles, &sampling(grid, spacing, method), timings)?;
        frame.surface(&Surfacing { normals, ..surfacing }, timings)
    }
}

impl Sigmas {
    pub fn value(self) -> Option<Sigma> {
        match self {
            Self::Auto => None,
            Self::Cells(cells) => Some(Sigma::new(cells).expect("a valid sigma")),
        }
    }
}

impl Iso {
    pub fn value(self) -> Option<Isovalue> {
        match self {
            Self::Auto => None,
            Self::At(c) => Some(Isovalue::new(c).expect("between 0 and 1")),
        }
    }
}

/// The volume inside a surface, divided by the volume of its particles. Returns an error if the
/// surface encloses too little volume, because its time would then be meaningless.
pub fn volume_ratio(surface: &StitchedSurface, particles: usize, spacing: f64) -> Outcome<f64> {
    match Shortfall::of(surface, None, particles, None, spacing)? {
        None => Ok(surface.volume()? / (particles as f64 * spacing.powi(3))),
        Some(shortfall) => {
            Err(format!("the timed surface does not enclose the fluid: {shortfall}").into())
        }
    }
}

pub fn grid(cell: f64) -> Outcome<Grid> {
    Ok(Grid::new(DVec3::ZERO, cell)?)
}

/// Settings for sampling on the CPU, without a memory limit.
pub fn sampling(grid: Grid, spacing: f64, method: impl Into<frame::Method>) -> Sampling {
    let method = method.into();
    Sampling {
        grid,
        domain: None,
        periodic: None,
        method,
        invalid: InvalidParticles::Refuse,
        side: method.brick_side(),
        carried: Vec::new(),
        kinds: Vec::new(),
        sizes: None,
        spacing: Some(spacing),
        resources: Resources::new(MemoryBudget(u64::MAX), std::env::temp_dir()),
    }
}

pub fn surfacing(sigma: Option<Sigma>, iso: Option<Isovalue>) -> Surfacing {
    Surfacing { sigma, iso, ..Surfacing::PLAIN }
}
