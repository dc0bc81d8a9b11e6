//! Tests of inputs and meshes whose number of pieces exceeds the number of files that a process may
//! open.

use std::fs::{self, File, OpenOptions};
use std::io::Write as _;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::Output;

use meniscus::error::{Cause, Error, FrameError, RereadError};
use meniscus::{MemoryBudget, Reconstruction};
use tempfile::TempDir;

use crate::common::files::raw;
use crate::common::{fill, program};

/// Number of pieces, which exceeds [`MAX_OPEN_FILES`].
const PIECES: usize = 700;
const MAX_OPEN_FILES: usize = 256;

fn ball() -> Vec<[f32; 3]> {
    fill(20.0, 2.0, 0.2, 3, |p| p.length() < 10.0).iter().map(|p| p.map(|x| x as f32)).collect()
}

fn piece(folder: &Path, number: usize) -> PathBuf {
    folder.join(format!("ball_{number}.vtp"))
}

/// A ball in one file, and in [`PIECES`] pieces whose raw appended data are read in place.
fn scene() -> (TempDir, PathBuf, PathBuf) {
    let folder = TempDir::new().unwrap();
    let particles = ball();
    let mut list = String::from("<VTKFile type=\"PPolyData\"><PPolyData>\n");
    for (number, own) in particles.chunks(particles.len().div_ceil(PIECES)).enumerate() {
        let head = format!(
            "<VTKFile type=\"PolyData\" byte_order=\"LittleEndian\" header_type=\"UInt64\"><PolyData>\
             <Piece NumberOfPoints=\"{}\"><Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/>\
             </Points></Piece></PolyData><AppendedData encoding=\"raw\">_",
            own.len()
        );
        let length = (12 * own.len() as u64).to_le_bytes();
        let bytes = [head.as_bytes(), &length, &raw(own), b"</AppendedData></VTKFile>"].concat();
        fs::write(piece(folder.path(), number), bytes).unwrap();
        list += &format!("<Piece Source=\"ball_{number}.vtp\"/>\n");
    }
    let [pieces, whole] = ["ball.pvtp", "ball.xyz"].map(|name| folder.path().join(name));
    fs::write(&pieces, list + "</PPolyData></VTKFile>").unwrap();
    fs::write(&whole, raw(&particles)).unwrap();
    assert!(piece(folder.path(), PIECES - 20).exists());
    (folder, pieces, whole)
}

/// Runs the program with a low limit on open files.
fn limited(folder: &Path, arguments: &str) -> Output {
    let arguments = format!("reconstruct {arguments} --backend cpu -q");
    program::in_shell(folder, &format!("ulimit -n {MAX_OPEN_FILES}"), &arguments)
}

#[track_caller]
fn succeeds(output: Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_frame_in_more_pieces_than_open_files_allowed_equals_a_single_file() {
    let (folder, _pieces, _) = scene();
    let folder = folder.path();
    succeeds(limited(folder, "ball.xyz -o one.ply --spacing 0.5"));
    for (number, options) in ["", "--threads 1", "--memory 24MiB --cell 0.3"].iter().enumerate() {
        if number == 2 {
            succeeds(limited(
                folder,
                &format!("ball.xyz -o one.ply --overwrite --spacing 0.5 {options}"),
            ));
        }
        succeeds(limited(
            folder,
            &format!("ball.pvtp -o many.ply --overwrite --spacing 0.5 {options}"),
        ));
        let [one, many] = ["one.ply", "many.ply"].map(|name| fs::read(folder.join(name)).unwrap());
        assert!(one == many, "with {options:?}");
    }
}

#[test]
fn a_mesh_is_merged_from_more_parts_than_open_files_allowed() {
    let (folder, ..) = scene();
    let folder = folder.path();
    succeeds(limited(folder, "ball.xyz -o one.ply --spacing 0.5 --cell 0.3"));
    let common = "ball.pvtp -o many.ply --spacing 0.5 --cell 0.3 --parts 300";
    succeeds(limited(folder, &format!("{common} --plan")));
    let parts = Reconstruction::new().spacing(0.5).cell(0.3).parts(
        folder.join("ball.pvtp"),
        folder.join("many.ply"),
        300,
    );
    (0..300).for_each(|part| drop(parts.part(part).unwrap()));
    succeeds(limited(folder, &format!("{common} --merge")));
    let [one, many] = ["one.ply", "many.ply"].map(|name| fs::read(folder.join(name)).unwrap());
    assert!(one == many);
}

/// Opens a frame, changes some of its pieces, and samples it.
fn sample_after(changed: Range<usize>, change: impl Fn(&Path)) -> Result<u64, Error> {
    let (folder, pieces, _) = scene();
    let opened = Reconstruction::new().spacing(0.5).open(&pieces).unwrap();
    changed.for_each(|number| change(&piece(folder.path(), number)));
    let surface = opened.sample().and_then(|frame| frame.surface());
    surface.map(|surface| surface.mesh().triangle_count()).inspect_err(|error| {
        assert!(error.to_string().starts_with(&format!("{}: ", pieces.display())), "{error}");
        assert_eq!(error.cause(), Cause::Input, "{error}");
    })
}

#[test]
fn a_changed_piece_is_an_error_whether_its_file_is_open_or_closed() {
    let is_changed = |error: &Error| {
        matches!(error, Error::Frame { fault: FrameError::Unread(RereadError::Changed), .. })
    };
    let shorter =
        |path: &Path| OpenOptions::new().write(true).open(path).unwrap().set_len(200).unwrap();
    let longer =
        |path: &Path| OpenOptions::new().append(true).open(path).unwrap().write_all(b"\n").unwrap();
    let later = |path: &Path| {
        let modified =
            fs::metadata(path).unwrap().modified().unwrap() + std::time::Duration::from_secs(1);
        File::options().write(true).open(path).unwrap().set_modified(modified).unwrap();
    };
    // Change pieces that the library may have closed, which are any pieces except the last ones.
    for change in [shorter as fn(&Path), longer, later] {
        for changed in [PIECES / 2, PIECES - 20] {
            assert!(is_changed(&sample_after(changed..changed + 1, change).unwrap_err()));
        }
    }
    // The library cannot keep all of these pieces open, so it opens some of them again.
    let many = 0..MAX_OPEN_FILES;
    // Replace a piece with another file that has the same name, size and time.
    let replaced = |path: &Path| {
        let (bytes, modified) =
            (fs::read(path).unwrap(), fs::metadata(path).unwrap().modified().unwrap());
        let other = path.with_extension("other");
        fs::write(&other, vec![b'x'; bytes.len()]).unwrap();
        File::options().write(true).open(&other).unwrap().set_modified(modified).unwrap();
        fs::rename(other, path).unwrap();
    };
    assert!(is_changed(&sample_after(many.clone(), replaced).unwrap_err()));
    let removed = sample_after(many, |path| fs::remove_file(path).unwrap());
    assert!(matches!(
        removed,
        Err(Error::Frame { fault: FrameError::Unread(RereadError::Io(_)), .. })
    ));
}

#[test]
fn many_pieces_need_no_more_memory_than_a_single_file() {
    let (_folder, pieces, whole) = scene();
    let tight = Reconstruction::new().spacing(0.5).memory(MemoryBudget(1 << 30)).threads(2);
    let memory = |path: &Path| {
        let opened = tight.open(path).unwrap();
        opened.needs(meniscus::files::MeshFormat::Ply).unwrap().unwrap().in_core
    };
    let [one, many] = [&whole, &pieces].map(|path| memory(path));
    assert!(many < one + (1 << 20), "{many} bytes in pieces, {one} in one file");
}
