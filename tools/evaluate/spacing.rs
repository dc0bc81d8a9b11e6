//! Compares the estimated spacing with the true one, for particle files and for particles generated
//! at spacing 1.

use std::path::Path;
use std::time::Instant;

use glam::{DQuat, DVec3, EulerRot};
use meniscus::files::open_particles;
use meniscus::internals::field::spacing::evidence;
use meniscus::internals::reconstruction::{Cells, SamplingRequest, SpacingHints};
use meniscus::{Particles, Reconstruction, Settings, SpacingMistake, SpacingWarning};

use crate::scene::Random;
use crate::tables::{Table, figure};
use crate::{Options, Outcome};

/// Spacings that a user might give, divided by the true spacing.
const GIVEN: [f64; 13] = [0.1, 0.25, 0.4, 0.5, 0.7, 0.85, 1.0, 1.1, 1.2, 1.5, 2.0, 4.0, 10.0];

pub fn run(options: &Options) -> Outcome<()> {
    let mut estimates =
        Table::new(&["particles", "count", "by counting only", "estimate", "warnings"]);
    let mut given = Table::new(&[
        "given spacing / true spacing",
        "0.1",
        "0.25",
        "0.4",
        "0.5",
        "0.7",
        "0.85",
        "1",
        "1.1",
        "1.2",
        "1.5",
        "2",
        "4",
        "10",
    ]);
    let mut cost =
        Table::new(&["particles", "ms to estimate", "ms of a frame without estimating", "share"]);
    for file in &options.files {
        let (path, truth) = match file.rsplit_once('=') {
            Some((path, truth)) => (path, Some(truth.parse()?)),
            None => (file.as_str(), None),
        };
        let particles = open_particles(path, &Settings::default())
            .map_err(|fault| format!("{path}: {fault}"))?;
        let name = Path::new(path).file_name().unwrap_or_default().to_string_lossy().into_owned();
        let truth = truth.or_else(|| spacing_in_name(&name)).or(particles.spacing);
        let truth = truth.ok_or_else(|| format!("{path}: the true spacing is not known"))?;
        let mut positions = vec![[0.0; 3]; particles.particles.len()];
        particles.particles.positions(0, &mut positions);
        estimates.row(estimate(&name, &positions, truth));
        given.row(
            [name.clone()]
                .into_iter()
                .chain(GIVEN.map(|over| warnings_about(&positions, over * truth))),
        );
        cost.row(cost_of(&name, &positions)?);
    }
    for (name, particles) in generated_particles(options.quick) {
        estimates.row(estimate(&name, &particles, 1.0));
    }
    estimates.print("Estimated spacing divided by the true spacing, and the warnings");
    if !options.files.is_empty() {
        given.show("Warnings about a given spacing");
        cost.show("Time of the estimate, with all processors");
    }
    Ok(())
}

/// The spacing that follows `Dp` in the name of a DualSPHysics table.
fn spacing_in_name(name: &str) -> Option<f64> {
    let rest = &name[name.find("Dp")? + 2..];
    let end = rest.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(rest.len());
    rest[..end].parse().ok()
}

fn estimate(name: &str, particles: &[[f64; 3]], truth: f64) -> [String; 5] {
    let counted =
        evidence(&particles).and_then(|evidence| evidence.counted).map(|counted| counted.mean);
    let over =
        |spacing: Option<f64>| spacing.map_or("none".into(), |spacing| figure(spacing / truth));
    let request = SamplingRequest::default();
    let (estimate, warnings) = match request.cells(&particles, SpacingHints::default()) {
        Ok(cells) => (cells.spacing(), describe_warnings(&cells)),
        Err(error) => (None, error.to_string()),
    };
    [name.to_owned(), particles.len().to_string(), over(counted), over(estimate), warnings]
}

fn describe_warnings(cells: &Cells) -> String {
    let slab = cells.slab.map(|_| "a plane".to_owned());
    let warnings = cells.warnings.iter().map(|warning| match warning {
        SpacingWarning::Contradicted { given, found, mistake, .. } => {
            let how = if given < found { "small" } else { "large" };
            let why = match mistake {
                Some(SpacingMistake::Radius) => ", radius?",
                Some(SpacingMistake::Double) => ", twice?",
                Some(SpacingMistake::Unit(_)) => ", unit?",
                _ => "",
            };
            format!("{how}{why}")
        }
        SpacingWarning::Thin { used, counted: Some(counted), .. } => {
            format!("thin: {} by neighbours, {} by density", figure(*used), figure(*counted))
        }
        SpacingWarning::Thin { used, nearest, .. } => {
            format!("thin: {} by neighbours, the nearest {}", figure(*used), figure(*nearest))
        }
        SpacingWarning::Random { .. } => "random, may be spray".into(),
        SpacingWarning::TwoResolutions { spacings: [one, other], .. } => {
            format!("two resolutions, {} and {}", figure(*one), figure(*other))
        }
        warning => warning.to_string(),
    });
    slab.into_iter().chain(warnings).collect::<Vec<_>>().join("; ")
}

fn warnings_about(particles: &[[f64; 3]], spacing: f64) -> String {
    let request = SamplingRequest { spacing: Some(spacing), ..SamplingRequest::default() };
    request
        .cells(&particles, SpacingHints::default())
        .map_or_else(|error| error.to_string(), |cells| describe_warnings(&cells))
}

