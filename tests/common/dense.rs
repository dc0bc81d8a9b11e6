//! The oracle: implements `src/method.md` on one dense array, as simply as possible.
//!
//! There are two implementations. One uses the library's integers, and the sparse field must equal
//! its result to the bit. The other uses f64, as `src/method.md` describes. The oracle shares no
//! code with the library except the marching-cubes table, which has its own tests.

use std::collections::BTreeMap;

use glam::{DVec3, IVec3};
use meniscus::internals::field::indicator::Indicator;
use meniscus::internals::field::recipe::Detail;
use meniscus::internals::grid::CellBox;
use meniscus::internals::surface::dual_mc::cases::TABLE;

/// The settings of the oracle. Cells have edge 1, and the grid's origin is 0.
pub struct Method {
    pub indicator: Indicator,
    pub sigma: f64,
    pub detail: Detail,
    /// The isovalue, in units of 1 / 65535.
    pub iso: f64,
    pub walls: Option<CellBox>,
}

/// The planes at which walls mirror the fluid, in halves of a cell.
#[derive(Clone, Copy)]
pub struct Mirrors([IVec3; 2]);

impl Mirrors {
    pub fn of(walls: CellBox) -> Self {
        Self([walls.lo * 2, walls.hi * 2])
    }

    /// Returns the same planes for cells that are twice as wide, in halves of these cells, rounded
    /// outwards.
    pub fn wider(self) -> Self {
        let [lo, hi] = self.0;
        Self([lo.div_euclid(IVec3::splat(2)), (hi + 1).div_euclid(IVec3::splat(2))])
    }

    /// The cell whose image along `axis` is at `cell`, found by reflecting the middle of `cell`
    /// until it is between the planes.
    fn source(self, mut cell: IVec3, axis: usize) -> IVec3 {
        let [lo, hi] = self.0.map(|planes| planes[axis]);
        let mut middle = 2 * cell[axis] + 1;
        while middle < lo || middle > hi {
            middle = 2 * if middle < lo { lo } else { hi } - middle;
        }
        cell[axis] = (middle - 1) / 2;
        cell
    }
}

/// A value for every cell of a box.
#[derive(Clone)]
pub struct Dense<T> {
    pub cells: CellBox,
    pub values: Vec<T>,
}

impl<T: Copy + Default> Dense<T> {
    pub fn new(cells: CellBox, value: impl Fn(IVec3) -> T) -> Self {
        let mut values = Vec::with_capacity(cells.volume());
        for z in cells.lo.z..cells.hi.z {
            for y in cells.lo.y..cells.hi.y {
                for x in cells.lo.x..cells.hi.x {
                    values.push(value(IVec3::new(x, y, z)));
                }
            }
        }
        Self { cells, values }
    }

    pub fn iter(&self) -> impl Iterator<Item = (IVec3, T)> + '_ {
        let size = self.cells.size();
        self.values.iter().enumerate().map(move |(i, &value)| {
            let i = i as i32;
            (
                self.cells.lo + IVec3::new(i % size.x, i / size.x % size.y, i / (size.x * size.y)),
                value,
            )
        })
    }

    /// The value of the box's cell that is nearest to `cell`.
    pub fn nearest(&mut self, cell: IVec3) -> &mut T {
        let (local, size) =
            (cell.clamp(self.cells.lo, self.cells.hi - 1) - self.cells.lo, self.cells.size());
        &mut self.values[(local.x + size.x * (local.y + size.y * local.z)) as usize]
    }

    /// The value of a cell. Outside the box, the value is 0 or, with walls, the value of the cell
    /// whose mirror image is at `cell`.
    pub fn at(&self, cell: IVec3, walls: Option<Mirrors>) -> T {
        let cell =
            walls.map_or(cell, |walls| (0..3).fold(cell, |cell, axis| walls.source(cell, axis)));
        self.value(cell)
    }

    /// The value of the cell that is `k` cells from `cell` along `axis`, like [`at`](Self::at) but
    /// mirrored only along this axis.
    pub fn along(&self, cell: IVec3, (k, axis): (i32, usize), walls: Option<Mirrors>) -> T {
        let cell = cell + IVec3::AXES[axis] * k;
        self.value(walls.map_or(cell, |walls| walls.source(cell, axis)))
    }

    fn value(&self, cell: IVec3) -> T {
        if !self.cells.contains(cell) {
            return T::default();
        }
        let (local, size) = (cell - self.cells.lo, self.cells.size());
        self.values[(local.x + size.x * (local.y + size.y * local.z)) as usize]
    }
}

