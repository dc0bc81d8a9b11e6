//! The request for a surface, step by step, and its run.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::available_parallelism;

use rayon::ThreadPoolBuilder;

use crate::backend::{Backend, Cpu};
use crate::baselines::Method;
use crate::brick::InvalidParticles;
use crate::error::Error;
use crate::field::calibration::Calibration;
use crate::field::indicator::{IndicatorKind, IndicatorRequest, SampledDif};
use crate::field::recipe::Detail;
use crate::frame::estimate::SMALLEST_BUDGET;
use crate::frame::{Frame, FrameError, Resources, Surfacing};
use crate::grid::units::{
    Isovalue, MeanCount, MemoryBudget, Sigma, Smooth, Tolerance, UnitError, positive_length,
};
use crate::io::bytes::Unpacking;
use crate::io::input::open_particles;
use crate::io::mnf::{is_packed, open_frame};
use crate::particles::Particles;
use crate::surface::dual_mc::Normals;
use crate::surface::simplify::{BYTES_A_THREAD, Reduction};
use crate::system::memory::default_budget;
use crate::system::timings::Timings;

use super::surface::Drawn;
use super::{Attributes, CellSize, Origin, Report, SamplingRequest, SinglePrecision, Surface};

/// A request for the surface of particles: what is not said is measured, or as usual.
///
/// Numbers are checked when it runs. Every run has threads of its own, and sets nothing for the rest of the program.
///
/// ```
/// use meniscus::Reconstruction;
///
/// // A ball of particles, one a unit.
/// let steps = || (-6..=6).map(f64::from);
/// let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
/// let ball: Vec<[f64; 3]> = lattice.filter(|p| p.iter().map(|c| c * c).sum::<f64>() < 36.0).collect();
///
/// let surface = Reconstruction::new().spacing(1.0).run(&ball[..])?;
/// let mesh = surface.to_mesh()?;
/// assert!(meniscus::surface::mesh::check::check(&mesh).is_closed_oriented_manifold());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
#[must_use]
pub struct Reconstruction {
    sampling: SamplingRequest,
    mean: Option<f64>,
    smooth: Option<f64>,
    sigma: Option<f64>,
    iso: Option<f64>,
    surfacing: Surfacing,
    tolerance: Option<f64>,
    reduction: Reduction,
    attributes: Attributes,
    calibration: Option<Calibration>,
    memory: Option<MemoryBudget>,
    scratch: Option<PathBuf>,
    threads: Option<usize>,
    backend: Arc<dyn Backend>,
}

impl Default for Reconstruction {
    fn default() -> Self {
        Self::new()
    }
}

impl Reconstruction {
    /// Asks for the usual surface.
    pub fn new() -> Self {
        Self {
            sampling: SamplingRequest::default(),
            mean: None,
            smooth: None,
            sigma: None,
            iso: None,
            surfacing: Surfacing::PLAIN,
            tolerance: None,
            reduction: Reduction::default(),
            attributes: Attributes::default(),
            calibration: None,
            memory: None,
            scratch: None,
            threads: None,
            backend: Arc::new(Cpu),
        }
    }

    /// Sets the distance between neighbouring particles, which is otherwise taken from the file or estimated.
    pub fn spacing(mut self, length: f64) -> Self {
        self.sampling.spacing = Some(length);
        self
    }

    /// Sets the edge of a cell.
    pub fn cell_size(mut self, length: f64) -> Self {
        self.sampling.cell = Some(CellSize::Length(length));
        self
    }

    /// Sets the edge of a cell in spacings: 0.5 is usual.
    pub fn cell(mut self, spacings: f64) -> Self {
        self.sampling.cell = Some(CellSize::Spacings(spacings));
        self
    }

    /// Sets a corner of the grid's cells.
    pub fn origin(mut self, corner: [f64; 3]) -> Self {
        self.sampling.origin = Some(corner.into());
        self
    }

    /// Sets the walls of a tank by its lowest and its highest corner; particles outside are not counted.
    pub fn walls(mut self, lowest: [f64; 3], highest: [f64; 3]) -> Self {
        self.sampling.walls = Some([lowest.into(), highest.into()]);
        self
    }

    /// Makes the field by an indicator: clouds are usual, the others are the paper's.
    pub fn indicator(mut self, kind: IndicatorKind) -> Self {
        self.sampling.field = kind.into();
        self
    }

    /// Sets `mu0`, the mean number of particles in a full cell, for counting.
    pub fn mean_count(mut self, particles: f64) -> Self {
        self.mean = Some(particles);
        self
    }

    /// Makes the field by one of the kernel methods that the paper compares against.
    pub fn baseline(mut self, method: Method) -> Self {
        self.sampling.field = method.into();
        self
    }

    /// Sets how calm the water is, for clouds: the width in spacings under which particles make one surface.
    pub fn smooth(mut self, spacings: f64) -> Self {
        self.smooth = Some(spacings);
        self
    }

