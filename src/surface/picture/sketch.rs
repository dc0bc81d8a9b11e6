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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_that_changes_evenly_is_what_it_is_at_every_pixel() {
        let light = |x: usize, y: usize| Vec3::new(x as f32, y as f32, 2.0 * x as f32 - 3.0 * y as f32 + 7.0);
        for [width, height] in [[1, 1], [9, 8], [13, 31]] {
            let sketch = Sketch::new(width, height, light);
            for n in 0..width * height {
                let [x, y] = [n % width, n / width];
                assert!(sketch.at(x, y).distance(light(x, y)) < 1e-3, "{x}, {y} of {width} x {height}");
            }
        }
    }
}
