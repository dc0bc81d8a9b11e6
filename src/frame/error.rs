//! Errors of a frame.

use std::io;
use std::path::PathBuf;

use bytesize::ByteSize;
use thiserror::Error;

use crate::baselines::TooManyCells;
use crate::brick::vulkan::DeviceBinError;
use crate::brick::{BinError, Census};
use crate::field::calibration::{NoMeanCount, TooFine};
use crate::field::recipe::{Filters, Recipe};
use crate::frame::estimate::OverBudget;
use crate::grid::units::{Isovalue, shown, significant};
use crate::particles::RereadError;
use crate::particles::kind::KindFault;
use crate::surface::simplify::TooSmall;
use crate::surface::solid::Solid;
use crate::system::cancel::Cancelled;
use crate::vulkan::VulkanError;

/// An error of the reconstruction of a frame.
#[derive(Debug, Error)]
pub enum FrameError {
    /// No particles remain from which a surface can be made.
    #[error("no particles to reconstruct: {}", skipped_particles_text(.0))]
    NoParticles(Census),
    /// A particle cannot be placed in a bin, or there are too many bins.
    #[error(transparent)]
    Bin(#[from] BinError),
    /// The particles changed, or could not be read again.
    #[error(transparent)]
    Unread(#[from] RereadError),
    /// The values of an attribute do not fit the kind of number that the mesh stores.
    #[error(transparent)]
    Kind(#[from] KindFault),
    /// The frame does not fit into its memory budget.
    #[error(transparent)]
    OverBudget(#[from] OverBudget),
    /// mu0, the mean number of particles in full cells, could not be measured.
    #[error(transparent)]
    MeanCount(#[from] NoMeanCount),
    /// The field does not locate the surface precisely enough.
    #[error(transparent)]
    TooFine(#[from] TooFine),
    /// The field is nowhere above the isovalue.
    #[error(
        "the surface is empty: the field is nowhere above the isovalue {}; use a lower isovalue or \
         smaller cells",
        significant(iso.value(), 4)
    )]
    NoSurface {
        /// The isovalue, given or measured.
        iso: Isovalue,
    },
    /// No cell's centre is inside the fluid, according to the cloud indicator.
    #[error("the surface is empty: {}", no_centre(*at_solids))]
    NoDistanceSurface {
        /// Whether the fluid ends at solids, which may cover all of it.
        at_solids: bool,
    },
    /// The calibration was measured on a frame with a different indicator, so it cannot be used.
    #[error(
        "this packed frame has a different indicator than the calibration frame; pack it again \
         with the same indicator"
    )]
    OtherIndicator,
    /// The calibration was measured on a frame with other cells or another spacing, so it cannot be
    /// used.
    #[error(
        "this packed frame has cells of {} and spacing {}, but the calibration frame has cells of \
         {} and spacing {}; pack all frames again with the same spacing and cell size",
        shown(own[0]), shown(own[1]), shown(calibrated[0]), shown(calibrated[1])
    )]
    OtherCells {
        /// The cell size and the spacing of the frame.
        own: [f64; 2],
        /// The cell size and the spacing of the calibration frame.
        calibrated: [f64; 2],
    },
    /// The images were made for filters with a smaller reach.
    #[error(
        "the packed or sampled frame has copies of particles only up to {there} cells beyond the \
         faces of its periodic box, but these settings need {needed} cells; use less smoothing, or \
         make the surface from the original particles"
    )]
    FewImages {
        /// The reach, in cells, of the filters beyond a face.
        needed: i32,
        /// The distance, in cells, beyond a face up to which images exist.
        there: i32,
    },
    /// Kernels need a spacing, which determines their width.
    #[error(
        "kernel methods (mueller, zhu-bridson and yu-turk) need the spacing of the particles; set \
         the spacing"
    )]
    NoSpacing,
    /// The grid is too fine for kernels.
    #[error(transparent)]
    Kernels(#[from] TooManyCells),
    /// The field of a kernel method is not positive anywhere.
    #[error("the surface is empty: no cell centre is inside the fluid; use smaller cells")]
    NoKernelSurface,
    /// The scratch files for data beyond the memory budget would not fit on the disk; nothing was
    /// written.
    #[error(
        "scratch files need at least {} in {}, which has {} free",
        ByteSize(*needed), folder.display(), ByteSize(*free)
    )]
    NoRoom {
        /// The scratch folder.
        folder: PathBuf,
        /// Minimum size, in bytes, of the scratch files.
        needed: u64,
        /// Free disk space, in bytes.
        free: u64,
    },
    /// Attributes have so many components that the values of a single block of the surface exceed
    /// the budget.
    #[error(
        "the attributes have {components} numbers per particle and need at least {} of memory, \
         but the limit is {}; transfer fewer attributes, or raise the limit",
        ByteSize(*needed), ByteSize(*budget)
    )]
    WideAttributes {
        /// Number of components per particle and vertex.
        components: usize,
        /// Minimum memory, in bytes.
        needed: u64,
        /// The budget, in bytes.
        budget: u64,
    },
    /// Every component is smaller than the minimum size.
    #[error("the surface is empty: {} removed {}", .0.limits(), all_components(.0))]
    NothingLeft(TooSmall),
    /// A mesh on a device has more vertices or triangles than 32 bits can count.
    #[error(
        "the surface has more vertices or triangles than 32 bits can count; use a larger cell \
         size"
    )]
    TooManyVertices,
    /// The surface does not fit into the caller's buffers.
    #[error(
        "the surface has {vertices} vertices and {triangles} triangles, more than the given \
         buffers can hold; use larger buffers"
    )]
    NoSpace {
        /// Number of vertices; each takes three f32.
        vertices: u32,
        /// Number of triangles; each takes three u32.
        triangles: u32,
    },
    /// The device that holds the particles and the mesh failed, or has too little memory.
    #[error(transparent)]
    Vulkan(#[from] VulkanError),
    /// The caller cancelled.
    #[error("cancelled")]
    Cancelled,
    /// A scratch file for data beyond the memory budget failed.
    #[error("cannot use scratch files in {}: {fault}", folder.display())]
    Scratch {
        /// The scratch folder.
        folder: PathBuf,
        /// The error of the scratch file.
        #[source]
        fault: io::Error,
    },
}

