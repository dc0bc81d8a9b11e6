//! Walls of a tank, found as the planes at which the particles end.
//!
//! Each side is judged separately. A plane is put at the outermost particle, with columns two
//! spacings wide behind it. A column counts if it is full of particles from two to four spacings
//! behind the plane. The columns show a wall under four conditions: there are many of them, nearly
//! all have a particle close to the plane, the density directly behind the plane is about that of
//! full fluid, and the outermost particles of groups of columns lie in one plane. The last
//! condition excludes a free surface with waves. In one frame, a free surface that is level within
//! 0.15 spacings looks like a wall; with several frames, only planes that stay at the same place
//! are walls.
//!
//! The outermost layer of a lattice is half a spacing inside the wall; disordered particles reach
//! the wall. One formula covers both cases. Let n be the number of particles per squared spacing in
//! the outermost shell, and m their mean depth below the plane. If fluid of one particle per cubed
//! spacing ends at the wall, the mean position of these particles is n/2 spacings inside the wall.
//! This is true for whole layers and for disordered particles. The wall is therefore n/2 - m
//! spacings beyond the plane. Solvers push particles back at the wall, so particles pile up there,
//! more densely than in full fluid. A gap behind the outermost layer distinguishes a layer from
//! such a pile; without a gap, n is limited to its value in full fluid.
//!
//! If particles have several sizes, each particle counts with its volume, and the spacing at a side
//! is the size that occupies most of the area there. Particles much coarser than this spacing do
//! not count, so a column of such particles is not full.
//!
//! All sums over particles are integers, so the order of the particles and the threads do not
//! matter.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

use glam::DVec3;
use rayon::prelude::*;

use crate::grid::{Grid, Walls};
use crate::particles::sizes::{MOST_TIMES, SizeAttributes, Sizes};
use crate::particles::{Bounds, Particles, finite_chunks};

/// Edge of a column, in spacings.
const COLUMN: f64 = 2.0;
/// The range of depths, in spacings, in which a column must be full to count.
const BEHIND: [f64; 2] = [2.0, 4.0];
/// The minimum density of a full column in the range [`BEHIND`], relative to full fluid.
const FULL: f64 = 0.6;
/// A column ends at the plane if its first particle is at most this deep, in spacings. The limit is
/// raised by the median depth at which groups begin, but at most doubled.
const NEAR: f64 = 0.6;
/// At a wall, at least this share of the full columns ends at the plane.
const ENDING: f64 = 0.8;
/// The depth of the shell that locates the wall, in spacings.
const SHELL: f64 = 1.5;
/// The depths, in spacings, of the gap behind the outermost layer of a lattice. Even with a jitter
/// of 0.3 spacings, there is such a gap.
const GAP: std::ops::Range<f64> = 0.5..0.9;
/// The maximum density in such a gap, in particles per cubed spacing.
const IN_GAP: f64 = 0.7;
/// The accepted densities of the fluid next to a wall, in particles per cubed spacing.
const DENSITY: std::ops::Range<f64> = 0.5..2.0;
/// Edge of a group, in columns.
const GROUP: u64 = 4;
/// Number of columns in a group.
const GROUP_COLUMNS: usize = (GROUP * GROUP) as usize;
/// The maximum number of examined groups per side; a larger side is sampled evenly.
const MOST_GROUPS: u64 = 2048;
/// The maximum difference, in spacings, between the depth at which a group's particles begin and
/// the median of these depths over all groups.
const LEVEL: f64 = 0.15;
/// At a wall, at least this share of the groups is within [`LEVEL`] of the median.
const LEVEL_SHARE: f64 = 0.85;
/// The maximum distance, in spacings, of the wall from the outermost particle.
const FARTHEST: f64 = 0.75;
/// The maximum distance, in spacings, between walls of several frames that count as the same wall.
/// It is also the maximum distance of particles beyond a wall for which the wall is moved.
const SAME_WALL_DISTANCE: f64 = 0.5;
/// The maximum distance, in spacings, by which a scene's wall may lie beyond the plane at which the
/// fluid ends. Within this distance, the wall is moved to the plane.
const MAX_GAP_TO_PLANE: f64 = 2.0;
/// The maximum distance, in spacings, by which a scene's wall may lie beyond the end of fluid that
/// is too shallow or too uneven to show a plane. Within this distance, the wall is moved to the end
/// of the fluid. Solvers keep fluid up to a spacing away from walls; farther away, such fluid may
/// have a free surface.
const MAX_GAP_TO_SHALLOW_FLUID: f64 = 1.1;
/// The minimum number of particles per squared spacing in the shell of a column whose fluid touches
/// a side.
const TOUCHING: f64 = 0.5;
/// The minimum number of columns that show where shallow fluid ends. The end of shallow fluid is
/// used only if a scene has a wall near it.
const FEWEST_TOUCHING: usize = 8;
/// The maximum volume, in cubed spacings, of the particles in a shell that holds only stray drops.
const FEW: f64 = 32.0;
/// Number of fixed-point steps of a depth per spacing.
const STEPS: f64 = 1024.0;
/// Number of fixed-point steps of a volume per cubed spacing. The smallest possible particle has 16
/// steps.
const VOLUME_STEPS: f64 = 16.0 * MOST_TIMES * MOST_TIMES * MOST_TIMES;
/// Number of classes of sizes: two for each factor of two, up to a factor of [`MOST_TIMES`].
const CLASSES: usize = 13;
/// The weight of the area of each class of sizes, relative to the weight of the next finer class.
const FINER: f64 = 0.84;
/// The maximum size, in spacings, of particles that count at a side. This limit is larger than
/// nearly all particles in the class that gives the spacing.
const LARGEST: f64 = 1.3;

