//! Triangles onto a raster, on all threads: each draws in rows of its own what may be there.
//!
//! Most triangles of a fine mesh lie between samples, and most of a coarse one in few rows. So all are looked at once, in tasks, for whether
//! the box of their corners holds a sample at all; strips of rows then go through those that do, of the tasks that reach them.

use std::ops::Range;

use rayon::prelude::*;

use super::camera::Camera;
use super::raster::{Corner, Raster};
use super::shape::Batch;

/// Triangles of a task.
const TASK: usize = 1 << 9;
const WORD: usize = u64::BITS as usize;
/// Strips of rows for each thread, and rows of the smallest.
const STRIPS: usize = 6;
const LEAST_ROWS: usize = 16;

/// The triangles of a task whose boxes hold a sample: a bit each, and the rows that they are in.
struct Held {
    rows: Range<i32>,
    members: [u64; TASK / WORD],
}

impl Held {
    fn of(raster: &Raster, triangles: impl Iterator<Item = [Corner; 3]>) -> Self {
        let (mut first, mut end) = (i32::MAX, i32::MIN);
        let mut members = [0; TASK / WORD];
        // Without branches: whether a small triangle holds a sample is as good as random.
        for (n, triangle) in triangles.enumerate() {
            let (rows, holds) = raster.rows(triangle);
            members[n / WORD] |= u64::from(holds) << (n % WORD);
            (first, end) = (first.min(rows.start), end.max(rows.end));
        }
        Self { rows: first..end, members }
    }

    fn meets(&self, rows: &Range<i32>) -> bool {
        self.rows.start < rows.end && rows.start < self.rows.end
    }

    fn members(&self) -> impl Iterator<Item = usize> + '_ {
        self.members.iter().enumerate().flat_map(|(n, &word)| {
            let mut word = word;
            std::iter::from_fn(move || {
                let bit = (word != 0).then(|| word.trailing_zeros())?;
                word &= word - 1;
                Some(n * WORD + bit as usize)
            })
        })
    }
}

/// Draws triangles on a raster. `corners` is kept from one call to the next for its memory.
pub(super) fn fill(raster: &Raster, camera: &Camera, batch: &Batch<'_>, corners: &mut Vec<Corner>) {
    let seen = |n: usize| camera.seen(batch.places[n].into());
    (0..batch.places.len()).into_par_iter().map(|n| raster.corner(seen(n))).collect_into_vec(corners);
    let corners = &corners[..];
    let tasks: Vec<Held> = batch
        .triangles
        .par_chunks(TASK)
        .map(|triangles| Held::of(raster, triangles.iter().map(|triangle| of(triangle, batch, corners))))
        .collect();
    let height = raster.height as i32;
    let strip = raster.height.div_ceil(STRIPS * rayon::current_num_threads()).max(LEAST_ROWS);
    (0..height).into_par_iter().step_by(strip).for_each(|top| {
        let rows = top..height.min(top + strip as i32);
        for (task, held) in tasks.iter().enumerate().filter(|(_, held)| held.meets(&rows)) {
            for n in held.members().map(|n| task * TASK + n) {
                let triangle = &batch.triangles[n];
                let seen = || triangle.map(|corner| seen(batch.index(corner)));
                raster.draw(&rows, batch.first + n as u32, of(triangle, batch, corners), seen);
            }
        }
    });
}

/// The corners of a triangle.
#[inline(always)]
fn of(&[a, b, c]: &[u32; 3], batch: &Batch<'_>, corners: &[Corner]) -> [Corner; 3] {
    [corners[batch.index(a)], corners[batch.index(b)], corners[batch.index(c)]]
}
