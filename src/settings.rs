//! Settings of a surface. The name, the type and the help of each setting are defined once.
//!
//! The command line is parsed into [`Settings`], and the bindings set its fields by name. State
//! files and plans store settings, and errors name them by [`Setting`]. Numbers are checked where
//! they are used.

mod faces;
mod plain;
mod value;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::baselines::KernelMethod;
use crate::field::indicator::IndicatorKind;
use crate::grid::PeriodicMesh;
use crate::grid::units::Isovalue;
use crate::io::input::InputFormat;
use crate::surface::mesh::up::UpAxis;

pub use crate::particles::condition::Where;
use crate::particles::sizes::SizeChoice;
pub use faces::{Faces, Tank};
use value::OptionalSetting;
pub use value::{FromSource, Iso, MethodName, Source};

/// The name of a setting, such as `smallest_drop`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Setting(&'static str);

impl Setting {
    /// Makes a setting from the name of a field of [`Settings`]. The prefix `r#` of a raw
    /// identifier, such as `r#where`, is removed.
    const fn of_field(field: &'static str) -> Self {
        match field.as_bytes().split_first_chunk::<2>() {
            Some((b"r#", name)) => Self(match str::from_utf8(name) {
                Ok(name) => name,
                Err(_) => field,
            }),
            _ => Self(field),
        }
    }

    /// Makes a setting from its name, which must be in snake case.
    #[must_use]
    pub const fn named(name: &'static str) -> Self {
        Self(name)
    }

    /// Finds the setting of [`Settings`] that has this key.
    #[must_use]
    pub fn by_key(key: &str) -> Option<Self> {
        Settings::ALL.iter().copied().find(|setting| setting.key() == key)
    }

    /// The name in snake case, as in the fields of [`Settings`].
    #[must_use]
    pub fn name(self) -> &'static str {
        self.0
    }

    /// The name in kebab case, as in options and files.
    #[must_use]
    pub fn key(self) -> String {
        self.0.replace('_', "-")
    }

    /// The short help: the first paragraph of the setting's documentation, on one line.
    #[must_use]
    pub fn help(self) -> String {
        let index = Settings::ALL.iter().position(|known| *known == self);
        let lines = index.map_or(&[][..], |index| Settings::DOCS[index]);
        let first = lines.iter().map(|line| line.trim()).take_while(|line| !line.is_empty());
        first.collect::<Vec<_>>().join(" ")
    }
}

impl std::fmt::Display for Setting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.key())
    }
}

