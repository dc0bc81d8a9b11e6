//! Tests of simulations with the library: the same bytes as with the program, events, cancellation,
//! frames from memory, and frames that are sampled once and meshed repeatedly.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Mutex;

use meniscus::error::{Conflict, SettingConflict};
use meniscus::files::Replace;
use meniscus::internals::field::calibration::CALIBRATING;
use meniscus::{
    Cancel, Cause, Cloud, Error, Event, IndicatorKind, LiveSimulation, MemoryBudget, Progress,
    Reconstruction, Simulation, SpacingWarning, Stage, Summary, Warning,
};
use tempfile::TempDir;

use crate::common::files::{bytes_of, raw, tree};
use crate::common::fill;
use crate::common::program::command;

/// A function that changes a request.
type Change = fn(Reconstruction) -> Reconstruction;

/// The particles of a falling drop in frame `frame`, with spacing 0.5.
fn falling(frame: u64) -> Vec<[f32; 3]> {
    let drop = fill(10.0, 2.0, 0.2, 3 + frame, |p| p.length() < 5.0);
    drop.iter().map(|&[x, y, z]| [x as f32, (y - 0.3 * frame as f64) as f32, z as f32]).collect()
}

fn write(path: &Path, particles: &[[f32; 3]]) {
    fs::write(path, raw(particles)).unwrap();
}

/// A folder with this number of frames of a falling drop.
fn simulated(frames: u64) -> TempDir {
    let folder = TempDir::new().unwrap();
    fs::create_dir(folder.path().join("sim")).unwrap();
    (1..=frames).for_each(|frame| {
        write(&folder.path().join(format!("sim/drop_{frame}.xyz")), &falling(frame))
    });
    folder
}

fn simulation(folder: &Path, meshes: &str) -> Simulation {
    let request = Reconstruction::new().spacing(0.5).threads(2).memory(MemoryBudget(1 << 30));
    Simulation::new(folder.join("sim/drop_{}.xyz"), folder.join(meshes).join("drop_{}.ply"))
        .reconstruction(request)
}

#[test]
fn the_library_and_the_program_write_the_same_files() {
    let folder = simulated(4);
    let cases: [(&[&str], Change); 4] = [
        (&[], |request| request),
        (&["--indicator", "counting", "--normals", "--up", "z"], |request| {
            request.indicator(IndicatorKind::Counting).normals(true).up(meniscus::UpAxis::Z)
        }),
        (&["--simplify", "1", "--smallest-drop", "4", "--attributes", "none"], |request| {
            request.simplify(1.0).smallest_drop(4).attributes([""; 0])
        }),
        (&["--indicator", "symmetry", "--iso", "0.3", "--domain", "-4,-9,-9,9,9,9"], |request| {
            request.indicator(IndicatorKind::Symmetry).iso(0.3).domain([-4.0, -9.0, -9.0], [9.0; 3])
        }),
    ];
    for (number, (options, change)) in cases.into_iter().enumerate() {
        let [program, library] = ["program", "library"].map(|by| format!("{by}_{number}"));
        let mut command =
            command(folder.path(), &["reconstruct", "sim/drop_{}.xyz", "--spacing", "0.5"]);
        command.arg("-o").arg(format!("{program}/drop_{{}}.ply")).args([
            "--quiet",
            "--backend",
            "cpu",
        ]);
        assert!(command.args(options).status().unwrap().success(), "{options:?}");
        let request = change(Reconstruction::new().spacing(0.5));
        let summaries =
            simulation(folder.path(), &library).reconstruction(request).run(|_| {}).unwrap();
        assert!(
            matches!(&summaries[..], [whole @ Summary { made: 4, .. }] if whole.is_complete()),
            "{summaries:?}"
        );
        let [program, library] = [program, library].map(|by| tree(&folder.path().join(by)));
        assert_eq!(program.len(), 8, "{:?}", program.keys());
        assert!(program.keys().eq(library.keys()), "{:?} {:?}", program.keys(), library.keys());
        for (file, bytes) in &program {
            assert!(library[file] == *bytes, "{file} by {options:?}");
        }
    }
}

