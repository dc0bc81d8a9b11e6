//! Periodic boxes: beyond a face, the fluid continues as it does inside the opposite face.
//!
//! A particle near a face also has an image beyond the opposite face, a whole number of fixed-point
//! steps away. A filter that reaches beyond a face therefore finds the same particles as in an
//! infinitely repeated fluid. The edges of a box may have different lengths, and need not be whole
//! numbers of cells long.
//!
//! Simulations usually wrap coordinates into the box only from time to time, for example whenever
//! they build lists of neighbours. Their files can contain particles that have left the box since
//! the last wrap. A particle slightly outside the box is therefore wrapped: it moves by one period.
//! A particle far outside shows that the box is wrong.

use glam::{DVec3, IVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::units::shown;
use super::{BIN, CELL_LIMIT, CellBox, Domain, FRACTIONS, Grid};

/// The names of the axes.
const AXES: [char; 3] = ['x', 'y', 'z'];

/// A box that repeats along some axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Periodic {
    /// Faces of the box; an open axis has none.
    faces: Domain,
    /// The maximum distance of images from the faces, in cells.
    reach: i32,
    /// The length of the box along each axis, in fixed-point steps; 0 for an axis that is not
    /// periodic.
    period: [i64; 3],
    /// The maximum distance of images from the faces, in the particles' unit of length.
    reach_length: f64,
}

/// A particle's position between the faces of a periodic box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct InBox {
    /// The position.
    pub position: [f64; 3],
    /// Whether the particle was wrapped: it was outside the box, by more than a rounding error.
    pub wrapped: bool,
}

/// How a mesh ends at periodic faces.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum PeriodicMesh {
    /// The mesh ends on the faces, and is closed there as at the walls of a tank.
    #[default]
    Cut,
    /// The mesh extends beyond the faces (by about 12 spacings with default settings), so adjacent
    /// copies overlap.
    Overlap,
}

impl PeriodicMesh {
    /// The name of the setting's value.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Cut => "cut",
            Self::Overlap => "overlap",
        }
    }
}

/// A box that cannot be periodic.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum PeriodicError {
    /// The corners are not in order, or not finite.
    #[error(
        "invalid periodic box: every coordinate must be finite, and along a periodic axis, the \
         second face must have the larger coordinate"
    )]
    Corners,
    /// No axis is periodic.
    #[error(
        "the box is not periodic along any axis; give the coordinates of both ends of at least one \
         axis"
    )]
    Open,
    /// The domain has walls along a periodic axis.
    #[error(
        "the domain has a wall at an end of axis {axis}, but {axis} is periodic; leave both {axis} \
         sides of the domain open"
    )]
    Walled {
        /// The axis: x, y or z.
        axis: char,
    },
    /// The box is so narrow that a filter could reach a particle and its image at the same time.
    #[error(
        "the periodic box is {} wide along {axis}, but must be at least {} wide, which is twice \
         the reach of the filters; use a smaller cell size or less smoothing, or make {axis} \
         non-periodic",
        shown(*width), shown(2.0 * *reach)
    )]
    Narrow {
        /// The axis: x, y or z.
        axis: char,
        /// The distance from face to face.
        width: f64,
        /// The distance beyond a face within which particles affect the surface inside the box.
        reach: f64,
    },
    /// The box, extended by the reach of the filters, ends too far from the grid's origin.
    #[error(
        "the periodic box, extended by the reach of the filters, ends more than {CELL_LIMIT} cells \
         from the origin; use a larger cell size"
    )]
    TooFar,
}

