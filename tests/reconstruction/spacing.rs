//! Tests of the spacing from every source: an estimate, a setting, a file, a scene, a state or a
//! packed frame.
//!
//! If the particles contradict the spacing, the library must warn. Other tests use particles that
//! lie in a plane, at one position, or far from the origin.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use glam::DVec3;
use meniscus::error::{Error, NoEstimate};
use meniscus::internals::field::spacing::evidence;
use meniscus::internals::io::output::read_mesh;
use meniscus::mesh::{check, measure};
use meniscus::{
    Cells, Event, LiveSimulation, Reconstruction, Simulation, SpacingMistake, SpacingSource,
    SpacingWarning, Summary, Surface,
};
use meniscus::{Slab, Warning};
use tempfile::TempDir;

use crate::common::files::{bytes_of, raw};
use crate::common::fill;
use crate::common::program::{command, run};

const SPACING: f64 = 0.05;

/// A ball of about 3000 particles.
fn ball() -> Vec<[f64; 3]> {
    let unit = fill(12.0, 1.0, 0.25, 3, |p| p.length() < 9.0);
    unit.into_iter().map(|p| p.map(|c| SPACING * c)).collect()
}

fn moved(particles: &[[f64; 3]], by: [f64; 3]) -> Vec<[f64; 3]> {
    particles.iter().map(|&p| (DVec3::from(p) + DVec3::from(by)).into()).collect()
}

/// A sheet of particles in the plane y = `at`, with edges of 30 and 24 spacings.
fn plane(at: f64) -> Vec<[f64; 3]> {
    let sheet = fill(15.0, 1.0, 0.2, 5, |p| p.y > 0.0 && p.y < 1.0 && p.z.abs() < 12.0);
    sheet.into_iter().map(|[x, _, z]| [SPACING * x, at, SPACING * z]).collect()
}

fn csv(particles: &[[f64; 3]]) -> String {
    particles.iter().fold("x,y,z\n".to_owned(), |mut text, [x, y, z]| {
        writeln!(text, "{x:?},{y:?},{z:?}").unwrap();
        text
    })
}

fn cells(surface: &Surface) -> &Cells {
    surface.report().cells.as_ref().unwrap()
}

fn contradiction(warnings: &[SpacingWarning]) -> Option<(f64, Option<SpacingMistake>)> {
    warnings.iter().find_map(|warning| match warning {
        SpacingWarning::Contradicted { found, mistake, .. } => Some((*found, *mistake)),
        _ => None,
    })
}

fn volume(surface: &Surface) -> f64 {
    let mesh = surface.to_mesh().unwrap();
    assert!(check(&mesh).is_closed_oriented_manifold());
    measure(&mesh).volume.unwrap()
}

#[test]
fn a_wrong_spacing_causes_a_warning_that_names_the_likely_mistake() {
    let ball = ball();
    for plausible in [0.85, 0.9, 1.0, 1.1, 1.2] {
        let surface = Reconstruction::new().spacing(plausible * SPACING).run(&ball).unwrap();
        assert_eq!(cells(&surface).warnings, [], "{plausible}");
    }
    for (wrong, mistake) in [
        (0.1, Some(SpacingMistake::Unit(0.1))),
        (0.25, None),
        (0.4, None),
        (0.5, Some(SpacingMistake::Radius)),
        (0.7, None),
        (1.5, None),
        (2.0, Some(SpacingMistake::Double)),
        (4.0, None),
        (10.0, Some(SpacingMistake::Unit(10.0))),
    ] {
        let surface = Reconstruction::new().spacing(wrong * SPACING).run(&ball).unwrap();
        let (found, named) =
            contradiction(&cells(&surface).warnings).unwrap_or_else(|| panic!("{wrong}"));
        assert!((found / SPACING - 1.0).abs() < 0.05, "{wrong}: {found}");
        assert_eq!(named, mistake, "{wrong}");
        let warned = |warning: &Warning| {
            matches!(warning, Warning::Spacing(SpacingWarning::Contradicted { .. }))
        };
        assert_eq!(surface.report().warnings.iter().filter(|warning| warned(warning)).count(), 1);
    }
}

