//! Pictures of meshes: a z-buffer, smooth shading, one camera for all that are to be compared.

use std::convert::Infallible;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use embedded_graphics::Pixel;
use embedded_graphics::draw_target::DrawTarget;
use embedded_graphics::geometry::{OriginDimensions, Point, Size};
use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::ascii::FONT_9X15;
use embedded_graphics::pixelcolor::BinaryColor;
use embedded_graphics::prelude::Drawable;
use embedded_graphics::text::{Baseline, Text};
use glam::{DVec2, DVec3, Vec3};
use meniscus::internals::surface::mesh::Mesh;

use crate::Outcome;

/// Samples along the edge of a pixel.
const FINER: usize = 2;
/// Sees about 30 degrees.
const FOCAL: f64 = 3.6;
const TOWARDS: DVec3 = DVec3::new(0.55, 0.5, 1.0);
const LIGHT: Vec3 = Vec3::new(-0.45, 0.8, 0.4);
const BACKGROUND: Vec3 = Vec3::splat(0.96);
const INK: Vec3 = Vec3::splat(0.1);
/// From a picture's upper left corner to its label.
const LABEL_AT: Point = Point::new(6, 4);
/// What is not coloured by something else.
pub const WATER: Vec3 = Vec3::new(0.25, 0.52, 0.8);

/// Looks at a ball, y up.
#[derive(Debug, Clone, Copy)]
pub struct Camera {
    pub centre: DVec3,
    pub radius: f64,
}

impl Camera {
    /// That sees all of a box.
    pub fn of([lo, hi]: [DVec3; 2]) -> Self {
        Self { centre: (lo + hi) / 2.0, radius: (hi - lo).length() / 2.0 }
    }

    /// Where a point is on a picture one high with its middle at 0, y down, and how far away.
    fn project(&self, point: DVec3) -> (DVec2, f64) {
        let back = TOWARDS.normalize();
        let right = DVec3::Y.cross(back).normalize();
        let up = back.cross(right);
        let eye = self.centre + 2.0 * FOCAL * self.radius * back;
        let seen = point - eye;
        let depth = -seen.dot(back);
        (DVec2::new(seen.dot(right), -seen.dot(up)) / depth * FOCAL, depth)
    }
}

/// Rows of pixels from the top.
pub struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<Vec3>,
}

impl Picture {
    /// Of a mesh whose vertices have colours, or are all [`WATER`].
    pub fn of(mesh: &Mesh, colours: Option<&[Vec3]>, camera: &Camera, [width, height]: [usize; 2]) -> Self {
        let mut fine = Self::blank(width * FINER, height * FINER);
        let mut depths = vec![f64::INFINITY; fine.pixels.len()];
        let half = DVec2::new(fine.width as f64, fine.height as f64) / 2.0;
        let seen: Vec<(DVec2, f64)> = mesh
            .positions
            .iter()
            .map(|&point| camera.project(point.into()))
            .map(|(at, depth)| (at * fine.height as f64 + half, depth))
            .collect();
        let shades: Vec<Vec3> = normals(mesh)
            .into_iter()
            .enumerate()
            .map(|(vertex, normal)| {
                colours.map_or(WATER, |colours| colours[vertex]) * light(normal) + gloss(normal)
            })
            .collect();
        for &triangle in &mesh.triangles {
            let corners = triangle.map(|vertex| seen[vertex as usize]);
            let shades = triangle.map(|vertex| shades[vertex as usize]);
            fine.fill(&mut depths, corners, shades);
        }
        fine.coarser()
    }

