//! A request whose numbers are in range and whose settings go together, and the threads to run it.

use std::path::Path;
use std::sync::Arc;
use std::thread::available_parallelism;

use rayon::ThreadPool;

use crate::backend::Cpu;
use crate::baselines::Method;
use crate::brick::InvalidParticles;
use crate::error::{Conflict, Error, Setting, Unfit};
use crate::field::calibration::Calibration;
use crate::field::indicator::{IndicatorKind, IndicatorRequest};
use crate::field::recipe::Detail;
use crate::frame::estimate::SMALLEST_BUDGET;
use crate::frame::{FieldRequest, Resources, Surfacing};
use crate::grid::PeriodicError;
use crate::grid::units::{Isovalue, MeanCount, Sigma, Smooth, Tolerance, UnitError, positive_length};
use crate::io::bytes::Unpacking;
use crate::io::output::MeshFormat;
use crate::particles::AttributeInfo;
use crate::surface::dual_mc::Normals;
use crate::surface::simplify::{BYTES_A_THREAD, Reduction};
use crate::system::memory::default_memory;

use super::asked::Asked;
use super::builder::Reconstruction;
use super::threads::Threads;
use super::{Attributes, CellSize, SamplingRequest};

/// Threads that a call may have at the most: more than any machine has cores, and few enough to start.
const MOST_THREADS: usize = 1024;

/// A request that can be run.
#[derive(Debug, Clone)]
pub(crate) struct Checked {
    pub(crate) asked: Asked,
    pub(crate) sampling: SamplingRequest,
    pub(crate) surfacing: Surfacing,
    pub(crate) reduction: Reduction,
    pub(crate) calibration: Option<Calibration>,
    pub(crate) threads: usize,
    pub(crate) resources: Resources,
}

/// A request with threads of its own.
#[derive(Debug, Clone)]
pub(crate) struct Ready {
    pub(crate) checked: Arc<Checked>,
    pub(crate) threads: Arc<ThreadPool>,
}

impl Reconstruction {
    /// Checks all numbers, and what of the settings can be checked without an input.
    pub(crate) fn checked(&self) -> Result<Checked, Error> {
        let asked = &self.asked;
        let surfacing = surfacing(asked)?;
        let sampling = sampling(asked, surfacing)?;
        let reduction = reduction(asked)?;
        let budget = self.memory.unwrap_or_else(default_memory);
        let threads = self.threads.or_else(|| available_parallelism().ok().map(Into::into)).unwrap_or(1);
        if !(1..=MOST_THREADS).contains(&threads) {
            return Err(Error::Threads(format!("their number must be 1 to {MOST_THREADS}")));
        }
        // Chunks are simplified whole, and every thread has its own.
        let simplifying = reduction.tolerance.map(|_| threads);
        let least = SMALLEST_BUDGET.0 + simplifying.map_or(0, |threads| BYTES_A_THREAD * threads as u64);
        if budget < SMALLEST_BUDGET {
            return Err(Error::LittleMemory { least: SMALLEST_BUDGET.0, simplifying: None });
        }
        if budget.0 < least {
            return Err(Error::LittleMemory { least, simplifying });
        }
        let backend = match sampling.field.indicator() {
            Some(_) => Arc::clone(&self.backend),
            None => Arc::new(Cpu),
        };
        let resources = Resources {
            budget,
            scratch: self.scratch.clone().unwrap_or_else(std::env::temp_dir),
            backend,
            control: self.control.clone(),
        };
        let (asked, calibration) = (asked.clone(), self.calibration);
        Ok(Checked { asked, sampling, surfacing, reduction, calibration, threads, resources })
    }
}

fn unfit<T>(setting: Setting, with: Conflict) -> Result<T, Error> {
    Err(Unfit { setting, with }.into())
}

/// The first setting that was given of those that have no meaning.
fn given<const N: usize>(settings: [(Setting, bool); N]) -> Option<Setting> {
    settings.into_iter().find_map(|(setting, given)| given.then_some(setting))
}

