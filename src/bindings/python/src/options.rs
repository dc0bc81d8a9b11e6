//! Converts keywords to settings of the library. Keywords are the program's options in snake case.

use meniscus::{MemoryBudget, Reconstruction, Settings, default_memory};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::backends::Device;
use crate::errors::InputError;
use crate::simulation::SIMULATION_KEYWORDS;
use crate::values::Keyword;

/// A group of keywords. Each function accepts only certain groups.
#[derive(Clone, Copy, PartialEq)]
pub enum KeywordGroup {
    /// Keywords for sampling the particles.
    Sampling,
    /// Keywords for computing a surface from sampled particles.
    Surface,
    /// Keywords for the backend, threads and memory.
    Machine,
    /// Keywords for reading particle files.
    Files,
    /// The keyword `where`, which selects particles.
    Where,
    /// The keyword `attributes`, which names attributes for the vertices.
    Attributes,
    /// Keywords for the frames of a simulation.
    Simulation,
}

impl KeywordGroup {
    fn of(name: &str) -> Option<Self> {
        if MACHINE_KEYWORDS.contains(&name) {
            return Some(Self::Machine);
        }
        if FILE_KEYWORDS.contains(&name) {
            return Some(Self::Files);
        }
        if name == "where" {
            return Some(Self::Where);
        }
        if name == "attributes" {
            return Some(Self::Attributes);
        }
        if SIMULATION_KEYWORDS.contains(&name) {
            return Some(Self::Simulation);
        }
        let setting = Settings::ALL.iter().find(|setting| setting.name() == name)?;
        Some(if setting.needs_particles() { Self::Sampling } else { Self::Surface })
    }
}

/// The keywords of [`KeywordGroup::Machine`].
const MACHINE_KEYWORDS: [&str; 5] = ["backend", "device", "threads", "memory", "scratch"];

/// The keywords of [`KeywordGroup::Files`].
const FILE_KEYWORDS: [&str; 1] = ["format"];

/// The keywords of a call, as a request. The backend is chosen later, when the input's size is
/// known.
pub struct Keywords {
    pub request: Reconstruction,
    device: Device,
    memory: MemoryBudget,
}

impl Keywords {
    /// Reads the keywords of a function. Keywords outside the groups in `known` give an error, and
    /// a keyword with the value None is ignored.
    pub fn of(
        function: &str,
        keywords: Option<&Bound<'_, PyDict>>,
        known: &[KeywordGroup],
    ) -> PyResult<Self> {
        let memory = default_memory();
        let mut parsed = Self { request: Reconstruction::new(), device: Device::default(), memory };
        let mut settings = Settings::default();
        let (mut spacing, mut cell) = (None, None);
        for (name, value) in keywords.into_iter().flatten() {
            let name: String = name.extract()?;
            let Some(kind) = KeywordGroup::of(&name).filter(|kind| known.contains(kind)) else {
                let what = format!("{function}() got an unexpected keyword argument '{name}'");
                return Err(PyTypeError::new_err(what));
            };
            if value.is_none() || kind == KeywordGroup::Simulation {
                continue;
            }
            let exclusive = match name.as_str() {
                "spacing" | "radius" => Some(&mut spacing),
                "cell" | "cell_size" => Some(&mut cell),
                _ => None,
            };
            if let Some(before) = exclusive.and_then(|slot| slot.replace(name.clone())) {
                return Err(InputError::new_err(format!(
                    "{name}: cannot be used with {before}, which sets the same length"
                )));
            }
            let keyword = Keyword { name: &name, value: &value };
            if !settings.set(&name, &keyword)? {
                parsed.set_machine_option(&keyword)?;
            }
        }
        parsed.device.check()?;
        parsed.request = parsed.request.with_settings(settings);
        Ok(parsed)
    }

    fn set_machine_option(&mut self, keyword: &Keyword<'_, '_>) -> PyResult<()> {
        let request = std::mem::take(&mut self.request);
        self.request = match keyword.name {
            "threads" => request.threads(keyword.whole()?),
            "memory" => {
                self.memory = MemoryBudget(keyword.bytes()?);
                request
            }
            "scratch" => request.scratch(keyword.path()?),
            "backend" => {
                self.device.set_backend(keyword)?;
                request
            }
            _ => {
                self.device.set_device(keyword.text_or_number()?);
                request
            }
        };
        Ok(())
    }

    /// Returns the request with the chosen backend. If the keywords leave the choice to the
    /// library, the library considers `input_bytes`, the size of the input, if known.
    pub fn on_machine(self, input_bytes: Option<u64>) -> PyResult<Reconstruction> {
        let request = self.request.memory(self.memory);
        if !request.uses_backend() {
            self.device.check_not_required("kernel methods run only on the CPU")?;
            return Ok(request);
        }
        Ok(match self.device.open(self.memory, input_bytes)? {
            Some(backend) => request.backend(backend),
            None => request,
        })
    }
}
