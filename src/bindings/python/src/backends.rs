//! Selects the backend from the keywords `backend` and `device`. A device stays open for later
//! calls.

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
    backend: Option<Name>,
    device: Option<String>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Name {
    Auto,
    Cpu,
    Vulkan,
}

/// Open devices. The key consists of the process, whether the caller requires a device, and the
/// device's name. It contains the process because a forked child cannot use its parent's devices.
type Open = HashMap<(u32, bool, Option<String>), Backend>;

static OPEN: LazyLock<Mutex<Open>> = LazyLock::new(Mutex::default);

impl Device {
    pub fn backend(&mut self, given: &Keyword<'_, '_>) -> PyResult<()> {
        let name = given.one_of(&["auto", "cpu", "vulkan"])?;
        self.backend = Some([Name::Auto, Name::Cpu, Name::Vulkan][name]);
        Ok(())
    }

    pub fn named(&mut self, device: String) {
        self.device = Some(device);
    }

    /// Returns an error if the keywords select the CPU and also name a device.
    pub fn check(&self) -> PyResult<()> {
        if self.backend == Some(Name::Cpu) && self.device.is_some() {
            return Err(InputError::new_err("device: cannot be used with backend=\"cpu\""));
        }
        Ok(())
    }

    /// Whether the keywords require a device, instead of leaving the choice to the library.
    fn is_wanted(&self) -> bool {
        match (self.backend, &self.device) {
            (Some(Name::Cpu), _) | (None | Some(Name::Auto), None) => false,
            (Some(Name::Vulkan), _) | (_, Some(_)) => true,
        }
    }

    /// Returns an error with the reason `why` if the keywords require a device.
    pub fn refuse(&self, why: &str) -> PyResult<()> {
        if self.is_wanted() {
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
        if self.backend == Some(Name::Cpu) {
            return Ok(None);
        }
        let wanted = self.is_wanted();
        let key = (std::process::id(), wanted, self.device.clone());
        let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(backend) = open.get(&key) {
            return Ok(Some(backend.clone()));
        }
        let cache: Option<PathBuf> = dirs::cache_dir().map(|folder| folder.join("meniscus"));
        let backend = if wanted {
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
