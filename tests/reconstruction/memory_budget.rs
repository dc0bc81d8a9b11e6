//! Tests of memory budgets: a frame that needs scratch files gives the same mesh, and stays within
//! its budget.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use meniscus::error::{Cause, Error};
use meniscus::internals::brick::{BinPlan, BrickSide, CountingRoom, InvalidParticles};
use meniscus::internals::field::indicator::{PageRule, indicate};
use meniscus::internals::frame::estimate::{Extraction, MemoryEstimate, MemoryPlan};
use meniscus::internals::frame::{
    CountedFrame, Detail, Engine, FrameError, Normals, Resources, Sampling, Surfacing,
};
use meniscus::internals::grid::units::MemoryBudget;
use meniscus::internals::system::timings::Timings;
use tempfile::TempDir;

use crate::common::attributed::Attributed;
use crate::common::files::{names, raw};
use crate::common::program::{command, in_shell, kill_when};
use crate::common::scene::{Random, splash};
use crate::common::{INDICATORS, reconstruct, sampling, splashes, surfacing, tank};

/// Particles with the attributes velocity and temperature.
fn moving(positions: Vec<[f64; 3]>) -> Attributed {
    Attributed::new(positions)
        .with("v", |_, position| {
            let [x, y, z] = position.map(|c| c as f32);
            [-z, 0.1 * y, x]
        })
        .with("temperature", |_, [_, _, z]| [-z as f32])
}

#[test]
fn spilling_particles_field_and_surface_does_not_change_the_mesh() {
    let particles = moving(splashes(31));
    let scratch = TempDir::new().unwrap();
    for indicator in INDICATORS {
        for (carried, walls) in [(vec![], false), (vec![1, 0], false), (vec![0], true)] {
            let mut sampling = Sampling {
                method: indicator.into(),
                side: indicator.brick_side(),
                carried,
                ..sampling()
            };
            sampling.domain = walls.then(|| tank(&sampling.grid));
            let surfacing =
                Surfacing { detail: Detail::Recovered, normals: Normals::Gradient, ..surfacing() };
            let (_, expected) = reconstruct(&particles, &sampling, &surfacing);
            // These budgets are so small that the plan assigns the minimum amount of memory to each
            // use.
            for budget in [1 << 18, 1 << 20, 1 << 22] {
                let resources = Resources::new(MemoryBudget(budget), scratch.path().to_owned());
                let sampling = Sampling { resources, ..sampling.clone() };
                let what =
                    format!("{indicator:?}, {budget} bytes, carrying {:?}", sampling.carried);
                let plan = CountedFrame::of(&particles, &sampling)
                    .unwrap()
                    .estimate()
                    .plan(MemoryBudget(budget));
                assert!(
                    matches!(plan, MemoryPlan::OutOfCore(_)),
                    "{what}: the plan spills nothing"
                );
                let (_, surface) = reconstruct(&particles, &sampling, &surfacing);
                assert_eq!(surface.iso, expected.iso, "{what}");
                assert!(surface.mesh.positions == expected.mesh.positions, "{what}: positions");
                assert!(surface.mesh.triangles == expected.mesh.triangles, "{what}: triangles");
                assert!(surface.mesh.normals == expected.mesh.normals, "{what}: normals");
                assert!(surface.mesh == expected.mesh, "{what}: attributes");
            }
        }
    }
    assert_eq!(fs::read_dir(scratch.path()).unwrap().count(), 0, "scratch files remain");
}

#[test]
fn wide_attributes_match_narrow_ones_and_need_little_more_memory() {
    const WIDE: usize = 100;
    let narrow = |_, position: [f64; 3]| position.map(|c| c as f32);
    let wide = |_, position: [f64; 3]| std::array::from_fn(|i| position[i % 3] as f32);
    let particles = Attributed::new(splashes(32))
        .with("narrow", narrow)
        .with::<WIDE>("wide", wide)
        .with::<1000>("wider", |_, _| [1.0; 1000]);
    let carrying = |carried| Sampling { carried, ..sampling() };
    let (_, surface) = reconstruct(&particles, &carrying(vec![0, 1]), &surfacing());
    let [narrow, wide] = &surface.mesh.attributes[..] else { panic!("expected two attributes") };
    for (of_narrow, of_wide) in narrow.values.chunks(3).zip(wide.values.chunks(WIDE)) {
        assert!(of_wide.iter().enumerate().all(|(i, value)| *value == of_narrow[i % 3]));
    }
    // With more components, vertex attributes need more memory, but smoothing in the threads does
    // not.
    let meshing = |carried| {
        let sampling = carrying(carried);
        CountedFrame::for_surface(&particles, &sampling, &surfacing(), None)
            .unwrap()
            .estimate()
            .meshing
    };
    let threads = rayon::current_num_threads() as u64;
    assert!(meshing(vec![2]) - meshing(vec![0]) < threads * (256 << 20));
}

