//! Tests that a part reads only the particles near its range of the Morton curve, and detects
//! changes of these particles since the plan was made.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use meniscus::error::{Error, PartsError};
use meniscus::{Parts, PeriodicMesh, Reconstruction};
use tempfile::TempDir;

use crate::common::files::raw;
use crate::common::scene::Random;
use crate::common::shuffle;

/// A pool that is long along x. The particles are sorted by x, as a simulation may sort them.
///
/// Blocks at the sides of the pool have almost no surface. These blocks come first along the Morton
/// curve, and belong to the first part. The last part is at the end of the pool.
fn pool() -> Vec<[f64; 3]> {
    let mut random = Random::new(3);
    let at = |i: usize| [i / 100, i / 10 % 10, i % 10].map(|c| 1.75 + 0.5 * c as f64);
    (0..100_000).map(|i| at(i).map(|x| x + 0.1 * random.unit())).collect()
}

/// A .vtp file that contains only points and their ghost flags, as raw appended data.
fn vtp(particles: &[[f64; 3]], ghosts: &[u8]) -> Vec<u8> {
    let points = raw(particles);
    let mut bytes = format!(
        "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
         <PolyData><Piece NumberOfPoints=\"{}\" NumberOfVerts=\"0\" NumberOfLines=\"0\" NumberOfStrips=\"0\" NumberOfPolys=\"0\">\n\
         <PointData><DataArray type=\"UInt8\" Name=\"vtkGhostType\" format=\"appended\" offset=\"0\"/></PointData>\n\
         <Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"appended\" offset=\"{}\"/></Points>\n\
         </Piece></PolyData>\n<AppendedData encoding=\"raw\">\n_",
        particles.len(),
        8 + ghosts.len(),
    )
    .into_bytes();
    bytes.extend((ghosts.len() as u64).to_le_bytes());
    bytes.extend(ghosts);
    bytes.extend((points.len() as u64).to_le_bytes());
    bytes.extend(points);
    bytes.extend(b"\n</AppendedData>\n</VTKFile>\n");
    bytes
}

/// Writes particles as a .pvtp with this number of pieces. Each piece also contains the first
/// particles of the next piece, as ghosts.
fn in_pieces(folder: &Path, particles: &[[f64; 3]], pieces: usize) -> PathBuf {
    let path = folder.join("pool.pvtp");
    let mut list = String::from("<VTKFile type=\"PPolyData\" version=\"1.0\"><PPolyData>\n");
    let each = particles.len().div_ceil(pieces);
    for (number, own) in particles.chunks(each).enumerate() {
        let next = &particles[((number + 1) * each).min(particles.len())..];
        let ghosts = &next[..next.len().min(100)];
        let flags: Vec<u8> = own.iter().map(|_| 0).chain(ghosts.iter().map(|_| 1)).collect();
        fs::write(piece(folder, number), vtp(&[own, ghosts].concat(), &flags)).unwrap();
        writeln!(list, "<Piece Source=\"piece_{number}.vtp\"/>").unwrap();
    }
    fs::write(&path, list + "</PPolyData></VTKFile>\n").unwrap();
    path
}

fn piece(folder: &Path, number: usize) -> PathBuf {
    folder.join(format!("piece_{number}.vtp"))
}

fn request() -> Reconstruction {
    Reconstruction::new().spacing(0.5).cell(0.5).threads(2)
}

/// Changes bytes of a file without changing its size or its time.
fn change_silently(path: &Path, change: impl FnOnce(&mut [u8])) {
    let modified = fs::metadata(path).unwrap().modified().unwrap();
    let mut bytes = fs::read(path).unwrap();
    change(&mut bytes);
    fs::write(path, bytes).unwrap();
    File::options().write(true).open(path).unwrap().set_modified(modified).unwrap();
}

/// Makes a part again. Returns the bytes of the part, and the number of particles that were read.
fn made(parts: &Parts, part: u32) -> (Vec<u8>, usize) {
    let _ = fs::remove_file(parts.folder().join(format!("part_{part}")));
    let made = parts.part(part).unwrap();
    assert!(!made.reused);
    (fs::read(made.path).unwrap(), made.read)
}

#[track_caller]
fn assert_refused(parts: &Parts, part: u32) {
    let _ = fs::remove_file(parts.folder().join(format!("part_{part}")));
    let error = parts.part(part).expect_err("the particles of the part have changed");
    assert!(matches!(error, Error::Parts(PartsError::Changed { .. })), "{error}");
}

#[test]
fn a_part_reads_only_the_chunks_of_the_input_that_touch_it() {
    let folder = TempDir::new().unwrap();
    let particles = pool();
    let input = folder.path().join("pool.xyz");
    fs::write(&input, raw(&particles)).unwrap();
    let parts = request().parts(&input, folder.path().join("m.ply"), 8);
    let planned = parts.plan().unwrap();
    let whole: Vec<_> = (0..8).map(|part| made(&parts, part)).collect();
    for (part, (_, read)) in planned.parts.iter().zip(&whole) {
        assert!(
            *read as u64 >= part.kept && *read <= part.kept as usize + 2 * 4096,
            "{read} for {part:?}"
        );
    }
    let least = whole.iter().map(|(_, read)| read).min().unwrap();
    assert!(4 * least < particles.len(), "{least} of {}", particles.len());

    // A part depends only on nearby particles. At the other end of the pool, particles may even be
    // NaN.
    change_silently(&input, |bytes| bytes[..12 * 8192].fill(0xff));
    assert_eq!(made(&parts, 7), whole[7]);
    // A part that depends on the changed particles must give an error.
    assert_refused(&parts, 0);
    change_silently(&input, |bytes| bytes.copy_from_slice(&raw(&particles)));
    assert_eq!(made(&parts, 0), whole[0]);
    // Replace the last particle with a copy of the first, which is at the other end of the pool.
    change_silently(&input, |bytes| bytes.copy_within(..12, 12 * (particles.len() - 1)));
    assert_refused(&parts, 7);
}

