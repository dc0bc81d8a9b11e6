//! The light of every pixel: what is seen there, how much of the sun gets to it, and what is behind it.

use glam::{DMat3, DVec3, Vec2, Vec3};

use crate::surface::mesh::bounds::Bounds;

use super::camera::Camera;
use super::colour::{Colour, Palette};
use super::light::{SUN, Seen, backdrop, ground, linear, solid, water, wire};
use super::raster::{Raster, Sample};
use super::request::Picture;
use super::visible::Visible;

/// Samples along the edge of a pixel.
pub(super) const FINER: usize = 2;
/// Samples along an edge of the sun's view: of large pictures, and of those of no more rows than that.
pub(super) const SUN_SAMPLES: usize = 1024;
const SMALL: usize = 400;
/// Distance of the sun's eye in radii: far enough for its rays to be parallel nearly.
const SUN_FAR: f64 = 40.0;
/// How fast sunlight dies in water, over the radius of the scene, and how thin a layer casts no shadow on itself.
const SUN_TAKEN: f32 = 5.0;
const SKIN: f32 = 0.012;
/// Where the floor ends in the backdrop, in radii from the middle.
const FLOOR: [f32; 2] = [2.0, 7.0];
/// Samples of a pixel are lit as one where their distances differ by less.
const ONE_DISTANCE: f32 = 0.01;
/// Width of wires in pixels.
const WIRE: f32 = 1.2;

/// The sun's view of the fluid, which tells how far its light gets.
pub(super) struct Sun {
    pub(super) camera: Camera,
    pub(super) raster: Raster,
    /// Radii of the scene in a unit of the raster.
    radii: f32,
}

impl Sun {
    /// The view of a box, for a picture of so many rows; nothing is drawn yet.
    pub(super) fn new([lo, hi]: Bounds, world: DMat3, rows: usize) -> Self {
        let (middle, radius) = ball([lo, hi]);
        let back = world * SUN.normalize().as_dvec3();
        let camera = Camera::far(middle, radius, SUN_FAR, back, world);
        let samples = if rows <= SMALL { SUN_SAMPLES / 2 } else { SUN_SAMPLES };
        let raster = Raster::new(samples, samples, &camera, (SUN_FAR + 1.0) * radius);
        Self { camera, raster, radii: SUN_FAR as f32 }
    }

    /// The share of the sun's light that gets to a place in the fluid, or on the ground where `below`.
    fn reaches(&self, place: DVec3, below: bool) -> f32 {
        let [x, y, distance] = self.camera.seen(place);
        let samples = self.raster.width;
        let side = samples as f64;
        let at = [x / distance + 0.5, 0.5 - y / distance].map(|share| share * side);
        if !at.iter().all(|at| (1.0..side - 1.0).contains(at)) {
            return 1.0;
        }
        let distance = (distance / self.camera.distance()) as f32;
        // Mean of what gets to nine samples around.
        let [column, row] = at.map(|at| at as usize);
        let mut sum = 0.0;
        for y in row - 1..=row + 1 {
            for x in column - 1..=column + 1 {
                sum += match self.raster.sample(y * samples + x) {
                    None => 1.0,
                    Some(sample) if below => {
                        let water = sample.through.max(0.0) * self.radii;
                        (-SUN_TAKEN * water).exp() * if water > 0.0 { 0.85 } else { 1.0 }
                    }
                    Some(sample) => {
                        let water = (distance - 1.0 / sample.near) * self.radii - SKIN;
                        if water > 0.0 { (-SUN_TAKEN * water).exp() } else { 1.0 }
                    }
                };
            }
        }
        sum / 9.0
    }
}

/// The middle and the radius of the ball around a box.
pub(super) fn ball(bounds: Bounds) -> (DVec3, f64) {
    let [lo, hi] = bounds.map(DVec3::from);
    ((lo + hi) / 2.0, ((hi - lo).length() / 2.0).max(f64::MIN_POSITIVE.sqrt()))
}

/// All that decides the light of a pixel.
pub(super) struct Scene<'a> {
    picture: &'a Picture,
    camera: &'a Camera,
    raster: &'a Raster,
    visible: &'a Visible,
    sun: &'a Sun,
    world: DMat3,
    middle: DVec3,
    /// Radii of the scene in a unit of the raster.
    radii: f32,
    /// Height of the floor, if there is one.
    floor: Option<f64>,
    palette: Option<Palette>,
}

impl<'a> Scene<'a> {
    /// A picture's view of what was drawn on its raster, and on the sun's.
    pub(super) fn new(
        picture: &'a Picture,
        [lo, hi]: Bounds,
        (camera, raster): (&'a Camera, &'a Raster),
        visible: &'a Visible,
        sun: &'a Sun,
        palette: Option<Palette>,
    ) -> Self {
        let world = picture.world();
        let (middle, radius) = ball([lo, hi]);
        let [lo, hi] = [lo, hi].map(|corner| world.y_axis.dot(corner.into()));
        let floor = picture.ground.then(|| lo.min(hi));
        let radii = (camera.distance() / radius) as f32;
        Self { picture, camera, raster, visible, sun, world, middle, radii, floor, palette }
    }

