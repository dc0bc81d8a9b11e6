//! `meniscus info`: the content of files.

use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use clap::Args;
use meniscus::error::{shown, significant};
use meniscus::files::{
    AttributeInfo, FrameInfo, GeometryInfo, GridInfo, Info, InputFormat, MeshFormat, MeshInfo,
    ParticlesInfo, ValueCounts, VolumeInfo, files, info_with, is_packed,
};
use meniscus::{Error, Settings, Where};

use super::advice::all_or_last;
use super::notes::{Verdict, corners, point, print, print_json};
use super::report::{counted, type_read};

#[derive(Args)]
pub struct InfoOptions {
    /// Particle files, packed frames (.mnf), meshes or volumes (.vdb). Folders, globs and patterns
    /// with {} for the frame number also work.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Format of particle files [default: determined by the extension].
    #[arg(long, value_enum, value_name = "NAME")]
    format: Option<InputFormat>,
    /// Use only particles whose attributes satisfy a condition, such as Type=1.
    #[arg(long, value_name = "CONDITION")]
    r#where: Option<Vec<Where>>,
    /// Print JSON: a list with one entry per file.
    #[arg(long)]
    json: bool,
}

/// Runs `meniscus info`.
pub fn run(options: &InfoOptions) -> Result<Verdict, Error> {
    let InfoOptions { format, r#where, .. } = options;
    let settings = Settings { format: *format, r#where: r#where.clone(), ..Settings::default() };
    let (mut infos, mut errors) = (Vec::new(), Vec::new());
    for file in files(&options.files, is_listed)? {
        match info_with(&file, &settings) {
            Ok(info) if options.json => infos.push(info),
            Ok(info) => print(&describe(&info))?,
            Err(error) => errors.push(error),
        }
    }
    if options.json {
        print_json(&infos)?;
    }
    all_or_last(errors)?;
    Ok(Verdict::Good)
}

/// Whether `info` describes this file when the user names its folder. In folders, `.json` files
/// are lists of frames or scenes rather than particles.
fn is_listed(file: &Path) -> bool {
    let is_particles = InputFormat::of(file).is_some_and(|format| format != InputFormat::Json);
    is_particles || MeshFormat::of(file).is_some() || is_packed(file)
}

fn describe(info: &Info) -> String {
    let mut lines = Vec::new();
    let mut line = |name: &str, text: String| lines.push(format!("  {name:<12} {text}"));
    let names = |attributes: &[AttributeInfo]| {
        let names: Vec<_> =
            attributes.iter().map(|a| format!("{} ({})", a.name, a.components)).collect();
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
            spacing_warnings,
            spacing_unknown,
            nearest_neighbours,
            slab,
            walls,
            memory_bytes,
            ghosts,
            values,
            unselected,
            left_out,
            box_size,
            unit_metres,
            particle_types,
            ..
        }) => {
            line("particles", particles.to_string());
            let only = || particle_types.first().map(|only| format!("{only} (the only type)"));
            type_read(particle_types).or_else(only).into_iter().for_each(|read| line("type", read));
            if *not_finite > 0 {
                line("not finite", not_finite.to_string());
            }
            if *ghosts > 0 {
                line("left out", format!("{ghosts} ghosts (copies of particles in other pieces)"));
            }
            left_out.iter().for_each(|part| line("left out", part.clone()));
            bounds.iter().for_each(|bounds| line("box", corners(bounds)));
            if let Some(edges) = box_size {
                line(
                    "file's box",
                    format!(
                        "edges {edges:?}; if fluid that leaves through a face re-enters on the \
                         opposite side, use --periodic"
                    ),
                );
            }
            if let Some(metres) = unit_metres {
                line("unit", format!("{metres:?} m, from the file"));
            }
            if *unselected > 0 {
                let particles = counted(*unselected as u64, "particle");
                line("left out", format!("{particles}, because of --where"));
            }
            line("attributes", names(attributes));
            for ValueCounts { name, values } in values {
                let listed = values.iter().map(|(value, count)| format!("{value} ({count})"));
                line(name, listed.collect::<Vec<_>>().join(", "));
            }
            let source = spacing_source.as_deref().unwrap_or_default();
            let unknown = || {
                let why =
                    spacing_unknown.as_deref().map_or(String::new(), |why| format!(": {why}"));
                let suggested = nearest_neighbours
                    .map(|d| format!("; nearest neighbours suggest {}", significant(d, 3)));
                format!("unknown{why}{}", suggested.unwrap_or_default())
            };
            line(
                "spacing",
                spacing.map_or_else(unknown, |s| format!("{}, from {source}", shown(s))),
            );
            spacing_warnings.iter().for_each(|warning| line("", format!("warning: {warning}")));
            slab.iter().for_each(|slab| line("plane", slab.to_string()));
            if let Some(found) = walls.as_ref().filter(|found| !found.walls.is_open()) {
                line("domain", format!("{found}, with --domain auto"));
            }
            if let Some(bytes) = memory_bytes {
                line("memory", format!("about {:.2} by default", ByteSize(*bytes)));
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
            periodic,
            indicator,
            mu0,
            spacing,
            largest_size,
            ..
        }) => {
            line("particles", particles.to_string());
            match (spacing, largest_size) {
                (Some(smallest), Some(largest)) => {
                    line("sizes", format!("{} to {}", shown(*smallest), shown(*largest)));
                }
                (Some(spacing), None) => line("spacing", shown(*spacing)),
                (None, _) => {}
            }
            line("cells", cells.to_string());
            line("bricks", bricks.to_string());
            bounds.iter().for_each(|bounds| line("box", corners(bounds)));
            line("cell size", shown(*cell_size));
            line("origin", point(origin));
            line("domain", domain.as_ref().map_or("unbounded".into(), corners));
            periodic.iter().for_each(|faces| {
                let along = |(axis, faces): (_, &Option<[f64; 2]>)| {
                    faces.map(|[lo, hi]| format!("{axis} {lo} to {hi}"))
                };
                line(
                    "periodic",
                    ["x", "y", "z"]
                        .into_iter()
                        .zip(faces)
                        .filter_map(along)
                        .collect::<Vec<_>>()
                        .join(", "),
                );
            });
            line("indicator", indicator.to_string());
            mu0.iter().for_each(|mu0| line("mu0", shown(*mu0)));
            format!("{}: packed frame", file.display())
        }
        Info::Mesh(MeshInfo {
            file,
            vertices,
            triangles,
            bounds,
            components,
            normals,
            attributes,
            ..
        }) => {
            line("vertices", vertices.to_string());
            line("triangles", triangles.to_string());
            line("components", components.to_string());
            line("normals", if *normals { "yes" } else { "no" }.into());
            bounds.iter().for_each(|bounds| line("box", corners(bounds)));
            line("attributes", names(attributes));
            format!("{}: mesh", file.display())
        }
        Info::Volume(VolumeInfo { file, grids, .. }) => {
            for grid in grids {
                let GridInfo { name, active_voxels, voxel_size, bounds, .. } = grid;
                line(name, kind_of(grid));
                active_voxels.iter().for_each(|voxels| line("  voxels", voxels.to_string()));
                match voxel_size {
                    Some([x, y, z]) if x == y && y == z => line("  voxel size", shown(*x)),
                    Some(edges) => line("  voxel size", point(edges)),
                    None => {}
                }
                bounds.iter().for_each(|bounds| line("  box", corners(bounds)));
            }
            format!("{}: OpenVDB, {} grids", file.display(), grids.len())
        }
        Info::Geometry(GeometryInfo { file, format, primitives, bounds, attributes, .. }) => {
            let kinds = primitives.kinds.iter().map(|(kind, count)| counted(*count, kind));
            line("primitives", kinds.collect::<Vec<_>>().join(", "));
            line("points", primitives.points.to_string());
            bounds.iter().for_each(|bounds| line("box", corners(bounds)));
            line("attributes", names(attributes));
            line("particles", format!("none; {}", primitives.remedy()));
            format!("{}: {format}", file.display())
        }
    };
    format!("{title}\n{}", lines.join("\n"))
}

/// The class of a grid and the type of its values.
fn kind_of(grid: &GridInfo) -> String {
    let GridInfo { class, value_type, half, .. } = grid;
    let half = if *half { ", half precision" } else { "" };
    match &**class {
        "unknown" => format!("{value_type}{half}"),
        class => format!("{class}, {value_type}{half}"),
    }
}