fn sampling(asked: &Asked, surfacing: Surfacing) -> Result<SamplingRequest, Error> {
    let length = |what, length: Option<f64>| length.map(|length| positive_length(what, length)).transpose();
    let cell =
        match (length("the cell size", asked.cell_size)?, length("the cell size in spacings", asked.cell)?) {
            (Some(size), _) => Some(CellSize::Length(size)),
            (None, ratio) => ratio.map(CellSize::Spacings),
        };
    let request = SamplingRequest {
        field: field(asked)?,
        invalid: if asked.skip_invalid { InvalidParticles::Skip } else { InvalidParticles::Refuse },
        origin: asked.origin.map(Into::into),
        walls: asked.walls.map(|corners| corners.map(Into::into)),
        periodic: asked.periodic.map(|faces| (faces, surfacing)),
        spacing: length("the spacing", asked.spacing)?,
        cell,
    };
    request.validate()?;
    Ok(request)
}

/// The maker of the field: refuses what has no meaning for kernels.
fn field(asked: &Asked) -> Result<FieldRequest, Error> {
    let kind = asked.indicator.unwrap_or_default();
    let Some(method) = asked.baseline else {
        if asked.mean.is_some() && !kind.counts() {
            return unfit(Setting::Mu0, Conflict::Indicator(kind));
        }
        return Ok(IndicatorRequest { kind, mean: asked.mean.map(MeanCount::new).transpose()? }.into());
    };
    let meaningless = given([
        (Setting::Smooth, asked.smooth.is_some()),
        (Setting::Sigma, asked.sigma.is_some()),
        (Setting::Detail, asked.details),
        (Setting::Indicator, asked.indicator.is_some()),
        (Setting::Mu0, asked.mean.is_some()),
        (Setting::Iso, method == Method::ZhuBridson && asked.iso.is_some()),
    ]);
    if let Some(setting) = meaningless {
        return unfit(setting, Conflict::Method(method));
    }
    // A kernel method's isovalue is as the others': held as a step of a field of 16 bits.
    let asked = asked.iso.map(Isovalue::new).transpose()?.map(Isovalue::value);
    Ok(match method {
        Method::Mueller { iso } => Method::Mueller { iso: asked.unwrap_or(iso) },
        Method::YuTurk { iso } => Method::YuTurk { iso: asked.unwrap_or(iso) },
        Method::ZhuBridson => method,
    }
    .into())
}

fn surfacing(asked: &Asked) -> Result<Surfacing, Error> {
    Ok(Surfacing {
        smooth: asked.smooth.map_or(Ok(Smooth::DEFAULT), Smooth::new)?,
        sigma: asked.sigma.map(Sigma::new).transpose()?,
        iso: asked.iso.map(Isovalue::new).transpose()?,
        detail: if asked.details { Detail::Recovered } else { Detail::Smoothed },
        normals: if asked.normals { Normals::Gradient } else { Normals::None },
        periodic_mesh: asked.periodic_mesh.unwrap_or_default(),
    })
}

fn reduction(asked: &Asked) -> Result<Reduction, Error> {
    if let Some(value) = asked.smallest_component.filter(|volume| !(volume.is_finite() && *volume > 0.0)) {
        return Err(UnitError::Volume(value).into());
    }
    Ok(Reduction {
        tolerance: asked.tolerance.map(Tolerance::new).transpose()?,
        smallest_component: asked.smallest_component,
        // Every drop has one.
        smallest_drop: asked.smallest_drop.filter(|&particles| particles > 1),
    })
}

impl Asked {
    /// Refuses settings of another indicator's surface.
    pub(crate) fn refuse_of_others(&self, kind: IndicatorKind) -> Result<(), Error> {
        let meaningless = match kind {
            IndicatorKind::Cloud => given([
                (Setting::Sigma, self.sigma.is_some()),
                (Setting::Iso, self.iso.is_some()),
                (Setting::Detail, self.details),
            ]),
            IndicatorKind::Counting | IndicatorKind::Symmetry => {
                given([(Setting::Smooth, self.smooth.is_some())])
            }
        };
        meaningless.map_or(Ok(()), |setting| unfit(setting, Conflict::Indicator(kind)))
    }

    /// Refuses what a frame that was packed cannot give.
    pub(crate) fn refuse_of_packed(&self, path: &Path) -> Result<(), Error> {
        let names = |attributes: &&Attributes| **attributes != Attributes::Named(Vec::new());
        let carried = self.attributes.as_ref().filter(names);
        let setting = self.other_sampling(&Self::default()).or(carried.map(|_| Setting::Attributes));
        setting.map_or(Ok(()), |setting| unfit(setting, Conflict::Packed(path.to_owned())))
    }

