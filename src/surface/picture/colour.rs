//! The colours of a surface: water, one colour, or those of a value.

use std::str::FromStr;

use colorous::Gradient;
use glam::Vec3;

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

/// Appends the value of every vertex, if they are coloured by one.
pub(super) fn values_of(
    colour: &Colour,
    mesh: &dyn MeshSource,
    vertices: &Vertices<'_>,
    out: &mut Vec<f32>,
) -> Result<(), PictureError> {
    let Colour::Attribute { name, .. } = colour else { return Ok(()) };
    let attributes = mesh.attributes();
    let Some(index) = attributes.iter().position(|info| info.name == *name) else {
        let known: Vec<&str> = attributes.iter().map(|info| &*info.name).collect();
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        return Err(PictureError::NoAttribute { name: name.clone(), known });
    };
    let components = attributes[index].components;
    let values = vertices.attributes[index].chunks(components);
    out.extend(values.map(|value| match value {
        [value] => *value,
        vector => vector.iter().map(|x| x * x).sum::<f32>().sqrt(),
    }));
    Ok(())
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
