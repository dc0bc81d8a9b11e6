//! The choice of a backend: the CPU, a device that the caller names, or the backend that is likely
//! to be faster.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytesize::ByteSize;

use crate::grid::units::MemoryBudget;
use crate::vulkan::{
    Device, DeviceChoice, DeviceInfo, DeviceKind, DeviceOptions, Instance, VulkanError,
};

use super::vulkan::MOST_HOST_BYTES;
use super::{Cpu, Executor, Vulkan};

/// A CPU or a device that runs the stages of frames. All backends produce the same bytes.
///
/// Clones share the device and its compiled shaders.
#[derive(Debug, Clone)]
pub struct Backend(Arc<dyn Executor>);

impl Backend {
    /// A backend that computes frames on all threads of the caller's thread pool.
    #[must_use]
    pub fn cpu() -> Self {
        Self::of(Cpu)
    }

    /// A backend that computes frames on `device`. Compiles the shaders for this device.
    ///
    /// # Errors
    /// [`VulkanError`] if the driver rejects a shader.
    pub fn vulkan(device: Device) -> Result<Self, VulkanError> {
        Ok(Self::of(Vulkan::new(device)?))
    }

    /// Returns the name of the CPU or device, for display.
    #[must_use]
    pub fn name(&self) -> String {
        self.0.name()
    }

    /// Returns the device; `None` for the CPU.
    #[must_use]
    pub fn device(&self) -> Option<&Device> {
        self.0.device()
    }

    // Public because tests pass an executor that monitors a device. `Executor` itself is public
    // only in `internals`.
    #[doc(hidden)]
    pub fn of(executor: impl Executor + 'static) -> Self {
        Self(Arc::new(executor))
    }

    #[doc(hidden)]
    #[must_use]
    pub fn executor(&self) -> &dyn Executor {
        &*self.0
    }
}

/// Size, in bytes, of the particles that two threads mesh in about a third of a second. In this
/// time, a driver opens a device, and compiles shaders or loads them from its cache. The size
/// corresponds to a million particles.
const SMALL: u64 = 12_000_000;

/// The smallest memory budget with which [`fastest`] looks for a device.
///
/// The driver and the batches of a device take up to [`MOST_HOST_BYTES`] of this budget. At least
/// three fifths of the budget remain for particles, samples and the surface.
const DEVICE_BUDGET: MemoryBudget = MemoryBudget(1 << 30);
const _: () = assert!(MOST_HOST_BYTES <= DEVICE_BUDGET.0 / 5 * 2);

/// Extensions of files whose size does not show the size of the particles, because the files are
/// compressed or consist of several pieces.
const UNKNOWN_SIZE: [&str; 7] = ["gz", "xz", "zst", "mnf", "npz", "bi4", "vtm"];

/// A reason to use the CPU.
#[derive(Debug)]
#[non_exhaustive]
pub enum CpuReason {
    /// The memory limit is below this number of bytes. A device would need too much of this memory.
    LittleMemory(u64),
    /// The machine has no GPU.
    NoGpu,
    /// Meshing this number of bytes of particles on the CPU takes less time than starting a device.
    Small(u64),
    /// The best device is not a discrete GPU.
    NotDiscrete(String),
    /// The best device has not passed the conformance tests.
    NotConformant(String),
    /// No device can be used.
    Vulkan(VulkanError),
}

impl fmt::Display for CpuReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LittleMemory(least) => {
                write!(f, "a GPU is used only if the memory limit is at least {}", ByteSize(*least))
            }
            Self::NoGpu => {
                f.write_str("no GPU found (drivers such as llvmpipe compute on the CPU)")
            }
            Self::Small(bytes) => write!(
                f,
                "meshing {} of particles takes less time than starting a GPU",
                ByteSize(*bytes)
            ),
            Self::NotDiscrete(name) => write!(f, "{name} is not a discrete GPU"),
            Self::NotConformant(name) => {
                write!(f, "{name} has not passed the Vulkan conformance tests")
            }
            Self::Vulkan(error) => error.fmt(f),
        }
    }
}

/// Opens a device, and compiles its shaders or loads them from the folder `cache`. Buffers may take
/// three quarters of the device's free memory.
///
/// # Errors
/// [`VulkanError`] if there is no such device, or if it cannot be used.
pub fn device(choice: &DeviceChoice, cache: Option<&Path>) -> Result<Backend, VulkanError> {
    let instance = Instance::connect(false)?;
    opened(&instance, &instance.choose(choice)?, cache)
}

