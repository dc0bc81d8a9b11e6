//! Compute on a Vulkan device: selection, memory, shaders, and batches of commands.
//!
//! This room knows nothing about fluids. It needs Vulkan 1.2 with timeline semaphores, and nothing
//! else. The guide for users is `guide.md`.

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
use thiserror::Error;

/// Bytes at whose multiples any device lets a part of a buffer begin.
pub const ALIGNMENT: u64 = 256;
/// Storage buffers that a shader binds at the most: devices that allow fewer are refused.
pub const MOST_BUFFERS: u32 = 8;
/// Threads of a work group at the most: devices that allow fewer are refused.
pub const MOST_THREADS: u32 = 256;
/// Bytes that the threads of a work group share at the most: devices that allow fewer are refused.
pub const MOST_SHARED: u32 = 16 << 10;
/// Bytes of a push block at the most, which any device allows.
pub const MOST_PUSH: u32 = 128;

/// An error of a device, its driver or the loader.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum VulkanError {
    /// The machine has no Vulkan loader, or the loader does not start.
    #[error("no Vulkan loader: {0}")]
    NoLoader(String),
    /// The validation layer was asked for and is not installed.
    #[error("the Vulkan validation layer is not installed")]
    NoValidation,
    /// The loader knows no device at all.
    #[error("no Vulkan device found")]
    NoDevice,
    /// No device of that number or name.
    #[error("no Vulkan device {wanted:?}; available: {known}")]
    NotFound {
        /// The number or name that was asked for.
        wanted: String,
        /// Number and name of each.
        known: String,
    },
    /// A device that lacks what is needed.
    #[error("{device} cannot be used: {lacks}")]
    Unsuitable {
        /// The name of the device.
        device: String,
        /// The requirement that the device does not meet.
        lacks: &'static str,
    },
    /// Memory of the device, or the share of it that may be used, is exhausted.
    #[error("device memory is exhausted: cannot allocate {bytes} more bytes")]
    OutOfMemory {
        /// How many were asked for.
        bytes: u64,
    },
    /// The device stopped working.
    #[error("the Vulkan device was lost")]
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

impl VulkanError {
    /// The error of a call.
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
