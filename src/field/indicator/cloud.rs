//! The DIF of clouds: see `mod.rs` of this folder for the formula.

use glam::{DVec3, IVec3};
use multiversion::multiversion;

use crate::brick::{BinContents, BrickSide, FrameFacts, PageInfo, PageSamples, PageShape, unpack};
use crate::grid::{BIN, CellBox, FRACTION_BITS, FRACTIONS};

/// The reach of a cloud beyond its cell, in cells.
pub const GHOST_LAYER: i32 = 1;
/// Number of fraction bits of a share of a cloud.
pub const SHARE_BITS: u32 = 16;
/// The shift that computes a share, which is half the square of a length. A length has one fraction
/// bit more than an offset, so its square, shifted right by this number of bits, is the share.
pub const SQUARE_BITS: u32 = 2 * FRACTION_BITS + 3 - SHARE_BITS;
/// The minimum amount. A particle's own cell gets at least half of the cloud along each axis, and
/// so at least an eighth of the whole cloud. An eighth of a smaller amount could be rounded to 0.
const LEAST_AMOUNT: u16 = 4;
/// The maximum amount. With this amount, a sample does not overflow for four particles in the
/// middle of a fine cell, or for more particles elsewhere in the cell.
const GREATEST_AMOUNT: u16 = 1 << 15;
/// Number of cells of a bin along an axis.
const ROW: usize = BIN as usize;

/// The total that a particle adds to the cells around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Amount(u16);

impl Amount {
    /// The amount for particles `spacing` cells apart. With cells of at least half a spacing, the
    /// sample of a cell deep in the fluid is 4096. Samples saturate at sixteen times this density.
    pub fn of_spacing(spacing: f64) -> Self {
        let eighths = 8.0 / (spacing * spacing * spacing);
        Self(((f64::from(GREATEST_AMOUNT) / eighths.max(1.0)) as u16).max(LEAST_AMOUNT))
    }

    /// Returns the amount as a number of steps of a sample.
    pub fn steps(self) -> u16 {
        self.0
    }
}

/// Number of fraction bits of a gain.
pub const GAIN_BITS: u32 = 12;
/// The gain of a layer that is one cell thick.
const NO_GAIN: u32 = 1 << GAIN_BITS;
/// The greatest gain. A gain is 1 divided by the thickness of a layer in cells, and no layer in a
/// tank is thinner than half a cell.
const MOST_GAIN: f64 = 2.0;
/// The minimum width of a tank, in spacings, in which its outermost layers have gains. In narrower
/// tanks, such as the slab of two-dimensional particles, particles do not fill the layers evenly.
const LEAST_WIDTH: f64 = 2.5;

/// The walls at which clouds end.
///
/// The outermost layer of cells in a tank extends to the wall, so it is between 0.5 and 1.5 cells
/// thick, and the number of particles in it is proportional to its thickness. Filters mirror its
/// samples at the wall, so the contributions of particles to these samples are divided by the
/// thickness.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CloudWalls {
    /// The cells within the walls.
    pub cells: CellBox,
    /// The factors, in 4096ths, for the samples of the outermost layers at the lower walls and at
    /// the upper walls.
    pub gains: [[u32; 3]; 2],
}

impl CloudWalls {
    /// The walls of a frame, if it is in a tank.
    #[must_use]
    pub fn of(facts: &FrameFacts) -> Option<Self> {
        let domain = facts.domain.as_ref()?;
        let [lo, hi] = domain.walls();
        let least = LEAST_WIDTH * facts.spacing.unwrap_or_else(|| facts.grid.cell_size());
        let is_wide = (hi - lo).cmpge(DVec3::splat(least));
        let layers = domain.layers(&facts.grid);
        let gains = [0, 1].map(|side: usize| {
            [0, 1, 2].map(|axis| {
                let gain = (1.0 / layers[axis][side]).min(MOST_GAIN) * f64::from(NO_GAIN);
                if is_wide.test(axis) { gain.round() as u32 } else { NO_GAIN }
            })
        });
        Some(Self { cells: domain.cells(), gains })
    }

