//! Conversion of the frames of a simulation, by the library and by the program.
#![allow(clippy::unwrap_used)]

#[path = "../common/mod.rs"]
mod common;
mod library;
mod program;
mod random_events;
mod watched_pieces;
