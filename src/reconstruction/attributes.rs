//! The choice of particle attributes that go to the vertices.

use crate::error::Error;
use crate::particles::{AttributeInfo, velocity_attribute};

/// The attributes that are asked for.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Attributes {
    /// The velocity, if the particles have it.
    #[default]
    Velocity,
    /// Attributes by their names; `velocity` is whatever the particles call so. None where there are no names.
    Named(Vec<String>),
}

impl Attributes {
    /// The numbers of those that are asked for, among all.
    ///
    /// # Errors
    /// [`Error::NoAttribute`], without a path.
    pub fn among(&self, all: &[AttributeInfo]) -> Result<Vec<usize>, Error> {
        let velocity = velocity_attribute(all);
        let names = match self {
            Self::Velocity => return Ok(velocity.into_iter().collect()),
            Self::Named(names) => names,
        };
        let mut carried = Vec::new();
        for name in names {
            let named = all.iter().position(|info| info.name == *name);
            let missing = || Error::NoAttribute {
                path: None,
                name: name.clone(),
                known: all.iter().map(|info| info.name.clone()).collect(),
            };
            let found = named.or(velocity.filter(|_| name == "velocity")).ok_or_else(missing)?;
            if !carried.contains(&found) {
                carried.push(found);
            }
        }
        Ok(carried)
    }
}
