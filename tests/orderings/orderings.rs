//! Explores the possible interleavings of threads in the two library files whose results could
//! depend on the interleaving: the slots that binning fills, and the gate of parallel frames.
//! loom's types replace the types of the standard library.
#![allow(dead_code, reason = "the tests use only some items of these files")]

mod brick;
mod simulation;
