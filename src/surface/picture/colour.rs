//! The colours of a surface: water, a solid colour, or a colour map of values.

use std::str::FromStr;
use std::sync::Arc;

use colorous::Gradient;
use embedded_graphics::text::Alignment;
use glam::Vec3;

use crate::particles::{AttributeInfo, AttributeKind};
use crate::surface::mesh::Mesh;
use crate::surface::mesh::compare::SearchableSurface;
use crate::surface::mesh::source::{MeshSource, Vertices};

use super::image::Image;
use super::light::linear;
use super::request::PictureError;

/// The colours of a surface.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub enum Colour {
    /// Water: reflects the sky, is transparent, and becomes bluer with depth.
    #[default]
    Water,
    /// A solid colour: red, green and blue in sRGB.
    Solid([u8; 3]),
    /// An attribute of the vertices, or its length if it is a vector, with a legend.
    Attribute {
        /// The attribute's name.
        name: String,
        /// Colours from the minimum to the maximum value.
        map: ColourMap,
    },
    /// The distance from another surface, negative inside, with a legend in the meshes' unit of
    /// length. The most distant 1 % of the vertices have the colours at the ends of the map.
    Distance {
        /// The other surface.
        from: Reference,
        /// Colours from the most negative to the most positive distance.
        map: ColourMap,
    },
}

impl Colour {
    /// The title and the colours of the legend, if there is one.
    pub(super) fn legend(&self) -> Option<(&str, ColourMap)> {
        match self {
            Self::Water | Self::Solid(_) => None,
            Self::Attribute { name, map } => Some((name, *map)),
            Self::Distance { map, .. } => Some(("distance", *map)),
        }
    }
}

/// A reference surface for distances.
#[derive(Debug, Clone)]
pub struct Reference(Arc<SearchableSurface>);

impl Reference {
    /// Builds the search structure of a mesh.
    ///
    /// # Errors
    /// [`PictureError::Reference`] if the mesh has no surface, or an invalid vertex.
    pub fn new(mesh: &Mesh) -> Result<Self, PictureError> {
        Ok(Self(Arc::new(SearchableSurface::reference(mesh).map_err(PictureError::Reference)?)))
    }

    fn distances(&self, places: &[[f64; 3]]) -> Vec<f32> {
        self.0.signed_distances(places).into_iter().map(|distance| distance as f32).collect()
    }
}

impl PartialEq for Reference {
    /// Whether one reference is a copy of the other. References that were prepared separately
    /// differ, even if their meshes are equal.
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// Colours for values from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ColourMap(usize);

/// Colour maps by name, starting with perceptually uniform ones (Liu and Heer 2018).
const MAPS: [(&str, Gradient); 9] = [
    ("viridis", colorous::VIRIDIS),
    ("cividis", colorous::CIVIDIS),
    ("plasma", colorous::PLASMA),
    ("magma", colorous::MAGMA),
    ("inferno", colorous::INFERNO),
    ("turbo", colorous::TURBO),
    ("blues", colorous::BLUES),
    ("greys", colorous::GREYS),
    ("red-blue", colorous::RED_BLUE),
];

/// The index of the diverging map.
const DIVERGING: usize = MAPS.len() - 1;

impl ColourMap {
    /// The names of all colour maps.
    pub const NAMES: [&'static str; MAPS.len()] = {
        let mut names = [""; MAPS.len()];
        let mut n = 0;
        while n < MAPS.len() {
            names[n] = MAPS[n].0;
            n += 1;
        }
        names
    };

    /// The map for values around zero.
    #[must_use]
    pub fn diverging() -> Self {
        Self(DIVERGING)
    }

    /// The colour of a value from 0 to 1; NaN is grey.
    pub(super) fn of(self, value: f32) -> [u8; 3] {
        if value.is_nan() {
            return [128; 3];
        }
        MAPS[self.0].1.eval_continuous(f64::from(value.clamp(0.0, 1.0))).as_array()
    }
}

impl FromStr for ColourMap {
    type Err = PictureError;

    fn from_str(name: &str) -> Result<Self, PictureError> {
        let found = MAPS.iter().position(|(known, _)| *known == name);
        found.map(Self).ok_or_else(|| PictureError::Map {
            name: name.to_owned(),
            known: Self::NAMES.join(", "),
        })
    }
}

/// The values that determine the vertices' colours.
pub(super) enum ColourSource<'a> {
    None,
    /// An attribute of the vertices.
    Attribute {
        index: usize,
        components: usize,
        kind: AttributeKind,
    },
    /// The distance from a surface.
    Distance(&'a Reference),
}

impl<'a> ColourSource<'a> {
    /// The values that determine the colours of a mesh.
    pub(super) fn new(colour: &'a Colour, mesh: &dyn MeshSource) -> Result<Self, PictureError> {
        let name = match colour {
            Colour::Water | Colour::Solid(_) => return Ok(Self::None),
            Colour::Distance { from, .. } => return Ok(Self::Distance(from)),
            Colour::Attribute { name, .. } => name,
        };
        let attributes = mesh.attributes();
        let Some(index) = attributes.iter().position(|info| info.name == *name) else {
            let known: Vec<&str> = attributes.iter().map(|info| &*info.name).collect();
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            return Err(PictureError::NoAttribute { name: name.clone(), known });
        };
        let AttributeInfo { components, kind, .. } = attributes[index];
        Ok(Self::Attribute { index, components, kind })
    }

    /// Whether the colours depend on values.
    pub(super) fn has_values(&self) -> bool {
        !matches!(self, Self::None)
    }