#[test]
fn attributes_too_wide_for_the_budget_are_refused_before_the_work() {
    let particles = Attributed::new(splashes(33)).with::<20_000>("wide", |_, _| [0.5; 20_000]);
    let small = Resources::new(MemoryBudget(16 << 20), std::env::temp_dir());
    let sampling = Sampling { carried: vec![0], resources: small, ..sampling() };
    let refused = CountedFrame::for_surface(&particles, &sampling, &surfacing(), None).map(drop);
    let Err(FrameError::WideAttributes { components, needed, budget }) = refused else {
        panic!("{refused:?}")
    };
    assert_eq!((components, budget), (20_000, 16 << 20));
    assert!(needed >= 2 * 1024 * 4 * 20_000, "{needed}");
}

#[test]
fn spray_is_stored_sparsely_within_the_estimated_memory() {
    let (mut random, grid) = (Random::new(5), sampling().grid);
    let spray: Vec<[f64; 3]> = (0..500).map(|_| [(); 3].map(|()| 160.0 * random.unit())).collect();
    for (particles, all_sparse) in [(splashes(6), false), (spray, true)] {
        for (indicator, side) in INDICATORS
            .into_iter()
            .flat_map(|i| [BrickSide::Eight, BrickSide::Sixteen].map(|side| (i, side)))
        {
            // The spacing, in cells, at which the average cell contains two particles.
            let spacing_cells = 2_f64.cbrt().recip();
            let rule = PageRule { indicator, spacing_cells, side, walls: None };
            let plan = BinPlan::count(
                &particles,
                &grid,
                None,
                InvalidParticles::Refuse,
                CountingRoom::BINS,
            );
            let plan = plan.unwrap();
            let extraction = Extraction {
                block_bytes: 4 * 41_u64.pow(3),
                carried_halo: 3,
                levels: 1,
                keeps_details: false,
                spacing_cells: None,
                wide_levels: 0,
                normals: false,
                components: Vec::new(),
            };
            let counted = plan.keys().iter().copied().zip(plan.counts());
            let estimate =
                MemoryEstimate::of(counted, Some(rule.shape()), &extraction, 0, |_| true);
            let bins = plan.fill(&particles, &[]).unwrap();
            let pages = indicate(&bins, 0..bins.keys().len(), &rule).unwrap();
            let (mut taken, mut sparse) = (0, 0);
            for (info, samples) in &pages {
                let all = samples.dense(rule.shape());
                let nonzero = all.iter().filter(|&&sample| sample > 0).count();
                let few = side == BrickSide::Sixteen && nonzero <= all.len() / 8;
                assert_eq!(
                    samples.bytes(),
                    if few { 4 * nonzero } else { 2 * all.len() },
                    "{rule:?}"
                );
                assert!(samples.bytes() <= info.most_bytes(rule.shape()), "{rule:?}, {info:?}");
                taken += samples.bytes() as u64;
                sparse += usize::from(few);
            }
            assert!(
                taken <= estimate.field,
                "{rule:?}: {taken} bytes, {} estimated",
                estimate.field
            );
            if side == BrickSide::Sixteen {
                assert_eq!(
                    sparse == pages.len(),
                    all_sparse,
                    "{rule:?}: {sparse} of {}",
                    pages.len()
                );
                assert_ne!(sparse, 0, "{rule:?}");
            }
        }
    }
}

/// The peak memory, in bytes, that a run recorded in the file `stats`.
fn peak(folder: &Path) -> u64 {
    let stats = fs::read_to_string(folder.join("stats")).unwrap();
    let stats: serde_json::Value = serde_json::from_str(stats.lines().last().unwrap()).unwrap();
    stats["peak_resident_bytes"].as_u64().unwrap()
}

/// A folder with 600 000 particles at spacing 1 (`splash.xyz`), and their surface (`whole.ply`).
fn folder_with_splash() -> TempDir {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("splash.xyz"), raw(&splash(600_000, 3))).unwrap();
    let run = in_shell(folder.path(), "", "reconstruct splash.xyz -o whole.ply --cell-size 1");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    folder
}

