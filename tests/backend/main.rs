//! Tests of every backend, and of results that stay on a Vulkan device. `tools/gpu/pack` packs them
//! as a portable program.
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
