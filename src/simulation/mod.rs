//! The frames of a simulation: which files they are, what is measured once for all of them, and
//! what is known of each that is done.
//!
//! What the surface depends on besides a frame's own particles is measured on the first frame that
//! can tell, frozen, and kept in a state file beside the outputs. From then on frames are
//! independent: whoever converts one, when and where, gets the same bytes. A frame that is done
//! leaves a record beside the state; the record is written after the output has got its name, so an
//! output with a record is whole.
//!
//! The guide for users is `guide.md`.

mod builder;
mod conversion;
mod event;
mod forecast;
mod frame_file;
mod freeze;
pub mod frozen;
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
mod small_meshes;
pub mod state;
mod tally;
mod watch;

use std::sync;

pub use builder::Simulation;
pub use event::{Event, FrameDone, FrameFailed, LeftOut, Missing, Summary, Tallied};
pub use forecast::{Forecast, Largest};
pub use frame_file::FrameFile;
pub use frozen::{Frozen, Trust};
pub use inputs::{files, frames};
pub use live::LiveSimulation;
#[cfg(feature = "pictures")]
pub use pictures::{PictureDone, PictureFile, Pictures, Sheet, SheetDone};
