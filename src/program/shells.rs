//! `meniscus completions` and `meniscus manual`: completion scripts and man pages.

use std::path::PathBuf;

use clap::{Args, Command};
use clap_complete::Shell;
use meniscus::Error;
use meniscus::error::WriteError;

use super::notes::Verdict;
use super::notes::print;

#[derive(Args)]
pub struct CompletionOptions {
    /// Name of the shell.
    shell: Shell,
}

#[derive(Args)]
pub struct ManualOptions {
    /// Existing folder for the man pages.
    folder: PathBuf,
}

/// Prints the completion script for a shell.
pub fn completions(options: &CompletionOptions, mut program: Command) -> Result<Verdict, Error> {
    let mut text = Vec::new();
    clap_complete::generate(options.shell, &mut program, "meniscus", &mut text);
    print(String::from_utf8_lossy(&text).trim_end())?;
    Ok(Verdict::Good)
}

/// Writes a man page for each command.
pub fn manual(options: &ManualOptions, program: Command) -> Result<Verdict, Error> {
    clap_mangen::generate_to(program, &options.folder)
        .map_err(|fault| WriteError::new(&options.folder, fault))?;
    Ok(Verdict::Good)
}
