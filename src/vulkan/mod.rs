//! Compute on a Vulkan device: selection, memory, shaders, and batches of commands.
//!
//! This module is independent of fluids. It needs only Vulkan 1.2 with timeline semaphores. The
//! guide for users is `guide.md`.

mod batch;
mod buffer;
mod device;
mod families;
mod faults;
mod instance;
mod shader;

pub use batch::{Batch, SemaphorePoint, Ticket};
pub use buffer::{Buffer, BufferKind, View};
pub use device::{
    Counters, Device, DeviceOptions, ExternalDevice, Limits, PIECE, Queue, Queues, Timing,
};
pub use faults::Faults;
pub use instance::{DeviceChoice, DeviceInfo, DeviceKind, Instance, ValidationLog};
pub use shader::{ComputePipeline, Shader};

use ash::vk;
use bytesize::ByteSize;
use thiserror::Error;

/// An alignment, in bytes, that is sufficient for buffer offsets on every device.
pub const ALIGNMENT: u64 = 256;
/// Maximum number of storage buffers per shader; devices with a lower limit are not supported.
pub const MOST_BUFFERS: u32 = 8;
/// Maximum number of threads per work group; devices with a lower limit are not supported.
pub const MOST_THREADS: u32 = 256;
/// Maximum bytes of shared memory per work group; devices with a lower limit are not supported.
pub const MOST_SHARED: u32 = 16 << 10;
/// Maximum size of push constants, in bytes. Every device supports this size.
pub const MOST_PUSH: u32 = 128;

/// An error of a device, its driver or the loader.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum VulkanError {
    /// The machine has no Vulkan loader, or the loader does not start.
    #[error("Vulkan is not available: {0}")]
    NoLoader(String),
    /// The threads of drivers would overflow their stacks.
    #[error(
        "Vulkan drivers need a stack of at least {needed} KiB, but the limit is {there} KiB; raise \
         it with `ulimit -s {needed}`",
        needed = least >> 10, there = limit >> 10
    )]
    SmallStack {
        /// The current stack limit, in bytes.
        limit: u64,
        /// The smallest stack limit, in bytes, that meniscus accepts.
        least: u64,
    },
    /// The validation layer was requested, but is not installed.
    #[error("the Vulkan validation layer is not installed; install it, or do not request it")]
    NoValidation,
    /// The loader does not list any device.
    #[error("no Vulkan device found")]
    NoDevice,
    /// No device has the requested number or name.
    #[error("no Vulkan device matches {wanted:?}; available devices: {known}")]
    NotFound {
        /// The requested number or name.
        wanted: String,
        /// Number and name of each device.
        known: String,
    },
    /// The device lacks a required feature.
    #[error("device \"{device}\" cannot be used: {lacks}")]
    Unsuitable {
        /// The name of the device.
        device: String,
        /// The requirement that the device does not meet.
        lacks: &'static str,
    },
    /// The memory of the device, or the memory limit, is exhausted.
    #[error("device memory is exhausted{}", requested(*bytes))]
    OutOfMemory {
        /// The number of requested bytes; 0 if it is unknown.
        bytes: u64,
    },
    /// The device stopped working.
    #[error("the Vulkan device stopped working (device lost)")]
    Lost,
    /// Any other call that failed.
    #[error("{call} failed: {result}")]
    Call {
        /// The name of the call.
        call: &'static str,
        /// The result that the call returned.
        result: vk::Result,
    },
}

fn requested(bytes: u64) -> String {
    match bytes {
        0 => String::new(),
        bytes => format!(": cannot allocate another {}", ByteSize(bytes)),
    }
}

impl VulkanError {
    /// Converts the result of a call to an error.
    fn of(call: &'static str) -> impl Fn(vk::Result) -> Self {
        move |result| match result {
            vk::Result::ERROR_DEVICE_LOST => Self::Lost,
            vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY => {
                Self::OutOfMemory { bytes: 0 }
            }
            result => Self::Call { call, result },
        }
    }
}
