//! The Python module `meniscus._meniscus`: the library's facade with NumPy arrays.
//!
//! [`arrays`] reads arrays in place. [`work`] runs the library without the interpreter's lock,
//! until the call ends or Ctrl-C cancels it. [`options`] converts keywords, which are the program's
//! options. [`errors`] converts errors to exceptions with the same messages.

mod arrays;
mod backends;
mod errors;
mod files;
mod frame;
mod memory;
mod mesh;
mod options;
mod particles;
mod program;
mod reconstruct;
mod report;
mod simulation;
mod summary;
mod values;
mod volume;
mod work;

use pyo3::prelude::*;

/// Watertight surface meshes from particle fluids: see the package `meniscus`, which exports these
/// items.
#[pymodule]
mod _meniscus {
    #[pymodule_export]
    use crate::files::{ParticleData, list_frames, read_particles};
    #[pymodule_export]
    use crate::frame::Frame;
    #[pymodule_export]
    use crate::mesh::Mesh;
    #[pymodule_export]
    use crate::program::program;
    #[pymodule_export]
    use crate::reconstruct::reconstruct;
    #[pymodule_export]
    use crate::report::{Check, Report};
    #[pymodule_export]
    use crate::simulation::Simulation;
    #[pymodule_export]
    use crate::summary::{Event, Summary};
    #[pymodule_export]
    use crate::volume::Volume;

    use super::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
