//! The request for a surface, step by step.

use std::path::PathBuf;
use std::sync::Arc;

use crate::backend::{Backend, Cpu};
use crate::baselines::Method;
use crate::field::calibration::Calibration;
use crate::field::indicator::IndicatorKind;
use crate::grid::PeriodicMesh;
use crate::grid::units::MemoryBudget;
use crate::io::UpAxis;
use crate::system::cancel::Cancel;
use crate::system::control::{Control, Progress};
use crate::vulkan::Device;

use super::Attributes;
use super::asked::{Asked, Settings};

/// A request for the surface of particles: what is not said is measured, or the default.
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
/// assert!(meniscus::mesh::check(&mesh).is_closed_oriented_manifold());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
#[must_use]
pub struct Reconstruction {
    pub(crate) asked: Asked,
    pub(crate) calibration: Option<Calibration>,
    pub(crate) memory: Option<MemoryBudget>,
    pub(crate) scratch: Option<PathBuf>,
    pub(crate) threads: Option<usize>,
    pub(crate) backend: Arc<dyn Backend>,
    pub(crate) control: Control,
}

impl Default for Reconstruction {
    fn default() -> Self {
        Self::new()
    }
}

impl Reconstruction {
    /// Asks for the default surface.
    pub fn new() -> Self {
        Self {
            asked: Asked::default(),
            calibration: None,
            memory: None,
            scratch: None,
            threads: None,
            backend: Arc::new(Cpu),
            control: Control::default(),
        }
    }

    /// Sets the distance between neighbouring particles, which is otherwise taken from the file or estimated.
    pub fn spacing(mut self, length: f64) -> Self {
        self.asked.spacing = Some(length);
        self
    }

    /// Sets the edge of a cell.
    pub fn cell_size(mut self, length: f64) -> Self {
        (self.asked.cell_size, self.asked.cell) = (Some(length), None);
        self
    }

    /// Sets the edge of a cell in spacings: 0.5 by default, two thirds for the paper's indicators.
    pub fn cell(mut self, spacings: f64) -> Self {
        (self.asked.cell_size, self.asked.cell) = (None, Some(spacings));
        self
    }

    /// Sets a corner of the grid's cells.
    pub fn origin(mut self, corner: [f64; 3]) -> Self {
        self.asked.origin = Some(corner);
        self
    }

    /// Sets the walls of a tank by its lowest and its highest corner; particles outside are not counted. An axis without walls goes
    /// from -inf to inf.
    pub fn domain(mut self, lowest: [f64; 3], highest: [f64; 3]) -> Self {
        self.asked.walls = Some([lowest, highest]);
        self
    }