    /// The gain of a cell along an axis.
    fn gain(&self, axis: usize, cell: i32) -> u32 {
        match [self.cells.lo[axis], self.cells.hi[axis] - 1] {
            [lo, _] if cell == lo => self.gains[0][axis],
            [_, hi] if cell == hi => self.gains[1][axis],
            _ => NO_GAIN,
        }
    }
}

/// A product of gains, rounded down.
#[inline(always)]
fn gain_product(a: u32, b: u32) -> u32 {
    (a * b) >> GAIN_BITS
}

/// A part of a cloud, multiplied by a gain, rounded. Parts are multiplied one by one, so that
/// samples do not depend on how bricks divide a bin.
#[inline(always)]
fn raised(part: u32, gain: u32) -> u32 {
    (part * gain + NO_GAIN / 2) >> GAIN_BITS
}

/// The number of cells of a bin along an axis, including one cell below and one above.
const ROW_AROUND: usize = ROW + 2;

/// For each axis, the gain of each cell around a bin, from the one below the bin to the one above.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Gains([[u32; ROW_AROUND]; 3]);

impl Gains {
    /// The gains around a bin; `None` if all of them are 1.
    fn of(walls: &CloudWalls, bin: IVec3) -> Option<Self> {
        let first = bin * BIN - 1;
        let gains = [0, 1, 2].map(|axis: usize| {
            let mut gains = [NO_GAIN; ROW_AROUND];
            gains.iter_mut().zip(first[axis]..).for_each(|(to, cell)| *to = walls.gain(axis, cell));
            gains
        });
        (gains != [[NO_GAIN; ROW_AROUND]; 3]).then_some(Self(gains))
    }

    /// The part of a cloud that a cell gets, multiplied by the cell's gain. The cell is number `at`
    /// of the three cells along each axis that the cloud around `own` reaches.
    #[inline(always)]
    fn raised(&self, part: u32, own: [usize; 3], at: [usize; 3]) -> u32 {
        let [x, y, z] = [0, 1, 2].map(|axis: usize| self.0[axis][own[axis] + at[axis]]);
        raised(part, gain_product(gain_product(z, y), x))
    }
}

/// The cells at which clouds end along each axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct CloudLimits {
    /// For each axis, the lowest and the highest cell within the walls, relative to the bin. These
    /// cells may lie outside the bin.
    ends: [[i32; 2]; 3],
    /// The gains of the cells; `None` if all of them are 1.
    gains: Option<Gains>,
}

impl CloudLimits {
    /// The limits for a bin; `None` if no wall affects it.
    fn of(walls: &CloudWalls, bin: IVec3) -> Option<Self> {
        let [lo, hi] = [walls.cells.lo, walls.cells.hi - 1].map(|end| (end - bin * BIN).to_array());
        let touched = |cell: &i32| (-1..=BIN).contains(cell);
        if !(lo.iter().any(touched) || hi.iter().any(touched)) {
            return None;
        }
        let ends = [0, 1, 2].map(|axis| [lo[axis], hi[axis]]);
        Some(Self { ends, gains: Gains::of(walls, bin) })
    }

    /// The shares of a cloud around a cell. A share beyond a wall is added to the share of the last
    /// cell inside the wall.
    #[inline(always)]
    fn fold(&self, axis: usize, cell: usize, [below, own, above]: [u32; 3]) -> [u32; 3] {
        let [at_lo, at_hi] = self.ends[axis].map(|end| end == cell as i32);
        let beyond = |at: bool, share: u32| if at { share } else { 0 };
        let (under, over) = (beyond(at_lo, below), beyond(at_hi, above));
        [below - under, own + under + over, above - over]
    }
}

/// The shares of a particle's cloud in the cell below, in the particle's own cell, and in the cell
/// above. `offset` is the particle's offset in its cell.
#[inline(always)]
fn shares(offset: u32) -> [u32; 3] {
    let length = 2 * offset + 1;
    let half_square = |length: u32| (length * length) >> SQUARE_BITS;
    let (below, above) = (half_square(2 * FRACTIONS - length), half_square(length));
    [below, (1 << SHARE_BITS) - below - above, above]
}