    fn blank(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![BACKGROUND; width * height] }
    }

    /// Draws what of a triangle is nearer than all before.
    fn fill(&mut self, depths: &mut [f64], corners: [(DVec2, f64); 3], shades: [Vec3; 3]) {
        let [(a, za), (b, zb), (c, zc)] = corners;
        let doubled_area = (b - a).perp_dot(c - a);
        if doubled_area == 0.0 {
            return;
        }
        let last = DVec2::new(self.width as f64 - 1.0, self.height as f64 - 1.0);
        let lo = (a.min(b).min(c) - 0.5).ceil().max(DVec2::ZERO);
        let hi = (a.max(b).max(c) - 0.5).floor().min(last);
        for y in lo.y as usize..(hi.y + 1.0).max(0.0) as usize {
            for x in lo.x as usize..(hi.x + 1.0).max(0.0) as usize {
                let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let u = (b - p).perp_dot(c - p) / doubled_area;
                let v = (c - p).perp_dot(a - p) / doubled_area;
                let w = 1.0 - u - v;
                let depth = u * za + v * zb + w * zc;
                let pixel = y * self.width + x;
                if u >= 0.0 && v >= 0.0 && w >= 0.0 && depth < depths[pixel] {
                    depths[pixel] = depth;
                    self.pixels[pixel] = shades[0] * u as f32 + shades[1] * v as f32 + shades[2] * w as f32;
                }
            }
        }
    }

    /// Means over the samples of each pixel.
    fn coarser(&self) -> Self {
        let mut coarse = Self::blank(self.width / FINER, self.height / FINER);
        for (n, pixel) in coarse.pixels.iter_mut().enumerate() {
            let (x, y) = (n % coarse.width * FINER, n / coarse.width * FINER);
            let samples = (0..FINER * FINER).map(|i| (y + i / FINER) * self.width + x + i % FINER);
            *pixel = samples.map(|sample| self.pixels[sample]).sum::<Vec3>() / (FINER * FINER) as f32;
        }
        coarse
    }

    /// With a line of text in the upper left corner.
    pub fn labelled(mut self, text: &str) -> Self {
        let style = MonoTextStyle::new(&FONT_9X15, BinaryColor::On);
        let text = Text::with_baseline(text, LABEL_AT, style, Baseline::Top);
        let Ok(_) = text.draw(&mut self);
        self
    }

    /// Pictures of one size side by side, in rows of so many.
    pub fn sheet(pictures: &[Self], columns: usize) -> Self {
        let (width, height) = (pictures[0].width, pictures[0].height);
        let mut sheet = Self::blank(columns * width, pictures.len().div_ceil(columns) * height);
        for (n, picture) in pictures.iter().enumerate() {
            for (y, row) in picture.pixels.chunks(width).enumerate() {
                let first = (n / columns * height + y) * sheet.width + n % columns * width;
                sheet.pixels[first..first + width].copy_from_slice(row);
            }
        }
        sheet
    }

    /// Writes a .png file.
    pub fn write(&self, path: &Path) -> Outcome<()> {
        let mut encoder =
            png::Encoder::new(BufWriter::new(File::create(path)?), self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        let bytes: Vec<u8> = self.pixels.iter().flat_map(|&colour| bytes(colour)).collect();
        encoder.write_header()?.write_image_data(&bytes)?;
        Ok(())
    }
}

impl OriginDimensions for Picture {
    fn size(&self) -> Size {
        Size::new(self.width as u32, self.height as u32)
    }
}

/// In ink; what is off is left as it is.
impl DrawTarget for Picture {
    type Color = BinaryColor;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<BinaryColor>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(Point { x, y }, _) in pixels.into_iter().filter(|pixel| pixel.1.is_on()) {
            if (0..self.width as i32).contains(&x) && (0..self.height as i32).contains(&y) {
                self.pixels[y as usize * self.width + x as usize] = INK;
            }
        }
        Ok(())
    }
}

pub fn bytes(colour: Vec3) -> [u8; 3] {
    (colour * 255.0).round().to_array().map(|channel| channel as u8)
}

/// Unit normals, of the triangles around each vertex by their areas.
fn normals(mesh: &Mesh) -> Vec<Vec3> {
    let mut normals = vec![DVec3::ZERO; mesh.positions.len()];
    for &triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| DVec3::from(mesh.positions[vertex as usize]));
        triangle.into_iter().for_each(|vertex| normals[vertex as usize] += (b - a).cross(c - a));
    }
    normals.into_iter().map(|normal| normal.normalize_or_zero().as_vec3()).collect()
}

/// Of a lamp, and of the sky.
fn light(normal: Vec3) -> f32 {
    0.35 + 0.15 * normal.y + 0.6 * normal.dot(LIGHT.normalize()).max(0.0)
}

/// What of the lamp is mirrored towards the camera: it shows a surface's unevenness.
fn gloss(normal: Vec3) -> f32 {
    let half = (LIGHT.normalize() + TOWARDS.normalize().as_vec3()).normalize();
    0.3 * normal.dot(half).max(0.0).powi(30)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::meshes::sphere;

    #[test]
    fn a_ball_covers_the_share_of_the_picture_that_it_should_and_hides_what_is_behind_it() {
        let ball = sphere(1.0, 5);
        let camera = Camera { centre: DVec3::ZERO, radius: 2.0 };
        let picture = Picture::of(&ball, None, &camera, [200, 200]);
        let covered = picture.pixels.iter().filter(|&&pixel| pixel != BACKGROUND).count() as f64;
        // From so far, the ball's radius on a picture one high is a quarter.
        let expected = std::f64::consts::PI * 50.0 * 50.0;
        assert!((covered / expected - 1.0).abs() < 0.05, "{covered} pixels, not {expected}");
        let front = picture.pixels[100 * 200 + 100];
        assert!(front.z > 0.5, "the side that faces the camera is lit: {front}");
    }

    #[test]
    fn a_label_is_drawn_in_the_upper_left_corner_as_far_as_the_picture_goes() {
        let blank = Picture::blank(60, 40);
        let inked = |text: &str| {
            let pixels = Picture::blank(60, 40).labelled(text).pixels;
            let ink = (0..pixels.len()).filter(|&n| pixels[n] == INK);
            ink.map(|n| (n % 60, n / 60)).collect::<Vec<_>>()
        };
        let short = inked("c 1");
        assert!(short.len() > 15 && short.iter().all(|&(x, y)| x < 6 + 3 * 9 && y < 4 + 15), "{short:?}");
        assert_ne!(short, inked("c 7"));
        assert!(inked("much longer than the picture").len() > short.len());
        assert!(blank.labelled("").pixels.iter().all(|&pixel| pixel == BACKGROUND));
    }
}
