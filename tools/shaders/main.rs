//! Compiles the shaders' sources, `spirv/*.wgsl`, to binaries, `spirv/*.spv`, and to a Rust table,
//! `src/shaders.rs`.
//!
//! `cargo run --example shaders` writes outdated files and prints their names. `cargo run --example
//! shaders -- --check` only prints the names of outdated files, and exits with 1 if there are any.
//!
//! Each shader is compiled from three pieces: the constants of
//! `meniscus::internals::backend::wgsl_constants` that it uses, the parts that its first line names
//! (`//! with wide float64`), and its own file. Therefore, changing a constant in Rust also changes
//! binaries. This program links the library, so for a new shader or field, change the WGSL and run
//! this program before you use the shader or field in Rust code.

#[allow(dead_code, reason = "only tests use the other functions")]
mod compile;

use std::fs;
use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use compile::{Fault, GeneratedFile};
use tempfile::NamedTempFile;

/// Compile the shaders' sources to binaries and to their Rust table.
#[derive(Parser)]
struct Options {
    /// Write no files, and fail if a file is outdated.
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
            println!("{}: outdated", made.file.display());
        } else {
            write(made)?;
            println!("{}: written", made.file.display());
        }
    }
    Ok(if options.check && !outdated.is_empty() { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Replaces a file with a complete temporary file, so that the file is never half-written.
fn write(GeneratedFile { file, bytes }: &GeneratedFile) -> Result<(), Fault> {
    let mut whole = NamedTempFile::new_in(file.parent().expect("files are in folders"))?;
    whole.write_all(bytes)?;
    // Only the owner can access a temporary file, so copy the permissions of the replaced file.
    if let Ok(replaced) = fs::metadata(file) {
        whole.as_file().set_permissions(replaced.permissions())?;
    }
    whole.persist(file)?;
    Ok(())
}
