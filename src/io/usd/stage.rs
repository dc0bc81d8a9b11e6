//! A stage that plays layers as value clips, and the manifest of the clips: two small text files.

use std::fmt::Write;

use crate::io::UpAxis;
use crate::particles::AttributeInfo;

use super::{PRIM, properties};

/// The stage's text. `clips` are layers with their time codes, in order; a layer is shown from its
/// time to the next one's.
///
/// Paths are relative to the stage.
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
    // Each layer's time 0 is at its own time of the stage; a time that occurs twice is a jump.
    let ends = clips.iter().skip(1).map(|(time, _)| Some(*time)).chain([None]);
    let times = clips.iter().zip(ends).flat_map(|((time, _), end)| {
        [Some(format!("({time}, 0)")), end.map(|end| format!("({end}, {})", end - time))]
    });
    let times = list(times.flatten().collect());
    let start = clips.first().map_or(0.0, |(time, _)| *time);
    let end = clips.last().map_or(0.0, |(time, _)| *time);
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

/// The manifest, which declares the contents of the clips.
#[derive(Debug, Clone)]
pub struct Manifest {
    /// Path relative to the stage.
    pub path: String,
    /// Whether any clip has normals.
    pub normals: bool,
    /// Attributes of all clips.
    pub attributes: Vec<AttributeInfo>,
}

impl Manifest {
    /// The file's text.
    pub fn text(&self) -> String {
        let declared = self.declarations();
        format!(
            "#usda 1.0\n(\n    defaultPrim = \"{PRIM}\"\n)\n\nover \"{PRIM}\"\n{{\n{declared}}}\n"
        )
    }

    /// The stage's prim needs them too: a clip provides values only for declared attributes.
    fn declarations(&self) -> String {
        let mut text = String::new();
        for property in properties(self.normals, &self.attributes) {
            let mut details = Vec::new();
            details.extend(property.interpolation.map(|how| format!("interpolation = \"{how}\"")));
            details.extend(property.element_size.map(|size| format!("elementSize = {size}")));
            let details: String =
                details.iter().map(|detail| format!("        {detail}\n")).collect();
            let details = if details.is_empty() { details } else { format!(" (\n{details}    )") };
            writeln!(text, "    {} {}{details}", property.kind, property.name)
                .expect("memory takes all");
        }
        text
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