#[test]
fn events_report_measurement_start_progress_success_and_failure() {
    let folder = simulated(5);
    fs::write(folder.path().join("sim/drop_3.xyz"), "seven").unwrap();
    fs::remove_file(folder.path().join("sim/drop_4.xyz")).unwrap();
    let (mut log, mut shares) = (Vec::new(), Vec::new());
    let on_event = |event: Event| {
        let line = match &event {
            Event::Measured { .. } => "measured".to_owned(),
            Event::Started { frames, done, lanes, .. } => {
                assert!(*lanes >= 1);
                format!("starts {done} of {frames}")
            }
            Event::Stage { progress: Some(progress), frame, .. } => {
                shares.push(progress.done);
                format!("{frame} {}", progress.stage)
            }
            Event::Done(done) => {
                assert!(done.output.exists() && done.report.is_some());
                assert!(event.to_string().contains(" vertices, "), "{event}");
                format!("done {}", done.mesh.frame)
            }
            Event::Failed(failed) => {
                assert_eq!(failed.error.cause(), Cause::Input);
                format!("failed {}", failed.frame)
            }
            Event::Ended(_) => "ended".to_owned(),
            _ => return,
        };
        log.push(line);
    };
    let summaries = simulation(folder.path(), "mesh").run(on_event).unwrap();
    assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)), "{shares:?}");
    assert!(shares.contains(&0.0) && shares.contains(&1.0), "{shares:?}");
    let place = |line: &str| {
        log.iter().position(|entry| entry == line).unwrap_or_else(|| panic!("{line}: {log:?}"))
    };
    assert!(place("starts 0 of 4") < place("done 1"));
    for frame in [1, 2, 5] {
        for stage in ["reading", "counting", "sampling", "meshing", "writing"] {
            assert!(place(&format!("{frame} {stage}")) < place(&format!("done {frame}")));
        }
    }
    assert!(place("failed 3") < place("ended") && place("measured") < place("ended"));
    let [summary] = &summaries[..] else { panic!("{summaries:?}") };
    let failed: Vec<_> =
        summary.failed.iter().map(|failed| (failed.frame, failed.error.cause())).collect();
    assert_eq!(
        (summary.made, &failed[..], summary.incomplete_frames()),
        (3, &[(3, Cause::Input)][..], 2)
    );
    assert_eq!((summary.missing[0].first, summary.missing[0].last), (4, 4));
    assert!(!summary.is_complete());
}

/// Converts four frames, and replaces the first frame when `is_time` returns true. Returns the
/// files of this conversion, and the files of a conversion of the final frames.
fn converted_while_changed(
    change: fn(Simulation) -> Simulation,
    is_time: fn(&Event) -> bool,
) -> [BTreeMap<String, Vec<u8>>; 2] {
    let (folder, unchanged) = (simulated(4), simulated(4));
    let first = folder.path().join("sim/drop_1.xyz");
    // At first, frame 1 has a different spacing and position.
    let early: Vec<[f32; 3]> = falling(7).iter().map(|p| p.map(|x| 1.3 * x)).collect();
    write(&first, &early);
    let mut is_early = true;
    let mut measured = 0;
    let request = Reconstruction::new().threads(2).memory(MemoryBudget(1 << 30));
    let by = |folder: &Path| simulation(folder, "mesh").reconstruction(request.clone());
    let on_event = |event: Event| {
        measured += usize::from(matches!(event, Event::Measured { .. }));
        if is_early && is_time(&event) {
            write(&first, &falling(1));
            is_early = false;
        }
    };
    let summaries = change(by(folder.path())).run(on_event).unwrap();
    assert!(summaries.iter().all(Summary::is_complete), "{summaries:?}");
    assert_eq!((is_early, measured), (false, 2));
    by(unchanged.path())
        .run(|_| ())
        .unwrap()
        .iter()
        .for_each(|summary| assert!(summary.is_complete()));
    [folder, unchanged].map(|folder| {
        let mut files = tree(&folder.path().join("mesh"));
        // Ignore the state and the records, which contain the times of the inputs.
        files.retain(|name, _| !name.contains(".meniscus"));
        files
    })
}

#[test]
fn changing_the_calibration_frame_recalibrates_every_frame() {
    let [files, unchanged] =
        converted_while_changed(|all| all, |event| matches!(event, Event::Measured { .. }));
    assert!(files == unchanged, "{:?}", files.keys());
}

#[test]
fn a_watched_calibration_frame_that_grows_recalibrates_every_frame() {
    let is_last = |event: &Event| matches!(event, Event::Done(done) if done.progress.done == 4);
    let [files, unchanged] = converted_while_changed(|all| all.watch(3.0), is_last);
    assert!(files == unchanged, "{:?}", files.keys());
}

#[test]
fn overwriting_all_frames_measures_the_calibration_again() {
    let folder = TempDir::new().unwrap();
    fs::create_dir(folder.path().join("sim")).unwrap();
    let put = |frame: u64, particles: &[[f32; 3]]| {
        write(&folder.path().join(format!("sim/drop_{frame}.xyz")), particles);
    };
    let spray: Vec<[f32; 3]> = falling(1).into_iter().step_by(97).collect();
    (1..=2).for_each(|frame| put(frame, &spray));
    simulation(folder.path(), "mesh").run(|_| {}).unwrap();
    (3..=4).for_each(|frame| put(frame, &falling(frame)));
    let run = |all: Simulation| assert!(all.run(|_| {}).unwrap()[0].is_complete());
    run(simulation(folder.path(), "mesh").overwrite());
    run(simulation(folder.path(), "fresh"));
    let meshes = |meshes: &str| {
        let mut files = tree(&folder.path().join(meshes));
        files.retain(|name, _| name.ends_with(".ply"));
        files
    };
    assert!(meshes("mesh") == meshes("fresh"));
}

