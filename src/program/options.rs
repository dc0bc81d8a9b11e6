//! The options of `reconstruct`: what they are, what they exclude, and what they mean to the
//! library.

use std::path::PathBuf;

use clap::Args;
use meniscus::files::InputFormat;
use meniscus::{Error, Reconstruction, Settings};

use super::parts::PartsOptions;
use super::run::RunOptions;
use super::simulation::SimulationOptions;

const INPUT: &str = "The particles of a frame, or the frames of a simulation";

/// The inputs that there can be, in words.
fn inputs() -> String {
    format!(
        "A frame: {}; or a .mnf that `pack` made. The frames of a simulation: files, a folder, a glob, a name with {{}} for \
         the number, or a .h5part or .vtkhdf of several steps.",
        InputFormat::KNOWN
    )
}

#[derive(Args)]
pub struct Options {
    #[arg(required = true, value_name = "INPUT", help = INPUT, long_help = format!("{INPUT}.\n\n{}", inputs()))]
    pub inputs: Vec<PathBuf>,
    /// Make one surface of the particles of all inputs, such as several fluids.
    ///
    /// Of several simulations, frames with the same number make one surface. Each input is named
    /// once, and an attribute that an input lacks is left out.
    #[arg(long, help_heading = "Simulations", hide_short_help = true)]
    pub together: bool,
    #[command(flatten)]
    pub settings: Settings,
    /// The mesh: .ply, .obj, .vtk, .vtp, .pvtp, .vtkhdf, .stl, .usdc, .glb or .bgeo.sc.
    ///
    /// Of a simulation: a name with {} or {:04} for the number, or a folder.
    #[arg(short, long, help_heading = "Output")]
    pub output: PathBuf,
    /// Draw a picture beside the mesh, as .png; of a simulation a sheet of its frames.
    #[arg(long, help_heading = "Output")]
    pub preview: bool,
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

impl Options {
    /// Returns the request for a surface, without the machine's part.
    pub fn request(&self) -> Result<Reconstruction, Error> {
        let request = Reconstruction::by(self.settings.clone());
        if self.run.vulkan_given() && !request.uses_backend() {
            return Err(Error::Request("--backend vulkan has no meaning for this --method".into()));
        }
        Ok(request)
    }
}
