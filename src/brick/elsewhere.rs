//! Pages that are not in the host's memory, and what can be made of them where they are.

use std::fmt::Debug;
use std::ops::Range;

use glam::IVec3;

use crate::grid::CellBox;

use super::{PageInfo, PageSamples};

/// Bits of a [`Factor`].
pub(super) const FACTOR_BITS: u32 = 16;

/// The share of their content that wide cells hold: at most all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Factor(u32);

impl Factor {
    /// Rounds a factor of at most 1 down to its step.
    #[must_use]
    pub fn new(factor: f64) -> Self {
        Self((factor * f64::from(1 << FACTOR_BITS)) as u32)
    }

    /// The factor in steps of 2^-16.
    #[must_use]
    pub fn steps(self) -> u32 {
        self.0
    }
}

/// Samples that are not in the host's memory, and what can be made of them where they are. Whatever fails is `None`, and made
/// on the host.
pub trait Elsewhere: Send + Sync + Debug {
    /// How many pages there are.
    fn count(&self) -> usize;

    /// The samples of consecutive pages.
    fn samples(&self, pages: Range<usize>) -> Option<Vec<PageSamples>>;

    /// The pages of bins in cells twice as wide, but for those that hold nothing: what
    /// [`DifField::halved`](super::DifField::halved) makes, within the `walls` of these cells.
    fn halved(
        &self,
        bins: &[IVec3],
        walls: Option<CellBox>,
        factor: Factor,
    ) -> Option<(Vec<PageInfo>, Box<dyn Elsewhere>)>;

    /// For each page a bit for each brick of four cells, by its Morton index: those that no cube of `width` parts along each axis
    /// touches that holds less than `least`; a part is two cells wide, and cubes slide by one.
    fn full_bricks(&self, width: u32, least: u32) -> Option<Vec<u64>>;
}
