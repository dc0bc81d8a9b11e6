//! Finds the spacing of the particles and the walls of their tank in a simulator's scene file.
//!
//! The scene file is in the folder of the frames or its parent folder. SPlisHSPlasH's scene is JSON
//! with the particle radius, which is half the spacing. Its tank is a box-shaped wall.
//! DualSPHysics' case is XML with the spacing `dp`. Its tank is the largest box of boundary
//! particles. The tank has walls at the faces that the case fills with particles.

use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use serde::Deserialize;

use crate::grid::Walls;
use crate::grid::units::positive_length;

/// Maximum size of a scene file in bytes. Larger files are skipped, because they probably contain
/// results instead of a scene.
const LARGEST: u64 = 16 << 20;

/// Facts about the particles and their tank that a scene contains.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SceneFacts {
    spacing: f64,
    tank: Option<Walls>,
}

/// The spacing of the particles at `path`, and the path of a scene file that contains it. `None` if
/// scene files contain different spacings.
///
/// Reads the .json and .xml files in the folder of `path`, or, if none of them is a scene, those in
/// the parent folder. Invalid files and files with other contents are skipped.
pub fn spacing_from_scene(path: &Path) -> Option<(f64, PathBuf)> {
    let scenes = scenes_near(path).into_iter();
    single_value(scenes.map(|(scene, path)| (scene.spacing, path)))
}

/// The walls of the tank around the particles at `path`, and the path of a scene file that contains
/// them. `None` if scene files contain different spacings or different tanks.
pub fn tank_from_scene(path: &Path) -> Option<(Walls, PathBuf)> {
    let scenes = scenes_near(path);
    single_value(scenes.iter().map(|(scene, path)| (scene.spacing, path)))?;
    let tanks = scenes.into_iter().filter_map(|(scene, path)| Some((scene.tank?, path)));
    single_value(tanks)
}

/// The first value. `None` if there is no value, or if a later value differs from the first.
fn single_value<T: PartialEq, P>(mut values: impl Iterator<Item = (T, P)>) -> Option<(T, P)> {
    let first = values.next()?;
    values.all(|(other, _)| other == first.0).then_some(first)
}

/// The scenes in the folder of `path`, or, if there are none, those in the parent folder.
fn scenes_near(path: &Path) -> Vec<(SceneFacts, PathBuf)> {
    let folder =
        path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let scenes = scenes_in(folder);
    if scenes.is_empty() { scenes_in(&parent_folder(folder)) } else { scenes }
}

/// The path of the parent folder, without `..` if possible.
fn parent_folder(folder: &Path) -> PathBuf {
    match (folder.components().next_back(), folder.parent()) {
        (Some(Component::Normal(_)), Some(parent)) if parent.as_os_str().is_empty() => ".".into(),
        (Some(Component::Normal(_)), Some(parent)) => parent.into(),
        _ => folder.join(".."),
    }
}

/// The scenes in a folder, sorted by the names of their files.
fn scenes_in(folder: &Path) -> Vec<(SceneFacts, PathBuf)> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let files = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut files: Vec<(PathBuf, Parser)> =
        files.filter_map(|path| parser_for(&path).map(|parser| (path, parser))).collect();
    files.sort_by(|(a, _), (b, _)| a.cmp(b));
    let scene = |(path, parser): (PathBuf, Parser)| {
        let scene = parser(&read_small(&path)?)?;
        positive_length("spacing", scene.spacing).ok()?;
        Some((scene, path))
    };
    files.into_iter().filter_map(scene).collect()
}

type Parser = fn(&[u8]) -> Option<SceneFacts>;

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

/// The six walls of a box with its lowest corner at `lo`. `None` for an invalid box. All
/// coordinates are rounded to the decimal place of the twelfth significant digit of the greatest
/// coordinate or edge, which removes the rounding errors of the corners.
fn walls_of(lo: [f64; 3], size: [f64; 3]) -> Option<Walls> {
    let is_box = lo.iter().all(|at| at.is_finite())
        && size.iter().all(|&edge| edge > 0.0 && edge.is_finite());
    let greatest = lo.iter().chain(&size).fold(0.0, |most: f64, at| most.max(at.abs()));
    let digits = (12.0 - libm::log10(greatest).ceil()).clamp(0.0, 30.0) as usize;
    let tidy = |at: f64| format!("{at:.digits$}").parse().map_or(at, |tidy: f64| tidy + 0.0);
    let ends = |axis: usize| [lo[axis], lo[axis] + size[axis]].map(|at| Some(tidy(at)));
    is_box.then(|| Walls([0, 1, 2].map(ends)))
}

