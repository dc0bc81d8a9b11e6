//! The outcome of a command, and how it is printed.

use meniscus::Error;

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

/// Prints a result as JSON, for programs.
pub fn print_json(value: &impl serde::Serialize) -> Result<(), Error> {
    print(&serde_json::to_string_pretty(value).expect("results have string keys and finite depth"))
}
