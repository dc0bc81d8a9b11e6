//! Draws a mesh: finds its bounding box, its visible triangles, and the radiance of every pixel.

use glam::Vec3;
use rayon::prelude::*;

use crate::surface::mesh::source::MeshSource;

use super::camera::{Camera, ball};
use super::colour::legend;
use super::colour::{ColourSource, Palette};
use super::fill::fill;
use super::image::Image;
use super::light::Sketch;
use super::light::byte;
use super::ranked::AtomicSet;
use super::raster::Raster;
use super::raster::{Canvas, ProjectedCorners};
use super::request::PictureError;
use super::request::{Budget, MeshMemory};
use super::request::{Effort, Picture, Scope};
use super::scene::{SampleCounts, Scene};
use super::shape::{LEAST_BATCH_BYTES, Shape, TRIANGLE_BYTES, VERTEX_BYTES};
use super::sun::{SunView, Sunlight};
use super::visible::VisibleTriangles;

/// A draft uses a coarser mesh if the mesh has more than this number of vertices per pixel.
const COARSENED: u64 = 2;

impl Picture {
    /// Draws a mesh.
    ///
    /// A mesh that exceeds the memory limit is read in batches, several times.
    ///
    /// # Errors
    /// The errors of [`check`](Self::check), [`PictureError::NoAttribute`],
    /// [`PictureError::Memory`] and [`PictureError::Io`].
    pub fn draw(&self, mesh: &dyn MeshSource) -> Result<Image, PictureError> {
        self.check()?;
        let values = ColourSource::new(&self.colour, mesh)?;
        let [width, height] = self.pixels();
        let fine = mesh.vertex_count() > COARSENED * (width * height) as u64;
        let coarsened =
            self.effort == Effort::Draft && fine && !values.has_values() && !self.wireframe;
        let coarser = if coarsened { mesh.coarser()? } else { None };
        let mesh = coarser.as_deref().unwrap_or(mesh);
        let (memory, budget) = self.memory_for(mesh)?;
        draw(self, &Shape::read(mesh, &values, &memory)?, &values, &budget)
    }

    /// The bounding box of a mesh, and the range of its coloured values.
    ///
    /// # Errors
    /// [`PictureError::NoAttribute`] and [`PictureError::Io`].
    pub fn scope_of(&self, mesh: &dyn MeshSource) -> Result<Scope, PictureError> {
        let values = ColourSource::new(&self.colour, mesh)?;
        Ok(Shape::read(mesh, &values, &MeshMemory::Batches(0))?.scope)
    }

    /// Decides whether the whole mesh or only batches of it are held in memory, and how much memory
    /// remains for the visible part of the mesh.
    fn memory_for(&self, mesh: &dyn MeshSource) -> Result<(MeshMemory, Budget), PictureError> {
        let allowed = self.memory.unwrap_or(u64::MAX);
        let [width, height] = self.pixels();
        let [vertices, triangles] = [mesh.vertex_count(), mesh.triangle_count()];
        let SampleCounts { of_pixel, of_sun, .. } = SampleCounts::new(self.effort, height);
        let picture = Raster::bytes(of_pixel * width, of_pixel * height)
            + Raster::bytes(of_sun, of_sun)
            + Sunlight::bytes(of_sun)
            + 3 * (width * height) as u64
            + AtomicSet::bytes(vertices)
            + AtomicSet::bytes(triangles);
        let whole = vertices * VERTEX_BYTES + triangles * TRIANGLE_BYTES;
        // All vertices and triangles of a mesh may be visible.
        let all_visible = vertices * VisibleTriangles::VERTEX_BYTES
            + triangles * VisibleTriangles::TRIANGLE_BYTES;
        if picture + whole + all_visible <= allowed {
            return Ok((MeshMemory::Whole, Budget::new(picture + whole, allowed)));
        }
        let batch = (allowed.saturating_sub(picture) / 2).max(LEAST_BATCH_BYTES);
        let budget = Budget::new(picture + batch, allowed);
        budget.check(0)?;
        Ok((MeshMemory::Batches(batch), budget))
    }
}

fn draw(
    picture: &Picture,
    shape: &Shape<'_>,
    values: &ColourSource<'_>,
    budget: &Budget,
) -> Result<Image, PictureError> {
    let [width, height] = picture.pixels();
    let world = picture.world();
    let scope = picture.scope.unwrap_or(shape.scope);
    let bounds = scope.bounds.unwrap_or([[0.0; 3], [1.0; 3]]);
    let (middle, radius) = ball(bounds);
    let camera = Camera::new(picture.view, bounds, world, width as f64 / height as f64);
    let farthest = camera.eye.distance(middle) + radius;
    let SampleCounts { of_pixel, of_sun, of_shadow } = SampleCounts::new(picture.effort, height);
    let raster = Raster::new(of_pixel * width, of_pixel * height, &camera, farthest);
    let sun = SunView::new(bounds, world, of_sun);
    let canvases = [
        Canvas { raster: &raster, camera: &camera },
        Canvas { raster: &sun.raster, camera: &sun.camera },
    ];
    let mut corners = ProjectedCorners::with_room(shape.most_corners());
    shape.batches(|batch| {
        fill(canvases, batch, &mut corners);
        Ok(())
    })?;
    drop(corners);
    let sun = sun.light(of_shadow);
    let visible = VisibleTriangles::of(&raster, shape, &camera, values, budget)?;
    let range = scope.range.unwrap_or([0.0, 1.0]);
    let legended = picture.colour.legend();
    let palette = legended.as_ref().map(|(_, map)| Palette::new(*map, range));
    let scene = Scene::new(picture, bounds, (&camera, &raster), &visible, &sun, palette);
    let rgb = match picture.effort {
        Effort::Full => bytes([width, height], |x, y| scene.pixel(x, y)),
        Effort::Draft => {
            let empty = Sketch::new(width, height, |x, y| scene.empty(x, y));
            bytes([width, height], |x, y| scene.sketched(x, y, empty.at(x, y)))
        }
    };
    let mut image = Image::new(width, height, rgb);
    if let Some((name, map)) = legended {
        legend(&mut image, name, map, range, scope.beyond);
    }
    Ok(image)
}

/// The bytes of all pixels.
fn bytes([width, height]: [usize; 2], light: impl Fn(usize, usize) -> Vec3 + Sync) -> Vec<u8> {
    let mut rgb = vec![0; 3 * width * height];
    rgb.par_chunks_mut(3 * width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_mut(3).enumerate() {
            pixel.copy_from_slice(&light(x, y).to_array().map(byte));
        }
    });
    rgb
}
