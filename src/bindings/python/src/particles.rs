//! Particles in arrays: positions and attributes.

use meniscus::Particles;
use meniscus::files::AttributeInfo;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyMapping;

use crate::arrays::{BoundArray, Numbers, check_length, columns, vectors};

/// The caller's arrays of positions and attributes, kept alive while the library reads them.
pub struct Arrays<'py> {
    pub positions: BoundArray<'py>,
    others: Vec<(String, BoundArray<'py>)>,
}

/// Particles for the library, which reads them in place from `Arrays`.
#[derive(Debug)]
pub struct ArrayParticles {
    positions: Numbers,
    attributes: Vec<AttributeInfo>,
    values: Vec<Numbers>,
}

impl<'py> Arrays<'py> {
    /// Reads the caller's positions, optional velocities, and other attributes by name.
    pub fn from_python(
        positions: &Bound<'py, PyAny>,
        velocity: Option<&Bound<'py, PyAny>>,
        attributes: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Self> {
        let positions = vectors("positions", positions)?;
        let mut others = Vec::new();
        if let Some(velocity) = velocity {
            let bound = vectors("velocity", velocity)?;
            check_length("velocity", &bound, positions.numbers.rows())?;
            others.push(("velocity".to_owned(), bound));
        }
        if let Some(attributes) = attributes {
            let mapping = attributes.cast::<PyMapping>().map_err(|_| {
                PyTypeError::new_err("attributes: must be a mapping from names to arrays")
            })?;
            for item in mapping.items()?.iter() {
                let (name, array): (Bound<'_, PyAny>, Bound<'_, PyAny>) = item.extract()?;
                let name: String = name.extract().map_err(|_| {
                    PyTypeError::new_err(format!("attributes: {name} is not a name; use a str"))
                })?;
                if others.iter().any(|(known, _)| *known == name) {
                    return Err(PyTypeError::new_err("velocity: is also given in attributes"));
                }
                let label = format!("attributes[{name:?}]");
                let bound = columns(&label, &array)?;
                check_length(&label, &bound, positions.numbers.rows())?;
                others.push((name, bound));
            }
        }
        Ok(Self { positions, others })
    }

    /// The particles for the library, which may read them only while `self` lives.
    pub fn as_particles(&self) -> ArrayParticles {
        let info = |(name, bound): &(String, BoundArray<'_>)| {
            let info = AttributeInfo::new(name, bound.numbers.columns());
            AttributeInfo { kind: bound.numbers.attribute_kind(&info), ..info }
        };
        ArrayParticles {
            positions: self.positions.numbers,
            attributes: self.others.iter().map(info).collect(),
            values: self.others.iter().map(|(_, bound)| bound.numbers).collect(),
        }
    }

    /// The name of the first attribute that is not in `names`; `None` if `names` contains all
    /// attributes. Without `names`, only the velocity is expected: an attribute "velocity" with
    /// three components.
    pub fn first_unnamed(&self, names: Option<&[String]>) -> Option<&str> {
        let is_known = |name: &String, bound: &BoundArray<'_>| match names {
            Some(names) => names.contains(name),
            None => name == "velocity" && bound.numbers.columns() == 3,
        };
        let (name, _) = self.others.iter().find(|(name, bound)| !is_known(name, bound))?;
        Some(name)
    }

    /// The names of all attributes; `None` if there are no attributes other than the velocity,
    /// because the library uses the velocity by default.
    pub fn attribute_names(&self) -> Option<Vec<String>> {
        self.first_unnamed(None)?;
        Some(self.others.iter().map(|(name, _)| name.clone()).collect())
    }
}

impl Particles for ArrayParticles {
    fn len(&self) -> usize {
        self.positions.rows()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        let rows = out.len();
        let out = out.as_flattened_mut();
        self.positions.read(first, rows, |at, number| out[at] = number);
    }

    fn attributes(&self) -> &[AttributeInfo] {
        &self.attributes
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let values = &self.values[index];
        values.read(first, out.len() / values.columns(), |at, number| out[at] = number as f32);
    }

    fn component(&self, (index, component): (usize, usize), first: usize, out: &mut [f64]) {
        let rows = out.len();
        self.values[index].column(component).read(first, rows, |at, number| out[at] = number);
    }

    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        let values = &self.values[index];
        values.read_whole(first, out.len() / values.columns(), |at, number| out[at] = number);
    }
}