/// A flag of a body, which is a boolean or a number. The number 0 means false. A missing flag is
/// false. `None` for other values.
fn flag(value: &serde_json::Value) -> Option<bool> {
    match value {
        serde_json::Value::Null => Some(false),
        serde_json::Value::Bool(flag) => Some(*flag),
        serde_json::Value::Number(number) => Some(number.as_f64() != Some(0.0)),
        _ => None,
    }
}

/// Reads a scene of SPlisHSPlasH. The spacing is twice `Configuration.particleRadius`. If exactly
/// one body is a wall, and this wall is a box that is neither rotated nor moving, this wall is the
/// tank. Otherwise, the tank is `None`.
fn splishsplash(json: &[u8]) -> Option<SceneFacts> {
    #[derive(Deserialize)]
    #[serde(rename_all = "PascalCase")]
    struct SceneDocument {
        configuration: Configuration,
        #[serde(default)]
        rigid_bodies: serde_json::Value,
    }
    #[derive(Deserialize)]
    #[serde(rename_all = "camelCase")]
    struct Configuration {
        particle_radius: f64,
    }
    #[derive(Deserialize)]
    #[serde(rename_all = "camelCase", default)]
    struct Body {
        geometry_file: String,
        is_dynamic: serde_json::Value,
        rotation_angle: f64,
        translation: [f64; 3],
        scale: [f64; 3],
    }
    impl Default for Body {
        fn default() -> Self {
            Self {
                geometry_file: String::new(),
                is_dynamic: serde_json::Value::Null,
                rotation_angle: 0.0,
                translation: [0.0; 3],
                scale: [1.0; 3],
            }
        }
    }
    impl Body {
        /// The walls of a scaled unit box that does not move or rotate. `None` for other bodies.
        fn walls(&self) -> Option<Walls> {
            let is_box = self.geometry_file.rsplit(['/', '\\']).next() == Some("UnitBox.obj");
            let is_fixed = flag(&self.is_dynamic) == Some(false) && self.rotation_angle == 0.0;
            let lo = [0, 1, 2].map(|axis| self.translation[axis] - self.scale[axis] / 2.0);
            walls_of(lo, self.scale).filter(|_| is_box && is_fixed)
        }
    }
    let SceneDocument { configuration, rigid_bodies } = serde_json::from_slice(json).ok()?;
    // Bodies that are not walls do not matter, even if they are invalid.
    let bodies = rigid_bodies.as_array().into_iter().flatten();
    let walls: Vec<_> = bodies.filter(|body| flag(&body["isWall"]) != Some(false)).collect();
    let tank = match walls[..] {
        [tank] => Body::deserialize(tank).ok().and_then(|body| body.walls()),
        _ => None,
    };
    Some(SceneFacts { spacing: 2.0 * configuration.particle_radius, tank })
}

/// Reads a case of DualSPHysics. The spacing is `<dp value="..">` among the constants of a
/// `<case>`, or else `<definition dp="..">`. The tank is the largest `<drawbox>` of boundary
/// particles.
fn dualsphysics(xml: &[u8]) -> Option<SceneFacts> {
    let number = |element: &BytesStart, attribute: &str| -> Option<f64> {
        let attribute = element.try_get_attribute(attribute).ok()??;
        attribute.value.trim().parse().ok()
    };
    let point = |element: &BytesStart| {
        Some([number(element, "x")?, number(element, "y")?, number(element, "z")?])
    };
    let xml = String::from_utf8_lossy(xml);
    let mut reader = Reader::from_str(&xml);
    let mut is_case = false;
    let (mut constant, mut defined) = (None, None);
    let mut boxes = CaseBoxes::default();
    loop {
        match reader.read_event().ok()? {
            Event::Start(element) | Event::Empty(element) => match element.name().as_ref() {
                "case" => is_case = true,
                _ if !is_case => return None,
                "dp" if constant.is_none() => constant = number(&element, "value"),
                "definition" => defined = number(&element, "dp"),
                "point" => boxes.lo = point(&element),
                "size" => boxes.size = point(&element),
                name => boxes.begin(name),
            },
            Event::Text(text) if boxes.is_fill => boxes.fill = text.as_ref().to_owned(),
            Event::End(element) => boxes.end(element.name().as_ref()),
            Event::Eof => break,
            _ => {}
        }
    }
    Some(SceneFacts { spacing: constant.or(defined)?, tank: boxes.tank() })
}

