//! The camera of all compared pictures.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use glam::DVec3;
use meniscus::internals::surface::mesh::Mesh;
use meniscus::picture::{Colour, Image, Picture, Scope, View};

use crate::Outcome;

const TOWARDS: DVec3 = DVec3::new(0.55, 0.5, 1.0);
/// The distance between the camera and the centre of a ball, in radii of the ball, at which the
/// ball fills the height of a picture. Half of the vertical field of view is 14 degrees.
const DISTANCE: f64 = 4.011;
/// The default colour. It is opaque, so that pictures show only the front of the surface.
const WATER: Colour = Colour::Solid([92, 158, 214]);

/// A camera that views a ball, with y up.
#[derive(Debug, Clone, Copy)]
pub struct Camera {
    pub centre: DVec3,
    pub radius: f64,
}

impl Camera {
    /// A camera that sees the whole box with these corners.
    pub fn of([lo, hi]: [DVec3; 2]) -> Self {
        Self { centre: (lo + hi) / 2.0, radius: (hi - lo).length() / 2.0 }
    }

    /// Draws a mesh from this camera. The bounds of the scene depend only on the camera, so that
    /// pictures of different meshes match.
    pub fn picture(&self, mesh: &Mesh, [width, height]: [usize; 2]) -> Outcome<Image> {
        self.coloured(mesh, [width, height], WATER, None)
    }

    /// Draws a mesh like [`picture`](Self::picture), in `colour`, with its colour map over `range`.
    pub fn coloured(
        &self,
        mesh: &Mesh,
        [width, height]: [usize; 2],
        colour: Colour,
        range: Option<[f32; 2]>,
    ) -> Outcome<Image> {
        let eye = self.centre + TOWARDS.normalize() * DISTANCE * self.radius;
        let half = DVec3::splat(self.radius / 3_f64.sqrt());
        let mut scope = Scope::default();
        scope.bounds = Some([self.centre - half, self.centre + half].map(Into::into));
        scope.range = range;
        let picture = Picture::new().size(width, height).colour(colour).scope(scope);
        Ok(picture.view(View::At { eye: eye.into(), target: self.centre.into() }).draw(mesh)?)
    }
}

/// Writes a .png file.
pub fn write(image: &Image, path: &Path) -> Outcome<()> {
    let mut out = BufWriter::new(File::create(path)?);
    Ok(image.write_png(&mut out)?)
}

/// Writes a .png file with images side by side.
pub fn write_sheet(images: &[Image], columns: usize, path: &Path) -> Outcome<()> {
    write(&Image::sheet(images, columns).ok_or("a sheet needs at least one picture")?, path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::meshes::sphere;

    #[test]
    fn a_ball_fills_the_expected_share_of_the_picture() {
        let camera = Camera { centre: DVec3::ONE, radius: 2.0 };
        let mut ball = sphere(1.0, 5);
        ball.positions.iter_mut().for_each(|p| *p = p.map(|x| x + 1.0));
        let [image, nothing] =
            [ball, Mesh::default()].map(|mesh| camera.picture(&mesh, [200, 200]).unwrap());
        let differ =
            image.rgb().chunks(3).zip(nothing.rgb().chunks(3)).filter(|(a, b)| a != b).count();
        // The ball's radius is half of the camera's, so the ball fills half of the picture's
        // height.
        let expected = std::f64::consts::PI * 50.0 * 50.0;
        assert!((differ as f64 / expected - 1.0).abs() < 0.05, "{differ} pixels, not {expected}");
    }
}