#[test]
fn the_spacing_of_many_particles_is_verified_while_counting_them() {
    // Use more particles than the estimate keeps in memory.
    let pool = fill(45.0, 1.0, 0.25, 7, |_| true);
    assert!(pool.len() > 600_000);
    for (given, contradicted) in
        [(0.5, true), (0.7, true), (0.9, false), (1.2, false), (1.5, true), (4.0, true)]
    {
        let request =
            Reconstruction::new().spacing(given).cell(if given < 1.0 { 1.0 } else { 0.5 });
        let frame = request.sample(&pool).unwrap();
        let found = frame.warnings().into_iter().find_map(|warning| match warning {
            Warning::Spacing(SpacingWarning::Contradicted { found, .. }) => Some(found),
            _ => None,
        });
        assert_eq!(found.is_some(), contradicted, "{given}");
        assert!(found.is_none_or(|found| (found - 1.0).abs() < 0.02), "{given}: {found:?}");
    }
    let estimated = Reconstruction::new().sample(&pool).unwrap();
    assert_eq!(estimated.warnings(), []);
}

#[test]
fn spray_around_a_fluid_does_not_cause_a_spacing_warning() {
    let mut particles = ball();
    let spray = fill(20.0, 0.5, 1.0, 9, |p| p.length() > 14.0);
    particles.extend(spray.into_iter().map(|p| p.map(|c| SPACING * c)));
    let surface = Reconstruction::new().spacing(SPACING).run(&particles).unwrap();
    assert_eq!(contradiction(&cells(&surface).warnings), None);
}

#[test]
fn the_spacing_warning_names_both_spacings_and_the_options_to_use() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("f_1.xyz"), raw(&ball())).unwrap();
    for given in [["--spacing", "0.025"], ["--radius", "0.0125"]] {
        let arguments =
            ["reconstruct", "f_1.xyz", "-o", "m.ply", "--overwrite", given[0], given[1]];
        let messages = run(folder.path(), &arguments, 0);
        assert!(
            messages.contains("spacing 0.025") && messages.contains("about 0.050"),
            "{messages}"
        );
        assert!(messages.contains("--radius 0.025 or --spacing 0.050"), "{messages}");
        assert_eq!(messages.matches("looks too small").count(), 1, "{messages}");
    }
    let info = command(folder.path(), &["info", "f_1.xyz", "--json"]).output().unwrap();
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert!((info[0]["spacing"].as_f64().unwrap() / SPACING - 1.0).abs() < 0.05, "{info}");
    assert_eq!(info[0]["spacing_warnings"], serde_json::json!([]));
}

#[test]
fn packing_and_meshing_a_packed_frame_warn_about_a_wrong_spacing() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("f.xyz"), raw(&ball())).unwrap();
    for (spacing, how) in [("0.025", Some("small")), ("0.05", None), ("0.1", Some("large"))] {
        let pack = ["pack", "f.xyz", "-o", "f.mnf", "--overwrite", "--spacing", spacing];
        let draw = ["reconstruct", "f.mnf", "-o", "f.ply", "--overwrite"];
        for arguments in [&pack[..], &draw[..]] {
            let messages = run(folder.path(), arguments, 0);
            match how {
                Some(how) => {
                    assert!(messages.contains(&format!("looks too {how}")), "{spacing}: {messages}")
                }
                None => assert!(!messages.contains("looks too"), "{messages}"),
            }
        }
    }
}

/// Runs a simulation, and returns the warnings about the spacing among its events.
fn warnings_of(simulation: &Simulation) -> Vec<SpacingWarning> {
    let mut warnings = Vec::new();
    let on_event = |event| {
        if let Event::SpacingWarning(warning) = event {
            warnings.push(*warning);
        }
    };
    let summaries = simulation.run(on_event).unwrap();
    assert!(summaries.iter().all(Summary::is_complete), "{summaries:?}");
    warnings
}

