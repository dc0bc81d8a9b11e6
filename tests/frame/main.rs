//! The field and the mesh of one frame: calibration, kernel methods, simplification, and checks of
//! meshes.
#![allow(clippy::unwrap_used)]

mod baselines;
mod calibration;
#[path = "../common/mod.rs"]
mod common;
mod mesh_checks;
mod simplify;
