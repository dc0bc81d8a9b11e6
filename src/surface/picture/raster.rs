//! The visible surface: for every sample of a picture, the nearest triangle, and the path length
//! through the water behind it (a visibility buffer, Burns and Hunt 2013).
//!
//! Corners are rounded to 1 / 256 of the distance between samples, and integer arithmetic decides
//! whether a sample is inside a triangle. A sample on an edge belongs to the triangle below or to
//! the right. Therefore, a closed surface has no cracks, and every line of sight leaves the fluid
//! as often as it enters the fluid. A sample stores an integer sum and a maximum over triangles,
//! which do not depend on the triangles' order. Therefore, any thread may draw small triangles.
//! Each thread draws the parts of large triangles in its own rows.

use std::ops::Range;
use std::sync::atomic::{AtomicI32, AtomicU64, Ordering};

use rayon::prelude::*;

use crate::system::memory::{empty_in_huge_pages, zeroed_in_huge_pages};

use super::camera::{Camera, FARTHEST};

/// Number of steps from one sample to the next. Corners are rounded to steps.
const STEPS: i32 = 1 << STEP_BITS;
const STEP_BITS: u32 = 8;
/// Maximum distance of a corner from the picture's first sample, in steps; triangles that extend
/// farther are clipped.
const FAR: i32 = 1 << 28;
/// Number of steps in the distance from the eye to the farthest place. Path lengths are stored in
/// these steps.
const PATH_STEPS: f64 = (1 << 26) as f64;

/// Maximum number of samples in the box of a triangle that any thread may draw. For larger
/// triangles, it is faster if only one thread writes to each row.
const MOST_SMALL_SAMPLES: i64 = 4;

/// A corner of a triangle on the picture.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Corner {
    /// Steps to the right and down from the middle of the first sample.
    at: [i32; 2],
    /// The eye's distance from the target, divided by the corner's distance in [camera
    /// coordinates](Camera::camera_coordinates); 0 if the corner is behind the eye, or too far to
    /// the side.
    near: f32,
}

/// The nearest triangle at a sample, and the path length through the fluid behind it.
#[derive(Debug, Clone, Copy)]
pub(super) struct RasterSample {
    /// The triangle's number.
    pub(super) triangle: u32,
    /// The eye's distance from the target, divided by the surface's distance in [camera
    /// coordinates](Camera::camera_coordinates).
    pub(super) near: f32,
    /// The path length through the fluid, projected onto the viewing axis, divided by the eye's
    /// distance from the target.
    pub(super) through: f32,
}

/// A mesh as seen from an eye.
pub(super) struct Raster {
    pub(super) width: usize,
    pub(super) height: usize,
    nearest: Vec<AtomicU64>,
    through: Vec<AtomicI32>,
    /// Distance from the eye to the target. In this unit, numbers keep their precision for meshes
    /// of any size.
    unit: f64,
    /// The distance of the near plane.
    near_plane: f64,
    path_steps: f32,
}

impl Raster {
    /// An empty raster, for an eye that sees up to a distance of about `farthest`.
    pub(super) fn new(width: usize, height: usize, camera: &Camera, farthest: f64) -> Self {
        let unit = camera.distance();
        let path_steps = (PATH_STEPS * unit / farthest.max(unit)) as f32;
        let samples = width * height;
        Self {
            width,
            height,
            nearest: zeroed_in_huge_pages(samples),
            through: zeroed_in_huge_pages(samples),
            unit,
            near_plane: camera.nearest(),
            path_steps,
        }
    }

    /// Memory, in bytes, of a raster of this size.
    pub(super) fn bytes(width: usize, height: usize) -> u64 {
        (width * height * (size_of::<AtomicU64>() + size_of::<AtomicI32>())) as u64
    }

    /// The visible surface at a sample; `None` if no surface is visible.
    pub(super) fn sample(&self, n: usize) -> Option<RasterSample> {
        let nearest = self.nearest[n].load(Ordering::Relaxed);
        (nearest > 0).then(|| RasterSample {
            triangle: !(nearest as u32),
            near: f32::from_bits((nearest >> 32) as u32),
            through: self.through[n].load(Ordering::Relaxed) as f32 / self.path_steps,
        })
    }

    /// The corner at a place in [camera coordinates](Camera::camera_coordinates).
    #[inline(always)]
    pub(super) fn corner(&self, [x, y, distance]: [f64; 3]) -> Corner {
        let near = 1.0 / distance;
        let steps = f64::from(STEPS);
        let scale = self.height as f64 * steps * near;
        let [right, down] = [
            (self.width as f64 - 1.0) / 2.0 * steps + x * scale,
            (self.height as f64 - 1.0) / 2.0 * steps - y * scale,
        ];
        let far = f64::from(FAR);
        if !(distance >= self.near_plane && right.abs() < far && down.abs() < far) {
            return Corner::default();
        }
        // The sum is positive, so the conversion, which truncates, rounds it down.
        let round = |steps: f64| (steps + far + 0.5) as i32 - FAR;
        Corner { at: [round(right), round(down)], near: (self.unit * near) as f32 }
    }

