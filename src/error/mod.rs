//! The errors of the library, each with the file that it concerns and with its cause.

mod parts;
mod setting;
mod simulation;

use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use thiserror::Error;

pub use crate::brick::BinError;
pub use crate::field::calibration::{Remedy, TooFine};
pub use crate::field::indicator::IndicatorKind;
pub use crate::field::spacing::NoEstimate;
pub use crate::frame::FrameError;
pub use crate::frame::estimate::OverBudget;
pub use crate::grid::units::{UnitError, shown, significant};
pub use crate::grid::{DomainError, PeriodicError};
pub use crate::io::{ColourScale, ReadError, ReadFault, WriteError, WriteFault};
pub use crate::particles::RereadError;
pub use crate::particles::kind::KindFault;
pub use crate::particles::selection::SelectionFault;
pub use crate::particles::sizes::SizeFault;
pub use crate::settings::Setting;
pub use crate::surface::mesh::compare::CompareError;
#[cfg(feature = "pictures")]
pub use crate::surface::picture::PictureError;
pub use crate::surface::solid::SolidFault;
pub use crate::surface::stitch::WholeMeshError;
pub use crate::vulkan::VulkanError;
pub use parts::PartsError;
pub use setting::{Conflict, SettingConflict};
pub use simulation::{FPS, SimulationError, WhyOne};

use crate::io::UnreadPart;
use crate::particles::{AttributeInfo, attribute_called, particle_count};
use crate::system::cancel::Cancelled;

/// Anything that can go wrong between a particle file and a mesh file.
///
/// The message is complete: it names the file, the place, and the system's error. `source()`
/// returns the underlying error, such as [`std::io::Error`]; do not append its message, which is
/// already included.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// An invalid request.
    #[error("{0}")]
    Request(String),
    /// A setting that does not apply to the request.
    #[error(transparent)]
    SettingConflict(#[from] SettingConflict),
    /// A request that names a file twice: as an input and an output, or as two outputs.
    #[error("{}", same_file(path, other))]
    SameFile {
        /// The file.
        path: PathBuf,
        /// The other name by which the request refers to the file.
        other: PathBuf,
    },
    /// The caller cancelled the work.
    #[error("cancelled")]
    Cancelled,
    /// A number out of range.
    #[error(transparent)]
    Unit(#[from] UnitError),
    /// An invalid domain.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// An invalid periodic box.
    #[error(transparent)]
    Periodic(#[from] PeriodicError),
    /// An input file that cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Conditions that cannot be applied to particles in memory, or that no particle satisfies.
    #[error(transparent)]
    Selection(SelectionFault),
    /// A requested Vulkan device that cannot be used.
    #[error(transparent)]
    Vulkan(#[from] VulkanError),
    /// An output file that cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// A frame of particles that cannot be reconstructed.
    #[error("{}{fault}", file(path.as_deref()))]
    Frame {
        /// The file, if the particles come from one.
        path: Option<PathBuf>,
        /// The fault.
        #[source]
        fault: FrameError,
    },
    /// A simulation that cannot be converted.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// A mesh that cannot be held in memory as a whole.
    #[error(transparent)]
    WholeMesh(#[from] WholeMeshError),
    /// An error while making a mesh in parts.
    #[error(transparent)]
    Parts(#[from] PartsError),
    /// A mesh that cannot be compared.
    #[error("{}: {fault}", path.display())]
    Mesh {
        /// The file.
        path: PathBuf,
        /// The fault.
        #[source]
        fault: CompareError,
    },
    /// A mesh that cannot be used as a solid.
    #[error("{}: {fault}", path.display())]
    Solid {
        /// The file.
        path: PathBuf,
        /// The fault.
        #[source]
        fault: SolidFault,
    },
    /// A picture that cannot be drawn.
    #[cfg(feature = "pictures")]
    #[error("{}{fault}", file(path.as_deref()))]
    Picture {
        /// The mesh file, if there is one.
        path: Option<PathBuf>,
        /// The fault.
        #[source]
        fault: PictureError,
    },
    /// An attribute that the particles do not have.
    #[error(
        "{}no attribute {name:?}; {}",
        file(path.as_deref()), available(left_out.as_deref(), known)
    )]
    NoAttribute {
        /// The file, if the particles come from one.
        path: Option<PathBuf>,
        /// The requested attribute.
        name: String,
        /// The names of the available attributes.
        known: Vec<String>,
        /// Description of the part of the file that has this name, if the reader skipped that part.
        left_out: Option<String>,
    },
    /// Particle sizes that cannot be taken from an attribute.
    #[error("{}{fault}", file(path.as_deref()))]
    Sizes {
        /// The file, if the particles come from one.
        path: Option<PathBuf>,
        /// The fault.
        #[source]
        fault: SizeFault,
    },
    /// A memory limit that is too small for any frame.
    #[error("{}the memory limit must be at least {}", to_simplify(*simplifying), ByteSize(*least))]
    LittleMemory {
        /// The smallest possible limit, in bytes.
        least: u64,
        /// The number of threads, if the minimum comes from simplifying.
        simplifying: Option<usize>,
    },
    /// Threads that cannot be started.
    #[error("cannot start threads: {0}")]
    Threads(String),
    /// The spacing is neither given nor in the file, and cannot be estimated.
    #[error(
        "{}cannot estimate the spacing of {}: {why}{}; {}",
        file(path.as_deref()),
        particle_count(*particles),
        suggestion(*suggested),
        remedy(*why)
    )]
    NoSpacing {
        /// The file, if the particles come from one.
        path: Option<PathBuf>,
        /// The number of particles.
        particles: usize,
        /// The reason.
        why: NoEstimate,
        /// The spacing that the nearest neighbours suggest.
        suggested: Option<f64>,
    },
}

/// The beginning of a message about a file: its path and a colon.
fn file(path: Option<&Path>) -> String {
    path.map_or(String::new(), |path| format!("{}: ", path.display()))
}

fn remedy(why: NoEstimate) -> &'static str {
    match why {
        NoEstimate::NotFinite => "repair the input",
        _ => "set the spacing or the cell size",
    }
}

