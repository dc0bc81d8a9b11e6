//! Runs the program in a folder, directly or in a shell, and checks its exit code.

use std::path::Path;
use std::process::{Child, Command, Output};
use std::thread::sleep;
use std::time::Duration;

/// The path of the program. `None` in device tests that are built without the program.
const MENISCUS: Option<&str> = option_env!("CARGO_BIN_EXE_meniscus");

/// A command that runs the program in a folder. The caller starts it.
pub fn command(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(MENISCUS.unwrap());
    command.current_dir(folder).args(arguments);
    command
}

/// Runs the program, which must exit with `code`, and returns its standard error.
#[track_caller]
pub fn run(folder: &Path, arguments: &[&str], code: i32) -> String {
    let Output { status, stderr, .. } = command(folder, arguments).output().unwrap();
    let errors = String::from_utf8(stderr).unwrap();
    assert_eq!(status.code(), Some(code), "{arguments:?}: {errors}");
    assert!(!errors.contains("panicked"), "{errors}");
    errors
}

/// Runs the program in a shell, after the commands in `before`, such as limits. The shell splits
/// the arguments.
pub fn in_shell(folder: &Path, before: &str, arguments: &str) -> Output {
    shell_command(folder, before, arguments).output().unwrap()
}

/// The command of [`in_shell`], which the caller starts. The program replaces the shell's process.
pub fn shell_command(folder: &Path, before: &str, arguments: &str) -> Command {
    let script = format!("{before}\nexec \"$0\" {arguments}");
    let mut command = Command::new("bash");
    command.current_dir(folder).args(["-c", &script, MENISCUS.unwrap()]);
    command
}

/// Waits until `reached` returns true, which must happen before `child` ends.
#[track_caller]
pub fn wait_until(child: &mut Child, what: &str, mut reached: impl FnMut(&Child) -> bool) {
    while !reached(child) {
        assert!(child.try_wait().unwrap().is_none(), "the program exited before {what} appeared");
        sleep(Duration::from_millis(1));
    }
}

/// Kills `child` when `reached` returns true, which must happen before `child` ends.
#[track_caller]
pub fn kill_when(mut child: Child, what: &str, reached: impl FnMut(&Child) -> bool) {
    wait_until(&mut child, what, reached);
    child.kill().unwrap();
    assert!(!child.wait().unwrap().success(), "{what} appeared, but the program exited normally");
}
