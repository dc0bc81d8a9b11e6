//! Particles to a surface in one call, with everything chosen that is not said: the facade, and the policy behind it.
//!
#![doc = include_str!("limits.md")]

mod attributes;
mod builder;
mod cells;
mod lattice;
mod request;
mod surface;
mod width;

pub use attributes::Attributes;
pub use builder::Reconstruction;
pub use cells::{CellSize, Cells, Doubt, Origin, SpacingSource};
pub use lattice::{moved, on_sound_grid, origin_for_lattice};
pub use request::{ChosenSampling, SamplingRequest};
pub use surface::{Report, Surface};
pub use width::SinglePrecision;
