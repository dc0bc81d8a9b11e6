//! Which points of a chunk are near a place: a grid of lists of numbers.

use glam::{IVec3, Vec3};

/// Positions are within so many cells of a chunk's corner.
const FAR: f32 = 1024.0;

/// Points by the cells that they are in.
pub struct Near {
    lo: IVec3,
    size: IVec3,
    /// Where each cell's list ends.
    ends: Vec<u32>,
    listed: Vec<u32>,
}

impl Near {
    /// Lists points by the cells that they are in.
    pub fn points(positions: &[Vec3]) -> Self {
        let lo = grid_cell(positions.iter().copied().reduce(Vec3::min).unwrap_or_default());
        let hi = grid_cell(positions.iter().copied().reduce(Vec3::max).unwrap_or_default());
        let size = hi - lo + 1;
        let mut near = Self {
            lo,
            size,
            ends: vec![0; size.as_usizevec3().element_product()],
            listed: vec![0; positions.len()],
        };
        for &position in positions {
            let cell = near.rank(grid_cell(position) - lo);
            near.ends[cell] += 1;
        }
        // Counts become starts, and starts become ends as the lists fill up.
        let mut total = 0;
        for end in &mut near.ends {
            total += std::mem::replace(end, total);
        }
        for (&position, number) in positions.iter().zip(0..) {
            let cell = near.rank(grid_cell(position) - lo);
            near.listed[near.ends[cell] as usize] = number;
            near.ends[cell] += 1;
        }
        near
    }

    fn rank(&self, cell: IVec3) -> usize {
        (cell.x + self.size.x * (cell.y + self.size.y * cell.z)) as usize
    }

    /// The points of all cells that the box from `lo` to `hi` comes into.
    pub fn within(&self, lo: Vec3, hi: Vec3) -> Vec<u32> {
        let lo = (grid_cell(lo) - self.lo).max(IVec3::ZERO);
        let hi = (grid_cell(hi) - self.lo).min(self.size - 1);
        let mut found = Vec::new();
        for z in lo.z..=hi.z {
            for y in lo.y..=hi.y {
                // One row of cells is one stretch of the list.
                if lo.x <= hi.x {
                    let [first, last] = [lo.x, hi.x].map(|x| self.rank(IVec3::new(x, y, z)));
                    let start = first.checked_sub(1).map_or(0, |before| self.ends[before]);
                    found.extend_from_slice(&self.listed[start as usize..self.ends[last] as usize]);
                }
            }
        }
        found
    }
}

fn grid_cell(point: Vec3) -> IVec3 {
    // Rounds down, as long as points are not that far below; floor is a call where processors may be old.
    (point + FAR).as_ivec3() - FAR as i32
}