    /// Sets the width of the Gaussian in cells, for the paper's indicators.
    pub fn sigma(mut self, cells: f64) -> Self {
        self.sigma = Some(cells);
        self
    }

    /// Sets the isovalue, between 0 and 1, for the paper's indicators; it is otherwise measured.
    pub fn iso(mut self, value: f64) -> Self {
        self.iso = Some(value);
        self
    }

    /// Recovers details that smoothing loses, for the paper's indicators.
    pub fn recover_details(mut self) -> Self {
        self.surfacing.detail = Detail::Recovered;
        self
    }

    /// Makes vertex normals from the field's gradient.
    pub fn normals(mut self) -> Self {
        self.surfacing.normals = Normals::Gradient;
        self
    }

    /// Carries these attributes of the particles to the vertices; without this their velocity, if they have it.
    pub fn attributes(mut self, names: impl IntoIterator<Item = impl Into<String>>) -> Self {
        self.attributes = Attributes::Named(names.into_iter().map(Into::into).collect());
        self
    }

    /// Uses fewer triangles, as long as no part of the surface moves farther than so many cells.
    pub fn simplify(mut self, cells: f64) -> Self {
        self.tolerance = Some(cells);
        self
    }

    /// Leaves out components, drops or bubbles, of less volume than so many cells.
    pub fn drop_smaller(mut self, cells: f64) -> Self {
        self.reduction.least_volume_cells = Some(cells);
        self
    }

    /// Leaves out drops of fewer particles, as told by their volume.
    pub fn smallest_drop(mut self, particles: u32) -> Self {
        self.reduction.smallest_drop = Some(particles).filter(|&particles| particles > 1);
        self
    }

    /// Leaves out particles that are not finite or too far away, and counts them, where they would be an error.
    pub fn skip_invalid(mut self) -> Self {
        self.sampling.invalid = InvalidParticles::Skip;
        self
    }

    /// Draws by the calibration of another frame, so that all frames of a simulation are alike.
    pub fn calibrated(mut self, by: Calibration) -> Self {
        self.calibration = Some(by);
        self
    }

    /// Sets the memory that may be used: three quarters of what is available otherwise.
    pub fn memory(mut self, budget: MemoryBudget) -> Self {
        self.memory = Some(budget);
        self
    }

    /// Sets the folder for what exceeds the memory: that of the system's temporary files otherwise.
    pub fn scratch(mut self, folder: impl Into<PathBuf>) -> Self {
        self.scratch = Some(folder.into());
        self
    }

    /// Sets the number of threads: one for each core otherwise.
    pub fn threads(mut self, count: usize) -> Self {
        self.threads = Some(count);
        self
    }

    /// Runs on a backend, such as a Vulkan device. Kernel methods run on the processor.
    pub fn backend(mut self, backend: Arc<dyn Backend>) -> Self {
        self.backend = backend;
        self
    }

    /// Reconstructs the surface of particles in memory.
    ///
    /// # Errors
    /// [`Error::Unit`] for numbers out of range, [`Error::Domain`], [`Error::NoSpacing`], [`Error::NoAttribute`], and
    /// [`Error::Frame`] for particles that have no surface or do not fit the memory.
    pub fn run(&self, particles: &(impl Particles + ?Sized)) -> Result<Surface, Error> {
        self.checked()?.on_threads(|request| request.of_particles(particles, Origin::default()))
    }

    /// Reconstructs the surface of the particles in a file, or of a frame that was packed.
    ///
    /// # Errors
    /// [`Error::Read`], and those of [`run`](Self::run).
    pub fn run_file(&self, path: impl AsRef<Path>) -> Result<Surface, Error> {
        let path = path.as_ref();
        self.checked()?.on_threads(|request| request.of_file(path)).map_err(|error| error.of_file(path))
    }

