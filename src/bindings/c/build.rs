//! Sets the soname of the library, and keeps it loaded.

fn main() {
    let get = |name: &str| std::env::var(name).unwrap_or_default();
    println!("cargo::rerun-if-changed=build.rs");
    if get("CARGO_CFG_TARGET_OS") == "linux" {
        // Versions before 1.0 differ by their second number.
        let (major, minor) = (get("CARGO_PKG_VERSION_MAJOR"), get("CARGO_PKG_VERSION_MINOR"));
        let version = if major == "0" { format!("0.{minor}") } else { major };
        println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libmeniscus.so.{version}");
        // Threads of the library end shortly after they are asked to, and need its code until then.
        println!("cargo::rustc-cdylib-link-arg=-Wl,-z,nodelete");
    }
}
