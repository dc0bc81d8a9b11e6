//! The program `meniscus`: runs the library's command line.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(meniscus::program::run(std::env::args_os()))
}