/// A table row with the time of the estimate, the time of a whole frame with a known spacing, and
/// their ratio. Each time is the median of seven runs.
fn cost_of(name: &str, particles: &[[f64; 3]]) -> Outcome<[String; 4]> {
    let median = |mut run: Box<dyn FnMut() -> Outcome<()> + '_>| -> Outcome<f64> {
        let mut took = Vec::new();
        for _ in 0..7 {
            let begun = Instant::now();
            run()?;
            took.push(1e3 * begun.elapsed().as_secs_f64());
        }
        took.sort_by(f64::total_cmp);
        Ok(took[3])
    };
    let spacing = SamplingRequest::default()
        .cells(&particles, SpacingHints::default())
        .ok()
        .and_then(|cells| cells.spacing());
    let Some(spacing) = spacing else {
        return Ok([name.to_owned(), "-".into(), "-".into(), "-".into()]);
    };
    let estimating = median(Box::new(|| {
        std::hint::black_box(evidence(&particles));
        Ok(())
    }))?;
    let folder = tempfile::tempdir()?;
    let mesh = folder.path().join("mesh.ply");
    let frame = median(Box::new(|| {
        let surface = Reconstruction::new().spacing(spacing).run(particles)?;
        std::fs::remove_file(&mesh).ok();
        surface.write(&mesh)?;
        Ok(())
    }))?;
    let share = format!("{:.1} %", 100.0 * estimating / frame);
    Ok([name.to_owned(), figure(estimating), figure(frame), share])
}

/// A box of particles, each displaced by up to `jitter` along each axis.
fn layers([x, y, z]: [usize; 3], jitter: f64, random: &mut Random) -> Vec<[f64; 3]> {
    let place = |i: usize| [i % x, i / x % y, i / (x * y)];
    let mut off = |c: usize| c as f64 + jitter * (2.0 * random.unit() - 1.0);
    (0..x * y * z).map(|i| place(i).map(&mut off)).collect()
}

/// Rotates particles by random angles about all axes.
fn rotated(particles: Vec<[f64; 3]>, random: &mut Random) -> Vec<[f64; 3]> {
    let [a, b, c] = [(); 3].map(|()| 6.0 * random.unit());
    let turn = DQuat::from_euler(EulerRot::XYZ, a, b, c);
    particles.into_iter().map(|p| (turn * DVec3::from(p)).into()).collect()
}

/// Particles in bars with gaps between them, or in sheets if the width equals the length.
fn bars(size: [usize; 3], gap: usize, jitter: f64, random: &mut Random) -> Vec<[f64; 3]> {
    let rows = if size[0] == size[1] { 1 } else { 6 };
    let mut all = Vec::new();
    for i in 0..6 * rows {
        let at = [(i / 6 * (size[1] + gap)) as f64, (i % 6 * (size[2] + gap)) as f64];
        let bar = layers(size, jitter, random);
        all.extend(bar.into_iter().map(|[x, y, z]| [x, y + at[0], z + at[1]]));
    }
    rotated(all, random)
}

fn generated_particles(quick: bool) -> Vec<(String, Vec<[f64; 3]>)> {
    let random = &mut Random::new(7);
    let mut all = Vec::new();
    for width in 1..=5 {
        for gap in (1..=5).filter(|gap| !quick || *gap == 3) {
            for jitter in [0.1, 0.3] {
                let bar = bars([40, width, width], gap, jitter, random);
                all.push((format!("bars {width} wide, gaps of {gap}, jitter {jitter}"), bar));
                let sheet = bars([40, 40, width], gap, jitter, random);
                all.push((format!("sheets {width} thick, gaps of {gap}, jitter {jitter}"), sheet));
            }
        }
    }
    let sides: &[usize] = if quick { &[5, 10, 22] } else { &[5, 10, 22, 46, 100, 215] };
    for &side in sides {
        for jitter in [0.0, 0.1, 0.2, 0.3, 0.4, 0.5].into_iter().filter(|j| side < 200 || *j == 0.3)
        {
            all.push((
                format!("lattice of {side}^3, jitter {jitter}"),
                layers([side; 3], jitter, random),
            ));
        }
    }
    for stretch in [1.2, 1.4, 1.6, 2.0] {
        for jitter in [0.0, 0.1, 0.3] {
            let mut lattice = layers([40; 3], jitter, random);
            lattice.iter_mut().for_each(|p| *p = [p[0] * stretch, p[1], p[2] / stretch]);
            let name = format!("lattice of 40^3, stretched {stretch} times, jitter {jitter}");
            all.push((name, rotated(lattice, random)));
        }
    }
    for side in [10_i32, 30, 60].into_iter().filter(|side| !quick || *side < 60) {
        let length = f64::from(side);
        let mut within = |length: f64| [(); 3].map(|()| length * random.unit());
        let uniform = (0..side.pow(3)).map(|_| within(length)).collect();
        all.push((format!("{side}^3 at random"), uniform));
        let cell = |i: i32| {
            [i / 8 % (side / 2), i / 8 / (side / 2) % (side / 2), i / 8 / (side / 2).pow(2)]
        };
        let seeded = (0..side.pow(3)).map(|i| {
            let at = within(2.0);
            [0, 1, 2].map(|axis| 2.0 * f64::from(cell(i)[axis]) + at[axis])
        });
        all.push((format!("{side}^3, eight at random in each cell of 2^3"), seeded.collect()));
    }
    let block = layers([30; 3], 0.3, random);
    let mut spray = |count: usize, length: f64| -> Vec<[f64; 3]> {
        (0..count).map(|_| [(); 3].map(|()| length * random.unit())).collect()
    };
    let (alone, few, many) = (spray(20_000, 271.0), spray(27_000, 300.0), spray(135_000, 500.0));
    all.push(("spray, 10 apart on average".into(), alone));
    all.push(("a block of 30^3 and as many in spray".into(), [block.clone(), few].concat()));
    all.push(("a block of 30^3 and five times as many in spray".into(), [block, many].concat()));
    all
}