/// The evidence of one frame about a side of the box around the particles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BoxSide {
    /// Too little fluid is behind this side, or the end of the fluid is not level enough.
    Unclear,
    /// Almost no particles are at this side.
    Stray,
    /// Too few columns end near the plane, or the density behind the plane is not that of fluid.
    Ragged,
    /// A plane, with a wall at this coordinate.
    Plane(f64),
}

/// The ends of the particles of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Ends {
    /// The least and the greatest coordinate along each axis.
    reach: [[f64; 2]; 3],
    sides: [[BoxSide; 2]; 3],
    /// For each side, the coordinate of the wall, assuming that the fluid touches a wall there.
    /// Unlike a plane, shallow or uneven fluid does not show whether there is a wall. `None` if too
    /// little fluid is near the outermost particle.
    touched: [[Option<f64>; 2]; 3],
    /// The spacing, which is the smallest size if there are several.
    spacing: f64,
    /// The spacing at each side.
    spacings: [[f64; 2]; 3],
    /// The axis perpendicular to the plane, if all particles lie in a plane.
    flat: Option<usize>,
}

/// Particles beyond a wall that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeyondWall {
    /// x, y or z.
    pub axis: char,
    /// The coordinate of the wall.
    pub wall: f64,
    /// The coordinate that particles reach.
    pub reach: f64,
    /// The new coordinate of the wall; `None` if the side is open instead.
    pub moved: Option<f64>,
}

/// A gap between a wall and the plane at which the particles end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GapAtWall {
    /// x, y or z.
    pub axis: char,
    /// The coordinate of the wall.
    pub wall: f64,
    /// The coordinate of the plane at which the fluid ends.
    pub end: f64,
}

/// Counts of the particles in a column near a side.
struct ColumnCounts {
    /// The minimum depth, in steps.
    nearest: AtomicU32,
    /// Volume of the particles in the shell, in steps.
    shell: AtomicU64,
    /// Volume of the particles at the depths of a lattice's gap, in steps.
    in_gap: AtomicU64,
    /// Volume, in steps, of the particles at the depths [`BEHIND`], where a column must be full to
    /// count.
    behind: AtomicU64,
    /// The sum of depth times volume over the shell's particles, with both in steps.
    depths: AtomicU64,
}

/// The columns behind one side.
struct SideColumns {
    axis: usize,
    /// 1 for the upper side, and 0 for the lower side.
    end: usize,
    /// The coordinate of the outermost particle.
    at: f64,
    /// The spacing at this side.
    spacing: f64,
    /// 1 over the spacing.
    per_spacing: f64,
    /// Every `stride`-th group is examined, along both axes of the side.
    stride: u64,
    /// Number of examined groups in a row.
    row: u64,
    columns: Vec<ColumnCounts>,
    /// The area of a column, in squared spacings.
    area: f64,
}

impl Ends {
    /// Examines the ends of the particles that the grid can hold. Returns `None` if the grid can
    /// hold none of the particles. If all particles lie in a plane, `flat` is the axis
    /// perpendicular to the plane. The particles have no ends along this axis. Sizes whose
    /// attribute does not exist are ignored.
    ///
    /// The particles are read once, once more if their bounds are not known, and once more if they
    /// have several sizes. Memory use is about eight megabytes at most.
    #[must_use]
    pub fn of(
        particles: &dyn Particles,
        known: Option<Bounds>,
        (spacing, sizes): (f64, Option<&Sizes>),
        flat: Option<usize>,
        grid: &Grid,
    ) -> Option<Self> {
        let is_on_grid = |position: [f64; 3]| grid.place(position).is_ok();
        let are_on_grid = |bounds: &Bounds| {
            [bounds.lo, bounds.hi].iter().all(|&corner| is_on_grid(corner.into()))
        };
        let bounds = known.filter(are_on_grid).or_else(|| bounds_on_grid(particles, grid))?;
        let own = sizes.and_then(|sizes| {
            Some(OwnSizes { sizes, columns: sizes.columns(particles.attributes()).ok()? })
        });
        let spacings = match &own {
            Some(own) => own.spacings(particles, &bounds, grid),
            None => [[spacing; 2]; 3],
        };
        let axes = (0..3).filter(|axis| flat != Some(*axis));
        let side = |axis: usize, end: usize| {
            SideColumns::of(axis, end, &bounds, spacings[axis][end], flat)
        };
        let sides: Vec<SideColumns> =
            axes.flat_map(|axis| [0, 1].map(|end| side(axis, end))).collect();
        let lo = bounds.lo;
        let count = |position: [f64; 3], size: f64| {
            // Most particles are far from all sides, so the depth is tested first.
            if sides.iter().any(|side| side.depth(position) < BEHIND[1]) && is_on_grid(position) {
                sides.iter().for_each(|side| side.add(position, size, lo));
            }
        };
        match &own {
            Some(own) => own.sizes.finite_chunks(particles, &own.columns).for_each(|chunk| {
                chunk.into_iter().for_each(|(position, size)| count(position, size));
            }),
            None => finite_chunks(particles)
                .for_each(|chunk| chunk.into_iter().for_each(|position| count(position, spacing))),
        }
        let mut ends = Self {
            reach: [0, 1, 2].map(|axis| [bounds.lo[axis], bounds.hi[axis]]),
            sides: [[BoxSide::Unclear; 2]; 3],
            touched: [[None; 2]; 3],
            spacing,
            spacings,
            flat,
        };
        for side in sides {
            ends.sides[side.axis][side.end] = side.judged();
            ends.touched[side.axis][side.end] = side.touched();
        }
        Some(ends)
    }
}

