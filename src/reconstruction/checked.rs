//! A request whose numbers are in range and whose settings fit together, and the threads to run it.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::available_parallelism;

use rayon::ThreadPool;

use crate::backend::Backend;
use crate::baselines::KernelMethod;
use crate::brick::InvalidParticles;
use crate::error::{Conflict, Error, Setting, SettingConflict};
use crate::field::calibration::Calibration;
use crate::field::indicator::IndicatorKind;
use crate::field::recipe::Detail;
use crate::frame::estimate::SMALLEST_BUDGET;
use crate::frame::{Method, Resources, Surfacing};
use crate::grid::units::{
    Isovalue, MeanCount, SheetStretch, Sigma, Smooth, Tolerance, UnitError, positive_length,
};
use crate::io::bytes::Unpacking;
use crate::io::input::InputFormat;
use crate::io::output::MeshFormat;
use crate::particles::AttributeInfo;
use crate::particles::kind::is_colour_or_component_name;
use crate::particles::sizes::SizeChoice;
use crate::settings::{Settings, Tank};
use crate::surface::dual_mc::Normals;
use crate::surface::mesh::up::UpAxis;
use crate::surface::simplify::{BYTES_PER_THREAD, Reduction};
use crate::system::memory::default_memory;

use super::builder::Reconstruction;
use super::threads::Threads;
use super::warning::Warning;
use super::{CellSize, SamplingRequest, WallSearch};

/// Maximum number of threads per call: more than the number of cores of most machines, but few
/// enough for the system to start them all.
const MOST_THREADS: usize = 1024;

/// A request that can be run.
#[derive(Debug, Clone)]
pub(crate) struct CheckedRequest {
    pub(crate) settings: Settings,
    pub(crate) sampling: SamplingRequest,
    pub(crate) surfacing: Surfacing,
    pub(crate) reduction: Reduction,
    pub(crate) calibration: Option<Calibration>,
    pub(crate) threads: usize,
    pub(crate) pool: Option<Arc<ThreadPool>>,
    pub(crate) resources: Resources,
    /// Warnings about solids whose triangles face inwards.
    pub(crate) inverted_solids: Vec<Warning>,
    /// The files of the solids that were read.
    pub(crate) solid_files: Vec<PathBuf>,
}

/// A checked request with its own threads.
#[derive(Debug, Clone)]
pub(crate) struct StartedRequest {
    pub(crate) checked: Arc<CheckedRequest>,
    pub(crate) threads: Arc<ThreadPool>,
}

impl Reconstruction {
    /// Checks all numbers, and all settings that can be checked without an input.
    pub(crate) fn checked(&self) -> Result<CheckedRequest, Error> {
        self.checked_without_solids()?.at_solids()
    }

    /// Checks everything except the solids, which may differ from frame to frame.
    pub(crate) fn checked_without_solids(&self) -> Result<CheckedRequest, Error> {
        let settings = &self.settings;
        let surfacing = surfacing(settings)?;
        let sampling = sampling(settings, &surfacing)?;
        let reduction = reduction(settings)?;
        let budget = self.memory.unwrap_or_else(default_memory);
        let threads =
            self.threads.or_else(|| available_parallelism().ok().map(Into::into)).unwrap_or(1);
        if !(1..=MOST_THREADS).contains(&threads) {
            return Err(Error::Threads(format!(
                "the number of threads must be from 1 to {MOST_THREADS}, got {threads}"
            )));
        }
        // Each thread keeps a whole chunk in memory while it simplifies the chunk.
        let simplifying = reduction.tolerance.map(|_| threads);
        let least =
            SMALLEST_BUDGET.0 + simplifying.map_or(0, |threads| BYTES_PER_THREAD * threads as u64);
        if budget < SMALLEST_BUDGET {
            return Err(Error::LittleMemory { least: SMALLEST_BUDGET.0, simplifying: None });
        }
        if budget.0 < least {
            return Err(Error::LittleMemory { least, simplifying });
        }
        let backend = match sampling.method {
            Method::Indicator { .. } => self.backend.clone(),
            Method::Kernels(_) => Backend::cpu(),
        };
        if let Some(folder) = self.scratch.as_ref().filter(|folder| !folder.is_dir()) {
            let what = if folder.exists() {
                "is not a folder; choose a folder for scratch files"
            } else {
                "the folder for scratch files does not exist; create it, or choose another folder"
            };
            return Err(Error::Request(format!("{}: {what}", folder.display())));
        }
        let resources = Resources {
            budget,
            scratch: self.scratch.clone().unwrap_or_else(std::env::temp_dir),
            backend,
            control: self.control.clone(),
        };
        let (settings, calibration, pool) = (settings.clone(), self.calibration, self.pool.clone());
        Ok(CheckedRequest {
            settings,
            sampling,
            surfacing,
            reduction,
            calibration,
            threads,
            pool,
            resources,
            inverted_solids: Vec::new(),
            solid_files: Vec::new(),
        })
    }
}

