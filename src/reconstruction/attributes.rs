//! Selects the attributes that are read from an input, and those that are interpolated to the
//! vertices.

use std::fmt;

use crate::error::Error;
use crate::io::ParticleFile;
use crate::io::output::MeshFormat;
use crate::io::wanted::{WantedAttributes, WantedParticles};
use crate::particles::sizes::SizeChoice;
use crate::particles::{Particles, attribute_called, velocity_attribute};
use crate::settings::Settings;

use super::checked::CheckedRequest;

/// Maximum number of attributes that a message lists.
const LISTED: usize = 10;

/// The attributes of an input that has attributes, but no velocity. `Display` prints them as one
/// line of text.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct NoVelocity {
    /// The names of the attributes.
    pub attributes: Vec<String>,
}

impl fmt::Display for NoVelocity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let listed = &self.attributes[..self.attributes.len().min(LISTED)];
        match &self.attributes[..] {
            [only] => write!(f, "the only attribute, {only}, is not recognised as a velocity"),
            all => {
                write!(f, "no velocity found among the attributes {}", listed.join(", "))?;
                match all.len() - listed.len() {
                    0 => Ok(()),
                    more => write!(f, " and {more} more"),
                }
            }
        }
    }
}

impl CheckedRequest {
    /// The particles and attributes that must be read from an input.
    pub(crate) fn wanted(&self) -> WantedParticles<'_> {
        self.settings.wanted(&self.sampling.size)
    }
}

impl Settings {
    /// The particles and attributes that must be read from an input, including the attributes for
    /// `sizes`.
    pub(crate) fn wanted<'a>(&'a self, sizes: &'a SizeChoice) -> WantedParticles<'a> {
        let (names, conditions) = (self.attribute_names(), self.conditions());
        let attributes = WantedAttributes::Only { names, conditions, sizes };
        WantedParticles {
            format: self.format,
            attributes,
            conditions,
            ..WantedParticles::default()
        }
    }

    /// Indices of the attributes that go to the vertices. By default, this is the velocity, if
    /// there is one and the format can store it. If there are no particles, a missing attribute is
    /// not an error, because some input formats store no attributes without particles.
    pub(crate) fn carried(
        &self,
        particles: &dyn Particles,
        format: Option<MeshFormat>,
    ) -> Result<Vec<usize>, Error> {
        let all = particles.attributes();
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
                left_out: None,
            };
            match attribute_called(name, all) {
                Some(found) if carried.contains(&found) => {}
                Some(found) => carried.push(found),
                None if particles.is_empty() => {}
                None => return Err(missing()),
            }
        }
        Ok(carried)
    }

    /// The attributes of `file`, if the mesh in this format would have a velocity by default, but
    /// none of the attributes is a velocity. `None` if there are no attributes.
    pub(crate) fn no_velocity(
        &self,
        file: &ParticleFile,
        format: Option<MeshFormat>,
    ) -> Option<NoVelocity> {
        let read = file.particles.attributes();
        let is_default = self.attribute_names().is_none();
        if !is_default
            || !format.is_none_or(MeshFormat::holds_attributes)
            || file.particles.is_empty()
            || velocity_attribute(read).is_some()
        {
            return None;
        }
        let attributes: Vec<String> =
            read.iter().chain(&file.unread).map(|info| info.name.clone()).collect();
        (!attributes.is_empty()).then_some(NoVelocity { attributes })
    }
}
