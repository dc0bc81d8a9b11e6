//! From the field to a mesh: dual marching cubes, attributes, stitching and simplifying, and what a
//! mesh is checked, compared and looked at by.

pub mod attribute;
pub mod dual_mc;
pub mod mesh;
#[cfg(feature = "pictures")]
pub mod picture;
pub mod simplify;
pub mod solid;
pub mod stitch;
