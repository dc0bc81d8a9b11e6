//! The axis that points up: in the particles, in the mesh file, and on the screens of programs that
//! show it.

use std::path::Path;

use crate::io::UpAxis;
use crate::io::glb::{Compression, Layout};
use crate::io::input::InputFormat;
use crate::io::output::MeshFormat;
use crate::surface::mesh::source::Bounds;
use crate::surface::mesh::source::MeshSource;
use crate::surface::mesh::up::Turned;

use crate::settings::Settings;

/// The axes that point up, from particles to what programs show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Orientation {
    particles: UpAxis,
    /// The axis in the file's coordinates.
    pub(crate) file: UpAxis,
    /// The axis that is up on a screen, after whatever the file says of turning.
    pub(crate) shown: UpAxis,
}

/// The axis that points up in the particles of a file, by who wrote it: DualSPHysics lets z point
/// up, other simulators mostly y.
#[must_use]
pub fn usual_up(input: &Path) -> UpAxis {
    if InputFormat::of(input) == Some(InputFormat::Bi4) { UpAxis::Z } else { UpAxis::Y }
}

impl Settings {
    /// The axis that points up in the particles of a file, by its format.
    #[must_use]
    pub fn usual_up(&self, input: &Path) -> UpAxis {
        match self.format {
            Some(InputFormat::Bi4) => UpAxis::Z,
            Some(_) => UpAxis::Y,
            None => usual_up(input),
        }
    }

    /// The axes of a mesh in a format, of particles whose usual axis is known.
    pub(crate) fn orientation(&self, usual: UpAxis, format: MeshFormat) -> Orientation {
        let particles = self.particles_up.unwrap_or(usual);
        match format {
            // Its node turns what is stored as it is.
            MeshFormat::Glb(_) => Orientation { particles, file: particles, shown: UpAxis::Y },
            _ => {
                let up = self.up.unwrap_or(particles);
                Orientation { particles, file: up, shown: up }
            }
        }
    }

    /// The layout of a file, where its format leaves a choice.
    pub(crate) fn layout(&self, orientation: Orientation) -> Layout {
        let compression = if self.compress { Compression::Meshopt } else { Compression::None };
        Layout { up: orientation.file, compression }
    }

    /// Whether the writer of a format holds the mesh as a whole.
    pub(crate) fn holds_whole_mesh(&self, format: MeshFormat) -> bool {
        format.holds_whole_mesh() || self.compress
    }
}

impl Orientation {
    /// A mesh as it goes to the file.
    pub(crate) fn turned<'a>(&self, mesh: &'a dyn MeshSource) -> Turned<'a> {
        Turned::new(mesh, self.particles, self.file)
    }

    /// The box of what is in the file, as programs show it.
    pub(crate) fn shown_bounds(&self, bounds: Option<Bounds>) -> Option<Bounds> {
        let [a, b] = bounds?.map(|corner| self.file.turned(self.shown, corner));
        Some([std::array::from_fn(|i| a[i].min(b[i])), std::array::from_fn(|i| a[i].max(b[i]))])
    }
}