/// The sizes of particles, and the attributes from which they are computed.
struct OwnSizes<'a> {
    sizes: &'a Sizes,
    columns: SizeAttributes,
}

/// For each side and each class of sizes, the area and the volume of the particles there, in
/// 1024ths of the area and the volume of the smallest particle.
type Classes = [[[[u64; 2]; CLASSES]; 2]; 3];

impl OwnSizes<'_> {
    /// The spacing at each side: the mean size in the class with the greatest area there. The area
    /// of smaller particles counts for more, because they show a wall more precisely.
    fn spacings(&self, particles: &dyn Particles, bounds: &Bounds, grid: &Grid) -> [[f64; 2]; 3] {
        const PARTS: f64 = 1024.0;
        let finest = self.sizes.finest;
        let of_chunk = |chunk: Vec<([f64; 3], f64)>| {
            let mut all = Classes::default();
            for (position, size) in chunk {
                let times = (size / finest).max(1.0);
                let class = (2.0 * libm::log2(times)).round().min((CLASSES - 1) as f64) as usize;
                for (axis, end) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
                    let at = [bounds.lo, bounds.hi][end][axis];
                    if (at - position[axis]).abs() < size && grid.place(position).is_ok() {
                        let [area, volume] = &mut all[axis][end][class];
                        *area += (PARTS * times * times) as u64;
                        *volume += (PARTS * times * times * times) as u64;
                    }
                }
            }
            all
        };
        let chunks = self.sizes.finite_chunks(particles, &self.columns);
        let all = chunks.map(of_chunk).reduce(Classes::default, |mut all, more| {
            let sums = all.as_flattened_mut().as_flattened_mut().as_flattened_mut();
            let more = more.as_flattened().as_flattened().as_flattened();
            sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
            all
        });
        all.map(|ends| {
            ends.map(|classes| {
                let mut factor = 1.0;
                let (mut most, mut spacing) = (0.0, finest);
                for [area, volume] in classes.map(|sums| sums.map(|sum| sum as f64)) {
                    if area * factor > most {
                        (most, spacing) = (area * factor, finest * (volume / area));
                    }
                    factor *= FINER;
                }
                spacing
            })
        })
    }
}

impl SideColumns {
    fn of(axis: usize, end: usize, bounds: &Bounds, spacing: f64, flat: Option<usize>) -> Self {
        let at = [bounds.lo, bounds.hi][end][axis];
        let groups = |axis: usize| {
            let columns = (bounds.hi[axis] - bounds.lo[axis]) / (COLUMN * spacing);
            columns as u64 / GROUP + 1
        };
        let [u, v] = others(axis).map(groups);
        let mut stride = 1;
        while u.div_ceil(stride).saturating_mul(v.div_ceil(stride)) > MOST_GROUPS {
            stride *= 2;
        }
        let (row, rows) = (u.div_ceil(stride), v.div_ceil(stride));
        let columns = (0..row * rows * GROUP * GROUP).map(|_| ColumnCounts::new()).collect();
        let area = if flat.is_some() { COLUMN } else { COLUMN * COLUMN };
        Self { axis, end, at, spacing, per_spacing: 1.0 / spacing, stride, row, columns, area }
    }

    /// The depth of a particle below the outermost particle, in spacings.
    #[inline(always)]
    fn depth(&self, position: [f64; 3]) -> f64 {
        (self.at - position[self.axis]).abs() * self.per_spacing
    }

