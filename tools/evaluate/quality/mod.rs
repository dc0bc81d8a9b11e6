//! Compares the quality of this library's surfaces with that of other programs' surfaces. Every
//! program reads and writes files. A table contains the programs' command lines.
//!
//! `tools/compare/quality` finds the programs, writes the table and runs this module. Lengths are
//! in spacings of the particles, and the spacing is 1 in all files, except in those with particles
//! of several sizes. Each program's best isovalue is chosen on bodies and lattices whose results
//! are not shown.

mod bodies;
mod clumps;
mod components;
mod frames;
mod heights;
mod level;
mod lines;
mod programs;
mod rest;
mod sheets;
mod sizes;
mod speed;
mod views;

use clap::ValueEnum;

use crate::{Options, Outcome};
use frames::Frame;
use lines::Board;

/// A part of the comparison.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Part {
    Bodies,
    Level,
    Frames,
    Clumps,
    Sheets,
    Sizes,
    Rest,
    Speed,
    Views,
}

pub fn run(options: &Options) -> Outcome<()> {
    let table = options.methods.as_ref().ok_or(
        "the topic quality needs --methods TABLE; run tools/compare/quality, which writes \
         the table",
    )?;
    let programs = programs::read(table)?;
    std::fs::create_dir_all(&options.out)?;
    let board = Board::new(bodies::methods(options, &programs)?)?;
    let dam = frames::dam_break()?;
    let given = options.simulations.iter().map(|folder| Frame::middle_of(folder));
    let given: Vec<Frame> = given.collect::<Outcome<_>>()?;

    for part in Part::value_variants() {
        if options.part.is_some_and(|only| only != *part) {
            continue;
        }
        match part {
            Part::Bodies => bodies::run(options, &board),
            Part::Level => level::run(options, &board),
            Part::Frames => frames::run(options, &board, &dam, &given),
            Part::Clumps => clumps::run(options, &board),
            Part::Sheets => sheets::run(options, &board),
            Part::Sizes => sizes::run(options, &board),
            Part::Rest => rest::run(options, &board, &dam),
            Part::Speed => speed::run(options, &board),
            Part::Views => views::run(options, &board, &dam, &given),
        }?;
    }
    Ok(())
}
