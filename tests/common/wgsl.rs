//! From the shaders' sources to their binaries.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use meniscus::programs::constants;
use naga::Module;
use naga::back::spv;
use naga::valid::{Capabilities, ValidationFlags, Validator};

pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("spirv")
}

fn read(name: &str) -> String {
    fs::read_to_string(folder().join(name).with_extension("wgsl")).unwrap()
}

pub fn source(name: &str) -> String {
    whole(&read(name))
}

/// The parts that the first line names, and the text itself, after the constants that they name.
pub fn whole(own: &str) -> String {
    let parts = own.lines().next().and_then(|line| line.strip_prefix("//! with ")).unwrap_or("");
    let text: String = parts.split_whitespace().map(read).chain([own.to_owned()]).collect();
    let words: HashSet<&str> = text.split(|c: char| !c.is_alphanumeric() && c != '_').collect();
    let named = constants().into_iter().filter(|(name, ..)| words.contains(name));
    let constants = named.map(|(name, kind, value)| format!("const {name}: {kind} = {value};\n"));
    constants.chain([text.clone()]).collect()
}

pub fn parsed(name: &str, source: &str) -> Module {
    naga::front::wgsl::parse_str(source).unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(source)))
}

pub fn compiled(name: &str, source: &str) -> Vec<u8> {
    let mut module = parsed(name, source);
    naga::compact::compact(&mut module, naga::compact::KeepUnused::No);
    let info = Validator::new(ValidationFlags::all(), Capabilities::IMMEDIATES)
        .validate(&module)
        .unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(source)));
    let options = spv::Options {
        lang_version: (1, 3),
        flags: spv::WriterFlags::empty(),
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::None,
        use_storage_input_output_16: false,
        force_loop_bounding: false,
        ..spv::Options::default()
    };
    let words = spv::write_vec(&module, &info, &options, None).unwrap();
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}
