//! Sets the soname of the shared library, and prevents dlclose from unloading it.

fn main() {
    let get = |name: &str| std::env::var(name).unwrap_or_default();
    println!("cargo::rerun-if-changed=build.rs");
    if get("CARGO_CFG_TARGET_OS") == "linux" {
        // Before 1.0, a new minor version may break the interface, so the soname contains the minor
        // version.
        let (major, minor) = (get("CARGO_PKG_VERSION_MAJOR"), get("CARGO_PKG_VERSION_MINOR"));
        let version = if major == "0" { format!("0.{minor}") } else { major };
        println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libmeniscus.so.{version}");
        // `nodelete` keeps the library loaded after `dlclose`, because the library's threads may
        // still run its code shortly after the last call has returned.
        println!("cargo::rustc-cdylib-link-arg=-Wl,-z,nodelete");
    }
}
