//! The command line: uses only the public interface of the library.

mod advice;
mod arguments;
mod devices;
mod foreign;
mod info;
mod inspect;
mod interrupt;
mod notes;
mod one_frame;
mod options;
mod pack;
mod parts;
mod process;
mod progress;
mod reconstruct;
mod render;
mod report;
mod run;
mod shells;
mod simulation;
mod stats;

use std::ffi::OsString;

use meniscus::{Cause, Error, Reconstruction, Settings};

use arguments::{Arguments, Command};
use notes::Verdict;

/// Runs a command line, whose first word is the program's name, and returns the exit code.
///
/// This is all that the program does: programs and packages in other languages may offer it as
/// their own. The process becomes the program's: signals are caught, and an interrupt ends it with
/// 130.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    process::set_up();
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    process::on_own_stack(move || match Arguments::of_command_line(&arguments) {
        Ok(Arguments { command }) => code(execute(command)),
        Err(error) => {
            // A closed pipe has nobody who could read why.
            let _ = error.print();
            error.exit_code() as u8
        }
    })
}

/// Parses a command line and makes the request of `reconstruct` and the settings that it was given,
/// without running it: for tests.
#[doc(hidden)]
pub fn parsed(
    arguments: impl IntoIterator<Item = OsString>,
) -> Result<Option<(Settings, Reconstruction)>, String> {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    match Arguments::of_command_line(&arguments).map_err(|error| error.to_string())?.command {
        Command::Reconstruct(options) => {
            let request = options.request().map_err(|error| error_message(&error))?;
            Ok(Some((options.settings.clone(), request)))
        }
        _ => Ok(None),
    }
}

/// The sentence that the program prints of an error: for tests.
#[doc(hidden)]
pub fn error_message(error: &Error) -> String {
    advice::error_message(error)
}

fn execute(command: Command) -> Result<Verdict, Error> {
    process::start_threads();
    match command {
        Command::Reconstruct(options) => reconstruct::run(&options),
        Command::Pack(options) => pack::run(&options),
        Command::Info(options) => info::run(&options),
        Command::Devices(options) => devices::run(&options),
        Command::Check(options) => inspect::check(&options),
        Command::Compare(options) => inspect::compare(&options),
        Command::Render(options) => render::run(&options),
        Command::Completions(options) => shells::completions(&options, Arguments::as_command()),
        Command::Manual(options) => shells::manual(&options, Arguments::as_command()),
    }
}

/// The exit code of a command.
fn code(verdict: Result<Verdict, Error>) -> u8 {
    match verdict {
        Ok(Verdict::Good) => 0,
        Ok(Verdict::Bad) => 1,
        Err(error) => {
            advice::say_error(&error);
            match error.cause() {
                Cause::Request => 2,
                Cause::Input => 3,
                Cause::Output => 4,
                Cause::Device => 5,
                Cause::Cancelled => 130,
            }
        }
    }
}
