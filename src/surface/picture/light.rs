//! Computes the radiance of the sky, the ground and a surface of water, of a solid colour or of a
//! colour map, under a soft sky and a sun. Colours are linear.

use std::sync::LazyLock;

use glam::Vec3;
use rayon::prelude::*;

/// The direction of the sun, with the components right, up and towards the viewer.
pub(super) const SUN: Vec3 = Vec3::new(-0.42, 0.78, 0.46);
const SUNLIGHT: Vec3 = Vec3::new(1.05, 1.0, 0.92);
/// Diffuse light from the sky overhead.
const SKY_DIFFUSE: Vec3 = Vec3::new(0.62, 0.70, 0.80);
/// Diffuse light from the ground.
const GROUND_DIFFUSE: Vec3 = Vec3::new(0.34, 0.33, 0.31);
/// The radiance of the sky at the horizon, in reflections.
const HORIZON: Vec3 = Vec3::new(0.92, 0.95, 0.97);
/// The radiance of the sky overhead, in reflections.
const ZENITH: Vec3 = Vec3::new(0.30, 0.50, 0.80);
/// The colour of the ground.
pub(super) const GROUND: Vec3 = Vec3::new(0.50, 0.50, 0.49);
/// The radiance of the backdrop: overhead, at the horizon, and below.
const BACKDROP: [Vec3; 3] =
    [Vec3::new(0.44, 0.51, 0.58), Vec3::new(0.78, 0.81, 0.83), Vec3::new(0.44, 0.45, 0.46)];
/// Colour of wires.
const WIRE_COLOUR: Vec3 = Vec3::new(0.01, 0.012, 0.015);
/// The reflectance of water at normal incidence (Schlick 1994, index of refraction 1.33).
const NORMAL_REFLECTANCE: f32 = 0.02;
const REFRACTION: f32 = 1.0 / 1.33;
/// Absorption of light by water, per radius of the scene. This is the radius of the ball around the
/// bounding box.
const ABSORPTION: Vec3 = Vec3::new(9.0, 2.6, 1.1);
/// Radiance that deep water adds by scattering.
const SCATTERED: Vec3 = Vec3::new(0.004, 0.105, 0.26);
/// The rate at which the added radiance increases with the path length, per radius of the scene.
const SCATTERING_RATE: f32 = 6.0;
/// Diffuse reflection of water, for a film and for deep water. Without diffuse reflection, drops,
/// thin sheets and the shape of the water would be invisible.
const DIFFUSE: [f32; 2] = [0.34, 0.42];
const DIFFUSE_COLOUR: Vec3 = Vec3::new(0.10, 0.38, 0.66);

/// A place on a surface, as seen along a line of sight.
#[derive(Debug, Clone, Copy)]
pub(super) struct ShadedPoint {
    /// The direction from the eye. All directions in this module have unit length.
    pub(super) towards: Vec3,
    /// The outward normal.
    pub(super) normal: Vec3,
    /// The path length through the fluid behind the place, in radii of the scene.
    pub(super) through: f32,
    /// The fraction of the sunlight that reaches the place.
    pub(super) lit: f32,
}

/// The radiance of the backdrop in the direction `towards`.
pub(super) fn backdrop(towards: Vec3) -> Vec3 {
    let [above, level, below] = BACKDROP;
    let up = towards.y;
    if up >= 0.0 {
        level.lerp(above, up.powf(0.6).min(1.0))
    } else {
        level.lerp(below, (-up).powf(0.6).min(1.0))
    }
}

/// The radiance of the sky in the direction `towards`, including the sun's glow.
fn sky(towards: Vec3) -> Vec3 {
    let up = towards.y;
    let sky = if up >= 0.0 {
        HORIZON.lerp(ZENITH, up.sqrt())
    } else {
        HORIZON.lerp(GROUND_DIFFUSE, (-up * 3.0).min(1.0))
    };
    let near = towards.dot(SUN.normalize()).max(0.0);
    sky + SUNLIGHT * (1.6 * near.powi(180) + 0.25 * near.powi(12))
}

/// The light that falls on a diffuse surface from the sky, the ground and the sun.
fn diffuse_light(normal: Vec3, lit: f32) -> Vec3 {
    let ambient = GROUND_DIFFUSE.lerp(SKY_DIFFUSE, 0.5 + 0.5 * normal.y);
    ambient * 0.75 + SUNLIGHT * (0.65 * lit * normal.dot(SUN.normalize()).max(0.0))
}

/// The radiance of flat ground; `lit` is the fraction of the sunlight that reaches it.
pub(super) fn ground(lit: f32) -> Vec3 {
    GROUND * diffuse_light(Vec3::Y, lit)
}

/// The radiance of a surface of one colour.
pub(super) fn solid(colour: Vec3, point: ShadedPoint) -> Vec3 {
    let half = (SUN.normalize() - point.towards).normalize();
    let gloss = point.normal.dot(half).max(0.0).powi(60);
    colour * diffuse_light(point.normal, point.lit) + SUNLIGHT * (0.12 * gloss * point.lit)
}

