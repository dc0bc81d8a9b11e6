//! The arrangement of bricks in the pages of bins.

use glam::IVec3;

use crate::grid::{BIN, CellBox, local_morton};

/// Edge of a brick, in cells. The edge affects only the amount of memory that the DIF takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BrickSide {
    /// 64 cells, 128 bytes.
    Four,
    /// 512 cells, 1 KiB.
    #[default]
    Eight,
    /// 4096 cells, 8 KiB: one brick per bin.
    Sixteen,
}

impl BrickSide {
    /// The edge in cells.
    #[must_use]
    pub const fn cells(self) -> i32 {
        match self {
            Self::Four => 4,
            Self::Eight => 8,
            Self::Sixteen => 16,
        }
    }

    /// The number of bricks in a bin. [`PageInfo::bricks`](super::PageInfo::bricks) uses one bit
    /// for each brick, starting with the lowest.
    pub fn bricks_per_bin(self) -> usize {
        (BIN / self.cells()).pow(3) as usize
    }

    /// Number of samples in a brick.
    pub fn samples(self) -> usize {
        self.cells().pow(3) as usize
    }
}

/// The arrangement of the samples of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageShape {
    /// The edge of the bricks.
    pub side: BrickSide,
    /// Width, in cells, of the layer that a brick stores around its own cells: 0 or 1. Particles in
    /// the brick contribute to this layer. A cell's sample is the sum of the samples that all
    /// bricks store for the cell, clamped to 65535.
    pub ghost_layer: i32,
}

impl From<BrickSide> for PageShape {
    /// A shape without a ghost layer.
    fn from(side: BrickSide) -> Self {
        Self { side, ghost_layer: 0 }
    }
}

impl PageShape {
    /// Edge, in cells, of a brick including its ghost layer.
    pub fn edge(self) -> i32 {
        self.side.cells() + 2 * self.ghost_layer
    }

    /// The cells of a brick, including its ghost layer. `brick` has the brick's coordinates, in
    /// bricks.
    pub(super) fn cells_of(self, brick: IVec3) -> CellBox {
        CellBox::cube(brick, self.side.cells()).grown(self.ghost_layer, self.ghost_layer)
    }

    /// Number of cells to which a particle can contribute.
    pub fn cells_per_particle(self) -> usize {
        (1 + 2 * self.ghost_layer as usize).pow(3)
    }

    /// Number of samples in a brick, including its ghost layer.
    pub fn brick_samples(self) -> usize {
        self.edge().pow(3) as usize
    }

    /// Number of samples in a whole bin if all bricks are stored.
    pub fn bin_samples(self) -> usize {
        self.side.bricks_per_bin() * self.brick_samples()
    }

    /// Tables, one for each axis, for indices into the samples of a dense bin with ghost layers.
    /// The table entries for a cell's x, y and z in the bin add up to the index of the lowest
    /// sample in the cell's neighbourhood.
    pub fn firsts(self) -> [[usize; BIN as usize]; 3] {
        let (side, edge) = (self.side.cells(), self.edge() as usize);
        [0, 1, 2].map(|axis: usize| {
            std::array::from_fn(|cell| {
                let mut brick = IVec3::ZERO;
                brick[axis] = cell as i32 / side;
                local_morton(brick) * self.brick_samples()
                    + (cell % side as usize) * edge.pow(axis as u32)
            })
        })
    }
}
