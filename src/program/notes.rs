//! Messages of a run on standard error, and results on standard output.

use std::io::{self, Write};

use indicatif::MultiProgress;
use meniscus::Error;
use meniscus::error::shown;

/// Prints the messages of a run on standard error, at a given level of detail.
#[derive(Clone, Default)]
pub struct Notes {
    quiet: bool,
    verbose: bool,
    /// Progress bars that stay below the messages.
    bars: Option<MultiProgress>,
}

impl Notes {
    /// Selects the level of detail: with `quiet`, only errors are printed; with `verbose`, details
    /// are also printed.
    pub fn new(quiet: bool, verbose: bool) -> Self {
        Self { quiet, verbose, bars: None }
    }

    /// Returns notes that are printed above these progress bars.
    pub fn above(self, bars: MultiProgress) -> Self {
        Self { bars: Some(bars), ..self }
    }

    /// Prints a warning.
    pub fn warn(&self, text: &str) {
        self.say(format!("warning: {text}"));
    }

    pub fn is_quiet(&self) -> bool {
        self.quiet
    }

    pub fn say(&self, text: impl AsRef<str>) {
        if !self.quiet {
            self.print(text.as_ref());
        }
    }

    pub fn detail(&self, text: impl AsRef<str>) {
        if self.verbose {
            self.print(text.as_ref());
        }
    }

    /// Prints an error, even if the option `quiet` is set.
    pub fn error(&self, text: impl AsRef<str>) {
        self.print(text.as_ref());
    }

    fn print(&self, text: &str) {
        match &self.bars {
            Some(bars) => bars.suspend(|| say(text)),
            None => say(text),
        }
    }
}

/// Writes a line to standard error in one call. Ignores errors, so that the work continues.
pub fn say(text: &str) {
    let _ = io::stderr().lock().write_all(format!("{text}\n").as_bytes());
}

/// The verdict of a command that ran to its end.
pub enum Verdict {
    /// Success.
    Good,
    /// The command ended normally, but a mesh has a defect or frames failed.
    Bad,
}

/// Writes results to standard output. A closed pipe is not an error.
pub fn print(text: &str) -> Result<(), Error> {
    use std::io::{ErrorKind, Write};
    match writeln!(io::stdout().lock(), "{text}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(meniscus::error::WriteError::new("standard output".as_ref(), error).into())
        }
        _ => Ok(()),
    }
}

/// A point as text.
pub fn point(point: &[f64; 3]) -> String {
    format!("[{}]", point.map(shown).join(", "))
}

/// A box as text: its lowest and its highest corner.
pub fn corners([lowest, highest]: &[[f64; 3]; 2]) -> String {
    format!("{} to {}", point(lowest), point(highest))
}

/// Prints a result as JSON.
pub fn print_json(value: &impl serde::Serialize) -> Result<(), Error> {
    print(&serde_json::to_string_pretty(value).expect("results have string keys and finite depth"))
}