    /// Refuses what a frame that was sampled as `sampled` says cannot give.
    pub(crate) fn refuse_of_sampled(&self, sampled: &Self) -> Result<(), Error> {
        let carried = self.attributes.as_ref().filter(|_| self.attributes != sampled.attributes);
        let setting = self.other_sampling(sampled).or(carried.map(|_| Setting::Attributes));
        setting.map_or(Ok(()), |setting| unfit(setting, Conflict::Sampled))
    }

    /// The first setting that was given and needs the particles, unless they were sampled so.
    fn other_sampling(&self, sampled: &Self) -> Option<Setting> {
        given([
            (Setting::Spacing, self.spacing.is_some() && self.spacing != sampled.spacing),
            (Setting::CellSize, self.cell_size.is_some() && self.cell_size != sampled.cell_size),
            (Setting::Cell, self.cell.is_some() && self.cell != sampled.cell),
            (Setting::Origin, self.origin.is_some() && self.origin != sampled.origin),
            (Setting::Domain, self.walls.is_some() && self.walls != sampled.walls),
            (Setting::Periodic, self.periodic.is_some() && self.periodic != sampled.periodic),
            (Setting::Indicator, self.indicator.is_some() && self.indicator != sampled.indicator),
            (Setting::Mu0, self.mean.is_some() && self.mean != sampled.mean),
            (Setting::SkipInvalid, self.skip_invalid && !sampled.skip_invalid),
            (
                Setting::ParticleType,
                self.particle_type.is_some() && self.particle_type != sampled.particle_type,
            ),
            (Setting::Method, self.baseline.is_some() && self.baseline != sampled.baseline),
        ])
    }

    /// Refuses what is asked for and a format cannot hold.
    pub(crate) fn refuse_of_format(&self, path: &Path, format: MeshFormat) -> Result<(), Error> {
        let is_glb = matches!(format, MeshFormat::Glb(_));
        let names = |attributes: &Attributes| *attributes != Attributes::Named(Vec::new());
        let meaningless = given([
            (Setting::Compression, self.compress && !is_glb),
            (Setting::Up, is_glb && self.up == Some(crate::io::UpAxis::Z)),
            (Setting::Normals, self.normals && !format.holds_normals()),
            (Setting::Attributes, self.attributes.as_ref().is_some_and(names) && !format.holds_attributes()),
        ]);
        let with = || Conflict::Format { path: path.to_owned(), format };
        meaningless.map_or(Ok(()), |setting| unfit(setting, with()))
    }

    /// The numbers of the attributes that go to the vertices, of those that there are. Velocity goes where a format can hold it.
    pub(crate) fn carried(
        &self,
        all: &[AttributeInfo],
        format: Option<MeshFormat>,
    ) -> Result<Vec<usize>, Error> {
        match &self.attributes {
            None if format.is_some_and(|format| !format.holds_attributes()) => Ok(Vec::new()),
            None => Attributes::Velocity.among(all),
            Some(wanted) => wanted.among(all),
        }
    }
}

impl Checked {
    /// Starts threads for the request.
    pub(crate) fn on_threads(self) -> Result<Ready, Error> {
        let threads = Threads::start(self.threads).map_err(Error::Threads)?;
        Ok(Ready { checked: Arc::new(self), threads })
    }

    /// Refuses settings that have no meaning for the indicator that was asked for, or without a periodic box.
    pub(crate) fn refuse_of_indicator(&self) -> Result<(), Error> {
        if self.asked.periodic_mesh.is_some() && self.asked.periodic.is_none() {
            return Err(PeriodicError::NoBox.into());
        }
        match self.sampling.field.indicator() {
            Some(asked) => self.asked.refuse_of_others(asked.kind),
            None => Ok(()),
        }
    }

    /// The memory for an input that has to be unpacked or decoded: an eighth of the budget.
    pub(crate) fn unpacking(&self) -> Unpacking<'_> {
        Unpacking { in_memory: self.resources.budget.0 / 8, scratch: &self.resources.scratch }
    }
}
