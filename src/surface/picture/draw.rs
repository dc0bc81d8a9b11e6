//! A mesh to an image: its corners as they are seen, the raster, light on every sample, and the legend.

use std::io;

use embedded_graphics::text::Alignment;
use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;

use crate::surface::mesh::bounds::Bounds;
use crate::surface::mesh::source::MeshSource;

use super::camera::Camera;
use super::colour::{Colour, ColourMap, Palette, values_of};
use super::error::PictureError;
use super::image::Image;
use super::light::{SUN, Seen, backdrop, byte, ground, linear, solid, water};
use super::raster::{Corner, Raster, Sample};
use super::request::{Picture, Scope};

/// Samples along the edge of a pixel.
const FINER: usize = 2;
/// Samples along an edge of the sun's view.
const SUN_SAMPLES: usize = 1024;
/// Bytes of a vertex: its place, its normal and value, and as it is seen.
const VERTEX_BYTES: u64 =
    (size_of::<[f64; 3]>() + size_of::<Corner>() + size_of::<Vec3>() + size_of::<f32>()) as u64;
const TRIANGLE_BYTES: u64 = size_of::<[u32; 3]>() as u64;
/// Triangles that are drawn at once.
const BATCH: usize = 1 << 20;
/// Distance of the sun's eye in radii: far enough for its rays to be parallel nearly.
const SUN_FAR: f64 = 40.0;
/// How fast sunlight dies in water, over the radius of the scene, and how thin a layer casts no shadow on itself.
const SUN_TAKEN: f32 = 5.0;
const SKIN: f32 = 0.012;
/// Where the floor ends in the backdrop, in radii from the middle.
const FLOOR: [f32; 2] = [2.0, 7.0];
/// Samples of a pixel are lit as one where their distances differ by less, and their normals by no more than about 20 degrees.
const ONE_DISTANCE: f32 = 0.01;
const ONE_NORMAL: f32 = 0.94;

/// A mesh's vertices and triangles as drawing wants them.
struct Shape {
    places: Vec<[f64; 3]>,
    normals: Vec<Vec3>,
    values: Vec<f32>,
    triangles: Vec<[u32; 3]>,
}

impl Picture {
    /// Draws a mesh.
    ///
    /// # Errors
    /// Those of [`check`](Self::check), [`PictureError::NoAttribute`], [`PictureError::Memory`] and [`PictureError::Io`].
    pub fn draw(&self, mesh: &dyn MeshSource) -> Result<Image, PictureError> {
        self.check()?;
        let scope = match self.scope {
            Some(scope) => scope,
            None => self.scope_of(mesh)?,
        };
        let needed = self.bytes(mesh.vertex_count(), mesh.triangle_count());
        if let Some(allowed) = self.memory.filter(|&allowed| allowed < needed) {
            return Err(PictureError::Memory { needed, allowed });
        }
        draw(self, mesh, scope)
    }

    /// Bytes that a picture of so many vertices and triangles takes.
    fn bytes(&self, vertices: u64, triangles: u64) -> u64 {
        let [width, height] = self.pixels();
        Raster::bytes(FINER * width, FINER * height)
            + Raster::bytes(SUN_SAMPLES, SUN_SAMPLES)
            + 3 * (width * height) as u64
            + vertices * VERTEX_BYTES
            + triangles * TRIANGLE_BYTES
    }
}

fn draw(picture: &Picture, mesh: &dyn MeshSource, scope: Scope) -> Result<Image, PictureError> {
    let [width, height] = picture.pixels();
    let world = picture.world();
    let bounds = scope.bounds.unwrap_or([[0.0; 3], [1.0; 3]]);
    let shape = shape_of(picture, mesh)?;
    let camera = Camera::new(picture.view, bounds, world, width as f64 / height as f64);
    let mut raster = Raster::new(FINER * width, FINER * height, camera.nearest() as f32);
    fill(&mut raster, &shape, &camera);
    let sun = Sun::new(&shape, bounds, world);
    let range = scope.range.unwrap_or([0.0, 1.0]);
    let palette = match &picture.colour {
        Colour::Attribute { map, .. } => Some(Palette::new(*map, range)),
        _ => None,
    };
    let scene = Scene::new(picture, &camera, &sun, bounds, world, palette);
    let mut rgb = vec![0; 3 * width * height];
    rgb.par_chunks_mut(3 * width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_mut(3).enumerate() {
            let light = scene.pixel(&raster, x, y);
            pixel.copy_from_slice(&light.to_array().map(byte));
        }
    });
    let mut image = Image::new(width, height, rgb);
    if let Colour::Attribute { name, map } = &picture.colour {
        legend(&mut image, name, *map, range);
    }
    Ok(image)
}

