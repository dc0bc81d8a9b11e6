//! The frames of a simulation: their files, their shared calibration, and the records of finished
//! frames.
//!
//! The surface of a frame depends on the frame's particles and on a calibration, which is measured
//! on the first suitable frame and stored in a state file next to the outputs. After that, frames
//! are independent: every process that converts a given frame writes the same bytes. For each
//! finished frame, a record is stored next to the state. The record is written after the output was
//! renamed to its final name, so an output with a record is complete.
//!
//! The guide for users is `guide.md`.

mod builder;
mod conversion;
mod event;
mod forecast;
mod frame_file;
mod freeze;
mod gaps;
mod gate;
mod inferred;
pub mod inputs;
mod lanes;
mod live;
pub mod naming;
mod numbered;
mod one_frame;
pub mod pattern;
#[cfg(feature = "pictures")]
mod pictures;
mod pieces;
mod placeholder;
pub mod records;
mod run;
mod setup;
pub mod shared_calibration;
mod small_meshes;
mod solids;
pub mod state;
mod tally;
mod watch;

use std::sync;

pub use builder::Simulation;
pub use event::{
    Event, FrameCounts, FrameDone, FrameFailed, MissingFrames, OmittedCounts, Summary, UnreachedEnd,
};
pub use forecast::{Forecast, LargestFrame};
pub use frame_file::FrameFile;
pub use inputs::{files, frames};
pub use live::LiveSimulation;
#[cfg(feature = "pictures")]
pub use pictures::{PictureDone, PictureFile, Pictures, Sheet, SheetDone};
pub use shared_calibration::{SharedCalibration, Trust};
