//! Where work runs, as the keywords `backend` and `device` say it: a device is opened once, and
//! kept for the calls that follow.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{LazyLock, Mutex, PoisonError};

use meniscus::Source;
use meniscus::devices::{self, Backend, DeviceChoice};
use meniscus::{Error, MemoryBudget};
use pyo3::prelude::*;

use crate::errors::{InputError, exception};
use crate::values::Given;

/// The processor or a device, as it is asked for.
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

/// Devices that are open, by the process that opened them, by whether one was asked for, and by
/// their names. A child that was forked cannot use its parent's.
type Open = HashMap<(u32, bool, Option<String>), Backend>;

static OPEN: LazyLock<Mutex<Open>> = LazyLock::new(Mutex::default);

impl Device {
    pub fn backend(&mut self, given: &Given<'_, '_>) -> PyResult<()> {
        let name = given.one_of(&["auto", "cpu", "vulkan"])?;
        self.backend = Some([Name::Auto, Name::Cpu, Name::Vulkan][name]);
        Ok(())
    }

    pub fn named(&mut self, device: String) {
        self.device = Some(device);
    }

    /// Refuses a device for the processor.
    pub fn check(&self) -> PyResult<()> {
        if self.backend == Some(Name::Cpu) && self.device.is_some() {
            return Err(InputError::new_err("device: the backend is the processor"));
        }
        Ok(())
    }

    /// Whether a device is asked for, and not only welcome.
    fn is_wanted(&self) -> bool {
        match (self.backend, &self.device) {
            (Some(Name::Cpu), _) | (None | Some(Name::Auto), None) => false,
            (Some(Name::Vulkan), _) | (_, Some(_)) => true,
        }
    }

    /// Refuses a device that was asked for.
    pub fn refuse(&self, why: &str) -> PyResult<()> {
        if self.is_wanted() {
            return Err(InputError::new_err(format!("backend: {why}")));
        }
        Ok(())
    }

    /// Opens it; `None` for the processor.
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
            devices::device(&choice, cache.as_deref())
                .map_err(|error| exception(Error::Vulkan(error)))?
        } else {
            match devices::fastest(budget, || input_bytes, cache.as_deref()) {
                (backend, None) => backend,
                (_, Some(_)) => return Ok(None),
            }
        };
        open.insert(key, backend.clone());
        Ok(Some(backend))
    }
}
