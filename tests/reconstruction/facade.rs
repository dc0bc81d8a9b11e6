//! Tests of the library's facade: reconstruction, reports, errors and sampled frames.

use std::error::Error as _;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use meniscus::error::{Cause, Conflict, Error, NoEstimate};
use meniscus::internals::baselines::KernelMethod;
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::frame::FrameError;
use meniscus::internals::grid::units::MemoryBudget;
use meniscus::internals::io::output::read_mesh;
use meniscus::internals::particles::{Particles, StridedPositions};
use meniscus::internals::reconstruction::SpacingSource;
use meniscus::internals::surface::mesh::check::check;
use meniscus::{EmptyReason, LiveSimulation, Reconstruction, Settings, Surface, UpAxis, Warning};
use tempfile::TempDir;

#[cfg(target_os = "linux")]
use crate::common::alone::alone;
use crate::common::files::{bytes_of, data, raw};
use crate::common::program::command;
use crate::common::{fill, splashes};

/// A ball of particles at spacing 0.5.
fn ball() -> Vec<[f64; 3]> {
    fill(10.0, 2.0, 0.2, 3, |p| p.length() < 5.0)
}

#[test]
fn the_library_and_the_program_write_the_same_bytes() {
    let default = Reconstruction::new;
    let cases: [(&[&str], Reconstruction); 8] = [
        (&[], default()),
        (
            &["--spacing", "0.5", "--cell", "0.3", "--smooth", "2"],
            default().spacing(0.5).cell(0.3).smooth(2.0),
        ),
        (&["--cell-size", "0.4", "--normals"], default().cell_size(0.4).normals(true)),
        (
            &["--indicator", "counting", "--detail"],
            default().indicator(IndicatorKind::Counting).detail(true),
        ),
        (
            &["--indicator", "symmetry", "--iso", "0.2", "--cell", "1", "--origin", "0.1,0,0"],
            default().indicator(IndicatorKind::Symmetry).iso(0.2).cell(1.0).origin([0.1, 0.0, 0.0]),
        ),
        (
            &["--domain", "-4,-9,-9,9,9,9", "--simplify", "0.5"],
            default().domain([-4.0, -9.0, -9.0], [9.0; 3]).simplify(0.5),
        ),
        (
            &["--method", "mueller"],
            default().method(KernelMethod::Mueller { iso: KernelMethod::HALF }),
        ),
        (
            &["--memory", "24MiB", "--threads", "1", "--smallest-drop", "5"],
            default().memory(MemoryBudget(24 << 20)).threads(1).smallest_drop(5),
        ),
    ];
    let folder = TempDir::new().unwrap();
    let input = folder.path().join("ball.xyz");
    fs::write(&input, raw(&ball())).unwrap();
    for (number, (options, reconstruction)) in cases.into_iter().enumerate() {
        let [program, library] =
            ["program", "library"].map(|by| folder.path().join(format!("{by}_{number}.ply")));
        let mut command = command(folder.path(), &["reconstruct"]);
        command.arg(&input).arg("-o").arg(&program).args(["--quiet", "--backend", "cpu"]);
        assert!(command.args(options).status().unwrap().success(), "{options:?}");
        let surface = reconstruction.run_file(&input).unwrap();
        surface.write(&library).unwrap();
        assert!(fs::read(&program).unwrap() == fs::read(&library).unwrap(), "{options:?}");
        let mesh = surface.to_mesh().unwrap();
        assert!(check(&mesh).is_closed_oriented_manifold(), "{options:?}");
        assert_eq!(read_mesh(&library).unwrap().triangles, mesh.triangles, "{options:?}");
    }
}

#[test]
fn a_packed_frame_has_the_mesh_of_its_particles() {
    let folder = TempDir::new().unwrap();
    let [input, packed] = ["ball.xyz", "ball.mnf"].map(|name| folder.path().join(name));
    fs::write(&input, raw(&ball())).unwrap();
    let mut pack = command(folder.path(), &["pack"]);
    pack.arg(&input).arg("-o").arg(&packed).args(["--quiet", "--backend", "cpu"]);
    assert!(pack.status().unwrap().success());
    let request = Reconstruction::new().smooth(1.9);
    let [whole, packed] = [&input, &packed].map(|path| request.run_file(path).unwrap());
    assert!(bytes_of(&whole) == bytes_of(&packed));
    assert!(whole.report().cells.is_some() && packed.report().cells.is_none());
}