    /// Counts a particle.
    #[inline(always)]
    fn add(&self, position: [f64; 3], size: f64, lo: DVec3) {
        let depth = self.depth(position);
        if depth >= BEHIND[1] {
            return;
        }
        let place = |axis: usize| ((position[axis] - lo[axis]) * self.per_spacing / COLUMN) as u64;
        let [u, v] = others(self.axis).map(place);
        let [group_u, group_v] = [u / GROUP, v / GROUP];
        if group_u % self.stride != 0 || group_v % self.stride != 0 {
            return;
        }
        let group = group_v / self.stride * self.row + group_u / self.stride;
        let index = (group * GROUP + v % GROUP) * GROUP + u % GROUP;
        let Some(column) = self.columns.get(index as usize) else { return };
        let steps = (depth * STEPS) as u32;
        let times = size * self.per_spacing;
        let counted = if times < LARGEST { times * times * times } else { 0.0 };
        let volume = (VOLUME_STEPS * counted).round() as u64;
        column.nearest.fetch_min(steps, Relaxed);
        if depth < SHELL {
            column.shell.fetch_add(volume, Relaxed);
            column.depths.fetch_add(volume * u64::from(steps), Relaxed);
        }
        if GAP.contains(&depth) {
            column.in_gap.fetch_add(volume, Relaxed);
        }
        if depth >= BEHIND[0] {
            column.behind.fetch_add(volume, Relaxed);
        }
    }

    /// Whether the columns show a wall, and its position.
    fn judged(&self) -> BoxSide {
        /// The minimum number of full columns, in total and per group. The first pair is for
        /// particles that lie in a plane, where 12 columns are 24 spacings long. The second pair is
        /// for other particles, where 30 columns cover 120 squared spacings.
        const LEAST: [(usize, usize); 2] = [(12, 2), (30, 4)];
        let (least, least_of_group) = LEAST[usize::from(self.area > COLUMN)];
        let behind = FULL * self.area * (BEHIND[1] - BEHIND[0]);
        let is_full = |column: &&ColumnCounts| volume(&column.behind) >= behind;
        let full = self.columns.iter().filter(is_full).count();
        let mut groups: Vec<f64> = self
            .columns
            .chunks(GROUP_COLUMNS)
            .filter_map(|group| {
                let full: Vec<f64> =
                    group.iter().filter(is_full).map(ColumnCounts::nearest).collect();
                (full.len() >= least_of_group).then(|| full.into_iter().fold(f64::MAX, f64::min))
            })
            .collect();
        if full < least || groups.len() < 3 {
            let all = self.columns.iter().map(|column| volume(&column.shell)).sum::<f64>();
            let is_stray = all * (self.stride as f64).powi(2) <= FEW;
            return if is_stray { BoxSide::Stray } else { BoxSide::Unclear };
        }
        groups.sort_unstable_by(f64::total_cmp);
        let median = groups[groups.len() / 2];
        // A few particles may lie in front of the others, because solvers let some particles pass
        // through walls.
        let end = median.min(NEAR) + NEAR;
        let ending = self.columns.iter().filter(is_full).filter(|c| c.nearest() < end).count();
        let level = groups.iter().filter(|&&depth| (depth - median).abs() <= LEVEL).count();
        let shell = Shell::of(self.columns.iter().filter(is_full), self.area);
        if (ending as f64) < ENDING * full as f64 || !DENSITY.contains(&(shell.per_area / SHELL)) {
            return BoxSide::Ragged;
        }
        if (level as f64) < LEVEL_SHARE * groups.len() as f64 {
            return BoxSide::Unclear;
        }
        BoxSide::Plane(self.wall(&shell))
    }

    /// The coordinate of the wall, assuming that the fluid touches a wall at this side, however
    /// shallow the fluid is. `None` if too little fluid is near the outermost particle.
    fn touched(&self) -> Option<f64> {
        let touches = |column: &&ColumnCounts| {
            column.nearest() < NEAR && volume(&column.shell) >= TOUCHING * self.area
        };
        let columns = self.columns.iter().filter(touches);
        let is_enough = columns.clone().count() >= FEWEST_TOUCHING;
        is_enough.then(|| self.wall(&Shell::of(columns, self.area)))
    }

    /// The coordinate of the wall that the fluid of a shell touches.
    fn wall(&self, shell: &Shell) -> f64 {
        let per_area = if shell.has_gap { shell.per_area } else { shell.per_area.min(SHELL) };
        let beyond = (per_area / 2.0 - shell.mean_depth).clamp(0.0, FARTHEST);
        moved_outward(self.end, self.at, beyond * self.spacing)
    }
}

/// The particles in the outermost shell of some columns.
struct Shell {
    /// Volume of the particles per area, in spacings.
    per_area: f64,
    /// Mean depth of the particles, in spacings.
    mean_depth: f64,
    /// Whether there is a gap behind the outermost layer, as in a lattice.
    has_gap: bool,
}

impl Shell {
    /// Sums the counts of columns. Each column has the cross-section `area`.
    fn of<'a>(columns: impl Iterator<Item = &'a ColumnCounts>, area: f64) -> Self {
        let (mut count, mut shell, mut in_gap, mut depths) = (0_u32, 0.0, 0.0, 0.0);
        for column in columns {
            count += 1;
            shell += volume(&column.shell);
            in_gap += volume(&column.in_gap);
            depths += volume(&column.depths) / STEPS;
        }
        let area = f64::from(count) * area;
        Self {
            per_area: shell / area,
            mean_depth: if shell > 0.0 { depths / shell } else { 0.0 },
            has_gap: in_gap <= IN_GAP * area * (GAP.end - GAP.start),
        }
    }
}

