//! `meniscus reconstruct --parts`: makes the mesh of one frame in parts, in several processes that
//! may run on different machines.

use std::path::Path;

use bytesize::ByteSize;
use clap::{Args, value_parser};
use meniscus::files::Replace;
use meniscus::{Error, Indicator, PartDone, PartNeeds, Parts, PartsPlan, Reconstruction};

use super::notes::Notes;
use super::notes::{Verdict, print};
use super::one_frame::{PreparedRequest, prepare, write};
use super::options::ReconstructOptions;
use super::report::{
    contents, report_cells, report_census, report_left_out, report_stages, warn_all,
};

/// Runs the requested step: `--plan`, `--part` or `--merge`. The mesh has `count` parts.
pub fn run(options: &ReconstructOptions, input: &Path, count: u32) -> Result<Verdict, Error> {
    let step = options.parts.step(options.simulation.plan)?;
    let refused = match step {
        _ if options.dry_run => Some(
            "--dry-run does not work with --parts; --plan prints the memory and scratch space that \
             each part needs",
        ),
        PartsStep::Plan | PartsStep::Part(_) if options.stats.is_some() => {
            Some("--stats works only with --merge: the other steps of --parts make no mesh")
        }
        PartsStep::Plan | PartsStep::Part(_) if options.preview => {
            Some("--preview works only with --merge: the other steps of --parts make no mesh")
        }
        PartsStep::Merge if options.simulation.resume => {
            Some("--resume does not work with --merge, which always writes the whole mesh")
        }
        _ => None,
    };
    if let Some(what) = refused {
        return Err(Error::Request(what.into()));
    }
    let PreparedRequest { request, output, preview, notes } =
        prepare(options, &[input.to_owned()])?;
    let parts = parts(options, &request, input, count);
    match step {
        PartsStep::Plan => {
            drop(output);
            plan(options, &parts, &notes)
        }
        PartsStep::Part(part) => {
            drop(output);
            make(options, &parts, part, &notes)
        }
        PartsStep::Merge => {
            let surface = parts.merge()?;
            let made = surface.report();
            notes.say(format!("{}: {count} parts", parts.folder().display()));
            if let Some(cells) = &made.cells {
                let moved_to = made.moved.then(|| made.facts.grid.origin().to_array());
                report_cells(cells, made.indicator.map(Indicator::kind), moved_to, &notes);
            }
            write(options, input, &surface, &request, (output, preview), &notes)?;
            notes.say(format!("{}: this folder can be deleted", parts.folder().display()));
            Ok(Verdict::Good)
        }
    }
}

fn parts(
    options: &ReconstructOptions,
    request: &Reconstruction,
    input: &Path,
    count: u32,
) -> Parts {
    let parts = request.parts(input, &options.output, count);
    match (replace(options), options.simulation.resume) {
        (Replace::Allow, _) => parts.overwrite(),
        (Replace::Refuse, true) => parts.resume(),
        (Replace::Refuse, false) => parts,
    }
}

fn replace(options: &ReconstructOptions) -> Replace {
    if options.run.overwrite { Replace::Allow } else { Replace::Refuse }
}

fn plan(options: &ReconstructOptions, parts: &Parts, notes: &Notes) -> Result<Verdict, Error> {
    let planned = parts.plan()?;
    let PartsPlan { particles, format, particle_types, left_out, cells, .. } = &planned;
    let PartsPlan { moved_to, indicator, .. } = &planned;
    let contents = contents(*particles, format, particle_types);
    notes.say(format!("{}: {contents}", options.inputs[0].display()));
    report_left_out(left_out, notes);
    report_cells(cells, Some(*indicator), *moved_to, notes);
    cells.walls.iter().for_each(|found| notes.say(found.to_string()));
    report_census(&planned.census, notes);
    print(&describe_parts(&planned))?;
    report_stages(&planned.timings, notes);
    if planned.parts.iter().any(|part| part.needs.is_none()) {
        notes.say(format!("{}: the plan already exists", planned.path.display()));
    }
    Ok(Verdict::Good)
}

/// Describes each part on one line: its number of particles, its memory and its scratch files.
fn describe_parts(planned: &PartsPlan) -> String {
    let mut lines = Vec::new();
    for (number, part) in planned.parts.iter().enumerate() {
        let mut line = format!(
            "part {number}: {} particles, or {} with the surrounding particles that affect its \
             surface",
            part.particles, part.kept
        );
        if let Some(PartNeeds { memory, in_core, scratch, .. }) = part.needs {
            let [memory, budget, in_core, scratch] =
                [memory, planned.budget, in_core, scratch].map(ByteSize);
            line += &format!("; memory: about {memory} of the {budget} limit");
            if scratch.0 > 0 {
                line += &format!(
                    " ({in_core} without scratch files); scratch files: at most about {scratch}"
                );
            }
        }
        lines.push(line);
    }
    lines.join("\n")
}

fn make(
    options: &ReconstructOptions,
    parts: &Parts,
    part: u32,
    notes: &Notes,
) -> Result<Verdict, Error> {
    let PartDone { path, bytes, blocks, triangles, read, reused, warnings, timings, .. } =
        parts.part(part)?;
    warn_all(&warnings, Some(options), notes);
    let what =
        format!("{}: {blocks} blocks, {triangles} triangles, {}", path.display(), ByteSize(bytes));
    if reused {
        notes.say(format!("{what}, made earlier by another run"));
    } else {
        notes.say(format!("{what} from {read} particles in {:.2} s", timings.total()));
    }
    report_stages(&timings, notes);
    Ok(Verdict::Good)
}

#[derive(Args)]
pub struct PartsOptions {
    /// Make the mesh of one frame in N parts: run with --plan, then with --part I for each part,
    /// then with --merge.
    ///
    /// All runs need the same settings, but can be on different machines. The plan and the parts
    /// are in a folder next to the output: for m.ply, it is m.ply.meniscus-parts.
    #[arg(long, value_name = "N", value_parser = value_parser!(u32).range(1..), help_heading = "Clusters", hide_short_help = true)]
    pub parts: Option<u32>,
    /// Make part I, where I is from 0 to N - 1. Parts can be made in any order. If a run is
    /// killed, make its part again.
    #[arg(
        long,
        value_name = "I",
        requires = "parts",
        conflicts_with_all = ["plan", "merge"],
        help_heading = "Clusters",
        hide_short_help = true
    )]
    part: Option<u32>,
    /// Check all parts, and join them into the mesh. The mesh has the same bytes as the mesh of a
    /// single run.
    #[arg(
        long,
        requires = "parts",
        conflicts_with = "plan",
        help_heading = "Clusters",
        hide_short_help = true
    )]
    merge: bool,
}

/// One of the three steps that make a mesh in parts.
pub enum PartsStep {
    Plan,
    Part(u32),
    Merge,
}

impl PartsOptions {
    /// Returns the requested step. `plan` says whether --plan was given.
    pub fn step(&self, plan: bool) -> Result<PartsStep, Error> {
        match (plan, self.part, self.merge) {
            (true, ..) => Ok(PartsStep::Plan),
            (false, Some(part), _) => Ok(PartsStep::Part(part)),
            (false, None, true) => Ok(PartsStep::Merge),
            (false, None, false) => {
                Err(Error::Request("--parts needs --plan, --part I or --merge".into()))
            }
        }
    }
}
