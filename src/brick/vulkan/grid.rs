//! The grid and its walls in the layout of shaders.

use bytemuck::{Pod, Zeroable};

use crate::grid::{Domain, Grid};

use super::wall_bounds;

/// The grid and its walls, laid out as in `grid.wgsl`: the parameters for placing particles and
/// vertices in f64.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct DeviceGrid {
    origin: [u64; 3],
    cell: u64,
    reciprocal: u64,
    walls_lo: [u64; 3],
    walls_hi: [u64; 3],
    padding: u64,
    lo: [i32; 3],
    walled: u32,
    hi: [i32; 3],
    padding_end: u32,
}

impl DeviceGrid {
    /// Lays out a grid, and a domain on it, for shaders.
    pub fn new(grid: &Grid, domain: Option<&Domain>) -> Self {
        let [lo, hi] = wall_bounds(domain.map(Domain::cells));
        let [walls_lo, walls_hi] = domain.map(Domain::walls).unwrap_or_default();
        let bits = |x: glam::DVec3| x.to_array().map(f64::to_bits);
        Self {
            origin: bits(grid.origin()),
            cell: grid.cell_size().to_bits(),
            reciprocal: reciprocal(grid.cell_size()),
            walls_lo: bits(walls_lo),
            walls_hi: bits(walls_hi),
            padding: 0,
            lo,
            walled: domain.is_some().into(),
            hi,
            padding_end: 0,
        }
    }
}

/// Returns the reciprocal for `float64.wgsl`: (2^116 - 1) / m, rounded down, where m is the
/// significand of `divisor` as an integer from 2^52 to 2^53.
///
/// The divisor must be positive and finite.
pub fn reciprocal(divisor: f64) -> u64 {
    let fraction_bits = f64::MANTISSA_DIGITS - 1;
    let fraction = divisor.to_bits() & ((1 << fraction_bits) - 1);
    let significand = if divisor.is_normal() { fraction | 1 << fraction_bits } else { fraction };
    let shift = significand.leading_zeros() - (u64::BITS - f64::MANTISSA_DIGITS);
    (((1_u128 << 116) - 1) / u128::from(significand << shift)) as u64
}
