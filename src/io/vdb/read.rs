//! Lists the grids of a file with their names and metadata, but without voxel values. Files that
//! other programs wrote are also supported.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::io::bytes::ByteView;
use crate::io::columns::Endian;
use crate::io::cursor::Cursor;
use crate::io::{ReadFault, malformed};

use super::archive::{MAGIC, VERSION};
use super::values::HALF;

/// The first supported version. Its files store a compression and offsets for each grid.
const FIRST_VERSION: u32 = 222;
/// Length of a file's identifier in bytes.
const ID: u64 = 36;
/// Maximum length, in bytes, of a text. Longer metadata values are skipped.
const LONGEST: u32 = 1 << 16;
/// Separates a grid's name from a suffix that distinguishes grids of the same name.
const SEPARATOR: char = '\u{1e}';

/// Description of a grid in a `.vdb`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct GridInfo {
    /// The name, which may be empty.
    pub name: String,
    /// The class, such as `level set` or `fog volume`.
    pub class: String,
    /// The type of the values, such as `float`, `vec3s` or `int32`. For a tree of an unusual shape,
    /// the type of the tree.
    pub value_type: String,
    /// Whether numbers are stored in half precision.
    pub half: bool,
    /// The number of active voxels, if the file states it.
    pub active_voxels: Option<u64>,
    /// The least and the greatest index of active voxels along each axis, if the file states them.
    pub index_bounds: Option<[[i32; 3]; 2]>,
    /// The edge lengths of a voxel. `None` for unsupported transforms.
    pub voxel_size: Option<[f64; 3]>,
    /// The centres of the voxels at `index_bounds`. `None` for rotations and unsupported
    /// transforms.
    pub bounds: Option<[[f64; 3]; 2]>,
}

/// The transform from voxel indices to positions.
#[derive(Debug, Default)]
struct Transform {
    /// The edge lengths of a voxel. `None` if unknown.
    size: Option<[f64; 3]>,
    /// The position of voxel index 0, if voxels are aligned to the axes.
    origin: Option<[f64; 3]>,
}

/// Reads the descriptions of all grids in a file, in file order.
///
/// # Errors
/// [`ReadFault::Truncated`] and [`ReadFault::Malformed`] for damaged files, and
/// [`ReadFault::Unsupported`] for other versions and for files that do not store the offsets of
/// their grids.
pub fn read_grids(bytes: ByteView) -> Result<Vec<GridInfo>, ReadFault> {
    let start = |at| Cursor::new(bytes, at, Endian::Little);
    let mut file = start(0);
    if file.u64("the header")? != MAGIC as u64 {
        return Err(malformed(0, "not an OpenVDB file"));
    }
    let version = file.u32("the header")?;
    if !(FIRST_VERSION..=VERSION).contains(&version) {
        let what = format!(
            "version {version} of the OpenVDB format is not supported, only {FIRST_VERSION} to \
             {VERSION}"
        );
        return Err(ReadFault::Unsupported(what));
    }
    // Skip the version of the library.
    file.u64("the header")?;
    let has_offsets = file.take("the header", 1)?[0] != 0;
    file.take("the identifier", ID)?;
    metadata(&mut file)?;
    let count = file.u32("the number of grids")?;
    if count > 0 && !has_offsets {
        let what = "the file was written to a stream and does not list the positions of its grids";
        return Err(ReadFault::Unsupported(what.to_owned()));
    }
    let mut grids = Vec::new();
    for _ in 0..count {
        let name = text(&mut file, "the name of a grid")?;
        let tree = text(&mut file, "the type of a grid")?;
        // Skip the name of the parent grid. A grid with a parent (an instance) shares the parent's
        // tree, but has its own metadata.
        text(&mut file, "the parent of a grid")?;
        let descriptor_at = file.at();
        let [grid, _, end] = [
            file.u64("the offset of a grid")?,
            file.u64("the offset of a grid")?,
            file.u64("the offset of a grid")?,
        ];
        let len = bytes.len() as u64;
        if grid < file.at() as u64 || end < grid {
            let what = format!("a grid cannot be at bytes {grid} to {end}");
            return Err(malformed(descriptor_at, what));
        }
        if end > len {
            let what = format!("grid {name}");
            return Err(ReadFault::Truncated { what, needed: end, have: len });
        }
        let mut at = start(grid as usize);
        at.u32("the compression of a grid")?;
        let metadata = metadata(&mut at)?;
        let transform = transform(&mut at)?;
        grids.push(GridInfo::new(&name, &tree, &metadata, &transform));
        file = start(end as usize);
    }
    Ok(grids)
}

