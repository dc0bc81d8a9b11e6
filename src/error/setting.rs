//! Settings that exclude each other, or what they are asked of.

use std::fmt;
use std::path::PathBuf;

use crate::baselines::Method;
use crate::field::indicator::IndicatorKind;
use crate::io::output::MeshFormat;

/// A setting of a reconstruction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
#[allow(missing_docs)]
pub enum Setting {
    Spacing,
    CellSize,
    Cell,
    Origin,
    Domain,
    Periodic,
    Indicator,
    Mu0,
    SkipInvalid,
    ParticleType,
    Method,
    Smooth,
    Sigma,
    Iso,
    Detail,
    Normals,
    Attributes,
    Compression,
    Up,
    Backend,
    Parts,
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Spacing => "a spacing",
            Self::CellSize | Self::Cell => "a size of cells",
            Self::Origin => "an origin",
            Self::Domain => "a tank",
            Self::Periodic => "a periodic box",
            Self::Indicator => "an indicator",
            Self::Mu0 => "a mean number of particles (mu0)",
            Self::ParticleType => "a type of particles",
            Self::SkipInvalid => "skipping invalid particles",
            Self::Method => "a kernel method",
            Self::Smooth => "a width of smoothing",
            Self::Sigma => "the width of a Gaussian (sigma)",
            Self::Iso => "an isovalue",
            Self::Detail => "recovering details",
            Self::Normals => "vertex normals",
            Self::Attributes => "vertex attributes",
            Self::Compression => "compression",
            Self::Up => "another axis that points up",
            Self::Backend => "a device",
            Self::Parts => "a mesh in parts",
        })
    }
}

/// A setting, file or format that a setting conflicts with.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Conflict {
    /// The indicator that makes the field.
    Indicator(IndicatorKind),
    /// The kernel method that makes the field.
    Method(Method),
    /// A packed frame, of which the particles themselves are not there any more.
    Packed(PathBuf),
    /// A frame that was sampled already, otherwise than is asked for now.
    Sampled,
    /// The format of the mesh.
    Format {
        /// The mesh's file.
        path: PathBuf,
        /// The format by its name.
        format: MeshFormat,
    },
}

/// A setting that was given, and has no meaning for what it is asked of.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Unfit {
    /// The setting.
    pub setting: Setting,
    /// The setting, file or format that it conflicts with.
    pub with: Conflict,
}

impl fmt::Display for Unfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let setting = self.setting;
        match &self.with {
            Conflict::Indicator(kind) => {
                write!(f, "{setting} has no meaning for the indicator {}", kind.name())
            }
            Conflict::Method(_) => write!(f, "{setting} has no meaning for this kernel method"),
            Conflict::Packed(path) => {
                write!(f, "{}: {setting} needs the particles themselves", path.display())
            }
            Conflict::Sampled => {
                write!(f, "{setting} needs the particles themselves, and the frame is sampled already")
            }
            Conflict::Format { path, format } => {
                write!(f, "{}: {format} cannot hold {setting}", path.display())
            }
        }
    }
}

impl std::error::Error for Unfit {}
