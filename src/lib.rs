//! Watertight surface meshes from the particles of fluid simulations (SPH, PBD, FLIP, MPM).
//!
//! | to | use |
//! |---|---|
//! | mesh one frame, from memory or a file | [`Reconstruction`], which gives a [`Surface`] and a [`Report`] |
//! | get vertices, triangles and attributes in memory | [`Surface::to_mesh`], which gives a [`mesh::Mesh`] |
//! | get a level set | [`Surface::volume`], which gives a [`Volume`] |
//! | try several surfaces of the same particles | [`Reconstruction::sample`], which gives a [`Frame`] |
//! | convert the files of a simulation | [`Simulation`] |
//! | mesh frames from memory with one calibration, while a simulation runs | [`LiveSimulation`] |
//! | mesh a frame that is too large for one machine | [`Parts`] |
//! | add attributes to positions in memory | [`Cloud`] |
//! | set every option of the program | [`Settings`] |
//! | cancel any of these | [`Cancel`] |
//!
//! Functions that can fail return an [`Error`]. Its [`Cause`] says what is at fault, such as the
//! request or the input.
//!
//! # A frame from memory
//!
//! ```
//! use meniscus::Reconstruction;
//!
//! // A ball of particles, one per unit of volume.
//! let steps = || (-6..=6).map(f64::from);
//! let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
//! let ball: Vec<[f64; 3]> = lattice.filter(|p| p.iter().map(|c| c * c).sum::<f64>() < 36.0).collect();
//!
//! let surface = Reconstruction::new().spacing(1.0).run(&ball)?;
//! let folder = tempfile::tempdir()?;
//! surface.write(folder.path().join("ball.ply"))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Frames of a simulation
//!
//! ```
//! use meniscus::{Event, Reconstruction, Simulation};
//!
//! # let folder = tempfile::tempdir()?;
//! # std::env::set_current_dir(folder.path())?;
//! # std::fs::create_dir("particles")?;
//! # for frame in 0..3_u8 {
//! #     let ball = (0..3375).map(|i| [i % 15, i / 15 % 15, i / 225].map(|c| f32::from(c as u8 + frame)));
//! #     let bytes: Vec<u8> = ball.flatten().flat_map(f32::to_le_bytes).collect();
//! #     std::fs::write(format!("particles/water_{frame}.xyz"), bytes)?;
//! # }
//! let mut triangles = 0;
//! let summaries = Simulation::new("particles/water_{}.xyz", "mesh/water_{:04}.ply")
//!     .reconstruction(Reconstruction::new().spacing(1.0))
//!     .resume()
//!     .run(|event| {
//!         if let Event::Done(frame) = event {
//!             triangles += frame.mesh.triangles;
//!         }
//!     })?;
//! for failed in summaries.iter().flat_map(|summary| &summary.failed) {
//!     eprintln!("frame {}: {}", failed.frame, failed.error);
//! }
//! assert!(triangles > 0 && summaries.iter().all(|summary| summary.is_complete()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Velocities for motion blur
//!
//! ```
//! use meniscus::{Cloud, Reconstruction};
//!
//! let positions: Vec<[f64; 3]> = (0..1000).map(|i| [i % 10, i / 10 % 10, i / 100].map(f64::from)).collect();
//! let velocities: Vec<[f32; 3]> = positions.iter().map(|p| [0.0, p[0] as f32, 0.0]).collect();
//!
//! let cloud = Cloud::new(&positions).with("velocity", &velocities);
//! let surface = Reconstruction::new().spacing(1.0).attributes(["velocity"]).run(&cloud)?;
//! let mesh = surface.to_mesh()?;
//! assert_eq!(mesh.attributes[0].values.len(), 3 * mesh.positions.len());
//! # Ok::<(), meniscus::Error>(())
//! ```
//!
//! # A frame larger than memory
//!
//! ```
//! use meniscus::{Cancel, MemoryBudget, Reconstruction};
//!
//! # let folder = tempfile::tempdir()?;
//! # std::env::set_current_dir(folder.path())?;
//! # let ball = (0..3375).map(|i| [i % 15, i / 15 % 15, i / 225].map(|c| f32::from(c as u8)));
//! # let bytes: Vec<u8> = ball.flatten().flat_map(f32::to_le_bytes).collect();
//! # std::fs::write("dam.xyz", bytes)?;
//! let cancel = Cancel::new();
//! let surface = Reconstruction::new()
//!     .memory(MemoryBudget(256 << 20))
//!     .scratch(std::env::temp_dir())
//!     .progress(|progress| println!("{} {:.0} %", progress.stage, 100.0 * progress.done))
//!     .cancel(cancel.clone())
//!     .run_file("dam.xyz")?;
//! // Neither all particles nor the whole mesh are in memory at once.
//! surface.write("dam.ply")?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Particles on a GPU
//!
//! ```
//! use meniscus::Reconstruction;
//! use meniscus::devices::{
//!     Coordinate, Device, DeviceChoice, DeviceOptions, DevicePositions, Instance, Pipeline,
//! };
//!
//! # let ball: Vec<[f32; 3]> = (0..3375).map(|i| [i % 15, i / 15 % 15, i / 225].map(|c| c as f32)).collect();
//! # let Ok(instance) = Instance::connect(false) else { return Ok(()) };
//! # let Ok(device) = Device::open(&instance, &DeviceChoice::Best, &DeviceOptions::default()) else { return Ok(()) };
//! // To use your own device and buffers, see `Device::adopt` and `Device::external_buffer`.
//! let view = device.uploaded(&ball)?;
//! let positions = DevicePositions { view, count: ball.len(), coordinate: Coordinate::Single };
//!
//! let request = Reconstruction::new().spacing(1.0).smooth(1.2).on_device()?;
//! let surface = Pipeline::new(&device)?.surface(&[positions], &request)?;
//! // `surface.positions` and `surface.indices` are buffers on the device.
//! assert!(surface.vertices > 0 && surface.triangles > 0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # How it works
//!
//! ```text
//! particles --bin--> binned particles --indicate--> DIF bricks, mu0         brick, field::indicator
//! DIF bricks --calibrate--> plateau; isovalue for the paper's indicators    field::calibration
//! DIF bricks --gather(halo)--> blocks --blur--> [--distances--> | --detail-->] --dual MC-->  field, surface, backend
//! block surfaces --stitch--> mesh [--simplify-->] --write--> file           surface::stitch, io
//! ```
//!
//! From particles to the field, almost all steps use integer arithmetic. The other steps, such as
//! those for solids and for particles of several sizes, use floating-point numbers, and perform
//! their operations in a fixed order. The result therefore depends only on the input, and not on
//! the order of the particles, on the number of threads, or on how the field is stored. Every mesh
//! is a closed, oriented 2-manifold. Vertices of neighbouring blocks become one vertex if they lie
//! on the same grid edge, never because they have the same position.
//!
//! [`method`] gives the formulas with their sources, [`guide`] is the guide for users, and
//! [`guide::glossary`] explains the terms. To change meniscus, see [`guide::contributing`] and
//! [`internals`].
//!
//! # Features
//!
//! All features are on by default. None of them is needed to make meshes. To turn them off, set
//! `default-features = false`, and list the features that you need.
//!
//! - Without `cli`, there is no program `meniscus` and no module `program`, and clap and the other
//!   dependencies of the command line are not built. `cli` turns on `pictures`.
//! - Without `pictures`, there is no module [`picture`], and meniscus cannot draw pictures.
//! - Without `hdf5`, HDF5 inputs give an error: VTKHDF, SWIFT, GADGET, openPMD, PySPH, H5Part, H5MD
//!   and others. `.vtkhdf` meshes can be written, but not read.