#[test]
fn a_budget_of_16_mib_gives_the_same_mesh_and_leaves_no_scratch_files() {
    let folder = folder_with_splash();
    let arguments =
        "reconstruct splash.xyz -o small.ply --cell-size 1 --memory 16MiB --stats stats";
    let run = in_shell(folder.path(), "", arguments);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let bytes = |name| fs::read(folder.path().join(name)).unwrap();
    assert!(bytes("whole.ply") == bytes("small.ply"));
    assert_eq!(names(folder.path()), ["small.ply", "splash.xyz", "stats", "whole.ply"]);
}

#[test]
fn a_full_scratch_folder_exits_with_4_and_leaves_no_files() {
    let folder = folder_with_splash();
    // A limit on the size of files simulates a full disk. With the small limit, particles cannot be
    // spilled. With the large limit, the mesh cannot be written.
    for kib in [64, 3600] {
        let limits = format!("trap '' XFSZ; ulimit -f {kib}");
        let run = in_shell(
            folder.path(),
            &limits,
            "reconstruct splash.xyz -o out.obj --cell-size 1 --memory 16MiB",
        );
        let errors = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(4), "{kib} KiB: {errors}");
        assert_eq!(names(folder.path()), ["splash.xyz", "whole.ply"], "{kib} KiB");
    }
    let run = in_shell(
        folder.path(),
        "",
        "reconstruct splash.xyz -o out.ply --cell-size 1 --memory 16MiB --scratch /proc",
    );
    assert_eq!(run.status.code(), Some(4), "{}", String::from_utf8_lossy(&run.stderr));
    let missing = "reconstruct splash.xyz -o out.ply --cell-size 1 --scratch no";
    for arguments in [missing.to_owned(), format!("{missing} --dry-run")] {
        let run = in_shell(folder.path(), "", &arguments);
        let errors = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(2), "{errors}");
        assert!(errors.contains("does not exist"), "{errors}");
    }
    let run = in_shell(folder.path(), "", &missing.replace("--scratch no", "--scratch splash.xyz"));
    let errors = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(2), "{errors}");
    assert!(errors.contains("splash.xyz: is not a folder"), "{errors}");
}

#[test]
fn a_frame_that_is_mostly_surface_stays_within_the_budget() {
    let (folder, mut random) = (TempDir::new().unwrap(), Random::new(7));
    // Fill 5^3 blocks with spray, which has a large surface.
    let coordinates = (0..450_000).flat_map(|_| (160.0 * random.unit() as f32).to_le_bytes());
    fs::write(folder.path().join("spray.xyz"), coordinates.collect::<Vec<u8>>()).unwrap();
    let reconstruct = |arguments: &str| {
        let fixed = "reconstruct spray.xyz --spacing 1 --cell-size 1 --threads 2 --backend cpu";
        let run = in_shell(folder.path(), "", &format!("{fixed} --overwrite {arguments}"));
        assert!(run.status.success(), "{arguments}: {}", String::from_utf8_lossy(&run.stderr));
        String::from_utf8(run.stdout).unwrap()
    };
    // Measure the memory of the program itself, which is mostly code and not part of the budget.
    fs::write(folder.path().join("drop.xyz"), [0; 12]).unwrap();
    let drop =
        "reconstruct drop.xyz -o drop.ply --spacing 1 --cell-size 1 --threads 2 --stats stats";
    assert!(in_shell(folder.path(), "", drop).status.success());
    let own = peak(folder.path());
    fs::remove_file(folder.path().join("stats")).unwrap();
    for normals in ["", "--normals"] {
        reconstruct(&format!("{normals} -o whole.ply --stats stats"));
        let whole = peak(folder.path());
        fs::remove_file(folder.path().join("stats")).unwrap();
        let plan = reconstruct(&format!("{normals} -o whole.ply --dry-run"));
        let (before, _) = plan.split_once(" MiB without scratch files").unwrap();
        let estimate: f64 = before.rsplit_once('(').unwrap().1.parse().unwrap();
        let budget = (0.6 * estimate * 1048576.0) as u64;
        reconstruct(&format!("{normals} -o small.ply --memory {budget}B --stats stats"));
        let peak = peak(folder.path());
        let allowed = own + budget + (2 << 20);
        assert!(
            peak < allowed && allowed < whole,
            "{normals}: {peak} bytes, {allowed} allowed, {whole} without"
        );
        let bytes = |name| fs::read(folder.path().join(name)).unwrap();
        assert!(bytes("whole.ply") == bytes("small.ply"), "{normals} under {budget} bytes");
        fs::remove_file(folder.path().join("stats")).unwrap();
    }
}

