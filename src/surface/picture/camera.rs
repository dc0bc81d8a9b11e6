//! The camera of a picture: a direction from which everything is visible, or an eye and a target.

use glam::{DMat3, DVec2, DVec3};

use crate::surface::mesh::source::Corners;

/// The vertical field of view in degrees, similar to that of a 70 mm lens.
const FIELD_OF_VIEW: f64 = 28.0;
/// The fraction of a picture that the bounding box may fill.
const FILLED: f64 = 0.94;
/// The distance of the near plane from the eye, as a fraction of the distance to the target.
const NEAREST: f64 = 1e-3;

/// Maximum magnitude of coordinates that are drawn. With larger coordinates, products could
/// overflow. Vertices with larger coordinates do not affect the bounding box either.
pub(super) const FARTHEST: f64 = 1e100;

/// A view of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum View {
    /// From a direction, and as close as possible while the whole bounding box is visible.
    From {
        /// Degrees around the up axis. At 0, the camera is on the +z side of the box, or on the -y
        /// side if z points up; at 90, it is on the +x side.
        azimuth: f64,
        /// Degrees above the horizon.
        elevation: f64,
        /// Magnification relative to the view of the whole bounding box: with 2, the camera is half
        /// as far away.
        zoom: f64,
    },
    /// From one point towards another point.
    At {
        /// The position of the eye.
        eye: [f64; 3],
        /// The point in the middle of the picture.
        target: [f64; 3],
    },
}

/// A pinhole camera: its position, the axes of its picture, and its focal length in units of the
/// picture's height.
#[derive(Debug, Clone, Copy)]
pub(super) struct Camera {
    pub(super) eye: DVec3,
    /// The directions to the right, up, and towards the viewer.
    pub(super) axes: DMat3,
    focal: f64,
    /// The distance from the eye to the target.
    distance: f64,
}

impl Camera {
    /// The camera for a view of a box. The axes of `world` are right, up and towards the viewer;
    /// `width` is the picture's width, in units of its height.
    pub(super) fn new(view: Option<View>, bounds: Corners, world: DMat3, width: f64) -> Self {
        let [lo, hi] = bounds.map(DVec3::from);
        let (middle, half) = ((lo + hi) / 2.0, (hi - lo) / 2.0);
        let focal = 0.5 / (FIELD_OF_VIEW.to_radians() / 2.0).tan();
        let (azimuth, elevation, zoom) = match view {
            Some(View::At { eye, target }) => {
                let (eye, target) = (DVec3::from(eye), DVec3::from(target));
                let axes = camera_axes((eye - target).normalize_or(world.z_axis), world);
                return Self { eye, axes, focal, distance: eye.distance(target) };
            }
            Some(View::From { azimuth, elevation, zoom }) => (azimuth, elevation, zoom),
            // The longer horizontal side of the box extends across the picture.
            None => {
                let size = world.transpose() * half;
                let along = if size.z.abs() > 1.2 * size.x.abs() { 62.0 } else { 28.0 };
                (along, 22.0, 1.0)
            }
        };
        let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
        let level = world.z_axis * azimuth.cos() + world.x_axis * azimuth.sin();
        let axes = camera_axes(level * elevation.cos() + world.y_axis * elevation.sin(), world);
        // Find the nearest eye position from which every corner is visible. If the eye looks at the
        // middle of the box, the picture of the box is not centred, so the line of sight is moved
        // repeatedly.
        let corners: Vec<DVec3> = (0..8)
            .map(|i| {
                middle
                    + half * DVec3::from([1, 2, 4].map(|bit| if i & bit == 0 { -1.0 } else { 1.0 }))
            })
            .collect();
        let mut target = middle;
        let mut distance = 0.0;
        for _ in 0..40 {
            distance = corners
                .iter()
                .map(|&corner| {
                    let rotated = axes.transpose() * (corner - target);
                    let reach = (rotated.x.abs() / width).max(rotated.y.abs());
                    rotated.z + 2.0 * focal * reach / FILLED
                })
                .fold(0.0, f64::max);
            let at = |corner: &DVec3| {
                let rotated = axes.transpose() * (*corner - target);
                DVec2::new(rotated.x, rotated.y) / (distance - rotated.z).max(f64::MIN_POSITIVE)
            };
            let (lo, hi) = corners
                .iter()
                .map(at)
                .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lo, hi), at| {
                    (lo.min(at), hi.max(at))
                });
            // The step has the length that would be right if every corner were as near as the
            // nearest corner. Farther corners move less in the picture, so the step is never too
            // long.
            let nearest = corners
                .iter()
                .map(|&corner| axes.z_axis.dot(corner - target))
                .fold(f64::NEG_INFINITY, f64::max);
            let off = (lo + hi) / 2.0 * (distance - nearest);
            target += axes.x_axis * off.x + axes.y_axis * off.y;
        }
        let distance = if distance > 0.0 { distance } else { 1.0 } / zoom;
        Self { eye: target + axes.z_axis * distance, axes, focal, distance }
    }

    /// A camera in the direction `back` from a ball, at a distance of `radii` radii from the ball's
    /// middle. The ball fills the picture.
    pub(super) fn far(middle: DVec3, radius: f64, radii: f64, back: DVec3, world: DMat3) -> Self {
        let distance = radius * radii;
        Self {
            eye: middle + back * distance,
            axes: camera_axes(back, world),
            focal: 0.5 * (distance - radius) / radius * FILLED,
            distance,
        }
    }

    /// A place in camera coordinates: `[x, y, distance]`. x / distance and y / distance are the
    /// position on the picture, to the right and up from its middle, in units of its height.
    #[inline]
    pub(super) fn camera_coordinates(&self, place: DVec3) -> [f64; 3] {
        let rotated = self.axes.transpose() * (place - self.eye);
        [rotated.x * self.focal, rotated.y * self.focal, -rotated.z]
    }

    /// The distance of the near plane.
    pub(super) fn nearest(&self) -> f64 {
        NEAREST * self.distance
    }

    /// Distance from the eye to the target.
    pub(super) fn distance(&self) -> f64 {
        self.distance
    }

    /// The direction from the eye towards a point of the picture. The point is given relative to
    /// the picture's middle, with y up, in units of the picture's height. The component of the
    /// direction along the middle line of sight is 1.
    pub(super) fn towards(&self, x: f64, y: f64) -> DVec3 {
        self.axes * DVec3::new(x / self.focal, y / self.focal, -1.0)
    }
}

/// The centre and the radius of the ball around a box.
pub(super) fn ball(bounds: Corners) -> (DVec3, f64) {
    let [lo, hi] = bounds.map(DVec3::from);
    ((lo + hi) / 2.0, ((hi - lo).length() / 2.0).max(f64::MIN_POSITIVE.sqrt()))
}

/// The axes of a picture that is seen from the direction `back`.
fn camera_axes(back: DVec3, world: DMat3) -> DMat3 {
    let right = world.y_axis.cross(back).normalize_or(world.x_axis);
    DMat3::from_cols(right, back.cross(right), back)
}
