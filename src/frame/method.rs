//! The method that computes the field of a frame.

use crate::baselines::KernelMethod;
use crate::brick::BrickSide;
use crate::field::calibration::Calibration;
use crate::field::indicator::{Indicator, IndicatorKind};
use crate::grid::units::MeanCount;

/// A method that computes a field from particles, chosen before the particles are read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Method {
    /// A discrete indicator: the cloud indicator, from which distances are computed, or an
    /// indicator of the paper.
    Indicator {
        /// The kind of the indicator.
        kind: IndicatorKind,
        /// `mu0`, for counting; if `None`, it is measured on the frame (eq. 4).
        mean: Option<MeanCount>,
    },
    /// Kernels whose width depends on the spacing. They run on the CPU only.
    Kernels(KernelMethod),
}

impl Method {
    /// The kind of the indicator; `None` for kernels.
    pub fn indicator(self) -> Option<IndicatorKind> {
        match self {
            Self::Indicator { kind, .. } => Some(kind),
            Self::Kernels(_) => None,
        }
    }

    /// The method with the `mu0` of a calibration that all frames of a simulation share.
    pub fn calibrated(self, by: Option<&Calibration>) -> Self {
        by.map_or(self, |known| self.with_mean(known.mean()))
    }

    /// The method with another `mu0`; kernels have none.
    pub fn with_mean(self, mean: Option<MeanCount>) -> Self {
        match self {
            Self::Indicator { kind, .. } => Self::Indicator { kind, mean },
            Self::Kernels(_) => self,
        }
    }

    /// The best brick size for the samples.
    pub fn brick_side(self) -> BrickSide {
        self.indicator().map_or_else(BrickSide::default, IndicatorKind::brick_side)
    }
}

/// Creates a method that measures mu0.
impl From<IndicatorKind> for Method {
    fn from(kind: IndicatorKind) -> Self {
        Self::Indicator { kind, mean: None }
    }
}

/// Creates a method with the mu0 of another frame's indicator.
impl From<Indicator> for Method {
    fn from(indicator: Indicator) -> Self {
        Self::Indicator { kind: indicator.kind(), mean: indicator.mean() }
    }
}

impl From<KernelMethod> for Method {
    fn from(method: KernelMethod) -> Self {
        Self::Kernels(method)
    }
}
