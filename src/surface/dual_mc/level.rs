//! Where in a field the surface is, and how a vertex remembers its place on its edge in 32 bits.

use crate::grid::units::Isovalue;

/// A level of a field.
pub trait Level: Copy {
    /// A sample of the field.
    type Sample: Copy + Default;

    /// Whether a sample is inside of the surface.
    fn is_inside(self, sample: Self::Sample) -> bool;

    /// Packs the samples at the lower and the upper end of an edge for its vertex; [`Crossings`]
    /// reads them.
    fn ends(self, lower: Self::Sample, upper: Self::Sample) -> [u16; 2];
}

/// Integer fields: a vertex keeps both samples.
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

/// The level 0 of a real field that is positive inside: a vertex keeps its fraction, in steps of
/// 2^-32.
#[derive(Debug, Clone, Copy)]
pub struct Zero;

impl Level for Zero {
    type Sample = f64;

    #[inline]
    fn is_inside(self, value: f64) -> bool {
        value > 0.0
    }

    #[inline]
    fn ends(self, lower: f64, upper: f64) -> [u16; 2] {
        // A ghost point has the value of the cell that it mirrors.
        let fraction = if lower == upper { 0.5 } else { lower / (lower - upper) };
        // The conversion saturates at the upper end, and 0 would be the sample itself.
        let steps = ((fraction * 2_f64.powi(32)) as u32).max(1);
        [steps as u16, (steps >> 16) as u16]
    }
}

/// The encoding of the 32 bits that a vertex keeps of its edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Crossings {
    /// Both samples, of a field with this isovalue.
    Samples(Isovalue),
    /// The fraction, in steps of 2^-32.
    Fractions,
}

impl From<Isovalue> for Crossings {
    fn from(iso: Isovalue) -> Self {
        Self::Samples(iso)
    }
}

impl From<Zero> for Crossings {
    fn from(_: Zero) -> Self {
        Self::Fractions
    }
}

impl Crossings {
    /// How far along its edge a vertex lies (eq. 8), from what it keeps.
    ///
    /// Equal samples are those of a cell and of the ghost point that mirrors it: half-way, for phi
    /// changes its sign.
    #[inline]
    pub fn fraction(self, [lower, upper]: [u16; 2]) -> f64 {
        match self {
            Self::Samples(_) if lower == upper => 0.5,
            Self::Samples(iso) => {
                // phi in halves: 2 c - 2 theta, and c is an integer and a half.
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
    fn a_fraction_is_kept_to_a_step_and_never_lies_on_a_sample() {
        let kept = |lower, upper| Crossings::Fractions.fraction(Zero.ends(lower, upper));
        for (lower, upper, fraction) in [(1.0, -3.0, 0.25), (-0.7, 0.1, 0.875), (2.0, 2.0, 0.5)] {
            assert!((kept(lower, upper) - fraction).abs() <= 2_f64.powi(-32));
        }
        for fraction in [kept(1.0, 0.0), kept(0.0, 1.0), kept(1e-30, -1e30), kept(1e30, -1e-30)] {
            assert!(fraction > 0.0 && fraction < 1.0);
        }
    }
}
