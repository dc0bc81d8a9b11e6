//! `meniscus reconstruct`: a frame of particles to a mesh; each frame of a simulation is one, see `sequence`.

use std::path::Path;
use std::sync::Arc;

use bytesize::ByteSize;
use meniscus::error::Error;
use meniscus::field::indicator::SampledDif;
use meniscus::frame::estimate::Estimate;
use meniscus::frame::{Counted, Frame, FrameError, Resources, Surfacing};
use meniscus::io::input::{file_and_step, open_particles};
use meniscus::io::mnf::{is_packed, open_frame};
use meniscus::io::output::{MeshFormat, MeshOutput};
use meniscus::io::whole::Replace;
use meniscus::particles::Particles;
use meniscus::reconstruction::SamplingRequest;
use meniscus::simulation::inputs::Inputs;
use meniscus::simulation::naming::Naming;
use meniscus::surface::mesh::source::MeshSource;
use meniscus::surface::simplify::BYTES_A_THREAD;
use meniscus::system::timings::Timings;
use serde_json::json;

use crate::identity::refuse_same_file;
use crate::interrupt;
use crate::options::Options;
use crate::outcome::Verdict;
use crate::report::{
    LeftOut, advice, coordinate_width, merged, report_calibration, report_device, report_laps,
    report_lattice, report_simplified, warnings,
};
use crate::run::{Notes, bytes_of, unpacking};
use crate::sampling::sampling;
use crate::sequence::{self};

impl Options {
    /// What simplifying and writing take beyond the surface, in words.
    fn further_needs(&self, format: MeshFormat, estimate: &Estimate) -> String {
        let mut needs = String::new();
        if self.simplify.is_some() {
            let threads = BYTES_A_THREAD * rayon::current_num_threads() as u64;
            // Two passes hold the triangles that are left as three numbers of 64 bits.
            needs += &format!(
                "\nsimplifying takes up to {} more, and {} of memory or scratch",
                ByteSize(threads),
                ByteSize(3 * estimate.surface)
            );
        }
        if format.holds_whole_mesh() {
            let bytes = ByteSize(3 * estimate.surface);
            needs += &format!("\n{format} is written from memory: up to {bytes} more");
        }
        needs
    }

    /// The frame, from particles or as it was packed; `None` where only an estimate was asked for.
    fn frame(
        &self,
        input: &Path,
        (request, surfacing): (&SamplingRequest, &Surfacing),
        format: MeshFormat,
        resources: Resources,
        timings: &mut Timings,
        notes: &Notes,
    ) -> Result<Option<Frame>, Error> {
        let in_file = |fault: FrameError| Error::Frame { path: Some(input.to_owned()), fault };
        if is_packed(input) {
            let sampled = open_frame(input, resources.budget.0 / 4)?;
            timings.done("open");
            self.refuse_of_others(sampled.indicator.kind())?;
            let particles = sampled.facts.census.binned;
            notes.say(format!("{}: {particles} particles, packed frame", input.display()));
            if self.dry_run {
                let output = self.output.display();
                crate::outcome::print(&format!("would reconstruct {particles} particles into {output}"))?;
                return Ok(None);
            }
            return Ok(Some(Frame::from_sampled(sampled, surfacing, resources)));
        }
        let file = open_particles(input, unpacking(&resources))?;
        timings.done("open");
        notes.say(format!("{}: {} particles, {}", input.display(), file.particles.len(), file.format));
        let carried = self.carried(input, &file, format)?;
        let sampling = sampling(request, (input, &file), carried, resources, notes)?;
        timings.done("spacing");
        let counted = Counted::for_surface(&file.particles, &sampling, surfacing).map_err(in_file)?;
        timings.done("count");
        if self.dry_run {
            let (estimate, budget) = (counted.estimate(), sampling.resources.budget);
            let plan = estimate.plan(budget);
            crate::outcome::print(&format!(
                "would reconstruct {} particles with cells of {} into {}\n\
                 memory: about {} of {}; all in memory would take {}\nscratch: at most about {} in {}{}",
                counted.census().binned,
                sampling.grid.cell_size(),
                self.output.display(),
                ByteSize(estimate.peak(plan)),
                ByteSize(budget.0),
                ByteSize(estimate.in_core()),
                ByteSize(file.particles.scratch_bytes() + estimate.scratch(plan)),
                sampling.resources.scratch.display(),
                self.further_needs(format, &estimate),
            ))?;
            return Ok(None);
        }
        Frame::sample_counted(counted, sampling.resources.budget, timings).map(Some).map_err(in_file)
    }
}

