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

pub mod backend;
pub mod baselines;
pub mod brick;
pub mod error;
pub mod field;
pub mod frame;
pub mod grid;
pub mod io;
pub mod particles;
pub mod reconstruction;
pub mod simulation;
pub mod surface;
pub mod system;
pub mod vulkan;

#[doc = include_str!("method.md")]
pub mod method {}

pub use error::Error;
pub use reconstruction::{Reconstruction, Surface};
