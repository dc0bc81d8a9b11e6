//! Tests `--watch` with frames in pieces: the program reads the pieces while a simulation writes
//! them, and converts no incomplete frame.

use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};
use std::thread::sleep;
use std::time::Duration;

use tempfile::TempDir;

use crate::common::program::command;
use crate::common::{files, fill};

/// The first or the second piece of a frame: half of a ball.
fn piece(half: usize) -> Vec<u8> {
    let inside = |p: glam::DVec3| p.length() < 4.0 && (p.x < 0.0) == (half == 0);
    let particles = fill(8.0, 2.0, 0.2, 3, inside);
    let numbers: Vec<String> = particles.iter().flatten().map(f64::to_string).collect();
    let text = format!(
        "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"{}\"><Points>\
         <DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"ascii\">{}</DataArray>\
         </Points></Piece></PolyData></VTKFile>\n",
        particles.len(),
        numbers.join(" ")
    );
    text.into_bytes()
}

fn write_pieces(folder: &Path, frame: u64) {
    (0..2).for_each(|half| {
        fs::write(folder.join(format!("f_{frame}_{half}.vtp")), piece(half)).unwrap()
    });
}

fn write_index(folder: &Path, frame: u64) {
    let pieces = [0, 1].map(|half| format!("<Piece Source=\"f_{frame}_{half}.vtp\"/>")).concat();
    let text = format!("<VTKFile type=\"PPolyData\"><PPolyData>{pieces}</PPolyData></VTKFile>\n");
    fs::write(folder.join(format!("f_{frame}.pvtp")), text).unwrap();
}

fn start(folder: &Path, input: &str, more: &[&str]) -> Child {
    let usual = ["reconstruct", input, "-o", "out/m_{}.ply", "--spacing", "0.5", "-q"];
    command(folder, &usual)
        .args(["--backend", "cpu"])
        .args(more)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// The meshes that exist when the program ends.
#[track_caller]
fn meshes(child: Child, folder: &Path) -> Vec<String> {
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    files::names(&folder.join("out")).into_iter().filter(|name| name.starts_with("m_")).collect()
}

#[test]
fn pieces_written_before_their_index_are_not_frames() {
    // At first there is no index, so the program cannot tell which files are pieces.
    for input in ["in", "in/f*"] {
        let folder = TempDir::new().unwrap();
        let sim = folder.path().join("in");
        fs::create_dir(&sim).unwrap();
        (1..=2).for_each(|frame| write_pieces(&sim, frame));
        let child = start(folder.path(), input, &["--watch=30", "--end", "3"]);
        // Wait for longer than the time after which a file counts as complete.
        sleep(Duration::from_millis(1800));
        (1..=2).for_each(|frame| write_index(&sim, frame));
        write_pieces(&sim, 3);
        sleep(Duration::from_millis(1800));
        write_index(&sim, 3);
        assert_eq!(meshes(child, folder.path()), ["m_1.ply", "m_2.ply", "m_3.ply"], "{input}");
    }
}

#[test]
fn pieces_without_an_index_are_recognised_by_another_frames_pieces() {
    let folder = TempDir::new().unwrap();
    (1..=2).for_each(|frame| write_pieces(folder.path(), frame));
    write_index(folder.path(), 1);
    for (input, more) in
        [(".", &[][..]), (".", &["--watch=2", "--overwrite"]), ("f*", &["--overwrite"])]
    {
        assert_eq!(
            meshes(start(folder.path(), input, more), folder.path()),
            ["m_1.ply"],
            "{input} {more:?}"
        );
    }
}

#[test]
fn files_named_like_pieces_are_frames_if_no_index_names_them() {
    let folder = TempDir::new().unwrap();
    write_pieces(folder.path(), 7);
    // In a folder, files become frames only after the timeout of --watch. With a pattern, they are
    // frames at once.
    for (input, more) in
        [(".", &["--watch=3"][..]), ("f_7_{}.vtp", &["--watch=30", "--end", "1", "--overwrite"])]
    {
        assert_eq!(
            meshes(start(folder.path(), input, more), folder.path()),
            ["m_0.ply", "m_1.ply"],
            "{input}"
        );
    }
}
