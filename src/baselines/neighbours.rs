//! The particles in a box of cells, stored so that all particles within a distance of a position
//! are found quickly.

use std::io;

use glam::{DVec3, IVec3};

use crate::brick::{BinContents, Bins};
use crate::grid::{BIN, CellBox, FRACTIONS, MortonKey};

/// Particles, sorted by cell.
#[derive(Debug)]
pub struct NeighbourGrid {
    /// The cells, relative to the same origin as `places`.
    cells: CellBox,
    /// The index in `places` at which each cell's particles begin, and the end of the last cell's
    /// particles.
    starts: Vec<u32>,
    places: Vec<DVec3>,
}

/// The cell and the position of each particle in a bin. Both are relative to the same origin as
/// `corner`, the lowest cell of the bin.
pub fn places(contents: &BinContents<'_>, corner: IVec3) -> impl Iterator<Item = (IVec3, DVec3)> {
    contents.particles().map(move |(local, offset)| {
        let local = local as i32;
        let cell = corner + IVec3::new(local % BIN, local / BIN % BIN, local / (BIN * BIN));
        // Each stored offset is rounded down to a step of 1 / `FRACTIONS` cells. Adding half a step
        // gives the middle of the step.
        let offset = DVec3::from(offset.map(f64::from)) + 0.5;
        (cell, cell.as_dvec3() + offset / f64::from(FRACTIONS))
    })
}

impl NeighbourGrid {
    /// The particles in `cells`, with positions relative to the lowest corner of the cell `origin`.
    ///
    /// # Errors
    /// If particles are in a scratch file that cannot be read.
    pub fn load(bins: &Bins, cells: CellBox, origin: IVec3) -> io::Result<Self> {
        let local = CellBox { lo: cells.lo - origin, hi: cells.hi - origin };
        let mut near =
            Self { cells: local, starts: vec![0; local.volume() + 1], places: Vec::new() };
        let mut found: Vec<(usize, DVec3)> = Vec::new();
        for coord in cells.cubes(BIN) {
            let Ok(bin) = bins.keys().binary_search(&MortonKey::of(coord)) else { continue };
            let contents = bins.contents(bin)?;
            let inside =
                places(&contents, coord * BIN - origin).filter(|(cell, _)| local.contains(*cell));
            found.extend(inside.map(|(cell, place)| (near.index(cell), place)));
        }
        // A counting sort. The counts become the start of each cell, and a cell's start advances
        // with each particle that is stored.
        found.iter().for_each(|&(cell, _)| near.starts[cell] += 1);
        let mut total = 0;
        for start in &mut near.starts {
            total += std::mem::replace(start, total);
        }
        near.places = vec![DVec3::ZERO; found.len()];
        for (cell, place) in found {
            near.places[near.starts[cell] as usize] = place;
            near.starts[cell] += 1;
        }
        near.starts.rotate_right(1);
        near.starts[0] = 0;
        Ok(near)
    }

    fn index(&self, cell: IVec3) -> usize {
        let (local, size) =
            ((cell - self.cells.lo).as_usizevec3(), self.cells.size().as_usizevec3());
        local.x + size.x * (local.y + size.y * local.z)
    }

    /// Calls `visit` for every particle within `radius` of `place`, with the particle's offset and
    /// squared distance from `place`.
    #[inline]
    pub fn within(&self, place: DVec3, radius: f64, mut visit: impl FnMut(DVec3, f64)) {
        let squared = radius * radius;
        let CellBox { lo, hi } = CellBox {
            lo: (place - radius).floor().as_ivec3(),
            hi: (place + radius).floor().as_ivec3() + 1,
        }
        .intersection(&self.cells);
        // The distance of a position from a layer of cells, along one axis.
        let distance_to_layer = |place: f64, cell: i32| {
            (f64::from(cell) - place).max(place - f64::from(cell + 1)).max(0.0)
        };
        for z in lo.z..hi.z {
            for y in lo.y..hi.y {
                let squared_along_x = squared
                    - distance_to_layer(place.z, z).powi(2)
                    - distance_to_layer(place.y, y).powi(2);
                if squared_along_x <= 0.0 {
                    continue;
                }
                let half = squared_along_x.sqrt();
                let first = ((place.x - half).floor() as i32).max(lo.x);
                let last = ((place.x + half).floor() as i32).min(hi.x - 1);
                if first > last {
                    continue;
                }
                let row = self.index(IVec3::new(first, y, z));
                let run = self.starts[row]..self.starts[row + (last - first) as usize + 1];
                for &other in &self.places[run.start as usize..run.end as usize] {
                    let offset = other - place;
                    let squared_distance = offset.length_squared();
                    if squared_distance < squared {
                        visit(offset, squared_distance);
                    }
                }
            }
        }
    }
}
