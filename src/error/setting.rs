//! Settings that conflict with each other or with the request.

use std::fmt;
use std::path::PathBuf;

use crate::baselines::KernelMethod;
use crate::field::indicator::IndicatorKind;
use crate::io::output::MeshFormat;
use crate::settings::Setting;

/// The reason for a conflict: for example another setting, a file or a format.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Conflict {
    /// The other setting is for the same length or the same sizes. Only one of the two can be given.
    Setting(Setting),
    /// A required setting that is missing.
    Needs(Setting),
    /// The indicator.
    Indicator(IndicatorKind),
    /// The kernel method.
    Method(KernelMethod),
    /// A packed frame, which has no particles.
    Packed(PathBuf),
    /// Packing a frame, which stores samples and no surface.
    Packing,
    /// Particles of several sizes.
    SeveralSizes {
        /// The attribute with the sizes.
        attribute: String,
    },
    /// A frame that was already sampled with another value of the setting.
    Sampled,
    /// A surface that is made on a device, from particles in the memory of this device.
    OnDevice,
    /// The format of the mesh.
    Format {
        /// The mesh's file.
        path: PathBuf,
        /// The format.
        format: MeshFormat,
    },
}

/// A setting that was given but does not apply.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SettingConflict {
    /// The setting.
    pub setting: Setting,
    /// The reason for the conflict.
    pub with: Conflict,
}

impl SettingConflict {
    /// Returns the message, in which each setting has the name that `name` returns for it.
    pub fn message_with(&self, name: &dyn Fn(Setting) -> String) -> String {
        let setting = name(self.setting);
        let name_of = |key: &'static str| name(Setting::named(key));
        match (&self.with, self.setting.name()) {
            (Conflict::Setting(other), _) => {
                format!("{setting} cannot be used with {}", name(*other))
            }
            (Conflict::Needs(other), _) => {
                format!("{setting} has no effect without {}", name(*other))
            }
            (Conflict::Packed(path), "format") => {
                format!(
                    "{}: {setting} is for particle files, but this is a packed frame; omit \
                     {setting}",
                    path.display()
                )
            }
            (Conflict::Indicator(kind), "mu0") => format!(
                "{setting} needs the indicator counting, but {} is {}",
                name_of("indicator"),
                kind.name()
            ),
            (Conflict::Indicator(IndicatorKind::Cloud), key) => {
                let indicator = name_of("indicator");
                let alternative = match key {
                    "iso" => {
                        format!("; alternatively, set {} to mueller or yu-turk", name_of("method"))
                    }
                    "sigma" => format!("; use {} instead", name_of("smooth")),
                    _ => String::new(),
                };
                format!(
                    "{setting} needs the indicator counting or symmetry, but {indicator} is cloud \
                     (the default){alternative}"
                )
            }
            (Conflict::Indicator(kind), "smooth") => format!(
                "{setting} needs the indicator cloud (the default), but {} is {}; use {} instead",
                name_of("indicator"),
                kind.name(),
                name_of("sigma")
            ),
            (Conflict::Indicator(kind), _) => format!(
                "{setting} needs the indicator cloud (the default), but {} is {}",
                name_of("indicator"),
                kind.name()
            ),
            (Conflict::Method(method), _) => {
                format!("{setting} cannot be used if {} is {}", name_of("method"), method.name())
            }
            (Conflict::Packed(path), _) => {
                format!(
                    "{}: {setting} needs the particles, but a packed frame has none; use the \
                     particle file",
                    path.display()
                )
            }
            (Conflict::Packing, "method" | "size" | "attributes") => {
                format!("{setting} is not supported when packing")
            }
            (Conflict::Packing, _) => {
                format!(
                    "{setting} does not apply to packing; set it when you reconstruct the packed \
                     frame"
                )
            }
            (Conflict::SeveralSizes { attribute }, _) => format!(
                "{setting} needs particles of one size, but the attribute {attribute:?} gives them \
                 different sizes; set {} to none to ignore the attribute",
                name_of("size")
            ),
            (Conflict::Sampled, _) => {
                format!(
                    "{setting} cannot be changed once the particles have been sampled; sample or \
                     pack them again"
                )
            }
            (Conflict::OnDevice, _) => {
                format!("{setting} is not supported for a surface on a device; omit {setting}")
            }
            (Conflict::Format { path, .. }, "compress") => {
                format!("{}: {setting} works only with .glb and .vdb files", path.display())
            }
            (Conflict::Format { path, format }, "up") => format!(
                "{}: {setting} cannot be z, because y always points up in {format}; if z points up \
                 in the particles, set {} to z",
                path.display(),
                name_of("particles_up")
            ),
            (Conflict::Format { path, format }, "attributes") if format.holds_colours() => format!(
                "{}: {format} cannot store {setting} other than one colour (3 or 4 numbers from 0 \
                 to 1, or integers from 0 to 255, with a name such as Cd); use .ply for other \
                 attributes",
                path.display()
            ),
            (Conflict::Format { path, format }, _) => {
                format!("{}: {format} cannot store {setting}; use .ply instead", path.display())
            }
        }
    }
}

impl fmt::Display for SettingConflict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message_with(&|setting| format!("`{setting}`")))
    }
}

impl std::error::Error for SettingConflict {}
