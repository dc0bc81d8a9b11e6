//! How bricks lie in the pages of bins.

use glam::IVec3;

use crate::grid::{BIN, CellBox, local_morton};

/// Edge of a brick in cells. It decides how tightly the DIF is stored, and nothing else.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BrickSide {
    /// 64 cells, 128 bytes.
    Four,
    /// 512 cells, 1 KiB.
    #[default]
    Eight,
    /// 4096 cells, 8 KiB: one brick a bin.
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

    /// How many fill a bin: the bits of [`PageInfo::bricks`](super::PageInfo::bricks) that can be
    /// set.
    pub fn bricks_a_bin(self) -> usize {
        (BIN / self.cells()).pow(3) as usize
    }

    /// Samples of a brick.
    pub fn samples(self) -> usize {
        self.cells().pow(3) as usize
    }
}

/// How the samples of a page lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageShape {
    /// The edge of the bricks.
    pub side: BrickSide,
    /// How many cells around its own a brick stores, in which its own particles leave something: 0
    /// or 1. What is in a cell is the sum over all bricks, at most 65535.
    pub ghost_layer: i32,
}

impl From<BrickSide> for PageShape {
    /// Without a ghost layer.
    fn from(side: BrickSide) -> Self {
        Self { side, ghost_layer: 0 }
    }
}

impl PageShape {
    /// Edge of a brick with its ghost layer, in cells.
    pub fn edge(self) -> i32 {
        self.side.cells() + 2 * self.ghost_layer
    }

    /// The cells of a brick with its ghost layer, given its place in bricks.
    pub(super) fn cells_of(self, brick: IVec3) -> CellBox {
        CellBox::cube(brick, self.side.cells()).grown(self.ghost_layer, self.ghost_layer)
    }

    /// Cells in which a particle can leave something.
    pub fn cells_a_particle(self) -> usize {
        (1 + 2 * self.ghost_layer as usize).pow(3)
    }

    /// Samples of a brick.
    pub fn brick_samples(self) -> usize {
        self.edge().pow(3) as usize
    }

    /// Samples of a whole bin, dense.
    pub fn bin_samples(self) -> usize {
        self.side.bricks_a_bin() * self.brick_samples()
    }

    /// Where the samples of a cell lie in a dense bin with ghost layers, for the lowest of the
    /// cells around it: the sum over the axes, each by the cell's coordinate in the bin.
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
