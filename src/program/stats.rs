//! `--stats`: a line of JSON for each frame, for other programs.

use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::Path;

use meniscus::error::WriteError;
use meniscus::{Error, FrameDone, FrameFailed, MethodName, Report, Timings, peak_memory};
use serde_json::{Map, Value, json};

use super::advice::error_message;
use super::options::ReconstructOptions;

/// Facts about the mesh of a frame, for the statistics.
pub struct MeshStats<'a> {
    pub input: &'a Path,
    pub output: &'a Path,
    /// Number of vertices, number of triangles, and size, in bytes, of the mesh file.
    pub counts: [u64; 3],
    pub stages: &'a Timings,
    /// Lower bound on the number of particles outside the surface.
    pub lost: u64,
}

impl ReconstructOptions {
    /// Checks, before the reconstruction, that statistics can be appended to the file. If this
    /// check creates the file, it also removes it. Rejects a nonempty file that does not begin with
    /// a JSON object. The file's folder need not exist yet if the reconstruction will create it for
    /// the meshes.
    pub fn prepare_stats(&self) -> Result<(), Error> {
        let Some(path) = self
            .stats
            .as_ref()
            .filter(|path| path.metadata().is_ok_and(|m| m.is_file()) || !path.exists())
        else {
            return Ok(());
        };
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        if folder.is_some_and(|folder| !folder.exists() && self.output.starts_with(folder)) {
            return Ok(());
        }
        let is_new = !path.exists();
        let file = OpenOptions::new().create(true).append(true).open(path);
        file.map_err(|e| WriteError::new(path, e))?;
        if is_new {
            let _ = std::fs::remove_file(path);
        }
        refuse_other_contents(path)
    }

    /// Appends a line to the file of `--stats`, if the option was given.
    pub fn append_stats(&self, record: impl FnOnce() -> Value) -> Result<(), Error> {
        let Some(path) = &self.stats else { return Ok(()) };
        let file = OpenOptions::new().create(true).append(true).open(path);
        let written = file.and_then(|mut file| writeln!(file, "{}", record()));
        Ok(written.map_err(|e| WriteError::new(path, e))?)
    }
}

/// Rejects a nonempty file that does not begin with a JSON object.
fn refuse_other_contents(path: &Path) -> Result<(), Error> {
    let mut first = [0];
    // Ignore read errors, because the program may have the permission to append to a file but not
    // the permission to read it.
    match File::open(path).and_then(|mut file| file.read(&mut first)) {
        Ok(1) if first != *b"{" => Err(Error::Request(format!(
            "{}: this file does not contain statistics; name another file for --stats",
            path.display()
        ))),
        _ => Ok(()),
    }
}

/// The record of a finished frame of a simulation, as one JSON object.
pub fn of_frame(options: &ReconstructOptions, done: &FrameDone) -> Value {
    let FrameDone { input, output, mesh, report, lost, .. } = done;
    let mut stats = match report {
        Some(report) => {
            let counts = [mesh.vertices, mesh.triangles, mesh.bytes];
            record(
                options,
                report,
                &MeshStats { input, output, counts, stages: &report.timings, lost: *lost },
            )
        }
        None => {
            json!({ "input": input, "output": output, "particles": 0, "vertices": 0, "triangles": 0 })
        }
    };
    stats["frame"] = json!(mesh.frame);
    stats["in_no_surface"] = json!(lost);
    stats["time"] = json!(done.time);
    stats
}

/// The record of a failed frame of a simulation, as one JSON object.
pub fn of_failed(failed: &FrameFailed) -> Value {
    json!({ "frame": failed.frame, "input": failed.input, "error": error_message(&failed.error) })
}

/// The record of a frame that is missing between existing frames, as one JSON object. `input` is
/// the path that its file would have.
pub fn of_missing(frame: i64, input: &Path) -> Value {
    json!({ "frame": frame, "input": input, "error": format!("{}: missing", input.display()) })
}

/// The record of a mesh and its reconstruction, as one JSON object.
pub fn record(options: &ReconstructOptions, report: &Report, made: &MeshStats<'_>) -> Value {
    let MeshStats { input, output, counts: [vertices, triangles, bytes], stages, lost } = made;
    let seconds =
        stages.seconds().iter().map(|&(stage, seconds)| (stage.to_owned(), json!(seconds)));
    let facts = &report.facts;
    let of_run = json!({
        "particles": facts.census.binned,
        "not_finite": facts.census.not_finite,
        "too_far": facts.census.too_far,
        "outside_domain": facts.census.outside,
        "wrapped": facts.census.wrapped,
        "cell_size": facts.grid.cell_size(),
        "origin": facts.grid.origin().to_array(),
        "domain": facts.domain.map(|domain| domain.walls().map(|wall| wall.to_array())),
        "periodic": facts.periodic.map(|periodic| periodic.faces()),
        "input": input,
        "output": output,
        "method": options.settings.method.unwrap_or(MethodName::Dif),
        "simplify": options.settings.simplify,
        "smallest_component": options.settings.smallest_component,
        "smallest_drop": options.settings.smallest_drop,
        "vertices": vertices,
        "triangles": triangles,
        "output_bytes": bytes,
        "seconds": seconds.collect::<Map<_, _>>(),
        "total_seconds": stages.total(),
        "threads": report.threads,
        "peak_resident_bytes": peak_memory(),
        "in_no_surface": lost,
        "isovalue": report.isovalue(),
        "spacing": facts.spacing,
        "backend": report.backend,
    });
    let of_field = match report.indicator {
        Some(indicator) => json!({
            "indicator": indicator.kind().name(),
            "mu0": indicator.mean().map(|mean| mean.particles()),
            "smooth": report.smooth,
            "sigma": report.sigma,
            "detail": options.settings.detail,
            "pages_on_device": report.on_device.pages,
            "regions_on_device": report.on_device.regions,
        }),
        None => json!({}),
    };
    joined(of_run, of_field)
}

/// Combines the fields of two JSON objects; a field of `other` replaces one with the same name.
fn joined(mut one: Value, other: Value) -> Value {
    if let (Value::Object(one), Value::Object(other)) = (&mut one, other) {
        one.extend(other);
    }
    one
}
