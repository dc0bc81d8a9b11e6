//! A mesh to an image: its box, what is seen of it, and light on every pixel.

use rayon::prelude::*;

use crate::surface::mesh::source::MeshSource;

use super::camera::Camera;
use super::colour::{Palette, Values};
use super::error::PictureError;
use super::image::Image;
use super::legend::legend;
use super::light::byte;
use super::ranked::Entered;
use super::raster::{Corner, Raster};
use super::request::{Picture, Scope};
use super::scene::{FINER, SUN_SAMPLES, Scene, Sun, ball};
use super::shape::{Batch, LEAST_BATCH_BYTES, Memory, Shape, TRIANGLE_BYTES, VERTEX_BYTES};
use super::visible::{VISIBLE_BYTES, Visible};

/// Triangles of a task.
const TASK: usize = 1 << 12;

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
        let shape = Shape::read(mesh, &values, &self.memory_for(mesh)?)?;
        draw(self, &shape, &values)
    }

    /// The box of a mesh, and the range of the values that it would be coloured by.
    ///
    /// # Errors
    /// [`PictureError::NoAttribute`] and [`PictureError::Io`].
    pub fn scope_of(&self, mesh: &dyn MeshSource) -> Result<Scope, PictureError> {
        let values = Values::new(&self.colour, mesh)?;
        Ok(Shape::read(mesh, &values, &Memory::Batches(0))?.scope)
    }

    /// How a mesh fits in the memory that may be used.
    fn memory_for(&self, mesh: &dyn MeshSource) -> Result<Memory, PictureError> {
        let Some(allowed) = self.memory else { return Ok(Memory::Whole) };
        let [width, height] = self.pixels();
        let samples = (FINER * FINER * width * height) as u64;
        let [vertices, triangles] = [mesh.vertex_count(), mesh.triangle_count()];
        let picture = Raster::bytes(FINER * width, FINER * height)
            + Raster::bytes(SUN_SAMPLES, SUN_SAMPLES)
            + 3 * (width * height) as u64;
        let seen =
            Entered::bytes(vertices) + Entered::bytes(triangles) + VISIBLE_BYTES * samples.min(triangles);
        let whole = vertices * VERTEX_BYTES + triangles * TRIANGLE_BYTES;
        let left = allowed.saturating_sub(picture + seen);
        if whole <= left {
            return Ok(Memory::Whole);
        }
        if left < LEAST_BATCH_BYTES {
            return Err(PictureError::Memory {
                needed: picture + seen + LEAST_BATCH_BYTES.min(whole),
                allowed,
            });
        }
        Ok(Memory::Batches(left))
    }
}

fn draw(picture: &Picture, shape: &Shape<'_>, values: &Values<'_>) -> Result<Image, PictureError> {
    let [width, height] = picture.pixels();
    let world = picture.world();
    let scope = picture.scope.unwrap_or(shape.scope);
    let bounds = scope.bounds.unwrap_or([[0.0; 3], [1.0; 3]]);
    let (middle, radius) = ball(bounds);
    let camera = Camera::new(picture.view, bounds, world, width as f64 / height as f64);
    let farthest = camera.eye.distance(middle) + radius;
    let raster = Raster::new(FINER * width, FINER * height, &camera, farthest);
    let sun = Sun::new(bounds, world, height);
    shape.batches(|batch| {
        fill(&raster, &camera, batch);
        fill(&sun.raster, &sun.camera, batch);
        Ok(())
    })?;
    let visible = Visible::of(&raster, shape, &camera, values)?;
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

/// Draws triangles on a raster.
fn fill(raster: &Raster, camera: &Camera, batch: &Batch<'_>) {
    let seen = |n: usize| camera.seen(batch.places[n].into());
    let corners: Vec<Corner> =
        (0..batch.places.len()).into_par_iter().map(|n| raster.corner(seen(n))).collect();
    batch.triangles.par_chunks(TASK).enumerate().for_each(|(task, triangles)| {
        for (n, triangle) in triangles.iter().enumerate() {
            let at = triangle.map(|corner| batch.index(corner));
            let number = batch.first + (task * TASK + n) as u32;
            raster.draw(number, at.map(|n| corners[n]), || at.map(seen));
        }
    });
}
