//! Files for the tests: the data in `tests/data`, particles and meshes as bytes, and the contents
//! of folders.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use meniscus::Surface;
use meniscus::mesh::Mesh;

/// The file or folder in `tests/data` with this path.
pub fn data(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(path)
}

/// Particles as a binary `.xyz` file: a little-endian f32 for each coordinate.
pub fn raw<T: Copy + Into<f64>>(particles: &[[T; 3]]) -> Vec<u8> {
    particles.iter().flatten().flat_map(|&x| (x.into() as f32).to_le_bytes()).collect()
}

/// A mesh as the text of a `.obj` file.
pub fn text_of_obj(mesh: &Mesh) -> String {
    let mut text = String::new();
    for [x, y, z] in &mesh.positions {
        writeln!(text, "v {x} {y} {z}").unwrap();
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| vertex + 1);
        writeln!(text, "f {a} {b} {c}").unwrap();
    }
    text
}

/// The bytes of the `.ply` file of a surface.
pub fn bytes_of(surface: &Surface) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.ply");
    surface.write(&path).unwrap();
    fs::read(path).unwrap()
}

/// The sorted names of a folder's entries.
pub fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// The bytes of every file below a folder. Each key is a file's path relative to the folder, with
/// `/` as separator.
pub fn tree(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for name in names(folder) {
        let path = folder.join(&name);
        if path.is_dir() {
            files.extend(
                tree(&path).into_iter().map(|(inner, bytes)| (format!("{name}/{inner}"), bytes)),
            );
        } else {
            files.insert(name, fs::read(path).unwrap());
        }
    }
    files
}
