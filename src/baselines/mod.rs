//! The kernel methods that the paper compares against (section 3). They use the same bins, dual
//! grid and stitching as discrete indicator functions (DIFs).
//!
//! Each method sums contributions of the particles around the centre of a cell. The contribution of
//! a particle is its kernel, which is computed once from the particles around it. The field of a
//! block then follows from the sum of the kernels that reach the block. In these modules, a field
//! has real values, which are positive inside the fluid. Lengths are in cells.
//!
//! Sums run over the bins along the Morton curve and, within a bin, over the particles in order of
//! cell and position. The sums are therefore the same for any number of threads. Positions are
//! rounded to 1 / 8192 of a cell, as for the DIF.

mod eigen;
mod kernels;
mod mueller;
mod neighbours;
mod scheme;
mod yu_turk;
mod zhu_bridson;

use std::io;
use std::path::Path;

use crate::brick::Bins;

pub use kernels::KernelField;
use kernels::Kernels;
use mueller::Mueller;
use scheme::Scheme;
pub use scheme::{Spacing, TooManyCells};
use yu_turk::YuTurk;
use zhu_bridson::ZhuBridson;

/// A kernel method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum KernelMethod {
    /// Mueller, Charypar and Gross 2003 (their eq. 2).
    Mueller {
        /// The isovalue of the surface. Deep in the fluid, the field is about 1.
        iso: f64,
    },
    /// Zhu and Bridson 2005.
    ZhuBridson,
    /// Yu and Turk 2013.
    YuTurk {
        /// The isovalue of the surface, as for Mueller.
        iso: f64,
    },
}

impl KernelMethod {
    /// The isovalue halfway between inside and outside.
    pub const HALF: f64 = 0.5;

    /// The name of the method.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Mueller { .. } => "mueller",
            Self::ZhuBridson => "zhu-bridson",
            Self::YuTurk { .. } => "yu-turk",
        }
    }

    /// The isovalue of the surface; `None` if the method itself defines the surface.
    #[must_use]
    pub fn iso(self) -> Option<f64> {
        match self {
            Self::Mueller { iso } | Self::YuTurk { iso } => Some(iso),
            Self::ZhuBridson => None,
        }
    }

    /// The distance, in cells, within which a particle affects the field: through its own kernel,
    /// and through the kernels of its neighbours, which depend on the particle. `spacing` is in
    /// cells.
    #[must_use]
    pub fn reach(self, spacing: f64) -> i32 {
        let support = Spacing::SUPPORT * spacing;
        let reach = match self {
            Self::Mueller { .. } => 2.0 * support,
            Self::ZhuBridson => support,
            Self::YuTurk { .. } => yu_turk::REACH * support,
        };
        reach.ceil() as i32
    }

    /// Bytes of a particle's kernel, which is kept until the surface is finished.
    #[must_use]
    pub fn kernel_bytes(self) -> u64 {
        let bytes = match self {
            Self::Mueller { .. } => size_of::<<Mueller as Scheme>::Kernel>(),
            Self::ZhuBridson => size_of::<<ZhuBridson as Scheme>::Kernel>(),
            Self::YuTurk { .. } => size_of::<<YuTurk as Scheme>::Kernel>(),
        };
        bytes as u64
    }

    /// Bytes per cell while a field is computed: the bytes of the largest sum plus the bytes of the
    /// field.
    pub const CELL_BYTES: u64 =
        (size_of::<<ZhuBridson as Scheme>::Sum>() + size_of::<f64>()) as u64;
}

/// Computes the kernels of all particles of `bins`, which must be [sorted](Bins::sorted). If the
/// kernels need more than `bytes` bytes, they go to a scratch file in `folder`.
///
/// # Errors
/// If a scratch file cannot be created, read or written.
pub fn kernel_field(
    bins: &Bins,
    method: KernelMethod,
    spacing: Spacing,
    bytes: u64,
    folder: &Path,
) -> io::Result<Box<dyn KernelField>> {
    Ok(match method {
        KernelMethod::Mueller { iso } => {
            Box::new(Kernels::of(bins, Mueller::new(spacing, iso), bytes, folder)?)
        }
        KernelMethod::ZhuBridson => {
            Box::new(Kernels::of(bins, ZhuBridson::new(spacing), bytes, folder)?)
        }
        KernelMethod::YuTurk { iso } => {
            Box::new(Kernels::of(bins, YuTurk::new(spacing, iso), bytes, folder)?)
        }
    })
}
