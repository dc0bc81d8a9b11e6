//! Fuzzes frames in parts: damaged plans and parts, and random particles that are meshed in parts.

use std::fs;
use std::path::PathBuf;
use std::sync::OnceLock;

use meniscus::{Parts, Reconstruction};

use super::{Target, build, folder};

pub fn targets() -> Vec<Target> {
    vec![
        Target {
            name: "part-files",
            runs: 300,
            run: damaged,
            seeds,
            words: &["\"fingerprint\":", "\"parts\": [", "18446744073709551615", "-1", "1e999"],
        },
        Target {
            name: "parts",
            runs: 20,
            run: merged,
            seeds: || vec![vec![3, 0, 7, 9, 1, 2, 3, 200, 201, 202], (0..200).collect()],
            words: &[],
        },
    ]
}

fn request() -> Reconstruction {
    Reconstruction::new().spacing(1.0).cell(1.0).threads(1)
}

/// The names of the files of a plan and its two parts.
const NAMES: [&str; 3] = ["plan.json", "part_0", "part_1"];

fn parts() -> (Parts, PathBuf) {
    let [input, output] = ["in.xyz", "out.ply"].map(folder::path);
    (request().parts(input, output, 2), folder::path("out.ply.meniscus-parts"))
}

/// A frame in two parts, and its mesh.
struct Whole {
    files: [Vec<u8>; 3],
    positions: Vec<[f64; 3]>,
}

fn whole() -> &'static Whole {
    static WHOLE: OnceLock<Whole> = OnceLock::new();
    WHOLE.get_or_init(|| {
        let (parts, files) = fresh();
        let positions = parts.merge().unwrap().to_mesh().unwrap().positions;
        Whole { files: NAMES.map(|name| fs::read(files.join(name)).unwrap()), positions }
    })
}

/// Writes an undamaged plan and its parts into this thread's folder.
fn fresh() -> (Parts, PathBuf) {
    let particles: Vec<[f64; 3]> = (0..30_u32)
        .map(|i| [i % 3, i / 3 % 3, 20 * (i / 15)].map(|c| f64::from(c) * 0.8))
        .collect();
    folder::file("in.xyz", &build::raw(&particles));
    let (parts, files) = parts();
    let parts = parts.overwrite();
    parts.plan().unwrap();
    (0..2).for_each(|part| drop(parts.part(part).unwrap()));
    (parts, files)
}

/// Replaces one of the files with bytes of `data`, and merges the parts. The first byte of `data`
/// selects the file, and whether this function corrects the checksum of a part. If the checksum is
/// correct, the library still checks that the part's lists match its meshes, but trusts the content
/// of the meshes.
fn damaged(data: &[u8]) {
    let Some((choice, data)) = data.split_first() else { return };
    thread_local! {
        static WRITTEN: () = drop(fresh());
    }
    WRITTEN.with(|()| ());
    let Whole { files, positions } = whole();
    let (parts, folder) = parts();
    let which = usize::from(choice & 3) % NAMES.len();
    let mut bytes = data.to_vec();
    if choice & 4 != 0 && which > 0 && bytes.len() > 4 {
        let end = bytes.len() - 4;
        let sum = crc32fast::hash(&bytes[..end]);
        bytes[end..].copy_from_slice(&sum.to_le_bytes());
    }
    fs::write(folder.join(NAMES[which]), &bytes).unwrap();
    match parts.merge() {
        // The mesh may differ only if the checksum was corrected.
        Ok(surface) => {
            let mesh = surface.to_mesh();
            if choice & 4 == 0 {
                assert!(mesh.unwrap().positions == *positions, "damaged parts gave another mesh");
            }
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    fs::write(folder.join(NAMES[which]), &files[which]).unwrap();
}

fn seeds() -> Vec<Vec<u8>> {
    let files = &whole().files;
    [(0, 0_u8), (1, 1), (2, 2), (1, 5), (2, 6)]
        .map(|(file, choice): (usize, u8)| [&[choice][..], &files[file]].concat())
        .to_vec()
}

/// Meshes random particles in one to six parts. The mesh must equal the mesh of a single run, or
/// both must fail with the same cause.
fn merged(data: &[u8]) {
    let Some(([count, scale], data)) = data.split_first_chunk::<2>() else { return };
    let scale = [0.02, 0.1, 1.0, 40.0][usize::from(scale & 3)];
    let particles: Vec<[f64; 3]> = data
        .as_chunks::<3>()
        .0
        .iter()
        .take(60)
        .map(|p| p.map(|c| (f64::from(c) - 128.0) * scale))
        .collect();
    let input = folder::file("random.xyz", &build::raw(&particles));
    let parts =
        request().parts(&input, folder::path("random.ply"), u32::from(count % 6) + 1).overwrite();
    let single = request().run_file(&input);
    let merged = parts.plan().and_then(|planned| {
        (0..planned.parts.len() as u32).rev().try_for_each(|part| parts.part(part).map(drop))?;
        parts.merge()
    });
    match (single, merged) {
        (Ok(single), Ok(merged)) => {
            assert!(single.to_mesh().unwrap() == merged.to_mesh().unwrap(), "the meshes differ")
        }
        (Err(single), Err(merged)) => {
            assert_eq!(single.cause(), merged.cause(), "{single} and {merged}")
        }
        (single, merged) => {
            panic!("{:?} and {:?}", single.map(|_| "a mesh"), merged.map(|_| "a mesh"))
        }
    }
    let _ = fs::remove_dir_all(parts.folder());
}
