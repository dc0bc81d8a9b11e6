//! Sunlight on and below the fluid, computed from the sun's view (a shadow map, Williams 1978).

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::surface::mesh::source::Corners;

use super::camera::{Camera, ball};
use super::light::SUN;
use super::raster::Raster;

/// Distance of the sun's eye, in radii of the scene: far enough for almost parallel rays.
const SUN_FAR: f64 = 40.0;
/// Absorption of sunlight by water, per radius of the scene.
const SUN_ABSORPTION: f32 = 5.0;
/// Thickness, in radii of the scene, of a layer that casts no shadow on itself.
const UNSHADED_DEPTH: f32 = 0.012;

/// The sun's view of the fluid.
pub(super) struct SunView {
    pub(super) camera: Camera,
    pub(super) raster: Raster,
    /// Conversion from units of the raster to radii of the scene.
    radii: f32,
}

impl SunView {
    /// An empty view of a box, with `samples` samples along each edge.
    pub(super) fn new([lo, hi]: Corners, world: DMat3, samples: usize) -> Self {
        let (middle, radius) = ball([lo, hi]);
        let back = world * SUN.normalize().as_dvec3();
        let camera = Camera::far(middle, radius, SUN_FAR, back, world);
        let raster = Raster::new(samples, samples, &camera, (SUN_FAR + 1.0) * radius);
        Self { camera, raster, radii: SUN_FAR as f32 }
    }

    /// Computes the sunlight after the fluid has been drawn.
    ///
    /// Shadows are blurred over squares with `blurred` samples along each edge.
    pub(super) fn light(self, blurred: usize) -> Sunlight {
        let Self { camera, raster, radii } = self;
        let of_sample = |n: usize| match raster.sample(n) {
            None => (f32::INFINITY, 1.0),
            Some(sample) => {
                let water = sample.through.max(0.0) * radii;
                (
                    1.0 / sample.near,
                    (-SUN_ABSORPTION * water).exp() * if water > 0.0 { 0.85 } else { 1.0 },
                )
            }
        };
        let samples = raster.width;
        let (distances, below) =
            (0..samples * samples).into_par_iter().with_min_len(samples).map(of_sample).unzip();
        Sunlight { camera, samples, blurred, radii, distances, below }
    }
}

/// Sunlight on and below the fluid.
pub(super) struct Sunlight {
    camera: Camera,
    /// Number of samples along an edge of the sun's view.
    samples: usize,
    /// Number of samples along an edge of the squares over which shadows are blurred.
    blurred: usize,
    radii: f32,
    /// For each sample, the distance of the surface, in units of the eye's distance from the
    /// target; infinite if there is no surface.
    distances: Vec<f32>,
    /// For each sample, the fraction of the light that passes through all of the fluid.
    below: Vec<f32>,
}

impl Sunlight {
    /// Memory, in bytes, of the sunlight for a view with `samples` samples along each edge.
    pub(super) fn bytes(samples: usize) -> u64 {
        (samples * samples * 2 * size_of::<f32>()) as u64
    }

    /// The fraction of the sunlight that reaches a place in the fluid; `exp` is the exponential
    /// function.
    pub(super) fn in_fluid(&self, place: DVec3, exp: impl Fn(f32) -> f32) -> f32 {
        self.mean(place, &self.distances, |surface, distance| {
            let water = (distance - surface) * self.radii - UNSHADED_DEPTH;
            if water > 0.0 { exp(-SUN_ABSORPTION * water) } else { 1.0 }
        })
    }

    /// The fraction of the sunlight that reaches a place on the ground.
    pub(super) fn on_ground(&self, place: DVec3) -> f32 {
        self.mean(place, &self.below, |share, _| share)
    }

    /// The mean over the samples around a place.
    fn mean(&self, place: DVec3, of: &[f32], share: impl Fn(f32, f32) -> f32) -> f32 {
        let [x, y, distance] = self.camera.camera_coordinates(place);
        let side = self.samples as f64;
        let at = [x / distance + 0.5, 0.5 - y / distance].map(|share| share * side);
        if !at.iter().all(|at| (1.0..side - 1.0).contains(at)) {
            return 1.0;
        }
        let distance = (distance / self.camera.distance()) as f32;
        let blurred = self.blurred;
        let [column, row] = at.map(|at| (at - 0.5 * (blurred as f64 - 1.0)) as usize);
        let rows = (row..row + blurred).map(|row| &of[row * self.samples + column..][..blurred]);
        rows.flatten().fold(0.0, |sum, &of| sum + share(of, distance)) / (blurred * blurred) as f32
    }
}
