//! Particles with attributes, borrowed from the memory of a simulator.

use super::{AttributeInfo, Particles};

/// Borrowed positions and attributes of particles.
///
/// ```
/// use meniscus::{Cloud, Reconstruction};
///
/// let steps = || (-3..=3).map(f64::from);
/// let positions: Vec<[f64; 3]> =
///     steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z]))).collect();
/// let velocity = vec![[0.0_f32, -1.0, 0.0]; positions.len()];
/// let heat = vec![293.0_f32; positions.len()];
///
/// let water = Cloud::new(&positions).with("velocity", &velocity).with("heat", &heat);
/// let request = Reconstruction::new().spacing(1.0).attributes(["velocity", "heat"]);
/// let mesh = request.run(&water)?.to_mesh()?;
/// assert_eq!(mesh.attributes[1].name, "heat");
/// # Ok::<(), meniscus::Error>(())
/// ```
#[derive(Debug)]
pub struct Cloud<'a, P: ?Sized> {
    positions: &'a P,
    infos: Vec<AttributeInfo>,
    values: Vec<&'a [f32]>,
}

/// A value of an attribute: one number, or several.
pub trait AttributeValue: Sized {
    /// Number of components of a value.
    const COMPONENTS: usize;

    /// The numbers of all `values`, one value after another.
    fn numbers(values: &[Self]) -> &[f32];
}

impl AttributeValue for f32 {
    const COMPONENTS: usize = 1;

    fn numbers(values: &[Self]) -> &[f32] {
        values
    }
}

impl<const N: usize> AttributeValue for [f32; N] {
    const COMPONENTS: usize = N;

    fn numbers(values: &[Self]) -> &[f32] {
        values.as_flattened()
    }
}

impl<'a, P: Particles + ?Sized> Cloud<'a, P> {
    /// Borrows positions, such as a vector or a slice of `[f32; 3]` or `[f64; 3]`.
    #[must_use]
    pub fn new(positions: &'a P) -> Self {
        Self { positions, infos: Vec::new(), values: Vec::new() }
    }

    /// Adds an attribute with a value for each particle.
    ///
    /// # Panics
    /// If the number of values differs from the number of particles, or if a value has no
    /// components.
    #[must_use]
    pub fn with<V: AttributeValue>(mut self, name: impl Into<String>, values: &'a [V]) -> Self {
        let (name, particles) = (name.into(), self.positions.len());
        assert!(V::COMPONENTS > 0, "values of {name} have no numbers");
        assert!(
            values.len() == particles,
            "{name} has {} values for {particles} particles",
            values.len()
        );
        self.infos.push(AttributeInfo::new(name, V::COMPONENTS));
        self.values.push(V::numbers(values));
        self
    }
}

impl<P: Particles + ?Sized> Particles for Cloud<'_, P> {
    fn len(&self) -> usize {
        self.positions.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        self.positions.positions(first, out);
    }

    fn attributes(&self) -> &[AttributeInfo] {
        &self.infos
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let first = first * self.infos[index].components;
        out.copy_from_slice(&self.values[index][first..first + out.len()]);
    }
}