/// Runs the command.
pub fn run(options: &Options) -> Result<Verdict, Error> {
    let inputs = Inputs::of(&options.inputs)?;
    let naming = Naming::of(&options.output)?;
    match (inputs, naming) {
        (None, None) => run_frame(options, &options.inputs[0]),
        (inputs, Some(naming)) => {
            let inputs = inputs.unwrap_or_else(|| Inputs::Files(options.inputs.clone()));
            sequence::run(options, &inputs, &naming)
        }
        (Some(inputs), None) => Err(Error::Request(format!(
            "{}: one file for the frames of {}; write {{}} where their numbers go, or name a folder",
            options.output.display(),
            inputs.describe()
        ))),
    }
}

fn run_frame(options: &Options, input: &Path) -> Result<Verdict, Error> {
    let notes = options.run.notes();
    options.sequence.refuse_for_one_frame()?;
    let request = options.request()?;
    let surfacing = options.surfacing()?;
    let reduction = options.reduction()?;
    if is_packed(input) {
        options.validate_frame_input(input)?;
    }
    let resources = options.resources(&options.output, || bytes_of([input]))?;
    options.validate_memory(&reduction, &resources)?;
    refuse_same_file(file_and_step(input).0, &options.output)?;
    if let Some(stats) = &options.stats {
        refuse_same_file(input, stats)?;
        refuse_same_file(&options.output, stats)?;
        options.prepare_stats()?;
    }
    let replace = if options.run.overwrite { Replace::Allow } else { Replace::Refuse };
    let prepare = || MeshOutput::prepare(&options.output, replace);
    let (output, unfinished) = interrupt::guard(prepare, MeshOutput::temporary)?;
    options.validate_format(output.format())?;
    let orientation = options.up.orientation(input, output.format());
    let output = output.with_layout(options.layout(orientation));
    let format = output.format();

    let mut timings = Timings::default();
    let in_file = |fault| Error::Frame { path: Some(input.to_owned()), fault };
    let backend = Arc::clone(&resources.backend);
    let made = options.frame(input, (&request, &surfacing), format, resources, &mut timings, &notes)?;
    let Some(frame) = made else { return Ok(Verdict::Good) };
    report_lattice(&frame, &notes);
    let calibrated = frame.calibrate(&surfacing, None, &mut timings).map_err(in_file)?;
    let measured = calibrated.measured();
    let mesh = calibrated.surface(&mut timings).map_err(in_file)?;
    warnings(&frame).iter().for_each(|warning| notes.say(format!("warning: {warning}")));
    measured.iter().for_each(|measured| report_calibration(&frame, measured, surfacing.iso, &notes));
    let lost = frame.lost(&mesh).map_err(in_file)?;
    LeftOut { lost, ..frame.facts().census.into() }.say(request.field, &notes);
    if let Some(shortfall) = frame.shortfall(&mesh).map_err(in_file)? {
        notes.say(format!(
            "warning: {shortfall}{}",
            advice(options, frame.dif().is_some_and(SampledDif::is_clouds), None)
        ));
    }
    let width = coordinate_width(&mesh, format, &notes)?;
    let mesh: Box<dyn MeshSource> = if reduction.is_none() {
        Box::new(mesh)
    } else {
        let simplified = frame.simplify(mesh, &reduction, &mut timings).map_err(in_file)?;
        report_simplified(&simplified, &reduction, &notes);
        Box::new(simplified)
    };
    if let Some(warning) = merged(&*mesh, format, &options.output)? {
        notes.say(format!("warning: {warning}"));
    }
    let bytes = output.write(&orientation.turned(&*mesh), width)?;
    drop(unfinished);
    timings.done("write");
    notes.say(format!(
        "{}: {} vertices, {} triangles, {} in {:.2} s",
        options.output.display(),
        mesh.vertex_count(),
        mesh.triangle_count(),
        ByteSize(bytes),
        timings.total(),
    ));
    report_laps(&timings, &notes);
    report_device(&*backend, 1, &notes);
    if options.stats.is_some() {
        let iso = measured.and_then(|measured| measured.calibration.iso());
        let mut record = options.record([input, &options.output], &frame, iso, &*mesh, bytes, &timings);
        record["in_no_surface"] = json!(lost);
        options.append_stats(&record)?;
    }
    Ok(Verdict::Good)
}
