//! The outcome of a command, and how it is printed.

use meniscus::Error;
use meniscus::error::shown;

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
    match writeln!(std::io::stdout().lock(), "{text}") {
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
