//! The method by which the field of a frame is made.

use crate::baselines::KernelMethod;
use crate::brick::BrickSide;
use crate::field::calibration::Calibration;
use crate::field::indicator::{Indicator, IndicatorKind};
use crate::grid::units::MeanCount;

/// A method to make a field of particles, decided before any of them is read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Method {
    /// A discrete indicator: clouds, which distances are told by, or one of the paper's.
    Indicator {
        /// The kind of the indicator.
        kind: IndicatorKind,
        /// `mu0`, for counting; measured on the frame (eq. 4) where it is `None`.
        mean: Option<MeanCount>,
    },
    /// Kernels as wide as the spacing says, on the processor.
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

    /// The method with the `mu0` of a calibration, which all frames of a simulation share.
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

    /// The bricks that suit the samples.
    pub fn brick_side(self) -> BrickSide {
        self.indicator().map_or_else(BrickSide::default, IndicatorKind::brick_side)
    }
}

/// Asks for mu0 to be measured.
impl From<IndicatorKind> for Method {
    fn from(kind: IndicatorKind) -> Self {
        Self::Indicator { kind, mean: None }
    }
}

/// The method that makes another frame alike.
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
