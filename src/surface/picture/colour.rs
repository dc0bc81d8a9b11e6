//! The colours of a surface: water, one colour, or those of a value.

use std::str::FromStr;
use std::sync::Arc;

use colorous::Gradient;
use glam::Vec3;

use crate::surface::mesh::Mesh;
use crate::surface::mesh::compare::Surface;
use crate::surface::mesh::source::{MeshSource, Vertices};

use super::error::PictureError;
use super::light::linear;

/// The colours of a surface.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub enum Colour {
    /// Water: mirrors the sky, lets through what is behind, and is the bluer the deeper it is.
    #[default]
    Water,
    /// One colour: red, green and blue as screens show them.
    Solid([u8; 3]),
    /// A value of the vertices, or the length of a vector, with a legend.
    Attribute {
        /// The attribute's name.
        name: String,
        /// Colours from its least to its greatest value.
        map: ColourMap,
    },
    /// The distance from another surface, negative inside of it, with a legend in the meshes' unit of length. The hundredth of the vertices
    /// that are farthest from it has the colours of the ends.
    Distance {
        /// The other surface.
        from: Reference,
        /// Colours from the farthest inside of it to as far outside.
        map: ColourMap,
    },
}

impl Colour {
    /// Names the subject of the legend, if there is one, and its colours.
    pub(super) fn legend(&self) -> Option<(&str, ColourMap)> {
        match self {
            Self::Water | Self::Solid(_) => None,
            Self::Attribute { name, map } => Some((name, *map)),
            Self::Distance { map, .. } => Some(("distance", *map)),
        }
    }
}

/// A surface that distances are measured from.
#[derive(Debug, Clone)]
pub struct Reference(Arc<Surface>);

impl Reference {
    /// Makes the triangles of a mesh ready to be searched.
    ///
    /// # Errors
    /// [`PictureError::Reference`] where it has no surface, or a vertex that is no point.
    pub fn new(mesh: &Mesh) -> Result<Self, PictureError> {
        Ok(Self(Arc::new(Surface::reference(mesh).map_err(PictureError::Reference)?)))
    }

    fn distances(&self, places: &[[f64; 3]]) -> Vec<f32> {
        self.0.signed_distances(places).into_iter().map(|distance| distance as f32).collect()
    }
}

impl PartialEq for Reference {
    /// Whether both are one.
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// Colours for values from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ColourMap(usize);

/// Maps by their names, first those that are fair to all eyes (Liu and Heer 2018).
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

/// The number of the map whose middle is pale.
const DIVERGING: usize = MAPS.len() - 1;

impl ColourMap {
    /// Names of all maps.
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

    /// The colour of a value from 0 to 1; what is no number is grey.
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
        found
            .map(Self)
            .ok_or_else(|| PictureError::Map { name: name.to_owned(), known: Self::NAMES.join(", ") })
    }
}

/// Values that vertices are coloured by.
pub(super) enum Values<'a> {
    None,
    /// An attribute of so many components.
    Attribute {
        index: usize,
        components: usize,
    },
    /// The distance from a surface.
    Distance(&'a Reference),
}

impl<'a> Values<'a> {
    /// The values by which a mesh gets its colours.
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
        Ok(Self::Attribute { index, components: attributes[index].components })
    }

    /// Whether there are any.
    pub(super) fn any(&self) -> bool {
        !matches!(self, Self::None)
    }

    /// The value of every vertex, if there are any.
    pub(super) fn of(&self, vertices: &Vertices<'_>) -> Vec<f32> {
        match *self {
            Self::None => Vec::new(),
            Self::Attribute { index, components } => {
                let length = |value: &[f32]| match value {
                    [value] => *value,
                    vector => vector.iter().map(|x| x * x).sum::<f32>().sqrt(),
                };
                vertices.attributes[index].chunks(components).map(length).collect()
            }
            Self::Distance(from) => from.distances(&vertices.positions),
        }
    }
}

/// Colours of values in steps, so that a sample is looked up and not worked out.
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
