//! The command line program, which the wheel installs as a script.

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs a command line of the program, whose first word is the program's name, and returns the exit
/// code. Signals of the process are the program's from then on.
#[pyfunction]
pub fn program(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| meniscus::program::run(arguments))
}
