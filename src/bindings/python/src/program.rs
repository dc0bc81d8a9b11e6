//! The command-line program `meniscus`, which the wheel installs as a script.

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs a command line of the program, with the program's name as its first word, and returns the
/// exit code. The signal handlers of the program stay installed in the process.
#[pyfunction]
pub fn program(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| meniscus::program::run(arguments))
}
