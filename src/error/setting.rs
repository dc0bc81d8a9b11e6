//! Settings that exclude each other, or what they are asked of.

use std::fmt;
use std::path::PathBuf;

use crate::baselines::KernelMethod;
use crate::field::indicator::IndicatorKind;
use crate::io::output::MeshFormat;
use crate::settings::Setting;

/// A setting, file or format that a setting conflicts with.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Conflict {
    /// A setting that says the same.
    Setting(Setting),
    /// The indicator that makes the field.
    Indicator(IndicatorKind),
    /// The kernel method that makes the field.
    Method(KernelMethod),
    /// A packed frame, of which the particles themselves are not there any more.
    Packed(PathBuf),
    /// A frame that is to be packed: it holds samples, and no surface.
    Packing,
    /// A frame that was sampled already, otherwise than is asked for now.
    Sampled,
    /// Particles and a surface that stay on a device.
    OnDevice,
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

impl Unfit {
    /// The sentence, with the setting called as `name` says.
    pub fn told(&self, name: &dyn Fn(Setting) -> String) -> String {
        let setting = name(self.setting);
        let named = |name_of: &'static str| name(Setting::named(name_of));
        match (&self.with, self.setting.name()) {
            (Conflict::Setting(other), _) => {
                format!("{setting} cannot be used with {}", name(*other))
            }
            (Conflict::Packed(path), "format") => {
                format!(
                    "{}: {setting} applies to particle files, but this is a packed frame",
                    path.display()
                )
            }
            (Conflict::Indicator(kind), "mu0") => {
                format!("{setting} does not apply to {} {}", named("indicator"), kind.name())
            }
            (Conflict::Indicator(IndicatorKind::Cloud), which) => format!(
                "{setting} applies only to {} counting and symmetry{}; for cloud, use {}",
                named("indicator"),
                if which == "iso" {
                    format!(" and to {} mueller and yu-turk", named("method"))
                } else {
                    String::new()
                },
                named("smooth"),
            ),
            (Conflict::Indicator(_), _) => format!(
                "{setting} applies only to {} cloud; for others, use {}",
                named("indicator"),
                named("sigma")
            ),
            (Conflict::Method(_), _) => {
                format!("{setting} does not apply to this {}", named("method"))
            }
            (Conflict::Packed(path), _) => {
                format!("{}: {setting} needs the particles, which a packed frame does not \
                         contain", path.display())
            }
            (Conflict::Packing, _) => {
                format!("{setting} is for surfaces: use it when you reconstruct the packed \
                         frame")
            }
            (Conflict::Sampled, _) => {
                format!(
                    "{setting} cannot change in a frame that is already sampled; sample the \
                     particles again"
                )
            }
            (Conflict::OnDevice, _) => {
                format!("{setting} does not apply to a surface on a device")
            }
            (Conflict::Format { path, .. }, "compress") => {
                format!("{}: {setting} applies only to .glb", path.display())
            }
            (Conflict::Format { .. }, "up") => format!(
                "{setting} z: a .glb always has y up; use {} z if z points up in the particles",
                named("particles_up")
            ),
            (Conflict::Format { path, format }, _) => {
                format!("{}: {format} cannot store {setting}", path.display())
            }
        }
    }
}

impl fmt::Display for Unfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.told(&Setting::key))
    }
}

impl std::error::Error for Unfit {}
