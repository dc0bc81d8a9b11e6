//! Tests of converting the frames of a simulation, with the library and with the program.
#![allow(clippy::unwrap_used)]

#[path = "../common/mod.rs"]
mod common;
mod library;
mod program;
mod random_events;
mod watched_pieces;
