//! Watertight surface meshes from particle fluids.
pub mod brick;
pub mod estimate;
pub mod frame;
pub mod grid;
pub mod io;
pub mod memory;
pub mod mesh;
pub mod particles;
pub mod plateau;
pub mod recipe;
pub mod spacing;
pub mod stage;
pub mod stitch;
pub mod units;
