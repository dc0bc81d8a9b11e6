//! Interpolates particle attributes to the vertices.
//!
//! A cell's value is blur(sum of values) / blur(N), where N is the number of particles in the cell.
//! The sum and N are blurred like the DIF. The value of a vertex is interpolated between the two
//! cells at the ends of its edge, weighted by its position on the edge. Sums over particles are
//! integers: values are rounded to multiples of a step. The step is a power of two, chosen so that
//! the greatest magnitude among the particles that affect a block takes 30 bits. Particles with a
//! value that is not finite are skipped.
//!
//! Integers such as identifiers cannot be averaged, so a vertex takes the value of the nearest
//! particle. Ties are decided by the particle's position, and then by its values.
//!
//! The value of a vertex depends only on the particles within the reach of the smoothing.

use std::io;
use std::ops::Range;

use glam::IVec3;

use crate::brick::{Bins, Block};
use crate::field::blur::{Filter, Smoothing};
use crate::grid::{BIN, CellBox, FRACTION_BITS, Mirror, MortonKey};
use crate::surface::dual_mc::Crossings;
use crate::surface::mesh::BlockMesh;

/// Number of components that are smoothed together: enough for common attributes, and few enough to
/// limit the memory of each thread.
const AT_ONCE: usize = 16;

/// Attributes with more components than this in total are wide: in each block, they take much more
/// memory than the mesh.
const WIDE: usize = 64;

/// Whether the attributes together are wide. `components` has the number of components of each
/// attribute. Wide attributes are interpolated and encoded for only a few blocks at a time.
pub fn are_wide(components: impl IntoIterator<Item = usize>) -> bool {
    components.into_iter().sum::<usize>() > WIDE
}

/// Memory, in bytes per cell, for smoothing an attribute with `components` components: for the sums
/// of the components that are smoothed together, the number of particles, and two more fields.
pub fn cell_bytes(components: usize) -> u64 {
    ((components.min(AT_ONCE) + 3) * size_of::<f64>()) as u64
}

/// The step to which values are rounded for summation.
#[derive(Debug, Clone, Copy, PartialEq)]
struct FixedPoint {
    steps_per_unit: f64,
}

impl FixedPoint {
    /// The finest step at which magnitudes up to `greatest` fit into 30 bits.
    fn for_magnitude(greatest: f32) -> Self {
        let exponent =
            if greatest > 0.0 { 29 - libm::log2(f64::from(greatest)).floor() as i32 } else { 0 };
        Self { steps_per_unit: 2f64.powi(exponent) }
    }

    fn steps(self, value: f32) -> i64 {
        (f64::from(value) * self.steps_per_unit).round() as i64
    }

    fn value(self, steps: i64) -> f64 {
        steps as f64 / self.steps_per_unit
    }
}

/// The values of a particle attribute at the vertices of a block, with the components of each
/// vertex contiguous. `smoothing` and `mirror` are in cells of the block's level.
///
/// # Errors
/// If a scratch file with particles cannot be read.
pub fn vertex_values(
    bins: &Bins,
    (attribute, components): (usize, usize),
    smoothing: &Smoothing,
    mesh: &BlockMesh,
    crossings: Crossings,
    mirror: Option<Mirror>,
) -> io::Result<Vec<f32>> {
    let edges: Vec<_> = mesh.edges().map(|(cell, axis)| [cell, cell + IVec3::AXES[axis]]).collect();
    let used = edges
        .iter()
        .flatten()
        .fold(CellBox::EMPTY, |used, &cell| used.union(&CellBox { lo: cell, hi: cell + 1 }));
    if used.is_empty() {
        return Ok(Vec::new());
    }
    let reach = smoothing.halo();
    // Sums are mirrored at walls, so the nearest cells within the walls are also needed.
    let cells = used.with_nearest_of(mirror.map(|mirror| mirror.cells())).grown(reach, reach);
    let smooth = |mut sum: Block<f64>| {
        sum.mirror(mirror);
        smoothing.apply(sum, mirror)
    };
    let mut values = vec![0.0; edges.len() * components];
    for first in (0..components).step_by(AT_ONCE) {
        let group = first..components.min(first + AT_ONCE);
        let level = mesh.level.level.into();
        let sums = sums(bins, (attribute, components), group.clone(), (cells, level))?;
        let sums: Vec<_> = sums.into_iter().map(smooth).collect();
        let (weight, sums) = sums.split_last().expect("the weights come last");
        let vertices = values.chunks_exact_mut(components).zip(&edges).zip(&mesh.ends);
        for ((values, cells), &ends) in vertices {
            interpolate(&mut values[group.clone()], sums, weight, *cells, crossings.fraction(ends));
        }
    }
    Ok(values)
}

