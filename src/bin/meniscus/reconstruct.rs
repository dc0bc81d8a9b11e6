//! `meniscus reconstruct`: a frame of particles to a mesh; each frame of a simulation is one, see `sequence`.

use std::path::Path;

use bytesize::ByteSize;
use meniscus::error::shown;
use meniscus::files::{MeshFormat, Replace, file_and_step, is_same_file};
use meniscus::{Error, Needs, Opened, Simulation};

use crate::interrupt;
use crate::options::Options;
use crate::outcome::{Verdict, print};
use crate::report::{report, report_device, report_opened, report_stages, warn_all};
use crate::run::bytes_of;
use crate::sequence;
use crate::stats::{Made, record};

/// Runs the command.
pub fn run(options: &Options) -> Result<Verdict, Error> {
    match Simulation::if_several(&options.inputs, &options.output)? {
        Some(simulation) => sequence::run(options, simulation),
        None => run_frame(options, &options.inputs[0]),
    }
}

/// Refuses a file that is to be read or written and written again, which is a slip of the hand.
pub fn refuse_same_file(one: &Path, other: &Path) -> Result<(), Error> {
    if is_same_file(one, other) {
        return Err(Error::TwoPurposes { path: other.to_owned(), other: one.to_owned() });
    }
    Ok(())
}

fn run_frame(options: &Options, input: &Path) -> Result<Verdict, Error> {
    let notes = options.run.notes();
    options.sequence.refuse_for_one_frame()?;
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
    let format = output.format();

    // What the file cannot hold need not be carried.
    let carries = options.attributes.is_some() || format.holds_attributes();
    let request = if carries { request } else { request.attributes([""; 0]) };
    let opened = request.open(input)?;
    report_opened(input, &opened, &notes);
    if options.dry_run {
        print(&dry_run(options, &opened, format)?)?;
        return Ok(Verdict::Good);
    }
    let frame = opened.sample()?;
    let surface = frame.surface()?;
    drop(frame);
    let mut stages = surface.report().timings.clone();
    report(options, surface.report(), surface.mesh(), &notes);
    warn_all(&surface.warnings_in(format)?, Some(options), &notes);
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
    report_stages(&stages, &notes);
    report_device(request.device(), 1, &notes);
    let counts = [mesh.vertex_count(), mesh.triangle_count(), bytes];
    let made = Made { input, output: &options.output, counts, stages: &stages, lost: report.lost };
    options.append_stats(|| record(options, report, &made))?;
    Ok(Verdict::Good)
}

/// Says what would be done, and what it would take.
fn dry_run(options: &Options, opened: &Opened, format: MeshFormat) -> Result<String, Error> {
    let output = options.output.display();
    let Some(needs) = opened.needs(format)? else {
        return Ok(format!("would reconstruct {} particles into {output}", opened.particles()));
    };
    let Needs { census, cell_size, budget, memory, in_core, scratch, .. } = needs;
    let [budget, memory, in_core] = [budget, memory, in_core].map(ByteSize);
    let scratch = match scratch {
        0 => "none".to_owned(),
        bytes => format!("at most about {} in {}", ByteSize(bytes), needs.scratch_folder.display()),
    };
    let mut text = format!(
        "would reconstruct {} particles with cells of {} into {output}\n\
         memory: about {memory} of {budget}; all in memory would take {in_core}\nscratch: {scratch}",
        census.binned,
        shown(cell_size),
    );
    if let Some([threads, triangles]) = needs.simplifying.map(|bytes| bytes.map(ByteSize)) {
        text += &format!("\nsimplifying takes up to {threads} more, and {triangles} of memory or scratch");
    }
    if let Some(bytes) = needs.writing {
        text += &format!("\n{format} is written from memory: up to {} more", ByteSize(bytes));
    }
    Ok(text)
}
