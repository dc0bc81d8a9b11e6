//! The DIF of a frame, with all that a surface through it has to know of the particles.

use crate::brick::{DifField, FrameFacts};

use super::Indicator;

/// A frame whose DIF is known: what a packed frame holds.
#[derive(Debug)]
pub struct SampledDif {
    /// Facts of the frame.
    pub facts: FrameFacts,
    /// The indicator that made it, with its mu0 where it counts.
    pub indicator: Indicator,
    /// The samples.
    pub dif: DifField,
}

impl SampledDif {
    /// Makes the DIF of what was stored by an indicator.
    #[must_use]
    pub fn new(facts: FrameFacts, indicator: Indicator, stored: DifField) -> Self {
        Self { facts, indicator, dif: indicator.decode(stored) }
    }
}
