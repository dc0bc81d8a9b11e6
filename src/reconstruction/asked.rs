//! Settings as a caller said them: nothing is checked, and nothing filled in.

use serde_json::{Map, Value, json};

use crate::baselines::Method;
use crate::field::indicator::IndicatorKind;
use crate::grid::PeriodicMesh;
use crate::io::UpAxis;
use crate::io::wanted::{Wanted, WantedAttributes};

use super::Attributes;

/// Settings by their names, in the words of the program's options.
pub type Settings = Map<String, Value>;

/// Says what is different now from when a version was asked for some settings, for people; empty where nothing is.
pub(crate) fn differing(version: &str, kept: &Settings, wanted: &Settings) -> String {
    let mut names: Vec<&str> = Vec::new();
    if version != env!("CARGO_PKG_VERSION") {
        names.push("version");
    }
    let keys = kept.keys().chain(wanted.keys().filter(|key| !kept.contains_key(*key)));
    names.extend(keys.filter(|key| kept.get(*key) != wanted.get(*key)).map(String::as_str));
    names.join(", ")
}

/// All settings that show in the bytes of a mesh.
#[derive(Debug, Clone, Default)]
pub(crate) struct Asked {
    pub(crate) spacing: Option<f64>,
    pub(crate) cell_size: Option<f64>,
    pub(crate) cell: Option<f64>,
    pub(crate) origin: Option<[f64; 3]>,
    pub(crate) walls: Option<[[f64; 3]; 2]>,
    pub(crate) periodic: Option<[Option<[f64; 2]>; 3]>,
    pub(crate) periodic_mesh: Option<PeriodicMesh>,
    pub(crate) skip_invalid: bool,
    /// `None` for gas, a fluid, or the only type that there is.
    pub(crate) particle_type: Option<String>,
    pub(crate) indicator: Option<IndicatorKind>,
    pub(crate) mean: Option<f64>,
    pub(crate) baseline: Option<Method>,
    pub(crate) smooth: Option<f64>,
    pub(crate) sigma: Option<f64>,
    pub(crate) iso: Option<f64>,
    pub(crate) details: bool,
    pub(crate) normals: bool,
    /// `None` for the velocity, where the format can hold it.
    pub(crate) attributes: Option<Attributes>,
    pub(crate) tolerance: Option<f64>,
    pub(crate) smallest_component: Option<f64>,
    pub(crate) smallest_drop: Option<u32>,
    pub(crate) compress: bool,
    pub(crate) up: Option<UpAxis>,
    pub(crate) particles_up: Option<UpAxis>,
}

impl Asked {
    /// Particles and attributes that have to be read of an input.
    pub(crate) fn wanted(&self) -> Wanted<'_> {
        let attributes = match &self.attributes {
            None | Some(Attributes::Velocity) => WantedAttributes::Velocity,
            Some(Attributes::Named(names)) => WantedAttributes::Named(names),
        };
        Wanted { particle_type: self.particle_type.as_deref(), attributes, ..Wanted::default() }
    }

    /// The settings as a state file keeps them: whoever goes on with its frames asks for the same.
    pub(crate) fn settings(&self) -> Settings {
        let method = match self.baseline {
            None => "dif",
            Some(Method::Mueller { .. }) => "mueller",
            Some(Method::ZhuBridson) => "zhu-bridson",
            Some(Method::YuTurk { .. }) => "yu-turk",
        };
        // Held as the nearest step of the field.
        let iso = self.iso.and_then(|iso| crate::grid::units::Isovalue::new(iso).ok());
        let attributes = self.attributes.as_ref().and_then(|attributes| match attributes {
            Attributes::Velocity => None,
            Attributes::Named(names) if names.is_empty() => Some(vec!["none".to_owned()]),
            Attributes::Named(names) => Some(names.clone()),
        });
        let settings = json!({
            "spacing": self.spacing,
            "cell-size": self.cell_size,
            "cell": self.cell,
            "origin": self.origin,
            "domain": self.walls.map(|[[x0, y0, z0], [x1, y1, z1]]| [x0, y0, z0, x1, y1, z1]),
            "indicator": self.indicator.unwrap_or_default().name(),
            "mu0": self.mean,
            "skip-invalid": self.skip_invalid,
            "method": method,
            "smooth": self.smooth,
            "sigma": self.sigma,
            "iso": iso.map_or(json!("auto"), |iso| json!(iso.value())),
            "detail": self.details,
            "normals": self.normals,
            "attributes": attributes,
            "simplify": self.tolerance,
            // Named as the option was before: states that were written then go on.
            "drop-smaller": self.smallest_component,
            "smallest-drop": self.smallest_drop,
            "compress": self.compress,
            "up": self.up.map(|axis| axis.to_string()),
            "particles-up": self.particles_up.map(|axis| axis.to_string()),
        });
        let mut settings = match settings {
            Value::Object(map) => map,
            _ => Settings::new(),
        };
        if let Some(name) = &self.particle_type {
            settings.insert("particle-type".into(), name.as_str().into());
        }
        if let Some(faces) = self.periodic {
            let ends = |side: usize| faces.map(|faces| faces.map(|faces| faces[side]));
            settings.insert("periodic".into(), json!([ends(0), ends(1)].as_flattened()));
        }
        // Also said of packed frames, which have their own box.
        let ends = self.periodic_mesh.unwrap_or_default();
        if self.periodic.is_some() || ends != PeriodicMesh::default() {
            settings.insert("periodic-mesh".into(), ends.name().into());
        }
        settings
    }
}
