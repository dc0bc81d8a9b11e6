//! Notes of a run for people, on standard error.

use std::io::{self, Write};

use indicatif::MultiProgress;
use meniscus::Error;
use meniscus::error::shown;

/// The notes that a run makes for people, on standard error.
#[derive(Clone, Default)]
pub struct Notes {
    quiet: bool,
    verbose: bool,
    /// Bars that stand below the notes.
    bars: Option<MultiProgress>,
}

impl Notes {
    /// Notes that leave out what only some want to read.
    pub fn new(quiet: bool, verbose: bool) -> Self {
        Self { quiet, verbose, bars: None }
    }

    /// Puts the notes above bars.
    pub fn above(self, bars: MultiProgress) -> Self {
        Self { bars: Some(bars), ..self }
    }

    /// Says what may be wrong.
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

    /// Says what even a quiet run has to say.
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

/// Writes a line at once and not piece by piece. Where nobody can read it, the work goes on.
pub fn say(text: &str) {
    let _ = io::stderr().lock().write_all(format!("{text}\n").as_bytes());
}

/// The verdict of a command that ran to its end.
pub enum Verdict {
    /// All is well.
    Good,
    /// The work was done, and something is not as it should be.
    Bad,
}

/// Writes results to standard output. A reader that went away is no error.
pub fn print(text: &str) -> Result<(), Error> {
    use std::io::{ErrorKind, Write};
    match writeln!(io::stdout().lock(), "{text}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(meniscus::error::WriteError::new("standard output".as_ref(), error).into())
        }
        _ => Ok(()),
    }
}

/// A point in words.
pub fn point(point: &[f64; 3]) -> String {
    format!("[{}]", point.map(shown).join(", "))
}

/// A box by its lowest and its highest corner, in words.
pub fn corners([lowest, highest]: &[[f64; 3]; 2]) -> String {
    format!("{} to {}", point(lowest), point(highest))
}

/// Prints a result as JSON, for programs.
pub fn print_json(value: &impl serde::Serialize) -> Result<(), Error> {
    print(&serde_json::to_string_pretty(value).expect("results have string keys and finite depth"))
}