#[test]
fn packed_frames_with_different_spacings_are_refused_in_a_sequence() {
    let folder = TempDir::new().unwrap();
    fs::create_dir(folder.path().join("packed")).unwrap();
    let pack = |frame: u64, spacing: f64| {
        let output = folder.path().join(format!("packed/drop_{frame}.mnf"));
        let request = Reconstruction::new().spacing(spacing);
        let frame = request.sample(&falling(frame)[..]).unwrap();
        frame.pack(request.packed_output(&output, Replace::Allow).unwrap()).unwrap();
    };
    let convert = || {
        let input = folder.path().join("packed/drop_{}.mnf");
        let mut faults = Vec::new();
        let _ = Simulation::new(input, folder.path().join("mesh/drop_{}.ply")).overwrite().run(
            |event| {
                if let Event::Failed(failed) = event {
                    faults.push(failed.error.to_string());
                }
            },
        );
        faults
    };
    pack(1, 0.5);
    pack(2, 0.6);
    let faults = convert();
    assert!(faults.len() == 1 && faults[0].contains("0.6"), "{faults:?}");
    pack(2, 0.502);
    assert_eq!(convert(), Vec::<String>::new());
}

#[test]
fn packed_frames_in_a_folder_are_frames_unless_it_has_particle_files() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("frames")).unwrap();
    for frame in 1..=2 {
        let request = Reconstruction::new().spacing(0.5);
        let sampled = request.sample(&falling(frame)[..]).unwrap();
        let output = path(&format!("frames/drop_{frame}.mnf"));
        sampled.pack(request.packed_output(&output, Replace::Allow).unwrap()).unwrap();
    }
    let convert = |output: &str| {
        let simulation = Simulation::new(path("frames"), path(output));
        assert!(simulation.run(|_| {}).unwrap()[0].is_complete());
        let meshes = tree(&path(output)).into_keys();
        meshes.filter(|name| name.ends_with(".ply")).collect::<Vec<_>>()
    };
    assert_eq!(convert("of_packed/"), ["drop_1.ply", "drop_2.ply"]);
    let particles = falling(3);
    let rows = particles.iter().map(|[x, y, z]| format!("{x} {y} {z}\n"));
    fs::write(path("frames/drop_3.xyz"), rows.collect::<String>()).unwrap();
    assert_eq!(convert("of_particles/"), ["drop_3.ply"]);
}

#[test]
fn a_cancelled_conversion_keeps_finished_frames_and_can_be_resumed() {
    let folder = simulated(40);
    let cancel = Cancel::new();
    let request = Reconstruction::new().spacing(0.5).threads(1).memory(MemoryBudget(1 << 30));
    let all =
        simulation(folder.path(), "mesh").reconstruction(request.clone().cancel(cancel.clone()));
    let (mut done, mut failed) = (0, 0);
    let on_event = |event| match event {
        Event::Done(_) => {
            done += 1;
            if done == 3 {
                cancel.cancel();
            }
        }
        Event::Failed(_) => failed += 1,
        _ => {}
    };
    let error = all.run(on_event).unwrap_err();
    assert!(matches!(error, Error::Cancelled), "{error}");
    assert!((3..40).contains(&done) && failed == 0, "{done} done, {failed} failed");
    let meshes = |folder: &str, root: &Path| {
        let files = tree(&root.join(folder));
        assert!(files.keys().all(|name| !name.contains(".tmp")), "{:?}", files.keys());
        files.into_iter().filter(|(name, _)| name.ends_with(".ply")).collect::<BTreeMap<_, _>>()
    };
    assert_eq!(meshes("mesh", folder.path()).len(), done);

    let again = simulation(folder.path(), "mesh").reconstruction(request.clone()).resume();
    let mut skipped = 0;
    let on_event = |event| {
        if let Event::Started { done, .. } = event {
            skipped = done;
        }
    };
    let resumed = again.run(on_event).unwrap();
    assert!(skipped == done && resumed[0].is_complete(), "{skipped} of {done}: {resumed:?}");
    let whole = simulation(folder.path(), "whole").reconstruction(request).run(|_| {}).unwrap();
    assert!(whole[0].is_complete(), "{whole:?}");
    assert!(meshes("mesh", folder.path()) == meshes("whole", folder.path()));
}

#[test]
fn a_simulation_runs_from_inside_its_own_single_threaded_pool() {
    let folder = simulated(3);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let pool = std::sync::Arc::new(pool);
    let request = Reconstruction::new().spacing(0.5).pool(std::sync::Arc::clone(&pool));
    let simulation = simulation(folder.path(), "mesh").reconstruction(request);
    let mut events = 0;
    let summaries = pool.install(|| simulation.run(|_| events += 1)).unwrap();
    assert!(summaries[0].made == 3 && events > 3, "{summaries:?}");
}