#[test]
fn strided_positions_of_any_width_are_read_in_place() {
    let particles: Vec<[f32; 3]> = ball().iter().map(|p| p.map(|x| x as f32)).collect();
    let wide: Vec<[f64; 3]> = particles.iter().map(|p| p.map(f64::from)).collect();
    // Each structure has two numbers before the position and one number after it.
    let structures: Vec<f32> =
        particles.iter().flat_map(|&[x, y, z]| [7.0, -1.0, x, y, z, f32::NAN]).collect();
    let strided = StridedPositions::new(&structures, 2, 6).unwrap();
    assert_eq!(strided.len(), particles.len());
    let request = Reconstruction::new().spacing(0.5);
    let expected = bytes_of(&request.run(&particles[..]).unwrap());
    assert!(bytes_of(&request.run(&wide[..]).unwrap()) == expected);
    assert!(bytes_of(&request.run(&particles).unwrap()) == expected);
    assert!(bytes_of(&request.run(&strided).unwrap()) == expected);
    assert!(StridedPositions::new(&structures, 0, 2).is_none());
    assert_eq!(StridedPositions::new(&structures[..5], 2, 6).unwrap().len(), 1);
    assert_eq!(StridedPositions::new(&structures[..4], 2, 6).unwrap().len(), 0);
    assert_eq!(StridedPositions::new(&structures[..4], 9, 6).unwrap().len(), 0);
}

#[test]
fn a_report_contains_settings_measurements_and_skipped_particles() {
    let mut particles = ball();
    particles.push([f64::NAN; 3]);
    let surface =
        Reconstruction::new().skip_invalid(true).smallest_drop(3).run(&particles[..]).unwrap();
    let report = surface.report();
    let (spacing, source) = report.cells.as_ref().unwrap().spacing.clone().unwrap();
    assert!((0.45..0.55).contains(&spacing), "{spacing}");
    assert_eq!(source, SpacingSource::Estimated);
    assert_eq!(report.facts.grid.cell_size(), spacing / 2.0);
    assert_eq!(
        (report.facts.census.not_finite, report.facts.census.binned),
        (1, particles.len() - 1)
    );
    assert!(report.measured.is_some() && report.too_small.is_some() && report.warnings.is_empty());
    assert!(report.timings.seconds().iter().any(|(stage, _)| *stage == "mesh"));
    let again = Reconstruction::new().calibrated(report.measured.unwrap().calibration);
    let again = again.skip_invalid(true).smallest_drop(3).run(&particles[..]).unwrap();
    assert!(again.report().measured.is_none() && bytes_of(&again) == bytes_of(&surface));
}

/// The key of the setting that caused an error.
fn key(error: &Error) -> String {
    match error {
        Error::Unit(unit) => unit.name().to_owned(),
        Error::SettingConflict(conflict) => conflict.setting.key(),
        Error::LittleMemory { .. } => "memory".to_owned(),
        other => panic!("{other} does not concern a setting"),
    }
}

#[test]
fn settings_out_of_range_are_refused_before_the_input_is_opened() {
    let default = Reconstruction::new;
    let both = Settings { spacing: Some(1.0), radius: Some(0.5), ..Settings::default() };
    let cells = Settings { cell: Some(0.5), cell_size: Some(0.5), ..Settings::default() };
    for (what, request) in [
        ("radius", Reconstruction::new().with_settings(both)),
        ("cell-size", Reconstruction::new().with_settings(cells)),
        ("spacing", default().spacing(0.0)),
        ("cell-size", default().cell_size(f64::NAN)),
        ("cell", default().cell(-1.0)),
        ("origin", default().origin([f64::INFINITY, 0.0, 0.0])),
        ("smooth", default().smooth(0.01)),
        ("sigma", default().indicator(IndicatorKind::Counting).sigma(-1.0)),
        ("iso", default().indicator(IndicatorKind::Counting).iso(2.0)),
        ("mu0", default().indicator(IndicatorKind::Counting).mu0(0.0)),
        ("simplify", default().simplify(1e9)),
        ("smallest-component", default().smallest_component(-2.0)),
        ("memory", default().memory(MemoryBudget(1 << 10))),
        ("memory", default().memory(MemoryBudget(48 << 20)).threads(2).simplify(1.0)),
    ] {
        // The file does not exist, but the setting is checked before the file is opened.
        let error = request.run_file("there/is/none.bgeo").unwrap_err();
        assert_eq!(error.cause(), Cause::Request, "{what}: {error}");
        assert_eq!(key(&error), what, "{error}");
    }
}