    /// The column and row of a corner in half samples: odd numbers are between samples. Corners
    /// outside the picture are clamped. For a corner that is behind the eye or too far to the side,
    /// or in a picture that is too large for 16 bits, both numbers are 0. Because 0 is even, a
    /// triangle with such a corner never counts as lying between samples.
    #[inline(always)]
    pub(super) fn halves(&self, corner: Corner) -> [u16; 2] {
        let (width, height) = (self.width as i32, self.height as i32);
        if corner.near <= 0.0 || width.max(height) >= i32::from(u16::MAX) / 2 {
            return [0; 2];
        }
        let [x, y] = corner.at;
        [halves(x, width), halves(y, height)]
    }

    /// For a triangle whose bounding box contains a sample: whether the box contains only one
    /// sample, and whether that sample is inside the triangle.
    #[inline(always)]
    pub(super) fn single_sample_in_box(&self, corners: [Corner; 3]) -> [bool; 2] {
        let [[left, right], [top, bottom]] = self.around(corners);
        let one = (left == right) & (top == bottom) & are_projected(corners);
        let [a, b, c] = corners;
        let turn = area(corners).signum();
        let inside = |p: Corner, q: Corner| turn_of([left, top], p, q, turn) >= 0;
        [one, one & inside(a, b) & inside(b, c) & inside(c, a)]
    }

    /// The first and last columns and rows of samples in the bounding box of a triangle.
    #[inline(always)]
    fn around(&self, corners: [Corner; 3]) -> [[i32; 2]; 2] {
        [
            samples(corners, 0, &(0..self.width as i32)),
            samples(corners, 1, &(0..self.height as i32)),
        ]
    }

    /// Draws a triangle if its box contains few samples, and returns `None`. Any thread may call
    /// this function. For all other triangles, draws nothing and returns the triangle's rows, which
    /// are all rows if a corner is behind the eye or too far to the side.
    #[inline(always)]
    pub(super) fn draw_if_small(&self, number: u32, corners: [Corner; 3]) -> Option<Range<i32>> {
        if !are_projected(corners) {
            return Some(0..self.height as i32);
        }
        let around @ [[left, right], [top, bottom]] = self.around(corners);
        // The sides of the box are less than 2^22, so their product fits into an i64.
        if i64::from(right + 1 - left) * i64::from(bottom + 1 - top) > MOST_SMALL_SAMPLES {
            return Some(top..bottom + 1);
        }
        self.fill(around, number, corners, |sample, key, path| {
            // Many triangles are hidden. For these, reading first avoids the slower `fetch_max`.
            if self.nearest[sample].load(Ordering::Relaxed) < key {
                self.nearest[sample].fetch_max(key, Ordering::Relaxed);
            }
            self.through[sample].fetch_add(path, Ordering::Relaxed);
        });
        None
    }

    /// Draws the part of a triangle in `rows`, in which no other thread may draw. `coordinates`
    /// returns the camera coordinates of the corners; it is called only if the triangle must be
    /// clipped.
    pub(super) fn draw(
        &self,
        rows: &Range<i32>,
        number: u32,
        corners: [Corner; 3],
        coordinates: impl FnOnce() -> [[f64; 3]; 3],
    ) {
        if are_projected(corners) {
            self.fill_rows(rows, number, corners);
            return;
        }
        // A clipped triangle is convex, so it can be drawn as a fan.
        let cut = self.cut(coordinates());
        let corners: Vec<Corner> = cut.iter().map(|&corner| self.corner(corner)).collect();
        if let [first, rest @ ..] = &corners[..]
            && corners.iter().all(|corner| corner.near > 0.0)
        {
            rest.windows(2)
                .for_each(|pair| self.fill_rows(rows, number, [*first, pair[0], pair[1]]));
        }
    }