    /// The light of a pixel: the mean of its samples'.
    pub(super) fn pixel(&self, x: usize, y: usize) -> Vec3 {
        let [width, height] = [self.raster.width, self.raster.height].map(|samples| samples as f32);
        let at = |x: f32, y: f32| Vec2::new((x - width / 2.0) / height, 0.5 - y / height);
        let of_sample = |i: usize| {
            let [x, y] = [FINER * x + i % FINER, FINER * y + i / FINER];
            (self.raster.sample(y * self.raster.width + x), at(x as f32 + 0.5, y as f32 + 0.5))
        };
        let samples: [_; FINER * FINER] = std::array::from_fn(of_sample);
        let near = samples.map(|(sample, _)| sample.map_or(0.0, |sample| sample.near));
        let one = near.iter().all(|near_too| (near_too - near[0]).abs() <= ONE_DISTANCE * near[0]);
        let middle = at((FINER * x) as f32 + 1.0, (FINER * y) as f32 + 1.0);
        if near == [0.0; FINER * FINER] {
            return self.behind(self.camera.eye, self.direction(middle));
        }
        let mut all = [Surface::default(); FINER * FINER];
        let share = 1.0 / all.len() as f32;
        for (surface, (sample, towards)) in all.iter_mut().zip(samples) {
            if let Some(sample) = sample {
                *surface = self.surface(sample, towards);
            }
        }
        if one {
            return self.light(&all.iter().fold(Surface::default(), |sum, of| sum.plus(of, share)), middle);
        }
        let lights = all.iter().zip(samples).map(|(surface, (sample, towards))| match sample {
            // Samples are averaged as they will be shown, so that a glint does not eat the edge beside it.
            Some(_) => self.light(surface, towards).min(Vec3::ONE),
            None => self.behind(self.camera.eye, self.direction(towards)),
        });
        lights.sum::<Vec3>() * share
    }

    /// The direction in which a place of the picture is seen, in the axes right, up and towards of the world.
    fn direction(&self, towards: Vec2) -> Vec3 {
        self.shown(towards).normalize()
    }

    fn shown(&self, towards: Vec2) -> Vec3 {
        (self.world.transpose() * self.camera.towards(towards.x.into(), towards.y.into())).as_vec3()
    }

    /// The surface that is seen at a sample.
    fn surface(&self, sample: Sample, towards: Vec2) -> Surface {
        let spot = self.visible.spot(sample.triangle, towards);
        let rows = (self.raster.height / FINER) as f32;
        let inked = self.picture.wireframe.then(|| {
            let [edge, radius] = [spot.edge, spot.radius].map(|heights| heights * rows);
            // Of triangles that are smaller than their wires, the wires fade.
            (0.5 * WIRE + 0.5 - edge).clamp(0.0, 1.0) * (radius / WIRE).min(1.0)
        });
        Surface {
            near: sample.near,
            normal: spot.normal,
            value: spot.value,
            through: sample.through,
            inked: inked.unwrap_or(0.0),
        }
    }

    /// The light of a surface, on a line of sight.
    fn light(&self, surface: &Surface, towards: Vec2) -> Vec3 {
        let line = self.camera.towards(towards.x.into(), towards.y.into());
        let shown = (self.world.transpose() * line).as_vec3();
        let direction = shown.normalize();
        let place = self.camera.eye + line * (self.camera.distance() / f64::from(surface.near));
        let normal = (self.world.transpose() * surface.normal.as_dvec3()).as_vec3().normalize_or(-direction);
        let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
        let through = (surface.through * shown.length() * self.radii).max(0.0);
        let seen = Seen { towards: direction, normal, through, lit: self.sun.reaches(place, false) };
        let light = match (&self.picture.colour, &self.palette) {
            (Colour::Solid(colour), _) => solid(linear(*colour), seen),
            (_, Some(palette)) => solid(palette.of(surface.value), seen),
            _ => water(seen, |bent| self.behind(place, bent)),
        };
        if surface.inked > 0.0 { wire(light, surface.inked) } else { light }
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
        let away = ((place - self.middle).length() / self.camera.distance()) as f32 * self.radii;
        let [near, far] = FLOOR;
        let share = ((away - near) / (far - near)).clamp(0.0, 1.0);
        if share >= 1.0 {
            return backdrop;
        }
        let floor = ground(self.sun.reaches(place, true));
        floor.lerp(backdrop, share * share * (3.0 - 2.0 * share))
    }
}

/// A surface that light falls on.
#[derive(Debug, Clone, Copy, Default)]
struct Surface {
    /// One over the distance, in units of the eye's.
    near: f32,
    /// Not of unit length.
    normal: Vec3,
    value: f32,
    through: f32,
    /// The share that wires cover.
    inked: f32,
}

impl Surface {
    fn plus(self, other: &Self, share: f32) -> Self {
        Self {
            near: self.near + share * other.near,
            normal: self.normal + other.normal,
            value: self.value + share * other.value,
            through: self.through + share * other.through,
            inked: self.inked + share * other.inked,
        }
    }
}