/// Converts a volume from steps to cubed spacings.
fn volume(steps: &AtomicU64) -> f64 {
    steps.load(Relaxed) as f64 / VOLUME_STEPS
}

impl ColumnCounts {
    /// The minimum depth of a particle, in spacings.
    fn nearest(&self) -> f64 {
        f64::from(self.nearest.load(Relaxed)) / STEPS
    }

    fn new() -> Self {
        let [shell, in_gap, behind, depths] = [0; 4].map(AtomicU64::new);
        Self { nearest: AtomicU32::new(u32::MAX), shell, in_gap, behind, depths }
    }
}

/// Bounds of the particles that a grid can hold; `None` if it can hold none of the particles.
#[must_use]
pub fn bounds_on_grid(particles: &dyn Particles, grid: &Grid) -> Option<Bounds> {
    let is_on_grid = |position: [f64; 3]| grid.place(position).is_ok();
    let of_chunk = |chunk: Vec<[f64; 3]>| {
        let all = Bounds::of(&chunk);
        if is_on_grid(all.lo.into()) && is_on_grid(all.hi.into()) {
            return all;
        }
        let on_grid = chunk.into_iter().filter(|&position| is_on_grid(position));
        Bounds::of(&on_grid.collect::<Vec<_>>())
    };
    let bounds = finite_chunks(particles).map(of_chunk).reduce(|| Bounds::NONE, Bounds::joined);
    (bounds.finite > 0).then_some(bounds)
}

/// The two axes other than `axis`.
fn others(axis: usize) -> [usize; 2] {
    [[1, 2], [0, 2], [0, 1]][axis]
}

/// Moves a coordinate outwards by `by`, at the lower or the upper end of a box.
fn moved_outward(end: usize, at: f64, by: f64) -> f64 {
    if end == 0 { at - by } else { at + by }
}

/// The distance of the coordinate `at` beyond `of`, at the lower or the upper end of a box.
fn outside(end: usize, at: f64, of: f64) -> f64 {
    if end == 0 { of - at } else { at - of }
}

/// The coordinate that lies farther out, at the lower or the upper end of a box.
fn outermost(end: usize, a: f64, b: f64) -> f64 {
    if outside(end, b, a) > 0.0 { b } else { a }
}

/// Rounds a wall to a coordinate with few digits, which is easy to copy. This moves the wall
/// outwards by at most a thousandth of the spacing, and keeps particles up to `reach` inside.
fn rounded(end: usize, wall: f64, reach: f64, spacing: f64) -> f64 {
    let digits = (3.0 - libm::log10(spacing).floor()).clamp(0.0, 15.0) as usize;
    let step = 10_f64.powi(-(digits as i32));
    let short = |at: f64| format!("{at:.digits$}").parse().unwrap_or(wall);
    let candidates =
        [0.0, 1.0, 2.0].map(|steps: f64| short(moved_outward(end, wall, steps * step)));
    let is_outside = |at: &f64| outside(end, *at, wall) >= 0.0 && outside(end, *at, reach) >= 0.0;
    let of_few_digits = candidates.into_iter().find(is_outside).unwrap_or(wall);
    // Avoids a negative zero.
    if of_few_digits == 0.0 { 0.0 } else { of_few_digits }
}

/// The walls of a tank, according to all examined frames and to `scene`. `scene` contains the walls
/// of a scene or of the caller, if they are known.
///
/// With one frame, its planes are the walls. With several frames, a side has a wall under three
/// conditions: at least two frames, and at least a third of all frames, show a wall at the same
/// place; fewer frames have a ragged end at that place than show the wall; and no frame has more
/// than stray drops beyond the wall. The top is open unless a scene has a wall there. If `up` is
/// known, the top is the upper side of the axis `up`. Otherwise, the top is the upper side of y, if
/// both y and z have a wall at the upper side. Also returns whether the scene's walls fit the
/// particles.
pub fn common(frames: &[Ends], scene: Option<&Walls>, up: Option<usize>) -> (Walls, bool) {
    let fits = |scene: &&Walls| {
        let sides = (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]);
        let passed = sides.filter(|&(axis, end)| {
            let passes = |wall: f64| frames.iter().any(|frame| frame.passes(axis, end, wall));
            scene.0[axis][end].is_some_and(passes)
        });
        passed.count() <= 1
    };
    if let Some(scene) = scene.filter(fits) {
        let wall = |axis: usize, end: usize| {
            scene.0[axis][end].and_then(|wall| wall_near_scene(frames, (axis, end), wall))
        };
        let walls = Walls([0, 1, 2].map(|axis| [0, 1].map(|end| wall(axis, end))));
        return (walls, true);
    }
    // If `up` is not given, and only one of the axes y and z lies in the plane of two-dimensional
    // particles, that axis points up.
    let in_plane = frames.first().and_then(|frame| frame.flat);
    let up = up.or(in_plane.and_then(|flat| [None, Some(2), Some(1)][flat]));
    let mut walls = Walls([0, 1, 2].map(|axis| [0, 1].map(|end| common_wall(frames, axis, end))));
    match up {
        Some(axis) => walls.0[axis][1] = None,
        None if walls.0[1][1].is_some() && walls.0[2][1].is_some() => walls.0[1][1] = None,
        None => {}
    }
    (walls, false)
}

