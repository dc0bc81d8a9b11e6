//! Computes the radiance of every pixel from the visible surface, the sunlight on it, and the
//! radiance behind it.

use glam::{DMat3, DVec3, Vec2, Vec3};

use crate::surface::mesh::source::Corners;

use super::camera::{Camera, ball};
use super::colour::{Colour, Palette};
use super::light::{ShadedPoint, backdrop, ground, linear, quick_exp, solid, water, wire};
use super::raster::{Raster, RasterSample};
use super::request::{Effort, Picture};
use super::sun::Sunlight;
use super::visible::{Edges, VisibleTriangles};

/// Maximum number of samples along the edge of a pixel.
const FINEST: usize = 2;
/// Number of samples along an edge of the sun's view; half as many for pictures with at most
/// [`SMALL`] rows.
const SUN_SAMPLES: usize = 1024;
const SMALL: usize = 400;
/// The floor fades into the backdrop between these distances from the middle, in radii of the
/// scene.
const FLOOR: [f32; 2] = [2.0, 7.0];
/// If the distances of a pixel's samples differ by at most this fraction, the samples are averaged
/// before the light is computed.
const ONE_DISTANCE: f32 = 0.01;
/// Width of wires in pixels.
const WIRE: f32 = 1.2;

/// Numbers of samples along edges: of a pixel, of the sun's view, and of the blur of its shadows.
#[derive(Debug, Clone, Copy)]
pub(super) struct SampleCounts {
    pub(super) of_pixel: usize,
    pub(super) of_sun: usize,
    pub(super) of_shadow: usize,
}

impl SampleCounts {
    /// The numbers for a picture with `rows` rows.
    pub(super) fn new(effort: Effort, rows: usize) -> Self {
        let of_sun = if rows <= SMALL { SUN_SAMPLES / 2 } else { SUN_SAMPLES };
        match effort {
            Effort::Full => Self { of_pixel: FINEST, of_sun, of_shadow: 3 },
            Effort::Draft => Self { of_pixel: 1, of_sun: of_sun / 2, of_shadow: 2 },
        }
    }
}

/// The data from which the light of each pixel is computed.
pub(super) struct Scene<'a> {
    picture: &'a Picture,
    camera: &'a Camera,
    raster: &'a Raster,
    /// Number of samples along the edge of a pixel.
    edge_samples: usize,
    visible: &'a VisibleTriangles,
    sun: &'a Sunlight,
    world: DMat3,
    middle: DVec3,
    /// Conversion from units of the raster to radii of the scene.
    radii: f32,
    /// Height of the floor, if there is one.
    floor: Option<f64>,
    palette: Option<Palette>,
}

impl<'a> Scene<'a> {
    /// Prepares a picture from its raster, its visible triangles and the sunlight.
    pub(super) fn new(
        picture: &'a Picture,
        [lo, hi]: Corners,
        (camera, raster): (&'a Camera, &'a Raster),
        visible: &'a VisibleTriangles,
        sun: &'a Sunlight,
        palette: Option<Palette>,
    ) -> Self {
        let world = picture.world();
        let (middle, radius) = ball([lo, hi]);
        let [lo, hi] = [lo, hi].map(|corner| world.y_axis.dot(corner.into()));
        let floor = picture.ground.then(|| lo.min(hi));
        let radii = (camera.distance() / radius) as f32;
        let edge_samples = raster.height / picture.pixels()[1];
        Self {
            picture,
            camera,
            raster,
            edge_samples,
            visible,
            sun,
            world,
            middle,
            radii,
            floor,
            palette,
        }
    }

    /// The radiance of a pixel: the mean over its samples.
    pub(super) fn pixel(&self, x: usize, y: usize) -> Vec3 {
        let edge_samples = self.edge_samples;
        let of_sample = |i: usize| {
            let [x, y] = [edge_samples * x + i % edge_samples, edge_samples * y + i / edge_samples];
            (self.raster.sample(y * self.raster.width + x), self.at(x as f32 + 0.5, y as f32 + 0.5))
        };
        let mut all = [(None, Vec2::ZERO); FINEST * FINEST];
        let samples = &mut all[..edge_samples * edge_samples];
        samples.iter_mut().enumerate().for_each(|(i, sample)| *sample = of_sample(i));
        let near =
            |&(sample, _): &(Option<RasterSample>, Vec2)| sample.map_or(0.0, |sample| sample.near);
        let first = near(&samples[0]);
        let one = samples.iter().all(|sample| (near(sample) - first).abs() <= ONE_DISTANCE * first);
        if samples.iter().all(|(sample, _)| sample.is_none()) {
            return self.empty(x, y);
        }
        let share = 1.0 / samples.len() as f32;
        let surfaces = samples.iter().map(|&(sample, towards)| {
            (
                sample.map_or(PixelSurface::default(), |sample| self.surface(sample, towards)),
                sample,
                towards,
            )
        });
        if one {
            let sum = surfaces
                .fold(PixelSurface::default(), |sum, (surface, ..)| sum.plus(&surface, share));
            let half = 0.5 * edge_samples as f32;
            let middle =
                self.at((edge_samples * x) as f32 + half, (edge_samples * y) as f32 + half);
            return self.light_exactly(&sum, middle);
        }
        let lights = surfaces.map(|(surface, sample, towards)| match sample {
            // Samples are averaged after clipping, so that a bright highlight does not hide the
            // edge next to it.
            Some(_) => self.light_exactly(&surface, towards).min(Vec3::ONE),
            None => self.behind(self.camera.eye, self.direction(towards)),
        });
        lights.sum::<Vec3>() * share
    }

    /// The direction towards a point of the picture, as components right, up and towards the
    /// viewer.
    fn direction(&self, towards: Vec2) -> Vec3 {
        self.unscaled_direction(towards).normalize()
    }