/// A share of an amount, rounded. `amount` times `share`, plus half of 2^`SHARE_BITS`, must fit in
/// 32 bits.
#[inline(always)]
fn part_of(amount: u32, share: u32) -> u32 {
    (amount * share + (1 << (SHARE_BITS - 1))) >> SHARE_BITS
}

/// A share of an amount, rounded. `amount` times `share`, plus half of 2^`SHARE_BITS`, must fit in
/// 48 bits.
#[inline(always)]
fn wide_part_of(amount: u32, share: u32) -> u32 {
    ((u64::from(amount) * u64::from(share) + (1 << (SHARE_BITS - 1))) >> SHARE_BITS) as u32
}

/// Adds up the clouds of a bin's particles. All clouds have the same `amount` unless each particle
/// has its own.
pub struct Clouds {
    amount: u16,
    walls: Option<CloudWalls>,
    shape: PageShape,
    /// The terms of the index of a cloud's lowest sample: see [`PageShape::firsts`].
    firsts: [[usize; ROW]; 3],
}

impl Clouds {
    /// Makes clouds of `amount` that end at `walls`.
    pub fn new(Amount(amount): Amount, walls: Option<CloudWalls>, shape: PageShape) -> Self {
        Self { amount, walls, shape, firsts: shape.firsts() }
    }

    /// A buffer of zeros, which can be reused for all pages.
    pub fn room(&self) -> Vec<u16> {
        // An update writes rows of four samples. The fourth sample of the last row, which is never
        // changed, lies beyond the page.
        vec![0; self.shape.bin_samples() + 1]
    }

    /// The page of particles in a bin, each with its own amount; `None` if the page is empty.
    /// `room` must be all zeros, and is all zeros again afterwards.
    pub fn page_of_amounts(
        &self,
        room: &mut [u16],
        bin: IVec3,
        particles: &[(u64, u32)],
    ) -> Option<(PageInfo, PageSamples)> {
        let walls = self.walls.and_then(|walls| CloudLimits::of(&walls, bin));
        let gains = walls.as_ref().and_then(|walls| walls.gains.as_ref());
        let edge = self.shape.edge() as usize;
        for &(record, amount) in particles {
            let (cell, offset) = unpack(record);
            let [x, y, z] = [0, 1, 2].map(|axis| {
                let shares = shares(offset[axis]);
                walls.as_ref().map_or(shares, |walls| walls.fold(axis, cell[axis], shares))
            });
            let first: usize = (0..3).map(|axis| self.firsts[axis][cell[axis]]).sum();
            for (plane, z) in z.into_iter().enumerate() {
                for (row, y) in y.into_iter().enumerate() {
                    let in_row = wide_part_of(wide_part_of(amount, z), y);
                    let to = &mut room[first + edge * (edge * plane + row)..][..3];
                    for (column, (to, x)) in to.iter_mut().zip(x).enumerate() {
                        let part = wide_part_of(in_row, x).min(u16::MAX.into());
                        let at = [column, row, plane];
                        let part = gains.map_or(part, |gains| gains.raised(part, cell, at));
                        *to = to.saturating_add(part.min(u16::MAX.into()) as u16);
                    }
                }
            }
        }
        self.take_page(room, bin, particles.iter().map(|&(record, _)| unpack(record).0))
    }

    /// The page of a bin's particles. `room` must be all zeros, and is all zeros again afterwards.
    pub fn page(
        &self,
        room: &mut [u16],
        bin: IVec3,
        particles: &BinContents<'_>,
    ) -> (PageInfo, PageSamples) {
        let walls = self.walls.and_then(|walls| CloudLimits::of(&walls, bin));
        let add = match self.shape.side {
            BrickSide::Four => add_clouds::<{ edge(BrickSide::Four) }>,
            BrickSide::Eight => add_clouds::<{ edge(BrickSide::Eight) }>,
            BrickSide::Sixteen => add_clouds::<{ edge(BrickSide::Sixteen) }>,
        };
        let packed = particles.packed();
        add(self, room, packed, walls.as_ref());
        let cells = packed.iter().map(|&particle| unpack(particle).0);
        self.take_page(room, bin, cells).expect("a bin holds particles")
    }