fn suggestion(suggested: Option<f64>) -> String {
    suggested.map_or(String::new(), |d| {
        format!("; their nearest neighbours suggest a spacing of {}", significant(d, 3))
    })
}

fn to_simplify(threads: Option<usize>) -> String {
    threads.map_or(String::new(), |threads| format!("to simplify with {threads} threads, "))
}

fn same_file(path: &Path, other: &Path) -> String {
    let path = path.display();
    match other.display() {
        other if other.to_string() == path.to_string() => {
            format!(
                "{path}: this file is named twice, as an input and an output or as two outputs; \
                 choose another output"
            )
        }
        other => format!("{path}: this is the same file as {other}; choose another output"),
    }
}

fn listed(names: &[String]) -> String {
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

/// Lists the available attributes. If the reader skipped a part of the file, the text begins with
/// the description of that part.
fn available(left_out: Option<&str>, known: &[String]) -> String {
    let known = listed(known);
    match left_out {
        Some(part) => format!("the reader skipped {part}; available attributes: {known}"),
        None => format!("available attributes: {known}"),
    }
}

/// The kind of an error, which says what the caller has to change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Cause {
    /// The request is wrong, or does not suit the input or the existing outputs.
    Request,
    /// The input is bad.
    Input,
    /// The output cannot be written.
    Output,
    /// The requested device cannot be used.
    Device,
    /// The caller cancelled the work.
    Cancelled,
}

impl From<Cancelled> for Error {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<SelectionFault> for Error {
    fn from(fault: SelectionFault) -> Self {
        match fault {
            SelectionFault::Cancelled => Self::Cancelled,
            fault => Self::Selection(fault),
        }
    }
}

impl From<SizeFault> for Error {
    fn from(fault: SizeFault) -> Self {
        Self::Sizes { path: None, fault }
    }
}

impl Error {
    /// Returns the message, in which each setting has the name that `name` returns for it. For the
    /// command-line program, `name` returns the names of options. For a binding, it returns the
    /// names of keywords.
    #[must_use]
    pub fn message_with(&self, name: &dyn Fn(Setting) -> String) -> String {
        match self {
            Self::SettingConflict(conflict) => conflict.message_with(name),
            // The message begins with the setting's key. Replace this key with the caller's name.
            Self::Unit(unit) => match Setting::by_key(unit.name()) {
                Some(setting) => unit.to_string().replacen(unit.name(), &name(setting), 1),
                None => unit.to_string(),
            },
            _ => self.to_string(),
        }
    }

    /// Adds the path of the particle file, if the error has none.
    #[must_use]
    pub fn of_file(mut self, file: &Path) -> Self {
        if let Self::Frame { path, .. }
        | Self::NoSpacing { path, .. }
        | Self::Sizes { path, .. }
        | Self::NoAttribute { path, .. } = &mut self
        {
            path.get_or_insert_with(|| file.to_owned());
        }
        self
    }

