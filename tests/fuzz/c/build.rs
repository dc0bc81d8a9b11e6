//! Compiles `random.c`, which tests random calls of the C interface. `FUZZED` selects the variant
//! in which the fuzzer's bytes determine the calls.

fn main() {
    let c = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../src/bindings/c");
    for folder in ["include", "tests"] {
        println!("cargo::rerun-if-changed={}", c.join(folder).display());
    }
    let mut build = cc::Build::new();
    build.file(c.join("tests/random.c")).include(c.join("include")).define("FUZZED", None);
    build.std("gnu11").warnings(false).compile("calls");
}
