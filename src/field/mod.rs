//! From particles to the field whose level the surface is: indicators, filters, the recipe that joins them, and the calibration that
//! says which level.
//!
//! One folder a stage: `mod.rs` states the formula and the promise, `cpu.rs` computes it, `vulkan.rs` has kernels do so.
//!
#![doc = include_str!("choosing.md")]
#![doc = include_str!("accuracy.md")]

pub mod blur;
pub mod calibration;
pub mod detail;
pub mod distance;
pub mod indicator;
pub mod recipe;
pub mod spacing;
