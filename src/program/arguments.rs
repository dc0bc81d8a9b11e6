//! The commands that there are, each with its options.

use std::ffi::OsString;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use meniscus::Settings;

use super::{devices, foreign, info, inspect, options, pack, render, shells};

/// Turn particle fluids into watertight surface meshes.
#[derive(Parser)]
#[command(version, about, propagate_version = true)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Subcommand)]
pub enum Command {
    /// Reconstruct the surface of a frame of particles, or of each frame of a simulation.
    Reconstruct(Box<options::Options>),
    /// Sample a frame once, to be reconstructed later with other filters or isovalues.
    Pack(Box<pack::Options>),
    /// Say what a particle file, a packed frame or a mesh holds.
    Info(info::Options),
    /// Check that meshes are closed, oriented 2-manifolds, and measure them.
    Check(inspect::CheckOptions),
    /// List the Vulkan devices of this machine.
    Devices(devices::Options),
    /// Measure how far a mesh lies from a reference.
    Compare(inspect::CompareOptions),
    /// Draw pictures of meshes.
    Render(render::Options),
    /// Print what a shell needs to complete options.
    Completions(shells::CompletionOptions),
    /// Write the manual's pages, for man.
    Manual(shells::ManualOptions),
}

impl Arguments {
    /// Reads a command line. An error is also what `--help` and `--version` print.
    pub fn of_command_line(arguments: &[OsString]) -> Result<Self, clap::Error> {
        let mut command = Self::as_command();
        let matches = command.try_get_matches_from_mut(arguments);
        let matches = matches.map_err(|error| {
            let subcommand = arguments.get(1).and_then(|word| word.to_str());
            foreign::explained(error, &mut command, subcommand)
        })?;
        Self::from_arg_matches(&matches).map_err(|error| error.format(&mut command))
    }

    /// The commands and options, as help, completions and manual pages show them: `pack` takes
    /// settings of a surface only to refuse them with a reason.
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
