//! Reads Houdini's classic .bgeo ("BgeoV", version 5), as partio and SPlisHSPlasH write it.
//!
//! All numbers are big endian. A header defines the attributes. Then each point is one record of x,
//! y, z, w and the attributes, with four bytes per number. The rest of the file is not read.

use std::collections::BTreeSet;

use crate::particles::{AttributeInfo, Label};

use super::bytes::Bytes;
use super::columns::{Column, ColumnStore, Endian, ParticleRows, Scalar};
use super::cursor::Cursor;
use super::houdini::MOST_TEXTS;
use super::{ParticleFile, ReadFault, malformed};

/// Size, in bytes, of each number of a point.
const NUMBER: u64 = 4;

/// Reads the header and the names of the attributes. The points are read later.
///
/// A vector or a list of numbers becomes one attribute. An attribute with one indexed string per
/// point becomes a label, unless its table has more than `MOST_TEXTS` strings. A point whose index
/// is -1 gets the empty string. Positions are not divided by the weight w, which is 1 for all
/// points that do not belong to a curve.
///
/// # Errors
/// [`ReadFault::Unsupported`] for a version other than 5 and for strings that are not indexed,
/// [`ReadFault::Malformed`] for an invalid header, and [`ReadFault::Truncated`] if the file ends
/// before the last point.
pub fn read_particles(bytes: Bytes) -> Result<ParticleFile, ReadFault> {
    let mut cursor = Cursor::new(bytes.view(), 0, Endian::Big);
    if cursor.take("the magic", 5)? != b"BgeoV" {
        return Err(malformed(0, "not a .bgeo file: it does not begin with \"BgeoV\""));
    }
    let version = cursor.u32("the version")?;
    if version != 5 {
        return Err(ReadFault::Unsupported(format!(
            "version {version} of the classic .bgeo format is not supported, only version 5"
        )));
    }
    let points = cursor.count("points")?;
    cursor.skip("the header", 3, NUMBER)?;
    let definitions = cursor.count("point attributes")?;
    cursor.skip("the header", 3, NUMBER)?;

    let mut record = 4 * NUMBER;
    let (mut attributes, mut labels) = (Vec::new(), Vec::new());
    for _ in 0..definitions {
        let Definition { name, components, values } = Definition::read(&mut cursor)?;
        match values {
            DefinedValues::Numbers(scalar) => attributes.push((name, components, scalar, record)),
            DefinedValues::Strings(texts) if components == 1 && texts.len() <= MOST_TEXTS => {
                labels.push((name, texts, record));
            }
            DefinedValues::Strings(_) => {}
        }
        record += u64::from(components) * NUMBER;
    }
    let start = cursor.skip("the points", points, record)?;

    let column = |scalar, within: u64| Column {
        offset: start + within as usize,
        stride: record as usize,
        scalar,
        endian: Endian::Big,
    };
    let position = column(Scalar::F32, 0);
    let attributes = attributes
        .into_iter()
        .filter(|(_, components, ..)| *components > 0)
        .map(|(name, components, scalar, within)| {
            let components = usize::from(components);
            let first = column(scalar, within);
            let columns = (0..components).map(|index| first.component(index)).collect();
            (AttributeInfo::new(name, components), columns)
        })
        .collect();
    let position = [0, 1, 2].map(|axis| position.component(axis));
    let particles: ColumnStore =
        ColumnStore::new(bytes, ParticleRows::All(points as usize), position, attributes);
    // The index -1 stands for no string. As an unsigned number, this index is greater than the
    // index of every string. A point with this index gets the label's first text, which is empty.
    let labels = labels.into_iter().map(|(name, texts, within)| {
        let (label, places) = label(name, texts);
        (label, (column(Scalar::U32, within), places))
    });
    Ok(ParticleFile::new(particles.with_labels(labels), "Houdini classic .bgeo"))
}

/// Returns the label with these texts, and maps their indices in the file to indices in the label.
/// The first text of the label is the empty text, because points without a string get the first
/// text.
fn label(name: String, texts: Vec<String>) -> (Label, Vec<u32>) {
    let unique: BTreeSet<String> = texts.iter().cloned().chain([String::new()]).collect();
    let unique: Vec<String> = unique.into_iter().collect();
    let place = |text: &String| unique.partition_point(|other| other < text) as u32;
    let places = texts.iter().map(place).collect();
    (Label { name, texts: unique }, places)
}

/// The definition of a point attribute: its name and how it is stored.
struct Definition {
    name: String,
    components: u16,
    values: DefinedValues,
}

/// The values of a point attribute.
enum DefinedValues {
    /// Numbers of this type.
    Numbers(Scalar),
    /// Indices of these strings.
    Strings(Vec<String>),
}

impl Definition {
    fn read(cursor: &mut Cursor) -> Result<Self, ReadFault> {
        let length = cursor.u16("an attribute's name")?;
        let name = cursor.take("an attribute's name", length.into())?;
        let name = String::from_utf8_lossy(name).into_owned();
        let components = cursor.u16("an attribute's size")?;
        let at = cursor.at();
        let scalar = match cursor.u32("an attribute's type")? {
            0 | 5 => Scalar::F32,
            1 => Scalar::I32,
            4 => {
                let mut texts = Vec::new();
                for _ in 0..cursor.count("strings")? {
                    let length = cursor.u16("a string's length")?;
                    let text = cursor.take("a string", length.into())?;
                    // Keep at most one string more than a label can have, which is enough to show
                    // that there are too many.
                    if texts.len() <= MOST_TEXTS {
                        texts.push(String::from_utf8_lossy(text).into_owned());
                    }
                }
                return Ok(Self { name, components, values: DefinedValues::Strings(texts) });
            }
            2 => {
                let what = format!(
                    "the attribute {name} contains plain strings; delete it, or convert it to \
                     indexed strings"
                );
                return Err(ReadFault::Unsupported(what));
            }
            other => {
                return Err(malformed(
                    at,
                    format!("the attribute {name} has the unknown type {other}"),
                ));
            }
        };
        cursor.skip("an attribute's default values", components.into(), NUMBER)?;
        Ok(Self { name, components, values: DefinedValues::Numbers(scalar) })
    }
}
