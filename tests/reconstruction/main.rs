//! Tests of the reconstruction of one frame: the facade, spacing, sizes, solids, periodic boxes,
//! parts, and the use of memory, files and threads.
#![allow(clippy::unwrap_used)]

mod changed_inputs;
#[path = "../common/mod.rs"]
mod common;
mod facade;
mod memory_budget;
mod metamorphic;
#[cfg(unix)]
mod open_files;
mod parts;
mod parts_reading;
mod periodic;
mod random_frames;
mod sheets;
mod sizes;
mod solids;
mod spacing;
mod spray;
mod thread_pool;
mod walls;
