//! Tests of reading and writing every format: valid files are read, and damaged files give errors.
#![allow(clippy::unwrap_used)]

mod alembic;
mod blocks;
mod build;
#[path = "../common/mod.rs"]
mod common;
#[cfg(feature = "hdf5")]
mod ghost_cells;
mod glb;
#[cfg(feature = "hdf5")]
mod hdf5;
mod houdini;
mod joined;
mod memory;
mod mesh_files;
mod mesh_memory;
mod mesh_pieces;
mod packed_frames;
mod parallel_vtk;
mod ply_vtk;
mod readers;
mod series;
#[cfg(feature = "hdf5")]
mod snapshots;
mod table_columns;
mod vdb;
mod vtk_meshes;
