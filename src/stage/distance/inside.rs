//! The deep inside of a fluid, where no surface can be, by definition: neither its samples nor its field are looked at.
//!
//! A brick of 4^3 wide cells is full where every cube of about 5 1/3 spacings that holds it, by whole bricks, holds at least 0.9 of what
//! the plateau says. A brick whose 26 neighbours are full as well is inside. The field is then at its greatest there, for all
//! that is made of it, so that meshes stay closed whatever lies inside. Cubes slide, so that a bubble at a corner shows: one of
//! two spacings takes more than a tenth of any cube that it lies in.

use glam::{IVec3, USizeVec3};
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::brick::{Block, DifField};
use crate::grid::{BIN, CellBox, MortonKey, local_morton};

/// Wide cells along the edge of a brick.
pub const BRICK: i32 = 4;
/// Bricks along the edge of a bin.
const BRICKS: i32 = BIN / BRICK;
/// Edge of the cubes that have to be full, in spacings.
const CUBE: f64 = 16.0 / 3.0;
/// What they have to hold of the plateau.
const FULL_SHARE: f64 = 0.9;

/// The bricks that are inside.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Inside {
    /// Of each bin of wide cells that has any, a bit for each brick, by its Morton index in the bin.
    bricks: HashMap<IVec3, u64>,
}

/// What there is to know of each bin.
fn by_bin<T: Send>(keys: &[MortonKey], of: impl Fn(IVec3) -> T + Sync) -> HashMap<IVec3, T> {
    let of_bin = |key: &MortonKey| (key.coord(), of(key.coord()));
    keys.par_iter().map(of_bin).collect::<Vec<_>>().into_iter().collect()
}

/// What there is of each brick of a box around a bin, x fastest.
struct Around<T> {
    edge: usize,
    values: Vec<T>,
}

impl<T: Copy> Around<T> {
    /// Of the bricks from `from` up to `to` along each axis, counted from the bin's corner.
    fn new(from: i32, to: i32, value: impl Fn(IVec3) -> T) -> Self {
        let edge = (to - from) as usize;
        let mut values = Vec::with_capacity(edge * edge * edge);
        for z in from..to {
            for y in from..to {
                for x in from..to {
                    values.push(value(IVec3::new(x, y, z)));
                }
            }
        }
        Self { edge, values }
    }

    /// Of every brick what `both` makes of the cube of `width` bricks that begins at it: fewer by `width` - 1 along each axis.
    fn cubes(self, width: usize, both: impl Fn(T, T) -> T) -> Self {
        let Self { edge, mut values } = self;
        let left = edge + 1 - width;
        // What follows is still what it was; what reaches beyond the end of a row is left out.
        for step in [1, edge, edge * edge] {
            for at in 0..values.len() {
                let further = (1..width).map_while(|k| values.get(at + k * step).copied());
                values[at] = further.fold(values[at], &both);
            }
        }
        let first = |y: usize, z: usize| edge * (y + edge * z);
        let rows = (0..left).flat_map(|z| (0..left).map(move |y| first(y, z)));
        Self { edge: left, values: rows.flat_map(|first| values[first..first + left].to_vec()).collect() }
    }
}

impl Around<bool> {
    /// A bit for each brick of a bin, by its Morton index.
    fn bits(&self) -> u64 {
        let edge = BRICKS as usize;
        debug_assert_eq!(self.edge, edge);
        let at = |i: usize| USizeVec3::new(i % edge, i / edge % edge, i / (edge * edge)).as_ivec3();
        let bits = self.values.iter().enumerate().filter(|&(_, &so)| so);
        bits.fold(0, |bits, (i, _)| bits | 1 << local_morton(at(i)))
    }
}

/// The bin of a brick, given in bricks from the corner of `bin`, and its Morton index there.
fn home(bin: IVec3, brick: IVec3) -> (IVec3, usize) {
    let edge = IVec3::splat(BRICKS);
    (bin + brick.div_euclid(edge), local_morton(brick.rem_euclid(edge)))
}