    /// Cuts off the parts of a triangle that are behind the eye, or too far to the side (Sutherland
    /// and Hodgman 1974).
    fn cut(&self, corners: [[f64; 3]; 3]) -> Vec<[f64; 3]> {
        if !corners.iter().flatten().all(|x| x.abs() <= FARTHEST) {
            return Vec::new();
        }
        let side = f64::from(FAR / (4 * STEPS)) / self.width.max(self.height) as f64;
        let near_plane = self.near_plane * (1.0 + 1e-6);
        let planes: [&dyn Fn([f64; 3]) -> f64; 5] = [
            &|[_, _, distance]| distance - near_plane,
            &|[x, _, distance]| side * distance - x,
            &|[x, _, distance]| side * distance + x,
            &|[_, y, distance]| side * distance - y,
            &|[_, y, distance]| side * distance + y,
        ];
        let mut polygon = corners.to_vec();
        for plane in planes {
            let mut clipped = Vec::with_capacity(polygon.len() + 1);
            for (n, &corner) in polygon.iter().enumerate() {
                let last = polygon[n.checked_sub(1).unwrap_or(polygon.len() - 1)];
                let [from, to] = [plane(last), plane(corner)];
                if (from >= 0.0) != (to >= 0.0) {
                    // For both triangles of the edge, the place of the cut is computed from the
                    // edge's inner end to its outer end, so that both triangles are clipped at
                    // exactly the same place.
                    let ([inner, outer], share) = if from >= 0.0 {
                        ([last, corner], from / (from - to))
                    } else {
                        ([corner, last], to / (to - from))
                    };
                    clipped.push(std::array::from_fn(|axis| {
                        inner[axis] + share * (outer[axis] - inner[axis])
                    }));
                }
                if to >= 0.0 {
                    clipped.push(corner);
                }
            }
            polygon = clipped;
        }
        polygon
    }

    fn fill_rows(&self, rows: &Range<i32>, number: u32, corners: [Corner; 3]) {
        let [top, bottom] = samples(corners, 1, rows);
        if top > bottom {
            return;
        }
        let [left, right] = samples(corners, 0, &(0..self.width as i32));
        // No other thread draws in these rows, so this reads and writes separately, which is much
        // faster than an atomic addition.
        self.fill([[left, right], [top, bottom]], number, corners, |sample, key, path| {
            let (nearest, through) = (&self.nearest[sample], &self.through[sample]);
            if nearest.load(Ordering::Relaxed) < key {
                nearest.store(key, Ordering::Relaxed);
            }
            through.store(through.load(Ordering::Relaxed).wrapping_add(path), Ordering::Relaxed);
        });
    }

    /// Calls `put` for each sample inside a triangle in a range of columns and rows, with the
    /// sample's number, a key that is greater for nearer triangles, and the contribution to the
    /// path length.
    #[inline(always)]
    fn fill(
        &self,
        [[left, right], [top, bottom]]: [[i32; 2]; 2],
        number: u32,
        [a, b, c]: [Corner; 3],
        put: impl Fn(usize, u64, i32),
    ) {
        let area = area([a, b, c]);
        if area == 0 {
            return;
        }
        // A triangle that is clockwise in the picture is seen from inside: there, the line of sight
        // leaves the fluid. The area of such a triangle is positive, because rows are counted
        // downwards.
        let (b, c, area, leaves) = if area > 0 { (b, c, area, 1.0) } else { (c, b, -area, -1.0) };
        // For each edge: a value that is at least 0 if the first sample is inside, and its
        // increments to the right and down.
        let edge = |p: Corner, q: Corner| {
            let [x, y] = across(p, q);
            [turn_of([left, top], p, q, 1), -y * i64::from(STEPS), x * i64::from(STEPS)]
        };
        let [mut of_c, c_right, c_down] = edge(a, b);
        let [mut of_a, a_right, a_down] = edge(b, c);
        let [mut of_b, b_right, b_down] = edge(c, a);
        let [b_near, c_near] = [b.near - a.near, c.near - a.near];
        let [least, most] = [a.near.min(b.near).min(c.near), a.near.max(b.near).max(c.near)];
        let share = 1.0 / area as f32;
        for y in top..=bottom {
            let row = y as usize * self.width;
            let [mut in_a, mut in_b, mut in_c] = [of_a, of_b, of_c];
            let mut entered = false;
            for x in left..=right {
                if in_a | in_b | in_c >= 0 {
                    entered = true;
                    let near = a.near + (in_b as f32 * b_near + in_c as f32 * c_near) * share;
                    let near = near.clamp(least, most);
                    // Among equally near triangles, the first one wins.
                    let key = u64::from(near.to_bits()) << 32 | u64::from(!number);
                    // Intermediate sums of a sample may overflow, but its final sum does not.
                    let path = (leaves / near * self.path_steps) as i64 as i32;
                    put(row + x as usize, key, path);
                } else if entered {
                    break;
                }
                in_a += a_right;
                in_b += b_right;
                in_c += c_right;
            }
            of_a += a_down;
            of_b += b_down;
            of_c += c_down;
        }
    }
}

