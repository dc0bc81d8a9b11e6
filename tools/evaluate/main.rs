//! Compares the paper's methods and prints Markdown tables: accuracy, roughness, speed, resolution,
//! parameters, pictures.
//!
//! `cargo run --release --example evaluate -- [TOPIC] [--out DIR] [--quick] [MESH...]`

mod accuracy;
mod camera;
mod defaults;
mod isovalue;
#[path = "../../tests/common/shapes.rs"]
mod meshes;
mod methods;
mod pictures;
mod quality;
mod resolution;
mod rest;
mod roughness;
mod sample;
#[path = "../bench/scene.rs"]
mod scene;
mod shapes;
mod solids;
mod spacing;
mod speed;
mod tables;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, ValueEnum};

type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

#[derive(Parser)]
struct Options {
    /// What to measure.
    #[arg(default_value = "all")]
    topic: Topic,
    /// Closed meshes to fill with particles, besides a sphere and a torus.
    meshes: Vec<PathBuf>,
    /// Folder for pictures.
    #[arg(long, value_name = "DIR", default_value = "target/evaluate")]
    out: PathBuf,
    /// Particle files for the topic spacing, as FILE=SPACING, or only FILE if the file or its name
    /// contains the spacing.
    #[arg(long, value_name = "FILE[=SPACING]", num_args = 1..)]
    files: Vec<String>,
    /// Particle file for pictures, with y up. By default, the pictures show a splash.
    #[arg(long, value_name = "FILE")]
    frame: Option<PathBuf>,
    /// Table of the programs to compare, for the topic quality.
    #[arg(long, value_name = "TABLE")]
    methods: Option<PathBuf>,
    /// Run only this part of the topic quality.
    #[arg(long)]
    part: Option<quality::Part>,
    /// Folders with the frames of simulations, with y up, for the topic quality.
    #[arg(long, value_name = "DIR", num_args = 1..)]
    simulations: Vec<PathBuf>,
    /// Use few particles and few runs, to check that everything works.
    #[arg(long)]
    quick: bool,
    /// Number of particles to fill a mesh with.
    #[arg(long, value_name = "COUNT")]
    particles: Option<usize>,
    /// Minimum depth of particles below a mesh's surface, in spacings. At 0.5, the particles'
    /// spheres touch the surface.
    #[arg(long, value_name = "SPACINGS", default_value = "0")]
    inset: f64,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Topic {
    /// Distances to meshes filled with particles (the paper's figure 13).
    Accuracy,
    /// Roughness of flat and round surfaces, holes in sheets, and number of drops that remain.
    Roughness,
    /// Stability of the surface of a pool at rest.
    Rest,
    /// Stability of the contact line of a ball that moves through a pool.
    Solids,
    /// Seconds per frame (table 1).
    Speed,
    /// Stage times for several resolutions (figure 14), and recovering details (figure 15).
    Resolution,
    /// Contact sheets for several values of sigma and c (figure 7).
    Parameters,
    /// Pictures of every method from one camera, and of bodies coloured by the surface's distance
    /// from the true one.
    Pictures,
    /// Rules for the isovalue, at many positions of a lattice relative to the grid.
    Isovalue,
    /// Error and cost for several cell sizes, sigmas and indicators.
    Defaults,
    /// The estimated spacing divided by the true one, for files and for generated particles, and
    /// the warnings about wrong spacings.
    Spacing,
    /// Comparison with other programs.
    Quality,
    /// All topics except quality, which needs other programs.
    All,
}

impl Options {
    /// Returns `quick` for a quick run, and `full` otherwise.
    fn choose<T>(&self, full: T, quick: T) -> T {
        if self.quick { quick } else { full }
    }

    fn particles(&self) -> usize {
        self.particles.unwrap_or(self.choose(20_000, 3_000))
    }
}

fn main() -> ExitCode {
    let options = Options::parse();
    let run: &[fn(&Options) -> Outcome<()>] = match options.topic {
        Topic::Accuracy => &[accuracy::run],
        Topic::Roughness => &[roughness::run],
        Topic::Rest => &[rest::run],
        Topic::Solids => &[solids::run],
        Topic::Speed => &[speed::run],
        Topic::Resolution => &[resolution::run],
        Topic::Parameters => &[pictures::parameters],
        Topic::Pictures => &[pictures::run],
        Topic::Isovalue => &[isovalue::run],
        Topic::Defaults => &[defaults::run],
        Topic::Spacing => &[spacing::run],
        Topic::Quality => &[quality::run],
        Topic::All => &[
            accuracy::run,
            roughness::run,
            rest::run,
            solids::run,
            speed::run,
            resolution::run,
            pictures::parameters,
            pictures::run,
            isovalue::run,
            defaults::run,
            spacing::run,
        ],
    };
    match run.iter().try_for_each(|run| run(&options)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(fault) => {
            eprintln!("evaluate: {fault}");
            ExitCode::FAILURE
        }
    }
}
