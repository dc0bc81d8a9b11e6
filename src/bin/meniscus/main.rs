//! The command line: sees only the public interface of the library.

mod advice;
mod allocator;
mod devices;
mod info;
mod inspect;
mod interrupt;
mod method;
mod notes;
mod one_frame;
mod options;
mod outcome;
mod pack;
mod parts;
mod parts_options;
mod progress;
mod reconstruct;
mod render;
mod report;
mod run;
mod sampling;
mod say;
mod shells;
mod simulation;
mod simulation_options;
mod stats;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use meniscus::Cause;

use outcome::Verdict;

/// Turn particle fluids into watertight surface meshes.
#[derive(Parser)]
#[command(version, about, propagate_version = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
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

fn main() -> ExitCode {
    allocator::keep_freed();
    let Arguments { command } = Arguments::parse();
    let verdict = match command {
        Command::Reconstruct(options) => reconstruct::run(&options),
        Command::Pack(options) => pack::run(&options),
        Command::Info(options) => info::run(&options),
        Command::Devices(options) => devices::run(&options),
        Command::Check(options) => inspect::check(&options),
        Command::Compare(options) => inspect::compare(&options),
        Command::Render(options) => render::run(&options),
        Command::Completions(options) => shells::completions(&options, Arguments::command()),
        Command::Manual(options) => shells::manual(&options, Arguments::command()),
    };
    match verdict {
        Ok(Verdict::Good) => ExitCode::SUCCESS,
        Ok(Verdict::Bad) => ExitCode::from(1),
        Err(error) => {
            advice::say_error(&error);
            ExitCode::from(match error.cause() {
                Cause::Request => 2,
                Cause::Input => 3,
                Cause::Output => 4,
                Cause::Device => 5,
                Cause::Cancelled => 130,
                _ => 2,
            })
        }
    }
}
