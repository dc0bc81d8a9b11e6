//! Canvases that a mesh is drawn on: the view of the eye and that of the sun, and where its corners are on both.

use rayon::prelude::*;

use crate::system::memory::empty_in_huge_pages;

use super::camera::Camera;
use super::raster::{Corner, Raster};

/// Corners of the smallest task.
const LEAST: usize = 1 << 9;

/// A raster, and the camera whose view is drawn on it.
#[derive(Clone, Copy)]
pub(super) struct Canvas<'a> {
    pub(super) raster: &'a Raster,
    pub(super) camera: &'a Camera,
}

impl Canvas<'_> {
    /// A place on the picture, and the halves that it is in.
    #[inline(always)]
    fn corner(&self, place: [f64; 3]) -> (Corner, u64) {
        let corner = self.raster.corner(self.camera.seen(place.into()));
        let [column, row] = self.raster.halves(corner);
        (corner, u64::from(column) << 16 | u64::from(row))
    }
}

/// How many views are drawn at once: the eye's and the sun's.
pub(super) const VIEWS: usize = 2;

/// Corners on the pictures, kept from one batch to the next for their memory.
pub(super) struct Corners {
    pub(super) at: Vec<[Corner; VIEWS]>,
    /// The [halves](Raster::halves) that each is in, 16 bits an axis, the eye's in the higher ones.
    pub(super) halves: Vec<u64>,
}

impl Corners {
    /// Bytes of one.
    pub(super) const BYTES: u64 = (size_of::<[Corner; VIEWS]>() + size_of::<u64>()) as u64;

    /// None yet, with room for so many.
    pub(super) fn with_room(count: usize) -> Self {
        Self { at: empty_in_huge_pages(count), halves: empty_in_huge_pages(count) }
    }

    /// Puts places on the pictures.
    pub(super) fn put(&mut self, [eye, sun]: [Canvas<'_>; VIEWS], places: &[[f64; 3]]) {
        let of = |&place: &[f64; 3]| {
            let (eye_corner, eye_halves) = eye.corner(place);
            let (sun_corner, sun_halves) = sun.corner(place);
            ([eye_corner, sun_corner], eye_halves << 32 | sun_halves)
        };
        places.par_iter().with_min_len(LEAST).map(of).unzip_into_vecs(&mut self.at, &mut self.halves);
    }
}
