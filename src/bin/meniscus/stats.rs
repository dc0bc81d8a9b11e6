//! `--stats`: what a program wants to know of a frame, a line of JSON each.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;

use meniscus::baselines::Method;
use meniscus::brick::FrameFacts;
use meniscus::error::Error;
use meniscus::field::indicator::SampledDif;
use meniscus::frame::{Frame, Surfacing};
use meniscus::grid::units::{Isovalue, MeanCount, Smooth};
use meniscus::io::WriteError;
use meniscus::surface::mesh::source::MeshSource;
use meniscus::system::memory::peak_resident;
use meniscus::system::timings::Timings;
use serde_json::{Value, json};

use crate::options::Options;

impl Options {
    /// What is known of a frame that is done; a DIF was drawn at an isovalue.
    pub fn record(
        &self,
        [input, output]: [&Path; 2],
        frame: &Frame,
        iso: Option<Isovalue>,
        mesh: &dyn MeshSource,
        bytes: u64,
        timings: &Timings,
    ) -> Value {
        let seconds = timings.seconds().iter().map(|&(stage, seconds)| (stage.to_owned(), json!(seconds)));
        let of_run = json!({
            "input": input,
            "output": output,
            "method": self.method,
            "simplify": self.simplify,
            "drop_smaller": self.drop_smaller,
            "smallest_drop": self.smallest_drop,
            "vertices": mesh.vertex_count(),
            "triangles": mesh.triangle_count(),
            "output_bytes": bytes,
            "seconds": seconds.collect::<serde_json::Map<_, _>>(),
            "total_seconds": timings.total(),
            "threads": rayon::current_num_threads(),
            "peak_resident_bytes": peak_resident(),
        });
        let of_field = match frame.dif() {
            Some(sampled) => self.dif_facts(frame, sampled, iso),
            None => json!({
                "spacing": frame.facts().spacing,
                "isovalue": frame.kernels().and_then(Method::iso),
                "backend": frame.backend(),
            }),
        };
        joined(joined(facts(frame.facts()), of_field), of_run)
    }

    /// Makes sure, before the work, that statistics can be appended; a file that was not there is not there then.
    pub fn prepare_stats(&self) -> Result<(), Error> {
        let Some(path) =
            self.stats.as_ref().filter(|path| path.metadata().is_ok_and(|m| m.is_file()) || !path.exists())
        else {
            return Ok(());
        };
        let is_new = !path.exists();
        let file = OpenOptions::new().create(true).append(true).open(path);
        file.map_err(|e| WriteError::new(path, e))?;
        if is_new {
            let _ = std::fs::remove_file(path);
        }
        Ok(())
    }

    /// Appends a line to the statistics, if they are asked for.
    pub fn append_stats(&self, record: &Value) -> Result<(), Error> {
        let Some(path) = &self.stats else { return Ok(()) };
        let file = OpenOptions::new().create(true).append(true).open(path);
        let written = file.and_then(|mut file| writeln!(file, "{record}"));
        Ok(written.map_err(|e| WriteError::new(path, e))?)
    }

    fn dif_facts(&self, frame: &Frame, sampled: &SampledDif, iso: Option<Isovalue>) -> Value {
        let SampledDif { facts, indicator, .. } = sampled;
        let of_paper = !sampled.is_clouds();
        let sigma = || Surfacing::PLAIN.width(facts.spacing, facts.grid.cell_size()).cells();
        json!({
            "indicator": indicator.kind().name(),
            "mu0": indicator.mean().map(MeanCount::particles),
            "smooth": (!of_paper).then(|| self.smooth.unwrap_or(Smooth::USUAL.spacings())),
            "sigma": of_paper.then(|| self.sigma.unwrap_or_else(sigma)),
            "isovalue": iso.map(Isovalue::value),
            "detail": self.detail,
            "backend": frame.backend(),
            "pages_on_device": frame.on_device().pages,
            "regions_on_device": frame.on_device().regions,
        })
    }
}

fn facts(FrameFacts { census, grid, domain, .. }: &FrameFacts) -> Value {
    json!({
        "particles": census.binned,
        "not_finite": census.not_finite,
        "too_far": census.too_far,
        "outside_domain": census.outside,
        "cell_size": grid.cell_size(),
        "origin": grid.origin().to_array(),
        "domain": domain.map(|domain| domain.walls().map(|wall| wall.to_array())),
    })
}

/// All fields of two objects.
fn joined(mut one: Value, other: Value) -> Value {
    if let (Value::Object(one), Value::Object(other)) = (&mut one, other) {
        one.extend(other);
    }
    one
}
