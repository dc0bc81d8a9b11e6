//! From particles to the field whose level the surface is: indicators, filters, the recipe that
//! joins them, and the calibration that says which level.
//!
//! One folder a stage: `mod.rs` states the formula and the promise, `cpu.rs` computes it,
//! `vulkan.rs` has shaders do so.
//!
//! Which of them to choose is said in `choosing.md`, how near they come in `accuracy.md`: both are
//! pages of the docs.

pub mod blur;
pub mod calibration;
pub mod detail;
pub mod distance;
pub mod indicator;
pub mod recipe;
pub mod sheets;
pub mod solid;
pub mod spacing;
pub mod walls;
