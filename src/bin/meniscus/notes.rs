//! Notes of a run for people, on standard error.

use indicatif::MultiProgress;

use crate::say::say;

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
