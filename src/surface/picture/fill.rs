//! Draws triangles onto two rasters at once, on all threads: the views of the eye and the sun.
//!
//! Most triangles of a fine mesh lie between samples, and most triangles of a coarse mesh cover few
//! rows. Therefore, tasks first test whether the bounding box of each triangle contains a sample,
//! and draw small triangles immediately. Each thread then draws the large triangles within its own
//! strips of rows.

use std::ops::Range;

use rayon::prelude::*;

use crate::system::bits::ones;

use super::raster::{Canvas, ProjectedCorners, VIEWS};
use super::raster::{Corner, Raster};
use super::shape::TriangleBatch;

/// Number of triangles per task.
const TASK: usize = 1 << 9;
const WORD: usize = u64::BITS as usize;
/// Number of strips per thread.
const STRIPS: usize = 6;
/// Minimum number of rows of a strip.
const LEAST_ROWS: usize = 16;

/// Finds the views in which a triangle may cover a sample, from the [half samples](Raster::halves)
/// of its corners. A triangle lies between samples if all corners have the same odd half sample
/// along an axis.
#[inline(always)]
fn may_show([a, b, c]: [u64; 3]) -> [u64; VIEWS] {
    const LOW: u64 = 0x7fff_7fff_7fff_7fff;
    let differ = (a ^ b) | (a ^ c);
    // Sets the highest bit of each 16-bit lane if any bit of the lane is set in `differ`, or if the
    // lane of `a` is even.
    let shows = differ | ((differ & LOW) + LOW) | !(a << 15);
    let both = |bit: u32| shows >> bit & shows >> (bit - 16) & 1;
    [both(63), both(31)]
}

/// The triangles of a task that have not been drawn yet: one bit for each, and the range of their
/// rows.
struct PendingTriangles {
    first: i32,
    end: i32,
    members: [u64; TASK / WORD],
}

impl PendingTriangles {
    const NONE: Self = Self { first: i32::MAX, end: i32::MIN, members: [0; TASK / WORD] };

    fn meets(&self, rows: &Range<i32>) -> bool {
        self.first < rows.end && rows.start < self.end
    }

    fn insert(&mut self, member: usize, rows: &Range<i32>) {
        self.members[member / WORD] |= 1 << (member % WORD);
        (self.first, self.end) = (self.first.min(rows.start), self.end.max(rows.end));
    }

    fn members(&self) -> impl Iterator<Item = usize> + '_ {
        self.members
            .iter()
            .enumerate()
            .flat_map(|(n, &word)| ones(word).map(move |bit| n * WORD + bit))
    }
}

/// Draws triangles on rasters.
pub(super) fn fill(
    canvases: [Canvas<'_>; VIEWS],
    batch: &TriangleBatch<'_>,
    corners: &mut ProjectedCorners,
) {
    corners.put(canvases, batch.places);
    let corners = &*corners;
    let tasks: Vec<[PendingTriangles; VIEWS]> = batch
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
            let pending = tasks.iter().map(|task| &task[view]).enumerate();
            for (task, pending) in pending.filter(|(_, pending)| pending.meets(&rows)) {
                for n in pending.members().map(|n| task * TASK + n) {
                    let triangle = &batch.triangles[n];
                    let coordinates = || {
                        triangle.map(|corner| {
                            camera.camera_coordinates(batch.places[batch.index(corner)].into())
                        })
                    };
                    let corners = of(triangle, batch, corners, view);
                    raster.draw(&rows, batch.first + n as u32, corners, coordinates);
                }
            }
        });
    }
}

