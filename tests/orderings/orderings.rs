//! Explores the orders of threads in the two library files whose results could depend on the order:
//! the slots that binning fills, and the gate of parallel frames. Types of loom replace the
//! standard library's.
#![allow(dead_code, reason = "a test uses what it tests of a file")]

mod brick;
mod simulation;
