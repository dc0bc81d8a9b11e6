//! The request for a surface, built option by option.

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

/// A request for the surface of particles. Settings without a value are measured, or take their
/// defaults.
///
/// Numbers are checked when the request runs. Each run has its own threads, unless
/// [`pool`](Self::pool) is called, and changes no global state.
///
/// ```
/// use meniscus::Reconstruction;
///
/// // A ball of particles, one per unit of volume.
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
    /// A request with default settings.
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

    /// Replaces all settings.
    ///
    /// ```
    /// use meniscus::{Reconstruction, Settings};
    ///
    /// let settings = Settings { spacing: Some(0.05), normals: true, ..Settings::default() };
    /// assert_eq!(Reconstruction::new().with_settings(settings.clone()).settings(), &settings);
    /// ```
    pub fn with_settings(mut self, settings: Settings) -> Self {
        self.settings = settings;
        self
    }

    /// Sets the distance between neighbouring particles. The default comes from the file, or is
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

    /// Sets the edge of a cell, in spacings. The default is 0.5, or 2/3 for the indicators counting
    /// and symmetry.
    pub fn cell(mut self, spacings: f64) -> Self {
        (self.settings.cell_size, self.settings.cell) = (None, Some(spacings));
        self
    }

    /// Sets the walls of a tank by its lowest and highest corner. Particles outside the walls are
    /// left out. A side at -inf or inf is open.
    pub fn domain(mut self, lowest: [f64; 3], highest: [f64; 3]) -> Self {
        self.settings.domain = Some(Tank::Walls(Walls::from_corners([lowest, highest])));
        self
    }

    /// Sets the files of solids: closed meshes at which the fluid ends, such as obstacles.
    pub fn solids(mut self, files: impl IntoIterator<Item = impl Into<String>>) -> Self {
        self.settings.solid = Some(files.into_iter().map(Into::into).collect());
        self
    }

    /// Finds the walls of the tank, from a scene file next to the input, or as the planes at which
    /// the particles end. No particle is outside these walls, and an uncertain side stays open.
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

    /// Sets a periodic box by its faces along x, y and z; `None` makes an axis open. Fluid that
    /// leaves the box at a face enters at the opposite face.
    ///
    /// A particle exactly on an upper face counts as being on the lower face. A particle that is at
    /// most one spacing outside the box is wrapped: it moves by one period, and [`Census`] counts
    /// it. A particle farther outside gives an error, unless [`skip_invalid`](Self::skip_invalid)
    /// leaves it out. Open axes can have walls.
    ///
    /// [`Census`]: crate::Census
    ///
    /// ```
    /// use meniscus::Reconstruction;
    ///
    /// // Water of infinite length and width, 7 deep.
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

    /// Uses one of the kernel methods with which the paper compares its own method.
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

    /// Sets the isovalue, between 0 and 1, for counting, symmetry and the kernel methods. By
    /// default, the isovalue is measured for counting and symmetry, and is 0.5 for kernel methods.
    pub fn iso(mut self, value: f64) -> Self {
        self.settings.iso = Some(Iso::Value(value));
        self
    }

    /// Interpolates these attributes of the particles to the vertices. The default is the velocity,
    /// if the particles have it.
    pub fn attributes(mut self, names: impl IntoIterator<Item = impl Into<String>>) -> Self {
        self.settings.attributes = Some(names.into_iter().map(Into::into).collect());
        self
    }

    /// Uses only particles that satisfy conditions on their attributes.
    ///
    /// If an input has several types of particles, `type` selects one, such as `PartType1` of a
    /// snapshot, an array of PySPH, or a species of openPMD. The default is the only type, the
    /// type `fluid`, or gas if no other type can be a liquid.
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

    /// Uses the calibration of another frame, so that the surfaces of both frames are consistent.
    pub fn calibrated(mut self, by: Calibration) -> Self {
        self.calibration = Some(by);
        self
    }

    /// Limits the memory. The default is three quarters of the available memory.
    pub fn memory(mut self, budget: MemoryBudget) -> Self {
        self.memory = Some(budget);
        self
    }

    /// Sets the folder for scratch files. The default is the system's temporary folder; the program
    /// uses the output's folder.
    pub fn scratch(mut self, folder: impl Into<PathBuf>) -> Self {
        self.scratch = Some(folder.into());
        self
    }

    /// Sets the number of threads. The default is one per core.
    pub fn threads(mut self, count: usize) -> Self {
        (self.threads, self.pool) = (Some(count), None);
        self
    }

    /// Runs on the caller's thread pool instead of starting threads.
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

    /// Runs on a backend, such as a Vulkan device. Kernel methods always run on the CPU.
    pub fn backend(mut self, backend: Backend) -> Self {
        self.backend = backend;
        self
    }

    /// Whether the request uses a backend. False for kernel methods, which always run on the CPU.
    #[must_use]
    pub fn uses_backend(&self) -> bool {
        self.settings.kernels().is_none()
    }

    /// Sets a handle that can cancel the work from any thread.
    pub fn cancel(mut self, cancel: Cancel) -> Self {
        self.control.cancel = cancel;
        self
    }

    /// Calls `report` with the progress of the work, from any thread. A
    /// [`Simulation`](crate::Simulation) reports the progress of its frames through
    /// [`Event::Stage`](crate::Event::Stage) instead.
    pub fn progress(mut self, report: impl Fn(Progress) + Send + Sync + 'static) -> Self {
        self.control.progress = Some(Arc::new(report));
        self
    }

    /// Sets the attribute that holds the particles' sizes. The attribute's name determines the
    /// meaning of its values: radii, diameters, volumes, or masses, which need a density. Without
    /// this setting, `pscale`, `radius` or `spacing` is used. The name `none` gives all particles
    /// one size. Only the indicator cloud supports sizes.
    pub fn size(mut self, attribute: impl Into<String>) -> Self {
        self.settings.size = Some(attribute.into());
        self
    }

    /// The settings that affect the mesh.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The device that the request runs on; `None` for the CPU.
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
    /// Sets the origin of the grid, which is a corner of a cell.
    origin: [f64; 3],
    /// Sets how the mesh ends at the faces of a periodic box. By default, the mesh ends on the
    /// faces.
    periodic_mesh: PeriodicMesh,
    /// Sets the indicator. The default is cloud; counting and symmetry are from the paper.
    indicator: IndicatorKind,
    /// Sets `mu0`, the mean number of particles in non-empty cells, for counting.
    mu0: f64,
    /// Sets the smoothing width for clouds, in spacings; the default is 1.6. Larger values give a
    /// smoother surface.
    smooth: f64,
    /// In thin sheets and filaments, joins particles that are at most this many spacings apart. The
    /// default is 2.15, and 0 turns joining off. Works only with the indicator cloud.
    sheets: f64,
    /// Sets the distance, in spacings, between the fluid and solids. With a negative distance, the
    /// fluid reaches into solids.
    solid_offset: f64,
    /// Sets the standard deviation, in cells, of the Gaussian for counting and symmetry. The
    /// default is one spacing, but at least one cell.
    sigma: f64,
    /// With the indicators counting and symmetry, recovers details that smoothing removes, such as
    /// drops.
    detail: bool,
    /// Adds vertex normals, from the field's gradient.
    normals: bool,
    /// Reduces the number of triangles without moving any part of the surface by more than this
    /// distance, in cells.
    simplify: f64,
    /// Removes drops and bubbles whose volume is less than this number of cells.
    smallest_component: f64,
    /// Removes drops with fewer than this number of particles, which is estimated from the drop's
    /// volume.
    smallest_drop: u32,
    /// Skips particles whose position is not finite, too far from the grid's origin, or outside the
    /// periodic box, and reports their number. Without this setting, such particles give an error.
    skip_invalid: bool,
    /// Compresses the output: `.glb` files with quantization and EXT_meshopt_compression, `.vdb`
    /// files with zlib.
    compress: bool,
    /// Sets the axis that points up in mesh files; rotates the mesh if another axis points up in
    /// the particles.
    up: UpAxis,
    /// Sets the axis that points up in the particles. The default is z for `.bi4` files and y for
    /// other formats.
    particles_up: UpAxis,
}
