//! The commands that there are, each with its options.

use clap::{Parser, Subcommand};

use crate::{devices, info, inspect, options, pack, render, shells};

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
