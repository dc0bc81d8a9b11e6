//! Prints the devices and the time of each stage, in milliseconds, for the report of
//! `tools/gpu/run`.

#[path = "../../tools/bench/backends.rs"]
#[allow(dead_code, clippy::duplicate_mod, reason = "the benchmark uses its command line")]
mod backends;

use std::env;
use std::fmt::Debug;
use std::str::FromStr;

use meniscus::internals::vulkan::Instance;

#[test]
#[ignore = "prints the devices"]
fn devices() {
    println!("{:#?}", Instance::connect(false).unwrap().devices().unwrap());
}

#[test]
#[ignore = "prints milliseconds per stage, which takes minutes"]
fn stages() {
    let device = env::var("MENISCUS_TEST_DEVICE").ok();
    let (cells, millions) = (list("MENISCUS_CELLS", "256,512"), list("MENISCUS_MILLIONS", "1,10"));
    let same =
        backends::measure(backends::Options { device, cells, millions, bench: true }).unwrap();
    assert!(same, "bytes differ");
}

/// Reads a list of numbers from an environment variable, or from `otherwise` if the variable is not
/// set.
fn list<T: FromStr<Err: Debug>>(variable: &str, otherwise: &str) -> Vec<T> {
    let text = env::var(variable).unwrap_or_else(|_| otherwise.to_owned());
    text.split(',').map(|number| number.parse().unwrap()).collect()
}
