//! Runs a test in a separate process, for tests that limit or measure the whole process.

use std::process::Command;

/// The environment variable that names the test to run in the child process.
const ALONE: &str = "MENISCUS_TEST_ALONE";

/// Runs `test` in a child process in which no other test runs.
///
/// `name` is the path of the calling test in its test program, such as `facade::no_threads`.
#[track_caller]
pub fn alone(name: &str, test: impl FnOnce()) {
    run(name, Command::new(std::env::current_exe().unwrap()), test);
}

/// Does the same as [`alone`], but a shell first runs the commands in `before`, such as `ulimit`,
/// and then starts the child process.
#[cfg(unix)]
#[track_caller]
pub fn alone_after(before: &str, name: &str, test: impl FnOnce()) {
    let mut shell = Command::new("sh");
    shell
        .args(["-c", &format!("{before}\nexec \"$0\" \"$@\"")])
        .arg(std::env::current_exe().unwrap());
    run(name, shell, test);
}

#[track_caller]
fn run(name: &str, mut program: Command, test: impl FnOnce()) {
    if std::env::var(ALONE).is_ok_and(|chosen| chosen == name) {
        return test();
    }
    let output = program.args(["--exact", name]).env(ALONE, name).output().unwrap();
    let [stdout, errors] =
        [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    assert!(output.status.success(), "{}: {stdout}{errors}", output.status);
    // If the name is wrong, the harness runs no test and reports success.
    assert!(stdout.contains("1 passed"), "no test is called {name}: {stdout}");
}
