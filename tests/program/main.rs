//! Tests of the program: its commands, options, exit codes and messages.
#![allow(clippy::unwrap_used)]

mod command_line;
#[path = "../common/mod.rs"]
mod common;
mod options;
mod requests;
mod selection;