fn shape_of(picture: &Picture, mesh: &dyn MeshSource) -> Result<Shape, PictureError> {
    let outline = mesh.outline();
    let vertices = outline.vertices as usize;
    if u32::try_from(vertices).is_err() {
        let what = format!("a picture is drawn of no more than {} vertices", u32::MAX);
        return Err(io::Error::new(io::ErrorKind::InvalidInput, what).into());
    }
    let mut shape = Shape {
        places: Vec::with_capacity(vertices),
        normals: Vec::with_capacity(vertices),
        values: Vec::new(),
        triangles: Vec::with_capacity(outline.triangles as usize),
    };
    for piece in 0..outline.pieces {
        let vertices = mesh.vertices(piece)?;
        shape.places.extend_from_slice(&vertices.positions);
        shape.normals.extend(vertices.normals.iter().map(|&normal| Vec3::from(normal)));
        values_of(&picture.colour, mesh, &vertices, &mut shape.values)?;
        // A file may name vertices that it does not have.
        let triangles = mesh.triangles(piece)?;
        let sound =
            triangles.iter().filter(|corners| corners.iter().all(|&corner| corner < outline.vertices));
        shape.triangles.extend(sound.map(|corners| corners.map(|corner| corner as u32)));
    }
    if shape.normals.len() < shape.places.len() {
        shape.normals = normals(&shape);
    }
    Ok(shape)
}

/// Normals of the triangles around each vertex, by their areas; not of unit length.
fn normals(shape: &Shape) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; shape.places.len()];
    for corners in &shape.triangles {
        let [a, b, c] = corners.map(|corner| DVec3::from(shape.places[corner as usize]));
        let normal = (b - a).cross(c - a).as_vec3();
        for &corner in corners {
            normals[corner as usize] += normal;
        }
    }
    normals
}

fn fill(raster: &mut Raster, shape: &Shape, camera: &Camera) {
    let across = raster.height as f64 / raster.width as f64;
    let corners: Vec<Corner> = (0..shape.places.len())
        .into_par_iter()
        .map(|n| {
            let [x, y, distance] = camera.seen(shape.places[n].into());
            Corner {
                at: [(2.0 * x * across) as f32, (2.0 * y) as f32, distance as f32],
                normal: shape.normals[n].normalize_or_zero(),
                value: shape.values.get(n).copied().unwrap_or(0.0),
            }
        })
        .collect();
    for triangles in shape.triangles.chunks(BATCH) {
        raster.draw(&corners, triangles);
    }
}

/// The sun's view of the fluid, which tells how far its light gets.
struct Sun {
    camera: Camera,
    raster: Raster,
    radius: f32,
}

impl Sun {
    fn new(shape: &Shape, [lo, hi]: Bounds, world: DMat3) -> Self {
        let (lo, hi) = (DVec3::from(lo), DVec3::from(hi));
        let radius = ((hi - lo).length() / 2.0).max(f64::MIN_POSITIVE);
        let back = world * SUN.normalize().as_dvec3();
        let camera = Camera::far((lo + hi) / 2.0, radius, SUN_FAR, back, world);
        let mut raster = Raster::new(SUN_SAMPLES, SUN_SAMPLES, camera.nearest() as f32);
        fill(&mut raster, shape, &camera);
        Self { camera, raster, radius: radius as f32 }
    }

    /// The share of the sun's light that gets to a place in the fluid, or on the ground where `below`.
    fn reaches(&self, place: DVec3, below: bool) -> f32 {
        let [x, y, distance] = self.camera.seen(place);
        let side = SUN_SAMPLES as f64;
        let at = [x / distance + 0.5, 0.5 - y / distance].map(|share| share * side);
        if at.iter().any(|&at| !(1.0..side - 1.0).contains(&at)) {
            return 1.0;
        }
        // Mean of what gets to nine samples around.
        let [column, row] = at.map(|at| at as usize);
        let mut sum = 0.0;
        for y in row - 1..=row + 1 {
            for sample in &self.raster.samples[y * SUN_SAMPLES + column - 1..][..3] {
                let water = match sample.near {
                    0.0 => 0.0,
                    _ if below => sample.through.max(0.0) / self.radius,
                    near => ((distance as f32 - 1.0 / near.abs()) / self.radius - SKIN).max(0.0),
                };
                sum += (-SUN_TAKEN * water).exp() * if below && water > 0.0 { 0.85 } else { 1.0 };
            }
        }
        sum / 9.0
    }
}

/// All that decides the light of a pixel.
struct Scene<'a> {
    picture: &'a Picture,
    camera: &'a Camera,
    sun: &'a Sun,
    world: DMat3,
    middle: DVec3,
    radius: f32,
    /// Height of the floor, if there is one.
    floor: Option<f64>,
    palette: Option<Palette>,
}

impl<'a> Scene<'a> {
    fn new(
        picture: &'a Picture,
        camera: &'a Camera,
        sun: &'a Sun,
        [lo, hi]: Bounds,
        world: DMat3,
        palette: Option<Palette>,
    ) -> Self {
        let [lo, hi] = [lo, hi].map(DVec3::from);
        let floor = picture.ground.then(|| world.y_axis.dot(lo).min(world.y_axis.dot(hi)));
        Self { picture, camera, sun, world, middle: (lo + hi) / 2.0, radius: sun.radius, floor, palette }
    }

