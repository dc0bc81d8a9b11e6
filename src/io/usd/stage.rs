//! Writes two small text files: a stage that plays layers as value clips, and the manifest of the
//! clips.

use std::fmt::Write;
use std::path::{Component, Path, absolute};

use crate::io::UpAxis;
use crate::particles::AttributeInfo;

use super::{PRIM, properties};

/// The text of the stage. `clips` contains the time code and the path of each layer, in order. A
/// layer is shown from its time code to the time code of the next layer.
///
/// Paths of layers are relative to the stage. The stage begins and ends at whole time codes,
/// because programs show only whole time codes.
pub fn stage(
    clips: &[(f64, String)],
    manifest: &Manifest,
    codes_per_second: f64,
    up: UpAxis,
) -> String {
    let list = |items: Vec<String>| items.join(", ");
    let layers = list(clips.iter().map(|(_, layer)| asset(layer)).collect());
    let active = list(
        clips.iter().enumerate().map(|(index, (time, _))| format!("({time}, {index})")).collect(),
    );
    // At the time code of a layer, the stage shows time 0 of this layer. Each later layer's time
    // code occurs twice in `times`, which makes the time in the layers jump back to 0.
    let ends = clips.iter().skip(1).map(|(time, _)| Some(*time)).chain([None]);
    let times = clips.iter().zip(ends).flat_map(|((time, _), end)| {
        [Some(format!("({time}, 0)")), end.map(|end| format!("({end}, {})", end - time))]
    });
    let times = list(times.flatten().collect());
    // Adding 0 turns -0 into 0.
    let start = clips.first().map_or(0.0, |(time, _)| time.floor() + 0.0);
    let end = clips.last().map_or(0.0, |(time, _)| time.ceil() + 0.0);
    let (path, declared) = (asset(&manifest.path), manifest.declarations());
    format!(
        "#usda 1.0\n\
         (\n    defaultPrim = \"{PRIM}\"\n    upAxis = \"{up}\"\n    metersPerUnit = 1\n    \
         timeCodesPerSecond = {codes_per_second}\n    framesPerSecond = {codes_per_second}\n    \
         startTimeCode = {start}\n    endTimeCode = {end}\n)\n\n\
         def Mesh \"{PRIM}\" (\n    clips = {{\n        dictionary default = {{\n            \
         asset[] assetPaths = [{layers}]\n            \
         double2[] active = [{active}]\n            \
         double2[] times = [{times}]\n            \
         string primPath = \"/{PRIM}\"\n            \
         asset manifestAssetPath = {path}\n        }}\n    }}\n)\n\
         {{\n    uniform token subdivisionScheme = \"none\"\n{declared}}}\n"
    )
}

/// The manifest, which declares the attributes of the clips.
#[derive(Debug, Clone)]
pub struct Manifest {
    /// Path of the manifest, relative to the stage.
    pub path: String,
    /// Whether any clip has normals.
    pub normals: bool,
    /// Attributes that occur in any clip.
    pub attributes: Vec<AttributeInfo>,
}

impl Manifest {
    /// The text of the manifest.
    pub fn text(&self) -> String {
        let declared = self.declarations();
        format!(
            "#usda 1.0\n(\n    defaultPrim = \"{PRIM}\"\n)\n\nover \"{PRIM}\"\n{{\n{declared}}}\n"
        )
    }

    /// Declarations of the attributes. The stage also needs them, because a clip provides values
    /// only for declared attributes.
    fn declarations(&self) -> String {
        let mut text = String::new();
        for property in properties(self.normals, &self.attributes) {
            let interpolation = property.interpolation.map_or(String::new(), |how| {
                format!(" (\n        interpolation = \"{how}\"\n    )")
            });
            writeln!(text, "    {} {}{interpolation}", property.kind, property.name)
                .expect("writing to a `String` does not fail");
        }
        text
    }
}

/// The reason why programs could not find the layers next to a stage at this path. `None` if they
/// can find them.
///
/// When OpenUSD looks for layers, it treats each backslash in the path of the stage as a separator,
/// even on Linux. It also rejects control characters in the paths of layers. The names of layers
/// contain the name of the stage.
pub fn path_fault(stage: &Path) -> Option<&'static str> {
    let whole = absolute(stage).unwrap_or_else(|_| stage.to_owned());
    let has_backslash = whole.components().any(|part| match part {
        Component::Normal(name) => name.to_string_lossy().contains('\\'),
        _ => false,
    });
    let name = stage.file_name().unwrap_or_default().to_string_lossy();
    if has_backslash {
        Some(
            "a USD stage cannot have a backslash in its path; choose another name or folder for \
             the meshes",
        )
    } else if name.contains(char::is_control) {
        Some(
            "a USD stage cannot have a control character in its name; choose another name for the \
             meshes",
        )
    } else {
        None
    }
}

fn asset(path: &str) -> String {
    let path = if path.starts_with('/') { path.to_owned() } else { format!("./{path}") };
    if path.contains('@') {
        format!("@@@{}@@@", path.replace("@@@", "\\@@@"))
    } else {
        format!("@{path}@")
    }
}
