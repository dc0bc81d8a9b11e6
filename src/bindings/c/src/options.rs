//! The options of a surface: those of the program's `reconstruct`, by their names.

use std::ffi::{c_char, c_void};
use std::path::Path;

use meniscus::devices::{DeviceChoice, bytes_of, device, fastest};
use meniscus::files::{InputFormat, Replace};
use meniscus::{
    Error, Faces, IndicatorKind, Iso, MemoryBudget, MethodName, PeriodicMesh, Reconstruction, Settings,
    UpAxis, default_memory,
};

use crate::coded::{coded, codes};
use crate::control::{Control, MeniscusCancel, MeniscusProgressCallback};
use crate::sized::{Growing, read};
use crate::status::{Failure, MeniscusStatus, Outcome, call};
use crate::text::{numbers, optional, optional_path, path, pointers};

/// How a cell's share of fluid is told from its particles.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusIndicator {
    /// Not said: clouds.
    Default = 0,
    /// Clouds.
    Cloud = 1,
    /// Counting, as in the paper.
    Counting = 2,
    /// Symmetry, as in the paper.
    Symmetry = 3,
}

/// How the field is made.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusMethod {
    /// By discrete indicator functions.
    Dif = 0,
    /// By the kernels of Mueller, Charypar and Gross 2003.
    Mueller = 1,
    /// By the kernels of Zhu and Bridson 2005.
    ZhuBridson = 2,
    /// By the kernels of Yu and Turk 2013.
    YuTurk = 3,
}

/// Where a mesh ends at the faces of a periodic box.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusPeriodicMesh {
    /// Not said: on them.
    Default = 0,
    /// On the faces, where it is closed as at the walls of a tank.
    Cut = 1,
    /// Beyond the faces, by as far as filters reach: copies side by side overlap.
    Overlap = 2,
}

/// An axis that points up.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusUp {
    /// Not said.
    Default = 0,
    /// The y axis.
    Y = 1,
    /// The z axis.
    Z = 2,
}

/// A format of particle files.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusFormat {
    /// Not said: the one that the extension names.
    Default = 0,
    /// Houdini's classic .bgeo.
    Bgeo = 1,
    /// DualSPHysics' .bi4.
    Bi4 = 2,
    /// Tables of text, as in .csv and .txt.
    Csv = 3,
    /// HDF5: VTKHDF, SWIFT, GADGET, openPMD, PySPH or H5Part.
    Hdf5 = 4,
    /// An array of NumPy.
    Npy = 5,
    /// Arrays of NumPy in one file.
    Npz = 6,
    /// Stanford's .ply.
    Ply = 7,
    /// Parallel VTK, .pvtp and .pvtu.
    Pvtp = 8,
    /// Legacy VTK.
    Vtk = 9,
    /// VTK's XML, .vtp and .vtu.
    Vtp = 10,
    /// Floats of 32 bits without a header, three for each particle.
    Xyz = 11,
}

/// Where the stages run; the bytes of the result are the same.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusBackend {
    /// Not said: a device where one is named, else the CPU.
    Default = 0,
    /// A discrete GPU where there is one and it is worth while, else the CPU.
    Auto = 1,
    /// The CPU.
    Cpu = 2,
    /// A Vulkan device.
    Vulkan = 3,
}

codes!(MeniscusIndicator: Default, Cloud, Counting, Symmetry);
codes!(MeniscusMethod: Dif, Mueller, ZhuBridson, YuTurk);
codes!(MeniscusPeriodicMesh: Default, Cut, Overlap);
codes!(MeniscusUp: Default, Y, Z);
codes!(MeniscusFormat: Default, Bgeo, Bi4, Csv, Hdf5, Npy, Npz, Ply, Pvtp, Vtk, Vtp, Xyz);
codes!(MeniscusBackend: Default, Auto, Cpu, Vulkan);

