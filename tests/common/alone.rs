//! Runs tests that limit or measure the whole process in their own process.

use std::process::Command;

/// Set in the child process to the name of the test that it runs.
const ALONE: &str = "MENISCUS_TEST_ALONE";

/// Runs `test` in a child process in which no other test runs.
///
/// `name` is the test that calls this, by its path in the test program, such as
/// `facade::no_threads`.
#[track_caller]
pub fn alone(name: &str, test: impl FnOnce()) {
    run(name, Command::new(std::env::current_exe().unwrap()), test);
}

/// Like [`alone`], in a process that a shell starts after the commands in `before`, such as
/// `ulimit`.
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
    let [says, errors] =
        [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    assert!(output.status.success(), "{}: {says}{errors}", output.status);
    // A wrong name selects no test, which is a success to the harness.
    assert!(says.contains("1 passed"), "no test is called {name}: {says}");
}