#[test]
fn a_simulation_warns_once_about_a_wrong_spacing_and_again_on_resume() {
    let folder = TempDir::new().unwrap();
    let frame = |number: usize, scale: f64| {
        let particles: Vec<_> = ball().into_iter().map(|p| p.map(|c| scale * c)).collect();
        fs::write(folder.path().join(format!("f_{number}.xyz")), raw(&particles)).unwrap();
    };
    (1..4).for_each(|number| frame(number, 1.0));
    let [inputs, outputs] = ["f_{}.xyz", "m_{}.ply"].map(|name| folder.path().join(name));
    let by = |spacing| {
        Simulation::new(&inputs, &outputs).reconstruction(Reconstruction::new().spacing(spacing))
    };
    let warnings = warnings_of(&by(0.5 * SPACING).overwrite());
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(contradiction(&warnings).is_some());
    assert_eq!(warnings_of(&by(SPACING).overwrite()), []);
    // Write later frames at a different scale, so that they contradict the spacing of the state.
    frame(4, 3.0);
    frame(5, 3.0);
    let warnings = warnings_of(&by(SPACING).resume());
    let of_state = |warning: &SpacingWarning| {
        matches!(warning, SpacingWarning::Contradicted { source: SpacingSource::State, .. })
    };
    assert!(warnings.len() == 1 && of_state(&warnings[0]), "{warnings:?}");
}

#[test]
fn a_live_simulation_warns_about_a_wrong_spacing() {
    let mut simulation =
        LiveSimulation::new(&Reconstruction::new().spacing(0.5 * SPACING)).unwrap();
    let surface = simulation.frame(&ball()).unwrap();
    let contradicted = |warning: &Warning| {
        matches!(warning, Warning::Spacing(SpacingWarning::Contradicted { .. }))
    };
    assert!(surface.report().warnings.iter().any(contradicted));
}

#[test]
fn particles_in_a_plane_become_a_flat_slab_one_spacing_thick() {
    for at in [0.0, -3.7] {
        let particles = plane(at);
        let surface = Reconstruction::new().run(&particles).unwrap();
        let Some(Slab { axis: 1, faces: [lo, hi] }) = cells(&surface).slab else {
            panic!("no slab")
        };
        let spacing = surface.report().facts.spacing.unwrap();
        assert!((spacing / SPACING - 1.0).abs() < 0.03, "{spacing}");
        assert!(
            (lo - (at - spacing / 2.0)).abs() < 1e-12 && (hi - (at + spacing / 2.0)).abs() < 1e-12
        );
        let expected = particles.len() as f64 * SPACING.powi(3);
        assert!(
            (volume(&surface) / expected - 1.0).abs() < 0.08,
            "{} of {expected}",
            volume(&surface)
        );
        let heights: Vec<f64> = surface.to_mesh().unwrap().positions.iter().map(|p| p[1]).collect();
        let ends =
            heights.iter().filter(|y| (**y - lo).abs() < 1e-9 || (**y - hi).abs() < 1e-9).count();
        assert!(heights.iter().all(|y| (lo - 1e-9..=hi + 1e-9).contains(y)));
        assert!(2 * ends > heights.len(), "{ends} of {} vertices are on the faces", heights.len());
        // The mesh must be the same as with explicit walls.
        let [x, z] = [f64::NEG_INFINITY; 2];
        let walled =
            Reconstruction::new().domain([x, lo, z], [-x, hi, -z]).spacing(spacing).run(&particles);
        assert_eq!(bytes_of(&surface), bytes_of(&walled.unwrap()));
    }
    let domain = Reconstruction::new().domain([-9.0; 3], [9.0; 3]).run(&plane(0.0)).unwrap();
    let given = Reconstruction::new().spacing(SPACING).run(&plane(0.0)).unwrap();
    assert_eq!(cells(&domain).slab.map(|slab| slab.axis), None);
    assert_eq!(cells(&given).slab.map(|slab| slab.axis), Some(1));
}