#![cfg_attr(docsrs, feature(doc_cfg))]

// Lets the modules of the program refer to the library as `meniscus`, as any other program does.
#[cfg(feature = "cli")]
extern crate self as meniscus;

mod backend;
mod baselines;
mod brick;
pub mod error;
mod field;
mod frame;
mod grid;
mod io;
mod particles;
#[cfg(feature = "cli")]
pub mod program;
mod reconstruction;
mod settings;
#[rustfmt::skip]
mod shaders;
mod simulation;
mod surface;
mod system;
mod vulkan;

#[doc = include_str!("links.md")]
#[doc = include_str!("method.md")]
pub mod method {}

/// Guides for users: formats, spacing, simulations, animations, pictures, tanks and periodic boxes,
/// choosing options, accuracy, speed, GPUs, limits, guarantees; and a page for contributors.
pub mod guide {
    #[doc = include_str!("links.md")]
    #[doc = include_str!("field/accuracy.md")]
    pub mod accuracy {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("simulation/animations.md")]
    pub mod animations {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("changelog.md")]
    pub mod changelog {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("field/choosing.md")]
    pub mod choosing {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("contributing.md")]
    pub mod contributing {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("io/formats.md")]
    pub mod formats {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("glossary.md")]
    pub mod glossary {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("vulkan/guide.md")]
    pub mod gpus {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("reconstruction/limits.md")]
    pub mod limits {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("reconstruction/parts/parts.md")]
    pub mod machines {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("io/mnf/packed.md")]
    pub mod packed {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("reconstruction/periodic.md")]
    pub mod periodic {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("reconstruction/tanks.md")]
    pub mod tanks {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("surface/picture/guide.md")]
    pub mod pictures {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("surface/simplify/guide.md")]
    pub mod simplifying {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("simulation/guide.md")]
    pub mod simulations {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("field/spacing/guide.md")]
    pub mod spacing {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("frame/speed.md")]
    pub mod speed {}
    #[doc = include_str!("links.md")]
    #[doc = include_str!("system/trust.md")]
    pub mod trust {}
}

