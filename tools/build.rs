//! Links the C++ runtime into the programs statically if the system has an archive of it.
//! meshoptimizer needs little of it, and loading the shared library would take a third of the time
//! of a small command.

use std::env::var;
use std::error::Error;
use std::fs;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=tools/build.rs");
    if (var("CARGO_CFG_TARGET_OS")?, var("CARGO_CFG_TARGET_ENV")?) != ("linux".into(), "gnu".into())
    {
        return Ok(());
    }
    let compiler = cc::Build::new().cpp(true).get_compiler();
    let asked = compiler.to_command().arg("-print-file-name=libstdc++.a").output()?;
    // A compiler without the archive prints its bare name.
    let archive = String::from_utf8(asked.stdout)?;
    let archive = Path::new(archive.trim());
    if archive.is_absolute() {
        // The linker uses the first match, and searches this folder before that of the shared
        // library.
        let here = var("OUT_DIR")?;
        println!("cargo:rerun-if-changed={}", archive.display());
        fs::copy(archive, Path::new(&here).join("libstdc++.a"))?;
        println!("cargo:rustc-link-search=native={here}");
    }
    Ok(())
}