#[test]
fn errors_name_the_file_and_expose_their_source() {
    let folder = TempDir::new().unwrap();
    let missing = folder.path().join("missing.bgeo");
    let error = Reconstruction::new().run_file(&missing).unwrap_err();
    assert!(error.to_string().starts_with(missing.to_str().unwrap()), "{error}");
    let chain = std::iter::successors(error.source(), |error| (*error).source());
    assert!(
        chain.into_iter().any(|error| error.downcast_ref::<std::io::Error>().is_some()),
        "{error:?}"
    );

    let none = folder.path().join("none.xyz");
    fs::write(&none, raw(&[[1.0; 3], [2.0, 9.0, 1.0]])).unwrap();
    let in_file = Reconstruction::new().run_file(&none).unwrap_err();
    assert!(in_file.to_string().starts_with(none.to_str().unwrap()), "{in_file}");
    let in_memory = Reconstruction::new().run(&[[1.0_f64; 3], [2.0, 9.0, 1.0]][..]).unwrap_err();
    assert!(
        matches!(
            in_memory,
            Error::NoSpacing { path: None, particles: 2, why: NoEstimate::TooFew, .. }
        ),
        "{in_memory}"
    );
    let missing =
        Reconstruction::new().spacing(0.5).attributes(["heat"]).run(&ball()[..]).unwrap_err();
    assert!(matches!(&missing, Error::NoAttribute { name, .. } if name == "heat"), "{missing}");
    let empty = Reconstruction::new().spacing(1.0).run(&[[f64::NAN; 3]; 0]).unwrap_err();
    assert!(
        matches!(empty, Error::Frame { path: None, fault: FrameError::NoParticles(_) }),
        "{empty}"
    );
}

#[test]
fn existing_outputs_are_replaced_only_on_request() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("mesh.obj");
    fs::write(&path, "mine").unwrap();
    let surface = Reconstruction::new().spacing(0.5).run(&ball()[..]).unwrap();
    assert_eq!(surface.write(&path).unwrap_err().cause(), Cause::Request);
    assert_eq!(fs::read(&path).unwrap(), b"mine");
    surface.overwrite(&path).unwrap();
    assert!(!read_mesh(&path).unwrap().triangles.is_empty());
    assert_eq!(surface.write(Path::new("mesh.doc")).unwrap_err().cause(), Cause::Request);
}

#[test]
fn concurrent_reconstructions_do_not_affect_each_other() {
    let particles = splashes(5);
    let alone =
        bytes_of(&Reconstruction::new().spacing(1.0).threads(1).run(&particles[..]).unwrap());
    let all: Vec<Vec<u8>> = std::thread::scope(|scope| {
        let run = |threads: usize| {
            let particles = &particles;
            scope.spawn(move || {
                bytes_of(
                    &Reconstruction::new()
                        .spacing(1.0)
                        .threads(threads)
                        .run(&particles[..])
                        .unwrap(),
                )
            })
        };
        let calls: Vec<_> = [1, 2, 3, 1].map(run).into_iter().collect();
        calls.into_iter().map(|call| call.join().unwrap()).collect()
    });
    assert!(all.iter().all(|bytes| *bytes == alone));
}

