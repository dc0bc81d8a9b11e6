//! Measures the paper's methods against each other and prints Markdown tables: accuracy, roughness,
//! speed, resolution, parameters, pictures.
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
    /// Where pictures go.
    #[arg(long, value_name = "DIR", default_value = "target/evaluate")]
    out: PathBuf,
    /// Particle files for the topic spacing, as FILE=SPACING; without the spacing where the file or
    /// its name says it.
    #[arg(long, value_name = "FILE[=SPACING]", num_args = 1..)]
    files: Vec<String>,
    /// Particles to take pictures of, y up, instead of a splash.
    #[arg(long, value_name = "FILE")]
    frame: Option<PathBuf>,
    /// Programs to compare, for quality.
    #[arg(long, value_name = "TABLE")]
    methods: Option<PathBuf>,
    /// Folders of frames of simulations, y up, for quality.
    #[arg(long, value_name = "DIR", num_args = 1..)]
    simulations: Vec<PathBuf>,
    /// Few particles and few runs: to see that all works.
    #[arg(long)]
    quick: bool,
    /// Particles in a mesh.
    #[arg(long, value_name = "COUNT")]
    particles: Option<usize>,
    /// How deep in a mesh its particles lie at the least, in spacings: 0.5 is spheres that touch
    /// its surface.
    #[arg(long, value_name = "SPACINGS", default_value = "0")]
    inset: f64,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Topic {
    /// Distances to meshes filled with particles (the paper's figure 13).
    Accuracy,
    /// Deviations of flat and round surfaces, holes in sheets, drops kept.
    Roughness,
    /// How still the surface of a pool at rest stands.
    Rest,
    /// Seconds a frame (table 1).
    Speed,
    /// Stage times by resolution (figure 14), and recovering details (figure 15).
    Resolution,
    /// Contact sheets of sigma and c (figure 7).
    Parameters,
    /// Every method through one camera, and bodies coloured by their distance from the truth.
    Pictures,
    /// Rules for the isovalue, by how a lattice falls on the grid.
    Isovalue,
    /// Cell, sigma and indicator: error against cost.
    Defaults,
    /// The estimated spacing over the true one, of files and of made particles, and what is said of
    /// wrong ones.
    Spacing,
    /// Side by side with other programs.
    Quality,
    /// All of these but quality, which needs those programs.
    All,
}

impl Options {
    /// What is chosen for a full run, or for a quick one.
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
