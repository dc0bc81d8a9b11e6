//! `--method`: frames by discrete indicator functions, or by one of the kernel methods that the paper compares against.

use clap::ValueEnum;
use meniscus::brick::Census;
use meniscus::error::Error;
use meniscus::frame::{Counted, Frame, FrameError, KernelFrame, Shortfall};
use meniscus::laps::Laps;
use meniscus::particles::Particles;
use meniscus::rivals::Method;
use meniscus::simplify::{Reduction, Simplified};
use meniscus::stitch::Stitched;
use meniscus::units::MemoryBudget;
use serde::Serialize;

use crate::reconstruct::{IsoOption, Options};
use crate::sampling::SamplingRequest;

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MethodName {
    /// Discrete indicator functions.
    Dif,
    /// Mueller, Charypar and Gross 2003.
    Mueller,
    /// Zhu and Bridson 2005.
    ZhuBridson,
    /// Yu and Turk 2013.
    YuTurk,
}

impl Options {
    /// How the particles are to be sampled, whatever they are.
    pub fn request(&self) -> Result<SamplingRequest, Error> {
        let request = self.sampling.validate()?;
        Ok(match self.rival()? {
            None => request,
            Some(method) => request.for_kernels(method),
        })
    }

    /// The kernel method that was asked for, if it was one; refuses what has no meaning for it.
    fn rival(&self) -> Result<Option<Method>, Error> {
        let iso = match self.iso {
            IsoOption::Auto => Method::HALF,
            IsoOption::Value(iso) => iso.value(),
        };
        let method = match self.method {
            MethodName::Dif => return Ok(None),
            MethodName::Mueller => Method::Mueller { iso },
            MethodName::ZhuBridson => Method::ZhuBridson,
            MethodName::YuTurk => Method::YuTurk { iso },
        };
        let of_dif = [
            ("--sigma", self.sigma.is_some()),
            ("--detail", self.detail),
            ("--adaptive", self.adaptive),
            ("--indicator", self.sampling.indicator_given()),
            ("--mu0", self.sampling.mu0_given()),
            ("--backend vulkan", self.run.vulkan_given()),
            ("--iso", method == Method::ZhuBridson && matches!(self.iso, IsoOption::Value(_))),
        ];
        match of_dif.into_iter().find(|&(_, given)| given) {
            None => Ok(Some(method)),
            Some((option, _)) => Err(Error::Request(format!("{option} has no meaning for this --method"))),
        }
    }
}

/// A frame by whichever method, ready to be meshed.
pub enum Sampled {
    Dif(Frame),
    Kernels(KernelFrame),
}

impl Sampled {
    /// By `rival`, or by a DIF where it is `None`.
    pub fn of<P: Particles + ?Sized>(
        counted: Counted<'_, P>,
        rival: Option<Method>,
        budget: MemoryBudget,
        laps: &mut Laps,
    ) -> Result<Self, FrameError> {
        Ok(match rival {
            None => Self::Dif(Frame::sample_counted(counted, budget, laps)?),
            Some(method) => Self::Kernels(KernelFrame::sample_counted(counted, method, budget, laps)?),
        })
    }

    pub fn census(&self) -> Census {
        match self {
            Self::Dif(frame) => frame.facts().census,
            Self::Kernels(frame) => frame.census(),
        }
    }

    /// What went wrong with the backend so far, and was made good.
    pub fn warnings(&self) -> Vec<String> {
        match self {
            Self::Dif(frame) => frame.warnings(),
            Self::Kernels(_) => Vec::new(),
        }
    }

    /// Whether a surface of the frame holds far less than its particles, where their spacing is known.
    pub fn shortfall(&self, surface: &Stitched) -> Result<Option<Shortfall>, FrameError> {
        let (spacing, resources) = match self {
            Self::Dif(frame) => (frame.facts().spacing, frame.resources()),
            Self::Kernels(frame) => (frame.sampling().spacing, &frame.sampling().resources),
        };
        let Some(spacing) = spacing else { return Ok(None) };
        let found = Shortfall::of(surface, self.census().binned, spacing);
        found.map_err(|fault| FrameError::Scratch { folder: resources.scratch.clone(), fault })
    }

    /// The surface with what a reduction leaves of it.
    pub fn simplify(
        &self,
        surface: Stitched,
        reduction: &Reduction,
        laps: &mut Laps,
    ) -> Result<Simplified, FrameError> {
        match self {
            Self::Dif(frame) => frame.simplify(surface, reduction, laps),
            Self::Kernels(frame) => frame.simplify(surface, reduction, laps),
        }
    }
}
