//! Light that changes slowly over a picture: worked out at few pixels, and between them taken from those around.

use glam::Vec3;
use rayon::prelude::*;

/// Pixels from one that is worked out to the next.
const STEP: usize = 4;

/// Light at every few pixels.
pub(super) struct Sketch {
    columns: usize,
    known: Vec<Vec3>,
}

impl Sketch {
    /// Works it out for a picture of such a size.
    pub(super) fn new(width: usize, height: usize, light: impl Fn(usize, usize) -> Vec3 + Sync) -> Self {
        let [columns, rows] = [width, height].map(|pixels| pixels.div_ceil(STEP) + 1);
        let of = |n: usize| light(n % columns * STEP, n / columns * STEP);
        let known = (0..columns * rows).into_par_iter().with_min_len(columns).map(of).collect();
        Self { columns, known }
    }

    /// The light at a pixel.
    pub(super) fn at(&self, x: usize, y: usize) -> Vec3 {
        let share = |at: usize| (at % STEP) as f32 / STEP as f32;
        let first = y / STEP * self.columns + x / STEP;
        let row = |first: usize| self.known[first].lerp(self.known[first + 1], share(x));
        row(first).lerp(row(first + self.columns), share(y))
    }
}
