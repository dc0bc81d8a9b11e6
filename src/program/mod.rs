//! The command line, which uses only the public interface of the library.

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

/// Runs a command line, with the program's name as its first word, and returns the exit code.
///
/// Other programs, and packages in other languages, can use this function to offer the command
/// line. It installs signal handlers for the whole process. After an interrupt, the process exits
/// with code 130.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    process::set_up();
    interrupt::catch_crashes();
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    process::on_own_stack(move || match Arguments::of_command_line(&arguments) {
        Ok(Arguments { command }) => {
            let say_error: fn(&Error) = match command {
                Command::Reconstruct(_) | Command::Pack(_) => advice::say_error,
                _ => advice::say_error_without_machine,
            };
            code(process::on_all_cores(|| execute(command)), say_error)
        }
        Err(error) => {
            // Ignore a failure to print. If the pipe is closed, nobody reads an error message.
            let _ = error.print();
            error.exit_code() as u8
        }
    })
}

/// For tests: parses a command line of `reconstruct`, and returns its settings and request without
/// running it. Returns `None` for other commands.
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

/// For tests: returns the text that the program prints for an error.
#[doc(hidden)]
pub fn error_message(error: &Error) -> String {
    advice::error_message(error)
}

fn execute(command: Command) -> Result<Verdict, Error> {
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

/// Returns the exit code of a command. If the command failed, prints the error with `say_error`.
fn code(verdict: Result<Verdict, Error>, say_error: impl FnOnce(&Error)) -> u8 {
    match verdict {
        Ok(Verdict::Good) => 0,
        Ok(Verdict::Bad) => 1,
        Err(error) => {
            say_error(&error);
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