#[test]
fn threads_can_make_surfaces_of_one_sampled_frame_at_the_same_time() {
    let water = fill(16.0, 1.0, 0.3, 4, |_| true);
    let request = Reconstruction::new().spacing(1.0).threads(2);
    let alone = bytes_of(&request.sample(&water).unwrap().surface().unwrap());
    for _ in 0..20 {
        // Use a new frame in each round, because the wide cells of a new frame are not computed
        // yet. All threads share the thread pool of the frame.
        let frame = Arc::new(request.sample(&water).unwrap());
        let (done, results) = std::sync::mpsc::channel();
        for _ in 0..3 {
            let (frame, done) = (Arc::clone(&frame), done.clone());
            std::thread::spawn(move || done.send(bytes_of(&frame.surface().unwrap())));
        }
        for _ in 0..3 {
            let surface =
                results.recv_timeout(Duration::from_secs(60)).expect("no thread is blocked");
            assert!(surface == alone);
        }
    }
}

#[test]
fn a_sampled_frame_refuses_settings_that_need_resampling() {
    let water = ball();
    let default = Reconstruction::new;
    let frame = default().spacing(0.5).cell(0.6).sample(&water).unwrap();
    let drawn = bytes_of(&frame.surface().unwrap());
    for same in
        [default(), default().spacing(0.5).cell(0.6), default().indicator(IndicatorKind::Cloud)]
    {
        assert!(bytes_of(&frame.surface_by(&same).unwrap()) == drawn, "{same:?}");
    }
    assert!(bytes_of(&frame.surface_by(&default().smooth(2.0).simplify(0.5)).unwrap()) != drawn);
    for (other, what) in [
        (default().cell(0.25), "cell"),
        (default().cell_size(0.3), "cell_size"),
        (default().spacing(0.4), "spacing"),
        (default().origin([0.1; 3]), "origin"),
        (default().domain([-1.0; 3], [1.0; 3]), "domain"),
        (default().indicator(IndicatorKind::Counting), "indicator"),
        (default().skip_invalid(true), "skip_invalid"),
        (default().method(KernelMethod::ZhuBridson), "method"),
        (default().attributes(["heat"]), "attributes"),
    ] {
        let error = frame.surface_by(&other).unwrap_err();
        let Error::SettingConflict(conflict) = &error else { panic!("{what:?}: {error}") };
        assert_eq!(
            (conflict.setting.name(), &conflict.with),
            (what, &Conflict::Sampled),
            "{error}"
        );
    }
}

#[test]
fn lengths_are_printed_with_readable_digits() {
    for (number, text) in [
        (0.0, "0"),
        (0.05, "0.05"),
        (1.0, "1"),
        (-1.946_808_218_955_993_7, "-1.94681"),
        (17.878_077_719_545_484, "17.8781"),
        (5e-4, "0.0005"),
        (1e-5, "1e-5"),
        (4.999_944e-321, "4.99994e-321"),
        (999_999.7, "1000000"),
        (1_234_567.25, "1234567"),
        (2.5e12, "2.5e12"),
        (f64::INFINITY, "inf"),
    ] {
        assert_eq!(meniscus::error::shown(number), text);
    }
    assert_eq!(meniscus::error::significant(0.060_234_9, 4), "0.06023");
}

#[test]
fn empty_frames_are_errors_alone_but_empty_meshes_in_a_live_simulation() {
    let none: [[f64; 3]; 0] = [];
    let usual = || Reconstruction::new().spacing(0.5).normals(true);
    let error = usual().run(&none).unwrap_err();
    assert_eq!(error.cause(), Cause::Input, "{error}");

    let mut simulation = LiveSimulation::new(&usual().smallest_drop(100)).unwrap();
    let counts =
        |surface: &Surface| [surface.mesh().vertex_count(), surface.mesh().triangle_count()];
    let empty = |surface: &Surface| {
        let mesh = surface.to_mesh().unwrap();
        counts(surface) == [0; 2] && mesh.normals.is_some() && mesh.positions.is_empty()
    };
    // A frame without particles gives an empty mesh, both before and after the calibration is
    // measured.
    assert!(empty(&simulation.frame(&none).unwrap()));
    assert!(!empty(&simulation.frame(&ball()).unwrap()) && simulation.is_settled());
    assert!(empty(&simulation.frame(&none).unwrap()));
    let drop = simulation.frame(&[[0.0; 3]]).unwrap();
    // Particles do not count as lost if an option removed them.
    let left_out = drop.report().too_small.map(|too_small| too_small.drops);
    assert!(empty(&drop) && drop.report().lost == 0 && left_out == Some(1), "{:?}", drop.report());
    let warned =
        |warning: &Warning| matches!(warning, Warning::Empty { why: EmptyReason::TooSmall(_), .. });
    assert!(drop.report().warnings.iter().any(warned), "{:?}", drop.report().warnings);
    // The empty mesh can be written and read.
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("empty.ply");
    drop.write(&path).unwrap();
    assert_eq!(read_mesh(&path).unwrap().triangles.len(), 0);
    // A frame without any valid position still gives an error.
    let error = simulation.frame(&[[f64::NAN; 3]]).unwrap_err();
    assert_eq!(error.cause(), Cause::Input, "{error}");
}