/// The values of an integer attribute at the vertices of a block, with the components of each
/// vertex contiguous. A vertex takes the values of the nearest particle within `reach` cells of the
/// block, or zeros if there is none.
///
/// # Errors
/// If a scratch file with particles cannot be read.
pub fn nearest_values(
    bins: &Bins,
    (attribute, components): (usize, usize),
    reach: i32,
    mesh: &BlockMesh,
    crossings: Crossings,
) -> io::Result<Vec<f32>> {
    let edges: Vec<_> = mesh.edges().collect();
    let used = edges
        .iter()
        .fold(CellBox::EMPTY, |used, &(cell, _)| used.union(&CellBox { lo: cell, hi: cell + 2 }));
    if used.is_empty() {
        return Ok(Vec::new());
    }
    let cells = used.grown(reach, reach);
    // For each particle, the index of its cell, its position in steps of 1 / 2^`FRACTION_BITS` of
    // the finest cells, and the bits of its values.
    let mut found: Vec<(usize, [i64; 3], Vec<u32>)> = Vec::new();
    let index_of = Block::<u8>::zero(cells);
    let level = u32::from(mesh.level.level);
    for coord in cells.in_narrower_cells(level).cubes(BIN) {
        let Ok(bin) = bins.keys().binary_search(&MortonKey::of(coord)) else { continue };
        let contents = bins.contents(bin)?;
        let tuples = contents.attributes[attribute].chunks_exact(components);
        for ((local, offset), tuple) in contents.particles().zip(tuples) {
            let own = cell_of(coord, local);
            let cell = own >> level;
            if cells.contains(cell) {
                let steps = [0, 1, 2]
                    .map(|axis| i64::from(own[axis]) << FRACTION_BITS | i64::from(offset[axis]));
                let words = tuple.iter().map(|word| word.to_bits()).collect();
                found.push((index_of.index(cell), steps, words));
            }
        }
    }
    // Particles are sorted by cell, then by position and values, so that the result does not depend
    // on their order in the input.
    found.sort_unstable();
    let of_cell = |cell: IVec3| {
        let index = index_of.index(cell);
        let first = found.partition_point(|&(other, ..)| other < index);
        found[first..].iter().take_while(move |&&(other, ..)| other == index)
    };
    let mut values = Vec::with_capacity(edges.len() * components);
    for (&(cell, axis), &ends) in edges.iter().zip(&mesh.ends) {
        // The position of the vertex, in the steps to which particle positions are rounded. A cell
        // of the block is 2^`bits` steps wide.
        let bits = FRACTION_BITS + level;
        let half = 1_i64 << (bits - 1);
        let mut place = [0, 1, 2].map(|a| (i64::from(cell[a]) << bits) + half);
        place[axis] += (crossings.fraction(ends) * (2 * half) as f64).round() as i64;
        let mut best: Option<(i64, [i64; 3], &[u32])> = None;
        for shell in 0..=reach {
            // All particles in this shell and in outer shells are at least `passed` steps away.
            let passed = (i64::from(shell) << bits) - 3 * half;
            if best.is_some_and(|(squared, ..)| passed > 0 && squared < passed * passed) {
                break;
            }
            for other in shell_around(cell, shell).filter(|&other| cells.contains(other)) {
                for (_, steps, words) in of_cell(other) {
                    let squared = (0..3).map(|a| (steps[a] - place[a]).pow(2)).sum();
                    let found = (squared, *steps, &words[..]);
                    best = Some(best.map_or(found, |best| best.min(found)));
                }
            }
        }
        match best {
            Some((.., words)) => values.extend(words.iter().map(|&word| f32::from_bits(word))),
            None => values.extend(std::iter::repeat_n(0.0, components)),
        }
    }
    Ok(values)
}