/// Meshes, whole in memory or read piece by piece: checks, measures and comparisons.
pub mod mesh {
    pub use crate::io::output::read_mesh;
    pub use crate::surface::mesh::check::{CheckReport, Defects, Topology, check};
    pub use crate::surface::mesh::compare::{Comparison, Distances, Side, compare};
    pub use crate::surface::mesh::measure::{Measures, Quality, measure};
    pub use crate::surface::mesh::source::{
        Corners, Indexed, Lattice, MeshSource, Outline, PieceOutline, Vertices,
    };
    pub use crate::surface::mesh::{Mesh, VertexAttribute};
}

/// Pictures of meshes, as files or in memory (feature `pictures`).
#[cfg(feature = "pictures")]
pub mod picture {
    pub use crate::simulation::{PictureDone, PictureFile, Pictures, Sheet, SheetDone};
    pub use crate::surface::picture::{
        Animation, Colour, ColourMap, Effort, Image, Picture, PictureError, Reference, Scope, View,
    };
}

/// Files: formats, outputs that are checked before the reconstruction starts, and the contents of
/// files.
pub mod files {
    pub use crate::io::houdini::Primitives;
    pub use crate::io::input::{InputFormat, file_and_step};
    pub use crate::io::mnf::is_packed;
    pub use crate::io::output::MeshFormat;
    pub use crate::io::series::SeriesFrame;
    pub use crate::io::stamp::Stamp;
    pub use crate::io::stamp::is_same_file;
    pub use crate::io::time_codes::{TimeFault, UnusedTimes};
    pub use crate::io::vdb::GridInfo;
    pub use crate::io::whole::Replace;
    pub use crate::io::{ParticleFile, UnreadPart, UpAxis};
    pub use crate::particles::occurring::{Value, ValueCounts};
    pub use crate::particles::{AttributeInfo, AttributeKind, Label, velocity_attribute};
    pub use crate::reconstruction::{
        FrameInfo, GeometryInfo, Info, MeshInfo, Output, PackReport, PackedOutput, ParticlesInfo,
        VolumeInfo, info, info_with, open_particles, usual_up,
    };
    pub use crate::simulation::{FrameFile, files, frames};
}

/// Backends: the CPU, a Vulkan device, or the caller's Vulkan device.
///
/// A [`Pipeline`](devices::Pipeline) meshes particles that are already on a device. Its
/// [`DeviceRequest`](devices::DeviceRequest) comes from [`Reconstruction::on_device`].
pub mod devices {
    pub use crate::backend::choice::{CpuReason, bytes_of, device, fastest};
    pub use crate::backend::{Backend, Work};
    pub use crate::brick::InvalidParticles;
    pub use crate::brick::vulkan::{Coordinate, DevicePositions};
    pub use crate::frame::resident::{DeviceRequest, Exchange, Pipeline, ResidentSurface};
    pub use crate::frame::{Detail, Normals, Surfacing};
    pub use crate::grid::units::{SheetStretch, Sigma, Smooth};
    pub use crate::vulkan::{
        Buffer, Counters, Device, DeviceChoice, DeviceInfo, DeviceKind, DeviceOptions,
        ExternalDevice, Instance, SemaphorePoint, Timing, View,
    };
}

