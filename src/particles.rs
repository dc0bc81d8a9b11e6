//! What the pipeline asks of particles: to be read by range, from several threads, as often as it likes.

/// A value that every particle carries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AttributeInfo {
    /// As the file spells it.
    pub name: String,
    /// Numbers per particle.
    pub components: usize,
}

/// Particles, held in memory or in a mapped file.
///
/// The order is the file's, and an index names a particle in error messages. Values are handed out as
/// stored: they may be NaN or infinite.
pub trait Particles: Sync {
    /// Number of particles.
    fn len(&self) -> usize;

    /// Whether there is none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Fills `out` with the positions of the particles from `first` on.
    ///
    /// # Panics
    /// If `first + out.len()` exceeds [`len`](Self::len).
    fn positions(&self, first: usize, out: &mut [[f64; 3]]);

    /// The attributes that [`attribute`](Self::attribute) serves, positions excluded.
    fn attributes(&self) -> &[AttributeInfo] {
        &[]
    }

    /// Fills `out` with attribute number `index` of the particles from `first` on, all components of one
    /// particle after the other.
    ///
    /// # Panics
    /// If the range exceeds the particles or there is no such attribute.
    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let _ = (first, out);
        panic!("there is no attribute number {index}");
    }
}

impl Particles for [[f64; 3]] {
    fn len(&self) -> usize {
        self.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        out.copy_from_slice(&self[first..first + out.len()]);
    }
}

impl Particles for [[f32; 3]] {
    fn len(&self) -> usize {
        self.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        for (to, from) in out.iter_mut().zip(&self[first..]) {
            *to = from.map(f64::from);
        }
    }
}

/// The names under which simulators store a particle's velocity.
pub const VELOCITY_NAMES: [&str; 8] =
    ["velocity", "v", "Vel", "vel", "V", "Velocity", "velocities", ".velocities"];

/// The number of the attribute that holds velocities, if there is one: three components under a usual name.
#[must_use]
pub fn velocity_attribute(attributes: &[AttributeInfo]) -> Option<usize> {
    VELOCITY_NAMES
        .iter()
        .find_map(|name| attributes.iter().position(|a| a.name == *name && a.components == 3))
}