/// Options of a surface, by the names of the options of `meniscus reconstruct`. To be filled with zeros but for what is said: 0 and NULL
/// mean that an option is not said, and what it is then is chosen as by the program. Lengths are in the unit of the positions.
///
/// What it points to has to be there while the call lasts that is given it; only `progress` and `user` are held longer, by a
/// MeniscusSimulation.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusOptions {
    /// sizeof(MeniscusOptions).
    pub size: usize,
    /// Distance between neighbouring particles, positive; not said, it is that of the file or of the scene beside it, or estimated.
    pub spacing: f64,
    /// Half of the spacing, to be given instead of it.
    pub radius: f64,
    /// Edge of a cell, positive.
    pub cell_size: f64,
    /// Edge of a cell in spacings, positive, to be given instead of cell_size; not said, it is 0.5, and 2/3 for the paper's indicators.
    pub cell: f64,
    /// A corner of the grid's cells: 3 numbers. Not said, it is 0, 0, 0, or moved to suit particles on a lattice.
    pub origin: *const f64,
    /// A tank with walls, at which the surface ends: 6 numbers, the lowest corner and the highest; particles outside are not counted.
    /// -INFINITY and INFINITY leave an axis without walls.
    pub domain: *const f64,
    /// A box beyond whose faces the fluid repeats itself: 6 numbers, the lowest corner and the highest. -INFINITY and INFINITY leave an
    /// axis open. Particles on an upper face count as on the lower one; others outside are refused.
    pub periodic: *const f64,
    /// The type of particles, of an input that holds several: PartType1 of a snapshot, an array of PySPH, a species of openPMD.
    pub particle_type: *const c_char,
    /// Mean number of particles in a full cell, positive, for counting; not said, it is measured.
    pub mu0: f64,
    /// Width of smoothing in spacings, for clouds: not said, it is 1.6; more is calmer.
    pub smooth: f64,
    /// Width of the Gaussian in cells, positive, for the paper's indicators: not said, a spacing, and a cell at the least.
    pub sigma: f64,
    /// Isovalue between 0 and 1, for the paper's indicators and for the kernels of Mueller and of Yu and Turk: not said, it is measured,
    /// and 0.5 for kernels.
    pub iso: f64,
    /// Use fewer triangles, none farther off than so many cells; positive.
    pub simplify: f64,
    /// Leave out components, drops or bubbles, of less volume than so many cells; positive.
    pub smallest_component: f64,
    /// The names of the particles' attributes to carry to the vertices; the one name "none" for none. Not said, it is their velocity, if
    /// they have one.
    pub attributes: *const *const c_char,
    /// How many names there are.
    pub attribute_count: usize,
    /// Bytes of memory that may be used, beside the particles and the mesh; not said, three quarters of what is available.
    pub memory: u64,
    /// Folder for what exceeds the memory; not said, that of the system's temporary files, or of a conversion's output.
    pub scratch: *const c_char,
    /// The Vulkan device, by its number, its UUID or a part of its name; not said, the best.
    pub device: *const c_char,
    /// Told of progress. Not of a conversion's, which tells of events.
    pub progress: MeniscusProgressCallback,
    /// Given to progress.
    pub user: *mut c_void,
    /// A handle by which any thread can end the work early. If progress ends it, it is as if this handle had been cancelled.
    pub cancel: *const MeniscusCancel,
    /// Leave out drops of fewer particles, as told by their volume.
    pub smallest_drop: u32,
    /// Threads to use, at most 1024; not said, one for each core. Every call has its own.
    pub threads: u32,
    /// One of MeniscusIndicator.
    pub indicator: i32,
    /// One of MeniscusMethod.
    pub method: i32,
    /// One of MeniscusPeriodicMesh.
    pub periodic_mesh: i32,
    /// The axis that points up in mesh files, one of MeniscusUp; not said, that of the particles.
    pub up: i32,
    /// The axis that points up in the particles, one of MeniscusUp; not said, z for .bi4 files, else y.
    pub particles_up: i32,
    /// One of MeniscusBackend.
    pub backend: i32,
    /// Not 0: leave out particles that are not finite or too far away, and count them, where they would be an error.
    pub skip_invalid: i32,
    /// Not 0: recover details that smoothing loses, for the paper's indicators.
    pub detail: i32,
    /// Not 0: make vertex normals, from the field's gradient.
    pub normals: i32,
    /// Not 0: write .glb files quantized and compressed (EXT_meshopt_compression).
    pub compress: i32,
    /// The format of an input, whatever its extension says, one of MeniscusFormat.
    pub format: i32,
}

// SAFETY: numbers, pointers and a nullable callback.
unsafe impl Growing for MeniscusOptions {
    const NAME: &str = "MeniscusOptions";
}

/// A request by options, on a machine that is still to be chosen.
pub struct Asked {
    pub request: Reconstruction,
    pub control: Control,
    memory: MemoryBudget,
    backend: MeniscusBackend,
    device: Option<String>,
}

