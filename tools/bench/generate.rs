//! Writes the benchmark scene as a particle file: raw f32 (.xyz), binary little-endian .ply, or
//! .pvtp.
//!
//! In a .pvtp, each piece contains the particles of one box of space, as in the output of a
//! simulation on many nodes. The particles are in random order, or sorted by rows of cells.
//!
//! `cargo run --release --example generate -- MILLIONS OUTPUT [PIECES | rows]`

mod scene;

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

fn main() -> io::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (Some(millions), Some(path)) =
        (arguments.next().and_then(|a| a.parse::<f64>().ok()), arguments.next())
    else {
        eprintln!(
            "usage: generate MILLIONS_OF_PARTICLES OUTPUT.ply|OUTPUT.xyz|OUTPUT.pvtp [PIECES | rows]"
        );
        std::process::exit(2);
    };
    let (count, last) = ((millions * 1e6) as usize, arguments.next());
    let mut particles = match last.as_deref() {
        Some("rows") => scene::splash_in_rows(count, &mut scene::Random::new(1)),
        _ => scene::splash(count, 1),
    };
    if path.ends_with(".pvtp") {
        let count = last.and_then(|a| a.parse().ok()).unwrap_or(64);
        let mut pieces = Vec::new();
        divide(&mut particles, count, &mut |piece| pieces.push(piece.len()));
        write_pieces(Path::new(&path), &particles, &pieces)?;
    } else {
        let mut out = BufWriter::new(File::create(&path)?);
        if path.ends_with(".ply") {
            write!(
                out,
                "ply\nformat binary_little_endian 1.0\nelement vertex {}\n\
                 property float x\nproperty float y\nproperty float z\nend_header\n",
                particles.len()
            )?;
        }
        write_numbers(&mut out, &particles)?;
        out.flush()?;
    }
    println!("{path}: {} particles at spacing 1", particles.len());
    Ok(())
}

fn write_numbers(out: &mut impl Write, particles: &[[f32; 3]]) -> io::Result<()> {
    particles.iter().flatten().try_for_each(|coordinate| out.write_all(&coordinate.to_le_bytes()))
}

/// Divides particles recursively, across their longest extent, into `pieces` boxes with about equal
/// numbers of particles, and passes each box to `take`.
fn divide(particles: &mut [[f32; 3]], pieces: usize, take: &mut impl FnMut(&[[f32; 3]])) {
    if pieces <= 1 || particles.is_empty() {
        return take(particles);
    }
    let extent = |axis: usize| {
        let coordinates = particles.iter().map(|p| p[axis]);
        let (lo, hi) = coordinates.fold((f32::MAX, f32::MIN), |(lo, hi), x| (lo.min(x), hi.max(x)));
        hi - lo
    };
    let extents = [0, 1, 2].map(extent);
    let axis = (0..3).max_by(|&a, &b| extents[a].total_cmp(&extents[b])).unwrap_or(0);
    let first = pieces / 2;
    let at = particles.len() * first / pieces;
    particles.select_nth_unstable_by(at, |a, b| a[axis].total_cmp(&b[axis]));
    let (below, above) = particles.split_at_mut(at);
    divide(below, first, take);
    divide(above, pieces - first, take);
}

/// Writes a .pvtp, and its pieces as .vtp files in a folder of the same name. `pieces` contains the
/// number of particles of each piece.
fn write_pieces(path: &Path, particles: &[[f32; 3]], pieces: &[usize]) -> io::Result<()> {
    let folder = path.with_extension("");
    std::fs::create_dir_all(&folder)?;
    let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut list = BufWriter::new(File::create(path)?);
    let points =
        "<DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"appended\" offset=\"0\"/>";
    writeln!(list, "<VTKFile type=\"PPolyData\" version=\"1.0\">\n<PPolyData GhostLevel=\"0\">")?;
    let mut rest = particles;
    for (number, &count) in pieces.iter().enumerate() {
        let own = rest.split_off(..count).unwrap_or_default();
        let mut out = BufWriter::new(File::create(folder.join(format!("piece_{number}.vtp")))?);
        write!(
            out,
            "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
             <PolyData>\n<Piece NumberOfPoints=\"{count}\">\n<Points>{points}</Points>\n</Piece>\n</PolyData>\n\
             <AppendedData encoding=\"raw\">\n_"
        )?;
        out.write_all(&(12 * count as u64).to_le_bytes())?;
        write_numbers(&mut out, own)?;
        write!(out, "\n</AppendedData>\n</VTKFile>\n")?;
        out.flush()?;
        writeln!(list, "<Piece Source=\"{name}/piece_{number}.vtp\"/>")?;
    }
    write!(list, "</PPolyData>\n</VTKFile>\n")?;
    list.flush()
}