#[test]
fn a_frame_can_be_cancelled_between_two_batches_of_blocks() {
    let water = fill(36.0, 1.0, 0.3, 5, |_| true);
    let cancel = Cancel::new();
    let reports = std::sync::Arc::new(Mutex::new(Vec::<Progress>::new()));
    let (stop, sink) = (cancel.clone(), std::sync::Arc::clone(&reports));
    let request =
        Reconstruction::new().spacing(1.0).cell(0.15).threads(1).memory(MemoryBudget(64 << 20));
    let error = request
        .cancel(cancel)
        .progress(move |progress| {
            sink.lock().unwrap().push(progress);
            if progress.stage == Stage::Meshing && progress.done > CALIBRATING {
                stop.cancel();
            }
        })
        .run(&water[..])
        .unwrap_err();
    assert_eq!(error.cause(), Cause::Cancelled, "{error}");
    let reports = reports.lock().unwrap();
    let last = reports.last().unwrap();
    assert!(
        last.stage == Stage::Meshing && last.done > CALIBRATING && last.done < 1.0,
        "{reports:?}"
    );
    let stages: Vec<Stage> = reports.iter().map(|progress| progress.stage).collect();
    assert!(stages.is_sorted() && stages.contains(&Stage::Sampling), "{stages:?}");
    assert_eq!(
        reports
            .iter()
            .filter(|progress| progress.stage == Stage::Meshing && progress.done > CALIBRATING)
            .count(),
        1
    );
}

#[test]
fn an_ordinary_frame_can_be_cancelled_during_meshing() {
    let water = fill(30.0, 1.0, 0.3, 5, |_| true);
    assert!(water.len() > 200_000);
    for (threads, kind) in
        [(1, IndicatorKind::Cloud), (2, IndicatorKind::Cloud), (2, IndicatorKind::Counting)]
    {
        let cancel = Cancel::new();
        let reports = std::sync::Arc::new(Mutex::new(Vec::<Progress>::new()));
        let (stop, sink) = (cancel.clone(), std::sync::Arc::clone(&reports));
        let request =
            Reconstruction::new().spacing(1.0).indicator(kind).threads(threads).cancel(cancel);
        let error = request
            .progress(move |progress| {
                sink.lock().unwrap().push(progress);
                if progress.stage == Stage::Meshing && progress.done > CALIBRATING {
                    stop.cancel();
                }
            })
            .run(&water)
            .unwrap_err();
        assert!(matches!(error, Error::Cancelled), "{error}");
        let last = *reports.lock().unwrap().last().unwrap();
        assert!(last.stage == Stage::Meshing && last.done < 0.5, "{last:?}");
    }
}

#[test]
fn a_frame_can_be_cancelled_in_the_middle_of_every_stage() {
    let folder = TempDir::new().unwrap();
    let input = folder.path().join("water.xyz");
    fs::write(&input, raw(&fill(30.0, 1.0, 0.3, 5, |_| true))).unwrap();
    for last in
        [Stage::Counting, Stage::Sampling, Stage::Meshing, Stage::Simplifying, Stage::Writing]
    {
        for format in ["ply", "glb", "obj"] {
            let cancel = Cancel::new();
            let reports = std::sync::Arc::new(Mutex::new(Vec::<Progress>::new()));
            let (stop, sink) = (cancel.clone(), std::sync::Arc::clone(&reports));
            let request = Reconstruction::new().spacing(1.0).simplify(0.5).threads(2);
            let request = request.cancel(cancel).progress(move |progress| {
                sink.lock().unwrap().push(progress);
                if progress.stage == last && progress.done > 0.0 {
                    stop.cancel();
                }
            });
            let mesh = folder.path().join("mesh").with_extension(format);
            let made = request.run_file(&input).and_then(|surface| surface.write(&mesh));
            let error = made.unwrap_err();
            assert_eq!(error.cause(), Cause::Cancelled, "{error}");
            let reports = reports.lock().unwrap();
            let end = reports.last().unwrap();
            assert!(
                end.stage == last && end.done > 0.0 && end.done < 1.0,
                "{last} of .{format}: {reports:?}"
            );
            assert_eq!(
                fs::read_dir(&folder).unwrap().count(),
                1,
                "{last} of .{format} left a file"
            );
        }
    }
}

