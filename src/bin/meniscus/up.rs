//! Options on which way is up.

use std::path::Path;

use clap::{Args, ValueEnum};
use meniscus::error::Error;
use meniscus::io::UpAxis;
use meniscus::io::output::MeshFormat;
use meniscus::io::up::Turned;
use meniscus::simulation::state::Settings;
use meniscus::surface::mesh::bounds::Bounds;
use meniscus::surface::mesh::source::MeshSource;
use serde_json::json;

#[derive(Args)]
pub struct UpOptions {
    /// The axis that points up in the mesh, which is turned where the particles have the other one up. In a .glb y does
    /// [default: as in the particles].
    #[arg(long, value_enum, help_heading = "Output", hide_short_help = true)]
    up: Option<Axis>,
    /// The axis that points up in the particles [default: z for .bi4, else y].
    #[arg(long, value_enum, help_heading = "Input", hide_short_help = true)]
    particles_up: Option<Axis>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Axis {
    Y,
    Z,
}

impl From<Axis> for UpAxis {
    fn from(axis: Axis) -> Self {
        match axis {
            Axis::Y => Self::Y,
            Axis::Z => Self::Z,
        }
    }
}

/// Which way is up, and where.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Orientation {
    particles: UpAxis,
    /// In the file's coordinates.
    pub file: UpAxis,
    /// As programs show it, after whatever the file says of turning.
    pub shown: UpAxis,
}

impl UpOptions {
    /// Refuses what the format has settled.
    pub fn validate(&self, format: MeshFormat) -> Result<(), Error> {
        if matches!(format, MeshFormat::Glb(_)) && self.up == Some(Axis::Z) {
            let what = "--up z: in a .glb y points up; --particles-up z says that the particles have z up";
            return Err(Error::Request(what.into()));
        }
        Ok(())
    }

    /// Of a mesh from `input`. DualSPHysics lets z point up; other simulators mostly y.
    pub fn orientation(&self, input: &Path, format: MeshFormat) -> Orientation {
        let name = input.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let usual = if name.trim_end_matches(".gz").ends_with(".bi4") { UpAxis::Z } else { UpAxis::Y };
        let particles = self.particles_up.map_or(usual, UpAxis::from);
        match format {
            // Its node turns what is stored as it is.
            MeshFormat::Glb(_) => Orientation { particles, file: particles, shown: UpAxis::Y },
            _ => {
                let up = self.up.map_or(particles, UpAxis::from);
                Orientation { particles, file: up, shown: up }
            }
        }
    }

    /// What was asked for, by the options' names.
    pub fn settings(&self, settings: &mut Settings) {
        let name = |axis: Option<Axis>| axis.map(|axis| UpAxis::from(axis).to_string());
        settings.insert("up".into(), json!(name(self.up)));
        settings.insert("particles-up".into(), json!(name(self.particles_up)));
    }
}

impl Orientation {
    /// `mesh` as it goes to the file.
    pub fn turned<'a>(&self, mesh: &'a dyn MeshSource) -> Turned<'a> {
        Turned::new(mesh, self.particles, self.file)
    }

    /// The box of what is in the file, as programs show it.
    pub fn shown_bounds(&self, bounds: Option<Bounds>) -> Option<Bounds> {
        let [a, b] = bounds?.map(|corner| self.file.turned(self.shown, corner));
        Some([std::array::from_fn(|i| a[i].min(b[i])), std::array::from_fn(|i| a[i].max(b[i]))])
    }
}
