//! Watertight surface meshes from particle fluids, by discrete indicator functions.
//!
//! ```text
//! particles --bin--> binned particles --indicate--> DIF bricks, mu0         brick, field::indicator
//! DIF bricks --calibrate--> plateau, and for the paper's ones the isovalue  field::calibration
//! DIF bricks --gather(halo)--> blocks --blur--> [--distances--> | --detail-->] --dual MC-->  field, surface, backend
//! block surfaces --stitch--> mesh --write--> file                           surface::stitch, io
//! ```
//!
//! Everything from a particle to the field is integer, so the result depends on nothing but the input: not
//! on the particles' order, the threads, or how the field is stored. Every mesh is a closed, oriented
//! 2-manifold; vertices are shared by the identity of the grid edge that they lie on.
//!
//! The formulas, their sources and a glossary are in [`method`].
//!
//! ```
//! use meniscus::Reconstruction;
//!
//! // A ball of particles, one a unit.
//! let steps = || (-6..=6).map(f64::from);
//! let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
//! let ball: Vec<[f64; 3]> = lattice.filter(|p| p.iter().map(|c| c * c).sum::<f64>() < 36.0).collect();
//!
//! let surface = Reconstruction::new().spacing(1.0).run(&ball[..])?;
//! let folder = tempfile::tempdir()?;
//! surface.write(folder.path().join("ball.ply"))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod backend;
mod baselines;
mod brick;
pub mod error;
mod field;
mod frame;
mod grid;
mod io;
mod particles;
mod reconstruction;
mod simulation;
mod surface;
mod system;
mod vulkan;

#[doc = include_str!("method.md")]
pub mod method {}

/// Guides: what goes in and out, simulations, what to choose, how accurate and how fast it is, GPUs, and limits.
pub mod guide {
    #[doc = include_str!("field/accuracy.md")]
    pub mod accuracy {}
    #[doc = include_str!("field/choosing.md")]
    pub mod choosing {}
    #[doc = include_str!("io/formats.md")]
    pub mod formats {}
    #[doc = include_str!("vulkan/guide.md")]
    pub mod gpus {}
    #[doc = include_str!("reconstruction/limits.md")]
    pub mod limits {}
    #[doc = include_str!("io/mnf/packed.md")]
    pub mod packed {}
    #[doc = include_str!("surface/simplify/guide.md")]
    pub mod simplifying {}
    #[doc = include_str!("simulation/guide.md")]
    pub mod simulations {}
    #[doc = include_str!("frame/speed.md")]
    pub mod speed {}
}

/// Meshes: their pieces, whole ones in memory, and what there is to check, to measure and to compare.
pub mod mesh {
    pub use crate::io::output::read_mesh;
    pub use crate::surface::mesh::check::{Report as CheckReport, check};
    pub use crate::surface::mesh::compare::{Comparison, Distances, Side, compare};
    pub use crate::surface::mesh::measure::{Measures, Quality, measure};
    pub use crate::surface::mesh::source::{MeshSource, Outline, Vertices};
    pub use crate::surface::mesh::{Mesh, VertexAttribute};
}

/// Files: formats, outputs that are made ready before the work, and what a file holds.
pub mod files {
    pub use crate::io::UpAxis;
    pub use crate::io::identity::is_same_file;
    pub use crate::io::input::file_and_step;
    pub use crate::io::output::MeshFormat;
    pub use crate::io::whole::Replace;
    pub use crate::particles::AttributeInfo;
    pub use crate::reconstruction::{
        FrameInfo, Info, MeshInfo, Output, Packed, PackedOutput, ParticlesInfo, info,
    };
}

/// Where stages run: the processor, a Vulkan device, or a caller's own.
pub mod devices {
    pub use crate::backend::choice::{OnCpu, bytes_of, device, fastest};
    pub use crate::backend::{Backend, Cpu, Vulkan, Work};
    pub use crate::frame::resident::{Exchange, Pipeline, ResidentSurface, Settings};
    pub use crate::vulkan::{
        Counters, Device, DeviceChoice, DeviceInfo, DeviceKind, DeviceOptions, Foreign, Instance, Timing,
    };
}

#[allow(missing_docs)]
/// All rooms of the house, for its own tests and tools: what is in here may change from one version to the next.
pub mod internals {
    pub mod backend {
        pub use crate::backend::*;
    }
    pub mod baselines {
        pub use crate::baselines::*;
    }
    pub mod brick {
        pub use crate::brick::*;
    }
    pub mod field {
        pub use crate::field::*;
    }
    pub mod frame {
        pub use crate::frame::*;
    }
    pub mod grid {
        pub use crate::grid::*;
    }
    pub mod io {
        pub use crate::io::*;
    }
    pub mod particles {
        pub use crate::particles::*;
    }
    pub mod reconstruction {
        pub use crate::reconstruction::*;
    }
    pub mod simulation {
        pub use crate::simulation::*;
    }
    pub mod surface {
        pub use crate::surface::*;
    }
    pub mod system {
        pub use crate::system::*;
    }
    pub mod vulkan {
        pub use crate::vulkan::*;
    }
}

pub use baselines::Method;
pub use brick::{Census, FrameFacts};
pub use error::{Cause, Error};
pub use field::calibration::{Calibrated, Calibration, Plateau};
pub use field::indicator::{Indicator, IndicatorKind};
pub use frame::Shortfall;
pub use grid::units::{Isovalue, MeanCount, MemoryBudget};
pub use grid::{Domain, Grid};
pub use io::UpAxis;
pub use particles::{Particles, StridedPositions};
pub use reconstruction::{
    Cells, Doubt, Emptiness, Frame, Needs, Opened, Reconstruction, Report, SpacingSource, Surface, Warning,
};
pub use simulation::{
    Event, Forecast, FrameDone, FrameFailed, Largest, LeftOut, LiveSimulation, Missing, Simulation, Summary,
    Tallied,
};
pub use surface::simplify::Dropped;
pub use system::cancel::Cancel;
pub use system::control::{Progress, Stage};
pub use system::memory::{default_memory, peak_memory};
pub use system::timings::Timings;
