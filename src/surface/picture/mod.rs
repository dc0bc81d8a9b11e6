//! Pictures of meshes: water under a soft sky, a solid colour, or an attribute by a colour map.
//!
//! Drawn in two steps: what is seen at every sample (`raster.rs`), then what light makes of it (`light.rs`). The fluid is closed, so the
//! depths at which a line of sight leaves it less those at which it enters are the way through the water, which is what it is coloured
//! by. A picture has the same bytes for any number of threads.

mod camera;
mod colour;
mod draw;
mod error;
mod image;
mod light;
mod raster;
mod request;

pub use camera::View;
pub use colour::{Colour, ColourMap};
pub use error::PictureError;
pub use image::{Animation, Image};
pub use request::{Picture, Scope};
