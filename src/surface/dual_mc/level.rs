//! The level of the surface in a field, and the 32 bits in which a vertex stores its position on
//! its edge.

use crate::grid::units::Isovalue;

/// The level of a field at which the surface lies.
pub trait Level: Copy {
    /// A sample of the field.
    type Sample: Copy + Default;

    /// Whether a sample is inside the surface.
    fn is_inside(self, sample: Self::Sample) -> bool;

    /// Packs the samples at the lower and the upper end of an edge for its vertex; [`Crossings`]
    /// unpacks them.
    fn ends(self, lower: Self::Sample, upper: Self::Sample) -> [u16; 2];
}

/// Integer fields: a vertex stores both samples.
impl Level for Isovalue {
    type Sample = u16;

    #[inline]
    fn is_inside(self, theta: u16) -> bool {
        theta > self.threshold()
    }

    #[inline]
    fn ends(self, lower: u16, upper: u16) -> [u16; 2] {
        [lower, upper]
    }
}

/// The zero level of a real-valued field that is positive inside. A vertex stores its position on
/// the edge as a fraction, in steps of 2^-32.
#[derive(Debug, Clone, Copy)]
pub struct ZeroLevel;

impl Level for ZeroLevel {
    type Sample = f64;

    #[inline]
    fn is_inside(self, value: f64) -> bool {
        value > 0.0
    }

    #[inline]
    fn ends(self, lower: f64, upper: f64) -> [u16; 2] {
        // A ghost point mirrors a sample across a wall, and counts as outside although it has the
        // same value. The vertex is then halfway, on the wall.
        let fraction = if lower == upper { 0.5 } else { lower / (lower - upper) };
        // The conversion saturates, so the fraction stays below 1. A fraction of 0 would put the
        // vertex on the sample, so the least fraction is one step.
        let steps = ((fraction * 2_f64.powi(32)) as u32).max(1);
        [steps as u16, (steps >> 16) as u16]
    }
}

/// The encoding of the 32 bits that a vertex stores.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Crossings {
    /// Both samples of the edge, from a field with this isovalue.
    Samples(Isovalue),
    /// The position on the edge as a fraction, in steps of 2^-32.
    Fractions,
}

impl From<Isovalue> for Crossings {
    fn from(iso: Isovalue) -> Self {
        Self::Samples(iso)
    }
}

impl From<ZeroLevel> for Crossings {
    fn from(_: ZeroLevel) -> Self {
        Self::Fractions
    }
}

impl Crossings {
    /// The position of a vertex on its edge, as a fraction (eq. 8), from the vertex's stored bits.
    ///
    /// Equal samples belong to a cell and the ghost point that mirrors it: the vertex is half-way
    /// between them, because phi only changes its sign.
    #[inline]
    pub fn fraction(self, [lower, upper]: [u16; 2]) -> f64 {
        match self {
            Self::Samples(_) if lower == upper => 0.5,
            Self::Samples(iso) => {
                // phi in units of 1/2: 2 c - 2 theta, where c is an integer plus one half.
                let phi = |theta: u16| {
                    f64::from(2 * i32::from(iso.threshold()) + 1 - 2 * i32::from(theta))
                };
                phi(lower) / (phi(lower) - phi(upper))
            }
            Self::Fractions => {
                f64::from(u32::from(lower) | u32::from(upper) << 16) / 2_f64.powi(32)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crossing_keeps_its_fraction_and_never_lies_on_a_sample() {
        let kept = |lower, upper| Crossings::Fractions.fraction(ZeroLevel.ends(lower, upper));
        for (lower, upper, fraction) in [(1.0, -3.0, 0.25), (-0.7, 0.1, 0.875), (2.0, 2.0, 0.5)] {
            assert!((kept(lower, upper) - fraction).abs() <= 2_f64.powi(-32));
        }
        for fraction in [kept(1.0, 0.0), kept(0.0, 1.0), kept(1e-30, -1e30), kept(1e30, -1e-30)] {
            assert!(fraction > 0.0 && fraction < 1.0);
        }
    }
}