/// The wall at a side where a scene has `wall`. Solvers keep a distance from walls, so if the fluid
/// of any frame ends near `wall`, the result is the place where the fluid ends. If the fluid of
/// several frames ends near `wall`, the outermost of these places counts. If the fluid of no frame
/// ends near `wall`, the result is `wall`, or `None` if particles are far beyond `wall`.
fn wall_near_scene(frames: &[Ends], (axis, end): (usize, usize), wall: f64) -> Option<f64> {
    let spacing = spacing_at(frames, axis, end);
    let is_near = |at: &f64, most| {
        (-SAME_WALL_DISTANCE..=most).contains(&(outside(end, wall, *at) / spacing))
    };
    let plane = |frame: &Ends| frame.plane(axis, end).filter(|at| is_near(at, MAX_GAP_TO_PLANE));
    let touched =
        |frame: &Ends| frame.touched[axis][end].filter(|at| is_near(at, MAX_GAP_TO_SHALLOW_FLUID));
    let ends = frames.iter().filter_map(|frame| plane(frame).or_else(|| touched(frame)));
    match ends.reduce(|a, b| outermost(end, a, b)) {
        Some(at) => Some(rounded_for(frames, axis, end, at)),
        None if frames.iter().any(|frame| frame.passes(axis, end, wall)) => None,
        None => Some(wall),
    }
}

fn common_wall(frames: &[Ends], axis: usize, end: usize) -> Option<f64> {
    let needed = if frames.len() == 1 { 1 } else { frames.len().div_ceil(3).max(2) };
    let spacing = spacing_at(frames, axis, end);
    let mut planes: Vec<f64> = frames.iter().filter_map(|frame| frame.plane(axis, end)).collect();
    planes.sort_unstable_by(|a, b| outside(end, *b, *a).total_cmp(&0.0));
    // Only the outermost plane can be a wall, because particles lie beyond the other planes.
    let wall = planes.into_iter().next()?;
    let is_same = |at: f64| (at - wall).abs() <= SAME_WALL_DISTANCE * spacing;
    let (mut supporting, mut opposing) = (0, 0);
    for frame in frames {
        match frame.sides[axis][end] {
            BoxSide::Plane(at) if is_same(at) => supporting += 1,
            BoxSide::Stray => {}
            _ if frame.passes(axis, end, wall) => return None,
            BoxSide::Ragged if is_same(frame.reach[axis][end]) => opposing += 1,
            _ => {}
        }
    }
    (supporting >= needed && supporting > opposing).then(|| rounded_for(frames, axis, end, wall))
}

/// A wall with few digits that holds all particles of the frames, except particles that are far
/// beyond it.
fn rounded_for(frames: &[Ends], axis: usize, end: usize, wall: f64) -> f64 {
    let reached = frames.iter().map(|frame| (frame.reach[axis][end], frame.spacings[axis][end]));
    let holding =
        reached.filter(|&(at, spacing)| outside(end, at, wall) <= SAME_WALL_DISTANCE * spacing);
    let reach = holding.map(|(at, _)| at).fold(wall, |a, b| outermost(end, a, b));
    rounded(end, reach, reach, spacing_at(frames, axis, end))
}

/// The greatest spacing at a side, among the frames that end in a plane there or, if no frame does,
/// among all frames.
fn spacing_at(frames: &[Ends], axis: usize, end: usize) -> f64 {
    let greatest = |frames: &mut dyn Iterator<Item = &Ends>| {
        frames.map(|frame| frame.spacings[axis][end]).reduce(f64::max)
    };
    let mut planes = frames.iter().filter(|frame| frame.plane(axis, end).is_some());
    greatest(&mut planes).or_else(|| greatest(&mut frames.iter())).unwrap_or(1.0)
}

/// The spacing at each side; `None` if it is the particles' spacing everywhere.
pub fn spacings_at_sides(frames: &[Ends]) -> Option<[[f64; 2]; 3]> {
    let is_other = |frame: &Ends| frame.spacings.as_flattened().iter().any(|&s| s != frame.spacing);
    frames
        .iter()
        .any(is_other)
        .then(|| [0, 1, 2].map(|axis| [0, 1].map(|end| spacing_at(frames, axis, end))))
}

impl Ends {
    fn plane(&self, axis: usize, end: usize) -> Option<f64> {
        match self.sides[axis][end] {
            BoxSide::Plane(at) => Some(at),
            BoxSide::Unclear | BoxSide::Stray | BoxSide::Ragged => None,
        }
    }

    /// Whether particles are so far beyond a wall that the wall is not moved for them.
    fn passes(&self, axis: usize, end: usize, wall: f64) -> bool {
        outside(end, self.reach[axis][end], wall) > SAME_WALL_DISTANCE * self.spacings[axis][end]
    }
}