/// Opens the best device if it is likely to be faster than the CPU, and if the memory limit is
/// large enough for the host memory that a device needs. Otherwise, returns the CPU and the reason.
/// `input_bytes` returns the size of the input in bytes, if it is known.
#[must_use]
pub fn fastest(
    budget: MemoryBudget,
    input_bytes: impl FnOnce() -> Option<u64>,
    cache: Option<&Path>,
) -> (Backend, Option<CpuReason>) {
    match fast_device(budget, input_bytes, cache) {
        Ok(backend) => (backend, None),
        Err(reason) => (Backend::cpu(), Some(reason)),
    }
}

fn fast_device(
    budget: MemoryBudget,
    input_bytes: impl FnOnce() -> Option<u64>,
    cache: Option<&Path>,
) -> Result<Backend, CpuReason> {
    if budget < DEVICE_BUDGET {
        return Err(CpuReason::LittleMemory(DEVICE_BUDGET.0));
    }
    if !may_have_gpu(Path::new("/dev")) {
        return Err(CpuReason::NoGpu);
    }
    if let Some(bytes) = input_bytes().filter(|&bytes| bytes < SMALL) {
        return Err(CpuReason::Small(bytes));
    }
    let instance = Instance::connect(false).map_err(CpuReason::Vulkan)?;
    let info = instance.choose(&DeviceChoice::Best).map_err(CpuReason::Vulkan)?;
    if info.kind != DeviceKind::Discrete {
        return Err(CpuReason::NotDiscrete(info.name));
    }
    if !info.is_conformant() {
        return Err(CpuReason::NotConformant(info.name));
    }
    opened(&instance, &info, cache).map_err(CpuReason::Vulkan)
}

fn opened(
    instance: &Arc<Instance>,
    info: &DeviceInfo,
    cache: Option<&Path>,
) -> Result<Backend, VulkanError> {
    let pipeline_cache = cache.map(PathBuf::from);
    let options = DeviceOptions {
        memory: Some(info.free / 4 * 3),
        pipeline_cache,
        ..DeviceOptions::default()
    };
    let choice = DeviceChoice::Named(info.index.to_string());
    Backend::vulkan(Device::open(instance, &choice, &options)?)
}

/// Total size, in bytes, of the particles in `files`; `None` if a file is missing, or if its size
/// does not show how many particles it holds.
pub fn bytes_of<'a>(files: impl IntoIterator<Item = &'a Path>) -> Option<u64> {
    let bytes = |file: &Path| {
        let extension = file.extension().unwrap_or_default().to_ascii_lowercase();
        let is_known = UNKNOWN_SIZE.iter().all(|unknown| extension != *unknown);
        std::fs::metadata(file).ok().filter(|_| is_known).map(|metadata| metadata.len())
    };
    files.into_iter().map(bytes).sum()
}

/// Whether loading the Vulkan drivers may find a GPU, rather than only drivers that compute on the
/// CPU. The check ignores device nodes with numbers: if a container has access to only one of the
/// GPUs, the node of that GPU can have any number.
fn may_have_gpu(nodes: &Path) -> bool {
    let known = ["dri", "nvidiactl", "dxg"];
    !cfg!(target_os = "linux") || known.iter().any(|node| nodes.join(node).exists())
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn a_gpu_device_node_with_any_number_is_detected() {
        let nodes = tempfile::tempdir().expect("a temporary folder can be made");
        assert!(!may_have_gpu(nodes.path()));
        for node in ["nvidia3", "nvidiactl"] {
            std::fs::write(nodes.path().join(node), "").expect("a file can be written");
        }
        assert!(may_have_gpu(nodes.path()));
    }

    #[test]
    fn no_device_is_opened_if_the_memory_budget_is_too_small() {
        // An input of 0 bytes is too small for a device, so no driver is loaded.
        let budget_is_too_small = |budget: u64| {
            let chosen = fast_device(MemoryBudget(budget), || Some(0), None);
            matches!(chosen, Err(CpuReason::LittleMemory(least)) if least == DEVICE_BUDGET.0)
        };
        assert!(budget_is_too_small(DEVICE_BUDGET.0 - 1));
        assert!(!budget_is_too_small(DEVICE_BUDGET.0));
    }
}