    /// The value of every vertex; empty if the colour needs no values.
    pub(super) fn of(&self, vertices: &Vertices<'_>) -> Vec<f32> {
        match *self {
            Self::None => Vec::new(),
            Self::Attribute { index, components, kind } => {
                let length = |value: &[f32]| match value {
                    [value] => kind.number(*value),
                    vector => vector.iter().map(|x| kind.number(*x).powi(2)).sum::<f32>().sqrt(),
                };
                vertices.attributes[index].chunks(components).map(length).collect()
            }
            Self::Distance(from) => from.distances(&vertices.positions),
        }
    }
}

/// A lookup table of colours.
pub(super) struct Palette {
    colours: Vec<Vec3>,
    range: [f32; 2],
}

const STEPS: usize = 256;

impl Palette {
    pub(super) fn new(map: ColourMap, range: [f32; 2]) -> Self {
        let colours = (0..STEPS).map(|n| linear(map.of(n as f32 / (STEPS - 1) as f32))).collect();
        Self { colours, range }
    }

    pub(super) fn of(&self, value: f32) -> Vec3 {
        let [lo, hi] = self.range;
        let share = if hi > lo { (value - lo) / (hi - lo) } else { 0.5 };
        let at = (share.clamp(0.0, 1.0) * (STEPS - 1) as f32 + 0.5) as usize;
        if value.is_nan() { linear([128; 3]) } else { self.colours[at] }
    }
}

/// Draws a legend for the values from `lo` to `hi`. If `beyond` is true, the legend says that the
/// colours at the ends also stand for values outside this range.
pub(super) fn legend(
    image: &mut Image,
    name: &str,
    map: ColourMap,
    [lo, hi]: [f32; 2],
    beyond: bool,
) {
    let (width, height) = (image.width() as i32, image.height() as i32);
    let line = image.line();
    let (bar, long) = (line, height / 3);
    let (left, top) = (width - 2 * line - bar, (height - long) / 2);
    for y in 0..long {
        let colour = map.of(1.0 - (y as f32 + 0.5) / long as f32);
        for x in 0..bar {
            if let (Ok(x), Ok(y)) = (usize::try_from(left + x), usize::try_from(top + y)) {
                image.set(x, y, colour);
            }
        }
    }
    image.text(name, [left + bar, top - 2 * line], Alignment::Right);
    let [below, above] = if beyond { ["<= ", ">= "] } else { [""; 2] };
    for (share, before, value) in [(0, above, hi), (1, "", lo / 2.0 + hi / 2.0), (2, below, lo)] {
        let y = top + long * share / 2 - line / 2;
        image.text(&format!("{before}{}", number(value)), [left - line / 2, y], Alignment::Right);
    }
}

/// Formats a number with three decimals, or with a power of ten if it is very small or large.
fn number(value: f32) -> String {
    let size = value.abs();
    if size == 0.0 || (1e-2..1e4).contains(&size) {
        format!("{value:.3}")
    } else {
        format!("{value:.2e}")
    }
}

/// The fraction of distances within the colour range. Without this limit, a few outliers would give
/// all other distances nearly the same colour.
const RANGE_SHARE: f64 = 0.99;
/// Number of low bits of an f32 that the histogram ignores: 7 of the 23 bits of the mantissa
/// remain.
const IGNORED_BITS: u32 = 16;

/// Statistics of values, which determine their colour range.
#[derive(Clone, Default)]
pub(super) struct ValueStatistics {
    extremes: Option<[f32; 2]>,
    /// A histogram of the magnitudes of distances, in steps of less than 1 %; empty for other
    /// values.
    magnitudes: Vec<u32>,
}

impl ValueStatistics {
    /// Collects the statistics of finite values.
    pub(super) fn of(values: &[f32], kind: &ColourSource<'_>) -> Self {
        let finite = || values.iter().copied().filter(|value| value.is_finite());
        let mut magnitudes = Vec::new();
        if matches!(kind, ColourSource::Distance(_)) {
            magnitudes.resize(1 << (u32::BITS - 1 - IGNORED_BITS), 0);
            finite().for_each(|value| {
                magnitudes[(value.abs().to_bits() >> IGNORED_BITS) as usize] += 1
            });
        }
        let extremes =
            finite().map(|value| [value; 2]).reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]);
        Self { extremes, magnitudes }
    }

    /// Adds other statistics.
    pub(super) fn join(&mut self, other: &Self) {
        let both = [self.extremes, other.extremes].into_iter().flatten();
        self.extremes = both.reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]);
        self.magnitudes.resize(other.magnitudes.len(), 0);
        self.magnitudes.iter_mut().zip(&other.magnitudes).for_each(|(sum, count)| *sum += count);
    }

    /// The colour range, and whether values exceed it. For distances, zero is in the middle.
    pub(super) fn range(&self) -> (Option<[f32; 2]>, bool) {
        let Some([lo, hi]) = self.extremes else { return (None, false) };
        if self.magnitudes.is_empty() {
            return (Some([lo, hi]), false);
        }
        let greatest = lo.abs().max(hi.abs());
        let all: u64 = self.magnitudes.iter().map(|&count| u64::from(count)).sum();
        let usual = (all as f64 * RANGE_SHARE).ceil() as u64;
        let mut within = 0;
        let last = self.magnitudes.iter().position(|&count| {
            within += u64::from(count);
            within >= usual
        });
        // If almost all distances are zero, the greatest distance determines the range.
        let bound = match last {
            Some(last @ 1..) => f32::from_bits((last as u32 + 1) << IGNORED_BITS).min(greatest),
            _ => greatest,
        };
        (Some([-bound, bound]), bound < greatest)
    }
}
