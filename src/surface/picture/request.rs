//! A request for pictures: size, camera and colours.

use std::io;

use bytesize::ByteSize;
use glam::{DMat3, DVec3};
use thiserror::Error;

use crate::surface::mesh::compare::CompareError;
use crate::surface::mesh::source::{Corners, joined};
use crate::surface::mesh::up::UpAxis;

use super::camera::View;
use super::colour::Colour;

const DEFAULT_SIZE: [usize; 2] = [1920, 1080];

/// The bounding box and the range of values that pictures share, so that frames can be compared.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Scope {
    /// The box that is completely visible; `None` if there are no vertices.
    pub bounds: Option<Corners>,
    /// The range of the attribute that is shown; for distances, a range that contains the distances
    /// of 99 % of the vertices.
    pub range: Option<[f32; 2]>,
    /// Whether some values are beyond the range. If so, the legend marks both ends of the range.
    pub beyond: bool,
}

impl Scope {
    /// The common scope of two meshes.
    #[must_use]
    pub fn joined(self, other: Self) -> Self {
        let ranges = [self.range, other.range].into_iter().flatten();
        Self {
            bounds: [self.bounds, other.bounds].into_iter().flatten().reduce(joined),
            range: ranges.reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]),
            beyond: self.beyond || other.beyond,
        }
    }
}

/// Quality of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Effort {
    /// Four samples per pixel.
    #[default]
    Full,
    /// A draft in about half the time: one sample per pixel, softer shadows, and no refraction. A
    /// surface with more than two vertices per pixel is drawn with fewer and larger triangles.
    Draft,
}

/// A request for pictures of meshes: size, camera and colours.
///
/// ```
/// use meniscus::{Reconstruction, picture::Picture};
///
/// let drop = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
/// let surface = Reconstruction::new().spacing(1.0).run(&drop)?;
/// let image = Picture::new().size(64, 48).draw(surface.mesh())?;
/// assert_eq!((image.width(), image.height()), (64, 48));
/// let mut png = Vec::new();
/// image.write_png(&mut png)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Picture {
    pub(super) size: Option<[usize; 2]>,
    pub(super) view: Option<View>,
    up: Option<UpAxis>,
    pub(super) ground: bool,
    pub(super) wireframe: bool,
    pub(super) colour: Colour,
    pub(super) scope: Option<Scope>,
    pub(super) memory: Option<u64>,
    pub(super) effort: Effort,
}

impl Picture {
    /// A picture with the default settings: 1920 x 1080 pixels, with the whole surface drawn as
    /// water and seen from the front, right and above.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets the width and height in pixels.
    #[must_use]
    pub fn size(mut self, width: usize, height: usize) -> Self {
        self.size = Some([width, height]);
        self
    }

    /// Sets the camera.
    #[must_use]
    pub fn view(mut self, view: View) -> Self {
        self.view = Some(view);
        self
    }

    /// Sets the axis that points up: y by default.
    #[must_use]
    pub fn up(mut self, axis: UpAxis) -> Self {
        self.up = Some(axis);
        self
    }

    /// Shows a floor under the bounding box, with the fluid's shadow.
    #[must_use]
    pub fn ground(mut self, shown: bool) -> Self {
        self.ground = shown;
        self
    }

    /// Shows the edges of the triangles.
    #[must_use]
    pub fn wireframe(mut self, shown: bool) -> Self {
        self.wireframe = shown;
        self
    }

    /// Sets the colours.
    #[must_use]
    pub fn colour(mut self, colour: Colour) -> Self {
        self.colour = colour;
        self
    }

    /// Sets the visible box and the range of values, instead of the mesh's own.
    #[must_use]
    pub fn scope(mut self, scope: Scope) -> Self {
        self.scope = Some(scope);
        self
    }

    /// Sets the quality.
    #[must_use]
    pub fn effort(mut self, effort: Effort) -> Self {
        self.effort = effort;
        self
    }

    /// Limits the memory for drawing a picture, in bytes. The mesh that is passed to
    /// [`draw`](Self::draw) does not count. There is no limit by default.
    #[must_use]
    pub fn memory(mut self, bytes: u64) -> Self {
        self.memory = Some(bytes);
        self
    }

