//! Compute pipelines.

use std::fmt;
use std::sync::Arc;

use ash::{util::read_spv, vk};
use rayon::prelude::*;

use super::device::SharedDevice;
use super::{Device, VulkanError};

/// A compute shader and its interface.
#[derive(Debug, Clone, Copy)]
pub struct Shader {
    /// The name of the shader's source, without extension, and of its entry point.
    pub name: &'static str,
    /// The SPIR-V binary of the shader.
    pub code: &'static [u8],
    /// The names of the storage buffers in the source, in the order of their bindings 0, 1, ... in
    /// set 0.
    pub buffers: &'static [&'static str],
    /// Bytes of push constants.
    pub push_bytes: u32,
    /// Number of threads in a work group, which is one-dimensional.
    pub group: u32,
}

/// A shader ready to run on a device.
pub struct ComputePipeline {
    pub(super) device: Arc<SharedDevice>,
    pub(super) shader: &'static Shader,
    pub(super) sets: vk::DescriptorSetLayout,
    pub(super) layout: vk::PipelineLayout,
    pub(super) pipeline: vk::Pipeline,
}

impl fmt::Debug for ComputePipeline {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("ComputePipeline").field(&self.shader.name).finish()
    }
}

impl ComputePipeline {
    /// Returns the number of work groups that together have at least `threads` threads.
    pub fn groups(&self, threads: u32) -> u32 {
        threads.div_ceil(self.shader.group)
    }
}

impl Device {
    /// Compiles several shaders in parallel.
    ///
    /// # Errors
    /// If [`pipeline`](Self::pipeline) fails for one of the shaders.
    pub fn pipelines<const N: usize>(
        &self,
        shaders: [&'static Shader; N],
    ) -> Result<[Arc<ComputePipeline>; N], VulkanError> {
        let compiled = shaders.par_iter().map(|shader| self.pipeline(shader).map(Arc::new));
        let compiled: Vec<_> = compiled.collect::<Result<_, _>>()?;
        Ok(compiled.try_into().expect("each shader has one pipeline"))
    }

    /// Compiles a shader, or loads it from the pipeline cache.
    ///
    /// # Errors
    /// [`VulkanError`] if the driver rejects the shader.
    pub fn pipeline(&self, shader: &'static Shader) -> Result<ComputePipeline, VulkanError> {
        let raw = &self.shared.raw;
        let binding = |i| {
            vk::DescriptorSetLayoutBinding::default()
                .binding(i)
                .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                .descriptor_count(1)
                .stage_flags(vk::ShaderStageFlags::COMPUTE)
        };
        let bindings: Vec<_> = (0..shader.buffers.len() as u32).map(binding).collect();
        let push = [vk::PushConstantRange::default()
            .stage_flags(vk::ShaderStageFlags::COMPUTE)
            .size(shader.push_bytes)];
        let binary = self.shared.binaries.get(shader.name).map_or(shader.code, Vec::as_slice);
        let code = read_spv(&mut std::io::Cursor::new(binary)).expect("a binary has whole words");
        // From here on, dropping `pipeline` frees everything if a later step fails.
        let mut pipeline = ComputePipeline {
            device: Arc::clone(&self.shared),
            shader,
            sets: vk::DescriptorSetLayout::null(),
            layout: vk::PipelineLayout::null(),
            pipeline: vk::Pipeline::null(),
        };
        // SAFETY: all handles belong to this device, and all pointers outlive the calls.
        unsafe {
            pipeline.sets = raw
                .create_descriptor_set_layout(
                    &vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings),
                    None,
                )
                .map_err(self.shared.call_error("vkCreateDescriptorSetLayout"))?;
            let sets = [pipeline.sets];
            let mut layout = vk::PipelineLayoutCreateInfo::default().set_layouts(&sets);
            if shader.push_bytes > 0 {
                layout = layout.push_constant_ranges(&push);
            }
            pipeline.layout = raw
                .create_pipeline_layout(&layout, None)
                .map_err(self.shared.call_error("vkCreatePipelineLayout"))?;
            let module = raw
                .create_shader_module(&vk::ShaderModuleCreateInfo::default().code(&code), None)
                .map_err(self.shared.call_error("vkCreateShaderModule"))?;
            let entry = std::ffi::CString::new(shader.name).expect("a name without zero bytes");
            let stage = vk::PipelineShaderStageCreateInfo::default()
                .stage(vk::ShaderStageFlags::COMPUTE)
                .module(module)
                .name(&entry);
            let info =
                [vk::ComputePipelineCreateInfo::default().stage(stage).layout(pipeline.layout)];
            let made = raw.create_compute_pipelines(self.shared.pipeline_cache, &info, None);
            raw.destroy_shader_module(module, None);
            pipeline.pipeline = made.map_err(|(_, result)| {
                self.shared.call_error("vkCreateComputePipelines")(result)
            })?[0];
        }
        Ok(pipeline)
    }
}

impl Drop for ComputePipeline {
    fn drop(&mut self) {
        // SAFETY: batches hold the pipelines that they run, so this pipeline is not in use.
        unsafe {
            self.device.raw.destroy_pipeline(self.pipeline, None);
            self.device.raw.destroy_pipeline_layout(self.layout, None);
            self.device.raw.destroy_descriptor_set_layout(self.sets, None);
        }
    }
}
