//! Tests of the field and the mesh of one frame: calibration, kernel methods, simplification and
//! mesh checks.
#![allow(clippy::unwrap_used)]

mod baselines;
mod calibration;
#[path = "../common/mod.rs"]
mod common;
mod mesh_checks;
mod simplify;
