//! The program, run in a folder: its command, what it says where its exit code is known, and by a
//! shell.

use std::path::Path;
use std::process::{Child, Command, Output};
use std::thread::sleep;
use std::time::Duration;

/// The program; tests of a device alone are built without it.
const MENISCUS: Option<&str> = option_env!("CARGO_BIN_EXE_meniscus");

/// The program in a folder, which is not started yet.
pub fn command(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(MENISCUS.unwrap());
    command.current_dir(folder).args(arguments);
    command
}

/// What a run says on standard error, which ends with `code`.
#[track_caller]
pub fn run(folder: &Path, arguments: &[&str], code: i32) -> String {
    let Output { status, stderr, .. } = command(folder, arguments).output().unwrap();
    let errors = String::from_utf8(stderr).unwrap();
    assert_eq!(status.code(), Some(code), "{arguments:?}: {errors}");
    assert!(!errors.contains("panicked"), "{errors}");
    errors
}

/// A run by a shell that first does what `before` says, such as to set limits; it takes the
/// arguments apart.
pub fn in_shell(folder: &Path, before: &str, arguments: &str) -> Output {
    let script = format!("{before}\nexec \"$0\" {arguments}");
    let mut command = Command::new("bash");
    command.current_dir(folder).args(["-c", &script, MENISCUS.unwrap()]).output().unwrap()
}

/// Waits until `reached` returns true, which is before `child` ends.
#[track_caller]
pub fn wait_until(child: &mut Child, what: &str, mut reached: impl FnMut(&Child) -> bool) {
    while !reached(child) {
        assert!(child.try_wait().unwrap().is_none(), "the run ends before {what}");
        sleep(Duration::from_millis(1));
    }
}

/// Kills `child` as soon as `reached` returns true, which is while it works.
#[track_caller]
pub fn kill_when(mut child: Child, what: &str, reached: impl FnMut(&Child) -> bool) {
    wait_until(&mut child, what, reached);
    child.kill().unwrap();
    assert!(!child.wait().unwrap().success(), "the run ends at {what}, before it is killed");
}