#[test]
fn a_planar_frame_is_reported_and_meshed_alike_in_sequences_and_parts() {
    let folder = TempDir::new().unwrap();
    for number in 1..3 {
        fs::write(folder.path().join(format!("f_{number}.csv")), csv(&plane(0.5))).unwrap();
    }
    let alone = run(folder.path(), &["reconstruct", "f_1.csv", "-o", "alone.ply"], 0);
    assert!(alone.contains("in the plane y = 0.5"), "{alone}");
    let all = run(folder.path(), &["reconstruct", "f_{}.csv", "-o", "m_{}.ply"], 0);
    assert!(all.contains("in the plane y = 0.5"), "{all}");
    let bytes = |name: &str| fs::read(folder.path().join(name)).unwrap();
    assert_eq!(bytes("m_1.ply"), bytes("m_2.ply"));
    let parts = ["reconstruct", "f_1.csv", "-o", "parts.ply", "--parts", "2"];
    run(folder.path(), &[&parts[..], &["--plan"]].concat(), 0);
    for part in ["0", "1"] {
        run(folder.path(), &[&parts[..], &["--part", part]].concat(), 0);
    }
    run(folder.path(), &[&parts[..], &["--merge"]].concat(), 0);
    assert_eq!(bytes("parts.ply"), bytes("alone.ply"));
}

#[test]
fn a_slab_ends_when_an_emitter_adds_more_layers() {
    let folder = TempDir::new().unwrap();
    let layers = |count: usize| -> Vec<[f64; 3]> {
        let at = |layer: usize| moved(&plane(0.5), [0.0, SPACING * layer as f64, 0.0]);
        (0..count).flat_map(at).collect()
    };
    for (frame, count) in [(1, 1), (2, 8)] {
        fs::write(folder.path().join(format!("f_{frame}.xyz")), raw(&layers(count))).unwrap();
    }
    let messages = run(folder.path(), &["reconstruct", "f_{}.xyz", "-o", "m_{}.ply"], 0);
    assert!(messages.contains("one spacing thick"), "{messages}");
    let volume_of = |frame: u32| {
        let mesh = read_mesh(&folder.path().join(format!("m_{frame}.ply"))).unwrap();
        measure(&mesh).volume.unwrap()
    };
    let layer = plane(0.5).len() as f64 * SPACING.powi(3);
    let volumes = [1, 2].map(|frame| volume_of(frame) / layer);
    assert!((volumes[0] - 1.0).abs() < 0.1 && (volumes[1] / 8.0 - 1.0).abs() < 0.1, "{volumes:?}");
    let mut live = LiveSimulation::new(&Reconstruction::new()).unwrap();
    let volumes = [1, 8].map(|count| volume(&live.frame(&layers(count)[..]).unwrap()) / layer);
    assert!((volumes[0] - 1.0).abs() < 0.1 && (volumes[1] / 8.0 - 1.0).abs() < 0.1, "{volumes:?}");
}

#[test]
fn particles_far_from_the_origin_get_a_nearby_grid_origin() {
    let near = Reconstruction::new().spacing(SPACING).run(&ball()).unwrap();
    for far in [[500_000.25, 4_649_776.5, 120.0], [-4e6, 0.5, 4.2e6]] {
        let surface = Reconstruction::new().run(&moved(&ball(), far)).unwrap();
        assert!(cells(&surface).origin.is_some() && cells(&surface).warnings.is_empty());
        assert!((volume(&surface) / volume(&near) - 1.0).abs() < 0.02);
    }
    let close = Reconstruction::new().run(&moved(&ball(), [500.0, 0.0, 0.0])).unwrap();
    assert_eq!(cells(&close).origin, None);

    let folder = TempDir::new().unwrap();
    for number in 1..4 {
        let at = [500_000.0 + 0.3 * f64::from(number), 4_649_776.0, 0.0];
        fs::write(folder.path().join(format!("f_{number}.csv")), csv(&moved(&ball(), at))).unwrap();
    }
    run(folder.path(), &["reconstruct", "f_{}.csv", "-o", "m_{}.ply"], 0);
    let state = fs::read(folder.path().join("m.meniscus/state.json"));
    let state = state.or_else(|_| fs::read(state_file(folder.path()))).unwrap();
    let state: serde_json::Value = serde_json::from_slice(&state).unwrap();
    assert!(state["shared"]["origin"][1].as_f64().unwrap() > 4e6, "{state}");
}

