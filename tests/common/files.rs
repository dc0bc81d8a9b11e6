//! Files that tests read, write and look for: the samples, particles and surfaces as bytes, and
//! what a folder holds.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use meniscus::Surface;

/// What lies in `tests/data` by that path.
pub fn data(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(path)
}

/// Particles as in a `.xyz` file of numbers: an f32 for each coordinate, little-endian.
pub fn raw<T: Copy + Into<f64>>(particles: &[[T; 3]]) -> Vec<u8> {
    particles.iter().flatten().flat_map(|&x| (x.into() as f32).to_le_bytes()).collect()
}

/// The bytes of the `.ply` file that a surface is written to.
pub fn bytes_of(surface: &Surface) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.ply");
    surface.write(&path).unwrap();
    fs::read(path).unwrap()
}

/// The names of all that is in a folder, in their order.
pub fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// The bytes of every file in a folder and in those below, by its path from the folder on, with
/// slashes.
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
