//! Links the C++ runtime into the programs statically if the system has an archive of it.
//! meshoptimizer needs only a small part of the runtime, but loading the shared library takes a
//! third of the time of a short command.

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
    let output = compiler.to_command().arg("-print-file-name=libstdc++.a").output()?;
    // If the compiler has no such archive, it prints only the name, without a folder.
    let archive = String::from_utf8(output.stdout)?;
    let archive = Path::new(archive.trim());
    if archive.is_absolute() {
        // The linker searches this folder before the folder with the shared library, and uses the
        // first library that it finds.
        let here = var("OUT_DIR")?;
        println!("cargo:rerun-if-changed={}", archive.display());
        fs::copy(archive, Path::new(&here).join("libstdc++.a"))?;
        println!("cargo:rustc-link-search=native={here}");
    }
    Ok(())
}