impl Periodic {
    /// The box between `faces` on `grid`. The faces are in world coordinates; `None` makes an axis
    /// open. Images exist up to `reach` cells beyond the faces.
    ///
    /// # Errors
    /// [`PeriodicError`] if the faces are not valid, closer together than twice the reach, or too
    /// far from the grid's origin.
    pub fn new(
        grid: &Grid,
        faces: [Option<[f64; 2]>; 3],
        reach: i32,
    ) -> Result<Self, PeriodicError> {
        Self::check(faces)?;
        let [lo, hi] = [0, 1].map(|side: usize| {
            let open = [f64::NEG_INFINITY, f64::INFINITY][side];
            DVec3::from(faces.map(|faces| faces.map_or(open, |faces| faces[side])))
        });
        let reach_length = f64::from(reach) * grid.cell_size();
        for axis in 0..3 {
            let width = hi[axis] - lo[axis];
            if width < 2.0 * reach_length {
                return Err(PeriodicError::Narrow { axis: AXES[axis], width, reach: reach_length });
            }
        }
        let images = Domain::new(grid, lo - reach_length, hi + reach_length);
        let (Ok(faces), Ok(_)) = (Domain::new(grid, lo, hi), images) else {
            return Err(PeriodicError::TooFar);
        };
        let steps = |width: f64| (width / grid.cell_size() * f64::from(FRACTIONS)).round() as i64;
        let period =
            (hi - lo).to_array().map(|width| if width.is_finite() { steps(width) } else { 0 });
        Ok(Self { faces, reach, period, reach_length })
    }

    /// Converts the box to a grid with cells 2^`octaves` times as wide. The coordinates of the
    /// faces stay exact. The cells between the faces, the reach in cells and the period in steps
    /// are rounded.
    #[must_use]
    pub fn in_wider_cells(self, octaves: u32) -> Self {
        let Self { faces, reach, period, reach_length } = self;
        Self {
            faces: faces.in_wider_cells(octaves),
            reach: reach >> octaves,
            period: period.map(|steps| steps >> octaves),
            reach_length,
        }
    }

    /// Checks the faces as far as possible without a cell size.
    ///
    /// # Errors
    /// [`PeriodicError::Corners`] if faces are not finite or not in order, [`PeriodicError::Open`]
    /// if no axis is periodic.
    pub fn check(faces: [Option<[f64; 2]>; 3]) -> Result<(), PeriodicError> {
        if faces.iter().flatten().any(|&[lo, hi]| !(lo.is_finite() && hi.is_finite() && lo < hi)) {
            return Err(PeriodicError::Corners);
        }
        if faces.iter().all(Option::is_none) { Err(PeriodicError::Open) } else { Ok(()) }
    }

    /// Returns an error if there are walls along a periodic axis.
    ///
    /// # Errors
    /// [`PeriodicError::Walled`].
    pub fn check_walls(
        faces: [Option<[f64; 2]>; 3],
        walls: [DVec3; 2],
    ) -> Result<(), PeriodicError> {
        let is_walled = |a: usize| walls.iter().any(|corner| corner[a].is_finite());
        match (0..3).find(|&axis| faces[axis].is_some() && is_walled(axis)) {
            Some(axis) => Err(PeriodicError::Walled { axis: AXES[axis] }),
            None => Ok(()),
        }
    }

    /// The faces along each axis, in world coordinates; `None` for an open axis.
    #[must_use]
    pub fn faces(&self) -> [Option<[f64; 2]>; 3] {
        let [lo, hi] = self.faces.walls();
        [0, 1, 2].map(|axis| lo[axis].is_finite().then(|| [lo[axis], hi[axis]]))
    }

    /// The maximum distance of images from the faces, in cells.
    #[must_use]
    pub fn reach(&self) -> i32 {
        self.reach
    }

    /// The cells whose centre lies between the faces; along an open axis, all cells.
    #[must_use]
    pub fn cells(&self) -> CellBox {
        self.faces.cells()
    }

    /// The periodic box on another grid.
    ///
    /// # Errors
    /// The errors of [`new`](Self::new).
    pub fn on(&self, grid: &Grid) -> Result<Self, PeriodicError> {
        Self::new(grid, self.faces(), self.reach)
    }

