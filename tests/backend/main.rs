//! What every backend must do, and what stays on a Vulkan device; `tools/gpu/pack` makes of these
//! tests a program to carry.
#![allow(clippy::unwrap_used)]

#[path = "../common/mod.rs"]
mod common;
#[path = "../../tools/shaders/compile.rs"]
#[allow(dead_code, reason = "the tests do not write binaries")]
mod compile;

mod bins_and_stitching;
mod conformance;
mod gpu_report;
mod resident;
mod shaders;
mod vulkan;
