//! The computation of the field from particles: indicators, filters, the recipe that combines them,
//! and the calibration, which measures the parameters that depend on the frame.
//!
//! Each stage with shaders is a folder: `mod.rs` states the formula and the guarantees, `cpu.rs`
//! evaluates the formula on the CPU, and `vulkan.rs` runs the stage's shaders.
//!
//! The guide `choosing.md` helps to choose an indicator, and `accuracy.md` shows how accurate the
//! indicators are.

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