    /// The light of a pixel: the mean of its samples'.
    fn pixel(&self, raster: &Raster, x: usize, y: usize) -> Vec3 {
        let width = raster.width;
        let samples: [Sample; FINER * FINER] =
            std::array::from_fn(|i| raster.samples[(FINER * y + i / FINER) * width + FINER * x + i % FINER]);
        let at = |x: f64, y: f64| {
            let height = raster.height as f64;
            self.camera.towards((x - width as f64 / 2.0) / height, 0.5 - y / height)
        };
        let samples = without_cracks(samples);
        let [first, ..] = samples;
        let one = samples.iter().all(|sample| {
            let apart = (sample.near - first.near).abs() <= ONE_DISTANCE * first.near;
            apart && (first.near == 0.0 || sample.normal.dot(first.normal) >= ONE_NORMAL)
        });
        if one {
            let mean = Sample {
                near: samples.iter().map(|sample| sample.near).sum::<f32>() / samples.len() as f32,
                normal: samples.iter().map(|sample| sample.normal).sum(),
                value: samples.iter().map(|sample| sample.value).sum::<f32>() / samples.len() as f32,
                through: samples.iter().map(|sample| sample.through).sum::<f32>() / samples.len() as f32,
            };
            return self.light(&mean, at((FINER * x) as f64 + 1.0, (FINER * y) as f64 + 1.0));
        }
        let lights = samples.iter().enumerate().map(|(i, sample)| {
            let towards = at((FINER * x + i % FINER) as f64 + 0.5, (FINER * y + i / FINER) as f64 + 0.5);
            // Samples are averaged as they will be shown, so that a glint does not eat the edge beside it.
            self.light(sample, towards).min(Vec3::ONE)
        });
        lights.sum::<Vec3>() / samples.len() as f32
    }

    /// The light of a sample, on a line from the eye that goes a distance of 1 forward.
    fn light(&self, sample: &Sample, towards: DVec3) -> Vec3 {
        let shown = (self.world.transpose() * towards).as_vec3();
        let direction = shown.normalize();
        if sample.near == 0.0 {
            return self.behind(self.camera.eye, direction);
        }
        let place = self.camera.eye + towards / f64::from(sample.near.abs());
        let normal = (self.world.transpose() * sample.normal.as_dvec3()).as_vec3().normalize_or(-direction);
        let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
        let through = (sample.through * shown.length() / self.radius).max(0.0);
        let seen = Seen { towards: direction, normal, through, lit: self.sun.reaches(place, false) };
        match (&self.picture.colour, &self.palette) {
            (Colour::Solid(colour), _) => solid(linear(*colour), seen),
            (_, Some(palette)) => solid(palette.of(sample.value), seen),
            _ => water(seen, |bent| self.behind(place, bent)),
        }
    }

    /// The light from behind all fluid: of the floor and the backdrop.
    fn behind(&self, from: DVec3, direction: Vec3) -> Vec3 {
        let backdrop = backdrop(direction);
        let Some(floor) = self.floor else { return backdrop };
        let above = self.world.y_axis.dot(from) - floor;
        if direction.y >= -1e-4 || above < 0.0 {
            return backdrop;
        }
        let place = from + self.world * direction.as_dvec3() * (above / f64::from(-direction.y));
        let away = (place - self.middle).length() as f32 / self.radius;
        let [near, far] = FLOOR;
        let share = ((away - near) / (far - near)).clamp(0.0, 1.0);
        if share >= 1.0 {
            return backdrop;
        }
        let floor = ground(self.sun.reaches(place, true));
        floor.lerp(backdrop, share * share * (3.0 - 2.0 * share))
    }
}

/// The samples of a pixel, without those that see the inside of the fluid through the rounding between two triangles.
fn without_cracks(samples: [Sample; FINER * FINER]) -> [Sample; FINER * FINER] {
    let outside = samples.into_iter().find(|sample| sample.near > 0.0);
    samples.map(|sample| match outside {
        Some(outside) if sample.near < 0.0 && outside.near > -sample.near => outside,
        _ => sample,
    })
}

/// The colours of the values, at the right edge.
fn legend(image: &mut Image, name: &str, map: ColourMap, [lo, hi]: [f32; 2]) {
    let (width, height) = (image.width() as i32, image.height() as i32);
    let line = image.line();
    let (bar, long) = (line, height / 3);
    let (left, top) = (width - 2 * line - bar, (height - long) / 2);
    for y in 0..long {
        let colour = map.of(1.0 - (y as f32 + 0.5) / long as f32);
        for x in 0..bar {
            if let (Ok(x), Ok(y)) = (usize::try_from(left + x), usize::try_from(top + y)) {
                image.set(x, y, colour);
            }
        }
    }
    image.text(name, [left + bar, top - 2 * line], Alignment::Right);
    for (share, value) in [(0, hi), (1, (lo + hi) / 2.0), (2, lo)] {
        let y = top + long * share / 2 - line / 2;
        image.text(&format!("{value:.3}"), [left - line / 2, y], Alignment::Right);
    }
}