    /// Takes the page of particles in the given `cells` of a bin out of `room`, and leaves zeros.
    fn take_page(
        &self,
        room: &mut [u16],
        bin: IVec3,
        cells: impl ExactSizeIterator<Item = [usize; 3]>,
    ) -> Option<(PageInfo, PageSamples)> {
        let samples = &mut room[..self.shape.bin_samples()];
        if PageSamples::are_sparse(self.shape.cells_per_particle() * cells.len(), self.shape) {
            // Few samples are nonzero, so only the samples near the particles' cells are examined.
            PageInfo::take_sparse(bin, samples, cells, self.shape)
        } else {
            let page = PageInfo::from_bricks(bin, samples, self.shape);
            samples.fill(0);
            page
        }
    }
}

/// Edge of a brick with its ghost layer, in samples.
const fn edge(side: BrickSide) -> usize {
    (side.cells() + 2 * GHOST_LAYER) as usize
}

/// Number of clouds in a batch, which the compiler vectorizes.
const BATCH: usize = 32;

/// Adds the clouds of particles to bricks with `EDGE` samples along an axis. Each update writes a
/// row of four samples, and leaves the last of them unchanged.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512vl+avx512dq",
    "x86_64+avx2+bmi1",
    "x86_64+sse4.1"
))]
fn add_clouds<const EDGE: usize>(
    of: &Clouds,
    samples: &mut [u16],
    packed: &[u64],
    walls: Option<&CloudLimits>,
) {
    let Clouds { amount, firsts, .. } = of;
    let amount = u32::from(*amount);
    let mut batch = [0; BATCH];
    // For each axis, the shares of the cells below, at and above the particle's own cell.
    let mut all_shares = [[[0; BATCH]; 3]; 3];
    // Rows of shares, indexed by z, then y.
    let mut rows = [[[[0; 4]; BATCH]; 3]; 3];
    for packed in packed.chunks(BATCH) {
        batch[..packed.len()].copy_from_slice(packed);
        for (axis, to) in all_shares.iter_mut().enumerate() {
            for (i, &particle) in batch.iter().enumerate() {
                let (cell, offset) = unpack(particle);
                let shares = shares(offset[axis]);
                let shares = walls.map_or(shares, |walls| walls.fold(axis, cell[axis], shares));
                to.iter_mut().zip(shares).for_each(|(to, share)| to[i] = share);
            }
        }
        let [x, y, z] = &all_shares;
        for (z, rows) in z.iter().zip(&mut rows) {
            for (y, rows) in y.iter().zip(rows) {
                for i in 0..BATCH {
                    let in_row = part_of(part_of(amount, z[i]), y[i]);
                    let part = |share| part_of(in_row, share) as u16;
                    rows[i] = [part(x[0][i]), part(x[1][i]), part(x[2][i]), 0];
                }
            }
        }
        if let Some(gains) = walls.and_then(|walls| walls.gains.as_ref()) {
            raise(&mut rows, gains, &batch);
        }
        for (i, &particle) in packed.iter().enumerate() {
            let ([x, y, z], _) = unpack(particle);
            let first = firsts[0][x] + firsts[1][y] + firsts[2][z];
            let around = &mut samples[first..][..2 * EDGE * (EDGE + 1) + 4];
            for (z, rows) in rows.iter().enumerate() {
                for (y, rows) in rows.iter().enumerate() {
                    let to = &mut around[EDGE * (EDGE * z + y)..][..4];
                    to.iter_mut()
                        .zip(&rows[i])
                        .for_each(|(to, part)| *to = to.saturating_add(*part));
                }
            }
        }
    }
}

