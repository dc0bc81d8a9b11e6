//! Pictures of meshes: water under a soft sky, a solid colour, or an attribute by a colour map.
//!
//! Drawn in three steps: which triangle is seen at every sample (`raster.rs`), what there is to
//! know of those that are (`visible.rs`), and what light makes of it (`scene.rs`, `light.rs`). Only
//! the first step sees all of a mesh, batch by batch. The fluid is closed, so the depths at which a
//! line of sight leaves it less those at which it enters are the way through the water, which is
//! what it is coloured by. A picture has the same bytes for any number of threads.

mod camera;
mod colour;
mod draw;
mod fill;
mod image;
mod light;
mod ranked;
mod raster;
mod request;
mod scene;
mod shape;
mod sun;
mod visible;

pub use camera::View;
pub use colour::{Colour, ColourMap, Reference};
pub(crate) use image::source_of_png;
pub use image::{Animation, Image};
pub use request::PictureError;
pub use request::{Effort, Picture, Scope};