/// The path of the only state file below a folder.
fn state_file(folder: &Path) -> std::path::PathBuf {
    let folders =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path().join("state.json"));
    folders.into_iter().find(|path| path.is_file()).unwrap()
}

#[test]
fn coarse_single_precision_coordinates_are_reported_with_their_step() {
    let single = |from: f64| -> Vec<[f32; 3]> {
        moved(&ball(), [from, 0.0, 0.0]).into_iter().map(|p| p.map(|c| c as f32)).collect()
    };
    for from in [0.0, 1e4, 9e4] {
        let surface = Reconstruction::new().run(&single(from)).unwrap();
        assert_eq!(cells(&surface).warnings, [], "{from}");
    }
    for spacing in [None, Some(SPACING)] {
        let request = Reconstruction::new();
        let request = spacing.into_iter().fold(request, Reconstruction::spacing);
        let surface = request.run(&single(300_000.0)).unwrap();
        let coarse = |warning: &SpacingWarning| matches!(warning, SpacingWarning::SinglePrecision { step, .. } if *step == 0.03125);
        assert!(cells(&surface).warnings.iter().any(coarse), "{:?}", cells(&surface).warnings);
    }
    let error = Reconstruction::new().run(&single(3e6)).unwrap_err();
    assert!(
        matches!(error, Error::NoSpacing { why: NoEstimate::SinglePrecision { step: 0.25 }, .. }),
        "{error}"
    );
}

#[test]
fn coincident_particles_and_clumps_of_unused_slots_are_reported() {
    let ball = ball();
    let coincident = |particles: &[[f64; 3]]| {
        let surface = Reconstruction::new().run(particles).unwrap();
        let spacing = surface.report().facts.spacing.unwrap();
        assert!((spacing / SPACING - 1.0).abs() < 0.05, "{spacing}");
        surface.report().warnings.iter().find_map(|warning| match warning {
            Warning::Coincident { found, .. } => {
                Some((found.particles, found.most, found.alone, found.at))
            }
            _ => None,
        })
    };
    assert_eq!(coincident(&ball), None);
    let twice = [ball.clone(), ball.clone()].concat();
    let (particles, most, alone, _) = coincident(&twice).unwrap();
    assert_eq!((particles, most, alone), (ball.len() as u64, 2, false));
    let parked = [ball, vec![[7.0, -3.0, 2.0]; 500]].concat();
    let (particles, most, alone, at) = coincident(&parked).unwrap();
    assert_eq!((particles, most, alone), (499, 500, true));
    assert!((DVec3::from(at) - DVec3::new(7.0, -3.0, 2.0)).length() < 1e-5, "{at:?}");

    let error = Reconstruction::new().run(&[[1.0_f64; 3]; 100]).unwrap_err();
    let Error::NoSpacing { particles: 100, why, .. } = error else { panic!("{error}") };
    assert_eq!(why, NoEstimate::Coincident { places: 1 });
    let error = Reconstruction::new().run(&[[f64::NAN; 3]; 100]).unwrap_err();
    let Error::NoSpacing { particles: 100, why, .. } = error else { panic!("{error}") };
    assert_eq!(why, NoEstimate::NotFinite);
}

#[test]
fn a_stack_of_many_separate_sheets_is_not_taken_for_deep_fluid() {
    for (layers, period) in [(1, 3.0), (2, 5.0)] {
        let mut sheets = Vec::new();
        let turn = glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.3, 0.7, 1.1);
        let mut random = crate::common::scene::Random::new(5);
        for i in 0..50 * 50 * 20 * layers {
            let [x, z, y] = [i % 50, i / 50 % 50, i / 2500].map(f64::from);
            let y = period * (y / f64::from(layers)).floor() + y % f64::from(layers);
            let jitter = DVec3::from([(); 3].map(|()| 0.2 * random.unit() - 0.1));
            sheets.push((turn * (DVec3::new(x, y, z) + jitter)).to_array());
        }
        let found = evidence(&sheets).unwrap().estimate().unwrap();
        assert!(found.thin && (found.spacing - 1.0).abs() < 0.12, "{layers}: {found:?}");
    }
}
