//! Tests of inputs that change while they are read: the frame fails with an error that names the
//! file. No signal ends the process, and no wrong mesh is returned.

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use meniscus::error::{Cause, Error, FrameError, RereadError};
use meniscus::{MemoryBudget, Particles, Reconstruction};
use tempfile::TempDir;

use crate::common::files::raw;
use crate::common::{fill, program};

/// A ball of particles at spacing 0.5.
fn ball() -> Vec<[f64; 3]> {
    fill(20.0, 2.0, 0.2, 3, |p| p.length() < 10.0)
}

fn written(folder: &TempDir) -> PathBuf {
    let path = folder.path().join("ball.xyz");
    fs::write(&path, raw(&ball())).unwrap();
    path
}

/// Opens a frame, changes its file, and returns the error of the frame.
fn error_after(change: impl FnOnce(&Path)) -> Error {
    let folder = TempDir::new().unwrap();
    let path = written(&folder);
    let opened = Reconstruction::new().spacing(0.5).open(&path).unwrap();
    change(&path);
    let error = opened.sample().expect_err("the input has changed");
    assert!(error.to_string().starts_with(&format!("{}: ", path.display())), "{error}");
    assert_eq!(error.cause(), Cause::Input, "{error}");
    error
}

fn is_changed(error: &Error) -> bool {
    matches!(error, Error::Frame { fault: FrameError::Unread(RereadError::Changed), .. })
}

#[test]
fn a_truncated_input_is_an_error_instead_of_a_signal() {
    for left in [0, 1, 4096, 12 * 1000 + 5] {
        let error = error_after(|path| {
            OpenOptions::new().write(true).open(path).unwrap().set_len(left).unwrap()
        });
        assert!(is_changed(&error), "{left} bytes: {error}");
    }
}

#[test]
fn an_input_that_grows_or_is_rewritten_is_an_error() {
    let error = error_after(|path| {
        OpenOptions::new().append(true).open(path).unwrap().write_all(&[0; 12]).unwrap()
    });
    assert!(is_changed(&error), "{error}");
    // Write the same bytes again, so that only the file's time changes.
    let error = error_after(|path| {
        let bytes = fs::read(path).unwrap();
        let modified = fs::metadata(path).unwrap().modified().unwrap();
        let mut file = File::options().write(true).open(path).unwrap();
        file.write_all(&bytes).unwrap();
        file.set_modified(modified + Duration::from_secs(1)).unwrap();
    });
    assert!(is_changed(&error), "{error}");
}

#[test]
fn an_input_replaced_by_a_rename_is_read_from_the_original_file() {
    let folder = TempDir::new().unwrap();
    let path = written(&folder);
    let request = Reconstruction::new().spacing(0.5);
    let opened = request.open(&path).unwrap();
    let later = folder.path().join("later.xyz");
    fs::write(&later, [0; 12]).unwrap();
    fs::rename(&later, &path).unwrap();
    let surface = opened.sample().unwrap().surface().unwrap();
    let whole = request.run(&ball()[..]).unwrap();
    assert_eq!(surface.mesh().triangle_count(), whole.mesh().triangle_count());
}

/// Writes the same particles in formats that must be decoded: text, encoded or compressed.
fn decoded_formats(folder: &Path) -> Vec<PathBuf> {
    let particles = fill(40.0, 2.0, 0.2, 3, |p| p.length() < 20.0);
    let count = particles.len();
    let rows = |separator: &str| {
        particles
            .iter()
            .map(|p| p.map(|x| x.to_string()).join(separator))
            .collect::<Vec<_>>()
            .join("\n")
    };
    let blanks = rows(" ");
    let ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\nproperty double x\nproperty double y\nproperty double z\nend_header\n{blanks}\n"
    );
    let vtk = format!(
        "# vtk DataFile Version 3.0\nball\nASCII\nDATASET POLYDATA\nPOINTS {count} double\n{blanks}\n"
    );
    let vtp = format!(
        "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"{count}\"><Points>\
         <DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"ascii\">{blanks}</DataArray>\
         </Points></Piece></PolyData></VTKFile>\n"
    );
    let files = [
        ("ball.csv", rows(",")),
        ("ball.xyz", blanks),
        ("ball.ply", ply),
        ("ball.vtk", vtk),
        ("ball.vtp", vtp),
    ];
    files
        .map(|(name, text)| {
            let path = folder.join(name);
            fs::write(&path, text).unwrap();
            path
        })
        .to_vec()
}