    /// Like [`direction`](Self::direction), but with a component of 1 along the viewing axis
    /// instead of unit length.
    fn unscaled_direction(&self, towards: Vec2) -> Vec3 {
        (self.world.transpose() * self.camera.towards(towards.x.into(), towards.y.into())).as_vec3()
    }

    /// The visible surface at a sample.
    fn surface(&self, sample: RasterSample, towards: Vec2) -> PixelSurface {
        let point = self.visible.point(sample.triangle, towards);
        let rows = (self.raster.height / self.edge_samples) as f32;
        let wire_share = self.picture.wireframe.then(|| {
            let Edges { nearest, radius } = self.visible.edges(sample.triangle, towards);
            let [nearest, radius] = [nearest, radius].map(|heights| heights * rows);
            // Wires fade on triangles that are smaller than the width of the wires.
            (0.5 * WIRE + 0.5 - nearest).clamp(0.0, 1.0) * (radius / WIRE).min(1.0)
        });
        PixelSurface {
            near: sample.near,
            normal: point.normal,
            value: point.value,
            through: sample.through,
            wire_share: wire_share.unwrap_or(0.0),
        }
    }

    /// The radiance of a pixel with one sample, without refraction. `behind` is the radiance behind
    /// the fluid.
    pub(super) fn sketched(&self, x: usize, y: usize, behind: Vec3) -> Vec3 {
        let Some(sample) = self.raster.sample(y * self.raster.width + x) else { return behind };
        let towards = self.at(x as f32 + 0.5, y as f32 + 0.5);
        self.light(&self.surface(sample, towards), towards, quick_exp, |_, _| behind)
    }

    /// The radiance of a pixel without the fluid.
    pub(super) fn empty(&self, x: usize, y: usize) -> Vec3 {
        let half = 0.5 * self.edge_samples as f32;
        let middle =
            self.at((self.edge_samples * x) as f32 + half, (self.edge_samples * y) as f32 + half);
        self.behind(self.camera.eye, self.direction(middle))
    }

    /// The position of a sample on the picture: to the right and up from the picture's middle, in
    /// units of the picture's height.
    fn at(&self, x: f32, y: f32) -> Vec2 {
        let [width, height] = [self.raster.width, self.raster.height].map(|samples| samples as f32);
        Vec2::new((x - width / 2.0) / height, 0.5 - y / height)
    }

    /// The radiance of a surface along a line of sight, with refraction.
    fn light_exactly(&self, surface: &PixelSurface, towards: Vec2) -> Vec3 {
        self.light(surface, towards, f32::exp, |place, bent| self.behind(place, bent))
    }

    /// The radiance of a surface along a line of sight. `exp` is the exponential function.
    /// `behind(place, direction)` returns the radiance behind the fluid on the line of sight that
    /// starts at `place` in the given direction.
    fn light(
        &self,
        surface: &PixelSurface,
        towards: Vec2,
        exp: impl Fn(f32) -> f32 + Copy,
        behind: impl Fn(DVec3, Vec3) -> Vec3,
    ) -> Vec3 {
        let line = self.camera.towards(towards.x.into(), towards.y.into());
        let unscaled = (self.world.transpose() * line).as_vec3();
        let direction = unscaled.normalize();
        let place = self.camera.eye + line * (self.camera.distance() / f64::from(surface.near));
        let normal =
            (self.world.transpose() * surface.normal.as_dvec3()).as_vec3().normalize_or(-direction);
        let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
        let through = (surface.through * unscaled.length() * self.radii).max(0.0);
        let point =
            ShadedPoint { towards: direction, normal, through, lit: self.sun.in_fluid(place, exp) };
        let light = match (&self.picture.colour, &self.palette) {
            (Colour::Solid(colour), _) => solid(linear(*colour), point),
            (_, Some(palette)) => solid(palette.of(surface.value), point),
            _ => water(point, exp, |bent| behind(place, bent)),
        };
        if surface.wire_share > 0.0 { wire(light, surface.wire_share) } else { light }
    }

    /// The radiance behind the fluid, which comes from the floor or the backdrop.
    fn behind(&self, from: DVec3, direction: Vec3) -> Vec3 {
        let Some(floor) = self.floor else { return backdrop(direction) };
        let above = self.world.y_axis.dot(from) - floor;
        if direction.y >= -1e-4 || above < 0.0 {
            return backdrop(direction);
        }
        let place = from + self.world * direction.as_dvec3() * (above / f64::from(-direction.y));
        let away = ((place - self.middle).length() / self.camera.distance()) as f32 * self.radii;
        let [near, far] = FLOOR;
        let share = ((away - near) / (far - near)).clamp(0.0, 1.0);
        if share >= 1.0 {
            return backdrop(direction);
        }
        let floor = ground(self.sun.on_ground(place));
        if share > 0.0 {
            floor.lerp(backdrop(direction), share * share * (3.0 - 2.0 * share))
        } else {
            floor
        }
    }
}

/// The visible surface at a sample, or its mean over the samples of a pixel.
#[derive(Debug, Clone, Copy, Default)]
struct PixelSurface {
    /// The eye's distance from the target, divided by the surface's distance in [camera
    /// coordinates](Camera::camera_coordinates).
    near: f32,
    /// The normal, which does not have unit length.
    normal: Vec3,
    value: f32,
    through: f32,
    /// The fraction of the surface that wires cover.
    wire_share: f32,
}

impl PixelSurface {
    fn plus(self, other: &Self, share: f32) -> Self {
        Self {
            near: self.near + share * other.near,
            normal: self.normal + other.normal,
            value: self.value + share * other.value,
            through: self.through + share * other.through,
            wire_share: self.wire_share + share * other.wire_share,
        }
    }
}
