//! What a run says of a frame, for people.

use std::fmt::Write;

use meniscus::brick::Census;
use meniscus::calibration::{Calibrated, ON_CORNERS, Plateau};
use meniscus::frame::Frame;
use meniscus::laps::Laps;
use meniscus::mesh::source::MeshSource;
use meniscus::simplify::{Reduction, Simplified};
use meniscus::stage::indicator::IndicatorKind;
use meniscus::units::{FULL, Isovalue};

use crate::method::MethodName;
use crate::reconstruct::{IsoOption, Options};
use crate::run::Notes;

/// Says what went wrong with the backend and was made good.
pub fn report_warnings(frame: &Frame, notes: &Notes) {
    frame.warnings().iter().for_each(|warning| notes.say(format!("warning: {warning}")));
}

/// Says what became of the particles, and warns of a lattice on the corners of cells.
pub fn report_frame(frame: &Frame, notes: &Notes) {
    let Census { not_finite, too_far, outside, .. } = frame.facts().census;
    for (count, what) in [
        (not_finite, "dropped: a coordinate is not finite"),
        (too_far, "dropped: beyond the addressable grid"),
        (outside, "not counted: outside of the domain"),
    ] {
        if count > 0 {
            notes.say(format!("{count} particles {what}"));
        }
    }
    let symmetric = frame.dif().filter(|sampled| sampled.indicator.kind() == IndicatorKind::Symmetry);
    let Some(sampled) = symmetric else { return };
    let mean = sampled.dif.mean_of_full();
    if mean < ON_CORNERS {
        let grid = frame.facts().grid;
        let shifted = (grid.origin() + grid.cell_size() / 2.0).to_array().map(|x| x.to_string()).join(",");
        notes.say(format!(
            "warning: the particles lie on the corners of cells (mean indicator {mean:.4}), which harms the \
             surface; --origin {shifted} moves the grid off them"
        ));
    }
}

/// What is said of drops of few particles.
pub fn left_out(drops: u64, particles: u32) -> String {
    format!("{drops} drops of fewer than {particles} particles left out")
}

pub fn report_simplified(simplified: &Simplified, reduction: &Reduction, notes: &Notes) {
    if let Some(volume) = reduction.least_volume_cells {
        notes.say(format!(
            "{} components of less than {volume} cells left out",
            simplified.dropped().components
        ));
    }
    if let Some(particles) = reduction.smallest_drop {
        notes.say(left_out(simplified.dropped().drops, particles));
    }
    if let Some(tolerance) = reduction.tolerance {
        let (left, whole) = (simplified.triangle_count(), simplified.whole().triangle_count());
        let share = 100.0 * left as f64 / whole as f64;
        notes
            .say(format!("simplified within {} cells: {share:.1} % of {whole} triangles", tolerance.cells()));
    }
}

/// Says where the surface is drawn, and how finely the field tells it.
pub fn report_calibration(frame: &Frame, measured: &Calibrated, given: Option<Isovalue>, notes: &Notes) {
    let &Calibrated { calibration, plateau, step_cells } = measured;
    notes.detail(format!("a step of the field moves the surface by {step_cells:.4} cells"));
    let fraction = |theta: u16| f64::from(theta) / f64::from(FULL);
    let Some(iso) = calibration.iso().map(Isovalue::value) else {
        let density = measured.density(frame.facts().spacing_cells_or_one());
        notes.say(match plateau {
            Plateau::Interior { .. } => {
                format!("{density:.4} particles in a cubed spacing deep in the fluid")
            }
            Plateau::Shallow { .. } => {
                let spacing = match frame.facts().spacing {
                    Some(_) => "spacing",
                    None => "spacing of one cell, for none is known",
                };
                format!("a particle in each cubed {spacing}, as no fluid is deep enough to tell")
            }
        });
        return;
    };
    let share = f64::from(Isovalue::PLATEAU_PERCENT) / 100.0;
    match (plateau, given) {
        (Plateau::Interior { lowest, .. }, Some(given)) if given.threshold() >= lowest => notes.say(format!(
            "warning: isovalue {iso:.4} is above the field's lowest interior value, {:.4}: expect bubbles inside",
            fraction(lowest)
        )),
        (_, Some(_)) => {}
        (Plateau::Interior { median, .. }, None) => {
            notes.say(format!("isovalue {iso:.4}, {share} of the interior plateau {:.4}", fraction(median)));
        }
        (Plateau::Shallow { expected }, None) => notes.say(format!(
            "isovalue {iso:.4}, {share} of the plateau {:.4} that {} tells: next to no fluid so dense is deeper than the \
             filters reach",
            fraction(expected),
            if frame.facts().spacing.is_some() { "the spacing" } else { "a spacing of one cell, for none is known," }
        )),
    }
}

/// Advises on a surface, of clouds or not, that holds less than its particles. `frame` is the one whose isovalue or plateau it has, if
/// that is another.
pub fn advice(options: &Options, is_cloud: bool, frame: Option<u64>) -> String {
    let mut advice = String::new();
    if let Some(frame) = frame {
        let _ = write!(
            advice,
            "; {} was measured on frame {frame}",
            if is_cloud { "its plateau" } else { "its isovalue" }
        );
    }
    if matches!(options.iso, IsoOption::Value(_)) {
        advice += "; a lower --iso, or --iso auto, shows more";
    } else if options.method == MethodName::Dif && !is_cloud {
        advice += "; --indicator cloud keeps drops and sheets that smoothing loses";
    }
    advice + "; is their --spacing right?"
}

/// Says what every stage took.
pub fn report_laps(laps: &Laps, notes: &Notes) {
    for (stage, seconds) in laps.seconds() {
        notes.detail(format!("  {stage:<10} {:>9.1} ms", seconds * 1e3));
    }
}
