//! Explores the orders of threads in the two library files whose results could depend on the order:
//! the slots that binning fills, and the gate of parallel frames. Types of loom replace the
//! standard library's.
#![allow(dead_code, reason = "the tests use only some items of these files")]

mod brick;
mod simulation;
