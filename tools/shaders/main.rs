//! Rebuilds the shaders' binaries, `spirv/*.spv`, and their Rust table, `src/shaders.rs`, from the
//! sources, `spirv/*.wgsl`.
//!
//! `cargo run --example shaders` writes outdated files and prints their names.
//! `cargo run --example shaders -- --check` writes nothing, prints their names, and exits with 1 if
//! there are any.
//!
//! A source consists of the constants of `meniscus::internals::backend::wgsl_constants` that it
//! uses, the parts that its first line names (`//! with wide float64`), and its file. Therefore a
//! change of a constant in Rust changes binaries too. This program links the library: change the
//! WGSL and run it before Rust code uses a new shader or field.

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
    /// Write nothing; fail if a file is outdated.
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

/// Replaces a file, completely or not at all.
fn write(Made { file, bytes }: &Made) -> Result<(), Fault> {
    let mut whole = NamedTempFile::new_in(file.parent().expect("files are in folders"))?;
    whole.write_all(bytes)?;
    // Only its owner can access a temporary file.
    if let Ok(replaced) = fs::metadata(file) {
        whole.as_file().set_permissions(replaced.permissions())?;
    }
    whole.persist(file)?;
    Ok(())
}
