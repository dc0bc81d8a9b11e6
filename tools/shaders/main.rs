//! Rebuilds the shaders' binaries, `spirv/*.spv`, and their Rust table, `src/shaders.rs`, from the
//! sources, `spirv/*.wgsl`.
//!
//! `cargo run --example shaders` writes the files that are not what the sources make, and names
//! them. `cargo run --example shaders -- --check` writes nothing, names them, and exits with 1 if
//! there are any.
//!
//! A source is what its file holds after the parts that its first line names
//! (`//! with wide float64`) and the constants of `meniscus::internals::backend::wgsl_constants`
//! that it uses, so a constant that changes in Rust changes binaries too. This program links the
//! library: change the WGSL and run it before Rust code uses a new shader or field.

#[allow(dead_code, reason = "tests use the rest")]
mod compile;

use std::fs;
use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use compile::{Fault, Made};
use tempfile::NamedTempFile;

/// Rebuilds the shaders' binaries and their Rust table from the sources.
#[derive(Parser)]
struct Options {
    /// Write nothing; fail if a file is not what the sources make.
    #[arg(long)]
    check: bool,
}

fn main() -> ExitCode {
    match run(&Options::parse()) {
        Ok(code) => code,
        Err(fault) => {
            eprintln!("{fault}");
            ExitCode::from(2)
        }
    }
}

fn run(options: &Options) -> Result<ExitCode, Fault> {
    let outdated = compile::outdated()?;
    for made in &outdated {
        if options.check {
            println!("{}: not what the sources make", made.file.display());
        } else {
            write(made)?;
            println!("{}: written", made.file.display());
        }
    }
    Ok(if options.check && !outdated.is_empty() { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Puts a file in its place, whole or not at all.
fn write(Made { file, bytes }: &Made) -> Result<(), Fault> {
    let mut whole = NamedTempFile::new_in(file.parent().expect("files are in folders"))?;
    whole.write_all(bytes)?;
    // A temporary file is its owner's alone.
    if let Ok(replaced) = fs::metadata(file) {
        whole.as_file().set_permissions(replaced.permissions())?;
    }
    whole.persist(file)?;
    Ok(())
}