/// The total size, in bytes, of the unnamed files in `scratch` that a process has opened.
#[cfg(target_os = "linux")]
fn scratch_bytes(child: &Child, scratch: &Path) -> u64 {
    let Ok(open) = fs::read_dir(format!("/proc/{}/fd", child.id())) else { return 0 };
    let is_scratch = |path: &Path| fs::read_link(path).is_ok_and(|file| file.starts_with(scratch));
    let files = open.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| is_scratch(path));
    files.filter_map(|path| Some(fs::metadata(path).ok()?.len())).sum()
}

#[test]
#[cfg(target_os = "linux")]
fn a_killed_run_leaves_no_scratch_files_and_can_be_repeated() {
    let folder = folder_with_splash();
    let scratch = folder.path().canonicalize().unwrap().join("scratch");
    fs::create_dir(&scratch).unwrap();
    let arguments = "reconstruct splash.xyz -o out.ply --cell-size 1 --memory 16MiB --scratch scratch --overwrite";
    let start = || {
        let mut command = command(folder.path(), &[]);
        command.args(arguments.split(' ')).stderr(Stdio::null()).spawn().unwrap()
    };
    let (mut child, mut most) = (start(), 0);
    while child.try_wait().unwrap().is_none() {
        most = most.max(scratch_bytes(&child, &scratch));
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(most > 1 << 20, "{most} bytes of scratch");
    for eighths in 0..6 {
        let least = (most / 8 * eighths).max(1);
        let what = format!("{least} of {most} bytes of scratch");
        kill_when(start(), &what, |child| scratch_bytes(child, &scratch) >= least);
        assert_eq!(names(&scratch), [""; 0], "scratch files remain");
    }
    fs::remove_file(folder.path().join("out.ply")).unwrap();
    let run = in_shell(folder.path(), "", arguments);
    assert!(run.status.success());
    let bytes = |name| fs::read(folder.path().join(name)).unwrap();
    assert!(bytes("whole.ply") == bytes("out.ply"));
}

#[test]
fn a_packed_frame_gives_the_mesh_of_its_particles_with_any_filter() {
    let folder = folder_with_splash();
    let run = |arguments: &str| {
        let run = in_shell(folder.path(), "", arguments);
        assert!(run.status.success(), "{arguments}: {}", String::from_utf8_lossy(&run.stderr));
        run
    };
    let [paper, clouds] = [
        &["", "--sigma 1.5 --detail", "--sigma 0.8 --iso 0.2 --normals", "--memory 16MiB"],
        &["", "--smooth 0.9", "--smooth 2.5 --normals", "--memory 16MiB --smooth 4"],
    ];
    for (indicator, filters) in [("cloud", clouds), ("symmetry", paper), ("counting", paper)] {
        run(&format!(
            "pack splash.xyz -o packed.mnf --cell-size 1 --indicator {indicator} --overwrite"
        ));
        run(&format!(
            "pack splash.xyz -o small.mnf --cell-size 1 --indicator {indicator} --overwrite --memory 16MiB"
        ));
        let bytes = |name| fs::read(folder.path().join(name)).unwrap();
        assert!(bytes("packed.mnf") == bytes("small.mnf"), "{indicator}");
        for filter in filters {
            run(&format!(
                "reconstruct splash.xyz -o a.ply --cell-size 1 --indicator {indicator} --overwrite {filter}"
            ));
            run(&format!("reconstruct packed.mnf -o b.ply --overwrite {filter}"));
            assert!(bytes("a.ply") == bytes("b.ply"), "{indicator} {filter}");
        }
    }
    let info = run("info packed.mnf --json");
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(info[0]["kind"], "frame");
    assert_eq!(info[0]["indicator"], "counting");
    let refused = in_shell(folder.path(), "", "reconstruct packed.mnf -o c.ply --cell-size 1");
    assert_eq!(refused.status.code(), Some(2));
}

#[test]
fn a_large_gzipped_input_is_decompressed_through_scratch_files() {
    let folder = folder_with_splash();
    let packed =
        Command::new("gzip").current_dir(folder.path()).args(["-1", "-k", "splash.xyz"]).status();
    assert!(packed.unwrap().success());
    let arguments = "reconstruct splash.xyz.gz -o small.ply --cell-size 1 --memory 16MiB";
    let run = in_shell(folder.path(), "", arguments);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let bytes = |name| fs::read(folder.path().join(name)).unwrap();
    assert!(bytes("whole.ply") == bytes("small.ply"));
    assert_eq!(names(folder.path()), ["small.ply", "splash.xyz", "splash.xyz.gz", "whole.ply"]);
    // The exit code is 4 if there is no space for the decompressed data, and 3 for a truncated
    // input.
    let full = in_shell(
        folder.path(),
        "trap '' XFSZ; ulimit -f 1024",
        &arguments.replace("small", "full"),
    );
    assert_eq!(full.status.code(), Some(4), "{}", String::from_utf8_lossy(&full.stderr));
    let cut = bytes("splash.xyz.gz");
    fs::write(folder.path().join("cut.xyz.gz"), &cut[..cut.len() - 1000]).unwrap();
    let cut = in_shell(
        folder.path(),
        "",
        "reconstruct cut.xyz.gz -o cut.ply --cell-size 1 --memory 16MiB",
    );
    assert_eq!(cut.status.code(), Some(3), "{}", String::from_utf8_lossy(&cut.stderr));
    assert_eq!(
        names(folder.path()),
        ["cut.xyz.gz", "small.ply", "splash.xyz", "splash.xyz.gz", "whole.ply"]
    );
}

#[test]
fn a_frame_that_fits_its_budget_uses_no_scratch_files() {
    let folder = folder_with_splash();
    let arguments = "reconstruct splash.xyz -o out.ply --cell-size 1 --memory 1GiB --scratch /proc";
    let run = in_shell(folder.path(), "", arguments);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
}

/// A folder with 1.5 million particles as a table, a .ply file and a .vtk file, and with their
/// surface in `whole.ply`. Each particle file contains about 45 MB of text.
fn folder_with_texts() -> TempDir {
    let folder = TempDir::new().unwrap();
    let lines: Vec<String> =
        splash(1_500_000, 3).iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    let n = lines.len();
    let ply = format!(
        "element vertex {n}\nproperty float x\nproperty float y\nproperty float z\nend_header"
    );
    for (name, head) in [
        ("splash.csv", "x y z".to_owned()),
        ("splash.ply", format!("ply\nformat ascii 1.0\n{ply}")),
        (
            "splash.vtk",
            format!(
                "# vtk DataFile Version 3.0\nsplash\nASCII\nDATASET POLYDATA\nPOINTS {n} float"
            ),
        ),
    ] {
        fs::write(folder.path().join(name), format!("{head}\n{}", lines.concat())).unwrap();
    }
    let run = in_shell(folder.path(), "", "reconstruct splash.csv -o whole.ply --cell-size 1");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    folder
}

#[test]
fn text_inputs_larger_than_the_budget_are_read_within_it() {
    let folder = folder_with_texts();
    let bytes = |name: &str| fs::read(folder.path().join(name)).unwrap();
    for name in ["splash.csv", "splash.ply", "splash.vtk"] {
        let arguments = format!(
            "reconstruct {name} -o small.ply --cell-size 1 --memory 16MiB --threads 2 --backend cpu \
             --stats stats --overwrite"
        );
        let run = in_shell(folder.path(), "", &arguments);
        assert!(run.status.success(), "{name}: {}", String::from_utf8_lossy(&run.stderr));
        assert!(bytes("whole.ply") == bytes("small.ply"), "{name}");
        // The peak includes the mapped program file, which is larger in a build without
        // optimization.
        let peak = peak(folder.path());
        assert!(peak < 32 << 20, "{name}: {peak} bytes, of a file of {}", bytes(name).len());
        let full = in_shell(
            folder.path(),
            "trap '' XFSZ; ulimit -f 4096",
            &arguments.replace("small", "full"),
        );
        let errors = String::from_utf8_lossy(&full.stderr);
        assert_eq!(full.status.code(), Some(4), "{name}: {errors}");
        assert!(errors.contains("scratch"), "{name}: {errors}");
    }
    let left = ["small.ply", "splash.csv", "splash.ply", "splash.vtk", "stats", "whole.ply"];
    assert_eq!(names(folder.path()), left);
}

#[test]
fn a_frame_too_large_for_any_memory_is_refused_before_the_work() {
    let mut particles = moving(splashes(31));
    // Use attributes that would need exbibytes, but are never read.
    particles.attributes[0].components = 1 << 36;
    let scratch = TempDir::new().unwrap();
    let resources = Resources::new(MemoryBudget(1 << 20), scratch.path().to_owned());
    let sampling = Sampling { resources, carried: vec![0], ..sampling() };
    let fault =
        Engine::sample(&particles, &sampling, &mut Timings::default()).expect_err("too wide");
    let FrameError::WideAttributes { components, needed, budget } = fault else {
        panic!("{fault}")
    };
    assert!(components == 1 << 36 && needed > budget);
    assert_eq!(Error::Frame { path: None, fault }.cause(), Cause::Request);
}
