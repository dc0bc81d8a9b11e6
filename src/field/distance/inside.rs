//! The deep inside of a fluid. By definition, it contains no surface. Its samples and its field are
//! not computed.
//!
//! A brick of 4^3 wide cells is full if every cube of about 4 spacings that overlaps it holds at
//! least 0.85 of the number of particles that the plateau implies. A brick is inside if it and its
//! 26 neighbours are full. In inside bricks, the field has its maximum at every stage, so that
//! meshes stay closed even if the fluid has bubbles in these bricks. Cubes slide in steps of two
//! wide cells. At any position, a bubble with a radius of two spacings takes up at least a quarter
//! of one of the cubes, so this cube is not full.

use glam::{IVec3, USizeVec3};
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::brick::{Block, DifField, RemotePages};
use crate::grid::{BIN, CellBox, MortonKey, local_morton};

/// Number of wide cells along the edge of a brick.
pub const BRICK: i32 = 4;
/// Number of bricks along the edge of a bin.
const BRICKS: i32 = BIN / BRICK;
/// The edge, in wide cells, of the parts into which bricks are divided. Cubes consist of whole
/// parts, and slide in steps of one part.
pub(super) const PART: i32 = 2;
/// The minimum edge of the cubes that must be full, in spacings.
const CUBE: f64 = 4.0;
/// The minimum content of a full cube, relative to the plateau.
const FULL_SHARE: f64 = 0.85;

/// The bricks that are inside.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct InsideBricks {
    /// For each bin of wide cells that has inside bricks, one bit per brick, at the brick's Morton
    /// index in the bin. The bit is set if the brick is inside.
    bricks: HashMap<IVec3, u64>,
}

/// Computes bits for each bin, and keeps the bins with at least one bit set.
fn bits_by_bin(keys: &[MortonKey], bits: impl Fn(IVec3) -> u64 + Sync) -> HashMap<IVec3, u64> {
    let of_bin =
        |key: &MortonKey| Some((key.coord(), bits(key.coord()))).filter(|(_, bits)| *bits != 0);
    keys.par_iter().filter_map(of_bin).collect::<Vec<_>>().into_iter().collect()
}

/// A value for each position in a cube of bricks or of parts of bricks, x fastest.
struct Cube<T> {
    edge: usize,
    values: Vec<T>,
}

impl<T: Copy> Cube<T> {
    /// Computes the values of the positions from `from` to `to` - 1 along each axis.
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

    /// For each position, combines the values of a cube with the function `both`. The cube begins
    /// at the position, and has `width` positions along each axis. The result has `width` - 1 fewer
    /// positions along each axis.
    fn joined(self, width: usize, both: impl Fn(T, T) -> T) -> Self {
        let Self { edge, mut values } = self;
        let left = edge + 1 - width;
        // The values can be replaced in place, because the loop reads only values that it has not
        // changed yet. Values of cubes that would reach beyond the end of a row are dropped.
        for step in [1, edge, edge * edge] {
            for at in 0..values.len() {
                let further = (1..width).map_while(|k| values.get(at + k * step).copied());
                values[at] = further.fold(values[at], &both);
            }
        }
        let first = |y: usize, z: usize| edge * (y + edge * z);
        let rows = (0..left).flat_map(|z| (0..left).map(move |y| first(y, z)));
        Self {
            edge: left,
            values: rows.flat_map(|first| values[first..first + left].to_vec()).collect(),
        }
    }
}

impl Cube<u64> {
    /// Sums the samples in each part of a box that consists of whole parts.
    fn of_parts(samples: &Block) -> Self {
        let cells = samples.cells();
        let edge = (cells.size().x / PART) as usize;
        let mut values = vec![0; edge * edge * edge];
        for ([y, z], row) in samples.rows(cells) {
            let [y, z] = [y - cells.lo.y, z - cells.lo.z].map(|at| (at / PART) as usize);
            let sums = &mut values[edge * (y + edge * z)..][..edge];
            for (sum, samples) in sums.iter_mut().zip(row.as_chunks::<{ PART as usize }>().0) {
                *sum += samples.iter().map(|&sample| u64::from(sample)).sum::<u64>();
            }
        }
        Self { edge, values }
    }
}

impl Cube<bool> {
    /// Keeps every other position along each axis.
    fn halved(self) -> Self {
        let edge = self.edge.div_ceil(2);
        let at = |place: IVec3| {
            2 * (place.x as usize + self.edge * (place.y as usize + self.edge * place.z as usize))
        };
        Self::new(0, edge as i32, |place| self.values[at(place)])
    }

    /// Returns one bit per brick of a bin, at the brick's Morton index.
    fn bits(&self) -> u64 {
        let edge = BRICKS as usize;
        debug_assert_eq!(self.edge, edge);
        let at = |i: usize| USizeVec3::new(i % edge, i / edge % edge, i / (edge * edge)).as_ivec3();
        let bits = self.values.iter().enumerate().filter(|&(_, &is_set)| is_set);
        bits.fold(0, |bits, (i, _)| bits | 1 << local_morton(at(i)))
    }
}

/// The bin that contains a brick, and the brick's Morton index in that bin. `brick` is in bricks,
/// relative to the corner of `bin`.
fn owner(bin: IVec3, brick: IVec3) -> (IVec3, usize) {
    let edge = IVec3::splat(BRICKS);
    (bin + brick.div_euclid(edge), local_morton(brick.rem_euclid(edge)))
}