/// Returns an error for the first given setting for which `meaningless` is true, and whose value
/// differs from its value in `known`.
fn refuse(
    settings: &Settings,
    known: &Settings,
    meaningless: impl FnMut(Setting) -> bool,
    with: impl FnOnce() -> Conflict,
) -> Result<(), Error> {
    match settings.first_difference(known, meaningless) {
        Some(setting) => Err(SettingConflict { setting, with: with() }.into()),
        None => Ok(()),
    }
}

/// Returns an error for the first given setting whose name is in `names`.
pub(super) fn refuse_named(
    settings: &Settings,
    names: &[&'static str],
    with: impl FnOnce() -> Conflict,
) -> Result<(), Error> {
    debug_assert!(names.iter().all(|name| Settings::ALL.contains(&Setting::named(name))));
    // `size` conflicts with other settings only if it names an attribute.
    let applies = |name| name != "size" || settings.asks_for_sizes();
    let is_named = |setting: Setting| names.contains(&setting.name()) && applies(setting.name());
    refuse(settings, &Settings::default(), is_named, with)
}

fn sampling(settings: &Settings, surfacing: &Surfacing) -> Result<SamplingRequest, Error> {
    let exclusive = [
        ("radius", settings.radius.is_some() && settings.spacing.is_some(), "spacing"),
        ("cell_size", settings.cell_size.is_some() && settings.cell.is_some(), "cell"),
        ("size", settings.asks_for_sizes() && settings.spacing.is_some(), "spacing"),
        ("size", settings.asks_for_sizes() && settings.radius.is_some(), "radius"),
    ];
    if let Some((setting, _, other)) = exclusive.into_iter().find(|(_, both, _)| *both) {
        let (setting, with) = (Setting::named(setting), Conflict::Setting(Setting::named(other)));
        return Err(SettingConflict { setting, with }.into());
    }
    if settings.solid_offset.is_some() && settings.solid.is_none() {
        let with = Conflict::Needs(Setting::named("solid"));
        return Err(SettingConflict { setting: Setting::named("solid_offset"), with }.into());
    }
    let length =
        |name, length: Option<f64>| length.map(|length| positive_length(name, length)).transpose();
    length("radius", settings.radius)?;
    let cell = match (length("cell-size", settings.cell_size)?, length("cell", settings.cell)?) {
        (Some(size), _) => Some(CellSize::Length(size)),
        (None, ratio) => ratio.map(CellSize::Spacings),
    };
    let request = SamplingRequest {
        method: method(settings)?,
        invalid: if settings.skip_invalid {
            InvalidParticles::Skip
        } else {
            InvalidParticles::Refuse
        },
        origin: settings.origin.map(Into::into),
        walls: match &settings.domain {
            Some(Tank::Walls(walls)) => Some(walls.corners()),
            Some(Tank::Auto) | None => None,
        },
        search: match &settings.domain {
            Some(Tank::Auto) => WallSearch::Walls,
            Some(Tank::Walls(_)) | None => WallSearch::Never,
        },
        up: match (settings.particles_up, settings.format) {
            (Some(UpAxis::Y), _) => Some(1),
            (Some(UpAxis::Z), _) | (None, Some(InputFormat::Bi4)) => Some(2),
            (None, _) => None,
        },
        periodic: settings.periodic.map(|faces| (faces.0, surfacing.clone())),
        spacing: length("spacing", settings.spacing_or_radius())?,
        size: size(settings),
        cell,
    };
    request.validate()?;
    Ok(request)
}

/// The choice of sizes. If the spacing is given, it is the size of all particles. Kernel methods
/// and the indicators other than cloud also need particles of one size.
fn size(settings: &Settings) -> SizeChoice {
    let needs_one = [
        ("method", settings.kernels().is_some()),
        ("indicator", settings.indicator.unwrap_or_default() != IndicatorKind::Cloud),
    ];
    match settings.size_choice() {
        _ if settings.spacing_or_radius().is_some() => SizeChoice::Ignored,
        SizeChoice::Usual => (needs_one.into_iter().find(|(_, is_given)| *is_given))
            .map_or(SizeChoice::Usual, |(name, _)| SizeChoice::OneFor(name)),
        chosen => chosen,
    }
}

/// Decides the method, and rejects settings that do not apply to it. For an indicator, the settings
/// of the surface are checked later.
fn method(settings: &Settings) -> Result<Method, Error> {
    let kind = settings.indicator.unwrap_or_default();
    let Some(kernels) = settings.kernels() else {
        if !kind.counts() {
            refuse_named(settings, &["mu0"], || Conflict::Indicator(kind))?;
        }
        let mean = settings.mu0.map(MeanCount::new).transpose()?;
        return Ok(Method::Indicator { kind, mean });
    };
    let conflict = || Conflict::Method(kernels);
    let of_indicators = [
        "indicator",
        "mu0",
        "smooth",
        "sheets",
        "size",
        "sigma",
        "detail",
        "solid",
        "solid_offset",
    ];
    refuse_named(settings, &of_indicators, conflict)?;
    if kernels == KernelMethod::ZhuBridson && settings.isovalue().is_some() {
        refuse_named(settings, &["iso"], conflict)?;
    }
    // Like the isovalue of an indicator, the isovalue of a kernel method is rounded to a step of a
    // 16-bit field.
    let requested_iso = settings.isovalue().map(Isovalue::new).transpose()?.map(Isovalue::value);
    Ok(Method::Kernels(match kernels {
        KernelMethod::Mueller { iso } => {
            KernelMethod::Mueller { iso: requested_iso.unwrap_or(iso) }
        }
        KernelMethod::YuTurk { iso } => KernelMethod::YuTurk { iso: requested_iso.unwrap_or(iso) },
        KernelMethod::ZhuBridson => kernels,
    }))
}

fn surfacing(settings: &Settings) -> Result<Surfacing, Error> {
    Ok(Surfacing {
        smooth: settings.smooth.map_or(Ok(Smooth::DEFAULT), Smooth::new)?,
        sheets: settings.sheets.map_or(Ok(SheetStretch::DEFAULT), SheetStretch::new)?,
        sigma: settings.sigma.map(Sigma::new).transpose()?,
        iso: settings.isovalue().map(Isovalue::new).transpose()?,
        detail: if settings.detail { Detail::Recovered } else { Detail::Smoothed },
        normals: if settings.normals { Normals::Gradient } else { Normals::None },
        periodic_mesh: settings.periodic_mesh.unwrap_or_default(),
        at_solids: !settings.solid_files().is_empty(),
        solid: None,
    })
}

fn reduction(settings: &Settings) -> Result<Reduction, Error> {
    if let Some(value) =
        settings.smallest_component.filter(|volume| !(volume.is_finite() && *volume > 0.0))
    {
        return Err(UnitError::Volume(value).into());
    }
    Ok(Reduction {
        tolerance: settings.simplify.map(Tolerance::new).transpose()?,
        smallest_component: settings.smallest_component,
        // A minimum of 1 removes nothing, because every drop has at least one particle.
        smallest_drop: settings.smallest_drop.filter(|&particles| particles > 1),
    })
}

impl Settings {
    /// Rejects settings that apply only to other indicators.
    pub(crate) fn check_indicator_settings(&self, kind: IndicatorKind) -> Result<(), Error> {
        let meaningless: &[&'static str] = match kind {
            IndicatorKind::Cloud if self.isovalue().is_some() => &["sigma", "iso", "detail"],
            IndicatorKind::Cloud => &["sigma", "detail"],
            IndicatorKind::Counting | IndicatorKind::Symmetry => {
                &["smooth", "sheets", "size", "solid", "solid_offset"]
            }
        };
        refuse_named(self, meaningless, || Conflict::Indicator(kind))
    }

    /// The settings, without `method` if it is the default. Packed frames use the default method,
    /// so a request that names the default method does not conflict with them.
    pub(super) fn without_default_method(&self) -> Self {
        Self { method: self.normalized().method, ..self.clone() }
    }

    /// Whether the settings name any attributes.
    fn names_attributes(&self) -> bool {
        self.attribute_names().is_some_and(|names| !names.is_empty())
    }

    /// Rejects settings that a packed frame cannot satisfy.
    pub(crate) fn check_packed(&self, path: &Path) -> Result<(), Error> {
        let needed = |setting: Setting| {
            setting.needs_particles() || setting.name() == "attributes" && self.names_attributes()
        };
        let with = || Conflict::Packed(path.to_owned());
        refuse(&self.without_default_method(), &Self::default(), needed, with)
    }

    /// Rejects settings of the sampling that differ from those with which the frame was sampled.
    pub(crate) fn check_sampled(&self, sampled: &Self) -> Result<(), Error> {
        let needed = |setting: Setting| setting.needs_particles() || setting.name() == "attributes";
        let given = self.normalized().first_difference(&sampled.normalized(), needed);
        given.map_or(Ok(()), |setting| {
            let is_radius = setting.name() == "spacing" && self.spacing.is_none();
            let setting = if is_radius { Setting::named("radius") } else { setting };
            Err(SettingConflict { setting, with: Conflict::Sampled }.into())
        })
    }

    /// Rejects settings that do not affect samples, because a packed frame contains only samples.
    pub(crate) fn check_packing(&self) -> Result<(), Error> {
        let of_surface = |setting: Setting| {
            !setting.is_of_samples() && (setting.name() != "attributes" || self.names_attributes())
        };
        refuse(&self.without_default_method(), &Self::default(), of_surface, || Conflict::Packing)
    }

    /// Rejects settings that a format cannot store.
    pub(crate) fn check_format(&self, path: &Path, format: MeshFormat) -> Result<(), Error> {
        let is_glb = matches!(format, MeshFormat::Glb(_));
        let is_compressed = is_glb || matches!(format, MeshFormat::Vdb { .. });
        let has_y_up = is_glb || matches!(format, MeshFormat::Abc(_));
        let names = self.attribute_names().unwrap_or_default();
        let colours =
            format.holds_colours() && names.iter().all(|name| is_colour_or_component_name(name));
        let holds_named = format.holds_attributes() || colours;
        let meaningless = |setting: Setting| match setting.name() {
            "compress" => !is_compressed,
            "up" => has_y_up && self.up == Some(UpAxis::Z),
            "normals" => !format.holds_normals(),
            "attributes" => self.names_attributes() && !holds_named,
            _ => false,
        };
        let with = || Conflict::Format { path: path.to_owned(), format };
        refuse(self, &Self::default(), meaningless, with)
    }

    /// Rejects named attributes that a format cannot store because of their kind or their number.
    /// `attributes` returns the attributes of the mesh. It is called only if the settings name
    /// attributes and the format cannot store every attribute.
    pub(crate) fn check_attributes(
        &self,
        path: &Path,
        format: MeshFormat,
        attributes: impl FnOnce() -> Result<Vec<AttributeInfo>, Error>,
    ) -> Result<(), Error> {
        if !self.names_attributes() || format.holds_attributes() {
            return Ok(());
        }
        let attributes = attributes()?;
        let are_colours = attributes.iter().all(|info| info.kind.is_colour());
        if format.holds_colours() && attributes.len() <= 1 && are_colours {
            return Ok(());
        }
        let with = Conflict::Format { path: path.to_owned(), format };
        Err(SettingConflict { setting: Setting::named("attributes"), with }.into())
    }
}

impl CheckedRequest {
    /// Starts threads for the request, unless the caller gave a thread pool.
    pub(crate) fn on_threads(self) -> Result<StartedRequest, Error> {
        let threads = self.started()?;
        Ok(StartedRequest { checked: Arc::new(self), threads })
    }

    /// Returns the thread pool that the caller gave, or starts threads.
    pub(super) fn started(&self) -> Result<Arc<ThreadPool>, Error> {
        let started = || Threads::start(self.threads).map_err(Error::Threads);
        self.pool.clone().map_or_else(started, Ok)
    }

    /// Rejects settings that do not apply to the indicator, or that need a periodic box if there is
    /// none.
    pub(crate) fn check_indicator(&self) -> Result<(), Error> {
        if self.settings.periodic_mesh.is_some() && self.settings.periodic.is_none() {
            let with = Conflict::Needs(Setting::named("periodic"));
            return Err(SettingConflict { setting: Setting::named("periodic_mesh"), with }.into());
        }
        match self.sampling.method {
            Method::Indicator { kind, .. } => self.settings.check_indicator_settings(kind),
            Method::Kernels(_) => Ok(()),
        }
    }

    /// The limits for an input that must be unpacked or decoded: an eighth of the budget in memory,
    /// and the scratch folder for data beyond this amount.
    pub(crate) fn unpacking(&self) -> Unpacking<'_> {
        Unpacking {
            in_memory: self.resources.budget.0 / 8,
            scratch: &self.resources.scratch,
            control: Some(&self.resources.control),
        }
    }
}
