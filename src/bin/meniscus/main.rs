//! The command line: sees only the public interface of the library.

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

use std::process::ExitCode;

use meniscus::Cause;

use arguments::{Arguments, Command};
use notes::Verdict;

fn main() -> ExitCode {
    process::set_up();
    process::on_own_stack(run)
}

fn run() -> ExitCode {
    let Arguments { command } = Arguments::of_command_line();
    process::start_threads();
    let verdict = match command {
        Command::Reconstruct(options) => reconstruct::run(&options),
        Command::Pack(options) => pack::run(&options),
        Command::Info(options) => info::run(&options),
        Command::Devices(options) => devices::run(&options),
        Command::Check(options) => inspect::check(&options),
        Command::Compare(options) => inspect::compare(&options),
        Command::Render(options) => render::run(&options),
        Command::Completions(options) => shells::completions(&options, Arguments::as_command()),
        Command::Manual(options) => shells::manual(&options, Arguments::as_command()),
    };
    match verdict {
        Ok(Verdict::Good) => ExitCode::SUCCESS,
        Ok(Verdict::Bad) => ExitCode::from(1),
        Err(error) => {
            advice::say_error(&error);
            ExitCode::from(match error.cause() {
                Cause::Request => 2,
                Cause::Input => 3,
                Cause::Output => 4,
                Cause::Device => 5,
                Cause::Cancelled => 130,
                _ => 2,
            })
        }
    }
}