/// The boxes that a case draws.
#[derive(Debug, Default)]
struct CaseBoxes {
    /// Whether the current commands draw boundary particles.
    is_boundary: bool,
    /// Whether a command transforms boxes. If so, the walls of the tank are unknown.
    is_moved: bool,
    /// Whether the reader is within a `boxfill` element.
    is_fill: bool,
    /// The fill mode of the current box, see [`filled`].
    fill: String,
    /// The lowest corner of the current box.
    lo: Option<[f64; 3]>,
    size: Option<[f64; 3]>,
    /// The volume of each box of boundary particles, and its filled faces as walls.
    walled: Vec<(f64, Walls)>,
}

impl CaseBoxes {
    fn begin(&mut self, name: &str) {
        match name {
            "setmkbound" => self.is_boundary = true,
            "setmkfluid" | "setmkvoid" => self.is_boundary = false,
            "move" | "rotate" | "rotateline" | "scale" | "matrixreset" => self.is_moved = true,
            "drawbox" => (self.lo, self.size, self.fill) = (None, None, String::new()),
            "boxfill" => self.is_fill = true,
            _ => {}
        }
    }

    fn end(&mut self, name: &str) {
        match name {
            "boxfill" => self.is_fill = false,
            "drawbox" => {
                let (Some(lo), Some(size), true) = (self.lo, self.size, self.is_boundary) else {
                    return;
                };
                let walls = walls_of(lo, size).zip(filled(&self.fill));
                self.walled.extend(walls.map(|(Walls(ends), filled)| {
                    let wall =
                        |axis: usize, end: usize| ends[axis][end].filter(|_| filled[axis][end]);
                    let walls = [0, 1, 2].map(|axis| [0, 1].map(|end| wall(axis, end)));
                    (size.iter().product(), Walls(walls))
                }));
            }
            _ => {}
        }
    }

    fn tank(self) -> Option<Walls> {
        let largest = self.walled.into_iter().reduce(|a, b| if b.0 > a.0 { b } else { a });
        largest.filter(|_| !self.is_moved).map(|(_, walls)| walls)
    }
}

