//! The options of `reconstruct`: what they are, what they exclude, and what they mean to the library.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytesize::ByteSize;
use clap::{Args, value_parser};
use meniscus::backend::Cpu;
use meniscus::baselines::Method;
use meniscus::error::Error;
use meniscus::field::indicator::IndicatorKind;
use meniscus::frame::estimate::SMALLEST_BUDGET;
use meniscus::frame::{Detail, Normals, Resources, Surfacing};
use meniscus::grid::units::{Isovalue, Sigma, Smooth, Tolerance};
use meniscus::io::ParticleFile;
use meniscus::io::glb::{Compression, Layout};
use meniscus::io::mnf::is_packed;
use meniscus::io::output::MeshFormat;
use meniscus::particles::Particles;
use meniscus::reconstruction::{Attributes, SamplingRequest};
use meniscus::simulation::state::Settings;
use meniscus::surface::simplify::{BYTES_A_THREAD, Reduction};
use serde_json::json;

use crate::method::MethodName;
use crate::run::RunOptions;
use crate::sampling::SamplingOptions;
use crate::sequence::SequenceOptions;
use crate::up::{Orientation, UpOptions};

#[derive(Args)]
pub struct Options {
    /// The particles of a frame, or the frames of a simulation.
    ///
    /// A frame: .bgeo, .vtk, .ply, .npy, .csv, .xyz or .bi4, gzipped or not; or a .mnf that `pack` made. The frames of a
    /// simulation: files, a folder, a glob, a name with {} for the number, or a .h5part of several steps.
    #[arg(required = true, value_name = "INPUT")]
    pub inputs: Vec<PathBuf>,
    #[command(flatten)]
    pub sampling: SamplingOptions,
    /// How calm the water is [default: 1.6].
    ///
    /// The width, in spacings, under which particles make one surface: more for the noise of FLIP, less to see every ripple.
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
    /// Where the surface is, between 0 and 1, for --indicator counting and symmetry and for kernel methods; auto: 0.47 of the
    /// field deep in the fluid, or of what the spacing tells it to be where no fluid is deep.
    #[arg(long, value_name = "VALUE|auto", value_parser = isovalue, default_value = "auto", allow_hyphen_values = true, help_heading = "Surface", hide_short_help = true)]
    pub iso: IsoOption,
    /// Recover details that smoothing loses, such as drops, for --indicator counting and symmetry.
    #[arg(long, help_heading = "Surface", hide_short_help = true)]
    pub detail: bool,
    /// The mesh: .ply, .obj, .vtk, .vtp, .stl, .usdc or .glb.
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
    attributes: Option<Vec<String>>,
    /// Use fewer triangles, within this distance.
    ///
    /// No part of the surface moves farther.
    #[arg(long, value_name = "CELLS", allow_negative_numbers = true, help_heading = "Output")]
    pub simplify: Option<f64>,
    /// Leave out whole components, drops or bubbles, of less than this volume, in cells.
    #[arg(
        long,
        value_name = "CELLS3",
        allow_negative_numbers = true,
        help_heading = "Output",
        hide_short_help = true
    )]
    pub drop_smaller: Option<f64>,
    /// Leave out drops of fewer particles, as told by their volume [default: 1, which leaves out none].
    #[arg(long, value_name = "PARTICLES", value_parser = value_parser!(u32).range(1..), help_heading = "Output", hide_short_help = true)]
    pub smallest_drop: Option<u32>,
    /// Write a .glb file quantized and compressed (EXT_meshopt_compression).
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub compress: bool,
    #[command(flatten)]
    pub up: UpOptions,
    /// Say what would be done, and do nothing.
    #[arg(long, help_heading = "Output")]
    pub dry_run: bool,
    /// Append a JSON record of counts, times and settings to this file, a line for each frame.
    #[arg(long, value_name = "FILE", help_heading = "Output", hide_short_help = true)]
    pub stats: Option<PathBuf>,
    #[command(flatten)]
    pub sequence: SequenceOptions,
    #[command(flatten)]
    pub run: RunOptions,
}

#[derive(Clone, Copy)]
pub enum IsoOption {
    Auto,
    Value(Isovalue),
}

