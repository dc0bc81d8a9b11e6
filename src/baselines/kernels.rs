//! The kernels of all particles of a frame, and the field that follows from their sum.

use std::fmt::Debug;
use std::io;
use std::path::Path;

use glam::{DVec3, IVec3};
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::brick::{Bins, Block};
use crate::grid::{BIN, BLOCK, CellBox, Mirror, block_parts};
use crate::surface::dual_mc::{Normals, ZeroLevel, block_mesh};
use crate::surface::mesh::BlockMesh;
use crate::system::scratch::Lists;

use super::neighbours::{NeighbourGrid, places};
use super::scheme::Scheme;

/// Maximum number of particles in a batch, unless a single bin has more. The kernels of a batch are
/// computed in parallel.
const BATCH: usize = 1 << 17;
/// Width, in cells, of the margin around a block in which its mesh may need the field: one cell for
/// the upper corners of the dual cells, and one more cell for normals.
const MARGIN: i32 = 2;

/// The field that a kernel method makes for a frame, ready to be meshed block by block.
pub trait KernelField: Debug + Send + Sync {
    /// The parts of blocks that the surface can pass through, in Morton order.
    fn regions(&self, walls: Option<CellBox>) -> Vec<CellBox>;

    /// The surface through a region; `None` if no surface passes through it. Cells outside `walls`
    /// are ghost points, which mirror the cells inside.
    ///
    /// # Errors
    /// If kernels are in a scratch file that cannot be read.
    fn mesh(
        &self,
        region: CellBox,
        with: Normals,
        walls: Option<CellBox>,
    ) -> io::Result<Option<BlockMesh>>;
}

/// The kernels of all particles.
#[derive(Debug)]
pub(super) struct Kernels<S: Scheme> {
    scheme: S,
    /// The kernels of each bin, in the order of its particles.
    kernels: Lists<S::Kernel>,
    bins: Vec<ReachedCells>,
    /// For each block, the bins whose kernels reach the block or its margin, in Morton order.
    by_block: HashMap<IVec3, Vec<u32>>,
}

/// The cells that the kernels of a bin's particles reach.
#[derive(Debug)]
struct ReachedCells {
    /// The bin's lowest cell.
    corner: IVec3,
    /// All cells whose centres a kernel may reach.
    cells: CellBox,
}

impl<S: Scheme> Kernels<S> {
    pub(super) fn of(bins: &Bins, scheme: S, bytes: u64, folder: &Path) -> io::Result<Self> {
        let mut kernels = Lists::in_memory();
        let mut reached = Vec::new();
        let count = bins.keys().len();
        while reached.len() < count {
            let mut particles = 0;
            let batch = (reached.len()..count).take_while(|&bin| {
                particles += bins.count(bin);
                particles <= BATCH
            });
            let batch = reached.len()..reached.len() + batch.count().max(1);
            let done: Vec<_> = batch
                .into_par_iter()
                .map(|bin| bin_kernels(bins, bin, &scheme))
                .collect::<io::Result<_>>()?;
            for (list, cells) in done {
                kernels.push(list)?;
                reached.push(cells);
            }
            if kernels.bytes() > bytes {
                kernels.move_to_file(folder)?;
            }
        }
        let mut by_block: HashMap<IVec3, Vec<u32>> = HashMap::new();
        for (bin, reached) in (0..).zip(&reached) {
            for block in reached.cells.grown(MARGIN, MARGIN).cubes(BLOCK) {
                by_block.entry(block).or_default().push(bin);
            }
        }
        Ok(Self { scheme, kernels, bins: reached, by_block })
    }

    fn field(&self, cells: CellBox, block: IVec3) -> io::Result<Block<f64>> {
        let mut sums = Block::zero(cells);
        for &bin in self.by_block.get(&block).map_or(&[][..], |bins| bins) {
            let ReachedCells { corner, cells: reached } = &self.bins[bin as usize];
            if reached.intersection(&cells).is_empty() {
                continue;
            }
            for kernel in self.kernels.get(bin as usize)?.iter() {
                self.splat(kernel, *corner, &mut sums);
            }
        }
        let mut field = Block::zero(cells);
        let values = sums.samples().iter().map(|&sum| self.scheme.field(sum));
        field.samples_mut().iter_mut().zip(values).for_each(|(to, value)| *to = value);
        Ok(field)
    }

    /// Adds a kernel to the sums at the centres of all cells that it reaches.
    fn splat(&self, kernel: &S::Kernel, corner: IVec3, sums: &mut Block<S::Sum>) {
        let [place, reach] = self.scheme.extent(kernel);
        let CellBox { lo, hi } = centres(place, reach, corner).intersection(&sums.cells());
        // The centre of a cell, relative to the kernel's position.
        let offset = |cell: IVec3| (cell - corner).as_dvec3() + 0.5 - place;
        for z in lo.z..hi.z {
            for y in lo.y..hi.y {
                if lo.x >= hi.x {
                    return;
                }
                let first = IVec3::new(lo.x, y, z);
                let index = sums.index(first);
                let mut point = offset(first);
                for sum in &mut sums.samples_mut()[index..index + (hi.x - lo.x) as usize] {
                    self.scheme.add(kernel, point, sum);
                    point.x += 1.0;
                }
            }
        }
    }
}

fn bin_kernels<S: Scheme>(
    bins: &Bins,
    bin: usize,
    scheme: &S,
) -> io::Result<(Vec<S::Kernel>, ReachedCells)> {
    let coord = bins.keys()[bin].coord();
    let corner = coord * BIN;
    let reach = scheme.neighbourhood().ceil() as i32;
    let neighbours =
        NeighbourGrid::load(bins, CellBox::cube(coord, BIN).grown(reach, reach), corner)?;
    let contents = bins.contents(bin)?;
    let kernels: Vec<_> = places(&contents, IVec3::ZERO)
        .map(|(_, place)| scheme.kernel(place, &neighbours))
        .collect();
    let reached = kernels.iter().fold(CellBox::EMPTY, |cells, kernel| {
        let [place, reach] = scheme.extent(kernel);
        cells.union(&centres(place, reach, corner))
    });
    Ok((kernels, ReachedCells { corner, cells: reached }))
}

/// The cells whose centres are at most `reach` away from `place` along each axis. `place` is
/// relative to the lowest corner of cell `corner`.
fn centres(place: DVec3, reach: DVec3, corner: IVec3) -> CellBox {
    let lo = (place - reach - 0.5).ceil().as_ivec3();
    let hi = (place + reach - 0.5).floor().as_ivec3() + 1;
    CellBox { lo: corner + lo, hi: corner + hi }
}

impl<S: Scheme> KernelField for Kernels<S> {
    fn regions(&self, walls: Option<CellBox>) -> Vec<CellBox> {
        // A dual cell extends one cell up from its lowest corner, so the lowest dual cells that
        // contain a reached cell begin one cell below the reached cell.
        let within = walls.map(|walls| walls.grown(1, 0));
        let cut = |cells: CellBox| within.map_or(cells, |within| cells.intersection(&within));
        let reached = self.bins.iter().map(|reached| cut(reached.cells.grown(1, 0)));
        block_parts(reached.filter(|cells| !cells.is_empty()))
    }

    fn mesh(
        &self,
        region: CellBox,
        with: Normals,
        walls: Option<CellBox>,
    ) -> io::Result<Option<BlockMesh>> {
        let mut field =
            self.field(with.cells(region), region.lo.div_euclid(IVec3::splat(BLOCK)))?;
        field.mirror(walls.map(Mirror::new));
        Ok(block_mesh(&field, region, ZeroLevel, with, walls))
    }
}
