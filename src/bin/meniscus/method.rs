//! `--method`: frames by discrete indicator functions, or by one of the kernel methods that the paper compares against.

use clap::ValueEnum;
use meniscus::baselines::Method;
use meniscus::error::Error;
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
        let mut request = self.sampling.validate()?;
        if let Some(method) = self.rival()? {
            request.field = method.into();
        }
        // A packed frame says by itself what it is of.
        if let Some(asked) = request.field.indicator().filter(|_| !self.packed()) {
            self.refuse_of_others(asked.kind)?;
        }
        Ok(request)
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
            ("--smooth", self.smooth.is_some()),
            ("--sigma", self.sigma.is_some()),
            ("--detail", self.detail),
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