/// Half of the paper's Gaussian mask (section 4.2), from the centre outwards. The full mask sums
/// to 1.
pub fn gaussian(sigma: f64) -> Vec<f64> {
    let taps = 3.max(2 * (3.0 * sigma).floor() as i32 - 1);
    let weight = |k: i32| (-f64::from(k * k) / (2.0 * sigma * sigma)).exp();
    let sum: f64 = (-(taps / 2)..=taps / 2).map(weight).sum();
    (0..=taps / 2).map(|k| weight(k) / sum).collect()
}

fn integer_weights(half: &[f64]) -> Vec<u64> {
    let mut weights: Vec<u64> = half.iter().map(|w| (w * 65536.0).round() as u64).collect();
    weights[0] = 65536 - 2 * weights[1..].iter().sum::<u64>();
    weights
}

impl Method {
    fn mu0(&self) -> f64 {
        self.indicator.mean().map_or(f64::NAN, |mean| mean.particles())
    }

    /// The cells between the walls or, without walls, all cells in which the field can differ from
    /// 0.
    fn cells(&self, particles: &[[f64; 3]]) -> CellBox {
        self.walls.unwrap_or_else(|| {
            let reach = 2 * gaussian(self.sigma).len() as i32 + 2;
            particles
                .iter()
                .map(|&p| DVec3::from(p).floor().as_ivec3())
                .fold(CellBox::EMPTY, |b, cell| b.union(&CellBox { lo: cell, hi: cell + 1 }))
                .grown(reach, reach)
        })
    }

    fn particles_by_cell(&self, particles: &[[f64; 3]]) -> BTreeMap<[i32; 3], Vec<DVec3>> {
        let mut by_cell: BTreeMap<_, Vec<_>> = BTreeMap::new();
        for p in particles.iter().map(|&p| DVec3::from(p)) {
            let cell = p.floor().as_ivec3();
            if self.walls.is_none_or(|walls| walls.contains(cell)) {
                by_cell.entry(cell.to_array()).or_default().push(p - cell.as_dvec3());
            }
        }
        by_cell
    }

    /// Computes the field in f64.
    pub fn real(&self, particles: &[[f64; 3]]) -> Dense<f64> {
        let by_cell = self.particles_by_cell(particles);
        let cells = self.cells(particles);
        let theta = Dense::new(cells, |cell| {
            let Some(offsets) = by_cell.get(&cell.to_array()) else { return 0.0 };
            let n = offsets.len() as f64;
            match self.indicator {
                Indicator::Counting(_) => n.min(self.mu0()) / self.mu0(),
                Indicator::Symmetry => {
                    let centroid = offsets.iter().sum::<DVec3>() / n;
                    1.0 - 2.0 * (centroid - 0.5).length() / 3f64.sqrt()
                }
                Indicator::Cloud => unreachable!("`distances.rs` is the oracle of clouds"),
            }
        });
        let blur = |field: &Dense<f64>, half: &[f64]| {
            (0..3).fold(field.clone(), |field, axis| {
                Dense::new(field.cells, |cell| {
                    let tap = |k: i32| {
                        half[k.unsigned_abs() as usize]
                            * field.along(cell, (k, axis), self.walls.map(Mirrors::of))
                    };
                    let reach = half.len() as i32 - 1;
                    (-reach..=reach).map(tap).sum()
                })
            })
        };
        let mut smooth = blur(&theta, &gaussian(self.sigma));
        if let Indicator::Counting(_) = self.indicator {
            smooth = blur(&smooth, &[1.0 / 3.0; 2]);
        }
        let c = self.iso / 65535.0;
        let [theta, smooth] = [&theta, &smooth].map(|field| |cell| field.at(cell, None));
        let dense = |value: &dyn Fn(IVec3) -> f64| Dense::new(cells, value);
        match self.detail {
            Detail::Smoothed => dense(&smooth),
            Detail::Recovered => {
                let lost = dense(&|cell| if smooth(cell) <= c { theta(cell) } else { 0.0 });
                let details = blur(&lost, &gaussian(self.sigma / 2.0));
                dense(&|cell| smooth(cell).max(details.at(cell, None)))
            }
        }
    }

