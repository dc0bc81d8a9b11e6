//! The shaders' binaries are those of their sources, and their interfaces are what Rust believes.

use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};

use meniscus::internals::backend::shaders::SHADERS;
use meniscus::internals::vulkan::{MOST_BUFFERS, MOST_PUSH, MOST_SHARED, MOST_THREADS, Shader};
use naga::{AddressSpace, TypeInner};

use crate::compile::{self, folder, parsed, source};

#[test]
fn every_binary_is_what_its_source_compiles_to() {
    let outdated: Vec<_> = compile::outdated().unwrap().into_iter().map(|binary| binary.file).collect();
    assert!(outdated.is_empty(), "`cargo run --example shaders` would rewrite {outdated:?}");
}

#[test]
fn no_binary_is_without_a_program_and_no_source_unused() {
    let mut used: Vec<String> = SHADERS.iter().map(|p| p.name.to_owned()).collect();
    let mut binaries = Vec::new();
    let mut sources = Vec::new();
    for file in fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path()) {
        let stem = file.file_stem().unwrap().to_str().unwrap().to_owned();
        match file.extension().unwrap().to_str().unwrap() {
            "spv" => binaries.push(stem),
            "wgsl" => sources.push(stem),
            other => panic!("{other} in spirv"),
        }
    }
    binaries.sort();
    used.sort();
    assert_eq!(binaries, used);
    for part in sources.iter().filter(|s| !used.contains(s)) {
        let named = |p: &&Shader| {
            let text = fs::read_to_string(folder().join(p.name).with_extension("wgsl")).unwrap();
            text.lines().next().unwrap().split_whitespace().any(|word| word == part)
        };
        assert!(SHADERS.iter().any(named), "nothing uses {part}.wgsl");
    }
}

#[test]
fn bindings_push_blocks_and_groups_are_what_rust_believes() {
    for shader in SHADERS {
        let module = parsed(shader.name, &source(shader.name).unwrap()).unwrap();
        let [entry] = &module.entry_points[..] else { panic!("{}: one entry point", shader.name) };
        assert_eq!((entry.name.as_str(), entry.workgroup_size), (shader.name, shader.group));
        let mut bound: Vec<(u32, &str)> = Vec::new();
        let mut push = Vec::new();
        let mut shared = 0;
        for (_, variable) in module.global_variables.iter() {
            if let Some(binding) = &variable.binding {
                assert_eq!(binding.group, 0, "{}", shader.name);
                assert!(matches!(variable.space, AddressSpace::Storage { .. }), "{}", shader.name);
                bound.push((binding.binding, variable.name.as_deref().unwrap()));
            } else if variable.space == AddressSpace::WorkGroup {
                shared += module.types[variable.ty].inner.size(module.to_ctx()).next_multiple_of(16);
            } else if variable.space == AddressSpace::Immediate {
                let TypeInner::Struct { members, .. } = &module.types[variable.ty].inner else {
                    panic!("{}: the push block is a structure", shader.name)
                };
                push = members
                    .iter()
                    .map(|m| {
                        let bytes = module.types[m.ty].inner.size(module.to_ctx());
                        (m.name.as_deref().unwrap(), m.offset, bytes)
                    })
                    .collect();
            }
        }
        bound.sort_unstable();
        let believed: Vec<_> = (0..).zip(shader.buffers.iter().copied()).collect();
        assert_eq!(bound, believed, "{}", shader.name);
        let believed: Vec<_> = shader.push.iter().map(|f| (f.name, f.offset, f.bytes)).collect();
        assert_eq!(push, believed, "{}", shader.name);
        let [width, height, depth] = shader.group;
        assert_eq!((height, depth), (1, 1), "{}", shader.name);
        for (used, most) in [
            (shader.push_bytes(), MOST_PUSH),
            (shader.buffers.len() as u32, MOST_BUFFERS),
            (width, MOST_THREADS),
            (shared, MOST_SHARED),
        ] {
            assert!(used <= most, "{}: {used} of {most}", shader.name);
        }
    }
}

#[test]
fn spirv_val_accepts_every_binary() {
    if Command::new("spirv-val").arg("--version").output().is_err() {
        assert!(std::env::var_os("MENISCUS_REQUIRE_VULKAN").is_none(), "spirv-val is not installed");
        let _ = writeln!(std::io::stderr(), "skipped: spirv_val_accepts_every_binary: it is not installed");
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
        assert!(output.status.success(), "{}: {}", shader.name, String::from_utf8_lossy(&output.stderr));
    }
}
