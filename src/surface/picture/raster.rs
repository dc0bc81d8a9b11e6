//! The surface as it is seen: for every sample of a picture what is nearest there, and how much water is behind it.
//!
//! Triangles are filled by retrofire's rasterizer, whose rule gives each sample on an edge to one of the two triangles beside it.
//! The picture is cut into bands of rows; a thread draws all of a band, in the mesh's order, so that nothing depends on threads.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;
use retrofire_core::geom::{Tri, Vertex, vertex};
use retrofire_core::math::point::pt3;
use retrofire_core::render::clip::{Clip, ClipVec, ClipVert, view_frustum};
use retrofire_core::render::raster::tri_fill;

/// Rows of a band.
const ROWS: usize = 32;

/// A sample of a picture.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sample {
    /// One over the distance of what is nearest; 0 where nothing is. Negative where that is seen from inside of the fluid.
    pub(super) near: f32,
    /// The normal there, not of unit length.
    pub(super) normal: Vec3,
    /// The value there, if vertices have any.
    pub(super) value: f32,
    /// The way through the fluid along the line of sight.
    pub(super) through: f32,
}

/// A vertex as it is seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corner {
    /// To the right and up, from -1 to 1 in the picture, times the distance; and the distance.
    pub(super) at: [f32; 3],
    pub(super) normal: Vec3,
    pub(super) value: f32,
}

/// A mesh as it is seen from somewhere.
pub(super) struct Raster {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) samples: Vec<Sample>,
    nearest: f32,
}

type Varying = ((f32, f32), (f32, f32));
type Filled = Vertex<retrofire_core::render::raster::ScreenPt, Varying>;

impl Raster {
    pub(super) fn new(width: usize, height: usize, nearest: f32) -> Self {
        Self { width, height, samples: vec![Sample::default(); width * height], nearest }
    }

    /// Bytes that one of such a size takes.
    pub(super) fn bytes(width: usize, height: usize) -> u64 {
        (width * height * size_of::<Sample>()) as u64
    }

    /// Draws triangles between corners.
    pub(super) fn draw(&mut self, corners: &[Corner], triangles: &[[u32; 3]]) {
        let bands = self.height.div_ceil(ROWS);
        let touched = |triangle: &[u32; 3]| self.bands_of(triangle.map(|corner| &corners[corner as usize]));
        // Triangles of each band, in their order: counted, then listed.
        let per_chunk: Vec<Vec<Vec<u32>>> = triangles
            .par_chunks(1 << 14)
            .enumerate()
            .map(|(chunk, triangles)| {
                let mut of_band = vec![Vec::new(); bands];
                for (n, triangle) in triangles.iter().enumerate() {
                    for band in touched(triangle) {
                        of_band[band].push((chunk << 14 | n) as u32);
                    }
                }
                of_band
            })
            .collect();
        let (width, height, nearest) = (self.width, self.height, self.nearest);
        self.samples.par_chunks_mut(ROWS * width).enumerate().for_each(|(band, samples)| {
            let first = band * ROWS;
            let mut band_of = Band { width, height, nearest, first, samples };
            for &triangle in per_chunk.iter().flat_map(|of_band| &of_band[band]) {
                band_of.draw(triangles[triangle as usize].map(|corner| &corners[corner as usize]));
            }
        });
    }

    /// The bands that a triangle can touch.
    fn bands_of(&self, corners: [&Corner; 3]) -> Range<usize> {
        let all = 0..self.height.div_ceil(ROWS);
        if corners.iter().all(|corner| corner.at[2] <= self.nearest) {
            return 0..0;
        }
        if corners.iter().any(|corner| corner.at[2] <= self.nearest) {
            return all;
        }
        let half = self.height as f32 / 2.0;
        let rows = corners.map(|corner| half - half * corner.at[1] / corner.at[2]);
        let lo = rows.iter().copied().fold(f32::INFINITY, f32::min) - 1.0;
        let hi = rows.iter().copied().fold(f32::NEG_INFINITY, f32::max) + 1.0;
        if hi < 0.0 || lo > self.height as f32 {
            return 0..0;
        }
        let band = |row: f32| (row.max(0.0) as usize / ROWS).min(all.end - 1);
        band(lo)..band(hi) + 1
    }
}

/// Rows of a picture that one thread draws.
struct Band<'a> {
    width: usize,
    height: usize,
    nearest: f32,
    first: usize,
    samples: &'a mut [Sample],
}

impl Band<'_> {
    fn draw(&mut self, corners: [&Corner; 3]) {
        let inside = |corner: &&Corner| {
            let [x, y, distance] = corner.at;
            distance > self.nearest && x.abs() < distance && y.abs() < distance
        };
        if corners.iter().all(inside) {
            let [a, b, c] = corners;
            // Counter-clockwise is seen from outside.
            self.fill([a, b, c].map(|corner| self.filled(corner.at, varying(corner))));
            return;
        }
        // Cut off at the edges of the picture, and before the eye.
        let clip = corners.map(|corner| {
            let [x, y, distance] = corner.at;
            let at = ClipVec::new([x, y, 2.0 * (distance - self.nearest) - distance, distance]);
            ClipVert::new(vertex(at, varying(corner)))
        });
        let mut cut: Vec<Tri<ClipVert<Varying>>> = Vec::new();
        [Tri(clip)].clip(&view_frustum::PLANES, &mut cut);
        for Tri(corners) in cut {
            self.fill(corners.map(|corner| {
                let [x, y, _, distance] = corner.pos.0;
                self.filled([x, y, distance], corner.attrib)
            }));
        }
    }

    fn filled(&self, [x, y, distance]: [f32; 3], varying: Varying) -> Filled {
        let (half_width, half_height) = (self.width as f32 / 2.0, self.height as f32 / 2.0);
        let near = 1.0 / distance;
        let row = half_height - half_height * y * near;
        vertex(pt3(half_width + half_width * x * near, row, near), varying)
    }

    fn fill(&mut self, corners: [Filled; 3]) {
        let [a, b, c] = [0, 1, 2].map(|i: usize| corners[i].pos);
        let doubled = (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x());
        if !(doubled.abs() > 0.0 && doubled.is_finite()) {
            return;
        }
        // Rows go down: a face that is seen from outside turns the other way there.
        let enters = if doubled < 0.0 { -1.0 } else { 1.0 };
        let (first, width, samples) = (self.first, self.width, &mut *self.samples);
        let last = first + samples.len() / width;
        tri_fill(corners, |scanline| {
            if !(first..last).contains(&scanline.y) || scanline.xs.start >= width {
                return;
            }
            let row = &mut samples[(scanline.y - first) * width..][..width];
            let end = scanline.xs.end.min(width);
            let row = row.get_mut(scanline.xs.start..end).unwrap_or_default();
            for (sample, (at, ((nx, ny), (nz, value)))) in row.iter_mut().zip(scanline.vs) {
                let near = at.z();
                sample.through += enters / near;
                if near > sample.near.abs() {
                    (sample.near, sample.value) = (-near * enters, value);
                    sample.normal = Vec3::new(nx, ny, nz);
                }
            }
        });
    }
}

fn varying(corner: &Corner) -> Varying {
    let Vec3 { x, y, z } = corner.normal;
    ((x, y), (z, corner.value))
}