fn isovalue(text: &str) -> Result<IsoOption, String> {
    if text == "auto" {
        return Ok(IsoOption::Auto);
    }
    let value: f64 = text.parse().map_err(|_| "a number between 0 and 1, or auto".to_owned())?;
    Isovalue::new(value).map(IsoOption::Value).map_err(|e| e.to_string())
}

impl Options {
    /// What was asked for and tells in the bytes of the mesh, by the options' names.
    pub fn settings(&self) -> Settings {
        let mut settings = self.sampling.settings();
        let iso = match self.iso {
            IsoOption::Auto => json!("auto"),
            IsoOption::Value(value) => json!(value.value()),
        };
        for (name, value) in [
            ("method", json!(self.method)),
            ("smooth", json!(self.smooth)),
            ("sigma", json!(self.sigma)),
            ("iso", iso),
            ("detail", json!(self.detail)),
            ("normals", json!(self.normals)),
            ("attributes", json!(self.attributes)),
            ("simplify", json!(self.simplify)),
            ("drop-smaller", json!(self.drop_smaller)),
            ("smallest-drop", json!(self.smallest_drop)),
            ("compress", json!(self.compress)),
        ] {
            settings.insert(name.to_owned(), value);
        }
        self.up.settings(&mut settings);
        settings
    }

    pub fn surfacing(&self) -> Result<Surfacing, Error> {
        Ok(Surfacing {
            smooth: self.smooth.map_or(Ok(Smooth::USUAL), Smooth::new)?,
            sigma: self.sigma.map(Sigma::new).transpose()?,
            iso: match self.iso {
                IsoOption::Auto => None,
                IsoOption::Value(value) => Some(value),
            },
            detail: if self.detail { Detail::Recovered } else { Detail::Smoothed },
            normals: if self.normals { Normals::Gradient } else { Normals::None },
        })
    }

    /// Whether all inputs are packed frames.
    pub fn packed(&self) -> bool {
        self.inputs.iter().all(|input| is_packed(input))
    }

    /// Refuses options of another indicator's surface.
    pub fn refuse_of_others(&self, kind: IndicatorKind) -> Result<(), Error> {
        let (given, why) = match kind {
            IndicatorKind::Cloud => (
                [
                    ("--sigma", self.sigma.is_some()),
                    ("--iso", matches!(self.iso, IsoOption::Value(_))),
                    ("--detail", self.detail),
                ],
                "is for --indicator counting and symmetry: the surface lies where distances told by clouds are 0, and --smooth \
                 says how calm it is",
            ),
            IndicatorKind::Counting | IndicatorKind::Symmetry => (
                [("--smooth", self.smooth.is_some()), ("", false), ("", false)],
                "is for --indicator cloud: --sigma says how smooth the surface of others is",
            ),
        };
        match given.into_iter().find(|&(_, given)| given) {
            None => Ok(()),
            Some((option, _)) => Err(Error::Request(format!("{option} {why}"))),
        }
    }

    /// Refuses what a frame that is sampled already cannot give.
    pub fn validate_frame_input(&self, input: &Path) -> Result<(), Error> {
        let refuse = |what: &str| {
            Err(Error::Request(format!("{}: {what} needs the particles themselves", input.display())))
        };
        if let Some(option) = self.sampling.given() {
            return refuse(option);
        }
        if self.method != MethodName::Dif {
            return refuse("--method");
        }
        if self.attributes.as_ref().is_some_and(|names| names != &["none"]) {
            return refuse("--attributes");
        }
        Ok(())
    }

    /// What a frame may take of the machine. Kernel methods run on the processor.
    pub fn resources(
        &self,
        output: &Path,
        input_bytes: impl FnOnce() -> Option<u64>,
    ) -> Result<Resources, Error> {
        let resources = self.run.resources(output, input_bytes)?;
        Ok(match self.method {
            MethodName::Dif => resources,
            _ => Resources { backend: Arc::new(Cpu), ..resources },
        })
    }