#[test]
#[cfg(target_os = "linux")]
fn stored_surfaces_keep_no_threads_alive() {
    alone("facade::stored_surfaces_keep_no_threads_alive", keep_surfaces_and_count_threads);
}

#[cfg(target_os = "linux")]
fn keep_surfaces_and_count_threads() {
    let threads = || fs::read_dir("/proc/self/task").unwrap().count();
    let ball = ball();
    let one = || Reconstruction::new().spacing(0.5).threads(16).run(&ball).unwrap();
    let surfaces: Vec<Surface> = (0..8).map(|_| one()).collect();
    // The threads end soon after the reconstruction.
    let few = (0..200).any(|_| {
        std::thread::sleep(Duration::from_millis(20));
        threads() < 8 * 16
    });
    assert!(few, "{} threads", threads());
    let [first, last] = [&surfaces[0], &surfaces[7]].map(bytes_of);
    assert!(first == last);
}

#[test]
fn open_particles_gives_positions_attributes_and_the_scene_spacing() {
    let folder = data("dambreak_small");
    let file = meniscus::files::open_particles(
        folder.join("ParticleData_Fluid_20.bgeo"),
        &Settings::default(),
    )
    .unwrap();
    assert_eq!(file.spacing, Some(0.05));
    assert!(
        file.particles.attributes().iter().any(|info| info.is_velocity()),
        "{:?}",
        file.particles.attributes()
    );
    let mut first = [[0.0; 3]];
    file.particles.positions(0, &mut first);
    assert!(first[0].iter().all(|x| x.is_finite()));
    let error = meniscus::files::open_particles(folder.join("frame.unknown"), &Settings::default())
        .unwrap_err();
    assert_eq!(error.cause(), Cause::Request, "{error}");
}

#[test]
fn frames_lists_a_simulation_and_refuses_missing_or_ambiguous_inputs() {
    let dir = TempDir::new().unwrap();
    let write = |name: &str, bytes: &[u8]| fs::write(dir.path().join(name), bytes).unwrap();
    let listed = |input: &str| meniscus::files::frames(&[dir.path().join(input)]);
    for name in ["pool_10.xyz", "pool_9.xyz", "notes.txt"] {
        write(name, &raw(&ball()));
    }
    let numbers =
        |input: &str| listed(input).unwrap().iter().map(|frame| frame.number).collect::<Vec<_>>();
    assert_eq!(numbers(""), [9, 10]);
    // A mesh in the same folder is not a frame.
    Reconstruction::new().run(&ball()).unwrap().write(dir.path().join("mesh_1.ply")).unwrap();
    assert_eq!(
        [numbers(""), numbers("pool_{}.xyz"), numbers("pool_*")],
        [[9, 10], [9, 10], [9, 10]]
    );
    let of_one = listed("pool_9.xyz").unwrap();
    assert_eq!((of_one.len(), &*of_one[0].path), (1, &*dir.path().join("pool_9.xyz")));
    let none = listed("none_{}.xyz").unwrap_err().to_string();
    assert!(none.ends_with("none_{}.xyz: no file matches this pattern"), "{none}");
    write("sand_1.xyz", &raw(&ball()));
    let several = listed("").unwrap_err().to_string();
    assert!(several.contains("pool_{}.xyz (2 frames), sand_{}.xyz (1 frame)"), "{several}");
}