    /// Checks all numbers.
    fn checked(&self) -> Result<Checked, Error> {
        let mut sampling = self.sampling.clone();
        sampling.spacing =
            sampling.spacing.map(|spacing| positive_length("the spacing", spacing)).transpose()?;
        sampling.cell = match sampling.cell {
            Some(CellSize::Length(size)) => Some(CellSize::Length(positive_length("the cell size", size)?)),
            Some(CellSize::Spacings(ratio)) => {
                Some(CellSize::Spacings(positive_length("the cell size in spacings", ratio)?))
            }
            None => None,
        };
        if let Some(IndicatorRequest { kind, .. }) = sampling.field.indicator() {
            let mean = self.mean.map(MeanCount::new).transpose()?;
            sampling.field = IndicatorRequest { kind, mean }.into();
        }
        sampling.validate()?;
        let surfacing = Surfacing {
            smooth: self.smooth.map_or(Ok(Smooth::USUAL), Smooth::new)?,
            sigma: self.sigma.map(Sigma::new).transpose()?,
            iso: self.iso.map(Isovalue::new).transpose()?,
            ..self.surfacing
        };
        let volume = self.reduction.least_volume_cells;
        if let Some(value) = volume.filter(|volume| !(volume.is_finite() && *volume > 0.0)) {
            return Err(UnitError::Volume(value).into());
        }
        let reduction =
            Reduction { tolerance: self.tolerance.map(Tolerance::new).transpose()?, ..self.reduction };
        let budget = self.memory.unwrap_or_else(default_budget);
        let threads = self.threads.or_else(|| available_parallelism().ok().map(Into::into)).unwrap_or(1);
        // Chunks are simplified whole, and every thread has its own.
        let chunks = if reduction.tolerance.is_some() { BYTES_A_THREAD * threads as u64 } else { 0 };
        let least = SMALLEST_BUDGET.0 + chunks;
        if budget.0 < least {
            return Err(Error::LittleMemory { least });
        }
        let backend = match sampling.field.indicator() {
            Some(_) => Arc::clone(&self.backend),
            None => Arc::new(Cpu),
        };
        let resources =
            Resources { budget, scratch: self.scratch.clone().unwrap_or_else(std::env::temp_dir), backend };
        Ok(Checked {
            sampling,
            surfacing,
            reduction,
            attributes: self.attributes.clone(),
            calibration: self.calibration,
            threads,
            resources,
        })
    }
}

/// A request whose numbers are in range.
struct Checked {
    sampling: SamplingRequest,
    surfacing: Surfacing,
    reduction: Reduction,
    attributes: Attributes,
    calibration: Option<Calibration>,
    threads: usize,
    resources: Resources,
}

/// A surface, but for the threads that it was made by.
struct Made {
    mesh: Drawn,
    precision: SinglePrecision,
    report: Report,
}

impl Checked {
    /// Makes a surface on threads of its own.
    fn on_threads(self, make: impl FnOnce(&Self) -> Result<Made, Error> + Send) -> Result<Surface, Error> {
        let pool = ThreadPoolBuilder::new().num_threads(self.threads).build();
        let threads = Arc::new(pool.map_err(|fault| Error::Threads(fault.to_string()))?);
        let Made { mesh, precision, report } = threads.install(|| make(&self))?;
        Ok(Surface { mesh, threads, precision, report })
    }

    fn of_file(&self, path: &Path) -> Result<Made, Error> {
        let budget = self.resources.budget.0;
        if is_packed(path) {
            return self.of_sampled(open_frame(path, budget / 4)?);
        }
        // What has to be unpacked or decoded may take an eighth of the budget.
        let unpacking = Unpacking { in_memory: budget / 8, scratch: &self.resources.scratch };
        let file = open_particles(path, unpacking)?;
        self.of_particles(&file.particles, Origin { path: Some(path), spacing: file.spacing })
    }

    fn of_particles(&self, particles: &(impl Particles + ?Sized), origin: Origin<'_>) -> Result<Made, Error> {
        let mut timings = Timings::default();
        let carried = self.attributes.among(particles.attributes())?;
        let chosen = self.sampling.sampling(particles, origin, carried, self.resources.clone())?;
        timings.done("spacing");
        chosen.sampling.refuse_unfit(&self.surfacing).map_err(in_memory)?;
        let frame = Frame::sample(particles, &chosen.sampling, &mut timings).map_err(in_memory)?;
        let mut made = self.draw(&frame, timings)?;
        (made.report.cells, made.report.moved) = (Some(chosen.cells), chosen.moved);
        Ok(made)
    }

    fn of_sampled(&self, sampled: SampledDif) -> Result<Made, Error> {
        self.draw(&Frame::from_sampled(sampled, &self.surfacing, self.resources.clone()), Timings::default())
    }

    fn draw(&self, frame: &Frame, mut timings: Timings) -> Result<Made, Error> {
        let calibrated = frame.calibrate(&self.surfacing, self.calibration.as_ref(), &mut timings);
        let calibrated = calibrated.map_err(in_memory)?;
        let measured = calibrated.measured();
        let surface = calibrated.surface(&mut timings).map_err(in_memory)?;
        let lost = frame.lost(&surface).map_err(in_memory)?;
        let shortfall = frame.shortfall(&surface).map_err(in_memory)?;
        let precision = SinglePrecision::of(&surface);
        let (mesh, dropped) = if self.reduction.is_none() {
            (Drawn::Whole(surface), None)
        } else {
            let simplified = frame.simplify(surface, &self.reduction, &mut timings).map_err(in_memory)?;
            let dropped = simplified.dropped();
            (Drawn::Reduced(simplified), Some(dropped))
        };
        let facts = frame.facts();
        let report = Report {
            cells: None,
            moved: false,
            grid: facts.grid,
            census: facts.census,
            measured,
            lost,
            shortfall,
            crowding: frame.crowding(),
            dropped,
            made_good: frame.warnings(),
            timings,
        };
        Ok(Made { mesh, precision, report })
    }
}

fn in_memory(fault: FrameError) -> Error {
    Error::Frame { path: None, fault }
}
