//! Writes the benchmark scene as a particle file: raw f32 (.xyz) or binary little-endian .ply.
//!
//! `cargo run --release --example generate -- MILLIONS OUTPUT`

mod scene;

use std::fs::File;
use std::io::{BufWriter, Write};

fn main() -> std::io::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (Some(millions), Some(path)) =
        (arguments.next().and_then(|a| a.parse::<f64>().ok()), arguments.next())
    else {
        eprintln!("usage: generate MILLIONS_OF_PARTICLES OUTPUT.ply|OUTPUT.xyz");
        std::process::exit(2);
    };
    let particles = scene::splash((millions * 1e6) as usize, 1);
    let mut out = BufWriter::new(File::create(&path)?);
    if path.ends_with(".ply") {
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\n\
             property float x\nproperty float y\nproperty float z\nend_header\n",
            particles.len()
        )?;
    }
    for coordinate in particles.iter().flatten() {
        out.write_all(&coordinate.to_le_bytes())?;
    }
    out.flush()?;
    println!("{path}: {} particles at spacing 1", particles.len());
    Ok(())
}
