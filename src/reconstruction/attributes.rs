//! The choice of particle attributes that go to the vertices, and of what is read of an input for
//! them.

use crate::error::Error;
use crate::io::output::MeshFormat;
use crate::io::wanted::{Wanted, WantedAttributes};
use crate::particles::sizes::SizeChoice;
use crate::particles::{AttributeInfo, attribute_called, velocity_attribute};
use crate::settings::{Settings, Where};

use super::checked::Checked;

impl Checked {
    /// Particles and attributes that have to be read of an input.
    pub(crate) fn wanted(&self) -> Wanted<'_> {
        self.settings.wanted(&self.sampling.size)
    }
}

impl Settings {
    /// Particles and attributes that have to be read of an input.
    pub(crate) fn wanted<'a>(&'a self, sizes: &'a SizeChoice) -> Wanted<'a> {
        let (names, conditions) = (self.attribute_names(), self.conditions());
        let attributes = WantedAttributes::Only { names, conditions, sizes };
        Wanted {
            format: self.format,
            particle_type: Where::particle_type(self.conditions()),
            attributes,
            conditions,
            ..Wanted::default()
        }
    }

    /// The numbers of the attributes that go to the vertices, of those that there are. Velocity
    /// goes where a format can hold it.
    pub(crate) fn carried(
        &self,
        all: &[AttributeInfo],
        format: Option<MeshFormat>,
    ) -> Result<Vec<usize>, Error> {
        let Some(names) = self.attribute_names() else {
            let is_held = format.is_none_or(MeshFormat::holds_attributes);
            return Ok(velocity_attribute(all).filter(|_| is_held).into_iter().collect());
        };
        let mut carried = Vec::new();
        for name in names {
            let missing = || Error::NoAttribute {
                path: None,
                name: name.clone(),
                known: all.iter().map(|info| info.name.clone()).collect(),
            };
            let found = attribute_called(name, all).ok_or_else(missing)?;
            if !carried.contains(&found) {
                carried.push(found);
            }
        }
        Ok(carried)
    }
}
