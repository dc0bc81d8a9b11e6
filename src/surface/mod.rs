//! From the field to a mesh: dual marching cubes, attributes, stitching and simplifying, and what a mesh is checked and compared by.

pub mod attribute;
pub mod dual_mc;
pub mod mesh;
pub mod simplify;
pub mod stitch;
