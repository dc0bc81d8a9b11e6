//! The axis that points up: in the particles, in the mesh file, and on the screen of a viewer.

use std::path::Path;

use crate::io::UpAxis;
use crate::io::glb::{GlbCompression, GlbLayout};
use crate::io::input::InputFormat;
use crate::io::output::MeshFormat;
use crate::surface::mesh::source::Corners;
use crate::surface::mesh::source::MeshSource;
use crate::surface::mesh::up::TurnedMesh;

use crate::settings::Settings;

/// The up axes of the particles, the mesh file and the screen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Orientation {
    particles: UpAxis,
    /// The axis that points up in the file's coordinates.
    pub(crate) file: UpAxis,
    /// The axis that is up on a screen, after any rotation that the file specifies.
    pub(crate) shown: UpAxis,
}

/// The axis that usually points up in the particles of a file: z for `.bi4` files of DualSPHysics,
/// y for all other formats.
#[must_use]
pub fn usual_up(input: &Path) -> UpAxis {
    if InputFormat::of(input) == Some(InputFormat::Bi4) { UpAxis::Z } else { UpAxis::Y }
}

impl Settings {
    /// The axis that usually points up in the particles of a file, depending on its format.
    #[must_use]
    pub fn usual_up(&self, input: &Path) -> UpAxis {
        match self.format {
            Some(InputFormat::Bi4) => UpAxis::Z,
            Some(_) => UpAxis::Y,
            None => usual_up(input),
        }
    }

    /// The up axes of a mesh in a format. `usual` is the up axis of the particles, unless the
    /// settings specify another.
    pub(crate) fn orientation(&self, usual: UpAxis, format: MeshFormat) -> Orientation {
        let particles = self.particles_up.unwrap_or(usual);
        match format {
            // A `.glb` stores the vertices without a rotation. Its node rotates them.
            MeshFormat::Glb(_) => Orientation { particles, file: particles, shown: UpAxis::Y },
            // In Alembic, y always points up.
            MeshFormat::Abc(_) => Orientation { particles, file: UpAxis::Y, shown: UpAxis::Y },
            _ => {
                let up = self.up.unwrap_or(particles);
                Orientation { particles, file: up, shown: up }
            }
        }
    }

    /// The layout of a file, for formats with several layouts.
    pub(crate) fn layout(&self, orientation: Orientation) -> GlbLayout {
        let compression =
            if self.compress { GlbCompression::Meshopt } else { GlbCompression::None };
        GlbLayout { up: orientation.file, compression }
    }

    /// Whether the writer of a format holds the whole mesh in memory.
    pub(crate) fn holds_whole_mesh(&self, format: MeshFormat) -> bool {
        format.holds_whole_mesh() || self.compress
    }
}

impl Orientation {
    /// The mesh, turned to the axes of the file.
    pub(crate) fn turned<'a>(&self, mesh: &'a dyn MeshSource) -> TurnedMesh<'a> {
        TurnedMesh::new(mesh, self.particles, self.file)
    }

    /// The bounding box of the mesh on the screen of a viewer.
    pub(crate) fn shown_bounds(&self, bounds: Option<Corners>) -> Option<Corners> {
        let [a, b] = bounds?.map(|corner| self.file.turned(self.shown, corner));
        Some([std::array::from_fn(|i| a[i].min(b[i])), std::array::from_fn(|i| a[i].max(b[i]))])
    }
}
