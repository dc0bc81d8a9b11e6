//! Pictures of meshes: water under a soft sky, a solid colour, or a colour map of an attribute.
//!
//! Drawing has three steps: finding the visible triangle at every sample (`raster.rs`), collecting
//! data of the visible triangles (`visible.rs`), and computing radiance (`scene.rs`, `light.rs`).
//! Only the first step reads the whole mesh, batch by batch. The surface is closed. Therefore, the
//! sum of the depths at which a line of sight leaves the fluid, minus the sum of the depths at
//! which the line enters, is the path length through the water. This length determines the colour.
//! A picture has the same bytes for any number of threads.

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
