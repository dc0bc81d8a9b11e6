//! Tries every order of threads, as far as the library's files depend on it: the slots that binning
//! fills, and the gate of parallel frames. The files are the library's; loom's types replace those
//! of the standard library.
#![allow(dead_code, reason = "a test uses what it tests of a file")]

mod brick;
mod simulation;
