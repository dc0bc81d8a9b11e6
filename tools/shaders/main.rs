//! Rebuilds the shaders' binaries, `spirv/*.spv`, from their sources, `spirv/*.wgsl`.
//!
//! `cargo run --example shaders` writes those that are not what their sources compile to, and names them.
//! `cargo run --example shaders -- --check` writes nothing, names them, and exits with 1 if there are any.
//!
//! A source is what its file holds after the parts that its first line names (`//! with wide float64`) and the constants
//! of `meniscus::internals::backend::shaders` that it uses, so a constant that changes in Rust changes binaries too. The library embeds the
//! binaries; for a new program create an empty one first, that the library compiles.

#[allow(dead_code, reason = "tests use the rest")]
mod compile;

use std::fs;
use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use compile::{Binary, Fault};
use tempfile::NamedTempFile;

/// Rebuilds the shaders' binaries from their sources.
#[derive(Parser)]
struct Options {
    /// Write nothing; fail if a binary is not what its source compiles to.
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
    for binary in &outdated {
        if options.check {
            println!("{}: not what its source compiles to", binary.file.display());
        } else {
            write(binary)?;
            println!("{}: written", binary.file.display());
        }
    }
    Ok(if options.check && !outdated.is_empty() { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Puts a binary in its place, whole or not at all.
fn write(Binary { file, code }: &Binary) -> Result<(), Fault> {
    let mut whole = NamedTempFile::new_in(compile::folder())?;
    whole.write_all(code)?;
    // A temporary file is its owner's alone.
    if let Ok(replaced) = fs::metadata(file) {
        whole.as_file().set_permissions(replaced.permissions())?;
    }
    whole.persist(file)?;
    Ok(())
}