/// The faces that a fill mode such as `bottom | left` or `all^top` fills: the lower face and the
/// upper face along each axis. `None` for an unknown mode.
fn filled(fill: &str) -> Option<[[bool; 2]; 3]> {
    const FACES: [[&str; 2]; 3] = [["left", "right"], ["front", "back"], ["bottom", "top"]];
    let mut words = fill.split('^').map(str::trim);
    let listed: Vec<&str> = words.next()?.split('|').map(str::trim).collect();
    let without: Vec<&str> = words.flat_map(|list| list.split('|')).map(str::trim).collect();
    let is_known = |word: &&str| *word == "all" || FACES.as_flattened().contains(word);
    listed.iter().chain(&without).all(is_known).then(|| {
        FACES.map(|pair| {
            pair.map(|face| {
                (listed.contains(&face) || listed.contains(&"all")) && !without.contains(&face)
            })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(extra: &str) -> Vec<u8> {
        let body = format!(
            r#"{{"geometryFile": "../models/UnitBox.obj", "translation": [0, 1.5, 0], "scale": [4, 3, 1.5], "isWall": true{extra}}}"#
        );
        format!(r#"{{"Configuration": {{"particleRadius": 0.025}}, "RigidBodies": [{body}]}}"#)
            .into()
    }

    #[test]
    fn scenes_that_disagree_give_no_spacing_and_no_tank() {
        let folder = tempfile::tempdir().unwrap();
        let frame = folder.path().join("frame_1.vtk");
        // Returns the spacing, and the top of the tank.
        let found_with = |name: &str, scene: Vec<u8>| {
            std::fs::write(folder.path().join(name), scene).unwrap();
            let top = tank_from_scene(&frame).map(|(walls, _)| walls.0[1][1].unwrap());
            (spacing_from_scene(&frame).map(|(spacing, _)| spacing), top)
        };
        let with = |old: &str, new: &str| {
            String::from_utf8(body("")).unwrap().replace(old, new).into_bytes()
        };
        assert_eq!(found_with("c.json", body("")), (Some(0.05), Some(3.0)));
        assert_eq!(found_with("results.json", b"{}".into()), (Some(0.05), Some(3.0)));
        // A scene with another particle radius and without a tank.
        let other = br#"{"Configuration": {"particleRadius": 0.1}}"#;
        assert_eq!(found_with("d.json", other.into()), (None, None));
        assert_eq!(found_with("d.json", b"{}".into()), (Some(0.05), Some(3.0)));
        assert_eq!(found_with("b.json", with("[4, 3, 1.5]", "[4, 2, 1.5]")), (Some(0.05), None));
        assert_eq!(found_with("a.json", with("0.025", "0.05")), (None, None));
    }

    #[test]
    fn the_splishsplash_tank_is_its_static_wall_box() {
        let tank =
            Walls([[Some(-2.0), Some(2.0)], [Some(0.0), Some(3.0)], [Some(-0.75), Some(0.75)]]);
        let scene = splishsplash(&body("")).unwrap();
        assert_eq!(scene, SceneFacts { spacing: 0.05, tank: Some(tank) });
        for other in [
            ", \"isDynamic\": true",
            ", \"isDynamic\": \"yes\"",
            ", \"rotationAngle\": 0.1",
            ", \"other\": 1",
        ] {
            let expected = if other.contains("other") { Some(tank) } else { None };
            assert_eq!(splishsplash(&body(other)).unwrap().tank, expected, "{other}");
        }
        // A second body with a number as its flag, or with an invalid property.
        for other in [r#"{"isDynamic": 1}"#, r#"{"isWall": 0, "scale": 1}"#] {
            let scene =
                String::from_utf8(body("")).unwrap().replace("}]", &format!("}}, {other}]"));
            assert_eq!(splishsplash(scene.as_bytes()).unwrap().tank, Some(tank), "{other}");
        }
        let moving = splishsplash(&body(", \"isDynamic\": 1")).unwrap();
        assert_eq!(moving.tank, None);
        let shifted = String::from_utf8(body("")).unwrap().replace("[0, 1.5, 0]", "[0, 1, 0]");
        let shifted = shifted.replace("[4, 3, 1.5]", "[4, 2.1, 1.5]");
        let tank = splishsplash(shifted.as_bytes()).unwrap().tank.unwrap();
        assert_eq!(tank.0[1], [Some(-0.05), Some(2.05)], "1 - 2.1 / 2 has a rounding error");
        let without =
            br#"{"Configuration": {"particleRadius": 0.025}, "RigidBodies": [{"scale": 1}]}"#;
        assert_eq!(splishsplash(without), Some(SceneFacts { spacing: 0.05, tank: None }));
    }

    #[test]
    fn the_dualsphysics_tank_is_the_filled_faces_of_its_largest_box() {
        let case = |moved: &str| {
            let drawn = |fill: &str, size: [f64; 3]| {
                let [x, y, z] = size;
                format!(
                    r#"<drawbox><boxfill>{fill}</boxfill><point x="0" y="0" z="0" /><size x="{x}" y="{y}" z="{z}" /></drawbox>"#
                )
            };
            let all = [
                "<setmkfluid mk=\"0\" />".to_owned(),
                drawn("solid", [9.0; 3]),
                "<setmkbound mk=\"0\" />".into(),
                drawn("bottom | left|right | front", [1.6, 0.67, 0.4]),
                drawn("all^top", [0.1, 0.1, 0.1]),
            ];
            format!(r#"<case><definition dp="0.02"/>{moved}{}</case>"#, all.join(""))
        };
        let tank = Walls([[Some(0.0), Some(1.6)], [Some(0.0), None], [Some(0.0), None]]);
        let scene = dualsphysics(case("").as_bytes());
        assert_eq!(scene, Some(SceneFacts { spacing: 0.02, tank: Some(tank) }));
        assert_eq!(dualsphysics(case("<move x=\"1\" />").as_bytes()).unwrap().tank, None);
        assert_eq!(filled("all^top"), Some([[true; 2], [true; 2], [true, false]]));
        assert_eq!(filled("solid"), None);
    }
}
