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
    /// A setting that it is about, and that is not given.
    Needs(Setting),
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
                format!("{setting} and {} exclude each other", name(*other))
            }
            (Conflict::Needs(other), _) => format!("{setting} needs {}", name(*other)),
            (Conflict::Packed(path), "format") => {
                format!(
                    "{}: {setting} is for particles, and this is a packed frame",
                    path.display()
                )
            }
            (Conflict::Indicator(kind), "mu0") => {
                format!("{setting} has no meaning for {} {}", named("indicator"), kind.name())
            }
            (Conflict::Indicator(IndicatorKind::Cloud), which) => format!(
                "{setting} is for {} counting and symmetry{}: the surface lies where distances told by clouds are 0, and {} says how \
                 calm it is",
                named("indicator"),
                if which == "iso" {
                    format!(", and for {} mueller and yu-turk", named("method"))
                } else {
                    String::new()
                },
                named("smooth"),
            ),
            (Conflict::Indicator(_), "solid" | "solid_offset") => {
                format!("{setting} is for {} cloud", named("indicator"))
            }
            (Conflict::Indicator(_), _) => format!(
                "{setting} is for {} cloud: {} says how smooth the surface of others is",
                named("indicator"),
                named("sigma")
            ),
            (Conflict::Method(_), _) => {
                format!("{setting} has no meaning for this {}", named("method"))
            }
            (Conflict::Packed(path), _) => {
                format!("{}: {setting} needs the particles themselves", path.display())
            }
            (Conflict::Packing, _) => {
                format!("{setting} is for surfaces: give it when the packed frame is reconstructed")
            }
            (Conflict::Sampled, _) => {
                format!(
                    "{setting} needs the particles themselves, and the frame is sampled already"
                )
            }
            (Conflict::OnDevice, _) => {
                format!("{setting} has no meaning for a surface that stays on a device")
            }
            (Conflict::Format { path, .. }, "compress") => {
                format!("{}: {setting} goes with .glb", path.display())
            }
            (Conflict::Format { .. }, "up") => format!(
                "{setting} z: in a .glb y points up; {} z says that the particles have z up",
                named("particles_up")
            ),
            (Conflict::Format { path, format }, _) => {
                format!("{}: {format} cannot hold {setting}", path.display())
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
