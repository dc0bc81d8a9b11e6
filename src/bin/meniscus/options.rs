//! The options of `reconstruct`: what they are, what they exclude, and what they mean to the library.

use std::path::PathBuf;

use clap::{Args, ValueEnum, value_parser};
use meniscus::{Error, Method, PeriodicMesh, Reconstruction, UpAxis};

use crate::method::MethodName;
use crate::parts_options::PartsOptions;
use crate::run::RunOptions;
use crate::sampling::SamplingOptions;
use crate::simulation_options::SimulationOptions;

#[derive(Args)]
pub struct Options {
    /// The particles of a frame, or the frames of a simulation.
    ///
    /// A frame: .bgeo, .vtk, .vtu, .pvtu, .ply, .npy, .csv, .xyz, .bi4 or HDF5, gzipped or not; or a .mnf that `pack` made. The frames of
    /// a simulation: files, a folder, a glob, a name with {} for the number, or a .h5part or .vtkhdf of several steps.
    #[arg(required = true, value_name = "INPUT")]
    pub inputs: Vec<PathBuf>,
    #[command(flatten)]
    pub sampling: SamplingOptions,
    /// Smoothing width in spacings; more is calmer [default: 1.6].
    ///
    /// Particles that close make one surface: 2 for the noise of FLIP, less to see every ripple. For --indicator cloud.
    #[arg(long, value_name = "SPACINGS", allow_negative_numbers = true, help_heading = "Surface")]
    pub smooth: Option<f64>,
    /// How the field is made: by discrete indicator functions, or by a kernel method to compare them with.
    #[arg(long, value_enum, default_value = "dif", help_heading = "Surface", hide_short_help = true)]
    pub method: MethodName,
    /// Width of the Gaussian, for --indicator counting and symmetry [default: a spacing, and a cell at the least].
    #[arg(
        long,
        value_name = "CELLS",
        allow_negative_numbers = true,
        help_heading = "Surface",
        hide_short_help = true
    )]
    pub sigma: Option<f64>,
    /// Isovalue between 0 and 1, for --indicator counting and symmetry and --method mueller and yu-turk.
    ///
    /// auto is 0.47 of the field deep in the fluid. Where no fluid is deep, the spacing tells what the field would be there. For kernel
    /// methods auto is 0.5.
    #[arg(long, value_name = "VALUE|auto", value_parser = isovalue, default_value = "auto", allow_hyphen_values = true, help_heading = "Surface", hide_short_help = true)]
    pub iso: IsoOption,
    /// Recover details that smoothing loses, such as drops, for --indicator counting and symmetry.
    #[arg(long, help_heading = "Surface", hide_short_help = true)]
    pub detail: bool,
    /// Where the mesh ends at the faces of a periodic box [default: cut].
    #[arg(long, value_enum, value_name = "ENDS", help_heading = "Surface", hide_short_help = true)]
    periodic_mesh: Option<PeriodicMeshName>,
    /// The mesh: .ply, .obj, .vtk, .vtp, .pvtp, .vtkhdf, .stl, .usdc or .glb.
    ///
    /// Of a simulation: a name with {} or {:04} for the number, or a folder.
    #[arg(short, long, help_heading = "Output")]
    pub output: PathBuf,
    /// Vertex normals, from the field's gradient.
    #[arg(long, help_heading = "Output")]
    pub normals: bool,
    /// Attributes to carry to the vertices [default: velocity].
    ///
    /// Those of the particles by their names, or none. Velocity goes where the format can hold it.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', help_heading = "Output")]
    pub attributes: Option<Vec<String>>,
    /// Use fewer triangles, within this distance.
    ///
    /// No part of the surface moves farther.
    #[arg(long, value_name = "CELLS", allow_negative_numbers = true, help_heading = "Output")]
    pub simplify: Option<f64>,
    /// Leave out whole components, drops or bubbles, of less than this volume, in cells.
    #[arg(
        long,
        alias = "drop-smaller",
        value_name = "CELLS3",
        allow_negative_numbers = true,
        help_heading = "Output",
        hide_short_help = true
    )]
    pub smallest_component: Option<f64>,
    /// Leave out drops of fewer particles, as told by their volume [default: 1, which leaves out none].
    #[arg(long, value_name = "PARTICLES", value_parser = value_parser!(u32).range(1..), help_heading = "Output", hide_short_help = true)]
    pub smallest_drop: Option<u32>,
    /// Draw a picture beside the mesh, as .png; of a simulation a sheet of its frames.
    #[arg(long, help_heading = "Output")]
    pub preview: bool,
    /// Write a .glb file quantized and compressed (EXT_meshopt_compression).
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub compress: bool,
    /// The axis that points up in the mesh, which is turned where the particles have the other one up. In a .glb y does
    /// [default: as in the particles].
    #[arg(long, value_enum, help_heading = "Output", hide_short_help = true)]
    up: Option<Axis>,
    /// The axis that points up in the particles [default: z for .bi4, else y].
    #[arg(long, value_enum, help_heading = "Input", hide_short_help = true)]
    particles_up: Option<Axis>,
    /// Say what would be done, and do nothing.
    #[arg(long, help_heading = "Output")]
    pub dry_run: bool,
    /// Append a JSON record of counts, times and settings to this file, a line for each frame.
    #[arg(long, value_name = "FILE", help_heading = "Output", hide_short_help = true)]
    pub stats: Option<PathBuf>,
    #[command(flatten)]
    pub simulation: SimulationOptions,
    #[command(flatten)]
    pub parts: PartsOptions,
    #[command(flatten)]
    pub run: RunOptions,
}

