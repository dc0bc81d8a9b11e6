//! Triangles onto two rasters at once, on all threads: the eye's and the sun's.
//!
//! Most triangles of a fine mesh lie between samples, and most of a coarse one in few rows. So all are looked at once, in tasks, for whether
//! the box of their corners holds a sample at all; of those that do, the small ones are drawn at once. Of the others each thread then draws
//! what is in strips of rows of its own, of the tasks that reach them.

use std::ops::Range;

use rayon::prelude::*;

use super::canvas::{Canvas, Corners, VIEWS};
use super::raster::{Corner, Raster};
use super::shape::Batch;

/// Triangles of a task.
const TASK: usize = 1 << 9;
const WORD: usize = u64::BITS as usize;
/// Strips of rows for each thread, and rows of the smallest.
const STRIPS: usize = 6;
const LEAST_ROWS: usize = 16;

/// Tells which views of a triangle may show a sample, by the halves of its corners: between samples all of them are in the same one.
#[inline(always)]
fn may_show([a, b, c]: [u64; 3]) -> [u64; VIEWS] {
    const LOW: u64 = 0x7fff_7fff_7fff_7fff;
    let differ = (a ^ b) | (a ^ c);
    // In the highest bit of each half whether any of its bits is set, or it is even.
    let shows = differ | ((differ & LOW) + LOW) | !(a << 15);
    let both = |bit: u32| shows >> bit & shows >> (bit - 16) & 1;
    [both(63), both(31)]
}

/// The triangles of a task that are to be drawn yet: a bit each, and the rows that they are in.
struct Held {
    rows: Range<i32>,
    members: [u64; TASK / WORD],
}

impl Held {
    const NONE: Self = Self { rows: i32::MAX..i32::MIN, members: [0; TASK / WORD] };

    fn meets(&self, rows: &Range<i32>) -> bool {
        self.rows.start < rows.end && rows.start < self.rows.end
    }

    fn insert(&mut self, member: usize, rows: &Range<i32>) {
        self.members[member / WORD] |= 1 << (member % WORD);
        self.rows = self.rows.start.min(rows.start)..self.rows.end.max(rows.end);
    }

    fn members(&self) -> impl Iterator<Item = usize> + '_ {
        self.members.iter().enumerate().flat_map(|(n, &word)| ones(word).map(move |bit| n * WORD + bit))
    }
}

/// The numbers of the bits that are set.
fn ones(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = (word != 0).then(|| word.trailing_zeros())?;
        word &= word - 1;
        Some(bit as usize)
    })
}

/// Draws triangles on rasters.
pub(super) fn fill(canvases: [Canvas<'_>; VIEWS], batch: &Batch<'_>, corners: &mut Corners) {
    corners.put(canvases, batch.places);
    let corners = &*corners;
    let tasks: Vec<[Held; VIEWS]> = batch
        .triangles
        .par_chunks(TASK)
        .enumerate()
        .map(|(task, triangles)| {
            let first = batch.first + (task * TASK) as u32;
            draw_small(canvases.map(|canvas| canvas.raster), first, triangles, batch, corners)
        })
        .collect();
    for (view, Canvas { raster, camera }) in canvases.into_iter().enumerate() {
        let height = raster.height as i32;
        let strip = raster.height.div_ceil(STRIPS * rayon::current_num_threads()).max(LEAST_ROWS);
        (0..height).into_par_iter().step_by(strip).for_each(|top| {
            let rows = top..height.min(top + strip as i32);
            let held = tasks.iter().map(|task| &task[view]).enumerate();
            for (task, held) in held.filter(|(_, held)| held.meets(&rows)) {
                for n in held.members().map(|n| task * TASK + n) {
                    let triangle = &batch.triangles[n];
                    let seen =
                        || triangle.map(|corner| camera.seen(batch.places[batch.index(corner)].into()));
                    let corners = of(triangle, batch, corners, view);
                    raster.draw(&rows, batch.first + n as u32, corners, seen);
                }
            }
        });
    }
}

/// Draws the small triangles of a task, and returns the large ones of each view.
fn draw_small(
    rasters: [&Raster; VIEWS],
    first: u32,
    triangles: &[[u32; 3]],
    batch: &Batch<'_>,
    corners: &Corners,
) -> [Held; VIEWS] {
    let mut large = [Held::NONE; VIEWS];
    for (word, triangles) in triangles.chunks(WORD).enumerate() {
        // Without branches: whether a small triangle holds a sample is as good as random.
        let mut may_hold = [0; VIEWS];
        for (n, &[a, b, c]) in triangles.iter().enumerate() {
            let halves = |corner: u32| corners.halves[batch.index(corner)];
            let [eye, sun] = may_show([halves(a), halves(b), halves(c)]);
            may_hold[0] |= eye << n;
            may_hold[1] |= sun << n;
        }
        for (view, raster) in rasters.iter().enumerate() {
            // Likewise whether the only sample in its box is inside of it.
            let mut drawn = 0;
            for n in ones(may_hold[view]) {
                let corners = of(&triangles[n], batch, corners, view);
                let [one, inside] = raster.holds_one(corners);
                drawn |= u64::from(!one | inside) << n;
            }
            for n in ones(drawn) {
                let corners = of(&triangles[n], batch, corners, view);
                let member = word * WORD + n;
                if let Some(rows) = raster.draw_if_small(first + member as u32, corners) {
                    large[view].insert(member, &rows);
                }
            }
        }
    }
    large
}

/// The corners of a triangle in a view.
#[inline(always)]
fn of(&[a, b, c]: &[u32; 3], batch: &Batch<'_>, corners: &Corners, view: usize) -> [Corner; 3] {
    let at = |corner: u32| corners.at[batch.index(corner)][view];
    [at(a), at(b), at(c)]
}
