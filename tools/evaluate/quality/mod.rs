//! Compares the quality of surfaces with those of other programs. Every program reads and writes
//! files, by a table of command lines.
//!
//! `tools/compare/quality` finds the programs, writes the table and runs this. Lengths are in
//! spacings of the particles, which are 1 in all files. The best isovalue of a program is chosen on
//! bodies and lattices that are not reported.

mod bodies;
mod clumps;
mod components;
mod frames;
mod heights;
mod level;
mod lines;
mod programs;
mod rest;
mod speed;
mod views;

use crate::{Options, Outcome};
use frames::Frame;
use lines::Board;

pub fn run(options: &Options) -> Outcome<()> {
    let table = options
        .methods
        .as_ref()
        .ok_or("quality needs --methods: tools/compare/quality writes them")?;
    let programs = programs::read(table)?;
    std::fs::create_dir_all(&options.out)?;
    let board = Board::new(bodies::methods(options, &programs)?)?;
    let dam = frames::dam_break()?;
    let given = options.simulations.iter().map(|folder| Frame::middle_of(folder));
    let given: Vec<Frame> = given.collect::<Outcome<_>>()?;

    bodies::run(options, &board)?;
    level::run(options, &board)?;
    frames::run(options, &board, &dam, &given)?;
    clumps::run(options, &board)?;
    rest::run(options, &board, &dam)?;
    speed::run(options, &board)?;
    views::run(options, &board, &dam, &given)
}