#[test]
fn a_part_opens_only_the_pieces_that_touch_it() {
    let folder = TempDir::new().unwrap();
    let particles = pool();
    let input = in_pieces(folder.path(), &particles, 13);
    let parts = request().parts(&input, folder.path().join("m.ply"), 5);
    assert_eq!(parts.plan().unwrap().particles, particles.len());
    let whole: Vec<_> = (0..5).map(|part| made(&parts, part)).collect();
    for number in 0..7 {
        change_silently(&piece(folder.path(), number), |bytes| bytes.fill(b'x'));
    }
    assert_eq!(made(&parts, 4), whole[4]);
    fs::remove_file(parts.folder().join("part_0")).unwrap();
    assert!(parts.part(0).unwrap_err().to_string().contains("piece_0.vtp: "));
    // The input's stamp detects a missing piece, even if the part does not need it.
    fs::remove_file(piece(folder.path(), 0)).unwrap();
    assert_refused(&parts, 4);
}

#[test]
fn merged_parts_equal_a_single_run_for_any_order_and_pieces_of_the_input() {
    let folder = TempDir::new().unwrap();
    let mut particles = pool();
    let single =
        request().run(&particles[..].iter().map(|p| p.map(|x| x as f32)).collect::<Vec<_>>());
    let expected = single.unwrap().to_mesh().unwrap();
    let file = |name: &str, particles: &[[f64; 3]]| {
        let path = folder.path().join(name);
        fs::write(&path, raw(particles)).unwrap();
        path
    };
    let ordered = file("ordered.xyz", &particles);
    let pieces = in_pieces(folder.path(), &particles, 7);
    shuffle(&mut particles, &mut Random::new(9));
    let shuffled = file("shuffled.xyz", &particles);
    for input in [ordered, pieces, shuffled] {
        let parts = request().parts(&input, folder.path().join("m.ply"), 6).overwrite();
        parts.plan().unwrap();
        let read: usize = (0..6).map(|part| made(&parts, part).1).sum();
        assert!(parts.merge().unwrap().to_mesh().unwrap() == expected, "{}", input.display());
        let times = read as f64 / particles.len() as f64;
        let is_shuffled = input.ends_with("shuffled.xyz");
        assert!(
            if is_shuffled { times == 6.0 } else { times < 3.5 },
            "{}: {times}",
            input.display()
        );
    }
}

/// Calm water in a box that is periodic along x and z, sorted by x. The box's length is not a whole
/// number of cells.
fn channel() -> ([f64; 3], Vec<[f64; 3]>) {
    let (edge, mut random) = ([200.2, 0.0, 13.7], Random::new(5));
    let particle = |i: usize| {
        let at = [i / 224, i / 28 % 8, i % 28].map(|c| c as f64 + 0.5);
        let at = [at[0] * edge[0] / 403.0, 0.5 * at[1], at[2] * edge[2] / 28.0];
        at.map(|x| x + 0.1 * random.unit())
    };
    let mut particles: Vec<_> = (0..403 * 224).map(particle).collect();
    // Add rows of particles on two faces of the box, with no other particles nearby.
    particles.extend((0..20).map(|i| [200.2, 14.0, 0.4 * f64::from(i)]));
    particles.extend((0..50).map(|i| [f64::from(i), 18.0, 13.7]));
    // Add a row of particles outside each of two faces.
    particles.extend((0..20).map(|i| [200.45, 22.0, 0.4 * f64::from(i)]));
    particles.extend((0..50).map(|i| [f64::from(i), 26.0, -0.25]));
    (edge, particles)
}

#[test]
fn merged_parts_of_a_periodic_box_equal_a_single_run() {
    let folder = TempDir::new().unwrap();
    let (edge, mut particles) = channel();
    let faces = [Some([0.0, edge[0]]), None, Some([0.0, edge[2]])];
    let input = folder.path().join("channel.xyz");
    for (ordered, periodic_mesh) in
        [(true, PeriodicMesh::Cut), (true, PeriodicMesh::Overlap), (false, PeriodicMesh::Cut)]
    {
        if !ordered {
            shuffle(&mut particles, &mut Random::new(9));
        }
        fs::write(&input, raw(&particles)).unwrap();
        let request = request().periodic(faces).periodic_mesh(periodic_mesh);
        let in_single: Vec<_> = particles.iter().map(|p| p.map(|x| x as f32)).collect();
        let expected = request.run(&in_single[..]).unwrap().to_mesh().unwrap();
        let parts = request.parts(&input, folder.path().join("m.ply"), 9).overwrite();
        let planned = parts.plan().unwrap();
        let read: Vec<usize> = (0..9).map(|part| made(&parts, part).1).collect();
        let merged = parts.merge().unwrap();
        let census = merged.report().facts.census;
        assert_eq!((census.binned, census.wrapped), (particles.len(), 70));
        assert!(merged.to_mesh().unwrap() == expected, "{ordered} {periodic_mesh:?}");
        for (part, &read) in planned.parts.iter().zip(&read) {
            let enough =
                if ordered { part.kept as usize + particles.len() / 4 } else { particles.len() };
            assert!(read <= enough && (ordered || read == enough), "{read} for {part:?}");
        }
        let least = read.iter().min().unwrap();
        assert!(!ordered || 2 * least < particles.len(), "{least} of {}", particles.len());
    }
}
