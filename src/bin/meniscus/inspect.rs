//! `meniscus check` and `meniscus compare`: what is to be thought of a mesh.

use std::path::PathBuf;

use clap::Args;
use meniscus::error::Error;
use meniscus::io::output::read_mesh;
use meniscus::mesh::check::{self, Report};
use meniscus::mesh::compare;
use meniscus::mesh::measure::{Measures, measure};
use serde::Serialize;

use crate::{Verdict, print, print_json};

#[derive(Args)]
pub struct CheckOptions {
    /// Meshes.
    #[arg(required = true, value_name = "MESH")]
    meshes: Vec<PathBuf>,
    /// As JSON, for programs: a list with an entry for each mesh.
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
pub struct CompareOptions {
    /// The mesh that distances are signed by: positive lies outside of it.
    reference: PathBuf,
    /// The mesh that is compared with it.
    mesh: PathBuf,
    /// As JSON, for programs.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Checked {
    mesh: PathBuf,
    closed_oriented_manifold: bool,
    report: Report,
    measures: Measures,
}

/// Checks every mesh; the verdict is good only if all are closed, oriented 2-manifolds.
pub fn check(options: &CheckOptions) -> Result<Verdict, Error> {
    let mut all = Vec::new();
    for path in &options.meshes {
        let mesh = read_mesh(path)?;
        let report = check::check(&mesh);
        let checked = Checked {
            mesh: path.clone(),
            closed_oriented_manifold: report.is_closed_oriented_manifold(),
            report,
            measures: measure(&mesh),
        };
        if !options.json {
            print(&format!("{}\n{}{}", path.display(), checked.report, checked.measures))?;
        }
        all.push(checked);
    }
    if options.json {
        print_json(&all)?;
    }
    let good = all.iter().all(|checked| checked.closed_oriented_manifold);
    Ok(if good { Verdict::Good } else { Verdict::Bad })
}

/// Measures the distances between two meshes.
pub fn compare(options: &CompareOptions) -> Result<Verdict, Error> {
    let reference = read_mesh(&options.reference)?;
    let mesh = read_mesh(&options.mesh)?;
    let comparison = compare::compare(&reference, &mesh).map_err(|e| Error::Request(e.to_string()))?;
    if options.json {
        print_json(&comparison)?;
    } else {
        print(&comparison.to_string())?;
    }
    Ok(Verdict::Good)
}