macro_rules! settings {
    ($( $(#[doc = $doc:literal])* #[arg($($arg:tt)*)] $name:ident: $type:ty, )*) => {
        /// Settings of a surface. A setting without a value is measured, or has its default.
        #[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
        #[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
        #[cfg_attr(feature = "cli", derive(clap::Args))]
        pub struct Settings {
            $(
                $(#[doc = $doc])*
                #[serde(skip_serializing_if = "OptionalSetting::is_unset")]
                #[cfg_attr(feature = "cli", arg(long, $($arg)*))]
                pub $name: $type,
            )*
        }

        impl Settings {
            /// All settings, in the order of the program's help.
            pub const ALL: &[Setting] = &[$(Setting::of_field(stringify!($name))),*];

            /// The lines of documentation of each setting, in the same order.
            const DOCS: &[&[&str]] = &[$(&[$($doc),*]),*];

            /// Sets the setting with this name in snake case from a caller's value, and returns
            /// `false` if no setting has the name.
            ///
            /// # Errors
            /// The errors of the source, if the value has the wrong type.
            pub fn set<S: Source>(&mut self, name: &str, source: &S) -> Result<bool, S::Error> {
                $(if name == const { Setting::of_field(stringify!($name)) }.0 {
                    self.$name = FromSource::taken(source)?;
                    return Ok(true);
                })*
                Ok(false)
            }

            /// Resets the setting with this name in snake case to its default, and returns `false`
            /// if no setting has the name.
            pub fn clear(&mut self, name: &str) -> bool {
                $(if name == const { Setting::of_field(stringify!($name)) }.0 {
                    self.$name = Default::default();
                    return true;
                })*
                false
            }

            /// The first setting that has a value, differs from the same setting of `other`, and
            /// satisfies `filter`.
            pub(crate) fn first_difference(
                &self,
                other: &Self,
                mut filter: impl FnMut(Setting) -> bool,
            ) -> Option<Setting> {
                $(
                    let setting = const { Setting::of_field(stringify!($name)) };
                    if !self.$name.is_unset() && self.$name != other.$name && filter(setting) {
                        return Some(setting);
                    }
                )*
                None
            }
        }
    };
}

settings! {
    /// Distance between neighbouring particles.
    ///
    /// By default, the spacing comes from the particle file, or from the simulator's scene file in
    /// the same folder or its parent. If neither file has it, meniscus estimates it from the
    /// particles.
    #[arg(
        value_name = "LENGTH", conflicts_with = "radius", allow_negative_numbers = true,
        help_heading = "Input"
    )]
    spacing: Option<f64>,

    /// Half of the spacing.
    #[arg(
        value_name = "LENGTH", allow_negative_numbers = true, help_heading = "Input",
        hide_short_help = true
    )]
    radius: Option<f64>,

    /// Attribute with the size of each particle, for particles of different sizes [default: pscale,
    /// radius or spacing].
    ///
    /// Each region of the fluid is meshed at its own particle spacing. The attribute's name
    /// determines how its values are read: as radii (half of a particle's spacing), diameters,
    /// volumes, masses or smoothing lengths. Masses also need a density attribute. meniscus
    /// compares the volume that the values imply with the volume that the particles fill. If the
    /// two differ by more than a factor of 1.4, as is usual for the smoothing lengths of SPH,
    /// meniscus multiplies all sizes by one common factor, so that the volumes match. In a GADGET
    /// or SWIFT file, sizes come from the masses and densities by default if the masses differ. If
    /// such a file has no densities, sizes come from the smoothing lengths. `none` gives all
    /// particles the same size. Works only with the indicator `cloud` (the default).
    #[arg(
        value_name = "NAME", conflicts_with_all = ["spacing", "radius"], help_heading = "Input",
        hide_short_help = true
    )]
    size: Option<String>,

    /// Edge length of a cell.
    #[arg(
        value_name = "LENGTH", conflicts_with = "cell", allow_negative_numbers = true,
        help_heading = "Surface", hide_short_help = true
    )]
    cell_size: Option<f64>,

    /// Cell size in spacings; a smaller size gives a finer mesh [default: 0.5].
    ///
    /// For the counting and symmetry indicators, the default is 0.6667.
    #[arg(value_name = "RATIO", allow_negative_numbers = true, help_heading = "Surface")]
    cell: Option<f64>,

    /// Origin of the grid: a point that is a corner of a cell [default: 0,0,0].
    ///
    /// If you give walls, the default moves to the nearest point for which the lower wall of each
    /// axis lies exactly between two cells.
    #[arg(
        value_name = "X,Y,Z", value_parser = faces::point, allow_hyphen_values = true,
        help_heading = "Surface", hide_short_help = true
    )]
    origin: Option<[f64; 3]>,

    /// Format of the input [default: determined by the extension].
    #[arg(value_enum, value_name = "NAME", help_heading = "Input", hide_short_help = true)]
    format: Option<InputFormat>,

    /// Use only particles whose attributes satisfy a condition, such as Type=1.
    ///
    /// A condition is an attribute, a comparison (=, !=, <, <=, > or >=) and a value: Type=1,
    /// age<2.5, phase!=boundary. mk=0,2 accepts either value. `and` joins conditions that must all
    /// hold. `velocity.y` and `velocity[1]` are the same component of a vector; x, y and z are the
    /// position. Some files store each type of particle separately: SWIFT and GADGET snapshots in
    /// groups such as PartType1, PySPH files in arrays, and openPMD files in species. type=NAME
    /// selects one of them. If there are several types, the default is PartType0 or fluid. A type
    /// called gas is the default only if no other type can be a liquid.
    #[arg(value_name = "CONDITION", help_heading = "Input")]
    r#where: Option<Vec<Where>>,

    /// Walls of a tank, or auto to find them [default: unbounded].
    ///
    /// The surface ends exactly on the walls, and particles outside are left out. `-` leaves a side
    /// open. auto takes the walls from the simulator's scene file, or looks for planes at which the
    /// particles end; it leaves no particles out.
    #[arg(
        value_name = "X0,Y0,Z0,X1,Y1,Z1|auto", allow_hyphen_values = true, help_heading = "Input"
    )]
    domain: Option<Tank>,

    /// Periodic box, whose opposite faces are joined.
    ///
    /// `-` for both ends of an axis makes it non-periodic: 0,-,0,1,-,1 is periodic along x and z.
    /// A particle exactly on an upper face counts as being on the lower face. A particle that is at
    /// most one spacing outside the box is wrapped into it, and a message gives the number of such
    /// particles. A particle farther outside is an error, unless you skip invalid particles.
    #[arg(value_name = "X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true, help_heading = "Input")]
    periodic: Option<Faces>,

    /// Closed mesh of a solid object at which the fluid ends, such as an obstacle.
    ///
    /// The mesh must have the units and axes of the particles. It can be a .ply, .obj, .stl, .vtk,
    /// .vtp, .pvtp, .vtkhdf, .bgeo.sc, .bgeo or .geo. Repeat the option for several solids. {} in
    /// the name stands for the frame number: solid.{}.obj gives each frame its own mesh. Works only
    /// with the indicator `cloud` (the default).
    #[arg(value_name = "MESH", help_heading = "Input")]
    solid: Option<Vec<String>>,

    /// Distance between the fluid and solids, in spacings [default: -0.1].
    ///
    /// A positive value leaves a gap. A negative value lets the fluid reach into the solids, which
    /// hides gaps in pictures.
    #[arg(
        value_name = "SPACINGS", allow_negative_numbers = true, help_heading = "Input",
        hide_short_help = true
    )]
    solid_offset: Option<f64>,

    /// Rule for computing the value of a cell from the particles in and near it [default: cloud].
    #[arg(value_enum, help_heading = "Surface", hide_short_help = true)]
    indicator: Option<IndicatorKind>,

    /// Mean number of particles in non-empty cells, for the counting indicator [default: measured].
    #[arg(
        value_name = "VALUE", allow_negative_numbers = true, help_heading = "Surface",
        hide_short_help = true
    )]
    mu0: Option<f64>,

    /// Skip particles with an invalid position, and report their number; by default, such particles
    /// are an error.
    ///
    /// A position is invalid if it is not finite, if it is more than one spacing outside the
    /// periodic box, or if it is more than 4.19 million cells from the grid's origin along an axis.
    #[arg(help_heading = "Input", hide_short_help = true)]
    skip_invalid: bool,

    /// Smoothing width in spacings, from 0.8 to 4 [default: 1.6].
    ///
    /// Larger is smoother: use 2 for noisy FLIP particles, and less than 1.6 to keep every ripple.
    /// Works only with the indicator `cloud` (the default).
    #[arg(value_name = "SPACINGS", allow_negative_numbers = true, help_heading = "Surface")]
    smooth: Option<f64>,

    /// In thin sheets and filaments, join particles that are at most this many spacings apart
    /// [default: 2.15].
    ///
    /// The value must be from 1 to 3, or 0, which turns this off. In practice, sheets tear at a
    /// slightly smaller distance: at about 2.1 spacings with the default. Works only with the
    /// indicator `cloud` (the default).
    #[arg(value_name = "SPACINGS", allow_negative_numbers = true, help_heading = "Surface")]
    sheets: Option<f64>,

    /// Method for computing the surface: dif, which uses the indicator, or one of three kernel
    /// methods, for comparison [default: dif].
    #[arg(value_enum, help_heading = "Surface", hide_short_help = true)]
    method: Option<MethodName>,

    /// Standard deviation of the smoothing Gaussian, for the counting and symmetry indicators
    /// [default: one spacing, but at least one cell].
    #[arg(
        value_name = "CELLS", allow_negative_numbers = true, help_heading = "Surface",
        hide_short_help = true
    )]
    sigma: Option<f64>,

    /// Isovalue between 0 and 1, for the counting and symmetry indicators and the mueller and
    /// yu-turk methods [default: auto].
    ///
    /// A higher isovalue moves the surface inwards. auto is 0.47 times the value of the field deep
    /// inside the fluid. If the fluid is too shallow to measure that value, meniscus computes it
    /// from the spacing. For mueller and yu-turk, auto is 0.5.
    #[arg(
        value_name = "VALUE|auto", allow_hyphen_values = true, help_heading = "Surface",
        hide_short_help = true
    )]
    iso: Option<Iso>,

    /// Recover details that smoothing removes, such as drops (for the counting and symmetry
    /// indicators).
    #[arg(help_heading = "Surface", hide_short_help = true)]
    detail: bool,

    /// How the mesh ends at the faces of a periodic box [default: cut].
    #[arg(value_enum, value_name = "ENDS", help_heading = "Surface", hide_short_help = true)]
    periodic_mesh: Option<PeriodicMesh>,

    /// Add vertex normals.
    #[arg(help_heading = "Output")]
    normals: bool,

    /// Attributes to transfer to the mesh [default: velocity].
    ///
    /// The values are interpolated from particles to vertices. `none` transfers no attributes. By
    /// default, the mesh has velocities if the particles have them and the format can store them.
    /// A list replaces this default: include `velocity` to keep it.
    #[arg(
        value_name = "NAME,...", value_delimiter = ',', value_parser = value::trimmed,
        help_heading = "Output"
    )]
    attributes: Option<Vec<String>>,

    /// Merge triangles; the surface moves by at most this many cells.
    #[arg(value_name = "CELLS", allow_negative_numbers = true, help_heading = "Output")]
    simplify: Option<f64>,

    /// Remove drops and bubbles with a volume of less than this many cells.
    #[arg(
        alias = "drop-smaller", value_name = "CELLS", allow_negative_numbers = true,
        help_heading = "Output", hide_short_help = true
    )]
    smallest_component: Option<f64>,

    /// Remove drops with fewer than this many particles; the number of particles is estimated from
    /// the drop's volume [default: 1, which keeps all drops].
    #[arg(
        value_name = "PARTICLES", value_parser = clap::value_parser!(u32).range(1..),
        help_heading = "Output", hide_short_help = true
    )]
    smallest_drop: Option<u32>,

    /// Compress the output: a .glb with quantization and EXT_meshopt_compression, a .vdb with zlib.
    #[arg(help_heading = "Output", hide_short_help = true)]
    compress: bool,

    /// Rotate the mesh so that this axis points up [default: the up axis of the particles].
    ///
    /// In .glb and .abc, y always points up.
    #[arg(value_enum, help_heading = "Output", hide_short_help = true)]
    up: Option<UpAxis>,

    /// Up axis of the particles [default: z for .bi4, else y].
    ///
    /// The mesh is rotated only if the up axis of the output is another axis.
    #[arg(value_enum, help_heading = "Input", hide_short_help = true)]
    particles_up: Option<UpAxis>,
}

