//! Prints the report of a frame.

use std::path::PathBuf;

use bytesize::ByteSize;
use meniscus::devices::{Counters, Device, Timing};
use meniscus::error::{shown, significant};
use meniscus::files::UnreadPart;
use meniscus::mesh::MeshSource;
use meniscus::{
    Cells, Census, IndicatorKind, Isovalue, MeasuredCalibration, OpenedFrame, Plateau, Report,
    SpacingSource, SpacingWarning, Timings, Warning,
};

use super::advice::{spacing_message, warning_message};
use super::notes::Notes;
use super::options::ReconstructOptions;

/// A count with its noun, such as "1 drop" or "2 drops". The plural of `noun` must end in s.
pub fn counted(number: u64, noun: &str) -> String {
    format!("{number} {noun}{}", if number == 1 { "" } else { "s" })
}

/// The maximum number of unread particle types that a message names.
const MOST_UNREAD_TYPES: usize = 12;

/// Names the particle type that was read from a file, which is the first of `types`, and the types
/// that were not read. Returns `None` if the file has fewer than two types.
pub fn type_read(types: &[String]) -> Option<String> {
    match types {
        [] | [_] => None,
        [read, others @ ..] => {
            let (shown, more) = others.split_at(others.len().min(MOST_UNREAD_TYPES));
            let more = if more.is_empty() { String::new() } else { format!(" and {}", more.len()) };
            Some(format!("{read} (not read: {}{more})", shown.join(", ")))
        }
    }
}

/// The number of particles in a file, its format, and the type that was read.
pub fn contents(particles: usize, format: &str, types: &[String]) -> String {
    let read = type_read(types).map_or(String::new(), |read| format!(", type {read}"));
    format!("{}, {format}{read}", counted(particles as u64, "particle"))
}

/// Prints the number of particles in the opened inputs, which particles and parts were left out,
/// and the chosen cells.
pub fn report_opened(inputs: &[PathBuf], opened: &OpenedFrame, notes: &Notes) {
    let names: Vec<_> = inputs.iter().map(|input| input.display().to_string()).collect();
    let contents = contents(opened.particles(), opened.format(), opened.particle_types());
    notes.say(format!("{}: {contents}", names.join(" and ")));
    if opened.ghosts() > 0 {
        notes.say(format!(
            "{} left out, because they are copies of particles in other pieces",
            counted(opened.ghosts() as u64, "ghost particle")
        ));
    }
    if opened.unselected() > 0 {
        let all = opened.particles() + opened.unselected();
        notes.say(format!("{} of {all} particles left out by --where", opened.unselected()));
    }
    report_left_out(opened.left_out(), notes);
    if let Some(cells) = opened.cells() {
        report_cells(cells, opened.indicator(), opened.moved_to(), notes);
    }
    match opened.walls() {
        Some((found, true)) => notes.say(found.to_string()),
        Some((_, false)) => {
            notes.say("the particles end at planes, which may be walls: try --domain auto");
        }
        None => {}
    }
    for gap in opened.gaps_at_walls() {
        notes.warn(&warning_message(&Warning::BeforeWall(*gap), None));
    }
}

/// Prints the unexpected parts of the input that were not read.
pub fn report_left_out(parts: &[UnreadPart], notes: &Notes) {
    let unexpected = parts.iter().filter(|part| part.is_unexpected());
    let warnings = unexpected.cloned().map(Warning::LeftOut);
    warnings.for_each(|warning| notes.warn(&warning_message(&warning, None)));
}

/// Prints the cell size, the indicator, and the new origin if the grid was moved.
pub fn report_cells(
    cells: &Cells,
    indicator: Option<IndicatorKind>,
    moved_to: Option<[f64; 3]>,
    notes: &Notes,
) {
    let indicator = indicator.map_or(String::new(), |kind| format!(", indicator {}", kind.name()));
    notes.say(format!("{cells}{indicator}"));
    cells.slab.iter().for_each(|slab| notes.say(slab.to_string()));
    cells.warnings.iter().for_each(|warning| notes.warn(&spacing_message(warning)));
    if let Some(corner) = moved_to {
        let corner = corner.map(shown).join(",");
        notes.say(format!(
            "all particles are on a lattice, so the grid's origin was moved to {corner}"
        ));
    }
}

/// Prints the warnings, the calibration and the removed components of a surface.
pub fn report(options: &ReconstructOptions, report: &Report, mesh: &dyn MeshSource, notes: &Notes) {
    warn_all(&report.warnings, Some(options), notes);
    report
        .measured
        .iter()
        .for_each(|measured| report_calibration(report, measured, options, notes));
    report_census(&report.facts.census, notes);
    let Some(left_out) = report.too_small else { return };
    if let Some(volume) = options.settings.smallest_component {
        notes.say(format!(
            "{} smaller than {volume} cells left out",
            counted(left_out.components, "component")
        ));
    }
    if let Some(particles) = options.settings.smallest_drop.filter(|&particles| particles > 1) {
        notes.say(too_small(left_out.drops, particles));
    }
    if let Some(tolerance) = options.settings.simplify {
        let whole = report.whole_triangles;
        let share = 100.0 * mesh.triangle_count() as f64 / whole as f64;
        notes.say(format!(
            "simplified with a tolerance of {tolerance} cells: {share:.1} % of {whole} triangles \
             remain"
        ));
    }
}

