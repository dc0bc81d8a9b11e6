//! A mesh to an image: its box, what is seen of it, and light on every pixel.

use std::ops::Range;

use rayon::prelude::*;

use crate::surface::mesh::source::MeshSource;

use super::camera::Camera;
use super::colour::{Palette, Values};
use super::error::PictureError;
use super::image::Image;
use super::legend::legend;
use super::light::byte;
use super::memory::{Budget, Memory};
use super::ranked::Entered;
use super::raster::{Corner, Raster};
use super::request::{Picture, Scope};
use super::scene::{FINER, SUN_SAMPLES, Scene, Sun, ball};
use super::shape::{Batch, LEAST_BATCH_BYTES, Shape, TRIANGLE_BYTES, VERTEX_BYTES};
use super::visible::Visible;

/// Triangles of which is known together in which rows they are.
const TASK: usize = 1 << 9;
/// Strips of rows for each thread, and rows of the smallest.
const STRIPS: usize = 6;
const LEAST_ROWS: usize = 16;

impl Picture {
    /// Draws a mesh.
    ///
    /// A mesh that takes more memory than there may be used beside the picture is read in batches, several times.
    ///
    /// # Errors
    /// Those of [`check`](Self::check), [`PictureError::NoAttribute`], [`PictureError::Memory`] and [`PictureError::Io`].
    pub fn draw(&self, mesh: &dyn MeshSource) -> Result<Image, PictureError> {
        self.check()?;
        let values = Values::new(&self.colour, mesh)?;
        let (memory, budget) = self.memory_for(mesh)?;
        draw(self, &Shape::read(mesh, &values, &memory)?, &values, &budget)
    }

    /// The box of a mesh, and the range of the values that it would be coloured by.
    ///
    /// # Errors
    /// [`PictureError::NoAttribute`] and [`PictureError::Io`].
    pub fn scope_of(&self, mesh: &dyn MeshSource) -> Result<Scope, PictureError> {
        let values = Values::new(&self.colour, mesh)?;
        Ok(Shape::read(mesh, &values, &Memory::Batches(0))?.scope)
    }

    /// How a mesh fits in the memory that may be used, and what of that is left for what is seen of it.
    fn memory_for(&self, mesh: &dyn MeshSource) -> Result<(Memory, Budget), PictureError> {
        let allowed = self.memory.unwrap_or(u64::MAX);
        let [width, height] = self.pixels();
        let [vertices, triangles] = [mesh.vertex_count(), mesh.triangle_count()];
        let picture = Raster::bytes(FINER * width, FINER * height)
            + Raster::bytes(SUN_SAMPLES, SUN_SAMPLES)
            + 3 * (width * height) as u64
            + Entered::bytes(vertices)
            + Entered::bytes(triangles);
        let whole = vertices * VERTEX_BYTES + triangles * TRIANGLE_BYTES;
        // Of a mesh that is in memory all may be seen.
        let all_seen = vertices * Visible::VERTEX_BYTES + triangles * Visible::TRIANGLE_BYTES;
        if picture + whole + all_seen <= allowed {
            return Ok((Memory::Whole, Budget::new(picture + whole, allowed)));
        }
        let batch = (allowed.saturating_sub(picture) / 2).max(LEAST_BATCH_BYTES);
        let budget = Budget::new(picture + batch, allowed);
        budget.check(0)?;
        Ok((Memory::Batches(batch), budget))
    }
}

fn draw(
    picture: &Picture,
    shape: &Shape<'_>,
    values: &Values<'_>,
    budget: &Budget,
) -> Result<Image, PictureError> {
    let [width, height] = picture.pixels();
    let world = picture.world();
    let scope = picture.scope.unwrap_or(shape.scope);
    let bounds = scope.bounds.unwrap_or([[0.0; 3], [1.0; 3]]);
    let (middle, radius) = ball(bounds);
    let camera = Camera::new(picture.view, bounds, world, width as f64 / height as f64);
    let farthest = camera.eye.distance(middle) + radius;
    let raster = Raster::new(FINER * width, FINER * height, &camera, farthest);
    let sun = Sun::new(bounds, world, height);
    let mut corners = Vec::new();
    shape.batches(|batch| {
        fill(&raster, &camera, batch, &mut corners);
        fill(&sun.raster, &sun.camera, batch, &mut corners);
        Ok(())
    })?;
    drop(corners);
    let visible = Visible::of(&raster, shape, &camera, values, budget)?;
    let range = scope.range.unwrap_or([0.0, 1.0]);
    let legended = picture.colour.legend();
    let palette = legended.as_ref().map(|(_, map)| Palette::new(*map, range));
    let scene = Scene::new(picture, bounds, (&camera, &raster), &visible, &sun, palette);
    let mut rgb = vec![0; 3 * width * height];
    rgb.par_chunks_mut(3 * width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_mut(3).enumerate() {
            pixel.copy_from_slice(&scene.pixel(x, y).to_array().map(byte));
        }
    });
    let mut image = Image::new(width, height, rgb);
    if let Some((name, map)) = legended {
        legend(&mut image, name, map, range);
    }
    Ok(image)
}

/// Draws triangles on a raster: each thread in rows of its own, all of the triangles that may be there. `corners` is kept from one call to
/// the next for its memory.
fn fill(raster: &Raster, camera: &Camera, batch: &Batch<'_>, corners: &mut Vec<Corner>) {
    let seen = |n: usize| camera.seen(batch.places[n].into());
    (0..batch.places.len()).into_par_iter().map(|n| raster.corner(seen(n))).collect_into_vec(corners);
    let corners = &corners[..];
    // Neighbours in the mesh are neighbours on the picture, mostly.
    let reached = |triangles: &[[u32; 3]]| {
        let rows = triangles.iter().flatten().map(|&corner| corners[batch.index(corner)].rows());
        rows.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)).unwrap_or(0..0)
    };
    let reaches: Vec<Range<i32>> = batch.triangles.par_chunks(TASK).map(reached).collect();
    let height = raster.height as i32;
    let strip = raster.height.div_ceil(STRIPS * rayon::current_num_threads()).max(LEAST_ROWS);
    (0..height).into_par_iter().step_by(strip).for_each(|top| {
        let rows = top..height.min(top + strip as i32);
        let tasks = batch.triangles.chunks(TASK).zip(&reaches).enumerate();
        for (task, (triangles, _)) in
            tasks.filter(|(_, (_, reach))| reach.start < rows.end && rows.start < reach.end)
        {
            for (n, triangle) in triangles.iter().enumerate() {
                let at = triangle.map(|corner| batch.index(corner));
                let number = batch.first + (task * TASK + n) as u32;
                raster.draw(&rows, number, at.map(|n| corners[n]), || at.map(seen));
            }
        }
    });
}