/// Adapts walls to particles within `bounds`, so that no particle is outside. `spacings` holds the
/// spacing at each side. A wall is moved if particles are slightly beyond it. If particles are
/// farther beyond a wall, its side becomes open. Also returns all walls that have particles beyond
/// them.
#[must_use]
pub fn adapted(
    walls: &Walls,
    bounds: &Bounds,
    spacings: [[f64; 2]; 3],
) -> (Walls, Vec<BeyondWall>) {
    let (mut adapted, mut past) = (*walls, Vec::new());
    for (axis, end) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
        let (Some(wall), reach) = (walls.0[axis][end], [bounds.lo, bounds.hi][end][axis]) else {
            continue;
        };
        let by = outside(end, reach, wall);
        if by > 0.0 {
            let moved = (by <= SAME_WALL_DISTANCE * spacings[axis][end]).then_some(reach);
            adapted.0[axis][end] = moved;
            past.push(BeyondWall { axis: ['x', 'y', 'z'][axis], wall, reach, moved });
        }
    }
    (adapted, past)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions in a box of lattice cells, each moved at random by up to `moved_by` along each
    /// axis.
    fn lattice(size: [i32; 3], moved_by: f64) -> Vec<[f64; 3]> {
        let mut state = 1_u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        };
        let mut positions = Vec::new();
        for (x, y, z) in (0..size[0])
            .flat_map(|x| (0..size[1]).flat_map(move |y| (0..size[2]).map(move |z| (x, y, z))))
        {
            positions.push([x, y, z].map(|c| f64::from(c) + 0.5 + moved_by * random()));
        }
        positions
    }

    fn ends(positions: &[[f64; 3]]) -> Ends {
        let grid = Grid::new(DVec3::ZERO, 0.5).unwrap();
        let ends = Ends::of(&positions, None, (1.0, None), None, &grid).unwrap();
        let known = Some(Bounds::of(positions));
        assert_eq!(Ends::of(&positions, known, (1.0, None), None, &grid).as_ref(), Some(&ends));
        ends
    }

    fn walls(positions: &[[f64; 3]]) -> Walls {
        common(&[ends(positions)], None, Some(1)).0
    }

    fn waves([x, y, z]: &[f64; 3]) -> bool {
        *y < 14.0 + 2.0 * (x / 6.0).sin() + 2.0 * (z / 5.0).cos()
    }

    #[test]
    fn walls_of_tanks_are_found_within_0_3_spacings_and_contain_all_particles() {
        // With a jitter of half a lattice cell, particles can be anywhere in the tank.
        for moved_by in [0.0, 0.1, 0.3, 0.5] {
            let mut water = lattice([50, 20, 40], moved_by);
            water.retain(waves);
            let found = walls(&water);
            let expected = [[Some(0.0), Some(50.0)], [Some(0.0), None], [Some(0.0), Some(40.0)]];
            for (axis, end) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
                let (found, expected) = (found.0[axis][end], expected[axis][end]);
                match (found, expected) {
                    (Some(found), Some(expected)) => {
                        assert!((found - expected).abs() < 0.3, "{moved_by}: {found}, {expected}")
                    }
                    other => assert_eq!(other, (None, None), "{moved_by}, axis {axis}"),
                }
            }
            let [lo, hi] = found.corners();
            assert!(water.iter().all(|&p| DVec3::from(p).cmpge(lo).all()));
            assert!(water.iter().all(|&p| DVec3::from(p).cmple(hi).all()));
            water.reverse();
            assert_eq!(walls(&water), found, "in another order");
        }
    }

    #[test]
    fn uneven_ends_are_not_walls() {
        let mut ball = lattice([48; 3], 0.4);
        ball.retain(|p| DVec3::from(*p).distance(DVec3::splat(24.0)) < 24.0);
        assert!(walls(&ball).is_open());
        // The water of a river has ragged ends where it flows in and out.
        let mut river = lattice([90, 20, 30], 0.4);
        river.retain(waves);
        river.retain(|[x, y, z]| (4.0 + 3.0 * (z / 3.0).sin()..80.0 + 2.0 * y.cos()).contains(x));
        let found = walls(&river);
        assert_eq!(
            found.0.map(|ends| ends.map(|end| end.is_some())),
            [[false; 2], [true, false], [true; 2]]
        );
        // If particles lie beyond a wall, the wall is uncertain.
        let mut leaking = lattice([50, 20, 40], 0.5);
        leaking.retain(waves);
        leaking.push([-3.0, 5.0, 5.0]);
        assert_eq!(walls(&leaking).0[0][0], None);
        assert!(walls(&leaking).0[0][1].is_some());
    }

    #[test]
    fn the_free_face_of_a_breaking_dam_is_not_a_wall() {
        let dam = ends(&lattice([30, 30, 40], 0.0));
        let mut broken = lattice([80, 20, 40], 0.3);
        broken.retain(waves);
        let broken = ends(&broken);
        let frames = [dam.clone(), broken.clone(), broken.clone()];
        let (found, _) = common(&frames, None, None);
        let expected = [[0.0, 80.0], [0.0, f64::INFINITY], [0.0, 40.0]];
        for (axis, end) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
            let open = [f64::NEG_INFINITY, f64::INFINITY][end];
            let at = found.0[axis][end].unwrap_or(open);
            assert!(at == expected[axis][end] || (at - expected[axis][end]).abs() < 0.3, "{at}");
        }
        // In a later frame, more than a few drops are beyond the wall.
        assert_eq!(common(&[dam.clone(), dam, broken], None, None).0.0[0][1], None);
    }

    #[test]
    fn a_wall_is_kept_if_only_some_frames_have_drops_beyond_it() {
        let mut water = lattice([50, 20, 40], 0.5);
        water.retain(waves);
        let tight = ends(&water);
        water.extend([[-3.0, 5.0, 5.0], [-9.0, 5.0, 5.0]]);
        let leaking = ends(&water);
        let wall = |frames: &[&Ends]| {
            let frames: Vec<Ends> = frames.iter().map(|&ends| ends.clone()).collect();
            common(&frames, None, None).0.0[0][0]
        };
        let expected = wall(&[&tight]);
        assert!(expected.is_some());
        assert_eq!(wall(&[&tight, &leaking, &tight]), expected);
        assert_eq!(wall(&[&tight, &leaking, &leaking]), None, "only one frame shows the wall");
    }

    #[test]
    fn the_scene_selects_the_walls_and_the_particles_place_them() {
        let dam = ends(&lattice([30, 30, 40], 0.0));
        // The fluid stays one spacing away from the boundary's particles.
        let scene = Walls([[Some(-1.0), Some(90.0)], [Some(-1.0), None], [Some(-1.0), Some(41.0)]]);
        let (found, matches) = common(std::slice::from_ref(&dam), Some(&scene), None);
        assert!(matches);
        assert_eq!(
            found,
            Walls([[Some(0.0), Some(90.0)], [Some(0.0), None], [Some(0.0), Some(40.0)]])
        );
        // A film of two layers is too shallow to show planes.
        let film = ends(&lattice([30, 2, 40], 0.2));
        let (found, _) = common(std::slice::from_ref(&film), Some(&scene), None);
        let [[lo, hi], [floor, top], [front, back]] = found.0;
        assert_eq!((hi, top), (Some(90.0), None));
        for (wall, expected) in [(lo, 0.0), (floor, 0.0), (front, 0.0), (back, 40.0)] {
            assert!((wall.unwrap() - expected).abs() < 0.1, "{wall:?}, expected {expected}");
        }
        assert!(common(std::slice::from_ref(&film), None, None).0.is_open());
        // The block expands until it touches the walls. Later frames show no planes.
        let mut splash = lattice([30, 30, 42], 0.2);
        splash.retain(|[x, y, _]| *y < 8.0 + 7.0 * (x / 3.0).sin());
        splash.iter_mut().for_each(|[_, _, z]| *z -= 1.0);
        let later = ends(&splash);
        let wide = Walls([[None; 2], [None; 2], [Some(-1.8), Some(41.8)]]);
        let (found, _) = common(&[dam.clone(), later], Some(&wide), None);
        let [front, back] = found.0[2].map(|wall| wall.unwrap());
        assert!((front + 1.0).abs() < 0.1 && (back - 41.0).abs() < 0.1, "{found:?}");
        // The walls of another simulation's scene do not match.
        let other = Walls([[Some(5.0), Some(20.0)], [Some(-1.0), None], [None, None]]);
        assert!(!common(&[dam], Some(&other), None).1);
    }

    #[test]
    fn walls_are_moved_for_near_outliers_and_removed_for_distant_ones() {
        let walls = Walls([[Some(0.0), Some(10.0)], [Some(0.0), None], [None, Some(5.0)]]);
        let bounds =
            Bounds { lo: DVec3::new(0.0, -0.25, -9.0), hi: DVec3::new(9.0, 90.0, 8.0), finite: 9 };
        let (adapted, past) = adapted(&walls, &bounds, [[1.0; 2]; 3]);
        assert_eq!(adapted, Walls([[Some(0.0), Some(10.0)], [Some(-0.25), None], [None, None]]));
        let moved: Vec<_> = past.iter().map(|past| (past.axis, past.wall, past.moved)).collect();
        assert_eq!(moved, [('y', 0.0, Some(-0.25)), ('z', 5.0, None)]);
    }

    #[test]
    fn rounded_walls_still_contain_the_outermost_particle() {
        for (end, wall, reach, spacing) in [
            (1, 1.234_567_891, 1.234_567_891, 0.05),
            (0, -1.234_567_891, -1.234_567_891, 0.05),
            (1, 0.1 + 0.2, 0.1 + 0.2, 1e-3),
            (0, -7e9 / 3.0, -7e9 / 3.0, 3e8),
            (1, 1e-12 / 3.0, 1e-12 / 3.0, 1e-13),
        ] {
            let rounded = rounded(end, wall, reach, spacing);
            assert!(outside(end, rounded, reach) >= 0.0, "{rounded} excludes {reach}");
            assert!((rounded - wall).abs() <= 0.01 * spacing, "{rounded} for {wall}");
        }
    }
}