/// Settings by their keys, as state files and plans store them.
pub type StoredSettings = Map<String, Value>;

/// Names of the settings that differ from the settings of an earlier run, joined by commas; empty
/// if none differs. If the earlier run had another `version`, the result names only the version,
/// because another version may give a different mesh.
pub(crate) fn differing(version: &str, kept: &StoredSettings, wanted: &StoredSettings) -> String {
    if version != env!("CARGO_PKG_VERSION") {
        return "the version of meniscus".into();
    }
    let keys = kept.keys().chain(wanted.keys().filter(|key| !kept.contains_key(*key)));
    keys.filter(|key| kept.get(*key) != wanted.get(*key))
        .map(String::as_str)
        .collect::<Vec<_>>()
        .join(", ")
}

/// Settings that need the particles. They cannot be changed for a frame that is already sampled.
const SAMPLING_SETTINGS: [&str; 14] = [
    "format",
    "spacing",
    "radius",
    "size",
    "cell_size",
    "cell",
    "origin",
    "domain",
    "periodic",
    "indicator",
    "mu0",
    "skip_invalid",
    "where",
    "method",
];

impl Setting {
    /// Whether the setting affects how particles are sampled, not only the surface.
    #[must_use]
    pub fn needs_particles(self) -> bool {
        SAMPLING_SETTINGS.contains(&self.0)
    }

