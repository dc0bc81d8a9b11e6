//! What every backend must do, written once: the method to the bit, and watertight surfaces of the right shape.
#![allow(clippy::unwrap_used)]
#![allow(clippy::duplicate_mod, reason = "the same list for each backend")]

#[path = "../common/mod.rs"]
mod common;

mod cpu;
mod vulkan;
