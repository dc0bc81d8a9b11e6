//! The spacing of the particles, from the scene file that a simulator leaves beside its frames.
//!
//! SPlisHSPlasH's scene is JSON and gives the radius, half of the spacing; DualSPHysics' case is
//! XML and gives the spacing `dp`.

use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use serde::Deserialize;

use crate::grid::units::positive_length;

/// No scene is larger, in bytes; a result that happens to be JSON may be.
const LARGEST: u64 = 16 << 20;

/// The spacing of the particles of `path`, and the file that says so.
///
/// Every .json and .xml in the file's folder is tried in the order of their names, then those of
/// the folder above. Files that do not parse, or are no scenes, are passed over.
pub fn spacing_beside(path: &Path) -> Option<(f64, PathBuf)> {
    let folder =
        path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    [folder, &above(folder)].iter().find_map(|folder| spacing_in(folder))
}

/// The folder above, by name where `folder` ends in one.
fn above(folder: &Path) -> PathBuf {
    match (folder.components().next_back(), folder.parent()) {
        (Some(Component::Normal(_)), Some(parent)) if parent.as_os_str().is_empty() => ".".into(),
        (Some(Component::Normal(_)), Some(parent)) => parent.into(),
        _ => folder.join(".."),
    }
}

fn spacing_in(folder: &Path) -> Option<(f64, PathBuf)> {
    let files = std::fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    let mut scenes: Vec<(PathBuf, Parser)> =
        files.filter_map(|path| parser_for(&path).map(|parser| (path, parser))).collect();
    scenes.sort();
    scenes.into_iter().find_map(|(path, parser)| {
        let spacing = positive_length("spacing", parser(&read_small(&path)?)?).ok()?;
        Some((spacing, path))
    })
}

type Parser = fn(&[u8]) -> Option<f64>;

fn parser_for(path: &Path) -> Option<Parser> {
    let extension = path.extension()?;
    if extension.eq_ignore_ascii_case("json") {
        Some(splishsplash)
    } else if extension.eq_ignore_ascii_case("xml") {
        Some(dualsphysics)
    } else {
        None
    }
}

fn read_small(path: &Path) -> Option<Vec<u8>> {
    let file = File::open(path).ok()?;
    let metadata = file.metadata().ok()?;
    if !metadata.is_file() || metadata.len() > LARGEST {
        return None;
    }
    let mut bytes = Vec::new();
    file.take(LARGEST).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

/// Twice `Configuration.particleRadius`.
fn splishsplash(json: &[u8]) -> Option<f64> {
    #[derive(Deserialize)]
    #[serde(rename_all = "PascalCase")]
    struct Scene {
        configuration: Configuration,
    }
    #[derive(Deserialize)]
    #[serde(rename_all = "camelCase")]
    struct Configuration {
        particle_radius: f64,
    }
    let scene: Scene = serde_json::from_slice(json).ok()?;
    Some(2.0 * scene.configuration.particle_radius)
}

/// `<dp value="..">` among the constants of a `<case>`, else `<definition dp="..">`.
fn dualsphysics(xml: &[u8]) -> Option<f64> {
    let number = |element: &BytesStart, attribute: &str| -> Option<f64> {
        let attribute = element.try_get_attribute(attribute).ok()??;
        attribute.value.trim().parse().ok()
    };
    let xml = String::from_utf8_lossy(xml);
    let mut reader = Reader::from_str(&xml);
    let mut is_case = false;
    let mut defined = None;
    loop {
        match reader.read_event().ok()? {
            Event::Start(element) | Event::Empty(element) => match element.name().as_ref() {
                "case" => is_case = true,
                _ if !is_case => return None,
                "dp" => return number(&element, "value").or(defined),
                "definition" => defined = number(&element, "dp"),
                _ => {}
            },
            Event::Eof => return defined,
            _ => {}
        }
    }
}
