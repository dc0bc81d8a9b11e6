//! What a frame will take of memory, known before it is taken.
//!
//! After the particles are counted by bin, and before anything is stored for them.

use bytesize::ByteSize;
use hashbrown::HashMap;
use thiserror::Error;

use crate::brick::BrickSide;
use crate::grid::{BIN, Grid, MortonKey};
use crate::units::MemoryBudget;

/// Bytes of a binned particle.
const RECORD: u64 = 8;
/// Bytes of a vertex in the finished mesh: its position, two triangles, and the samples of its edge.
const VERTEX: u64 = 24 + 2 * 12 + 8;
/// Vertices around a particle that is alone.
const VERTICES_A_PARTICLE: u64 = 60;
/// Vertices in a bin full of wrinkled surface: a plane through it has 16^2 times one to two.
const VERTICES_A_BIN: u64 = 2000;
/// Bytes of a bin's bookkeeping: keys, offsets and hash table entries.
const BIN_OVERHEAD: u64 = 160;

/// Bytes at the peak, by what they are for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Estimate {
    /// Sorted particles, with their attributes.
    pub particles: u64,
    /// The DIF.
    pub field: u64,
    /// The surface, at the most.
    pub mesh: u64,
}

/// A frame that would take more memory than it may.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error(
    "a cell size of {cell_size} needs about {} of memory, and {} may be used; \
     a cell size of {fitting_cell_size} needs {}; or allow more with --memory",
    ByteSize(*needed), ByteSize(*budget), ByteSize(*fitting)
)]
pub struct OverBudget {
    /// What was asked for.
    pub cell_size: f64,
    /// Estimated bytes at the peak.
    pub needed: u64,
    /// Bytes that may be used.
    pub budget: u64,
    /// The smallest doubling of the cell size that fits, or does not get any better.
    pub fitting_cell_size: f64,
    /// Estimated bytes with that.
    pub fitting: u64,
}

impl Estimate {
    /// For particles counted by bin.
    #[must_use]
    pub fn of(
        counts: impl Iterator<Item = (MortonKey, usize)>,
        side: BrickSide,
        carried_components: usize,
    ) -> Self {
        let brick_bytes = 2 * side.cells().pow(3) as u64;
        let bricks_a_bin = (BIN / side.cells()).pow(3) as u64;
        let mut estimate = Self::default();
        for (_, count) in counts {
            let count = count as u64;
            estimate.particles += count * (RECORD + 4 * carried_components as u64);
            estimate.field += BIN_OVERHEAD + count.min(bricks_a_bin) * brick_bytes;
            estimate.mesh += VERTEX * (count * VERTICES_A_PARTICLE).min(VERTICES_A_BIN);
        }
        estimate
    }

    /// Everything, in bytes. Particles without attributes are gone before the mesh is made.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.particles + self.field + self.mesh
    }

    /// Compares with what may be used.
    ///
    /// # Errors
    /// [`OverBudget`], with the cell size to use instead.
    pub fn check(
        &self,
        budget: MemoryBudget,
        counts: impl Iterator<Item = (MortonKey, usize)>,
        grid: &Grid,
    ) -> Result<(), OverBudget> {
        let needed = self.total();
        if needed <= budget.0 {
            return Ok(());
        }
        let per_particle = self.particles;
        let mut bins: HashMap<glam::IVec3, usize> = counts.map(|(key, n)| (key.coord(), n)).collect();
        let mut cell = grid.cell_size();
        let mut fitting = needed;
        while fitting > budget.0 && bins.len() > 1 {
            let mut coarser: HashMap<glam::IVec3, usize> = HashMap::new();
            for (coord, count) in bins {
                *coarser.entry(coord >> 1).or_default() += count;
            }
            bins = coarser;
            cell *= 2.0;
            let counts = bins.iter().map(|(&coord, &n)| (MortonKey::of(coord), n));
            let coarse = Self { particles: per_particle, ..Self::of(counts, BrickSide::default(), 0) };
            fitting = coarse.total();
        }
        Err(OverBudget {
            cell_size: grid.cell_size(),
            needed,
            budget: budget.0,
            fitting_cell_size: cell,
            fitting,
        })
    }
}
