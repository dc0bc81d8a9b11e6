//! `meniscus reconstruct`: a frame of particles to a mesh; each frame of a simulation is one, see `sequence`.

use std::path::Path;

use bytesize::ByteSize;
use meniscus::files::{MeshFormat, Output, Replace, file_and_step, is_same_file};
use meniscus::{Error, Needs, Opened, Reconstruction, Simulation, Surface};

use crate::interrupt;
use crate::notes::Notes;
use crate::options::Options;
use crate::outcome::{Verdict, print};
use crate::parts;
use crate::report::{report, report_device, report_opened, report_stages, warn_all};
use crate::run::bytes_of;
use crate::sequence;
use crate::stats::{Made, record};

/// Runs the command.
pub fn run(options: &Options) -> Result<Verdict, Error> {
    match (Simulation::if_several(&options.inputs, &options.output)?, options.parts.parts) {
        (Some(_), Some(_)) => {
            let what = "--parts is for one frame: jobs of a sequence take --frames of it each";
            Err(Error::Request(what.into()))
        }
        (Some(simulation), None) => sequence::run(options, simulation),
        (None, Some(count)) => parts::run(options, &options.inputs[0], count),
        (None, None) => run_frame(options, &options.inputs[0]),
    }
}

/// Refuses a file that is to be read or written and written again, which is a slip of the hand.
pub fn refuse_same_file(one: &Path, other: &Path) -> Result<(), Error> {
    if is_same_file(one, other) {
        return Err(Error::TwoPurposes { path: other.to_owned(), other: one.to_owned() });
    }
    Ok(())
}

/// A request of which all is checked that can be before the work, and the file that it is for.
pub struct Ready {
    pub request: Reconstruction,
    pub output: Output,
    pub notes: Notes,
}

/// Checks a request for one frame, and makes sure that its mesh can be written.
pub fn ready(options: &Options, input: &Path) -> Result<Ready, Error> {
    let notes = options.run.notes();
    match options.parts.parts {
        Some(_) => options.sequence.refuse_for_parts()?,
        None => options.sequence.refuse_for_one_frame()?,
    }
    let request = options.request()?;
    request.check(input)?;
    let request = options.run.machine(request, &options.output, || bytes_of([input]))?;
    request.check(input)?;
    refuse_same_file(file_and_step(input).0, &options.output)?;
    if let Some(stats) = &options.stats {
        refuse_same_file(input, stats)?;
        refuse_same_file(&options.output, stats)?;
        options.prepare_stats()?;
    }
    let replace = if options.run.overwrite { Replace::Allow } else { Replace::Refuse };
    let request = request.cancel(interrupt::handle());
    let output = request.output(&options.output, replace)?;

    // What the file cannot hold need not be carried.
    let carries = options.attributes.is_some() || output.format().holds_attributes();
    let request = if carries { request } else { request.attributes([""; 0]) };
    Ok(Ready { request, output, notes })
}

/// Says what there is to know of a surface, and writes it.
pub fn write(
    options: &Options,
    input: &Path,
    surface: &Surface,
    request: &Reconstruction,
    output: Output,
    notes: &Notes,
) -> Result<(), Error> {
    let format = output.format();
    let mut stages = surface.report().timings.clone();
    report(options, surface.report(), surface.mesh(), notes);
    warn_all(&surface.warnings_in(format)?, Some(options), notes);
    stages.skip();
    let bytes = surface.write_to(output)?;
    stages.done("write");
    let (mesh, report) = (surface.mesh(), surface.report());
    notes.say(format!(
        "{}: {} vertices, {} triangles, {} in {:.2} s",
        options.output.display(),
        mesh.vertex_count(),
        mesh.triangle_count(),
        ByteSize(bytes),
        stages.total(),
    ));
    report_stages(&stages, notes);
    report_device(request.device(), 1, notes);
    let counts = [mesh.vertex_count(), mesh.triangle_count(), bytes];
    let made = Made { input, output: &options.output, counts, stages: &stages, lost: report.lost };
    options.append_stats(|| record(options, report, &made))
}

fn run_frame(options: &Options, input: &Path) -> Result<Verdict, Error> {
    let Ready { request, output, notes } = ready(options, input)?;
    let opened = request.open(input)?;
    report_opened(input, &opened, &notes);
    if options.dry_run {
        print(&dry_run(options, &opened, output.format())?)?;
        return Ok(Verdict::Good);
    }
    let frame = opened.sample()?;
    let surface = frame.surface()?;
    drop(frame);
    write(options, input, &surface, &request, output, &notes)?;
    Ok(Verdict::Good)
}

/// Says what would be done, and what it would take.
fn dry_run(options: &Options, opened: &Opened, format: MeshFormat) -> Result<String, Error> {
    let output = options.output.display();
    let Some(needs) = opened.needs(format)? else {
        return Ok(format!("would reconstruct {} particles into {output}", opened.particles()));
    };
    let Needs { census, cell_size, budget, memory, in_core, scratch, .. } = needs;
    let [budget, memory, in_core, scratch] = [budget, memory, in_core, scratch].map(ByteSize);
    let mut text = format!(
        "would reconstruct {} particles with cells of {cell_size} into {output}\n\
         memory: about {memory} of {budget}; all in memory would take {in_core}\nscratch: at most about {scratch} in {}",
        census.binned,
        needs.scratch_folder.display(),
    );
    if let Some([threads, triangles]) = needs.simplifying.map(|bytes| bytes.map(ByteSize)) {
        text += &format!("\nsimplifying takes up to {threads} more, and {triangles} of memory or scratch");
    }
    if let Some(bytes) = needs.writing {
        text += &format!("\n{format} is written from memory: up to {} more", ByteSize(bytes));
    }
    Ok(text)
}