    /// Computes the field in the library's integers: offsets have 13 bits, and theta has 16 bits.
    pub fn integer(&self, particles: &[[f64; 3]]) -> Dense<u16> {
        let by_cell = self.particles_by_cell(particles);
        let cells = self.cells(particles);
        let theta = Dense::new(cells, |cell| {
            let Some(offsets) = by_cell.get(&cell.to_array()) else { return 0 };
            let n = offsets.len() as i128;
            match self.indicator {
                Indicator::Cloud => unreachable!("`distances.rs` is the oracle of clouds"),
                Indicator::Counting(_) => {
                    (((n as f64).min(self.mu0()) / self.mu0()) * 65535.0).round() as u16
                }
                Indicator::Symmetry => {
                    let mut square = 0;
                    for axis in 0..3 {
                        let sum: i128 =
                            offsets.iter().map(|o| (o[axis] * 8192.0).floor() as i128).sum();
                        let distance = (2 * sum + n - n * 8192).abs();
                        let quarter_steps = (8 * distance + n) / (2 * n);
                        square += quarter_steps * quarter_steps;
                    }
                    let floor = square.isqrt();
                    let root = if square - floor * floor > floor { floor + 1 } else { floor };
                    (65535 - (root * 37837 + (1 << 14)) / (1 << 15)) as u16
                }
            }
        });
        let blur = |field: &Dense<u16>, half: &[u64]| {
            (0..3).fold(field.clone(), |field, axis| {
                Dense::new(field.cells, |cell| {
                    let tap = |k: i32| {
                        half[k.unsigned_abs() as usize]
                            * u64::from(field.along(cell, (k, axis), self.walls.map(Mirrors::of)))
                    };
                    let reach = half.len() as i32 - 1;
                    (((-reach..=reach).map(tap).sum::<u64>() + 32768) / 65536) as u16
                })
            })
        };
        let mut smooth = blur(&theta, &integer_weights(&gaussian(self.sigma)));
        if let Indicator::Counting(_) = self.indicator {
            smooth = blur(&smooth, &[21846, 21845]);
        }
        let t = self.iso.floor() as u64;
        let [theta, smooth] = [&theta, &smooth].map(|field| |cell| field.at(cell, None));
        let dense = |value: &dyn Fn(IVec3) -> u16| Dense::new(cells, value);
        match self.detail {
            Detail::Smoothed => dense(&smooth),
            Detail::Recovered => {
                let lost =
                    dense(&|cell| if u64::from(smooth(cell)) <= t { theta(cell) } else { 0 });
                let details = blur(&lost, &integer_weights(&gaussian(self.sigma / 2.0)));
                dense(&|cell| smooth(cell).max(details.at(cell, None)))
            }
        }
    }
}

/// A key that sorts cells in mesh order. The order follows the Morton curve through tiles of 4^3
/// cells. Within a tile, x varies fastest, and z slowest.
fn order_of(cell: IVec3) -> (u64, i32) {
    let tile = (cell.div_euclid(IVec3::splat(4)) + (1 << 20)).to_array();
    let mut morton = 0;
    for bit in 0..21 {
        for (axis, coordinate) in tile.iter().enumerate() {
            morton |= ((*coordinate as u64 >> bit) & 1) << (3 * bit + axis);
        }
    }
    let local = cell.rem_euclid(IVec3::splat(4));
    (morton, local.x + 4 * local.y + 16 * local.z)
}

/// Meshes a dense field by marching cubes. The isovalue `c` is in the field's unit.
pub fn mesh(field: &Dense<f64>, c: f64, walls: Option<CellBox>) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    // Beyond the box, all cells are outside, because the box ends at walls or the field is 0 there.
    let inside = |cell: IVec3| field.cells.contains(cell) && field.at(cell, None) > c;
    let dual = Dense::<u8>::new(field.cells.grown(1, 0), |_| 0)
        .iter()
        .map(|(cell, _)| cell)
        .collect::<Vec<_>>();

    let mut vertices = BTreeMap::new();
    for &cell in &dual {
        for axis in 0..3 {
            let next = cell + IVec3::AXES[axis];
            if inside(cell) != inside(next) {
                let mut position = cell.as_dvec3() + 0.5;
                let phi = |cell| c - field.at(cell, None);
                let ghost = walls.is_some_and(|w| !w.contains(cell) || !w.contains(next));
                position[axis] += if ghost { 0.5 } else { phi(cell) / (phi(cell) - phi(next)) };
                let (tile, local) = order_of(cell);
                vertices.insert((tile, axis, local), position.to_array());
            }
        }
    }
    let number: BTreeMap<_, u32> = vertices.keys().zip(0..).map(|(&key, i)| (key, i)).collect();

    let mut cells: Vec<IVec3> = dual;
    cells.sort_by_key(|&cell| order_of(cell));
    let mut triangles = Vec::new();
    for cell in cells {
        let case: usize = (0..8_i32)
            .map(|k| usize::from(inside(cell + IVec3::new(k & 1, k >> 1 & 1, k >> 2))) << k)
            .sum();
        for triangle in &TABLE[case] {
            triangles.push(triangle.map(|edge| {
                let (tile, local) = order_of(cell + edge.offset());
                number[&(tile, usize::from(edge.axis), local)]
            }));
        }
    }
    (vertices.into_values().collect(), triangles)
}
