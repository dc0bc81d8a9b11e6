//! See the room's `mod.rs` for the formulas.

use std::io;

use rayon::prelude::*;

use crate::brick::{Bins, Block};
use crate::grid::{BIN, CellBox, MortonKey};
use crate::mesh::BlockMesh;
use crate::stage::blur::Smoothing;
use crate::stage::dual_mc::vertex_fraction;
use crate::units::Isovalue;

/// The step to which an attribute's values are rounded before they are added.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixedPoint {
    steps_per_unit: f64,
}

impl FixedPoint {
    /// The finest step at which the attribute's greatest magnitude takes no more than 30 bits.
    ///
    /// # Errors
    /// Where particles are in a scratch file that cannot be read.
    pub fn of(bins: &Bins, attribute: usize) -> io::Result<Self> {
        let greatest = (0..bins.keys().len())
            .into_par_iter()
            .map(|bin| {
                let contents = bins.contents(bin)?;
                let finite = contents.attributes[attribute].iter().filter(|x| x.is_finite());
                Ok(finite.fold(0.0, |greatest: f32, x| greatest.max(x.abs())))
            })
            .try_reduce(|| 0.0, |a, b: f32| io::Result::Ok(a.max(b)))?;
        let exponent = if greatest > 0.0 { 29 - f64::from(greatest).log2().floor() as i32 } else { 0 };
        Ok(Self { steps_per_unit: 2f64.powi(exponent) })
    }

    fn steps(self, value: f32) -> i64 {
        (f64::from(value) * self.steps_per_unit).round() as i64
    }

    fn value(self, steps: i64) -> f32 {
        (steps as f64 / self.steps_per_unit) as f32
    }
}

/// An attribute of the particles on the vertices of a block, all components of one vertex after the other.
///
/// # Errors
/// Where particles are in a scratch file that cannot be read.
pub fn vertex_values(
    bins: &Bins,
    (attribute, components, fixed): (usize, usize, FixedPoint),
    smoothing: &Smoothing,
    mesh: &BlockMesh,
    iso: Isovalue,
    walls: Option<CellBox>,
) -> io::Result<Vec<f32>> {
    let edges: Vec<_> = mesh
        .tiles
        .iter()
        .flat_map(|tile| {
            let corner = tile.corner(mesh.block);
            tile.edges().map(move |(cell, axis)| [corner + cell, corner + cell + glam::IVec3::AXES[axis]])
        })
        .collect();
    let used = edges
        .iter()
        .flatten()
        .fold(CellBox::EMPTY, |used, &cell| used.union(&CellBox { lo: cell, hi: cell + 1 }));
    if used.is_empty() {
        return Ok(Vec::new());
    }
    let reach = smoothing.reach();
    let mut sums = sums(bins, attribute, components, fixed, used.grown(reach, reach))?;
    for sum in &mut sums {
        if let Some(walls) = walls {
            sum.repeat_edges(walls);
        }
        *sum = smoothing.apply(sum, walls);
    }
    let (weight, sums) = sums.split_last().expect("the weights come last");

    let mut values = Vec::with_capacity(edges.len() * components);
    for (cells, &ends) in edges.iter().zip(&mesh.ends) {
        let upper_share = vertex_fraction(ends, iso) as f32;
        let index = cells.map(|cell| weight.index(cell));
        let weights = index.map(|i| weight.samples()[i]);
        // An end that no particle reaches has no value to give.
        let shares = match weights.map(|w| w > 0.0) {
            [true, true] => [(1.0 - upper_share) / weights[0], upper_share / weights[1]],
            [true, false] => [1.0 / weights[0], 0.0],
            [false, true] => [0.0, 1.0 / weights[1]],
            [false, false] => [0.0, 0.0],
        };
        values.extend(
            sums.iter().map(|sum| sum.samples()[index[0]] * shares[0] + sum.samples()[index[1]] * shares[1]),
        );
    }
    Ok(values)
}

/// Per cell the sum of each component over its particles, and last the number of particles.
fn sums(
    bins: &Bins,
    attribute: usize,
    components: usize,
    fixed: FixedPoint,
    cells: CellBox,
) -> io::Result<Vec<Block<f32>>> {
    let mut sums: Vec<Block<i64>> = vec![Block::zero(cells); components + 1];
    for coord in cells.cubes(BIN) {
        let Ok(bin) = bins.keys().binary_search(&MortonKey::of(coord)) else { continue };
        let contents = bins.contents(bin)?;
        let tuples = contents.attributes[attribute].chunks_exact(components);
        for ((local, _), tuple) in contents.particles().zip(tuples) {
            let local =
                glam::IVec3::new(local as i32 % BIN, local as i32 / BIN % BIN, local as i32 / (BIN * BIN));
            let cell = coord * BIN + local;
            if !cells.contains(cell) || tuple.iter().any(|x| !x.is_finite()) {
                continue;
            }
            let index = sums[0].index(cell);
            for (sum, steps) in sums.iter_mut().zip(tuple.iter().map(|&x| fixed.steps(x)).chain([1])) {
                sum.samples_mut()[index] += steps;
            }
        }
    }
    let float = |(component, sum): (usize, Block<i64>)| {
        let mut block = Block::zero(cells);
        for (to, &sum) in block.samples_mut().iter_mut().zip(sum.samples()) {
            *to = if component < components { fixed.value(sum) } else { sum as f32 };
        }
        block
    };
    Ok(sums.into_iter().enumerate().map(float).collect())
}
