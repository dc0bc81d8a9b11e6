//! Tips for users who type an option of another program. Each tip names the option of this program
//! with the same effect.

use clap::Command;
use clap::error::{ContextKind, ContextValue, Error, ErrorKind};

/// Options of other programs, the option of this program with the same effect, and a short
/// explanation.
const FOREIGN: &[(&[&str], &str, &str)] = &[
    (&["-r", "--particle-radius"], "radius", "is the same length"),
    (
        &["--particle-spacing", "--particle-separation", "--particle-diameter", "--dp"],
        "spacing",
        "is the distance between neighbouring particles",
    ),
    (
        &["-l", "--smoothing-length", "--smoothing-radius", "--kernel-radius"],
        "smooth",
        "sets the smoothing width in spacings (a spacing is two particle radii)",
    ),
    (
        &["--mesh-smoothing-iters", "--mesh-smoothing-weights", "--smoothing-iterations"],
        "smooth",
        "sets the smoothing width in spacings",
    ),
    (
        &["-c", "--cube-size"],
        "cell-size",
        "is a length; if the cube size is in particle radii, use half the number with --cell",
    ),
    (
        &["--voxel-size", "--grid-size", "--resolution"],
        "cell-size",
        "sets the edge length of a cell",
    ),
    (
        &["-t", "--surface-threshold", "--threshold", "--isovalue", "--iso-value", "--iso-level"],
        "iso",
        "sets the isovalue, for the indicators counting and symmetry and for kernel methods",
    ),
    (
        &["--mesh-cleanup", "--decimate", "--decimation"],
        "simplify",
        "reduces the number of triangles",
    ),
    (&["-a", "--interpolate-attribute"], "attributes", "takes names separated by commas"),
    (
        &["--sph-normals", "--normals-smoothing-iters"],
        "normals",
        "computes vertex normals from the field",
    ),
    (
        &["--particle-aabb-min", "--particle-aabb-max", "--domain-min", "--domain-max", "--aabb"],
        "domain",
        "takes both corners: X0,Y0,Z0,X1,Y1,Z1",
    ),
    (&["--output-file", "--output-dir", "--out"], "output", "names a mesh, or a folder of meshes"),
    (&["-s", "--start-index", "--start-frame"], "start", "sets the first frame"),
    (&["-e", "--end-index", "--end-frame"], "end", "sets the last frame"),
    (&["-n", "-j", "--num-threads", "--jobs"], "threads", "sets the number of threads"),
];

/// Options that name the input in other programs. In meniscus, inputs need no option.
const INPUT: &[&str] = &["-i", "--input", "--input-file", "--input-dir"];

/// Adds a tip to an error about an option of another program.
pub fn with_tip(mut error: Error, command: &mut Command, subcommand: Option<&str>) -> Error {
    let Some(command) = subcommand.and_then(|name| command.find_subcommand_mut(name)) else {
        return error;
    };
    let named = match (error.kind(), error.get(ContextKind::InvalidArg)) {
        (ErrorKind::UnknownArgument, Some(ContextValue::String(named))) => named.clone(),
        _ => return error,
    };
    let is_option = |long: &str| command.get_arguments().any(|arg| arg.get_long() == Some(long));
    let equivalent =
        FOREIGN.iter().find(|(names, option, _)| names.contains(&&*named) && is_option(option));
    let tip = match equivalent {
        Some((_, option, what)) => format!("use '--{option}', which {what}"),
        None if INPUT.contains(&&*named) => "inputs need no option; give only their paths".into(),
        None => return error,
    };
    error.remove(ContextKind::SuggestedArg);
    error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    error.insert(ContextKind::Usage, ContextValue::StyledStr(command.render_usage()));
    error
}