/// The cells whose Chebyshev distance from `cell` is `distance`.
fn shell_around(cell: IVec3, distance: i32) -> impl Iterator<Item = IVec3> {
    let along = move || -distance..=distance;
    along().flat_map(move |z| along().map(move |y| (y, z))).flat_map(move |(y, z)| {
        let inner = y.abs() < distance && z.abs() < distance;
        let step = if inner { 2 * distance } else { 1 };
        along().step_by(step.max(1) as usize).map(move |x| cell + IVec3::new(x, y, z))
    })
}

/// Cell number `local` in the bin at `coord`.
fn cell_of(coord: IVec3, local: usize) -> IVec3 {
    let local = local as i32;
    coord * BIN + IVec3::new(local % BIN, local / BIN % BIN, local / (BIN * BIN))
}

/// Interpolates the `values` of a vertex between those of two `cells`. The second cell has the
/// weight `upper_share`.
fn interpolate(
    values: &mut [f32],
    sums: &[Block<f64>],
    weight: &Block<f64>,
    cells: [IVec3; 2],
    upper_share: f64,
) {
    let index = cells.map(|cell| weight.index(cell));
    let weights = index.map(|i| weight.samples()[i]);
    // If no particle reaches one end of the edge, the vertex takes the value of the other end.
    let shares = match weights.map(|w| w > 0.0) {
        [true, true] => [(1.0 - upper_share) / weights[0], upper_share / weights[1]],
        [true, false] => [1.0 / weights[0], 0.0],
        [false, true] => [0.0, 1.0 / weights[1]],
        [false, false] => [0.0, 0.0],
    };
    for (value, sum) in values.iter_mut().zip(sums) {
        let ends = index.map(|i| sum.samples()[i]);
        *value = (ends[0] * shares[0] + ends[1] * shares[1]) as f32;
    }
}

/// For each component in `group`, a block with the sum over the particles of each cell. The last
/// block has the number of particles in each cell. All components are rounded to the same step.
fn sums(
    bins: &Bins,
    (attribute, components): (usize, usize),
    group: Range<usize>,
    (cells, level): (CellBox, u32),
) -> io::Result<Vec<Block<f64>>> {
    let mut sums: Vec<Block<i64>> = vec![Block::zero(cells); group.len() + 1];
    let mut greatest = 0.0;
    let mut indices: Vec<usize> = Vec::new();
    let mut values: Vec<f32> = Vec::new();
    for coord in cells.in_narrower_cells(level).cubes(BIN) {
        let Ok(bin) = bins.keys().binary_search(&MortonKey::of(coord)) else { continue };
        let contents = bins.contents(bin)?;
        let tuples = contents.attributes[attribute].chunks_exact(components);
        for ((local, _), tuple) in contents.particles().zip(tuples) {
            let cell = cell_of(coord, local) >> level;
            if cells.contains(cell) && tuple.iter().all(|x| x.is_finite()) {
                indices.push(sums[0].index(cell));
                values.extend_from_slice(&tuple[group.clone()]);
                greatest = tuple.iter().fold(greatest, |greatest: f32, x| x.abs().max(greatest));
            }
        }
    }
    let fixed = FixedPoint::for_magnitude(greatest);
    for (&index, tuple) in indices.iter().zip(values.chunks_exact(group.len())) {
        for (sum, steps) in sums.iter_mut().zip(tuple.iter().map(|&x| fixed.steps(x)).chain([1])) {
            sum.samples_mut()[index] += steps;
        }
    }
    let real = |(component, sum): (usize, Block<i64>)| {
        let mut block = Block::zero(cells);
        for (to, &sum) in block.samples_mut().iter_mut().zip(sum.samples()) {
            *to = if component < group.len() { fixed.value(sum) } else { sum as f64 };
        }
        block
    };
    Ok(sums.into_iter().enumerate().map(real).collect())
}
