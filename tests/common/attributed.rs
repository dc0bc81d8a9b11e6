//! Particles in memory with attributes, for the tests.

use meniscus::internals::particles::{AttributeInfo, Particles};

/// The positions of particles, and their attributes.
pub struct Attributed {
    positions: Vec<[f64; 3]>,
    pub attributes: Vec<AttributeInfo>,
    /// For each attribute, the values of all particles, in particle order.
    values: Vec<Vec<f32>>,
}

impl Attributed {
    /// Particles without attributes.
    pub fn new(positions: Vec<[f64; 3]>) -> Self {
        Self { positions, attributes: Vec::new(), values: Vec::new() }
    }

    /// Adds an attribute. The function `value` computes it from a particle's number and position.
    pub fn with<const N: usize>(
        mut self,
        name: &str,
        value: impl Fn(usize, [f64; 3]) -> [f32; N],
    ) -> Self {
        let values =
            self.positions.iter().enumerate().flat_map(|(i, &position)| value(i, position));
        self.values.push(values.collect());
        self.attributes.push(AttributeInfo::new(name, N));
        self
    }
}

impl Particles for Attributed {
    fn len(&self) -> usize {
        self.positions.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        self.positions[..].positions(first, out);
    }

    fn attributes(&self) -> &[AttributeInfo] {
        &self.attributes
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let start = first * self.attributes[index].components;
        out.copy_from_slice(&self.values[index][start..start + out.len()]);
    }
}