#[test]
fn calibration_and_component_measurement_report_progress() {
    let reports = std::sync::Arc::new(Mutex::new(Vec::<Progress>::new()));
    let sink = std::sync::Arc::clone(&reports);
    Reconstruction::new()
        .spacing(1.0)
        .simplify(0.5)
        .smallest_drop(4)
        .progress(move |progress| sink.lock().unwrap().push(progress))
        .run(&fill(30.0, 1.0, 0.3, 5, |_| true))
        .unwrap();
    let reports = reports.lock().unwrap();
    // The first tenth of meshing is for calibrating, and the first tenth of simplifying is for
    // measuring components.
    for stage in [Stage::Meshing, Stage::Simplifying] {
        let shares = reports.iter().filter(|progress| progress.stage == stage).map(|of| of.done);
        let shares: Vec<f64> = shares.filter(|&done| done > 0.0 && done < 1.0).collect();
        let [begun, later] = [0.0..CALIBRATING, CALIBRATING..1.0]
            .map(|range| shares.iter().filter(|share| range.contains(share)).count());
        assert!(begun > 1 && later > 1 && shares.is_sorted(), "{stage}: {shares:?}");
    }
}

#[test]
fn every_stage_reports_from_0_to_1_and_can_be_cancelled_at_its_end() {
    let folder = simulated(1);
    let input = folder.path().join("sim/drop_1.xyz");
    let reports = std::sync::Arc::new(Mutex::new(Vec::<Progress>::new()));
    let sink = std::sync::Arc::clone(&reports);
    let request = || Reconstruction::new().spacing(0.5).simplify(0.5);
    let surface = request()
        .progress(move |progress| sink.lock().unwrap().push(progress))
        .run_file(&input)
        .unwrap();
    surface.write(folder.path().join("mesh.ply")).unwrap();
    // Writing has finished, so the callback does not hold the lock.
    let reports = std::mem::take(&mut *reports.lock().unwrap());
    let stages: Vec<_> = reports.chunk_by(|a, b| a.stage == b.stage).collect();
    let names: Vec<_> = stages.iter().map(|stage| stage[0].stage).collect();
    use Stage::{Counting, Meshing, Reading, Sampling, Simplifying, Writing};
    assert_eq!(names, [Reading, Counting, Sampling, Meshing, Simplifying, Writing]);
    for stage in stages {
        assert!(stage[0].done == 0.0 && stage[stage.len() - 1].done == 1.0, "{stage:?}");
        assert!(stage.is_sorted_by(|a, b| a.done <= b.done), "{stage:?}");
    }
    for last in [Reading, Counting, Sampling, Meshing, Simplifying] {
        let cancel = Cancel::new();
        let stop = cancel.clone();
        let request = request().cancel(cancel).progress(move |progress| {
            if progress.stage == last && progress.done == 1.0 {
                stop.cancel();
            }
        });
        assert!(matches!(request.run_file(&input), Err(Error::Cancelled)), "{last}");
    }
    // A cancelled write leaves no file, because a file gets its name only when it is complete.
    let cancel = Cancel::new();
    let output = request()
        .cancel(cancel.clone())
        .output(folder.path().join("late.ply"), Replace::Refuse)
        .unwrap();
    cancel.cancel();
    assert!(matches!(surface.write_to(output), Err(Error::Cancelled)));
    assert!(!folder.path().join("late.ply").exists());
}

#[test]
fn a_request_cancelled_before_it_starts_writes_nothing() {
    let folder = simulated(2);
    let cancel = Cancel::new();
    cancel.cancel();
    let request = Reconstruction::new().spacing(0.5).cancel(cancel);
    assert!(matches!(request.run(&falling(1)[..]).unwrap_err(), Error::Cancelled));
    let input = folder.path().join("sim/drop_1.xyz");
    assert!(matches!(request.run_file(&input).unwrap_err(), Error::Cancelled));
    let error = simulation(folder.path(), "mesh").reconstruction(request).run(|_| {}).unwrap_err();
    assert!(matches!(error, Error::Cancelled), "{error}");
    let left = fs::read_dir(folder.path().join("mesh")).map_or(0, Iterator::count);
    assert_eq!(left, 0);
}

#[test]
fn live_frames_from_memory_equal_frames_from_files() {
    for kind in [IndicatorKind::Cloud, IndicatorKind::Counting, IndicatorKind::Symmetry] {
        let folder = simulated(3);
        let request = Reconstruction::new().spacing(0.5).indicator(kind).cell(0.8);
        simulation(folder.path(), "mesh").reconstruction(request.clone()).run(|_| {}).unwrap();
        let mut live = LiveSimulation::new(&request).unwrap();
        for frame in 1..=3 {
            let surface = live.frame(&falling(frame)[..]).unwrap();
            let file = folder.path().join(format!("mesh/drop_{frame}.ply"));
            assert!(
                live.is_settled() && bytes_of(&surface) == fs::read(file).unwrap(),
                "frame {frame} by {kind:?}"
            );
        }
    }
}