/// Draws the small triangles of a task, and returns the large triangles of each view.
fn draw_small(
    rasters: [&Raster; VIEWS],
    first: u32,
    triangles: &[[u32; 3]],
    batch: &TriangleBatch<'_>,
    corners: &ProjectedCorners,
) -> [PendingTriangles; VIEWS] {
    let mut large = [PendingTriangles::NONE; VIEWS];
    for (word, triangles) in triangles.chunks(WORD).enumerate() {
        // Whether a small triangle contains a sample is almost random, so a branch would often be
        // mispredicted. This loop therefore has no branches.
        let mut may_contain = [0; VIEWS];
        for (n, &[a, b, c]) in triangles.iter().enumerate() {
            let halves = |corner: u32| corners.halves[batch.index(corner)];
            let [eye, sun] = may_show([halves(a), halves(b), halves(c)]);
            may_contain[0] |= eye << n;
            may_contain[1] |= sun << n;
        }
        for (view, raster) in rasters.iter().enumerate() {
            // Whether the only sample in a triangle's box is inside the triangle is almost random,
            // so this loop has no branches.
            let mut drawn = 0;
            for n in ones(may_contain[view]) {
                let corners = of(&triangles[n], batch, corners, view);
                let [one, inside] = raster.single_sample_in_box(corners);
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
fn of(
    &[a, b, c]: &[u32; 3],
    batch: &TriangleBatch<'_>,
    corners: &ProjectedCorners,
    view: usize,
) -> [Corner; 3] {
    let at = |corner: u32| corners.at[batch.index(corner)][view];
    [at(a), at(b), at(c)]
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;
    use crate::surface::mesh::Mesh;
    use crate::surface::picture::camera::{Camera, View};
    use crate::surface::picture::colour::ColourSource;
    use crate::surface::picture::request::MeshMemory;
    use crate::surface::picture::shape::Shape;

    /// The visible triangle, its inverse distance and the path length in the fluid at each sample.
    fn visible_samples(raster: &Raster) -> Vec<Option<[u32; 3]>> {
        let samples = (0..raster.width * raster.height).map(|n| raster.sample(n));
        samples
            .map(|sample| sample.map(|s| [s.triangle, s.near.to_bits(), s.through.to_bits()]))
            .collect()
    }

    #[test]
    fn the_fast_path_for_small_triangles_fills_the_same_pixels() {
        let mut state = 7_u64;
        let mut unit = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1 << 24)
        };
        let mut mesh = Mesh::default();
        for n in 0..20_000 {
            // Triangles of various sizes, on and off the picture, and some behind the eye.
            let middle = [(); 3].map(|()| 3.0 * unit() - 1.5);
            let size = [0.01, 0.03, 0.1, 1.0, 4.0][n % 5];
            mesh.positions.extend([(); 3].map(|()| middle.map(|x| x + size * (unit() - 0.5))));
            let first = 3 * n as u32;
            mesh.triangles.push([first, first + 1, first + 2]);
        }
        // A visible triangle whose corners are all too far to the side.
        mesh.positions.extend([[-1e9, -1e9, 0.0], [1e9, -1e9, 0.0], [0.0, 1e9, 0.0]]);
        mesh.triangles.push([60_000, 60_001, 60_002]);
        let bounds = [[-1.0; 3], [1.0; 3]];
        let at = |eye| {
            Camera::new(Some(View::At { eye, target: [0.0; 3] }), bounds, DMat3::IDENTITY, 1.5)
        };
        let cameras = [at([0.0, 0.0, 4.0]), at([1.2, 1.0, 0.3])];
        let rasters = || cameras.each_ref().map(|camera| Raster::new(90, 60, camera, 6.0));
        let (found, expected) = (rasters(), rasters());
        let shape = Shape::read(&mesh, &ColourSource::None, &MeshMemory::Whole).unwrap();
        shape
            .batches(|batch| {
                let mut corners = ProjectedCorners::with_room(0);
                let canvas = |view: usize| Canvas { raster: &found[view], camera: &cameras[view] };
                fill([canvas(0), canvas(1)], batch, &mut corners);
                for (n, triangle) in batch.triangles.iter().enumerate() {
                    for (view, raster) in expected.iter().enumerate() {
                        let places = || {
                            triangle.map(|corner| {
                                cameras[view]
                                    .camera_coordinates(batch.places[corner as usize].into())
                            })
                        };
                        raster.draw(
                            &(0..60),
                            n as u32,
                            of(triangle, batch, &corners, view),
                            places,
                        );
                    }
                }
                Ok(())
            })
            .unwrap();
        for view in 0..VIEWS {
            assert!(
                visible_samples(&found[view]) == visible_samples(&expected[view]),
                "view {view}"
            );
            assert!(visible_samples(&found[view]).iter().flatten().count() > 3000);
        }
    }
}
