//! Particle attributes carried to the vertices.
//!
//! A cell's value is blur(sum of values) / blur(N), both blurred as the DIF is; a vertex takes the mean
//! of the two ends of its edge, weighted as its position is. Sums over particles are integers: values are
//! rounded to a step that is a power of two, 2^-30 of the greatest magnitude among the particles that a block
//! of vertices sees, or finer. Values that are not finite count as if the particle did not have the attribute.
//!
//! Reaches as far as the smoothing.

mod cpu;

pub use cpu::vertex_values;

/// Bytes of a cell while an attribute of so many components is smoothed: sums of it and of the particles, in two fields.
#[must_use]
pub fn cell_bytes(components: usize) -> u64 {
    ((components + 3) * size_of::<f64>()) as u64
}
