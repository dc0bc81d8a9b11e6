//! Keywords, which are the program's options in snake case, and what they mean to the library.

use meniscus::files::UpAxis;
use meniscus::{IndicatorKind, MemoryBudget, Method, PeriodicMesh, Reconstruction, default_memory};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::backends::Device;
use crate::errors::InputError;
use crate::values::Given;

/// The keywords that say how particles are sampled.
pub const SAMPLING: [&str; 11] = [
    "spacing",
    "radius",
    "cell_size",
    "cell",
    "origin",
    "domain",
    "periodic",
    "indicator",
    "mu0",
    "skip_invalid",
    "method",
];

/// The keywords of a surface, for which the particles are not needed again.
pub const SURFACE: [&str; 12] = [
    "periodic_mesh",
    "smooth",
    "sigma",
    "iso",
    "detail",
    "normals",
    "simplify",
    "smallest_component",
    "smallest_drop",
    "compress",
    "up",
    "particles_up",
];

/// The keywords of what the machine gives.
pub const MACHINE: [&str; 5] = ["backend", "device", "threads", "memory", "scratch"];

/// The keywords of files of particles.
pub const FILES: [&str; 2] = ["attributes", "particle_type"];

/// A request by its keywords, but for the backend, which depends on how large the input is.
pub struct Keywords {
    pub request: Reconstruction,
    device: Device,
    memory: MemoryBudget,
}

impl Keywords {
    /// Reads the keywords of a function, which are all of those in `known`; what is None is not said.
    pub fn of(function: &str, keywords: Option<&Bound<'_, PyDict>>, known: &[&[&str]]) -> PyResult<Self> {
        let memory = default_memory();
        let mut asked = Self { request: Reconstruction::new(), device: Device::default(), memory };
        let (mut spacing, mut cell) = (None, None);
        for (name, value) in keywords.into_iter().flatten() {
            let name: String = name.extract()?;
            if !known.iter().any(|names| names.contains(&name.as_str())) {
                let what = format!("{function}() got an unexpected keyword argument '{name}'");
                return Err(PyTypeError::new_err(what));
            }
            if value.is_none() {
                continue;
            }
            let exclusive = match name.as_str() {
                "spacing" | "radius" => Some(&mut spacing),
                "cell" | "cell_size" => Some(&mut cell),
                _ => None,
            };
            if let Some(before) = exclusive.and_then(|slot| slot.replace(name.clone())) {
                return Err(InputError::new_err(format!("{name}: {before} is given, and both say the same")));
            }
            asked.take(&Given { name: &name, value: &value })?;
        }
        asked.device.check()?;
        Ok(asked)
    }

    fn take(&mut self, given: &Given<'_, '_>) -> PyResult<()> {
        let request = std::mem::take(&mut self.request);
        self.request = match given.name {
            "spacing" => request.spacing(given.number()?),
            "radius" => {
                let radius = given.number()?;
                if !(radius.is_finite() && radius > 0.0) {
                    return Err(InputError::new_err(format!(
                        "radius: must be positive and finite, not {radius}"
                    )));
                }
                request.spacing(2.0 * radius)
            }
            "cell_size" => request.cell_size(given.number()?),
            "cell" => request.cell(given.number()?),
            "origin" => request.origin(given.point()?),
            "domain" => {
                let walls = given.faces()?.map(|walls| walls.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]));
                request.domain(walls.map(|[low, _]| low), walls.map(|[_, high]| high))
            }
            "periodic" => request.periodic(given.faces()?),
            "periodic_mesh" => request.periodic_mesh(
                given.one_of(&[PeriodicMesh::Cut, PeriodicMesh::Overlap].map(|ends| (ends.name(), ends)))?,
            ),
            "indicator" => {
                let known = [IndicatorKind::Cloud, IndicatorKind::Counting, IndicatorKind::Symmetry];
                request.indicator(given.one_of(&known.map(|kind| (kind.name(), kind)))?)
            }
            "method" => {
                let iso = Method::HALF;
                let known = [
                    ("dif", None),
                    ("mueller", Some(Method::Mueller { iso })),
                    ("zhu-bridson", Some(Method::ZhuBridson)),
                    ("yu-turk", Some(Method::YuTurk { iso })),
                ];
                match given.one_of(&known)? {
                    Some(method) => request.method(method),
                    None => request,
                }
            }
            "mu0" => request.mu0(given.number()?),
            "skip_invalid" if given.switch()? => request.skip_invalid(),
            "smooth" => request.smooth(given.number()?),
            "sigma" => request.sigma(given.number()?),
            "iso" if given.text().is_ok_and(|word| word == "auto") => request,
            "iso" => request.iso(given.number()?),
            "detail" if given.switch()? => request.detail(),
            "normals" if given.switch()? => request.normals(),
            "simplify" => request.simplify(given.number()?),
            "smallest_component" => request.smallest_component(given.number()?),
            "smallest_drop" => request.smallest_drop(given.count()?),
            "compress" if given.switch()? => request.compress(),
            "up" => request.up(axis(given)?),
            "particles_up" => request.particles_up(axis(given)?),
            "attributes" => request.attributes(given.names()?),
            "particle_type" => request.particle_type(given.text()?),
            "threads" => request.threads(given.count()?),
            "memory" => {
                self.memory = MemoryBudget(given.bytes()?);
                request
            }
            "scratch" => request.scratch(given.path()?),
            "backend" => {
                self.device.backend(given)?;
                request
            }
            "device" => {
                self.device.named(given.text_or_number()?);
                request
            }
            // Switches that are off.
            _ => request,
        };
        Ok(())
    }

    /// The request, on a backend that suits inputs of so many bytes, if that is known.
    pub fn on_machine(self, input_bytes: Option<u64>) -> PyResult<Reconstruction> {
        let request = self.request.memory(self.memory);
        if !request.uses_backend() {
            self.device.refuse("kernel methods run on the processor")?;
            return Ok(request);
        }
        Ok(match self.device.open(self.memory, input_bytes)? {
            Some(backend) => request.backend(backend),
            None => request,
        })
    }
}

fn axis(given: &Given<'_, '_>) -> PyResult<UpAxis> {
    given.one_of(&[("y", UpAxis::Y), ("z", UpAxis::Z)])
}
