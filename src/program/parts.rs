//! `meniscus reconstruct --parts`: one frame's mesh in parts, each made by a process of its own on
//! any machine.

use std::path::Path;

use bytesize::ByteSize;
use clap::{Args, value_parser};
use meniscus::files::Replace;
use meniscus::{Error, Indicator, PartMade, PartTakes, Parts, Planned, Reconstruction};

use super::notes::Notes;
use super::notes::{Verdict, print};
use super::one_frame::{Ready, ready, write};
use super::options::Options;
use super::report::{report_cells, report_census, report_stages, warn_all};

/// Runs the step that is asked for of so many parts.
pub fn run(options: &Options, input: &Path, count: u32) -> Result<Verdict, Error> {
    let step = options.parts.step(options.simulation.plan)?;
    let refused = match step {
        _ if options.dry_run => {
            Some("--dry-run has no meaning with --parts: --plan says what each part takes")
        }
        Step::Plan | Step::Part(_) if options.stats.is_some() => Some("--stats goes with --merge"),
        Step::Plan | Step::Part(_) if options.preview => Some("--preview goes with --merge"),
        Step::Merge if options.simulation.resume => {
            Some("--resume goes with --plan: a mesh is merged as a whole")
        }
        _ => None,
    };
    if let Some(what) = refused {
        return Err(Error::Request(what.into()));
    }
    let Ready { request, output, preview, notes } = ready(options, &[input.to_owned()])?;
    let parts = parts(options, &request, input, count);
    match step {
        Step::Plan => {
            drop(output);
            plan(options, &parts, &notes)
        }
        Step::Part(part) => {
            drop(output);
            make(options, &parts, part, &notes)
        }
        Step::Merge => {
            let surface = parts.merge()?;
            let made = surface.report();
            notes.say(format!("{}: {count} parts", parts.folder().display()));
            if let Some(cells) = &made.cells {
                let moved_to = made.moved.then(|| made.facts.grid.origin().to_array());
                report_cells(cells, made.indicator.map(Indicator::kind), moved_to, &notes);
            }
            write(options, input, &surface, &request, (output, preview), &notes)?;
            notes.say(format!("{}: of no use any more, and can go", parts.folder().display()));
            Ok(Verdict::Good)
        }
    }
}

fn parts(options: &Options, request: &Reconstruction, input: &Path, count: u32) -> Parts {
    let parts = request.parts(input, &options.output, count);
    match (replace(options), options.simulation.resume) {
        (Replace::Allow, _) => parts.overwrite(),
        (Replace::Refuse, true) => parts.resume(),
        (Replace::Refuse, false) => parts,
    }
}

fn replace(options: &Options) -> Replace {
    if options.run.overwrite { Replace::Allow } else { Replace::Refuse }
}

fn plan(options: &Options, parts: &Parts, notes: &Notes) -> Result<Verdict, Error> {
    let planned = parts.plan()?;
    let Planned { particles, format, cells, moved_to, indicator, .. } = &planned;
    notes.say(format!("{}: {particles} particles, {format}", options.inputs[0].display()));
    report_cells(cells, Some(*indicator), *moved_to, notes);
    cells.walls.iter().for_each(|found| notes.say(found.to_string()));
    report_census(&planned.census, notes);
    print(&listed(&planned))?;
    report_stages(&planned.timings, notes);
    if planned.parts.iter().any(|part| part.takes.is_none()) {
        notes.say(format!("{}: was there already", planned.path.display()));
    }
    Ok(Verdict::Good)
}

/// A line for each part: what it holds, and what it takes.
fn listed(planned: &Planned) -> String {
    let mut lines = Vec::new();
    for (number, part) in planned.parts.iter().enumerate() {
        let mut line =
            format!("part {number}: {} particles, {} with those around", part.particles, part.kept);
        if let Some(PartTakes { memory, in_core, scratch, .. }) = part.takes {
            let [memory, budget, in_core, scratch] =
                [memory, planned.budget, in_core, scratch].map(ByteSize);
            line += &format!("; about {memory} of {budget} memory");
            if scratch.0 > 0 {
                line += &format!(
                    ", where all in memory would take {in_core}; at most about {scratch} of scratch"
                );
            }
        }
        lines.push(line);
    }
    lines.join("\n")
}

fn make(options: &Options, parts: &Parts, part: u32, notes: &Notes) -> Result<Verdict, Error> {
    let PartMade { path, bytes, blocks, triangles, read, was_there, warnings, timings, .. } =
        parts.part(part)?;
    warn_all(&warnings, Some(options), notes);
    let what =
        format!("{}: {blocks} blocks, {triangles} triangles, {}", path.display(), ByteSize(bytes));
    if was_there {
        notes.say(format!("{what}, done already"));
    } else {
        notes
            .say(format!("{what} of {read} particles that were read, in {:.2} s", timings.total()));
    }
    report_stages(&timings, notes);
    Ok(Verdict::Good)
}

#[derive(Args)]
pub struct PartsOptions {
    /// Make one frame's mesh in N parts, on any machines: with --plan, then --part I for each, then
    /// --merge.
    ///
    /// All have to be asked for the same. Plan and parts are kept beside the output, in a folder
    /// named as it with .meniscus-parts appended.
    #[arg(long, value_name = "N", value_parser = value_parser!(u32).range(1..), help_heading = "Clusters", hide_short_help = true)]
    pub parts: Option<u32>,
    /// Make part I of them, from 0. Any order will do; what is killed can be begun again.
    #[arg(
        long,
        value_name = "I",
        requires = "parts",
        conflicts_with_all = ["plan", "merge"],
        help_heading = "Clusters",
        hide_short_help = true
    )]
    part: Option<u32>,
    /// Check all parts, and write the mesh: byte for byte that of a single run.
    #[arg(
        long,
        requires = "parts",
        conflicts_with = "plan",
        help_heading = "Clusters",
        hide_short_help = true
    )]
    merge: bool,
}

/// A step on the way to a mesh in parts.
pub enum Step {
    Plan,
    Part(u32),
    Merge,
}

impl PartsOptions {
    /// The one step that is asked for, by whether it is the plan.
    pub fn step(&self, plan: bool) -> Result<Step, Error> {
        match (plan, self.part, self.merge) {
            (true, ..) => Ok(Step::Plan),
            (false, Some(part), _) => Ok(Step::Part(part)),
            (false, None, true) => Ok(Step::Merge),
            (false, None, false) => {
                Err(Error::Request("--parts needs --plan, --part I or --merge".into()))
            }
        }
    }
}
