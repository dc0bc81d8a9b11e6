//! Where a picture is taken from: a direction from which all is seen, or an eye and what it looks
//! at.

use glam::{DMat3, DVec2, DVec3};

use crate::surface::mesh::source::Bounds;

/// The angle between the picture's upper and lower edge, in degrees, as a lens of some 70 mm sees.
const FIELD_OF_VIEW: f64 = 28.0;
/// The part of a picture that the box may fill.
const FILLED: f64 = 0.94;
/// From the nearest plane that is drawn to the eye, as a share of the distance to what it looks at.
const NEAREST: f64 = 1e-3;

/// The greatest coordinate that is drawn: squares of those beyond it are not finite soon, and they
/// do not count for the box.
pub(super) const FARTHEST: f64 = 1e100;

/// A way to look at a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum View {
    /// From a direction, as near as all of the box is seen.
    From {
        /// Degrees around the axis that points up: 0 looks along the horizontal axis that comes
        /// last, 90 along the other.
        azimuth: f64,
        /// Degrees above the horizon.
        elevation: f64,
        /// How much larger than whole the box is seen.
        zoom: f64,
    },
    /// From a point towards another.
    At {
        /// The place of the eye.
        eye: [f64; 3],
        /// The point in the middle of the picture.
        target: [f64; 3],
    },
}

/// An eye, the axes of its picture, and how long a unit at a distance of 1 is seen, in heights of
/// the picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Camera {
    pub(super) eye: DVec3,
    /// To the right, up, and back to the viewer.
    pub(super) axes: DMat3,
    focal: f64,
    /// From the eye to what it looks at.
    distance: f64,
}

impl Camera {
    /// The eye that looks at a box, the frame of whose world has the axes right, up and towards;
    /// `width` in heights.
    pub(super) fn new(view: Option<View>, bounds: Bounds, world: DMat3, width: f64) -> Self {
        let [lo, hi] = bounds.map(DVec3::from);
        let (middle, half) = ((lo + hi) / 2.0, (hi - lo) / 2.0);
        let focal = 0.5 / (FIELD_OF_VIEW.to_radians() / 2.0).tan();
        let (azimuth, elevation, zoom) = match view {
            Some(View::At { eye, target }) => {
                let (eye, target) = (DVec3::from(eye), DVec3::from(target));
                let axes = looking((eye - target).normalize_or(world.z_axis), world);
                return Self { eye, axes, focal, distance: eye.distance(target) };
            }
            Some(View::From { azimuth, elevation, zoom }) => (azimuth, elevation, zoom),
            // Its long side is seen across.
            None => {
                let size = world.transpose() * half;
                let along = if size.z.abs() > 1.2 * size.x.abs() { 62.0 } else { 28.0 };
                (along, 22.0, 1.0)
            }
        };
        let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
        let level = world.z_axis * azimuth.cos() + world.x_axis * azimuth.sin();
        let axes = looking(level * elevation.cos() + world.y_axis * elevation.sin(), world);
        // The nearest place on the line of sight from which each corner is within the picture; the
        // middle of what is seen is not that of the box, so the line is moved until it is.
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
                    let seen = axes.transpose() * (corner - target);
                    let reach = (seen.x.abs() / width).max(seen.y.abs());
                    seen.z + 2.0 * focal * reach / FILLED
                })
                .fold(0.0, f64::max);
            let at = |corner: &DVec3| {
                let seen = axes.transpose() * (*corner - target);
                DVec2::new(seen.x, seen.y) / (distance - seen.z).max(f64::MIN_POSITIVE)
            };
            let (lo, hi) = corners
                .iter()
                .map(at)
                .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lo, hi), at| {
                    (lo.min(at), hi.max(at))
                });
            // As far as moves the nearest corner there, and no other too far.
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

    /// An eye at a distance of `radii` from a ball, in a direction; the ball fills the picture.
    pub(super) fn far(middle: DVec3, radius: f64, radii: f64, back: DVec3, world: DMat3) -> Self {
        let distance = radius * radii;
        Self {
            eye: middle + back * distance,
            axes: looking(back, world),
            focal: 0.5 * (distance - radius) / radius * FILLED,
            distance,
        }
    }

    /// A place as the eye sees it: to the right and up in heights of the picture from its middle,
    /// times the distance; and the distance.
    #[inline]
    pub(super) fn seen(&self, place: DVec3) -> [f64; 3] {
        let seen = self.axes.transpose() * (place - self.eye);
        [seen.x * self.focal, seen.y * self.focal, -seen.z]
    }

    /// The nearest distance that is drawn.
    pub(super) fn nearest(&self) -> f64 {
        NEAREST * self.distance
    }

    /// Distance of the eye from what it looks at.
    pub(super) fn distance(&self) -> f64 {
        self.distance
    }

    /// The direction in which a place of the picture is seen, in heights from its middle, y up; not
    /// of unit length: it goes a distance of 1 forward.
    pub(super) fn towards(&self, x: f64, y: f64) -> DVec3 {
        self.axes * DVec3::new(x / self.focal, y / self.focal, -1.0)
    }
}

/// The middle and the radius of the ball around a box.
pub(super) fn ball(bounds: Bounds) -> (DVec3, f64) {
    let [lo, hi] = bounds.map(DVec3::from);
    ((lo + hi) / 2.0, ((hi - lo).length() / 2.0).max(f64::MIN_POSITIVE.sqrt()))
}

/// The axes of a picture that is taken from a direction.
fn looking(back: DVec3, world: DMat3) -> DMat3 {
    let right = world.y_axis.cross(back).normalize_or(world.x_axis);
    DMat3::from_cols(right, back.cross(right), back)
}