impl Inside {
    /// Of a field of wide cells of `edge` spacings whose samples deep in the fluid are about `plateau`.
    #[must_use]
    pub fn of(field: &DifField, edge: f64, plateau: f64) -> Self {
        let keys: Vec<MortonKey> = field.keys().collect();
        let sums = by_bin(&keys, |bin| {
            let samples = field.gather(CellBox::cube(bin, BIN));
            let mut sums = [0; 64];
            for ([y, z], row) in samples.rows(samples.cells()) {
                for (x, four) in (0..).zip(row.as_chunks::<{ BRICK as usize }>().0) {
                    let brick = IVec3::new(x, (y - bin.y * BIN) / BRICK, (z - bin.z * BIN) / BRICK);
                    sums[local_morton(brick)] += four.iter().map(|&sample| u64::from(sample)).sum::<u64>();
                }
            }
            sums
        });
        let width = (CUBE / (edge * f64::from(BRICK))).round().max(1.0) as i32;
        let least = FULL_SHARE * plateau * f64::from(BRICK * width).powi(3);
        let full = by_bin(&keys, |bin| {
            let held = Around::new(1 - width, BRICKS + width - 1, |brick| {
                let (bin, brick) = home(bin, brick);
                sums.get(&bin).map_or(0, |sums| sums[brick])
            });
            let Around { edge, values } = held.cubes(width as usize, |a, b| a + b);
            let values = values.into_iter().map(|sum| sum as f64 >= least).collect();
            Around { edge, values }.cubes(width as usize, |a, b| a && b).bits()
        });
        let is_full = |bin: IVec3, brick: IVec3| {
            let (bin, brick) = home(bin, brick);
            full.get(&bin).is_some_and(|full| full >> brick & 1 != 0)
        };
        let mut bricks = by_bin(&keys, |bin| match full[&bin] {
            0 => 0,
            _ => Around::new(-1, BRICKS + 1, |brick| is_full(bin, brick)).cubes(3, |a, b| a && b).bits(),
        });
        bricks.retain(|_, bits| *bits != 0);
        Self { bricks }
    }

    /// Whether a brick of wide cells is inside, given in bricks.
    #[must_use]
    pub fn contains(&self, brick: IVec3) -> bool {
        let (bin, brick) = home(IVec3::ZERO, brick);
        self.bricks.get(&bin).is_some_and(|bricks| bricks >> brick & 1 != 0)
    }

    /// The bricks among some wide cells that are inside, in bricks.
    pub fn bricks(&self, cells: CellBox) -> impl Iterator<Item = IVec3> + '_ {
        let bins = cells.cubes(BIN).filter_map(|bin| Some((bin, *self.bricks.get(&bin)?)));
        bins.flat_map(move |(bin, bricks)| {
            let part = cells.intersection(&CellBox::cube(bin, BIN));
            part.cubes(BRICK).filter(move |&brick| bricks >> local_morton(brick - bin * BRICKS) & 1 != 0)
        })
    }

    /// A bit for each brick that some wide cells touch, x fastest, in words: those that are inside.
    #[must_use]
    pub fn marks(&self, cells: CellBox) -> Vec<u32> {
        let touched = CellBox {
            lo: cells.lo.div_euclid(IVec3::splat(BRICK)),
            hi: (cells.hi - 1).div_euclid(IVec3::splat(BRICK)) + 1,
        };
        let mut marks = vec![0; touched.volume().div_ceil(u32::BITS as usize)];
        let size = touched.size();
        for brick in self.bricks(cells) {
            let at = brick - touched.lo;
            let index = (at.x + size.x * (at.y + size.y * at.z)) as usize;
            marks[index / 32] |= 1 << (index % 32);
        }
        marks
    }

    /// The smallest box around the bricks among some wide cells that are not inside, in wide cells.
    #[must_use]
    pub fn rest(&self, cells: CellBox) -> CellBox {
        let mut rest = CellBox::EMPTY;
        for bin in cells.cubes(BIN) {
            let part = cells.intersection(&CellBox::cube(bin, BIN));
            match self.bricks.get(&bin) {
                Some(&u64::MAX) => {}
                Some(bricks) => {
                    let others = part
                        .cubes(BRICK)
                        .filter(|&brick| bricks >> local_morton(brick - bin * BRICKS) & 1 == 0);
                    rest = others.fold(rest, |rest, brick| rest.union(&CellBox::cube(brick, BRICK)));
                }
                None => rest = rest.union(&part),
            }
        }
        rest
    }

    /// Raises a field of wide cells to its greatest inside.
    pub fn raise(&self, field: &mut Block) {
        let cells = field.cells();
        for brick in self.bricks(cells) {
            let part = cells.intersection(&CellBox::cube(brick, BRICK));
            let width = part.size().x as usize;
            for z in part.lo.z..part.hi.z {
                for y in part.lo.y..part.hi.y {
                    let first = field.index(IVec3::new(part.lo.x, y, z));
                    field.samples_mut()[first..first + width].fill(u16::MAX);
                }
            }
        }
    }
}
