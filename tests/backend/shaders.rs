//! Tests that the shaders' binaries and their Rust table match the sources, stay within the limits
//! of all devices, and are valid.

use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};

use meniscus::internals::shaders::SHADERS;
use meniscus::internals::vulkan::{MOST_BUFFERS, MOST_PUSH, MOST_SHARED, MOST_THREADS};
use naga::AddressSpace;

use crate::compile::{self, folder, parsed, programs, source};

#[test]
fn binaries_and_the_rust_table_match_the_sources() {
    let outdated: Vec<_> = compile::outdated().unwrap().into_iter().map(|made| made.file).collect();
    assert!(outdated.is_empty(), "`cargo run --example shaders` would rewrite {outdated:?}");
}

#[test]
fn every_binary_has_a_source_and_every_source_is_used() {
    let programs = programs().unwrap();
    let mut binaries = Vec::new();
    let mut sources = Vec::new();
    for file in fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path()) {
        let stem = file.file_stem().unwrap().to_str().unwrap().to_owned();
        match file.extension().unwrap().to_str().unwrap() {
            "spv" => binaries.push(stem),
            "wgsl" => sources.push(stem),
            other => panic!("unexpected extension {other} in spirv"),
        }
    }
    binaries.sort();
    assert_eq!(binaries, programs);
    for part in sources.iter().filter(|s| !programs.contains(s)) {
        let uses_part = |program: &String| {
            let text = fs::read_to_string(folder().join(program).with_extension("wgsl")).unwrap();
            text.lines().next().unwrap().split_whitespace().any(|word| word == part)
        };
        assert!(programs.iter().any(uses_part), "nothing uses {part}.wgsl");
    }
}

#[test]
fn every_shader_stays_within_the_limits_of_all_devices() {
    for shader in SHADERS {
        let module = parsed(shader.name, &source(shader.name).unwrap()).unwrap();
        let shared =
            module.global_variables.iter().filter(|(_, v)| v.space == AddressSpace::WorkGroup);
        let bytes = |ty| module.types[ty].inner.size(module.to_ctx()).next_multiple_of(16);
        let shared = shared.map(|(_, variable)| bytes(variable.ty)).sum();
        for (used, most) in [
            (shader.push_bytes, MOST_PUSH),
            (shader.buffers.len() as u32, MOST_BUFFERS),
            (shader.group, MOST_THREADS),
            (shared, MOST_SHARED),
        ] {
            assert!(used <= most, "{}: {used} of {most}", shader.name);
        }
    }
}

#[test]
fn spirv_val_accepts_every_binary() {
    if Command::new("spirv-val").arg("--version").output().is_err() {
        assert!(
            std::env::var_os("MENISCUS_REQUIRE_VULKAN").is_none(),
            "spirv-val is not installed"
        );
        let _ = writeln!(
            std::io::stderr(),
            "skipped: spirv_val_accepts_every_binary: spirv-val is not installed"
        );
        return;
    }
    for shader in SHADERS {
        let mut validator = Command::new("spirv-val")
            .args(["--target-env", "vulkan1.2", "-"])
            .stdin(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        validator.stdin.take().unwrap().write_all(shader.code).unwrap();
        let output = validator.wait_with_output().unwrap();
        assert!(
            output.status.success(),
            "{}: {}",
            shader.name,
            String::from_utf8_lossy(&output.stderr)
        );
    }
}
