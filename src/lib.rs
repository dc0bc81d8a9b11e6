//! Watertight surface meshes from particle fluids.
pub mod io;
pub mod mesh;
pub mod particles;
pub mod units;
