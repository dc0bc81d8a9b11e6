//! `--method`: a surface by one of the kernel methods that the paper compares against.

use std::path::Path;

use bytesize::ByteSize;
use clap::ValueEnum;
use meniscus::error::Error;
use meniscus::frame::{self, FrameError, KernelSurface, Resources, rival_surface};
use meniscus::io::input::open_particles;
use meniscus::io::output::MeshFormat;
use meniscus::laps::Laps;
use meniscus::particles::Particles;
use meniscus::rivals::Method;
use meniscus::stage::dual_mc::Normals;
use serde_json::{Value, json};

use crate::reconstruct::{IsoOption, Options};
use crate::run::{Notes, unpacking};
use crate::sampling::{SamplingRequest, report_census};

#[derive(Clone, Copy, ValueEnum)]
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
    /// The kernel method that was asked for, if it was one; refuses what has no meaning for it.
    pub fn rival(&self) -> Result<Option<Method>, Error> {
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
            ("--backend vulkan", self.run.vulkan_given()),
            ("--iso", method == Method::ZhuBridson && matches!(self.iso, IsoOption::Value(_))),
        ];
        match of_dif.into_iter().find(|&(_, given)| given) {
            None => Ok(Some(method)),
            Some((option, _)) => Err(Error::Request(format!("{option} has no meaning for this --method"))),
        }
    }

    /// The surface by a kernel method, and what a program wants to know of it; `None` where nothing was to be done.
    #[allow(clippy::too_many_arguments, reason = "as for a DIF, and the method")]
    pub fn rival_frame(
        &self,
        method: Method,
        input: &Path,
        request: &SamplingRequest,
        format: MeshFormat,
        resources: Resources,
        laps: &mut Laps,
        notes: &Notes,
    ) -> Result<Option<(KernelSurface, Value)>, Error> {
        let file = open_particles(input, unpacking(&resources))?;
        laps.lap("open");
        notes.say(format!("{}: {} particles, {}", input.display(), file.particles.len(), file.format));
        let carried = self.carried(input, &file, format)?;
        let sampling = request.sampling_by_spacing(input, &file, carried, resources, notes)?;
        laps.lap("spacing");
        let in_file = |fault: FrameError| Error::Frame { path: input.to_owned(), fault };
        if self.dry_run {
            let (census, _) = frame::estimate(&file.particles, &sampling).map_err(in_file)?;
            let (cell, output) = (sampling.grid.cell_size(), self.output.display());
            let kernels = ByteSize(census.binned as u64 * method.kernel_bytes());
            crate::print(&format!(
                "would reconstruct {} particles with cells of {cell} into {output}\n\
                 kernels: {kernels} of memory or scratch, besides what the particles take",
                census.binned,
            ))?;
            return Ok(None);
        }
        let normals = if self.normals { Normals::Gradient } else { Normals::None };
        let surface = rival_surface(&file.particles, &sampling, method, normals, laps).map_err(in_file)?;
        report_census(surface.census, notes);
        let (name, iso) = match method {
            Method::Mueller { iso } => ("mueller", Some(iso)),
            Method::ZhuBridson => ("zhu-bridson", None),
            Method::YuTurk { iso } => ("yu-turk", Some(iso)),
        };
        let facts = json!({
            "particles": surface.census.binned,
            "not_finite": surface.census.not_finite,
            "too_far": surface.census.too_far,
            "outside_domain": surface.census.outside,
            "cell_size": sampling.grid.cell_size(),
            "origin": sampling.grid.origin().to_array(),
            "domain": sampling.domain.map(|domain| domain.walls().map(|wall| wall.to_array())),
            "method": name,
            "spacing": sampling.spacing,
            "isovalue": iso,
            "backend": "CPU",
        });
        Ok(Some((surface, facts)))
    }
}
