//! The commands of the program and their options.

use std::ffi::OsString;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use meniscus::Settings;

use super::{devices, foreign, info, inspect, options, pack, render, shells};

/// Turn the particles of fluid simulations into watertight triangle meshes.
#[derive(Parser)]
#[command(version, about, propagate_version = true)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Subcommand)]
pub enum Command {
    /// Make a mesh from the particles of a frame, or of each frame of a simulation.
    Reconstruct(Box<options::ReconstructOptions>),
    /// Save a frame in a compact form (.mnf), to mesh it later with different smoothing.
    Pack(Box<pack::PackOptions>),
    /// Print what particle files, packed frames or meshes contain.
    Info(info::InfoOptions),
    /// Check that meshes are closed, oriented and manifold, and measure them.
    Check(inspect::CheckOptions),
    /// List the Vulkan devices of this machine.
    Devices(devices::DevicesOptions),
    /// Measure the distances between a mesh and a reference mesh.
    Compare(inspect::CompareOptions),
    /// Draw pictures and animations of meshes.
    Render(render::RenderOptions),
    /// Print a completion script for a shell.
    Completions(shells::CompletionOptions),
    /// Write man pages into a folder.
    Manual(shells::ManualOptions),
}

impl Arguments {
    /// Parses a command line. `--help` and `--version` give errors that contain the text to print.
    pub fn of_command_line(arguments: &[OsString]) -> Result<Self, clap::Error> {
        let mut command = Self::as_command();
        let matches = command.try_get_matches_from_mut(arguments);
        let matches = matches.map_err(|error| {
            let subcommand = arguments.get(1).and_then(|word| word.to_str());
            foreign::with_tip(error, &mut command, subcommand)
        })?;
        Self::from_arg_matches(&matches).map_err(|error| error.format(&mut command))
    }

    /// Returns the commands and options, as clap needs them for help, completions and man pages.
    /// `pack` hides the options that apply only to surfaces, but still parses them, so that it can
    /// reject them with a message that gives the reason.
    pub fn as_command() -> clap::Command {
        let is_of_surface = |id: &str| {
            Settings::ALL.iter().any(|setting| setting.name() == id && !setting.is_of_samples())
        };
        Self::command().mut_subcommand("pack", |pack| {
            pack.mut_args(|arg| {
                let hide = is_of_surface(arg.get_id().as_str());
                if hide { arg.hide(true) } else { arg }
            })
        })
    }
}
