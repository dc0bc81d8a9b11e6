//! Reads Houdini's classic .bgeo ("BgeoV", version 5), as partio and SPlisHSPlasH write it.
//!
//! All numbers are big endian. A header defines the attributes. Then each point is one record of x,
//! y, z, w and the attributes, with four bytes per number. The rest of the file is not read.

use crate::particles::AttributeInfo;

use super::bytes::Bytes;
use super::columns::{Column, ColumnStore, Endian, ParticleRows, Scalar};
use super::cursor::Cursor;
use super::{ParticleFile, ReadFault, malformed};

/// Size, in bytes, of each number of a point.
const NUMBER: u64 = 4;

/// Reads the header and the names of the attributes. The points are read later.
///
/// A vector or a list of numbers is one attribute. Indexed strings are skipped. Positions are not
/// divided by the weight w, which is 1 for all points outside curves.
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
    let mut attributes = Vec::new();
    for _ in 0..definitions {
        let definition = Definition::read(&mut cursor)?;
        if let Some(scalar) = definition.scalar {
            attributes.push((definition.name, definition.components, scalar, record));
        }
        record += u64::from(definition.components) * NUMBER;
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
    Ok(ParticleFile::new(particles, "Houdini classic .bgeo"))
}

/// The definition of a point attribute: its name and how it is stored.
struct Definition {
    name: String,
    components: u16,
    /// The type of the numbers. `None` for indices of strings.
    scalar: Option<Scalar>,
}

impl Definition {
    fn read(cursor: &mut Cursor) -> Result<Self, ReadFault> {
        let length = cursor.u16("an attribute's name")?;
        let name = cursor.take("an attribute's name", length.into())?;
        let name = String::from_utf8_lossy(name).into_owned();
        let components = cursor.u16("an attribute's size")?;
        let at = cursor.at();
        let scalar = match cursor.u32("an attribute's type")? {
            0 | 5 => Some(Scalar::F32),
            1 => Some(Scalar::I32),
            4 => None,
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
        if scalar.is_some() {
            cursor.skip("an attribute's default values", components.into(), NUMBER)?;
        } else {
            for _ in 0..cursor.count("strings")? {
                let length = cursor.u16("a string's length")?;
                cursor.take("a string", length.into())?;
            }
        }
        Ok(Self { name, components, scalar })
    }
}
