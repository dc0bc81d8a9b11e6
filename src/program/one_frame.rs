//! The mesh of a single frame: checks the request before the reconstruction, and writes messages
//! and files after it.

use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use meniscus::files::{Output, Replace, file_and_step, is_same_file};
use meniscus::picture::PictureFile;
use meniscus::{Error, Reconstruction, Surface};

use super::interrupt;
use super::notes::Notes;
use super::options::ReconstructOptions;
use super::report::{report, report_device, report_stages, warn_all};
use super::run::bytes_of;
use super::stats::{MeshStats, record};

/// Rejects two paths that lead to the same file: an input and an output, or two outputs.
pub fn refuse_same_file(one: &Path, other: &Path) -> Result<(), Error> {
    if is_same_file(one, other) {
        return Err(Error::SameFile { path: other.to_owned(), other: one.to_owned() });
    }
    Ok(())
}

/// A checked request with its output files.
pub struct PreparedRequest {
    pub request: Reconstruction,
    pub output: Output,
    pub preview: Option<PictureFile>,
    pub notes: Notes,
}

/// Checks a request for one frame, and prepares its output files.
pub fn prepare(options: &ReconstructOptions, inputs: &[PathBuf]) -> Result<PreparedRequest, Error> {
    let notes = options.run.notes();
    match options.parts.parts {
        Some(_) => options.simulation.refuse_for_parts()?,
        None => options.simulation.refuse_for_one_frame()?,
    }
    let request = options.request()?;
    let check = |request: &Reconstruction| inputs.iter().try_for_each(|input| request.check(input));
    check(&request)?;
    let bytes = || bytes_of(inputs.iter().map(PathBuf::as_path));
    let request = options.run.machine(request, &options.output, bytes)?;
    check(&request)?;
    for input in inputs {
        refuse_same_file(file_and_step(input).0, &options.output)?;
        options.stats.iter().try_for_each(|stats| refuse_same_file(input, stats))?;
    }
    options.stats.iter().try_for_each(|stats| refuse_same_file(&options.output, stats))?;
    let replace = if options.run.overwrite { Replace::Allow } else { Replace::Refuse };
    let request = request.cancel(interrupt::handle());
    let output = request.output(&options.output, replace)?;
    // The statistics file may be in the output's folder, which `request.output` creates. So this
    // check must come after `request.output`.
    options.prepare_stats()?;
    let preview = options
        .preview
        .then(|| PictureFile::beside(&options.output, replace, &interrupt::handle()))
        .transpose()?;
    if let (Some(preview), Some(stats)) = (&preview, &options.stats) {
        refuse_same_file(preview.path(), stats)?;
    }

    // By default, attributes are not computed if the mesh file cannot store them.
    let keeps_attributes =
        options.settings.attributes.is_some() || output.format().holds_attributes();
    let request = if keeps_attributes { request } else { request.attributes([""; 0]) };
    Ok(PreparedRequest { request, output, preview, notes })
}

/// Draws the preview next to a mesh.
fn draw_preview(surface: &Surface, file: PictureFile, notes: &Notes) -> Result<(), Error> {
    let image = surface.preview()?;
    let what = format!("{}: {} x {} pixels", file.path().display(), image.width(), image.height());
    file.write(&image)?;
    notes.say(what);
    Ok(())
}

/// Reports a surface, and writes it with its preview.
pub fn write(
    options: &ReconstructOptions,
    input: &Path,
    surface: &Surface,
    request: &Reconstruction,
    (output, preview): (Output, Option<PictureFile>),
    notes: &Notes,
) -> Result<(), Error> {
    let format = output.format();
    let mut stages = surface.report().timings.clone();
    report(options, surface.report(), surface.mesh(), notes);
    warn_all(&surface.warnings_in(format)?, Some(options), notes);
    stages.skip();
    let bytes = surface.write_to(output)?;
    stages.done("write");
    if let Some(file) = preview {
        draw_preview(surface, file, notes)?;
        stages.done("picture");
    }
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
    let made =
        MeshStats { input, output: &options.output, counts, stages: &stages, lost: report.lost };
    options.append_stats(|| record(options, report, &made))
}