    /// Checks the size and the view.
    ///
    /// # Errors
    /// [`PictureError::Size`] or [`PictureError::View`] if the size or the view is invalid.
    pub fn check(&self) -> Result<(), PictureError> {
        let [width, height] = self.pixels();
        if [width, height].iter().any(|side| !(1..=MOST_PIXELS).contains(side)) {
            return Err(PictureError::Size(width, height));
        }
        let finite = |numbers: &[f64]| numbers.iter().all(|number| number.is_finite());
        match self.view {
            Some(View::From { azimuth, elevation, zoom })
                if !finite(&[azimuth, elevation, zoom]) || zoom <= 0.0 =>
            {
                Err(PictureError::View(
                    "the camera's angles must be finite, and its zoom factor positive",
                ))
            }
            Some(View::At { eye, target }) if !finite(&[eye, target].concat()) || eye == target => {
                Err(PictureError::View(
                    "the positions of the camera and of its target must be finite and different",
                ))
            }
            _ => Ok(()),
        }
    }

    /// Sets the memory limit, unless it is already set.
    pub(crate) fn memory_unless_set(mut self, bytes: u64) -> Self {
        self.memory = self.memory.or(Some(bytes));
        self
    }

    /// Sets the axis that points up, unless it is already set.
    pub(crate) fn up_unless_set(mut self, up: impl FnOnce() -> UpAxis) -> Self {
        self.up = self.up.or_else(|| Some(up()));
        self
    }

    pub(super) fn pixels(&self) -> [usize; 2] {
        self.size.unwrap_or(DEFAULT_SIZE)
    }

    /// The axes of the world: to the right, up, and towards the viewer.
    pub(super) fn world(&self) -> DMat3 {
        match self.up.unwrap_or(UpAxis::Y) {
            UpAxis::Y => DMat3::IDENTITY,
            UpAxis::Z => DMat3::from_cols(DVec3::X, DVec3::Z, -DVec3::Y),
        }
    }
}

/// The part of a mesh that is held in memory.
pub(super) enum MeshMemory {
    /// The whole mesh.
    Whole,
    /// Batches of at most this many bytes.
    Batches(u64),
}

/// The memory limit and the used bytes.
pub(super) struct Budget {
    used: u64,
    allowed: u64,
}

impl Budget {
    /// A budget of `allowed` bytes, of which `used` bytes are already used.
    pub(super) fn new(used: u64, allowed: u64) -> Self {
        Self { used, allowed }
    }

    /// Checks that `bytes` more bytes are available.
    pub(super) fn check(&self, bytes: u64) -> Result<(), PictureError> {
        let Self { used, allowed } = *self;
        let needed = used + bytes;
        if needed <= allowed { Ok(()) } else { Err(PictureError::Memory { needed, allowed }) }
    }
}

/// Maximum number of pixels per side.
pub(super) const MOST_PIXELS: usize = 1 << 15;

/// A picture that cannot be drawn.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PictureError {
    /// An invalid size.
    #[error(
        "the size of a picture must be from 1 to {MOST_PIXELS} pixels per side, got {0} x \
             {1}"
    )]
    Size(usize, usize),
    /// An invalid view.
    #[error("{0}")]
    View(&'static str),
    /// An unknown colour map.
    #[error("no colour map {name:?}; available maps: {known}")]
    Map {
        /// The requested name.
        name: String,
        /// The available names.
        known: String,
    },
    /// An attribute that the vertices do not have.
    #[error("the vertices have no attribute {name:?}; available attributes: {known}")]
    NoAttribute {
        /// The requested attribute.
        name: String,
        /// The available names.
        known: String,
    },
    /// A reference mesh that has no surface, or an invalid vertex.
    #[error("{0}")]
    Reference(CompareError),
    /// A picture that exceeds the memory limit.
    #[error(
        "a picture of this mesh needs {} of memory, but the limit is {}; draw a smaller picture, \
         or raise the limit",
        ByteSize(*needed), ByteSize(*allowed)
    )]
    Memory {
        /// Memory that the picture needs, in bytes.
        needed: u64,
        /// The memory limit, in bytes.
        allowed: u64,
    },
    /// A mesh that cannot be read from its scratch file.
    #[error("{0}")]
    Io(#[from] io::Error),
}
