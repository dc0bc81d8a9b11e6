//! Compiles the shaders' sources to SPIR-V binaries and to a Rust table. The example `shaders` and
//! the tests use this module.

#[path = "table.rs"]
mod table;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};

use meniscus::internals::backend::wgsl_constants;
use meniscus::internals::shaders::SHADERS;
use meniscus::internals::vulkan::Shader;
use naga::Module;
use naga::back::spv;
use naga::proc::{BoundsCheckPolicies, BoundsCheckPolicy};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use rspirv::binary::Assemble;
use rspirv::dr::{Instruction, Operand};
use rspirv::spirv::{Decoration, Op, StorageClass, Word};

/// An error about a source that cannot be read or compiled, with the source's name, the line and
/// the cause.
pub type Fault = Box<dyn std::error::Error + Send + Sync>;

/// A file that is generated from the sources: a binary, or the Rust table.
pub struct GeneratedFile {
    pub file: PathBuf,
    pub bytes: Vec<u8>,
}

/// Compiles all sources, and returns the generated files that are missing or outdated.
pub fn outdated() -> Result<Vec<GeneratedFile>, Fault> {
    let (mut made, mut modules) = (Vec::new(), BTreeMap::new());
    for name in programs()? {
        let source = source(&name)?;
        let file = folder().join(&name).with_extension("spv");
        made.push(GeneratedFile { file, bytes: compiled(&name, &source)? });
        let module = parsed(&name, &source)?;
        modules.insert(name, module);
    }
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/shaders.rs");
    made.push(GeneratedFile { file, bytes: table::rust(&modules)?.into_bytes() });
    made.retain(|made| fs::read(&made.file).ok().as_ref() != Some(&made.bytes));
    Ok(made)
}

/// The sorted names of the sources with an entry point. All other sources are parts of programs.
pub fn programs() -> Result<Vec<String>, Fault> {
    let mut programs = Vec::new();
    for entry in fs::read_dir(folder())? {
        let file = entry?.path();
        let name = file.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
        if file.extension().is_some_and(|kind| kind == "wgsl") && read(name)?.contains("@compute") {
            programs.push(name.to_owned());
        }
    }
    programs.sort();
    Ok(programs)
}

/// The folder of the sources and binaries.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("spirv")
}

/// Reads the text of a source, without the parts that it includes.
fn read(name: &str) -> Result<String, Fault> {
    let file = folder().join(name).with_extension("wgsl");
    fs::read_to_string(&file).map_err(|cause| format!("{}: {cause}", file.display()).into())
}

/// Reads the complete source of a program: its constants, its included parts and its own text.
pub fn source(name: &str) -> Result<String, Fault> {
    whole(&read(name)?)
}

/// Completes a source: prepends the parts that its first line names, and before them the constants
/// that it uses.
pub fn whole(own: &str) -> Result<String, Fault> {
    let parts = own.lines().next().and_then(|line| line.strip_prefix("//! with ")).unwrap_or("");
    let parts = parts.split_whitespace().map(read).collect::<Result<String, Fault>>()?;
    let text = parts + own;
    let words: HashSet<&str> = text.split(|c: char| !c.is_alphanumeric() && c != '_').collect();
    let named = wgsl_constants().into_iter().filter(|(name, ..)| words.contains(name));
    let constants: String =
        named.map(|(name, kind, value)| format!("const {name}: {kind} = {value};\n")).collect();
    Ok(constants + &text)
}

/// Parses a complete source.
pub fn parsed(name: &str, source: &str) -> Result<Module, Fault> {
    naga::front::wgsl::parse_str(source)
        .map_err(|fault| format!("{name}: {}", fault.emit_to_string(source)).into())
}

/// Compiles a complete source to SPIR-V.
pub fn compiled(name: &str, source: &str) -> Result<Vec<u8>, Fault> {
    compiled_with(name, source, BoundsCheckPolicy::Unchecked)
}

/// Compiles all programs with bounds checks: an index beyond the end of a buffer or an array
/// becomes the last index.
pub fn checked() -> Result<HashMap<&'static str, Vec<u8>>, Fault> {
    let binary = |shader: &&Shader| {
        let checks = BoundsCheckPolicy::Restrict;
        Ok((shader.name, compiled_with(shader.name, &source(shader.name)?, checks)?))
    };
    SHADERS.iter().map(binary).collect()
}

fn compiled_with(name: &str, source: &str, checks: BoundsCheckPolicy) -> Result<Vec<u8>, Fault> {
    let mut module = parsed(name, source)?;
    naga::compact::compact(&mut module, naga::compact::KeepUnused::No);
    let info = Validator::new(ValidationFlags::all(), Capabilities::IMMEDIATES)
        .validate(&module)
        .map_err(|fault| format!("{name}: {}", fault.emit_to_string(source)))?;
    let options = spv::Options {
        lang_version: (1, 3),
        flags: spv::WriterFlags::empty(),
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::None,
        use_storage_input_output_16: false,
        force_loop_bounding: false,
        bounds_check_policies: BoundsCheckPolicies {
            index: checks,
            buffer: checks,
            ..Default::default()
        },
        ..spv::Options::default()
    };
    let words = spv::write_vec(&module, &info, &options, None)?;
    let words = without_unused_layouts(&words).map_err(|fault| format!("{name}: {fault}"))?;
    Ok(words.iter().flat_map(|word| word.to_le_bytes()).collect())
}

/// Removes the layout decorations of all types except those of storage buffers and push blocks.
/// naga decorates all arrays, but Vulkan allows no layouts in workgroup memory
/// (VUID-StandaloneSpirv-None-10684).
fn without_unused_layouts(words: &[u32]) -> Result<Vec<u32>, Fault> {
    let mut module = rspirv::dr::load_words(words).map_err(|fault| fault.to_string())?;
    let ids = |of: &Instruction| {
        of.operands.iter().filter_map(Operand::id_ref_any).collect::<Vec<Word>>()
    };
    let reached_from = |classes: &[StorageClass]| {
        let types = &module.types_global_values;
        let is_of = |operand: &Operand| matches!(operand, Operand::StorageClass(class) if classes.contains(class));
        let is_pointer =
            |of: &&Instruction| of.class.opcode == Op::TypePointer && of.operands.iter().any(is_of);
        let mut open: Vec<Word> = types.iter().filter(is_pointer).flat_map(ids).collect();
        let mut reached = HashSet::new();
        while let Some(next) = open.pop() {
            if reached.insert(next) {
                open.extend(types.iter().filter(|of| of.result_id == Some(next)).flat_map(ids));
            }
        }
        reached
    };
    let laid_out = reached_from(&[StorageClass::StorageBuffer, StorageClass::PushConstant]);
    let shared = reached_from(&[StorageClass::Workgroup]);
    let target = |of: &Instruction| {
        let layouts = [Decoration::ArrayStride, Decoration::Offset, Decoration::MatrixStride];
        let is_layout = |operand: &Operand| matches!(operand, Operand::Decoration(what) if layouts.contains(what));
        of.operands.iter().any(is_layout).then(|| of.operands[0].unwrap_id_ref())
    };
    let targets: HashSet<Word> = module.annotations.iter().filter_map(target).collect();
    if let Some(both) = targets.iter().find(|id| laid_out.contains(*id) && shared.contains(*id)) {
        return Err(format!(
            "type {both} is used in a buffer and in workgroup memory, but can have only one layout"
        )
        .into());
    }
    module.annotations.retain(|of| target(of).is_none_or(|id| laid_out.contains(&id)));
    Ok(module.assemble())
}