/// The number of bytes that a process has read from all files. Returns `u64::MAX` if the system
/// does not count them.
fn bytes_read(child: &Child) -> u64 {
    let counts = fs::read_to_string(format!("/proc/{}/io", child.id())).unwrap_or_default();
    let read = counts.lines().find_map(|line| line.strip_prefix("rchar: "));
    read.map_or(u64::MAX, |read| read.parse().unwrap())
}

#[test]
fn truncating_an_input_during_decoding_is_an_error_or_has_no_effect() {
    let folder = TempDir::new().unwrap();
    let mut changed = 0;
    for path in decoded_formats(folder.path()) {
        let whole = fs::read(&path).unwrap();
        let mut command = program::command(folder.path(), &["info"]);
        let command = command.arg(&path).stdout(Stdio::null()).stderr(Stdio::piped());
        assert!(command.output().unwrap().status.success(), "{}", path.display());
        for step in 0..8 {
            fs::write(&path, &whole).unwrap();
            let mut child = command.spawn().unwrap();
            let eighths = whole.len() as u64 / 8 * step;
            while bytes_read(&child) < eighths && child.try_wait().unwrap().is_none() {
                std::thread::sleep(Duration::from_millis(1));
            }
            let file = OpenOptions::new().write(true).open(&path).unwrap();
            file.set_len([0, whole.len() as u64 / 3][step as usize % 2]).unwrap();
            let output = child.wait_with_output().unwrap();
            let errors = String::from_utf8(output.stderr).unwrap();
            assert!(
                matches!(output.status.code(), Some(0 | 3)),
                "{} {:?}: {errors}",
                path.display(),
                output.status
            );
            assert!(errors.is_empty() || errors.contains("ball."), "{errors}");
            changed += i32::from(errors.contains("changed while it was being read"));
        }
    }
    assert!(changed > 0, "no file was shortened while it was read");
}

/// Particles that stay the same for the first `stable_passes` passes. In all later passes, the
/// first particle is displaced by the vector `by`.
struct Unstable {
    particles: Vec<[f64; 3]>,
    stable_passes: usize,
    passes: AtomicUsize,
    by: [f64; 3],
}

impl Particles for Unstable {
    fn len(&self) -> usize {
        self.particles.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        out.copy_from_slice(&self.particles[first..first + out.len()]);
        if first == 0 && self.passes.fetch_add(1, Ordering::Relaxed) >= self.stable_passes {
            (0..3).for_each(|axis| out[0][axis] += self.by[axis]);
        }
    }
}

#[test]
fn a_particle_that_changes_its_bin_between_two_passes_is_an_error() {
    // The particle moves to an existing bin, to an empty bin, or out of all bins.
    for by in [[9.0, 0.0, 0.0], [1e4, 0.0, 0.0], [f64::NAN, 0.0, 0.0]] {
        for budget in [MemoryBudget(1 << 30), MemoryBudget(32 << 20)] {
            let particles = fill(60.0, 2.0, 0.2, 3, |p| p.length() < 24.0);
            // Use enough cells that the library does not keep the positions after the first pass,
            // but reads them again.
            let request = Reconstruction::new().spacing(0.5).cell(0.15).memory(budget);
            let unstable = |stable_passes| Unstable {
                particles: particles.clone(),
                stable_passes,
                passes: 0.into(),
                by,
            };
            let stable = unstable(usize::MAX);
            request.sample(&stable).unwrap();
            let passes = stable.passes.into_inner();
            assert!(passes >= 2, "{passes} passes under {budget:?}");
            let error = request.sample(&unstable(passes - 1)).expect_err("a particle has moved");
            assert!(is_changed(&error), "{by:?} under {budget:?}: {error}");
        }
    }
}