    /// The walls at which the mesh of a fluid within `walls` ends.
    #[must_use]
    pub fn mesh_walls(&self, walls: Option<Domain>, mesh: PeriodicMesh) -> Option<Domain> {
        match (mesh, walls) {
            (PeriodicMesh::Overlap, walls) => walls,
            (PeriodicMesh::Cut, None) => Some(self.faces),
            (PeriodicMesh::Cut, Some(walls)) => Some(self.faces.joined(&walls)),
        }
    }

    /// Returns the position of a particle between the faces. A coordinate on the upper face moves
    /// to the lower face. A coordinate outside the box also moves to the lower face if it equals a
    /// face after both are rounded to f32. Any other coordinate that is at most `farthest` outside
    /// the box moves by one period. If a finite coordinate is farther outside, `Err` names its
    /// axis. Coordinates that are not finite are returned unchanged.
    ///
    /// `farthest` must be less than the width of the box.
    pub(crate) fn inside(&self, world: [f64; 3], farthest: f64) -> Result<InBox, char> {
        let [lo, hi] = self.faces.walls();
        let mut inside = InBox { position: world, wrapped: false };
        for axis in 0..3 {
            let (x, lo, hi) = (world[axis], lo[axis], hi[axis]);
            let is_on = |face: f64| x == face || x as f32 == face as f32;
            if (lo..hi).contains(&x) || !x.is_finite() {
                continue;
            }
            inside.position[axis] = if is_on(hi) || is_on(lo) {
                lo
            } else if (lo - x).max(x - hi) <= farthest {
                inside.wrapped = true;
                let moved = if x < lo { x + (hi - lo) } else { x - (hi - lo) };
                // Rounding can move a coordinate onto the upper face or below the lower face.
                if (lo..hi).contains(&moved) { moved } else { lo }
            } else {
                return Err(AXES[axis]);
            };
        }
        Ok(inside)
    }

    /// Boxes of bins that together contain all particles whose original positions are in `bins`,
    /// and all images of these particles.
    pub fn with_images(&self, bins: CellBox) -> impl Iterator<Item = CellBox> + use<> {
        let (period, edge) = (self.period, i64::from(BIN) * i64::from(FRACTIONS));
        let sides = move |axis: usize| if period[axis] == 0 { 0..=0 } else { -1..=1 };
        let sides = sides(2)
            .flat_map(move |z| sides(1).flat_map(move |y| sides(0).map(move |x| [x, y, z])));
        // `inside` may move a particle: to the lower face if its rounded coordinate equals a face,
        // or by one period if it is outside the box. A period is not a whole number of steps, so
        // the bin along a periodic axis may differ by one from the bin of the original position,
        // shifted by whole periods.
        let margin = IVec3::from(period.map(|period| i32::from(period != 0)));
        let cells = self.cells().grown(self.reach + 1, self.reach + 1);
        let reached = CellBox {
            lo: cells.lo.div_euclid(IVec3::splat(BIN)),
            hi: cells.hi.div_euclid(IVec3::splat(BIN)) + 1,
        };
        sides.map(move |sides| {
            let moved = |corner: IVec3| {
                [0, 1, 2].map(|a| i64::from(corner[a]) * edge + sides[a] * period[a])
            };
            let lo = moved(bins.lo).map(|step| step.div_euclid(edge) as i32);
            let hi = moved(bins.hi).map(|step| (step + edge - 1).div_euclid(edge) as i32);
            CellBox { lo: IVec3::from(lo) - margin, hi: IVec3::from(hi) + margin }
                .intersection(&reached)
        })
    }

    /// Whether a particle is beyond the faces, or close enough to a face to have images.
    #[must_use]
    pub fn is_near_face(&self, world: [f64; 3]) -> bool {
        let [lo, hi] = self.faces.walls();
        let is_far = |a: usize| {
            world[a] >= lo[a] + self.reach_length && world[a] < hi[a] - self.reach_length
        };
        !(0..3).all(is_far)
    }

