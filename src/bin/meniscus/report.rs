//! What a run says of a frame, for people.

use std::fmt::Write;
use std::path::Path;

use bytesize::ByteSize;
use meniscus::backend::Backend;
use meniscus::brick::{Census, FrameFacts};
use meniscus::error::Error;
use meniscus::field::calibration::{Calibrated, ON_CORNERS, Plateau};
use meniscus::field::indicator::IndicatorKind;
use meniscus::frame::{FieldRequest, Frame};
use meniscus::grid::units::{FULL, Isovalue, shown};
use meniscus::io::output::MeshFormat;
use meniscus::io::{CoordinateWidth, WriteError, stl};
use meniscus::reconstruction::SinglePrecision;
use meniscus::surface::mesh::source::MeshSource;
use meniscus::surface::simplify::{Dropped, Reduction, Simplified};
use meniscus::surface::stitch::Stitched;
use meniscus::system::timings::Timings;
use meniscus::vulkan::{Counters, Timing};

use crate::method::MethodName;
use crate::options::{IsoOption, Options};
use crate::run::Notes;

/// Particles that are so many times too dense for their spacing are half as far apart.
const CROWDED: f64 = 8.0;

/// What went wrong with a frame and was made good, or left out: with its backend, its spacing and its attributes.
pub fn warnings(frame: &Frame) -> Vec<String> {
    let FrameFacts { census: Census { binned, .. }, spacing, .. } = *frame.facts();
    let crowded = frame.crowding().filter(|&crowding| crowding > CROWDED).map(|crowding| {
        format!(
            "there are {crowding:.1} times as many particles as {} apart have room: is their --spacing right?",
            shown(spacing.unwrap_or_default())
        )
    });
    let lacking = frame.lacking_attributes().map(|(name, without)| {
        format!(
            "{without} of {binned} particles have no {name} that is a finite number of 32 bits: the others alone tell that of \
             the vertices"
        )
    });
    frame.warnings().into_iter().chain(crowded).chain(lacking).collect()
}

/// What a format makes of vertices that f32 does not tell apart.
pub fn merged(mesh: &dyn MeshSource, format: MeshFormat, path: &Path) -> Result<Option<String>, Error> {
    if format != MeshFormat::Stl {
        return Ok(None);
    }
    let merged = stl::merged_vertices(mesh).map_err(|fault| WriteError::new(path, fault))?;
    Ok((merged > 0).then(|| {
        format!(
            "{merged} vertices have the place of another in f32, and {format} has nothing else to tell them by; .ply keeps them"
        )
    }))
}

/// Particles and drops that surfaces leave out.
#[derive(Debug, Default, Clone, Copy)]
pub struct LeftOut {
    pub census: Census,
    /// Particles in no surface, at the least.
    pub lost: u64,
    pub drops: u64,
}

/// So many particles in no surface are not worth a word.
const FEW: u64 = 10;

impl LeftOut {
    pub fn add(&mut self, other: &Self) {
        self.census.binned += other.census.binned;
        self.census.not_finite += other.census.not_finite;
        self.census.too_far += other.census.too_far;
        self.census.outside += other.census.outside;
        self.lost += other.lost;
        self.drops += other.drops;
    }

    /// Says how many particles are left out, and why, of a field.
    pub fn say(&self, field: FieldRequest, notes: &Notes) {
        let Census { binned, not_finite, too_far, outside } = self.census;
        for (count, what) in [
            (not_finite, "dropped: a coordinate is not finite"),
            (too_far, "dropped: beyond the addressable grid"),
            (outside, "not counted: outside of the domain"),
        ] {
            if count > 0 {
                notes.say(format!("{count} particles {what}"));
            }
        }
        if self.lost > FEW {
            let advice = match field.indicator().map(|asked| asked.kind) {
                Some(IndicatorKind::Counting | IndicatorKind::Symmetry) => "--indicator cloud keeps drops",
                Some(IndicatorKind::Cloud) | None => "smaller cells keep more",
            };
            let lost = self.lost;
            notes.say(format!("warning: at least {lost} of {binned} particles are in no surface; {advice}"));
        }
    }
}

impl From<Census> for LeftOut {
    fn from(census: Census) -> Self {
        Self { census, ..Self::default() }
    }
}

/// Warns of a lattice on the corners of cells.
pub fn report_lattice(frame: &Frame, notes: &Notes) {
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
pub fn dropped(drops: u64, particles: u32) -> String {
    format!("{drops} drops of fewer than {particles} particles left out")
}

/// The options that left out all components of a surface.
pub fn limits(dropped: Dropped) -> &'static str {
    match (dropped.components, dropped.drops) {
        (_, 0) => "--drop-smaller",
        (0, _) => "--smallest-drop",
        _ => "--drop-smaller and --smallest-drop",
    }
}

/// Says what simplifying left out and how far it went.
pub fn report_simplified(simplified: &Simplified, reduction: &Reduction, notes: &Notes) {
    if let Some(volume) = reduction.least_volume_cells {
        notes.say(format!(
            "{} components of less than {volume} cells left out",
            simplified.dropped().components
        ));
    }
    if let Some(particles) = reduction.smallest_drop {
        notes.say(dropped(simplified.dropped().drops, particles));
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

/// Says what a device was asked to do for so many frames, and how long it took for each stage.
pub fn report_device(backend: &dyn Backend, frames: usize, notes: &Notes) {
    let Some(device) = backend.device() else { return };
    let Counters { submissions, allocations, sent, received } = device.take_counters();
    let each = |count: u64| count as f64 / frames.max(1) as f64;
    notes.detail(format!(
        "{}, a frame: {:.1} submissions, {:.1} buffers made, {} sent, {} received",
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

/// Says what every stage took.
pub fn report_laps(timings: &Timings, notes: &Notes) {
    for (stage, seconds) in timings.seconds() {
        notes.detail(format!("  {stage:<10} {:>9.1} ms", seconds * 1e3));
    }
}

/// f64 where f32 is too coarse for the surface and the format can hold it.
pub fn coordinate_width(
    surface: &Stitched,
    format: MeshFormat,
    notes: &Notes,
) -> Result<CoordinateWidth, Error> {
    match SinglePrecision::of(surface) {
        SinglePrecision::Enough => Ok(CoordinateWidth::F32),
        SinglePrecision::TooCoarse | SinglePrecision::Exceeded if format.holds_f64() => {
            notes.detail("coordinates are written as f64: f32 is too coarse for them");
            Ok(CoordinateWidth::F64)
        }
        SinglePrecision::TooCoarse => {
            notes.say(format!(
                "warning: {format} holds coordinates as f32, too coarse for these; .ply holds f64"
            ));
            Ok(CoordinateWidth::F32)
        }
        SinglePrecision::Exceeded => {
            Err(Error::Request(format!("{format} holds coordinates as f32, which these exceed; use .ply")))
        }
    }
}
