//! The command line: sees only the public interface of the library.

mod allocator;
mod devices;
mod identity;
mod info;
mod inspect;
mod interrupt;
mod lanes;
mod method;
mod pack;
mod progress;
mod reconstruct;
mod report;
mod run;
mod sampling;
mod say;
mod sequence;
mod stats;
mod up;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use meniscus::error::{Cause, Error};

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
    Reconstruct(Box<reconstruct::Options>),
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
}

/// What a command that ran to its end found.
enum Verdict {
    /// All is well.
    Good,
    /// The work was done, and something is not as it should be.
    Bad,
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
    };
    match verdict {
        Ok(Verdict::Good) => ExitCode::SUCCESS,
        Ok(Verdict::Bad) => ExitCode::from(1),
        Err(error) => {
            say::say(&format!("meniscus: {error}"));
            ExitCode::from(match error.cause() {
                Cause::Request => 2,
                Cause::Input => 3,
                Cause::Output => 4,
                Cause::Device => 5,
            })
        }
    }
}

/// Writes results to standard output. A reader that went away is no error.
fn print(text: &str) -> Result<(), Error> {
    use std::io::{ErrorKind, Write};
    match writeln!(std::io::stdout().lock(), "{text}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(meniscus::io::WriteError::new("standard output".as_ref(), error).into())
        }
        _ => Ok(()),
    }
}

/// Prints a result as JSON, for programs.
fn print_json(value: &impl serde::Serialize) -> Result<(), Error> {
    print(&serde_json::to_string_pretty(value).expect("results have string keys and finite depth"))
}