/// The radiance of water. `behind` returns the radiance behind the water in a direction; `exp` is
/// the exponential function.
pub(super) fn water(
    point: ShadedPoint,
    exp: impl Fn(f32) -> f32,
    behind: impl Fn(Vec3) -> Vec3,
) -> Vec3 {
    let ShadedPoint { towards, normal, through, lit } = point;
    let facing = (-towards.dot(normal)).clamp(0.0, 1.0);
    let reflectance = NORMAL_REFLECTANCE + (1.0 - NORMAL_REFLECTANCE) * (1.0 - facing).powi(5);
    let reflected = sky(towards + 2.0 * facing * normal);
    // The line of sight is refracted by Snell's law where it enters the water, and not again where
    // it leaves the water.
    let along = towards + facing * normal;
    let bent = towards.lerp((towards - along * (1.0 - REFRACTION)).normalize(), 0.7).normalize();
    let transmitted = Vec3::new(
        exp(-ABSORPTION.x * through),
        exp(-ABSORPTION.y * through),
        exp(-ABSORPTION.z * through),
    );
    let scattering = 1.0 - exp(-SCATTERING_RATE * through);
    let light = diffuse_light(normal, lit);
    let inside = behind(bent) * transmitted + SCATTERED * scattering * (0.35 + 0.65 * light);
    let [film, deep] = DIFFUSE;
    let diffuse = film + (deep - film) * scattering;
    let body = inside.lerp(DIFFUSE_COLOUR * light, diffuse);
    let half = (SUN.normalize() - towards).normalize();
    let glint = normal.dot(half).max(0.0).powi(240);
    body.lerp(reflected, reflectance) + SUNLIGHT * (1.4 * glint * lit)
}

/// A fast approximation of the exponential of a non-positive number. Its error is below 0.001, and
/// thus invisible in a channel of 8 bits.
#[inline]
pub(super) fn quick_exp(x: f32) -> f32 {
    let power = (x * std::f32::consts::LOG2_E + EXPONENT_BIAS).max(0.0);
    let whole = power as u32;
    let part = power - whole as f32;
    // A cubic that is 1 at 0 and 2 at 1.
    let of_part = 1.0 + part * (0.695_56 + part * (0.226_17 + part * 0.078_27));
    f32::from_bits(whole << (f32::MANTISSA_DIGITS - 1)) * of_part
}
const EXPONENT_BIAS: f32 = (f32::MAX_EXP - 1) as f32;

/// The radiance of a place where a dark wire covers the fraction `share` of the surface.
pub(super) fn wire(surface: Vec3, share: f32) -> Vec3 {
    surface.lerp(WIRE_COLOUR, share)
}

/// The byte of a channel in sRGB, after compressing values that are too bright.
pub(super) fn byte(light: f32) -> u8 {
    let x = light.max(0.0);
    // The curve is linear up to 0.8, and then approaches 1.
    let x = if x <= 0.8 { x } else { 1.0 - 0.2 * (-(x - 0.8) / 0.2).exp() };
    SRGB[((x * (SRGB_STEPS - 1) as f32 + 0.5) as usize).min(SRGB_STEPS - 1)]
}

/// The sRGB bytes of linear values from 0 to 1, in steps fine enough for the darkest bytes.
static SRGB: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let byte = |step: usize| {
        let x = step as f32 / (SRGB_STEPS - 1) as f32;
        let srgb = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
        (srgb * 255.0 + 0.5) as u8
    };
    (0..SRGB_STEPS).map(byte).collect()
});
const SRGB_STEPS: usize = 1 << 13;

/// The linear values of an sRGB colour.
pub(super) fn linear([r, g, b]: [u8; 3]) -> Vec3 {
    let light = |byte: u8| {
        let x = f32::from(byte) / 255.0;
        if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
    };
    Vec3::new(light(r), light(g), light(b))
}

/// Distance, in pixels, between the points at which a [`Sketch`] has computed values.
const STEP: usize = 4;

/// Radiance on a coarse grid of pixels, interpolated between the grid's points.
pub(super) struct Sketch {
    columns: usize,
    known: Vec<Vec3>,
}

impl Sketch {
    /// Computes the grid for a picture of this size.
    pub(super) fn new(
        width: usize,
        height: usize,
        light: impl Fn(usize, usize) -> Vec3 + Sync,
    ) -> Self {
        let [columns, rows] = [width, height].map(|pixels| pixels.div_ceil(STEP) + 1);
        let of = |n: usize| light(n % columns * STEP, n / columns * STEP);
        let known = (0..columns * rows).into_par_iter().with_min_len(columns).map(of).collect();
        Self { columns, known }
    }

    /// The radiance at a pixel.
    pub(super) fn at(&self, x: usize, y: usize) -> Vec3 {
        let share = |at: usize| (at % STEP) as f32 / STEP as f32;
        let first = y / STEP * self.columns + x / STEP;
        let row = |first: usize| self.known[first].lerp(self.known[first + 1], share(x));
        row(first).lerp(row(first + self.columns), share(y))
    }
}

#[cfg(test)]
mod sketch_tests {
    use super::*;

    #[test]
    fn linear_light_is_interpolated_exactly() {
        let light = |x: usize, y: usize| {
            Vec3::new(x as f32, y as f32, 2.0 * x as f32 - 3.0 * y as f32 + 7.0)
        };
        for [width, height] in [[1, 1], [9, 8], [13, 31]] {
            let sketch = Sketch::new(width, height, light);
            for n in 0..width * height {
                let [x, y] = [n % width, n / width];
                assert!(
                    sketch.at(x, y).distance(light(x, y)) < 1e-3,
                    "{x}, {y} of {width} x {height}"
                );
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quick_exp_is_accurate_to_a_thousandth() {
        for n in 0..100_000 {
            let x = -1e-3 * n as f32;
            assert!(
                (quick_exp(x) - x.exp()).abs() <= 1e-3 * x.exp() + 1e-37,
                "{x}: {}",
                quick_exp(x)
            );
        }
        assert_eq!(quick_exp(f32::NEG_INFINITY), 0.0);
    }
}
