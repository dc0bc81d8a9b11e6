//! Selects the backend from the keywords `backend` and `device`. An opened device stays open for
//! later calls.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{LazyLock, Mutex, PoisonError};

use meniscus::Source;
use meniscus::devices::{self, Backend, DeviceChoice};
use meniscus::{Error, MemoryBudget};
use pyo3::prelude::*;

use crate::errors::{InputError, exception};
use crate::values::Keyword;
use crate::work::on_all_cores;

/// The values of the keywords `backend` and `device`.
#[derive(Default)]
pub struct Device {
    backend: Option<BackendName>,
    device: Option<String>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum BackendName {
    Auto,
    Cpu,
    Vulkan,
}

/// Open devices. The key consists of the process, whether the caller requires a device, and the
/// device's name. It contains the process because a forked child cannot use its parent's devices.
type OpenDevices = HashMap<(u32, bool, Option<String>), Backend>;

static OPEN_DEVICES: LazyLock<Mutex<OpenDevices>> = LazyLock::new(Mutex::default);

impl Device {
    pub fn set_backend(&mut self, keyword: &Keyword<'_, '_>) -> PyResult<()> {
        let name = keyword.one_of(&["auto", "cpu", "vulkan"])?;
        self.backend = Some([BackendName::Auto, BackendName::Cpu, BackendName::Vulkan][name]);
        Ok(())
    }

    pub fn set_device(&mut self, device: String) {
        self.device = Some(device);
    }

    /// Returns an error if the keywords select the CPU and also name a device.
    pub fn check(&self) -> PyResult<()> {
        if self.backend == Some(BackendName::Cpu) && self.device.is_some() {
            return Err(InputError::new_err("device: cannot be used with backend=\"cpu\""));
        }
        Ok(())
    }

    /// Whether the keywords require a device, instead of leaving the choice to the library.
    fn requires_device(&self) -> bool {
        match (self.backend, &self.device) {
            (Some(BackendName::Cpu), _) | (None | Some(BackendName::Auto), None) => false,
            (Some(BackendName::Vulkan), _) | (_, Some(_)) => true,
        }
    }

    /// Returns an error with the reason `why` if the keywords require a device.
    pub fn check_not_required(&self, why: &str) -> PyResult<()> {
        if self.requires_device() {
            return Err(InputError::new_err(format!("backend: {why}")));
        }
        Ok(())
    }

    /// Opens the device, or returns it if it is already open. Returns `None` for the CPU.
    pub fn open(
        &self,
        budget: MemoryBudget,
        input_bytes: Option<u64>,
    ) -> PyResult<Option<Backend>> {
        if self.backend == Some(BackendName::Cpu) {
            return Ok(None);
        }
        let is_required = self.requires_device();
        let key = (std::process::id(), is_required, self.device.clone());
        let mut open = OPEN_DEVICES.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(backend) = open.get(&key) {
            return Ok(Some(backend.clone()));
        }
        let cache: Option<PathBuf> = dirs::cache_dir().map(|folder| folder.join("meniscus"));
        let backend = if is_required {
            let choice = self.device.clone().map_or(DeviceChoice::Best, DeviceChoice::Named);
            on_all_cores(|| devices::device(&choice, cache.as_deref()))
                .and_then(|device| device.map_err(Error::Vulkan))
                .map_err(exception)?
        } else {
            let fastest = || devices::fastest(budget, || input_bytes, cache.as_deref());
            match on_all_cores(fastest).map_err(exception)? {
                (backend, None) => backend,
                (_, Some(_)) => return Ok(None),
            }
        };
        open.insert(key, backend.clone());
        Ok(Some(backend))
    }
}
