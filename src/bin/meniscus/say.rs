//! Messages on standard error.

use std::io::{self, Write};

/// Writes a line at once and not piece by piece. Where nobody can read it, the work goes on.
pub fn say(text: &str) {
    let _ = io::stderr().lock().write_all(format!("{text}\n").as_bytes());
}
