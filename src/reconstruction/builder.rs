//! The request for a surface, step by step.

use std::path::PathBuf;
use std::sync::Arc;

use rayon::ThreadPool;

use crate::backend::Backend;
use crate::baselines::KernelMethod;
use crate::field::calibration::Calibration;
use crate::field::indicator::IndicatorKind;
use crate::grid::units::MemoryBudget;
use crate::grid::{PeriodicMesh, Walls};
use crate::io::UpAxis;
use crate::settings::{Faces, Iso, MethodName, Settings, Tank, Where};
use crate::system::cancel::Cancel;
use crate::system::control::{Control, Progress};
use crate::vulkan::Device;

/// A request for the surface of particles: what is not said is measured, or the default.
///
/// Numbers are checked when it runs. Every run has threads of its own, and sets nothing for the
/// rest of the program.
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
    pub(crate) settings: Settings,
    pub(crate) calibration: Option<Calibration>,
    pub(crate) memory: Option<MemoryBudget>,
    pub(crate) scratch: Option<PathBuf>,
    pub(crate) threads: Option<usize>,
    pub(crate) pool: Option<Arc<ThreadPool>>,
    pub(crate) backend: Backend,
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
            settings: Settings::default(),
            calibration: None,
            memory: None,
            scratch: None,
            threads: None,
            pool: None,
            backend: Backend::cpu(),
            control: Control::default(),
        }
    }

    /// Takes all settings at once.
    ///
    /// ```
    /// use meniscus::{Reconstruction, Settings};
    ///
    /// let settings = Settings { spacing: Some(0.05), normals: true, ..Settings::default() };
    /// assert_eq!(Reconstruction::by(settings.clone()).settings(), &settings);
    /// ```
    pub fn by(settings: Settings) -> Self {
        Self::new().with_settings(settings)
    }

    /// Puts settings in place of all that were asked for.
    pub fn with_settings(mut self, settings: Settings) -> Self {
        self.settings = settings;
        self
    }

    /// Sets the distance between neighbouring particles, which is otherwise taken from the file or
    /// estimated.
    pub fn spacing(mut self, length: f64) -> Self {
        (self.settings.spacing, self.settings.radius) = (Some(length), None);
        self
    }

    /// Sets the edge of a cell.
    pub fn cell_size(mut self, length: f64) -> Self {
        (self.settings.cell_size, self.settings.cell) = (Some(length), None);
        self
    }

    /// Sets the edge of a cell in spacings: 0.5 by default, two thirds for the paper's indicators.
    pub fn cell(mut self, spacings: f64) -> Self {
        (self.settings.cell_size, self.settings.cell) = (None, Some(spacings));
        self
    }

    /// Sets the walls of a tank by its lowest and its highest corner; particles outside are not
    /// counted. A side at -inf or inf is open.
    pub fn domain(mut self, lowest: [f64; 3], highest: [f64; 3]) -> Self {
        self.settings.domain = Some(Tank::Walls(Walls::from_corners([lowest, highest])));
        self
    }

    /// Sets closed meshes that the fluid ends at, such as obstacles, by their files.
    pub fn solids(mut self, files: impl IntoIterator<Item = impl Into<String>>) -> Self {
        self.settings.solid = Some(files.into_iter().map(Into::into).collect());
        self
    }

    /// Finds the walls of the tank: those of the scene beside the file, or the planes at which the
    /// particles end. No particle is outside of them, and a side that is not certain stays open.
    ///
    /// ```
    /// use meniscus::Reconstruction;
    ///
    /// // A tank that is open above, where the water has waves.
    /// let steps = |n: i32| (0..n).map(|i| f64::from(i) + 0.5);
    /// let depth = |x: f64| (12.0 + 3.0 * (x / 5.0).sin()) as i32;
    /// let water = steps(40).flat_map(|x| {
    ///     steps(depth(x)).flat_map(move |y| steps(40).map(move |z| [x, y, z]))
    /// });
    /// let water: Vec<[f64; 3]> = water.collect();
    ///
    /// let surface = Reconstruction::new().spacing(1.0).find_domain().run(&water[..])?;
    /// let [lowest, highest] = surface.report().facts.domain.ok_or("no walls")?.walls();
    /// assert!(lowest.to_array().iter().all(|at| at.abs() < 0.01));
    /// assert!((highest.x - 40.0).abs() < 0.01 && (highest.z - 40.0).abs() < 0.01);
    /// assert_eq!(highest.y, f64::INFINITY);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn find_domain(mut self) -> Self {
        self.settings.domain = Some(Tank::Auto);
        self
    }

    /// Sets a periodic box by its faces along x, y and z, `None` for an axis that is open: beyond a
    /// face the fluid goes on as it does behind the opposite one.
    ///
    /// Particles on an upper face are on the lower one; others outside are an error, or left out
    /// where such are [skipped](Self::skip_invalid). Walls can stand along open axes.
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
        self.settings.periodic = Some(Faces(faces));
        self
    }

    /// Makes the field by one of the kernel methods that the paper compares against.
    pub fn method(mut self, method: KernelMethod) -> Self {
        self.settings.method = Some(match method {
            KernelMethod::Mueller { .. } => MethodName::Mueller,
            KernelMethod::ZhuBridson => MethodName::ZhuBridson,
            KernelMethod::YuTurk { .. } => MethodName::YuTurk,
        });
        if let Some(iso) = method.iso().filter(|iso| *iso != KernelMethod::HALF) {
            self.settings.iso = Some(Iso::Value(iso));
        }
        self
    }

    /// Sets the isovalue, between 0 and 1, for the paper's indicators and for kernels; it is
    /// otherwise measured, or a half.
    pub fn iso(mut self, value: f64) -> Self {
        self.settings.iso = Some(Iso::Value(value));
        self
    }

    /// Carries these attributes of the particles to the vertices; without this their velocity, if
    /// they have it.
    pub fn attributes(mut self, names: impl IntoIterator<Item = impl Into<String>>) -> Self {
        self.settings.attributes = Some(names.into_iter().map(Into::into).collect());
        self
    }

    /// Uses only the particles that satisfy conditions on their attributes. Where an input holds
    /// several types of particles, `type` names one: `PartType1` of a snapshot, an array of PySPH, a
    /// species of openPMD; without it that is gas, `fluid`, or the only one.
    ///
    /// ```
    /// use meniscus::{Cloud, Reconstruction, Where};
    ///
    /// let positions: Vec<[f32; 3]> = (0..512).map(|i| [i / 64, i / 8 % 8, i % 8].map(|n| n as f32)).collect();
    /// let phase: Vec<f32> = positions.iter().map(|position| f32::from(position[1] > 3.5)).collect();
    /// let water: Where = "phase=0".parse()?;
    /// let request = Reconstruction::new().spacing(1.0).select(water);
    /// let mesh = request.run(&Cloud::new(&positions).with("phase", &phase))?.to_mesh()?;
    /// assert!(mesh.positions.iter().all(|position| position[1] < 4.0));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn select(mut self, conditions: Where) -> Self {
        self.settings.r#where.get_or_insert_default().push(conditions);
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

    /// Sets the folder for what exceeds the memory: that of the system's temporary files otherwise,
    /// where the program takes the output's.
    pub fn scratch(mut self, folder: impl Into<PathBuf>) -> Self {
        self.scratch = Some(folder.into());
        self
    }

    /// Sets the number of threads: one for each core otherwise.
    pub fn threads(mut self, count: usize) -> Self {
        (self.threads, self.pool) = (Some(count), None);
        self
    }

    /// Runs on threads of the caller's, beside whatever else they do, in place of threads of its
    /// own.
    ///
    /// ```
    /// use std::sync::Arc;
    ///
    /// use meniscus::Reconstruction;
    ///
    /// let pool = Arc::new(rayon::ThreadPoolBuilder::new().num_threads(2).build()?);
    /// let request = Reconstruction::new().spacing(1.0).pool(Arc::clone(&pool));
    /// let surface = request.run(&[[0.0; 3], [1.0, 0.0, 0.0]])?;
    /// assert_eq!(surface.report().threads, 2);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn pool(mut self, pool: Arc<ThreadPool>) -> Self {
        (self.threads, self.pool) = (Some(pool.current_num_threads()), Some(pool));
        self
    }

    /// Runs on a backend, such as a Vulkan device. Kernel methods run on the processor.
    pub fn backend(mut self, backend: Backend) -> Self {
        self.backend = backend;
        self
    }

    /// Whether a backend has a part in it: kernel methods have none.
    #[must_use]
    pub fn uses_backend(&self) -> bool {
        self.settings.kernels().is_none()
    }

    /// Takes a handle by which the work can be ended early, from any thread.
    pub fn cancel(mut self, cancel: Cancel) -> Self {
        self.control.cancel = cancel;
        self
    }

    /// Tells a function of progress, from whatever thread makes it. The frames of a
    /// [`Simulation`](crate::Simulation) tell of theirs by [`Event::Stage`](crate::Event::Stage)
    /// instead.
    pub fn progress(mut self, tell: impl Fn(Progress) + Send + Sync + 'static) -> Self {
        self.control.progress = Some(Arc::new(tell));
        self
    }

    /// The settings that show in the bytes of a mesh.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The device that it runs on, unless that is the processor.
    #[must_use]
    pub fn device(&self) -> Option<&Device> {
        self.backend.device()
    }
}

