//! The public interface for single frames: turns particles into a surface, and chooses the
//! defaults.
//!
//! There are four ways to make a frame's mesh. All take the same steps:
//!
//! | | plan | sample | extract | write |
//! |---|---|---|---|---|
//! | a whole frame: `opened`, `frame` | chooses the cells and counts the particles in one reading | all particles, `CheckedRequest::engine` | `extract` | `output` |
//! | in parts: `parts` | once for all parts, `parts/plan.rs`, stored in `plan.json` | the bins that affect the part's blocks, `parts/make.rs` | only its blocks; `parts/merge.rs` stitches all | a file of blocks, then `output` |
//! | of a simulation: `simulation` | calibrated on one frame, `simulation/freeze.rs` | in parallel or alone, `simulation/one_frame.rs` | `extract_or_empty` | one thread fills the file, and another thread renames it |
//! | live: `simulation/live.rs` | calibrated on the first suitable frame, in memory | all particles, `CheckedRequest::engine` | `extract_or_empty` | the caller |
//!
//! The guide `limits.md` lists limits.

pub mod as_numbers;
mod attributes;
mod builder;
mod cells;
mod checked;
mod extract;
mod frame;
mod info;
mod lattice;
#[cfg(test)]
#[cfg(feature = "pictures")]
mod messages;
mod needs;
mod on_device;
mod opened;
mod orientation;
mod output;
mod particles;
mod parts;
mod report;
mod request;
mod run;
mod solids;
mod spacing;
mod surface;
mod threads;
mod warning;
mod width;

pub use attributes::NoVelocity;
pub use builder::Reconstruction;
pub use cells::{CellSize, Cells, FoundWalls, Slab, SpacingHints};
pub(crate) use checked::{CheckedRequest, StartedRequest};
pub(crate) use extract::ExtractedSurface;
pub use frame::Frame;
pub use info::{
    FrameInfo, GeometryInfo, Info, MeshInfo, ParticlesInfo, VolumeInfo, info, info_with,
};
pub use lattice::{moved, on_sound_grid, origin_for_lattice};
pub use needs::Needs;
pub(crate) use needs::mesh_bytes;
pub use opened::OpenedFrame;
pub(crate) use orientation::Orientation;
pub use orientation::usual_up;
pub use output::{Output, PackReport, PackedOutput};
pub(crate) use output::{TemporaryOutput, coordinate_width, refuse_same_file};
pub use particles::open_particles;
pub use parts::{PartDone, PartNeeds, PartShare, Parts, PartsPlan};
pub use report::Report;
pub use request::{ChosenSampling, SamplingRequest, WallSearch};
pub use spacing::{SpacingMistake, SpacingSource, SpacingWarning};
pub use surface::Surface;
pub(crate) use surface::format_warnings;
#[cfg(feature = "pictures")]
pub(crate) use threads::Threads;
pub use warning::{EmptyReason, Warning};
pub(crate) use warning::{alpha_warnings, lost_warning, missing_attributes};
pub use width::SinglePrecision;
