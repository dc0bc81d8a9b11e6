//! Tries every order of threads in the two files of the library that depend on it: the slots that
//! binning fills, and the gate of parallel frames. Types of loom replace the standard library's.
#![allow(dead_code, reason = "a test uses what it tests of a file")]

mod brick;
mod simulation;
