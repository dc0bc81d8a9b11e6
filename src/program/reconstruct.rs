//! `meniscus reconstruct`. This module converts single frames; `simulation` converts simulations.

use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use meniscus::error::shown;
use meniscus::files::{InputFormat, MeshFormat, files};
use meniscus::{Error, Needs, OpenedFrame, Simulation};

use super::advice::no_velocity_message;
use super::notes::{Verdict, print};
use super::one_frame::{PreparedRequest, prepare, write};
use super::options::ReconstructOptions;
use super::parts;
use super::report::report_opened;
use super::simulation;

/// Runs `meniscus reconstruct`.
pub fn run(options: &ReconstructOptions) -> Result<Verdict, Error> {
    if options.together {
        return run_together(options);
    }
    let format = options.settings.format;
    match (Simulation::detect(&options.inputs, &options.output, format)?, options.parts.parts) {
        (Some(_), Some(_)) => {
            let what = "--parts is for one frame; divide a simulation with --frames";
            Err(Error::Request(what.into()))
        }
        (Some(simulation), None) => simulation::run(options, simulation),
        (None, Some(count)) => parts::run(options, &options.inputs[0], count),
        (None, None) => run_frame(options, &options.inputs[..1]),
    }
}

/// Runs `--together`: joins all inputs into one frame, or several simulations frame by frame.
fn run_together(options: &ReconstructOptions) -> Result<Verdict, Error> {
    if options.parts.parts.is_some() {
        return Err(Error::Request(
            "--parts reads a single file and cannot be used with --together".into(),
        ));
    }
    match Simulation::detect_together(&options.inputs, &options.output, options.settings.format)? {
        Some(simulation) => simulation::run(options, simulation),
        None => {
            let is_known =
                |path: &Path| options.settings.format.is_some() || InputFormat::of(path).is_some();
            run_frame(options, &files(&options.inputs, is_known)?)
        }
    }
}

fn run_frame(options: &ReconstructOptions, inputs: &[PathBuf]) -> Result<Verdict, Error> {
    let PreparedRequest { request, output, preview, notes } = prepare(options, inputs)?;
    let opened = request.open_together(inputs)?;
    let input = &inputs[0];
    report_opened(inputs, &opened, &notes);
    if let Some(found) = opened.no_velocity(output.format()) {
        notes.say(no_velocity_message(&found));
    }
    opened.check_output(&output)?;
    if options.dry_run {
        print(&dry_run(options, &opened, output.format())?)?;
        return Ok(Verdict::Good);
    }
    let frame = opened.sample()?;
    let surface = frame.surface()?;
    drop(frame);
    write(options, input, &surface, &request, (output, preview), &notes)?;
    Ok(Verdict::Good)
}

/// Describes a reconstruction without running it, and estimates its memory, disk space and time.
fn dry_run(
    options: &ReconstructOptions,
    opened: &OpenedFrame,
    format: MeshFormat,
) -> Result<String, Error> {
    let output = options.output.display();
    let Some(needs) = opened.needs(format)? else {
        return Ok(format!("would reconstruct {} particles into {output}", opened.particles()));
    };
    let Needs { census, cell_size, budget, memory, in_core, scratch, triangles, .. } = needs;
    let [budget, memory, in_core] = [budget, memory, in_core].map(ByteSize);
    let scratch = match scratch {
        0 => "none".to_owned(),
        bytes => format!("at most about {} in {}", ByteSize(bytes), needs.scratch_folder.display()),
    };
    let mut text = format!(
        "would reconstruct {} particles with cells of {} into {output}\nmemory: about {memory:.2} \
         of the {budget} limit ({in_core:.2} without scratch files)\nscratch: {scratch}",
        census.binned,
        shown(cell_size),
    );
    if let Some([threads, triangles]) = needs.simplifying.map(|bytes| bytes.map(ByteSize)) {
        text += &format!(
            "\nsimplifying: up to {threads} more memory, and {triangles} of memory or scratch files"
        );
    }
    if let Some(bytes) = needs.writing {
        text += &format!("\nwriting {format}: up to {} more memory", ByteSize(bytes));
    }
    text += &format!("\ntriangles: about {triangles}\ndisk: about {}", ByteSize(needs.disk));
    if let Some(seconds) = needs.seconds {
        text += &format!("\ntime: about {:.0} s", seconds.ceil());
    }
    Ok(text)
}