/// A number, where it is said: what is not a number is said, and refused by the library.
fn given(number: f64) -> Option<f64> {
    (number != 0.0).then_some(number)
}

impl Asked {
    /// Takes what a caller asks for: all defaults, where it is NULL.
    ///
    /// # Safety
    /// `at` is NULL or points to a structure of the size that it says, and what that points to is as its fields say.
    pub unsafe fn new(at: *const MeniscusOptions) -> Outcome<Self> {
        if at.is_null() {
            let control = Control::new(None, std::ptr::null_mut(), None);
            let request = control.of(Reconstruction::new());
            let (memory, backend) = (default_memory(), MeniscusBackend::Default);
            return Ok(Self { request, control, memory, backend, device: None });
        }
        // SAFETY: as for this function.
        let said = unsafe { read(at, "options") }?;
        // SAFETY: a handle that is not freed yet, or NULL.
        let control = Control::new(said.progress, said.user, unsafe { said.cancel.as_ref() });
        // SAFETY: as for this function.
        let settings = unsafe { settings(&said) }?;
        let mut request = control.of(Reconstruction::by(settings));
        if said.threads != 0 {
            request = request.threads(said.threads as usize);
        }
        let memory = if said.memory == 0 { default_memory() } else { MemoryBudget(said.memory) };
        // SAFETY: as for this function.
        let scratch = unsafe { optional_path(said.scratch, "options.scratch") }?;
        if let Some(folder) = scratch {
            request = request.scratch(folder);
        }
        // SAFETY: as for this function.
        let device = unsafe { optional(said.device, "options.device") }?.map(str::to_owned);
        let request = request.memory(memory);
        let backend = coded(said.backend, "options.backend")?;
        Ok(Self { request, control, memory, backend, device })
    }

    /// Chooses where it runs, for an input of as many bytes as is told where it matters, if that is known.
    pub fn on_machine(mut self, input_bytes: impl FnOnce(&Reconstruction) -> Option<u64>) -> Outcome<Self> {
        use MeniscusBackend::{Auto, Cpu, Default, Vulkan};
        let open = |choice| device(&choice, None).map_err(Error::from);
        let backend = match (self.backend, self.device.take()) {
            (Default | Cpu, None) => return Ok(self),
            (Cpu, Some(_)) => return Err(Failure::request("options.device: options.backend is the CPU")),
            (Auto, None) if !self.request.uses_backend() => return Ok(self),
            _ if !self.request.uses_backend() => {
                return Err(Failure::request("options.backend: kernel methods run on the CPU"));
            }
            (Auto, None) => fastest(self.memory, || input_bytes(&self.request), None).0,
            (Vulkan, None) => open(DeviceChoice::Best)?,
            (Default | Auto | Vulkan, Some(named)) => open(DeviceChoice::Named(named))?,
        };
        self.request = self.request.backend(backend);
        Ok(self)
    }

    /// Chooses where a file is surfaced.
    pub fn for_file(self, file: &Path) -> Outcome<Self> {
        self.on_machine(|_| bytes_of([file]))
    }
}

fn up(axis: i32, what: &str) -> Outcome<Option<UpAxis>> {
    Ok(match coded(axis, what)? {
        MeniscusUp::Default => None,
        MeniscusUp::Y => Some(UpAxis::Y),
        MeniscusUp::Z => Some(UpAxis::Z),
    })
}

fn format(format: i32) -> Outcome<Option<InputFormat>> {
    Ok(Some(match coded(format, "options.format")? {
        MeniscusFormat::Default => return Ok(None),
        MeniscusFormat::Bgeo => InputFormat::Bgeo,
        MeniscusFormat::Bi4 => InputFormat::Bi4,
        MeniscusFormat::Csv => InputFormat::Csv,
        MeniscusFormat::Hdf5 => InputFormat::Hdf5,
        MeniscusFormat::Npy => InputFormat::Npy,
        MeniscusFormat::Npz => InputFormat::Npz,
        MeniscusFormat::Ply => InputFormat::Ply,
        MeniscusFormat::Pvtp => InputFormat::Pvtp,
        MeniscusFormat::Vtk => InputFormat::Vtk,
        MeniscusFormat::Vtp => InputFormat::Vtp,
        MeniscusFormat::Xyz => InputFormat::Xyz,
    }))
}