/// Edge of the cubes that must be full, in parts. `edge` is the edge of a wide cell in spacings.
fn cube_parts(edge: f64) -> i32 {
    (CUBE / (edge * f64::from(PART)) - 1e-9).ceil().max(1.0) as i32
}

impl InsideBricks {
    /// The distance from a brick, in wide cells, within which cells affect whether the brick is
    /// inside. `edge` is the edge of a wide cell in spacings. A brick is inside only if its
    /// neighbours are full, and every cube that overlaps a neighbour affects whether it is full.
    pub fn reach(edge: f64) -> i32 {
        BRICK + PART * (cube_parts(edge) - 1)
    }

    /// The box around all bricks that `cells` touch. Both boxes are in wide cells.
    pub fn bricks_around(cells: CellBox) -> CellBox {
        let brick = IVec3::splat(BRICK);
        CellBox {
            lo: cells.lo.div_euclid(brick) * BRICK,
            hi: ((cells.hi - 1).div_euclid(brick) + 1) * BRICK,
        }
    }

    /// Finds the inside bricks of a field of wide cells, whose edge is `edge` spacings. Samples
    /// deep in the fluid are about `plateau`.
    pub fn of(field: &DifField, edge: f64, plateau: f64) -> Self {
        let keys: Vec<MortonKey> = field.keys().collect();
        let width = cube_parts(edge);
        let least = FULL_SHARE * plateau * f64::from(PART * width).powi(3);
        let margin = PART * (width - 1);
        // Sums are integers, so the minimum `least` can be rounded up.
        let full_bricks =
            |pages: &dyn RemotePages| pages.full_bricks(width as u32, least.ceil() as u32);
        let full = field.remote().and_then(full_bricks).map(|bits| {
            let bins = keys.iter().map(|key| key.coord());
            bins.zip(bits).filter(|&(_, bits)| bits != 0).collect()
        });
        let full: HashMap<IVec3, u64> = full.unwrap_or_else(|| {
            bits_by_bin(&keys, |bin| {
                // A bin with too few particles for a full cube, as in spray, has no inside brick,
                // and is not examined further.
                let cells = CellBox::cube(bin, BIN);
                let own: u64 =
                    field.gather(cells).samples().iter().map(|&sample| u64::from(sample)).sum();
                if (own as f64) < least {
                    return 0;
                }
                let sums = Cube::of_parts(&field.gather(cells.grown(margin, margin)));
                let Cube { edge, values } = sums.joined(width as usize, |a, b| a + b);
                let full = Cube {
                    edge,
                    values: values.into_iter().map(|sum| sum as f64 >= least).collect(),
                };
                let of_brick = width + BRICK / PART - 1;
                full.joined(of_brick as usize, |a, b| a && b).halved().bits()
            })
        });
        let is_full = |bin: IVec3, brick: IVec3| {
            let (bin, brick) = owner(bin, brick);
            full.get(&bin).is_some_and(|full| full >> brick & 1 != 0)
        };
        let bricks = bits_by_bin(&keys, |bin| match full.get(&bin) {
            None => 0,
            Some(_) => Cube::new(-1, BRICKS + 1, |brick| is_full(bin, brick))
                .joined(3, |a, b| a && b)
                .bits(),
        });
        Self { bricks }
    }

    /// Whether a brick of wide cells, given in brick coordinates, is inside.
    pub fn contains(&self, brick: IVec3) -> bool {
        let (bin, brick) = owner(IVec3::ZERO, brick);
        self.bricks.get(&bin).is_some_and(|bricks| bricks >> brick & 1 != 0)
    }

    /// The inside bricks among the wide cells `cells`, in brick coordinates.
    pub fn bricks(&self, cells: CellBox) -> impl Iterator<Item = IVec3> + '_ {
        let bins = cells.cubes(BIN).filter_map(|bin| Some((bin, *self.bricks.get(&bin)?)));
        bins.flat_map(move |(bin, bricks)| {
            let part = cells.intersection(&CellBox::cube(bin, BIN));
            part.cubes(BRICK)
                .filter(move |&brick| bricks >> local_morton(brick - bin * BRICKS) & 1 != 0)
        })
    }

    /// One bit for each brick that the wide cells `cells` touch, x fastest, packed into words. The
    /// bit is set if the brick is inside.
    pub fn marks(&self, cells: CellBox) -> Vec<u32> {
        let CellBox { lo, hi } = Self::bricks_around(cells);
        let touched = CellBox { lo: lo / BRICK, hi: hi / BRICK };
        let mut marks = vec![0; touched.volume().div_ceil(u32::BITS as usize)];
        let size = touched.size();
        for brick in self.bricks(cells) {
            let at = brick - touched.lo;
            let index = (at.x + size.x * (at.y + size.y * at.z)) as usize;
            marks[index / 32] |= 1 << (index % 32);
        }
        marks
    }

    /// The smallest box, in wide cells, around the bricks among `cells` that are not inside.
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
                    rest =
                        others.fold(rest, |rest, brick| rest.union(&CellBox::cube(brick, BRICK)));
                }
                None => rest = rest.union(&part),
            }
        }
        rest
    }

    /// Sets, in inside bricks, the samples of a field of wide cells to the maximum sample.
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