/// All modules, for the library's own tests and tools. Anything here may change in any version.
#[doc(hidden)]
pub mod internals {
    /// Backends for the stages of a frame: CPU or Vulkan device.
    pub mod backend {
        pub use crate::backend::*;
    }
    /// The kernel methods that the paper compares against (section 3). They use the same bins, dual
    /// grid and stitching.
    pub mod baselines {
        pub use crate::baselines::*;
    }
    /// Sparse storage: particles sorted into bins, the DIF in bricks, and padded blocks that are
    /// cut out of the DIF.
    pub mod brick {
        pub use crate::brick::*;
    }
    /// From particles to the field: indicators, filters, the recipe that combines them, and the
    /// calibration, which determines where the surface lies.
    pub mod field {
        pub use crate::field::*;
    }
    /// One frame, within its memory budget: from particles to a field, and from the field to a
    /// surface.
    pub mod frame {
        pub use crate::frame::*;
    }
    /// The world-anchored cell grid, boxes of cells, Morton keys and the walls of a tank.
    pub mod grid {
        pub use crate::grid::*;
    }
    /// Readers and writers of files. Each format has its own module, and the extension selects the
    /// format.
    pub mod io {
        pub use crate::io::*;
    }
    /// The interface through which the pipeline reads ranges of particles, repeatedly and from
    /// several threads.
    pub mod particles {
        pub use crate::particles::*;
    }
    /// The facade: from particles to a surface in one call, and the policy that chooses defaults.
    pub mod reconstruction {
        pub use crate::reconstruction::*;
    }
    /// Settings of a surface, each defined once.
    pub mod settings {
        pub use crate::settings::*;
    }
    /// All shaders and their push constants, generated from the WGSL sources.
    pub mod shaders {
        pub use crate::shaders::*;
    }
    /// The frames of a simulation: their files, their shared calibration, and the records of
    /// finished frames.
    pub mod simulation {
        pub use crate::simulation::*;
    }
    /// From the field to a mesh: dual marching cubes, attributes, stitching, simplifying, checks
    /// and comparisons.
    pub mod surface {
        pub use crate::surface::*;
    }
    /// Resources of the machine: memory budget, scratch files, timings, and cancellation.
    pub mod system {
        pub use crate::system::*;
    }
    /// Compute on a Vulkan device: selection, memory, shaders, and batches of commands.
    pub mod vulkan {
        pub use crate::vulkan::*;
    }
}

pub use baselines::KernelMethod;
pub use brick::{Census, FrameFacts};
pub use error::{Cause, Error};
pub use field::calibration::{Calibration, MeasuredCalibration, Plateau};
pub use field::indicator::{Indicator, IndicatorKind};
pub use field::walls::{BeyondWall, GapAtWall};
pub use frame::{CoincidentParticles, Shortfall};
pub use grid::units::{Isovalue, MeanCount, MemoryBudget};
pub use grid::{Domain, Grid, Periodic, PeriodicMesh, Walls};
pub use io::UpAxis;
pub use particles::condition::{Comparison, Condition};
pub use particles::mixture::Mixture;
pub use particles::sizes::{Meaning as SizeMeaning, Sizes};
pub use particles::{AttributeValue, Cloud, Particles, StridedPositions};
pub use reconstruction::{
    Cells, EmptyReason, FoundWalls, Frame, Needs, NoVelocity, OpenedFrame, PartDone, PartNeeds,
    PartShare, Parts, PartsPlan, Reconstruction, Report, Slab, SpacingMistake, SpacingSource,
    SpacingWarning, Surface, Warning,
};
pub use settings::{Faces, Iso, MethodName, Setting, Settings, Source, Tank, Where};
pub use simulation::{
    Event, Forecast, FrameCounts, FrameDone, FrameFailed, LargestFrame, LiveSimulation,
    MissingFrames, OmittedCounts, SharedCalibration, Simulation, Summary, Trust, UnreachedEnd,
};
pub use surface::level_set::Volume;
pub use surface::simplify::TooSmall;
pub use system::cancel::Cancel;
pub use system::control::{Progress, Stage};
pub use system::memory::{default_memory, peak_memory};
pub use system::timings::Timings;
