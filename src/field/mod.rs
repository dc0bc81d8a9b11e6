//! From particles to the field: indicators, filters, the recipe that combines them, and the
//! calibration of the level at which the surface lies.
//!
//! Each stage is a folder: `mod.rs` states the formula and the guarantees, `cpu.rs` computes it,
//! and `vulkan.rs` runs its shaders.
//!
//! The guides `choosing.md` and `accuracy.md` help to choose between indicators, and show how
//! accurate they are.

pub mod blur;
pub mod calibration;
pub mod detail;
pub mod distance;
pub mod indicator;
pub mod recipe;
pub mod sheets;
pub mod sizes;
pub mod solid;
pub mod spacing;
pub mod walls;