    /// If the missing attribute is one of the `parts` of the file that the reader skipped, adds the
    /// description of that part to the error.
    #[must_use]
    pub(crate) fn with_skipped_part(mut self, parts: &[UnreadPart]) -> Self {
        if let Self::NoAttribute { name, left_out, .. } = &mut self {
            // A request for `velocity` also matches a skipped part with another name for the
            // velocity. Such names match only attributes with three components, so the part is
            // assumed to have three.
            let is_missing = |part: &&UnreadPart| {
                let info = part.attribute().map(|part| AttributeInfo::new(part, 3));
                attribute_called(name, info.as_slice()).is_some()
            };
            *left_out = parts.iter().find(is_missing).map(ToString::to_string);
        }
        self
    }

    /// Returns the kind of the error, which says what the caller has to change.
    #[must_use]
    pub fn cause(&self) -> Cause {
        match self {
            Self::Cancelled | Self::Frame { fault: FrameError::Cancelled, .. } => Cause::Cancelled,
            Self::Request(_)
            | Self::SettingConflict(_)
            | Self::SameFile { .. }
            | Self::Unit(_)
            | Self::Domain(_)
            | Self::Periodic(_)
            | Self::NoAttribute { .. }
            | Self::Sizes { .. }
            | Self::Threads(_)
            | Self::LittleMemory { .. } => Cause::Request,
            #[cfg(feature = "pictures")]
            Self::Picture { fault: PictureError::Io(_) | PictureError::Reference(_), .. } => {
                Cause::Input
            }
            #[cfg(feature = "pictures")]
            Self::Picture { .. } => Cause::Request,
            // The conditions can be right even if no particle of this frame satisfies them, because
            // particles of other frames may satisfy them. The cause is therefore the input.
            Self::Selection(SelectionFault::None { .. })
            | Self::Read(ReadError {
                fault: ReadFault::Selection(SelectionFault::None { .. }),
                ..
            }) => Cause::Input,
            Self::Selection(_)
            | Self::Read(ReadError {
                fault: ReadFault::UnknownExtension { .. } | ReadFault::Selection(_),
                ..
            }) => Cause::Request,
            Self::WholeMesh(WholeMeshError::Scratch(_)) => Cause::Output,
            Self::WholeMesh(_) => Cause::Request,
            Self::Read(ReadError { fault: ReadFault::Scratch(_), .. }) => Cause::Output,
            Self::Frame {
                fault:
                    FrameError::OverBudget(_)
                    | FrameError::NoSpacing
                    | FrameError::Kernels(_)
                    | FrameError::TooFine(_)
                    | FrameError::TooManyVertices
                    | FrameError::FewImages { .. }
                    | FrameError::NoSpace { .. }
                    | FrameError::WideAttributes { .. },
                ..
            } => Cause::Request,
            Self::Frame {
                fault: FrameError::NoRoom { .. } | FrameError::Scratch { .. }, ..
            } => Cause::Output,
            Self::Frame {
                fault:
                    FrameError::NoParticles(_)
                    | FrameError::Bin(_)
                    | FrameError::Unread(_)
                    | FrameError::Kind(_)
                    | FrameError::MeanCount(_)
                    | FrameError::NoSurface { .. }
                    | FrameError::NoKernelSurface
                    | FrameError::NoDistanceSurface { .. }
                    | FrameError::OtherIndicator
                    | FrameError::OtherCells { .. }
                    | FrameError::NothingLeft { .. },
                ..
            }
            | Self::NoSpacing { .. }
            | Self::Mesh { .. }
            | Self::Solid { .. }
            | Self::Read(_) => Cause::Input,
            Self::Simulation(
                SimulationError::NoFrames(_)
                | SimulationError::NoMatch(_)
                | SimulationError::NoFiles(_)
                | SimulationError::NoFolder(_)
                | SimulationError::Unreadable { .. },
            ) => Cause::Input,
            Self::Simulation(SimulationError::Io { .. }) => Cause::Output,
            Self::Simulation(_) => Cause::Request,
            Self::Parts(
                PartsError::Changed { .. }
                | PartsError::Missing { .. }
                | PartsError::Damaged { .. }
                | PartsError::OtherPlan(_),
            ) => Cause::Input,
            Self::Parts(PartsError::Io { .. }) => Cause::Output,
            Self::Parts(_) => Cause::Request,
            Self::Vulkan(_) | Self::Frame { fault: FrameError::Vulkan(_), .. } => Cause::Device,
            Self::Write(error) => match error.fault {
                WriteFault::Io(_) => Cause::Output,
                WriteFault::Exists
                | WriteFault::ExistsInSimulation
                | WriteFault::UnknownExtension { .. }
                | WriteFault::Unsupported(_) => Cause::Request,
            },
        }
    }
}