#[derive(Clone, Copy)]
pub enum IsoOption {
    Auto,
    Value(f64),
}

fn isovalue(text: &str) -> Result<IsoOption, String> {
    if text == "auto" {
        return Ok(IsoOption::Auto);
    }
    text.parse().map(IsoOption::Value).map_err(|_| "a number between 0 and 1, or auto".to_owned())
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Axis {
    Y,
    Z,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PeriodicMeshName {
    /// On the faces, where it is closed as at the walls of a tank.
    Cut,
    /// Beyond them, by as far as filters reach: copies side by side overlap.
    Overlap,
}

impl From<PeriodicMeshName> for PeriodicMesh {
    fn from(ends: PeriodicMeshName) -> Self {
        match ends {
            PeriodicMeshName::Cut => Self::Cut,
            PeriodicMeshName::Overlap => Self::Overlap,
        }
    }
}

impl From<Axis> for UpAxis {
    fn from(axis: Axis) -> Self {
        match axis {
            Axis::Y => Self::Y,
            Axis::Z => Self::Z,
        }
    }
}

impl Options {
    /// Returns the request for a surface, without the machine's part.
    pub fn request(&self) -> Result<Reconstruction, Error> {
        let method = match self.method {
            MethodName::Dif => None,
            MethodName::Mueller => Some(Method::Mueller { iso: Method::HALF }),
            MethodName::ZhuBridson => Some(Method::ZhuBridson),
            MethodName::YuTurk => Some(Method::YuTurk { iso: Method::HALF }),
        };
        let mut request = self.sampling.request(Reconstruction::new())?;
        if let Some(method) = method {
            request = request.method(method);
        }
        if self.run.vulkan_given() && !request.uses_backend() {
            return Err(Error::Request("--backend vulkan has no meaning for this --method".into()));
        }
        if let Some(spacings) = self.smooth {
            request = request.smooth(spacings);
        }
        if let Some(cells) = self.sigma {
            request = request.sigma(cells);
        }
        if let IsoOption::Value(value) = self.iso {
            request = request.iso(value);
        }
        if self.detail {
            request = request.detail();
        }
        if let Some(ends) = self.periodic_mesh {
            request = request.periodic_mesh(ends.into());
        }
        if self.normals {
            request = request.normals();
        }
        if let Some(names) = &self.attributes {
            let none = names == &["none"];
            request = request.attributes(names.iter().filter(|_| !none));
        }
        if let Some(cells) = self.simplify {
            request = request.simplify(cells);
        }
        if let Some(cells) = self.smallest_component {
            request = request.smallest_component(cells);
        }
        if let Some(particles) = self.smallest_drop {
            request = request.smallest_drop(particles);
        }
        if self.compress {
            request = request.compress();
        }
        if let Some(axis) = self.up {
            request = request.up(axis.into());
        }
        if let Some(axis) = self.particles_up {
            request = request.particles_up(axis.into());
        }
        Ok(request)
    }

    /// Whether the isovalue was given.
    pub fn iso_given(&self) -> bool {
        matches!(self.iso, IsoOption::Value(_))
    }
}