#[test]
fn a_sampled_frame_keeps_the_up_axis_of_its_particles() {
    let dir = TempDir::new().unwrap();
    let file = dir.path().join("ball.xyz");
    fs::write(&file, raw(&ball())).unwrap();
    let up =
        |request: Reconstruction| request.open(&file).unwrap().sample().unwrap().particles_up();
    assert_eq!(up(Reconstruction::new()), UpAxis::Y);
    assert_eq!(up(Reconstruction::new().particles_up(UpAxis::Z)), UpAxis::Z);
}

/// Particles that count how often they are read completely.
struct CountedPasses {
    particles: Vec<[f64; 3]>,
    passes: AtomicUsize,
}

impl Particles for CountedPasses {
    fn len(&self) -> usize {
        self.particles.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        self.particles.as_slice().positions(first, out);
        if first == 0 {
            self.passes.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[test]
fn finding_walls_needs_two_more_passes_over_the_particles() {
    let pool = fill(84.0, 1.0, 0.2, 3, |p| p.y < 0.0 && p.abs().max_element() < 52.0);
    assert!(pool.len() > 1 << 19, "{}", pool.len());
    let passes = |request: Reconstruction| {
        let counted = CountedPasses { particles: pool.clone(), passes: 0.into() };
        let frame = request.spacing(1.0).cell_size(1.0).sample(&counted).unwrap();
        drop(frame);
        counted.passes.into_inner()
    };
    // Usually, the library counts the particles in the pass that checks the spacing. To find walls,
    // it first checks the spacing, then finds the walls, and then counts, in three passes.
    let (plain, sought) =
        (passes(Reconstruction::new()), passes(Reconstruction::new().find_domain()));
    assert_eq!(sought, plain + 2);
}

#[test]
fn cells_too_fine_for_the_estimated_spacing_are_refused_except_in_spray() {
    let ball = fill(14.0, 1.0, 0.2, 3, |p| p.length() < 6.0);
    let cells = |size: f64| Reconstruction::new().cell_size(size);
    let error = cells(0.09).run(&ball).unwrap_err();
    assert!(matches!(error, Error::Frame { fault: FrameError::TooFine(_), .. }), "{error}");
    let fine = cells(0.12).run(&ball).unwrap();
    assert!(fine.report().warnings.iter().all(|w| !matches!(w, Warning::Crowded { .. })));
    // Drops of spray are farther apart than the spacing.
    let spray: Vec<[f64; 3]> = ball.iter().map(|p| p.map(|x| 40.0 * x)).collect();
    let spray: Vec<[f64; 3]> = spray.into_iter().step_by(7).take(60).collect();
    assert!(cells(0.5).run(&spray).is_ok());
}

#[test]
fn particles_are_counted_during_the_spacing_estimate_without_another_pass() {
    let ball = fill(44.0, 2.0, 0.2, 3, |p| p.length() < 21.0);
    assert!(ball.len() > 1 << 18);
    let mut with_nan = ball.clone();
    with_nan[70_000][2] = f64::NAN;
    let usual = || Reconstruction::new().cell_size(0.6);
    let walls = || usual().domain([-20.0, -30.0, -30.0], [30.0; 3]);
    for (particles, request) in
        [(&ball, usual()), (&ball, walls()), (&with_nan, walls().skip_invalid(true))]
    {
        let read = |request: &Reconstruction| {
            let counted = CountedPasses { particles: particles.clone(), passes: 0.into() };
            let surface = request.run(&counted).unwrap();
            (surface, counted.passes.into_inner())
        };
        let (by_estimate, passes) = read(&request);
        let report = by_estimate.report();
        let Some((spacing, SpacingSource::Estimated)) = report.cells.as_ref().unwrap().spacing
        else {
            panic!("the report has no estimated spacing");
        };
        let (by_spacing, fewest) = read(&request.spacing(spacing));
        assert_eq!(passes, fewest);
        assert_eq!(report.facts.census, by_spacing.report().facts.census);
        assert_eq!(report.facts.census.not_finite, usize::from(std::ptr::eq(particles, &with_nan)));
        assert!(by_estimate.to_mesh().unwrap() == by_spacing.to_mesh().unwrap());
    }
    let [estimated, given] =
        [usual(), usual().spacing(0.5)].map(|request| request.run(&with_nan).unwrap_err());
    assert_eq!(estimated.to_string(), given.to_string());
    assert!(given.to_string().contains("70000"), "{given}");
}
