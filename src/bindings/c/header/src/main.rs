//! Generates `include/meniscus.h` from the sources: `cargo run -p meniscus-c-header`.

use std::path::{Path, PathBuf};

/// The folder of the C bindings.
fn interface() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Generates the text of the header from the Rust sources.
fn header() -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let root = interface();
    let config = cbindgen::Config::from_file(root.join("cbindgen.toml"))?;
    let mut text = Vec::new();
    cbindgen::Builder::new()
        .with_src(root.join("src/lib.rs"))
        .with_config(config)
        .generate()?
        .write(&mut text);
    Ok(text)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    Ok(std::fs::write(interface().join("include/meniscus.h"), header()?)?)
}

#[test]
fn the_committed_c_header_is_up_to_date() {
    let made = String::from_utf8(header().expect("cbindgen succeeds")).expect("UTF-8");
    let there = std::fs::read_to_string(interface().join("include/meniscus.h")).expect("a header");
    assert!(made == there, "meniscus.h is out of date; run `cargo run -p meniscus-c-header`");
    assert!(made.matches("\nMeniscusStatus meniscus_").count() > 15);
}