/// Reads the settings of a surface.
///
/// # Safety
/// As for [`Asked::new`].
unsafe fn settings(said: &MeniscusOptions) -> Outcome<Settings> {
    if said.radius != 0.0 && said.spacing != 0.0 {
        return Err(Failure::request("options.radius and options.spacing exclude each other"));
    }
    if said.cell != 0.0 && said.cell_size != 0.0 {
        return Err(Failure::request("options.cell and options.cell_size exclude each other"));
    }
    // SAFETY: as for this function.
    let (origin, domain, periodic) =
        unsafe { (numbers(said.origin), numbers(said.domain), numbers(said.periodic)) };
    let faces = |[x0, y0, z0, x1, y1, z1]: [f64; 6]| Faces::from_corners([[x0, y0, z0], [x1, y1, z1]]);
    // SAFETY: as for this function.
    let particle_type = unsafe { optional(said.particle_type, "options.particle_type") }?.map(str::to_owned);
    Ok(Settings {
        spacing: given(said.spacing),
        radius: given(said.radius),
        cell_size: given(said.cell_size),
        cell: given(said.cell),
        origin,
        domain: domain.map(faces),
        periodic: periodic.map(faces),
        format: format(said.format)?,
        particle_type,
        indicator: match coded(said.indicator, "options.indicator")? {
            MeniscusIndicator::Default => None,
            MeniscusIndicator::Cloud => Some(IndicatorKind::Cloud),
            MeniscusIndicator::Counting => Some(IndicatorKind::Counting),
            MeniscusIndicator::Symmetry => Some(IndicatorKind::Symmetry),
        },
        mu0: given(said.mu0),
        skip_invalid: said.skip_invalid != 0,
        smooth: given(said.smooth),
        method: Some(match coded(said.method, "options.method")? {
            MeniscusMethod::Dif => MethodName::Dif,
            MeniscusMethod::Mueller => MethodName::Mueller,
            MeniscusMethod::ZhuBridson => MethodName::ZhuBridson,
            MeniscusMethod::YuTurk => MethodName::YuTurk,
        })
        .filter(|method| *method != MethodName::Dif),
        sigma: given(said.sigma),
        iso: given(said.iso).map(Iso::Value),
        detail: said.detail != 0,
        periodic_mesh: match coded(said.periodic_mesh, "options.periodic_mesh")? {
            MeniscusPeriodicMesh::Default => None,
            MeniscusPeriodicMesh::Cut => Some(PeriodicMesh::Cut),
            MeniscusPeriodicMesh::Overlap => Some(PeriodicMesh::Overlap),
        },
        normals: said.normals != 0,
        // SAFETY: as for this function.
        attributes: unsafe { attributes(said) }?,
        simplify: given(said.simplify),
        smallest_component: given(said.smallest_component),
        smallest_drop: (said.smallest_drop != 0).then_some(said.smallest_drop),
        compress: said.compress != 0,
        up: up(said.up, "options.up")?,
        particles_up: up(said.particles_up, "options.particles_up")?,
    })
}

/// Reads the names of attributes.
///
/// # Safety
/// As for [`Asked::new`].
unsafe fn attributes(said: &MeniscusOptions) -> Outcome<Option<Vec<String>>> {
    if said.attribute_count == 0 {
        return Ok(None);
    }
    // SAFETY: as for this function.
    let names = unsafe { pointers(said.attributes, said.attribute_count, "options.attributes") }?;
    let mut wanted = Vec::new();
    for (index, &name) in names.iter().enumerate() {
        // SAFETY: as for this function.
        let name = unsafe { optional(name, &format!("options.attributes[{index}]")) }?;
        wanted.extend(name.map(str::to_owned));
    }
    Ok(Some(wanted))
}

/// Whether a file that is there may be replaced.
pub fn replacing(overwrite: i32) -> Replace {
    if overwrite == 0 { Replace::Refuse } else { Replace::Allow }
}

/// Makes sure, before the work, that a mesh could be written to `path`, whose extension says the format, and that the format can hold
/// what is asked for. Leaves nothing there.
///
/// `options` may be NULL for all defaults. `overwrite`: not 0 if a file that is there may be replaced.
///
/// Pointers are NULL or as is said.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_check_output(
    path: *const c_char,
    options: *const MeniscusOptions,
    overwrite: i32,
) -> MeniscusStatus {
    call(|| {
        // SAFETY: as for this function.
        let (path, asked) = unsafe { (self::path(path, "path")?, Asked::new(options)?) };
        asked.request.output(&path, replacing(overwrite))?;
        Ok(())
    })
}