impl GridInfo {
    fn new(
        name: &str,
        tree: &str,
        metadata: &BTreeMap<String, Vec<u8>>,
        transform: &Transform,
    ) -> Self {
        let stored = tree.strip_suffix(HALF);
        let tree = stored.unwrap_or(tree);
        let usual = tree.strip_prefix("Tree_").and_then(|tree| tree.strip_suffix("_5_4_3"));
        let class = metadata.get("class").map(|class| String::from_utf8_lossy(class).into_owned());
        let corner = |name: &str| -> Option<[i32; 3]> {
            let (words, []) = metadata.get(name)?.as_chunks::<4>() else { return None };
            Some(<[[u8; 4]; 3]>::try_from(words).ok()?.map(i32::from_le_bytes))
        };
        let index_bounds = corner("file_bbox_min").zip(corner("file_bbox_max"));
        let index_bounds = index_bounds.map(<[_; 2]>::from);
        // A grid without active voxels has bounds whose least index exceeds the greatest.
        let index_bounds =
            index_bounds.filter(|[low, high]| low.iter().zip(high).all(|(low, high)| low <= high));
        let place = |(origin, size): ([f64; 3], [f64; 3]), index: [i32; 3]| -> [f64; 3] {
            std::array::from_fn(|axis| origin[axis] + size[axis] * f64::from(index[axis]))
        };
        let axes = transform.origin.zip(transform.size);
        let voxels = metadata.get("file_voxel_count").and_then(|count| count[..].try_into().ok());
        Self {
            name: name.split(SEPARATOR).next().unwrap_or_default().to_owned(),
            class: class.unwrap_or_else(|| "unknown".to_owned()),
            value_type: usual.unwrap_or(tree).to_owned(),
            half: stored.is_some(),
            active_voxels: voxels.map(u64::from_le_bytes),
            index_bounds,
            voxel_size: transform.size,
            bounds: axes.zip(index_bounds).map(|(axes, corners)| corners.map(|at| place(axes, at))),
        }
    }
}

/// Reads a length, and the text that follows it.
fn text(file: &mut Cursor, what: &str) -> Result<String, ReadFault> {
    let at = file.at();
    let length = file.u32(what)?;
    if length > LONGEST {
        return Err(malformed(at, format!("{what} is too long: {length} bytes")));
    }
    Ok(String::from_utf8_lossy(file.take(what, length.into())?).into_owned())
}

/// Reads metadata: a map from names to the bytes of values. Long values are skipped.
fn metadata(file: &mut Cursor) -> Result<BTreeMap<String, Vec<u8>>, ReadFault> {
    const WHAT: &str = "metadata";
    let count = file.u32(WHAT)?;
    let mut all = BTreeMap::new();
    for _ in 0..count {
        let name = text(file, WHAT)?;
        let _type = text(file, WHAT)?;
        let length = file.u32(WHAT)?;
        if length > LONGEST {
            file.skip(WHAT, length.into(), 1)?;
        } else {
            all.insert(name, file.take(WHAT, length.into())?.to_vec());
        }
    }
    Ok(all)
}

fn transform(file: &mut Cursor) -> Result<Transform, ReadFault> {
    let kind = text(file, "the transform of a grid")?;
    let mut numbers = |count: usize| -> Result<Vec<f64>, ReadFault> {
        (0..count).map(|_| file.f64("the transform of a grid")).collect()
    };
    let mut vector =
        || -> Result<[f64; 3], ReadFault> { Ok(numbers(3)?.try_into().expect("three were read")) };
    Ok(match &*kind {
        // A map with a translation begins with the position of index 0 and the scale factors. The
        // values that follow, such as the absolute edge lengths of a voxel, are not needed.
        "UniformScaleTranslateMap" | "ScaleTranslateMap" => {
            Transform { origin: Some(vector()?), size: Some(vector()?) }
        }
        "UniformScaleMap" | "ScaleMap" => {
            Transform { origin: Some([0.0; 3]), size: Some(vector()?) }
        }
        "TranslationMap" => Transform { origin: Some(vector()?), size: Some([1.0; 3]) },
        "AffineMap" | "UnitaryMap" => {
            let matrix = numbers(16)?;
            let row = |row: usize| matrix[4 * row..][..3].iter().map(|x| x * x).sum::<f64>().sqrt();
            Transform { origin: None, size: Some([0, 1, 2].map(row)) }
        }
        _ => Transform::default(),
    })
}