    /// The images of a particle between the faces: none, one, three or seven. `steps` is the
    /// particle's position in fixed-point steps on `grid`.
    pub fn images(
        &self,
        grid: &Grid,
        world: [f64; 3],
        steps: [i64; 3],
    ) -> impl Iterator<Item = [f64; 3]> + use<> {
        let [lo, hi] = self.faces.walls();
        let image: [Option<f64>; 3] = [0, 1, 2].map(|axis| {
            let shift = if world[axis] < lo[axis] + self.reach_length {
                self.period[axis]
            } else if world[axis] >= hi[axis] - self.reach_length {
                -self.period[axis]
            } else {
                return None;
            };
            // `cells` is in the middle of a step, so that rounding does not change the step.
            let cells = ((steps[axis] + shift) as f64 + 0.5) / f64::from(FRACTIONS);
            Some(grid.origin()[axis] + grid.cell_size() * cells)
        });
        let moved = image
            .iter()
            .zip(0..)
            .fold(0_u32, |moved, (x, axis)| moved | u32::from(x.is_some()) << axis);
        (1..8_u32).filter(move |some| some & !moved == 0).map(move |some| {
            let along = |axis: usize| if some >> axis & 1 == 1 { image[axis] } else { None };
            [0, 1, 2].map(|axis| along(axis).unwrap_or(world[axis]))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit_box(grid: &Grid) -> Periodic {
        Periodic::new(grid, [Some([0.0, 1.1]), None, Some([-2.0, 1.0])], 2).unwrap()
    }

    #[test]
    fn images_are_whole_periods_away_and_a_corner_has_seven() {
        let grid = Grid::new(DVec3::new(0.3, -7.0, 1e-3), 0.037).unwrap();
        let cube = Periodic::new(&grid, [Some([0.0, 1.1]); 3], 2).unwrap();
        let images =
            |of: [f64; 3]| cube.images(&grid, of, grid.place(of).unwrap()).collect::<Vec<_>>();
        assert_eq!(images([0.5, 0.5, 0.5]).len(), 0);
        assert_eq!(images([0.05, 0.5, 0.5]).len(), 1);
        assert_eq!(images([0.05, 1.05, 0.5]).len(), 3);
        assert_eq!(images([0.05, 1.05, 0.01]).len(), 7);
        let period = (1.1_f64 / 0.037 * 8192.0).round() as i64;
        for i in 0..1000 {
            let at = [f64::from(i) / 14_000.0, 0.5, 0.5];
            let steps = grid.place(at).unwrap();
            let [image] = images(at)[..] else { panic!("one image of {at:?}") };
            assert_eq!(grid.place(image), Ok([steps[0] + period, steps[1], steps[2]]));
        }
    }

    #[test]
    fn the_upper_face_maps_to_the_lower_one_despite_single_precision() {
        let grid = Grid::new(DVec3::ZERO, 0.037).unwrap();
        let periodic = unit_box(&grid);
        let inside = |world| periodic.inside(world, 0.0);
        let unwrapped = |position| Ok(InBox { position, wrapped: false });
        assert_eq!(inside([1.1, 5.0, 1.0]), unwrapped([0.0, 5.0, -2.0]));
        assert_eq!(inside([f64::from(1.1_f32), 5.0, 0.0]), unwrapped([0.0, 5.0, 0.0]), "above 1.1");
        assert_eq!(inside([1.100_001, 5.0, 0.0]), Err('x'));
        assert_eq!(inside([-1e-9, 5.0, 0.0]), Err('x'));
        assert_eq!(inside([0.5, 1e300, -2.001]), Err('z'), "y is open");
    }

    #[test]
    fn particles_slightly_outside_are_wrapped_and_stay_in_the_box() {
        let grid = Grid::new(DVec3::ZERO, 0.037).unwrap();
        let periodic = unit_box(&grid);
        let inside = |world| periodic.inside(world, 0.0625);
        let wrapped = |position| Ok(InBox { position, wrapped: true });
        assert_eq!(inside([0.5, 5.0, 1.0625]), wrapped([0.5, 5.0, -1.9375]));
        assert_eq!(inside([0.5, 5.0, -2.0625]), wrapped([0.5, 5.0, 0.9375]));
        assert_eq!(inside([1.15, 5.0, -2.01]), wrapped([1.15 - 1.1, 5.0, -2.01 + 3.0]));
        assert_eq!(inside([0.5, 5.0, 1.0626]), Err('z'));
        assert_eq!(inside([-0.0626, 5.0, 1.03]), Err('x'));
        assert_eq!(inside([f64::INFINITY, 5.0, 0.0]).unwrap().position[0], f64::INFINITY);
        // The sum of this coordinate and the period is rounded to the upper face.
        assert_eq!(inside([-1e-30, 5.0, 0.0]), wrapped([0.0, 5.0, 0.0]));
    }

    #[test]
    fn boxes_with_images_contain_the_particles_and_all_their_images() {
        let (x, z) = ([0.7, 24.8], [-21.7, 1.3]);
        // Bins of the second grid begin on a face that is rounded down in single precision.
        for origin in [DVec3::new(0.3, -7.0, 1e-3), DVec3::new(0.7, 0.0, 1.3)] {
            let grid = Grid::new(origin, 0.037).unwrap();
            let periodic = Periodic::new(&grid, [Some(x), None, Some(z)], 40).unwrap();
            let bin = |at: [f64; 3]| {
                let edge = i64::from(BIN) * i64::from(FRACTIONS);
                IVec3::from(grid.place(at).unwrap().map(|step| step.div_euclid(edge) as i32))
            };
            let mut images = 0;
            for i in 0..5000 {
                let share = |k: i32| f64::from(i * k % 4999) / 4999.0;
                let along = |[lo, hi]: [f64; 2], k: i32| match i * k % 11 {
                    0 => f64::from(lo as f32),
                    1 => f64::from(hi as f32),
                    2 => lo - share(5),
                    3 => hi + share(5),
                    _ => lo + share(k) * (hi - lo),
                };
                let original = [along(x, 7), 30.0 * share(13), along(z, 17)];
                let around: Vec<CellBox> =
                    periodic.with_images(CellBox::cube(bin(original), 1)).collect();
                assert_eq!(around.len(), 9, "y is open");
                let inside = periodic.inside(original, 1.0).unwrap().position;
                for at in
                    periodic.images(&grid, inside, grid.place(inside).unwrap()).chain([inside])
                {
                    assert!(
                        around.iter().any(|bins| bins.contains(bin(at))),
                        "{at:?} of {original:?}"
                    );
                    images += 1;
                }
            }
            assert!(images > 7000, "{images}");
        }
    }

    #[test]
    fn a_box_that_cannot_be_periodic_is_refused() {
        let grid = Grid::new(DVec3::ZERO, 0.1).unwrap();
        let new = |x, reach| Periodic::new(&grid, [x, None, None], reach);
        assert_eq!(new(None, 2), Err(PeriodicError::Open));
        for bad in [[1.0, 1.0], [1.0, 0.0], [0.0, f64::INFINITY], [f64::NAN, 1.0]] {
            assert_eq!(new(Some(bad), 2), Err(PeriodicError::Corners));
        }
        assert!(new(Some([0.0, 1.0]), 5).is_ok());
        assert!(matches!(new(Some([0.0, 1.0]), 6), Err(PeriodicError::Narrow { axis: 'x', .. })));
        assert_eq!(new(Some([0.0, 1e9]), 6), Err(PeriodicError::TooFar));
        let walls =
            [DVec3::splat(f64::NEG_INFINITY).with_x(0.0), DVec3::splat(f64::INFINITY).with_x(1.0)];
        let refused = Periodic::check_walls([Some([0.0, 1.0]), None, None], walls);
        assert_eq!(refused, Err(PeriodicError::Walled { axis: 'x' }));
        assert_eq!(Periodic::check_walls([None, Some([0.0, 1.0]), None], walls), Ok(()));
    }
}
