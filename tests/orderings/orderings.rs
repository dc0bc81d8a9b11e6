//! Every order that threads can come in, as far as the library's own files rely on it: the slots
//! that binning fills, and the gate of frames side by side. The files are those of the library;
//! what is loom's in place of the standard library's they are given here.
#![allow(dead_code, reason = "a test uses what it tests of a file")]

mod brick;
mod simulation;
