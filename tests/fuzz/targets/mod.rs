//! The fuzz targets: the function of each target, and its small seed files, which are generated.
//!
//! A target takes arbitrary bytes, and panics if the library panics or breaks a guarantee. If a
//! format has compression or checksums, the target adds them to the mutated bytes, so that the
//! library accepts them.

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
    /// Number of runs on stable Rust. All runs of a target together should take less than a second.
    pub runs: u32,
    pub run: fn(&[u8]),
    /// Returns the seeds that are mutated.
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

/// Makes the library do parallel work on the calling thread, because targets must be deterministic,
/// and their work is too small for several threads.
pub fn on_one_thread() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread();
    // Ignore the error if this function was already called.
    let _ = pool.build_global();
}
