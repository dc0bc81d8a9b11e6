//! From the field to a mesh: dual marching cubes, attributes, stitching and simplifying; checks,
//! comparisons and pictures of meshes.

pub mod attribute;
pub mod dual_mc;
pub mod level_set;
pub mod mesh;
#[cfg(feature = "pictures")]
pub mod picture;
pub mod simplify;
pub mod solid;
pub mod stitch;