/// Prints the isovalue or the density of the particles, and how far the smallest step of the field
/// moves the surface.
fn report_calibration(
    report: &Report,
    measured: &MeasuredCalibration,
    options: &ReconstructOptions,
    notes: &Notes,
) {
    let &MeasuredCalibration { calibration, plateau, step_cells } = measured;
    let facts = &report.facts;
    notes.detail(format!(
        "field values are rounded to steps; one step moves the surface by {} cells",
        significant(step_cells, 3)
    ));
    let Some(iso) = calibration.iso().map(Isovalue::value) else {
        let density = measured.density(facts.spacing_cells_or_one());
        notes.say(match plateau {
            Plateau::Interior { .. } => {
                format!("measured density: {density:.3} particles per cubed spacing")
            }
            Plateau::Shallow { .. } => {
                let spacing = match facts.spacing {
                    Some(_) => "cubed spacing",
                    None => "cell (the spacing is unknown)",
                };
                format!(
                    "density: assumed to be one particle per {spacing}, because the fluid is too \
                     shallow to measure its density"
                )
            }
        });
        return;
    };
    let share = f64::from(Isovalue::PLATEAU_PERCENT) / 100.0;
    let [iso, fluid] = [iso, plateau.fraction()].map(|value| significant(value, 4));
    match plateau {
        _ if options.settings.isovalue().is_some() => {}
        Plateau::Interior { .. } => {
            notes.say(format!(
                "isovalue {iso}: {share} times {fluid}, the value of the field deep in the fluid"
            ));
        }
        Plateau::Shallow { .. } => notes.say(format!(
            "isovalue {iso}: {share} times {fluid}, which is computed from {} because the fluid is \
             too shallow to measure the field",
            match facts.spacing {
                Some(_) => "the spacing",
                None => "a spacing of one cell (the spacing is unknown)",
            }
        )),
    }
}

/// Prints how many particles were left out, for each reason, and how many were wrapped.
pub fn report_census(census: &Census, notes: &Notes) {
    for (count, what) in [
        (census.not_finite, "skipped: a coordinate is not finite"),
        (census.too_far, "skipped: too far from the origin of the grid"),
        (census.outside, "left out: outside the domain or the periodic box"),
        (census.wrapped, "slightly outside the periodic box: wrapped into it"),
    ] {
        if count > 0 {
            notes.say(format!("{} {what}", counted(count as u64, "particle")));
        }
    }
}

/// Returns the message about drops that were left out.
pub fn too_small(drops: u64, particles: u32) -> String {
    format!("{} of fewer than {particles} particles left out", counted(drops, "drop"))
}

/// Prints a device's submissions, new buffers and transferred bytes, and its time for each stage.
/// All numbers are averages per frame.
pub fn report_device(device: Option<&Device>, frames: usize, notes: &Notes) {
    let Some(device) = device else { return };
    let Counters { submissions, allocations, sent, received } = device.take_counters();
    let each = |count: u64| count as f64 / frames.max(1) as f64;
    notes.detail(format!(
        "{}, per frame: {:.1} submissions, {:.1} new buffers, {} sent, {} received",
        device.name(),
        each(submissions),
        each(allocations),
        ByteSize(each(sent) as u64),
        ByteSize(each(received) as u64),
    ));
    for Timing { stage, seconds, .. } in device.take_timings() {
        notes.detail(format!("  {stage:<20} {:>9.1} ms", seconds * 1e3 / frames.max(1) as f64));
    }
}

/// Prints the time of every stage.
pub fn report_stages(timings: &Timings, notes: &Notes) {
    for (stage, seconds) in timings.seconds() {
        notes.detail(format!("  {stage:<10} {:>9.1} ms", seconds * 1e3));
    }
}

/// Prints the warnings about a surface, with advice. Skips warnings about the spacing and about
/// unread parts of the input, because the program printed these warnings when it opened the input
/// or planned the parts. The exception is the warning that particles contradict the spacing of a
/// packed frame, which is printed here.
pub fn warn_all(warnings: &[Warning], options: Option<&ReconstructOptions>, notes: &Notes) {
    let was_printed = |warning: &&Warning| match warning {
        Warning::Spacing(SpacingWarning::Contradicted { source, .. }) => {
            *source != SpacingSource::Packed
        }
        warning => matches!(warning, Warning::Spacing(_) | Warning::LeftOut(_)),
    };
    let others = warnings.iter().filter(|warning| !was_printed(warning));
    others.for_each(|warning| notes.warn(&warning_message(warning, options)));
}
