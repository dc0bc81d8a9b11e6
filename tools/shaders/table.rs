//! Generates the shaders' Rust table, `src/shaders.rs`, from their parsed sources.

use std::collections::BTreeMap;

use naga::{AddressSpace, GlobalVariable, Module, ScalarKind, TypeInner, VectorSize};

use super::Fault;

const HEAD: &str = "\
//! Every shader of `spirv`, and the push constants that each takes.
//!
//! `cargo run --example shaders` writes this file from the WGSL sources, which explain buffers and
//! fields.
#![allow(missing_docs, reason = \"the WGSL sources explain them\")]

use bytemuck::{Pod, Zeroable};

use crate::vulkan::Shader;
";

/// Returns the text of `src/shaders.rs` for these programs.
pub fn rust(programs: &BTreeMap<String, Module>) -> Result<String, Fault> {
    let mut text = format!("{HEAD}\n/// Every shader, by name.\n");
    text += &format!("pub const SHADERS: [&Shader; {}] = [\n", programs.len());
    programs.keys().for_each(|name| text += &format!("    &{},\n", name.to_uppercase()));
    text += "];\n";
    let mut blocks = BTreeMap::new();
    for (name, module) in programs {
        let within = |fault| format!("{name}.wgsl: {fault}");
        let push = push_block(module).map_err(within)?;
        text += &shader(name, module, push.as_ref().map(|block| &*block.name)).map_err(within)?;
        if let Some(Block { name: block, fields }) = push
            && *blocks.entry(block.clone()).or_insert_with(|| fields.clone()) != fields
        {
            return Err(within(format!("another shader declares a different {block}")).into());
        }
    }
    for (name, fields) in blocks {
        text += "\n#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]\n#[repr(C)]\n";
        text += &format!("pub struct {name} {{\n{fields}}}\n");
    }
    Ok(text)
}

/// Returns the Rust constant that describes a shader.
fn shader(name: &str, module: &Module, push: Option<&str>) -> Result<String, String> {
    let [entry] = &module.entry_points[..] else { return Err("needs one entry point".into()) };
    if entry.name != name {
        return Err(format!("the entry point must be named {name}, not {}", entry.name));
    }
    let [group, 1, 1] = entry.workgroup_size else {
        return Err("the workgroup must have size 1 along y and z".into());
    };
    let constant = name.to_uppercase();
    let buffers = buffers(module)?;
    let push_bytes = push.map_or("0".into(), |push| format!("size_of::<{push}>() as u32"));
    Ok(format!(
        "
pub const {constant}: Shader = Shader {{
    name: \"{name}\",
    code: include_bytes!(\"../spirv/{name}.spv\"),
    buffers: &{buffers:?},
    push_bytes: {push_bytes},
    group: {group},
}};
"
    ))
}

/// Returns the names of the storage buffers in set 0, in the order of their bindings 0, 1, ...
fn buffers(module: &Module) -> Result<Vec<&str>, String> {
    let mut buffers = BTreeMap::new();
    for (_, variable) in module.global_variables.iter() {
        let Some(binding) = &variable.binding else { continue };
        let name = name_of(variable);
        if binding.group != 0 || !matches!(variable.space, AddressSpace::Storage { .. }) {
            return Err(format!("{name} must be a storage buffer of group 0"));
        }
        buffers.insert(binding.binding, name);
    }
    if buffers.keys().copied().ne(0..buffers.len() as u32) {
        return Err(format!("bindings must be numbered from 0 without gaps: {buffers:?}"));
    }
    Ok(buffers.into_values().collect())
}

fn name_of(variable: &GlobalVariable) -> &str {
    variable.name.as_deref().expect("variables of WGSL have names")
}

/// A push block: the structure's name, and its fields as Rust declares them.
struct Block {
    name: String,
    fields: String,
}

fn push_block(module: &Module) -> Result<Option<Block>, String> {
    let variables = module.global_variables.iter().map(|(_, variable)| variable);
    let Some(push) = variables.into_iter().find(|v| v.space == AddressSpace::Immediate) else {
        return Ok(None);
    };
    let kind = &module.types[push.ty];
    let (Some(name), TypeInner::Struct { members, .. }) = (&kind.name, &kind.inner) else {
        return Err(format!("{} must be a structure", name_of(push)));
    };
    let (mut fields, mut end) = (String::new(), 0);
    for member in members {
        let field = member.name.as_deref().expect("fields of WGSL have names");
        let inner = &module.types[member.ty].inner;
        if member.offset != end {
            return Err(format!("{name}: {} bytes before {field} are unused", member.offset - end));
        }
        end += inner.size(module.to_ctx());
        let kind = rust_type(inner).ok_or_else(|| format!("{name}: no Rust type for {field}"))?;
        fields += &format!("    pub {field}: {kind},\n");
    }
    Ok(Some(Block { name: name.clone(), fields }))
}

/// Returns the Rust type that has the layout of a number or a vector.
fn rust_type(inner: &TypeInner) -> Option<String> {
    let (scalar, size) = match inner {
        TypeInner::Scalar(scalar) => (scalar, None),
        TypeInner::Vector { scalar, size } => (scalar, Some(*size)),
        _ => return None,
    };
    let number = match (scalar.kind, scalar.width) {
        (ScalarKind::Uint, 4) => "u32",
        (ScalarKind::Sint, 4) => "i32",
        (ScalarKind::Float, 4) => "f32",
        _ => return None,
    };
    Some(size.map_or(number.into(), |size: VectorSize| format!("[{number}; {}]", size as u8)))
}