#[inline(always)]
fn across(p: Corner, q: Corner) -> [i64; 2] {
    [i64::from(q.at[0]) - i64::from(p.at[0]), i64::from(q.at[1]) - i64::from(p.at[1])]
}

/// Twice the area of a triangle; negative if the triangle is counter-clockwise in the picture.
#[inline(always)]
fn area([a, b, c]: [Corner; 3]) -> i64 {
    let ([x, y], [u, v]) = (across(a, b), across(a, c));
    x * v - y * u
}

/// Twice the signed area of the triangle that an edge forms with a sample, minus one if samples on
/// this edge count as outside. A `turn` of -1 reverses the edge.
#[inline(always)]
fn turn_of(sample: [i32; 2], p: Corner, q: Corner, turn: i64) -> i64 {
    let [x, y] = across(p, q);
    let to = |axis: usize| i64::from(sample[axis]) * i64::from(STEPS) - i64::from(p.at[axis]);
    let (to_x, to_y) = (to(0), to(1));
    let lacks = i64::from(!((turn * y < 0) | (y == 0) & (turn * x > 0)));
    turn * (x * to_y - y * to_x) - lacks
}

/// Converts a coordinate to half samples, plus 2. An odd result is between two samples. The axis
/// has `samples` samples.
#[inline(always)]
fn halves(at: i32, samples: i32) -> u16 {
    let half = 2 * (at >> STEP_BITS) + i32::from(at & (STEPS - 1) != 0);
    // Places outside the picture count as lying between two samples that do not exist. No result is
    // less than 1.
    (half.clamp(-1, 2 * samples - 1) + 2) as u16
}

/// Whether no corner is behind the eye or too far to the side.
#[inline(always)]
fn are_projected([a, b, c]: [Corner; 3]) -> bool {
    a.near.min(b.near).min(c.near) > 0.0
}

/// The first and last sample along an axis, within the given range, between the outermost corners.
#[inline(always)]
fn samples(corners: [Corner; 3], axis: usize, of: &Range<i32>) -> [i32; 2] {
    let [a, b, c] = [corners[0].at[axis], corners[1].at[axis], corners[2].at[axis]];
    let (lo, hi) = (a.min(b).min(c), a.max(b).max(c));
    // Samples are at multiples of `STEPS`.
    [((lo + STEPS - 1) >> STEP_BITS).max(of.start), (hi >> STEP_BITS).min(of.end - 1)]
}

/// Minimum number of corners per task.
const LEAST_CORNERS_PER_TASK: usize = 1 << 9;

/// A raster, and the camera whose view is drawn on it.
#[derive(Clone, Copy)]
pub(super) struct Canvas<'a> {
    pub(super) raster: &'a Raster,
    pub(super) camera: &'a Camera,
}

impl Canvas<'_> {
    /// The corner at a place, and its half samples: the column in the upper 16 bits, and the row in
    /// the lower 16 bits.
    #[inline(always)]
    fn corner(&self, place: [f64; 3]) -> (Corner, u64) {
        let corner = self.raster.corner(self.camera.camera_coordinates(place.into()));
        let [column, row] = self.raster.halves(corner);
        (corner, u64::from(column) << 16 | u64::from(row))
    }
}

/// Number of views that are drawn at once: eye and sun.
pub(super) const VIEWS: usize = 2;

/// The corners of a batch in each view. The buffers are reused between batches.
pub(super) struct ProjectedCorners {
    pub(super) at: Vec<[Corner; VIEWS]>,
    /// The [half samples](Raster::halves) of each corner, 16 bits per axis, with those of the eye's
    /// view in the higher bits.
    pub(super) halves: Vec<u64>,
}

impl ProjectedCorners {
    /// Memory per corner, in bytes.
    pub(super) const BYTES: u64 = (size_of::<[Corner; VIEWS]>() + size_of::<u64>()) as u64;

    /// An empty list with capacity for `count`.
    pub(super) fn with_room(count: usize) -> Self {
        Self { at: empty_in_huge_pages(count), halves: empty_in_huge_pages(count) }
    }

    /// Projects places onto the pictures.
    pub(super) fn put(&mut self, [eye, sun]: [Canvas<'_>; VIEWS], places: &[[f64; 3]]) {
        let of = |&place: &[f64; 3]| {
            let (eye_corner, eye_halves) = eye.corner(place);
            let (sun_corner, sun_halves) = sun.corner(place);
            ([eye_corner, sun_corner], eye_halves << 32 | sun_halves)
        };
        places
            .par_iter()
            .with_min_len(LEAST_CORNERS_PER_TASK)
            .map(of)
            .unzip_into_vecs(&mut self.at, &mut self.halves);
    }
}