    /// Whether the setting affects packed frames. All settings that affect the sampling also affect
    /// packed frames, except `method` and `size`, which `check_packing` rejects.
    #[must_use]
    pub fn is_of_samples(self) -> bool {
        self.needs_particles() && !["method", "size"].contains(&self.0)
    }
}

impl Settings {
    /// The spacing, or twice the radius.
    #[must_use]
    pub fn spacing_or_radius(&self) -> Option<f64> {
        self.spacing.or(self.radius.map(|radius| 2.0 * radius))
    }

    /// The attribute with the sizes of the particles.
    #[must_use]
    pub fn size_choice(&self) -> SizeChoice {
        match self.size.as_deref() {
            None => SizeChoice::Usual,
            Some("none") => SizeChoice::Ignored,
            Some(name) => SizeChoice::Named(name.to_owned()),
        }
    }

    /// Whether the settings name an attribute for the sizes of the particles.
    #[must_use]
    pub fn asks_for_sizes(&self) -> bool {
        matches!(self.size_choice(), SizeChoice::Named(_))
    }

    /// The settings in a normalized form: a spacing instead of a radius, all conditions joined into
    /// one, `none` instead of an empty list of attributes, and no value for an automatic isovalue
    /// or for the method `dif`, which are the defaults.
    pub(crate) fn normalized(&self) -> Self {
        let iso = self.isovalue().map(Iso::Value);
        let none = || vec!["none".to_owned()];
        Self {
            spacing: self.spacing_or_radius(),
            radius: None,
            r#where: Where::joined(self.conditions()).map(|all| vec![all]),
            iso,
            method: self.method.filter(|method| *method != MethodName::Dif),
            attributes: self
                .attributes
                .clone()
                .map(|names| if names.is_empty() { none() } else { names }),
            ..self.clone()
        }
    }