/// The reason for a surface that encloses no cell centre, and the remedy.
pub(crate) fn no_centre(at_solids: bool) -> &'static str {
    if at_solids {
        "no cell centre is inside the fluid and outside the solids; if the solids cover the fluid, \
         move them, and otherwise use smaller cells"
    } else {
        "no cell centre is inside the fluid; use smaller cells"
    }
}

impl From<Cancelled> for FrameError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<DeviceBinError> for FrameError {
    fn from(error: DeviceBinError) -> Self {
        match error {
            DeviceBinError::Bin(error) => Self::Bin(error),
            DeviceBinError::Vulkan(error) => Self::Vulkan(error),
        }
    }
}

fn skipped_particles_text(census: &Census) -> String {
    let &Census { not_finite, too_far, outside, .. } = census;
    let are = |count| if count == 1 { "is" } else { "are" };
    let have = if not_finite == 1 { "has a position that is" } else { "have positions that are" };
    let counts = [
        (not_finite, format!("{have} not finite")),
        (too_far, format!("{} too far from the origin of the grid", are(too_far))),
        (outside, format!("{} outside the domain or the periodic box", are(outside))),
    ];
    let counts = counts.iter().filter(|(count, _)| *count > 0);
    let clauses: Vec<String> = counts.map(|(count, why)| format!("{count} {why}")).collect();
    match &clauses[..] {
        [] => "the input has none".into(),
        [only] => only.clone(),
        [others @ .., last] => format!("{}, and {last}", others.join(", ")),
    }
}

/// The grammatical object of a message that says that all components of a surface were removed.
fn all_components(small: &TooSmall) -> String {
    match small.total() {
        1 => "its only component".into(),
        total => format!("all of its {total} components"),
    }
}

impl FrameError {
    /// Returns the error for a surface that `recipe` leaves empty, with or without a solid.
    pub(super) fn no_surface(recipe: &Recipe, solid: Option<&Solid>) -> Self {
        match recipe.filters {
            Filters::Paper(_) => Self::NoSurface { iso: recipe.iso },
            Filters::Distances(_) => Self::NoDistanceSurface { at_solids: solid.is_some() },
        }
    }
}