    /// Sets a periodic box by its faces along x, y and z, `None` for an axis that is open: beyond a face the fluid goes on as it does
    /// behind the opposite one.
    ///
    /// Particles on an upper face are on the lower one; others outside are an error, or left out where such are
    /// [skipped](Self::skip_invalid). Walls can stand along open axes.
    ///
    /// ```
    /// use meniscus::Reconstruction;
    ///
    /// // Water of endless length and width, 7 deep.
    /// let steps = |n: i32| (0..n).map(|i| f64::from(i) + 0.5);
    /// let slab = steps(30).flat_map(|x| steps(7).flat_map(move |y| steps(30).map(move |z| [x, y, z])));
    /// let slab: Vec<[f64; 3]> = slab.collect();
    ///
    /// let surface = Reconstruction::new().spacing(1.0).periodic([Some([0.0, 30.0]), None, Some([0.0, 30.0])]).run(&slab[..])?;
    /// let mesh = surface.to_mesh()?;
    /// assert!(meniscus::mesh::check(&mesh).is_closed_oriented_manifold());
    /// assert!(mesh.positions.iter().all(|[x, ..]| (0.0..=30.0).contains(x)));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn periodic(mut self, faces: [Option<[f64; 2]>; 3]) -> Self {
        self.asked.periodic = Some(faces);
        self
    }

    /// Sets where the mesh ends at the faces of a periodic box: on them, if it is not said.
    pub fn periodic_mesh(mut self, ends: PeriodicMesh) -> Self {
        self.asked.periodic_mesh = Some(ends);
        self
    }

    /// Makes the field by an indicator: clouds by default, the others are the paper's.
    pub fn indicator(mut self, kind: IndicatorKind) -> Self {
        self.asked.indicator = Some(kind);
        self
    }

    /// Sets `mu0`, the mean number of particles in a full cell, for counting.
    pub fn mu0(mut self, particles: f64) -> Self {
        self.asked.mean = Some(particles);
        self
    }

    /// Makes the field by one of the kernel methods that the paper compares against.
    pub fn method(mut self, method: Method) -> Self {
        self.asked.baseline = Some(method);
        self
    }

    /// Sets the width of smoothing in spacings, 1.6 by default, for clouds: more makes calmer water.
    pub fn smooth(mut self, spacings: f64) -> Self {
        self.asked.smooth = Some(spacings);
        self
    }

    /// Sets the width of the Gaussian in cells, a spacing and at least a cell by default, for the paper's indicators.
    pub fn sigma(mut self, cells: f64) -> Self {
        self.asked.sigma = Some(cells);
        self
    }

    /// Sets the isovalue, between 0 and 1, for the paper's indicators and for kernels; it is otherwise measured, or a half.
    pub fn iso(mut self, value: f64) -> Self {
        self.asked.iso = Some(value);
        self
    }

    /// Recovers details that smoothing loses, for the paper's indicators.
    pub fn detail(mut self) -> Self {
        self.asked.details = true;
        self
    }

    /// Makes vertex normals from the field's gradient.
    pub fn normals(mut self) -> Self {
        self.asked.normals = true;
        self
    }

    /// Carries these attributes of the particles to the vertices; without this their velocity, if they have it.
    pub fn attributes(mut self, names: impl IntoIterator<Item = impl Into<String>>) -> Self {
        self.asked.attributes = Some(Attributes::Named(names.into_iter().map(Into::into).collect()));
        self
    }

    /// Uses fewer triangles, as long as no part of the surface moves farther than so many cells.
    pub fn simplify(mut self, cells: f64) -> Self {
        self.asked.tolerance = Some(cells);
        self
    }

    /// Leaves out components, drops or bubbles, of less volume than so many cells.
    pub fn smallest_component(mut self, cells: f64) -> Self {
        self.asked.smallest_component = Some(cells);
        self
    }

    /// Leaves out drops of fewer particles, as told by their volume.
    pub fn smallest_drop(mut self, particles: u32) -> Self {
        self.asked.smallest_drop = Some(particles);
        self
    }

    /// Sets the type of particles that is meant, where an input holds several: `PartType1` of a snapshot, an array of PySPH's, a species
    /// of openPMD's. Without this it is gas, `fluid`, or the only one.
    pub fn particle_type(mut self, name: impl Into<String>) -> Self {
        self.asked.particle_type = Some(name.into());
        self
    }

    /// Leaves out particles that are not finite or too far away, and counts them, where they would be an error.
    pub fn skip_invalid(mut self) -> Self {
        self.asked.skip_invalid = true;
        self
    }

    /// Writes `.glb` files quantized and compressed (EXT_meshopt_compression).
    pub fn compress(mut self) -> Self {
        self.asked.compress = true;
        self
    }

    /// Sets the axis that points up in mesh files, which are turned where the particles have the other one up.
    pub fn up(mut self, axis: UpAxis) -> Self {
        self.asked.up = Some(axis);
        self
    }

    /// Sets the axis that points up in the particles: z for `.bi4` and y for all else, if it is not said.
    pub fn particles_up(mut self, axis: UpAxis) -> Self {
        self.asked.particles_up = Some(axis);
        self
    }

    /// Draws by the calibration of another frame, so that both are alike.
    pub fn calibrated(mut self, by: Calibration) -> Self {
        self.calibration = Some(by);
        self
    }

    /// Sets the memory that may be used: three quarters of what is available otherwise.
    pub fn memory(mut self, budget: MemoryBudget) -> Self {
        self.memory = Some(budget);
        self
    }

    /// Sets the folder for what exceeds the memory: that of the system's temporary files otherwise, where the program takes the output's.
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

    /// Whether a backend has a part in it: kernel methods have none.
    #[must_use]
    pub fn uses_backend(&self) -> bool {
        self.asked.baseline.is_none()
    }

    /// Takes a handle by which the work can be ended early, from any thread.
    pub fn cancel(mut self, cancel: Cancel) -> Self {
        self.control.cancel = cancel;
        self
    }

    /// Tells a function of progress, from whatever thread makes it. The frames of a [`Simulation`](crate::Simulation) tell of theirs by
    /// [`Event::Stage`](crate::Event::Stage) instead.
    pub fn progress(mut self, tell: impl Fn(Progress) + Send + Sync + 'static) -> Self {
        self.control.progress = Some(Arc::new(tell));
        self
    }

    /// Lists the settings that show in the bytes of a mesh, in the words of the program's options.
    #[must_use]
    pub fn settings(&self) -> Settings {
        self.asked.settings()
    }

    /// The device that it runs on, unless that is the processor.
    #[must_use]
    pub fn device(&self) -> Option<&Device> {
        self.backend.device()
    }
}
