//! `meniscus pack`: particles to a DIF frame, to be reconstructed later with other filters or isovalues.

use std::path::PathBuf;

use bytesize::ByteSize;
use clap::Args;
use meniscus::error::Error;
use meniscus::frame::{Frame, FrameError, Surfacing};
use meniscus::io::input::open_particles;
use meniscus::io::mnf::write_frame;
use meniscus::io::whole::{Replace, WholeFile};
use meniscus::particles::Particles;
use meniscus::system::timings::Timings;

use crate::identity::refuse_same_file;
use crate::interrupt;
use crate::outcome::Verdict;
use crate::report::{LeftOut, report_laps, report_lattice, warnings};
use crate::run::{RunOptions, bytes_of, unpacking};
use crate::sampling::{SamplingOptions, sampling};
use meniscus::io::mnf::is_packed;

#[derive(Args)]
pub struct Options {
    /// The particles: .bgeo, .vtk, .ply, .npy, .csv, .xyz or .bi4, gzipped or not.
    input: PathBuf,
    /// The frame: .mnf.
    #[arg(short, long)]
    output: PathBuf,
    #[command(flatten)]
    sampling: SamplingOptions,
    #[command(flatten)]
    run: RunOptions,
}

/// Runs the command.
pub fn run(options: &Options) -> Result<Verdict, Error> {
    let notes = options.run.notes();
    let request = options.sampling.validate()?;
    if !is_packed(&options.output) {
        return Err(Error::Request(format!("{}: packed frames are .mnf files", options.output.display())));
    }
    let resources = options.run.resources(&options.output, || bytes_of([options.input.as_path()]))?;
    refuse_same_file(&options.input, &options.output)?;
    let replace = if options.run.overwrite { Replace::Allow } else { Replace::Refuse };
    let prepare = || WholeFile::prepare(&options.output, replace);
    let (output, unfinished) = interrupt::guard(prepare, WholeFile::temporary)?;

    let mut timings = Timings::default();
    let file = open_particles(&options.input, unpacking(&resources))?;
    timings.done("open");
    notes.say(format!("{}: {} particles, {}", options.input.display(), file.particles.len(), file.format));
    let sampling = sampling(&request, (&options.input, &file), Vec::new(), resources, &notes)?;
    timings.done("spacing");
    let in_file = |fault: FrameError| Error::Frame { path: Some(options.input.clone()), fault };
    sampling.refuse_unfit(&Surfacing::PLAIN).map_err(in_file)?;
    let frame = Frame::sample(&file.particles, &sampling, &mut timings).map_err(in_file)?;
    warnings(&frame).iter().for_each(|warning| notes.say(format!("warning: {warning}")));
    LeftOut::from(frame.facts().census).say(sampling.field, &notes);
    report_lattice(&frame, &notes);
    let sampled = frame.dif().ok_or_else(|| Error::Request("kernels cannot be packed".into()))?;
    let bytes = output.write(|out| write_frame(out, sampled).map(drop))?;
    drop(unfinished);
    timings.done("write");
    notes.say(format!(
        "{}: {} cells in {} bricks, {} in {:.2} s",
        options.output.display(),
        sampled.dif.full_cells(),
        sampled.dif.bricks(),
        ByteSize(bytes),
        timings.total(),
    ));
    report_laps(&timings, &notes);
    Ok(Verdict::Good)
}
