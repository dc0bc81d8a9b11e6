//! The options of `reconstruct`, their conflicts, and their conversion to a request of the library.

use std::path::PathBuf;

use clap::Args;
use meniscus::files::InputFormat;
use meniscus::{Error, Reconstruction, Settings};

use super::parts::PartsOptions;
use super::run::RunOptions;
use super::simulation::SimulationOptions;

const INPUT: &str = "Particle files of one frame, or of all frames of a simulation";

/// The possible inputs, for `--help`.
fn inputs() -> String {
    format!(
        "One frame can be any of these files: {}; or a packed frame (.mnf). A simulation can be \
         several files, a folder, a glob (such as 'sim/*.vtk'), a pattern with {{}} for the frame \
         number, a list (.pvd, .series), or one file with several steps, such as .h5part or \
         .vtkhdf.",
        InputFormat::KNOWN
    )
}

#[derive(Args)]
pub struct ReconstructOptions {
    #[arg(required = true, value_name = "INPUT", help = INPUT, long_help = format!("{INPUT}.\n\n{}", inputs()))]
    pub inputs: Vec<PathBuf>,
    /// Merge the particles of all inputs, such as several fluids, into one surface.
    ///
    /// If the inputs are several simulations, frames with the same number make one surface. List
    /// each input only once. Attributes that are missing from one of the inputs are left out.
    #[arg(long, help_heading = "Simulations", hide_short_help = true)]
    pub together: bool,
    #[command(flatten)]
    pub settings: Settings,
    /// Mesh file; its extension selects the format.
    ///
    /// .ply, .obj, .vtk, .vtp, .pvtp, .vtkhdf, .stl, .usdc, .glb, .bgeo.sc, .abc or .vdb. For a
    /// simulation, give a pattern with {} or {:04} for the frame number, a folder, or one .abc for
    /// all frames.
    #[arg(short, long, help_heading = "Output")]
    pub output: PathBuf,
    /// Draw a picture (.png) of the mesh, or of up to 24 frames.
    #[arg(long, help_heading = "Output")]
    pub preview: bool,
    /// Print what would be done without doing it.
    #[arg(long, help_heading = "Output")]
    pub dry_run: bool,
    /// Append one line of JSON per frame to this file, with counts, times and settings.
    #[arg(long, value_name = "FILE", help_heading = "Output", hide_short_help = true)]
    pub stats: Option<PathBuf>,
    #[command(flatten)]
    pub simulation: SimulationOptions,
    #[command(flatten)]
    pub parts: PartsOptions,
    #[command(flatten)]
    pub run: RunOptions,
}

impl ReconstructOptions {
    /// Returns the request for a surface. [`RunOptions::machine`] adds the threads, the memory
    /// limit, the scratch folder and the backend.
    pub fn request(&self) -> Result<Reconstruction, Error> {
        let request = Reconstruction::new().with_settings(self.settings.clone());
        if self.run.is_backend_vulkan() && !request.uses_backend() {
            return Err(Error::Request(
                "--backend vulkan does not support this --method; use --backend cpu".into(),
            ));
        }
        Ok(request)
    }
}
