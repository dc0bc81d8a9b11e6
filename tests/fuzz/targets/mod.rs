//! The fuzz targets: a function for each, and small seed files, all generated here.
//!
//! A target takes any bytes. It panics if the library panics, or if the library breaks a promise. A
//! target compresses and checksums its bytes itself, so that mutations get past this.

mod arguments;
pub mod folder;
mod meshes;
mod names;
mod packed;
mod particles;
mod parts;
mod state;
mod surfaces;
mod wrapped;

#[path = "../../io/build.rs"]
pub mod build;

/// A fuzz target.
pub struct Target {
    /// The name on the command line.
    pub name: &'static str,
    /// Number of runs on stable Rust, which should take some tenths of a second.
    pub runs: u32,
    pub run: fn(&[u8]),
    /// The seeds of mutations.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Words that mutations insert.
    pub words: &'static [&'static str],
}

/// All targets.
pub fn all() -> Vec<Target> {
    let mut all = particles::targets();
    all.extend(meshes::targets());
    all.extend(wrapped::targets());
    all.extend(packed::targets());
    all.extend(parts::targets());
    all.extend(state::targets());
    all.extend(names::targets());
    all.extend(surfaces::targets());
    all.extend(arguments::targets());
    all
}

/// Runs shared work on the calling thread: passing it on takes longer, and a target must be
/// deterministic.
pub fn on_one_thread() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread();
    // Fails if this was called before.
    let _ = pool.build_global();
}