#[test]
fn a_live_frame_that_lacks_the_velocity_of_the_first_causes_a_warning() {
    let mut live = LiveSimulation::new(&Reconstruction::new().spacing(0.5)).unwrap();
    let water = falling(1);
    let velocity = vec![[0.0_f32, -1.0, 0.0]; water.len()];
    let first = live.frame(&Cloud::new(&water).with("velocity", &velocity)).unwrap();
    let second = live.frame(&falling(2)[..]).unwrap();
    let [first, second] = [&first, &second].map(|surface| &surface.report().warnings);
    let lacks = Warning::MissingAttribute { attribute: "velocity".into(), calibration_frame: None };
    assert!(!first.contains(&lacks) && second.contains(&lacks), "{second:?}");
}

#[test]
fn a_live_frame_has_the_attribute_types_of_the_first() {
    let request = Reconstruction::new().spacing(0.5).attributes(["Cd", "heat"]);
    let mut live = LiveSimulation::new(&request).unwrap();
    let water = falling(1);
    let heat = vec![293.0_f32; water.len()];
    let (rgb, rgba) = (vec![[0.5_f32; 3]; water.len()], vec![[0.5_f32; 4]; water.len()]);
    live.frame(&Cloud::new(&water).with("Cd", &rgb).with("heat", &heat)).unwrap();
    let second = live.frame(&Cloud::new(&water).with("Cd", &rgba).with("heat", &heat)).unwrap();
    let alpha = Warning::Alpha { attribute: "Cd".into(), own: 4, shared: 3 };
    assert!(second.report().warnings.contains(&alpha));
    assert_eq!(second.mesh().attributes()[0].components, 3);
    let other = Cloud::new(&water).with("Cd", &rgb).with("heat", &rgb);
    assert_eq!(live.frame(&other).unwrap_err().cause(), Cause::Input);
}

#[test]
fn a_live_simulation_keeps_its_first_measurements_for_later_frames() {
    // A thin sheet has no interior, so it does not settle the calibration.
    let sheet: Vec<[f64; 3]> = fill(20.0, 2.0, 0.1, 7, |p| (0.0..0.5).contains(&p.y));
    let mut live = LiveSimulation::new(&Reconstruction::new().spacing(0.5)).unwrap();
    live.frame(&sheet[..]).unwrap();
    assert!(!live.is_settled());
    live.frame(&falling(1)[..]).unwrap();
    assert!(live.is_settled());

    let mut live = LiveSimulation::new(&Reconstruction::new()).unwrap();
    let first = live.frame(&falling(1)[..]).unwrap();
    assert!(live.is_settled());
    // A frame with only half of the particles must keep the spacing and the plateau.
    let thinned: Vec<[f32; 3]> = falling(2).into_iter().step_by(2).collect();
    let second = live.frame(&thinned[..]).unwrap();
    let [one, other] = [&first, &second].map(|surface| surface.report());
    assert_eq!(one.facts.grid, other.facts.grid);
    assert_eq!(one.calibration, other.calibration);
    let alone = Reconstruction::new().run(&thinned[..]).unwrap();
    assert_ne!(alone.report().facts.grid, other.facts.grid);
    assert_ne!(alone.report().calibration, other.calibration);
}

#[test]
fn a_sampled_frame_can_be_meshed_repeatedly_with_other_settings() {
    let water = falling(1);
    let request = Reconstruction::new().spacing(0.5);
    let frame = request.sample(&water[..]).unwrap();
    for smooth in [1.2, 1.6, 2.2] {
        let other = request.clone().smooth(smooth);
        let drawn = frame.surface_by(&other).unwrap();
        assert!(bytes_of(&drawn) == bytes_of(&other.run(&water[..]).unwrap()), "{smooth}");
    }
    assert!(bytes_of(&frame.surface().unwrap()) == bytes_of(&request.run(&water[..]).unwrap()));

    let folder = TempDir::new().unwrap();
    let packed = folder.path().join("frame.mnf");
    frame.pack(request.packed_output(&packed, Replace::Refuse).unwrap()).unwrap();
    let drawn = Reconstruction::new().smooth(2.2).run_file(&packed).unwrap();
    assert!(bytes_of(&drawn) == bytes_of(&request.clone().smooth(2.2).run(&water[..]).unwrap()));
    let none = request.packed_output(folder.path().join("frame.ply"), Replace::Refuse).unwrap_err();
    assert_eq!(none.cause(), Cause::Request);
}

