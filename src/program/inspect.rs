//! `meniscus check` and `meniscus compare`: defects and measurements of a mesh, and its distances
//! from another mesh.

use std::path::{Path, PathBuf};

use clap::Args;
use meniscus::Error;
use meniscus::error::shown;
use meniscus::files::{InputFormat, MeshFormat, files};
use meniscus::mesh::{CheckReport, Comparison, Distances, Measures, Side, measure, read_mesh};
use serde::Serialize;

use super::advice::all_or_last;
use super::notes::{Verdict, corners, point, print, print_json};

#[derive(Args)]
pub struct CheckOptions {
    /// Meshes, folders, globs, or patterns with {} for the frame number.
    #[arg(required = true, value_name = "MESH")]
    meshes: Vec<PathBuf>,
    /// Print JSON: a list with one entry per mesh.
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
pub struct CompareOptions {
    /// Reference mesh. Distances are positive outside it and negative inside.
    reference: PathBuf,
    /// Mesh to compare with the reference.
    mesh: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct MeshCheck {
    mesh: PathBuf,
    closed_oriented_manifold: bool,
    report: CheckReport,
    measures: Measures,
}

/// Checks every mesh that can be read. If any mesh could not be read, returns an error at the end.
/// The verdict is good only if all meshes are closed, oriented 2-manifolds and every component
/// encloses a volume.
pub fn check(options: &CheckOptions) -> Result<Verdict, Error> {
    let (mut all, mut errors) = (Vec::new(), Vec::new());
    let is_mesh = |file: &Path| {
        MeshFormat::of(file).is_some_and(MeshFormat::is_read)
            || InputFormat::of(file) == Some(InputFormat::Bgeo)
    };
    for path in files(&options.meshes, is_mesh)? {
        let mesh = match read_mesh(&path) {
            Ok(mesh) => mesh,
            Err(error) => {
                errors.push(Error::from(error));
                continue;
            }
        };
        let report = meniscus::mesh::check(&mesh);
        let checked = MeshCheck {
            mesh: path.clone(),
            closed_oriented_manifold: report.is_closed_oriented_manifold(),
            report,
            measures: measure(&mesh),
        };
        if !options.json {
            print(&format!(
                "{}\n{}\n{}",
                path.display(),
                checked.report,
                describe(&checked.measures)
            ))?;
        }
        all.push(checked);
    }
    if options.json {
        print_json(&all)?;
    }
    all_or_last(errors)?;
    let good = all
        .iter()
        .all(|checked| checked.closed_oriented_manifold && checked.measures.flat_components == 0);
    Ok(if good { Verdict::Good } else { Verdict::Bad })
}

fn describe(measures: &Measures) -> String {
    let Measures {
        bounds,
        area,
        volume,
        components,
        flat_components,
        euler_characteristic,
        genus,
        quality,
    } = measures;
    let known = |value: Option<String>| value.unwrap_or_else(|| "unknown".to_owned());
    let lines = [
        ("box", known(bounds.as_ref().map(corners))),
        ("area", shown(*area)),
        ("volume", known(volume.map(shown))),
        ("components", components.to_string()),
        ("components without volume", flat_components.to_string()),
        (
            "genus",
            known(genus.map(|g| format!("{g} (Euler characteristic {euler_characteristic})"))),
        ),
        ("smallest angle", known(quality.worst_angle.map(|a| format!("{a:.2} degrees")))),
        ("mean smallest angle", known(quality.mean_angle.map(|a| format!("{a:.2} degrees")))),
        ("worst aspect ratio", known(quality.worst_aspect.map(|a| format!("{a:.1}")))),
        ("flat triangles", quality.flat.to_string()),
    ];
    lines.map(|(name, value)| format!("  {name:<25} {value}")).join("\n")
}

/// Measures the distances between two meshes.
pub fn compare(options: &CompareOptions) -> Result<Verdict, Error> {
    let reference = read_mesh(&options.reference)?;
    let mesh = read_mesh(&options.mesh)?;
    let comparison = meniscus::mesh::compare(&reference, &mesh).map_err(|fault| {
        let path = match fault.side() {
            Side::Reference => options.reference.clone(),
            Side::Mesh => options.mesh.clone(),
        };
        Error::Mesh { path, fault }
    })?;
    if options.json {
        print_json(&comparison)?;
    } else {
        let Comparison { hausdorff, bias, from_mesh, from_reference } = &comparison;
        let way = |name: &str, d: &Distances| {
            format!(
                "{name:<15} mean {}, RMS {}, greatest {} at {}",
                shown(d.mean),
                shown(d.rms),
                shown(d.max),
                point(&d.farthest)
            )
        };
        print(&format!(
            "Hausdorff       {}\nbias            {}{}\n{}\n{}",
            shown(*hausdorff),
            if *bias > 0.0 { "+" } else { "" },
            shown(*bias),
            way("from mesh", from_mesh),
            way("from reference", from_reference),
        ))?;
    }
    Ok(Verdict::Good)
}