/// Multiplies the parts of a batch of clouds by the gains of their cells.
fn raise(rows: &mut [[[[u16; 4]; BATCH]; 3]; 3], gains: &Gains, batch: &[u64; BATCH]) {
    for (z, rows) in rows.iter_mut().enumerate() {
        for (y, rows) in rows.iter_mut().enumerate() {
            for (parts, &particle) in rows.iter_mut().zip(batch) {
                let (cell, _) = unpack(particle);
                for (x, part) in parts[..3].iter_mut().enumerate() {
                    let more = gains.raised(u32::from(*part), cell, [x, y, z]);
                    *part = more.min(u16::MAX.into()) as u16;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_preserve_the_sum_and_the_first_two_moments() {
        let whole = 65536.0;
        for offset in 0..FRACTIONS {
            let shares = shares(offset).map(|share| f64::from(share) / whole);
            assert_eq!(shares.iter().sum::<f64>(), 1.0);
            let offset = (f64::from(offset) + 0.5) / f64::from(FRACTIONS) - 0.5;
            let moment = |power: i32| (-1.0_f64).powi(power) * shares[0] + shares[2];
            assert!((moment(1) - offset).abs() <= 1.0 / whole, "{offset}");
            assert!((moment(2) - offset * offset - 0.25).abs() <= 2.0 / whole, "{offset}");
        }
    }

    #[test]
    fn the_minimum_amount_leaves_a_sample_in_the_particles_own_cell() {
        assert_eq!(Amount::of_spacing(1e-3).steps(), LEAST_AMOUNT);
        assert_eq!(Amount::of_spacing(4.0).steps(), GREATEST_AMOUNT);
        for offset in [0, FRACTIONS / 2, FRACTIONS - 1] {
            let [_, own, _] = shares(offset);
            assert!(part_of(part_of(part_of(LEAST_AMOUNT.into(), own), own), own) > 0, "{offset}");
        }
    }

    #[test]
    fn gains_apply_to_the_outermost_layers_only_and_multiply_at_edges() {
        let cells = CellBox { lo: IVec3::new(2, 0, -40), hi: IVec3::new(40, 9, 40) };
        let walls = CloudWalls { cells, gains: [[8192, 2731, NO_GAIN], [3000, 5000, 6000]] };
        let gains = CloudLimits::of(&walls, IVec3::ZERO).unwrap().gains.unwrap();
        let of_cell = |cell| gains.raised(1000, cell, [1; 3]);
        assert_eq!(of_cell([5, 5, 5]), 1000);
        assert_eq!(of_cell([2, 5, 5]), 2000);
        assert_eq!(of_cell([5, 0, 5]), 667);
        assert_eq!(of_cell([5, 8, 5]), 1221);
        assert_eq!(of_cell([2, 0, 5]), 1333);
        // The cells of a neighbouring bin count too, because clouds reach into them.
        let above = CloudWalls { cells: CellBox { hi: IVec3::new(17, 90, 40), ..cells }, ..walls };
        assert_eq!(CloudLimits::of(&above, IVec3::ZERO).unwrap().gains.unwrap().0[0][17], 3000);
        assert_eq!(CloudLimits::of(&walls, IVec3::new(1, 40, 0)), None, "a bin in the middle");
    }

    #[test]
    fn weights_beyond_a_wall_move_to_the_last_cell_inside() {
        let tank = CellBox { lo: IVec3::new(16, -40, 3), hi: IVec3::new(17, 40, 32) };
        let limits = |cells: CellBox, bin: IVec3| {
            CloudLimits::of(&CloudWalls { cells, gains: [[NO_GAIN; 3]; 2] }, bin)
        };
        let walls = limits(tank, IVec3::new(1, 0, 0)).unwrap();
        assert_eq!(walls.fold(0, 0, [1, 20, 300]), [0, 321, 0], "one cell between two walls");
        assert_eq!(walls.fold(1, 0, [1, 20, 300]), [1, 20, 300], "far from both walls");
        assert_eq!(walls.fold(2, 3, [1, 20, 300]), [0, 21, 300], "at the lower wall");
        assert_eq!(walls.fold(2, 4, [1, 20, 300]), [1, 20, 300]);
        assert_eq!(
            limits(tank, IVec3::new(0, 0, 1)).map(|walls| walls.fold(2, 15, [1, 20, 300])),
            Some([1, 320, 0])
        );
        assert_eq!(limits(CellBox::cube(IVec3::ZERO, 64), IVec3::ONE), None, "a bin in the middle");
    }
}
