//! The method, one room a stage: `mod.rs` states the formula and the promise, `cpu.rs` computes it.

pub mod attribute;
pub mod blur;
pub mod detail;
pub mod distance;
pub mod dual_mc;
pub mod indicator;