    /// Conditions that particles must satisfy.
    #[must_use]
    pub fn conditions(&self) -> &[Where] {
        self.r#where.as_deref().unwrap_or_default()
    }

    /// The isovalue; `None` if it is measured.
    #[must_use]
    pub fn isovalue(&self) -> Option<f64> {
        match self.iso {
            Some(Iso::Value(value)) => Some(value),
            Some(Iso::Auto) | None => None,
        }
    }

    /// The kernel method, if `method` names one.
    #[must_use]
    pub fn kernels(&self) -> Option<KernelMethod> {
        match self.method {
            None | Some(MethodName::Dif) => None,
            Some(MethodName::Mueller) => Some(KernelMethod::Mueller { iso: KernelMethod::HALF }),
            Some(MethodName::ZhuBridson) => Some(KernelMethod::ZhuBridson),
            Some(MethodName::YuTurk) => Some(KernelMethod::YuTurk { iso: KernelMethod::HALF }),
        }
    }

    /// Names of the attributes on the vertices; `None` means the velocity if the format can store
    /// it.
    #[must_use]
    pub fn attribute_names(&self) -> Option<&[String]> {
        let names = self.attributes.as_deref()?;
        Some(if names == ["none"] { &[] } else { names })
    }

    /// The settings as state files and plans store them. Some settings that make the same mesh,
    /// such as a radius and the equivalent spacing, are stored in the same form.
    #[must_use]
    pub fn kept(&self) -> StoredSettings {
        // The isovalue is rounded to the nearest step of a 16-bit field.
        let iso = self.isovalue().and_then(|iso| Isovalue::new(iso).ok());
        let kept = Self {
            iso: iso.map(|iso| Iso::Value(iso.value())),
            indicator: self.indicator.filter(|kind| *kind != IndicatorKind::default()),
            periodic_mesh: self.periodic_mesh.filter(|ends| *ends != PeriodicMesh::default()),
            ..self.normalized()
        };
        match serde_json::to_value(kept) {
            Ok(Value::Object(map)) => map,
            _ => StoredSettings::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Walls;

    /// Settings with a value in every field.
    fn all() -> Settings {
        Settings {
            spacing: Some(0.5),
            radius: Some(0.25),
            size: Some("pscale".into()),
            cell_size: Some(0.1),
            cell: Some(0.5),
            origin: Some([1.0, 2.0, 3.0]),
            format: Some(InputFormat::Csv),
            r#where: Some(vec!["Type=1".parse().unwrap()]),
            domain: Some(Tank::Walls(Walls([
                [Some(0.0), Some(1.0)],
                [None; 2],
                [None, Some(2.0)],
            ]))),
            periodic: Some(Faces([None, Some([0.0, 4.0]), None])),
            solid: Some(vec!["ball.obj".into()]),
            solid_offset: Some(0.2),
            indicator: Some(IndicatorKind::Counting),
            mu0: Some(3.0),
            skip_invalid: true,
            smooth: Some(2.0),
            sheets: Some(1.8),
            method: Some(MethodName::YuTurk),
            sigma: Some(1.0),
            iso: Some(Iso::Value(0.4)),
            detail: true,
            periodic_mesh: Some(PeriodicMesh::Overlap),
            normals: true,
            attributes: Some(vec!["heat".into()]),
            simplify: Some(0.3),
            smallest_component: Some(9.0),
            smallest_drop: Some(2),
            compress: true,
            up: Some(UpAxis::Z),
            particles_up: Some(UpAxis::Y),
        }
    }

    #[test]
    fn settings_round_trip_through_json_under_their_keys() {
        let Ok(Value::Object(map)) = serde_json::to_value(all()) else { panic!("no map") };
        let keys: Vec<String> = Settings::ALL.iter().map(|setting| setting.key()).collect();
        assert!(map.keys().all(|key| keys.contains(key)) && map.len() == keys.len(), "{map:?}");
        let settings: Settings = serde_json::from_value(Value::Object(map)).unwrap();
        assert_eq!(settings, all());
        assert!(serde_json::from_str::<Settings>(r#"{"spacng": 1}"#).is_err());
        assert_eq!(serde_json::from_str::<Settings>("{}").unwrap(), Settings::default());
    }

    #[test]
    fn equivalent_settings_are_stored_in_the_same_form() {
        let defaults = Settings::default().kept();
        let explicit = Settings {
            iso: Some(Iso::Auto),
            indicator: Some(IndicatorKind::Cloud),
            method: Some(MethodName::Dif),
            periodic_mesh: Some(PeriodicMesh::Cut),
            ..Settings::default()
        };
        assert_eq!(explicit.kept(), defaults);
        let [by_radius, by_spacing] = [(None, Some(0.25)), (Some(0.5), None)]
            .map(|(spacing, radius)| Settings { spacing, radius, ..Settings::default() }.kept());
        assert_eq!(by_radius, by_spacing);
        let with_attributes = |names: &[&str]| Settings {
            attributes: Some(names.iter().map(|name| (*name).to_owned()).collect()),
            ..Settings::default()
        };
        assert_eq!(with_attributes(&[]).kept(), with_attributes(&["none"]).kept());
        let version = env!("CARGO_PKG_VERSION");
        assert_eq!(differing(version, &by_radius, &defaults), "spacing");
        assert_eq!(differing("0.1", &by_radius, &defaults), "the version of meniscus");
    }

    #[test]
    fn every_setting_has_one_line_of_help_and_can_be_cleared() {
        let mut settings = all();
        for setting in Settings::ALL {
            let help = setting.help();
            assert!(
                help.len() > 10 && !help.contains('\n') && !help.contains("  "),
                "{setting}: {help}"
            );
            assert!(settings.clear(setting.name()), "{setting}");
        }
        assert_eq!(settings, Settings::default());
        assert_eq!(Setting("radius").help(), "Half of the spacing.");
        assert!(!settings.clear("spacng") && Setting("spacng").help().is_empty());
    }

    #[test]
    fn lists_of_setting_names_contain_only_settings() {
        for name in SAMPLING_SETTINGS {
            assert!(Settings::ALL.contains(&Setting::named(name)), "{name}");
        }
    }

    #[test]
    fn the_first_given_setting_that_differs_is_found() {
        let (all, defaults) = (all(), Settings::default());
        assert_eq!(all.first_difference(&defaults, |_| true), Some(Setting("spacing")));
        let affects_only_surface = |setting: Setting| !setting.needs_particles();
        let differing = all.first_difference(&defaults, affects_only_surface);
        assert_eq!(differing, Some(Setting("solid")));
        assert_eq!(all.first_difference(&all, |_| true), None);
        assert_eq!(defaults.first_difference(&all, |_| true), None);
    }
}
