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
//! ```
//! use meniscus::brick::{BrickSide, InvalidParticles};
//! use meniscus::frame::{Frame, Resources, Sampling, Surfacing};
//! use meniscus::grid::Grid;
//! use meniscus::system::timings::Timings;
//! use meniscus::surface::mesh::check::check;
//! use meniscus::field::indicator::IndicatorKind;
//!
//! // A ball of particles, one a cell.
//! let steps = || (-8..8).map(|i| f64::from(i) + 0.5);
//! let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
//! let particles: Vec<[f64; 3]> = lattice.filter(|p| p.iter().map(|c| c * c).sum::<f64>() < 50.0).collect();
//!
//! let sampling = Sampling {
//!     grid: Grid::new([0.0; 3].into(), 1.0)?,
//!     domain: None,
//!     field: IndicatorKind::default().into(),
//!     invalid: InvalidParticles::Refuse,
//!     side: BrickSide::default(),
//!     carried: Vec::new(),
//!     spacing: None,
//!     resources: Resources::new(meniscus::system::memory::default_budget(), std::env::temp_dir()),
//! };
//! let frame = Frame::sample(&particles[..], &sampling, &mut Timings::default())?;
//! let surface = frame.surface(&Surfacing::PLAIN, &mut Timings::default())?;
//! assert!(check(&surface.to_mesh()?).is_closed_oriented_manifold());
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
pub mod simulation;
pub mod surface;
pub mod system;
pub mod vulkan;