#[test]
fn inapplicable_settings_are_refused_and_named() {
    let default = Reconstruction::new;
    let counting = || default().indicator(IndicatorKind::Counting);
    let mueller = || default().method(meniscus::KernelMethod::Mueller { iso: 0.5 });
    let folder = TempDir::new().unwrap();
    for (setting, request) in [
        ("sigma", default().sigma(1.0)),
        ("iso", default().iso(0.5)),
        ("detail", default().detail(true)),
        ("mu0", default().mu0(3.0)),
        ("smooth", counting().smooth(1.6)),
        ("smooth", mueller().smooth(1.6)),
        ("sigma", mueller().sigma(1.6)),
        ("iso", default().method(meniscus::KernelMethod::ZhuBridson).iso(0.5)),
        ("indicator", mueller().indicator(IndicatorKind::Cloud)),
    ] {
        let refused = |error| {
            let Error::SettingConflict(conflict) = error else { return false };
            conflict.setting.name() == setting
        };
        assert!(refused(request.check("none.bgeo").unwrap_err()), "{setting}");
        assert!(refused(request.run(&falling(1)[..]).unwrap_err()), "{setting}");
        assert!(refused(request.run_file("there/is/none.bgeo").unwrap_err()), "{setting}");
        let simulation = Simulation::new("none_{}.bgeo", folder.path().join("mesh_{}.ply"));
        assert!(refused(simulation.reconstruction(request).check().unwrap_err()), "{setting}");
    }
    for (setting, request, name) in [
        ("normals", default().normals(true), "m.stl"),
        ("attributes", default().attributes(["heat"]), "m.obj"),
        ("compress", default().compress(true), "m.ply"),
        ("up", default().up(meniscus::UpAxis::Z), "m.glb"),
    ] {
        let error = request.output(folder.path().join(name), Replace::Refuse).unwrap_err();
        assert!(
            matches!(&error, Error::SettingConflict(SettingConflict {
                setting: refused,
                with: Conflict::Format { .. },
                ..
            }) if refused.name() == setting),
            "{setting}: {error}"
        );
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn warnings_of_a_simulation_name_the_calibration_frame() {
    let folder = simulated(1);
    // Frame 2 has only a ninth of the particles. Its field deep in the fluid (the plateau) is much
    // lower than that of frame 1, so the isovalue that was measured on frame 1 is too high for it.
    let far: Vec<[f32; 3]> = falling(1).into_iter().step_by(9).collect();
    write(&folder.path().join("sim/drop_2.xyz"), &far);
    let mut found = Vec::new();
    let request = Reconstruction::new().spacing(0.5).indicator(IndicatorKind::Counting);
    let on_event = |event| {
        if let Event::Done(done) = event {
            found.extend(done.warnings);
        }
    };
    simulation(folder.path(), "mesh").reconstruction(request).run(on_event).unwrap();
    let calibration_frame = found.iter().find_map(|warning| match warning {
        Warning::Shortfall { calibration_frame, clouds: false, .. } => Some(*calibration_frame),
        Warning::Empty { calibration_frame, clouds: false, .. } => Some(*calibration_frame),
        _ => None,
    });
    assert_eq!(calibration_frame, Some(Some(1)), "{found:?}");
    assert!(found.iter().all(|warning| !warning.to_string().contains("--")), "{found:?}");
}

/// Water with waves, which depend on the frame, in a tank that is open at the top. Along x and z,
/// the tank reaches from 0 to 24.
fn tank(frame: u64) -> Vec<[f32; 3]> {
    let waves = move |x: f64| 12.0 + 2.0 * (x / 3.0 + frame as f64).sin();
    let water = fill(12.0, 1.0, 0.3, 3 + frame, |_| true).into_iter();
    let water = water.map(|p| p.map(|c| c + 12.0)).filter(|&[x, y, _]| y < waves(x));
    water.map(|p| p.map(|c| c as f32)).collect()
}

#[test]
fn detected_walls_cover_all_frames_survive_resume_and_drop_no_particle() {
    let folder = TempDir::new().unwrap();
    fs::create_dir(folder.path().join("sim")).unwrap();
    // The library measures the walls on frames 1, 3, 5 and so on, but not on frame 6.
    for frame in 1..=13 {
        let mut water = tank(frame);
        if frame == 6 {
            water.push([-4.0, 3.0, 3.0]);
        }
        write(&folder.path().join(format!("sim/drop_{frame}.xyz")), &water);
    }
    let request = Reconstruction::new().spacing(1.0).find_domain();
    let convert = |simulation: Simulation| {
        let (mut shared, mut done) = (None, BTreeMap::new());
        let summary = simulation.reconstruction(request.clone()).run(|event| match event {
            Event::Measured { shared: found, .. } | Event::Resumed { shared: found, .. } => {
                shared = Some(found);
            }
            Event::Done(frame) => drop(done.insert(frame.frame, frame)),
            _ => {}
        });
        assert!(summary.unwrap().iter().all(Summary::is_complete));
        (shared.unwrap().walls.unwrap(), done)
    };
    let (found, done) = convert(simulation(folder.path(), "mesh"));
    let [lo, hi] = found.walls.corners();
    for (at, expected) in [(lo.x, 0.0), (lo.y, 0.0), (lo.z, 0.0), (hi.x, 24.0), (hi.z, 24.0)] {
        assert!((at - expected).abs() < 0.3, "{found}");
    }
    assert_eq!(hi.y, f64::INFINITY);
    for (number, frame) in &done {
        let facts = frame.report.as_ref().unwrap().facts;
        let passed: Vec<_> = frame
            .warnings
            .iter()
            .filter_map(|warning| match warning {
                Warning::BeyondWall(past) => Some((past.axis, past.reach, past.moved)),
                _ => None,
            })
            .collect();
        assert_eq!(facts.census.outside, 0, "frame {number}");
        let walls = facts.domain.unwrap().walls();
        if *number == 6 {
            assert_eq!(passed, [('x', -4.0, None)]);
            assert_eq!(walls[0].x, f64::NEG_INFINITY);
        } else {
            assert_eq!((passed.len(), walls), (0, [lo, hi]), "frame {number}");
        }
    }
    // A resumed conversion must use the same walls.
    fs::remove_file(folder.path().join("mesh/drop_9.ply")).unwrap();
    let (again, done) = convert(simulation(folder.path(), "mesh").resume());
    assert_eq!((again, done.len()), (found, 1));
    assert_eq!(done[&9].report.as_ref().unwrap().facts.domain.unwrap().walls(), [lo, hi]);
}

/// The positions and radii of a cube of particles with spacing 1, and of a cube with spacing 2.
fn of_two_sizes() -> (Vec<[f64; 3]>, Vec<f32>) {
    let cube = |first: f64, spacing: f64, count: i32| {
        let at = move |i: i32| (f64::from(i) + 0.5) * spacing;
        (0..count.pow(3))
            .map(move |i| [first + at(i % count), at(i / count % count), at(i / count / count)])
    };
    let positions: Vec<_> = cube(0.0, 1.0, 16).chain(cube(16.0, 2.0, 8)).collect();
    let radii = positions.iter().map(|p| if p[0] < 16.0 { 0.5 } else { 1.0 }).collect();
    (positions, radii)
}

/// The warnings about the particles' sizes.
fn about_sizes(warnings: &[Warning]) -> Vec<SpacingWarning> {
    let of_sizes = |warning: &Warning| match warning {
        Warning::Spacing(
            sizes @ (SpacingWarning::Sizes { .. } | SpacingWarning::MoreSizes { .. }),
        ) => Some(sizes.clone()),
        _ => None,
    };
    warnings.iter().filter_map(of_sizes).collect()
}

#[test]
fn sizes_that_the_calibration_frame_does_not_have_are_reported() {
    let (positions, radii) = of_two_sizes();
    let one = vec![0.5_f32; positions.len()];
    let mut faulty = radii.clone();
    (faulty[0], faulty[1]) = (-1.0, f32::NAN);
    let frames = |first: &[f32], second: &[f32]| {
        let mut live = LiveSimulation::new(&Reconstruction::new().cell(0.5)).unwrap();
        [first, second].map(|radii| {
            let cloud = Cloud::new(&positions).with("radius", radii);
            about_sizes(&live.frame(&cloud).unwrap().report().warnings)
        })
    };
    let [none, several] = frames(&one, &radii);
    assert_eq!(none, []);
    assert!(
        matches!(&several[..], [SpacingWarning::MoreSizes { sizes: [1.0, 2.0], .. }]),
        "{several:?}"
    );
    let [none, strays] = frames(&radii, &faulty);
    assert_eq!(none, []);
    assert!(matches!(&strays[..], [SpacingWarning::Sizes { invalid: 2, .. }]), "{strays:?}");

    // Repeat this test with files, where the largest frame calibrates the simulation.
    let folder = TempDir::new().unwrap();
    let mut invalid = one.clone();
    invalid[5] = 0.0;
    for (number, digits, radii) in [(1, 9, &one), (2, 2, &invalid), (3, 2, &radii)] {
        let rows = positions.iter().zip(radii);
        let text: String =
            rows.map(|([x, y, z], radius)| format!("{x},{y},{z},{radius:.digits$}\n")).collect();
        fs::write(folder.path().join(format!("in_{number}.csv")), format!("x,y,z,radius\n{text}"))
            .unwrap();
    }
    let mut found = BTreeMap::new();
    Simulation::new(folder.path().join("in_{}.csv"), folder.path().join("out_{}.ply"))
        .reconstruction(Reconstruction::new().cell(0.5).threads(2))
        .run(|event| {
            if let Event::Done(done) = event {
                found.insert(done.mesh.frame, about_sizes(&done.warnings));
            }
        })
        .unwrap();
    assert_eq!(found[&1], []);
    assert!(
        matches!(&found[&2][..], [SpacingWarning::Sizes { invalid: 1, larger: 0, usual: 1.0, .. }]),
        "{found:?}"
    );
    assert!(
        matches!(&found[&3][..], [SpacingWarning::MoreSizes { sizes: [1.0, 2.0], .. }]),
        "{found:?}"
    );
}
