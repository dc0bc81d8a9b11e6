//! `meniscus info`: what a file holds.

use std::path::PathBuf;

use bytesize::ByteSize;
use clap::Args;
use meniscus::Error;
use meniscus::error::shown;
use meniscus::files::{AttributeInfo, FrameInfo, Info, MeshInfo, ParticlesInfo, info};

use crate::outcome::{Verdict, corners, point, print, print_json};

#[derive(Args)]
pub struct Options {
    /// Particle files, packed frames (.mnf) or meshes.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Print JSON, for programs: a list with an entry for each file.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(options: &Options) -> Result<Verdict, Error> {
    let infos = options.files.iter().map(info).collect::<Result<Vec<_>, _>>()?;
    if options.json {
        print_json(&infos)?;
    } else {
        for info in &infos {
            print(&describe(info))?;
        }
    }
    Ok(Verdict::Good)
}

fn describe(info: &Info) -> String {
    let mut lines = Vec::new();
    let mut line = |name: &str, text: String| lines.push(format!("  {name:<12} {text}"));
    let names = |attributes: &[AttributeInfo]| {
        let names: Vec<_> = attributes.iter().map(|a| format!("{} ({})", a.name, a.components)).collect();
        if names.is_empty() { "none".to_owned() } else { names.join(", ") }
    };
    let title = match info {
        Info::Particles(ParticlesInfo {
            file,
            format,
            particles,
            not_finite,
            bounds,
            attributes,
            spacing,
            spacing_source,
            memory_bytes,
            ..
        }) => {
            line("particles", particles.to_string());
            if *not_finite > 0 {
                line("not finite", not_finite.to_string());
            }
            bounds.iter().for_each(|bounds| line("box", corners(bounds)));
            line("attributes", names(attributes));
            let source = spacing_source.as_deref().unwrap_or_default();
            line("spacing", spacing.map_or("unknown".into(), |s| format!("{}, from {source}", shown(s))));
            if let Some(bytes) = memory_bytes {
                line("memory", format!("about {} by default", ByteSize(*bytes)));
            }
            format!("{}: {format}", file.display())
        }
        Info::Frame(FrameInfo {
            file,
            particles,
            cells,
            bricks,
            bounds,
            cell_size,
            origin,
            domain,
            indicator,
            mu0,
            ..
        }) => {
            line("particles", particles.to_string());
            line("cells", cells.to_string());
            line("bricks", bricks.to_string());
            bounds.iter().for_each(|bounds| line("box", corners(bounds)));
            line("cell size", shown(*cell_size));
            line("origin", point(origin));
            line("domain", domain.as_ref().map_or("unbounded".into(), corners));
            line("indicator", indicator.to_string());
            mu0.iter().for_each(|mu0| line("mu0", shown(*mu0)));
            format!("{}: packed frame", file.display())
        }
        Info::Mesh(MeshInfo {
            file, vertices, triangles, bounds, components, normals, attributes, ..
        }) => {
            line("vertices", vertices.to_string());
            line("triangles", triangles.to_string());
            line("components", components.to_string());
            line("normals", if *normals { "yes" } else { "no" }.into());
            bounds.iter().for_each(|bounds| line("box", corners(bounds)));
            line("attributes", names(attributes));
            format!("{}: mesh", file.display())
        }
        _ => String::new(),
    };
    format!("{title}\n{}", lines.join("\n"))
}