macro_rules! setters {
    ($($(#[doc = $doc:literal])* $name:ident: $type:ty,)*) => {
        impl Reconstruction {
            $(
                $(#[doc = $doc])*
                pub fn $name(mut self, value: $type) -> Self {
                    self.settings.$name = value.into();
                    self
                }
            )*
        }
    };
}

setters! {
    /// Sets a corner of the grid's cells.
    origin: [f64; 3],
    /// Sets where the mesh ends at the faces of a periodic box: on them, if it is not said.
    periodic_mesh: PeriodicMesh,
    /// Makes the field by an indicator: clouds by default, the others are the paper's.
    indicator: IndicatorKind,
    /// Sets `mu0`, the mean number of particles in a full cell, for counting.
    mu0: f64,
    /// Sets the width of smoothing in spacings, 1.6 by default, for clouds: more makes calmer
    /// water.
    smooth: f64,
    /// Joins neighbours in a sheet or a thread up to so many spacings apart, 2.15 by default; 0 joins
    /// none. For clouds.
    sheets: f64,
    /// Sets by how many spacings the fluid ends before solids; less than 0, it reaches into them.
    solid_offset: f64,
    /// Sets the width of the Gaussian in cells, a spacing and at least a cell by default, for the
    /// paper's indicators.
    sigma: f64,
    /// Recovers details that smoothing loses, for the paper's indicators.
    detail: bool,
    /// Makes vertex normals from the field's gradient.
    normals: bool,
    /// Uses fewer triangles, as long as no part of the surface moves farther than so many cells.
    simplify: f64,
    /// Leaves out components, drops or bubbles, of less volume than so many cells.
    smallest_component: f64,
    /// Leaves out drops of fewer particles, as told by their volume.
    smallest_drop: u32,
    /// Leaves out particles that are not finite or too far away, and counts them, where they would
    /// be an error.
    skip_invalid: bool,
    /// Writes `.glb` files quantized and compressed (EXT_meshopt_compression).
    compress: bool,
    /// Sets the axis that points up in mesh files, which are turned where the particles have the
    /// other one up.
    up: UpAxis,
    /// Sets the axis that points up in the particles: z for `.bi4` and y for all else, if it is not
    /// said.
    particles_up: UpAxis,
}
