//! The entry point for libFuzzer: runs the target that `MENISCUS_FUZZ` names. See `tools/fuzz`.
#![cfg_attr(not(test), no_main)]
#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "this program uses only some items of the shared modules"
)]

mod c;
#[path = "targets/mod.rs"]
mod targets;

use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;

static RUN: OnceLock<fn(&[u8])> = OnceLock::new();

/// Returns the function of the target that `MENISCUS_FUZZ` names. If `MENISCUS_SEEDS` names a
/// folder, writes the target's seeds into the folder and its words into a file next to the folder,
/// and exits.
fn chosen() -> fn(&[u8]) {
    targets::on_one_thread();
    let name = std::env::var("MENISCUS_FUZZ").unwrap_or_default();
    // Only libFuzzer runs the target `c`. On stable Rust, the C interface's own test makes random
    // calls instead.
    let mut all = targets::all();
    all.push(c::target());
    let names = || all.iter().map(|target| target.name).collect::<Vec<_>>().join("\n");
    let Some(target) = all.iter().find(|target| target.name == name) else {
        println!("{}", names());
        std::process::exit(2);
    };
    if let Some(folder) = std::env::var_os("MENISCUS_SEEDS").map(std::path::PathBuf::from) {
        for (number, seed) in (target.seeds)().into_iter().enumerate() {
            std::fs::write(folder.join(format!("seed_{number}")), seed).unwrap();
        }
        let quoted =
            |word: &&str| word.bytes().map(|byte| format!("\\x{byte:02x}")).collect::<String>();
        let words: String =
            target.words.iter().map(|word| format!("\"{}\"\n", quoted(word))).collect();
        std::fs::write(folder.with_extension("dict"), words).unwrap();
        std::process::exit(0);
    }
    target.run
}

fuzz_target!(init: { RUN.get_or_init(chosen); }, |data: &[u8]| {
    RUN.get_or_init(chosen)(data);
});