    /// What is to be left out of the surface.
    pub fn reduction(&self) -> Result<Reduction, Error> {
        if let Some(volume) = self.drop_smaller.filter(|volume| !(volume.is_finite() && *volume > 0.0)) {
            return Err(Error::Request(format!("--drop-smaller must be a positive volume; {volume} is not")));
        }
        Ok(Reduction {
            tolerance: self.simplify.map(Tolerance::new).transpose()?,
            least_volume_cells: self.drop_smaller,
            smallest_drop: self.smallest_drop.filter(|&particles| particles > 1),
        })
    }

    /// Chunks are simplified whole, and every thread has its own.
    pub fn validate_memory(&self, reduction: &Reduction, resources: &Resources) -> Result<(), Error> {
        let least = SMALLEST_BUDGET.0 + BYTES_A_THREAD * rayon::current_num_threads() as u64;
        if reduction.tolerance.is_some() && resources.budget.0 < least {
            let (least, threads) = (ByteSize(least), rayon::current_num_threads());
            return Err(Error::Request(format!(
                "--simplify with {threads} threads needs --memory of {least}; fewer --threads need less"
            )));
        }
        Ok(())
    }

    /// How the file is laid out, where the format leaves a choice.
    pub fn layout(&self, orientation: Orientation) -> Layout {
        let compression = if self.compress { Compression::Meshopt } else { Compression::None };
        Layout { up: orientation.file, compression }
    }

    /// Refuses what is asked for and the format cannot hold.
    pub fn validate_format(&self, format: MeshFormat) -> Result<(), Error> {
        let refuse = |what: &str| {
            Err(Error::Request(format!("{}: {format} cannot hold {what}", self.output.display())))
        };
        if !matches!(format, MeshFormat::Glb(_)) && self.compress {
            return Err(Error::Request(format!("{}: --compress goes with .glb", self.output.display())));
        }
        self.up.validate(format)?;
        if self.normals && !format.holds_normals() {
            return refuse("vertex normals");
        }
        if self.attributes.as_ref().is_some_and(|a| a != &["none"]) && !format.holds_attributes() {
            return refuse("vertex attributes");
        }
        Ok(())
    }

    /// The numbers of the attributes to carry.
    pub fn carried(
        &self,
        input: &Path,
        file: &ParticleFile,
        format: MeshFormat,
    ) -> Result<Vec<usize>, Error> {
        let wanted = match &self.attributes {
            None if format.holds_attributes() => Attributes::Velocity,
            None => Attributes::Named(Vec::new()),
            Some(names) if names == &["none"] => Attributes::Named(Vec::new()),
            Some(names) => Attributes::Named(names.clone()),
        };
        wanted.among(file.particles.attributes()).map_err(|error| error.of_file(input))
    }

    /// How the particles are to be sampled, whatever they are.
    pub fn request(&self) -> Result<SamplingRequest, Error> {
        let mut request = self.sampling.validate()?;
        if let Some(method) = self.rival()? {
            request.field = method.into();
        }
        // A packed frame says by itself what it is of.
        if let Some(asked) = request.field.indicator().filter(|_| !self.packed()) {
            self.refuse_of_others(asked.kind)?;
        }
        Ok(request)
    }

    /// The kernel method that was asked for, if it was one; refuses what has no meaning for it.
    fn rival(&self) -> Result<Option<Method>, Error> {
        let iso = match self.iso {
            IsoOption::Auto => Method::HALF,
            IsoOption::Value(iso) => iso.value(),
        };
        let method = match self.method {
            MethodName::Dif => return Ok(None),
            MethodName::Mueller => Method::Mueller { iso },
            MethodName::ZhuBridson => Method::ZhuBridson,
            MethodName::YuTurk => Method::YuTurk { iso },
        };
        let of_dif = [
            ("--smooth", self.smooth.is_some()),
            ("--sigma", self.sigma.is_some()),
            ("--detail", self.detail),
            ("--indicator", self.sampling.indicator_given()),
            ("--mu0", self.sampling.mu0_given()),
            ("--backend vulkan", self.run.vulkan_given()),
            ("--iso", method == Method::ZhuBridson && matches!(self.iso, IsoOption::Value(_))),
        ];
        match of_dif.into_iter().find(|&(_, given)| given) {
            None => Ok(Some(method)),
            Some((option, _)) => Err(Error::Request(format!("{option} has no meaning for this --method"))),
        }
    }
}
