//! What is fuzzed: a function for each target, and the small files that mutations begin with, all
//! of them made here.
//!
//! A target takes any bytes, and fails by a panic: where the library panics, and where something
//! does not hold that it promises. What formats compress or sum up a target compresses and sums up
//! itself, so that mutations get past that.

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

/// Something that takes any bytes.
pub struct Target {
    /// The name on the command line.
    pub name: &'static str,
    /// How often it is run on stable Rust, which is to take some tenths of a second.
    pub runs: u32,
    pub run: fn(&[u8]),
    /// What mutations begin with.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Words that mutations put in.
    pub words: &'static [&'static str],
}

/// All that there are.
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

/// Lets the calling thread do what the library would share among all: handing work over takes
/// longer than doing it, and what is fuzzed is to be the same every time.
pub fn on_one_thread() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread();
    // There is one already where this is called twice.
    let _ = pool.build_global();
}
