//! NumPy's .npy: an N x 3 array of f32 or f64, in either byte order and either order of its axes.
//!
//! The header is a Python dictionary. It is read by the few rules that NumPy's own writer follows, since a
//! general parser of literals can be made to run for hours by a kilobyte of brackets.

use super::bytes::Bytes;
use super::columns::{Column, ColumnStore, Endian, Rows, Scalar};
use super::cursor::{Cursor, malformed};
use super::{ParticleFile, ReadFault};

/// Reads the header; the array stays where it is.
///
/// # Errors
/// [`ReadFault::Unsupported`] for any other shape or element, [`ReadFault::Malformed`] and
/// [`ReadFault::Truncated`] for a header that does not parse or does not fit the file.
pub fn read_particles(bytes: Bytes) -> Result<ParticleFile, ReadFault> {
    let mut cursor = Cursor::new(&bytes, 0, Endian::Little);
    if cursor.take("the magic", 6)? != b"\x93NUMPY" {
        return Err(malformed(0, "not a .npy file: it does not begin with \"\\x93NUMPY\""));
    }
    let version = cursor.take("the version", 2)?[0];
    let length = match version {
        1 => cursor.u16("the header's length")?.into(),
        2 | 3 => cursor.u32("the header's length")?.into(),
        _ => {
            let what = format!("version {version} of .npy; versions 1 to 3 are known");
            return Err(ReadFault::Unsupported(what));
        }
    };
    let at = cursor.at();
    let header = cursor.take("the header", length)?;
    let header = std::str::from_utf8(header).map_err(|_| malformed(at, "the header is not text"))?;
    let value =
        |key: &str| value_of(header, key).ok_or_else(|| malformed(at, format!("the header has no '{key}'")));

    let (endian, scalar) = element(value("descr")?)?;
    let rows = row_count(value("shape")?, at)?;
    let size = scalar.size();
    let start = cursor.skip("the array", rows, 3 * size as u64)?;
    let rows = rows as usize;
    let (stride, axis_step) = match value("fortran_order")? {
        order if order.starts_with("False") => (3 * size, size),
        order if order.starts_with("True") => (size, rows * size),
        _ => return Err(malformed(at, "'fortran_order' is neither True nor False")),
    };
    let position = [0, 1, 2].map(|axis| Column { offset: start + axis * axis_step, stride, scalar, endian });
    Ok(ParticleFile {
        particles: ColumnStore::new(bytes, Rows::All(rows), position, Vec::new()),
        format: "NumPy .npy",
        spacing: None,
    })
}

/// What follows `'key':` in the dictionary, to its end.
fn value_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    ['\'', '"'].iter().find_map(|quote| {
        let (_, rest) = header.split_once(&format!("{quote}{key}{quote}"))?;
        Some(rest.trim_start().strip_prefix(':')?.trim_start())
    })
}

/// The type named by `'<f4'` and the like.
fn element(descr: &str) -> Result<(Endian, Scalar), ReadFault> {
    let mut parts = descr.splitn(3, ['\'', '"']);
    let name = match (parts.next(), parts.next(), parts.next()) {
        (Some(""), Some(name), Some(_)) => name,
        _ => "of a structure",
    };
    match name {
        "<f4" => Ok((Endian::Little, Scalar::F32)),
        "<f8" => Ok((Endian::Little, Scalar::F64)),
        ">f4" => Ok((Endian::Big, Scalar::F32)),
        ">f8" => Ok((Endian::Big, Scalar::F64)),
        _ => Err(ReadFault::Unsupported(format!(
            "elements {name}; positions are read from float32 and float64 (.astype(np.float32))"
        ))),
    }
}

/// N of the shape `(N, 3)`.
fn row_count(shape: &str, at: usize) -> Result<u64, ReadFault> {
    let shape = shape
        .strip_prefix('(')
        .and_then(|rest| rest.split_once(')'))
        .map(|(inside, _)| inside)
        .ok_or_else(|| malformed(at, "'shape' is not a tuple"))?;
    let sizes = shape.split(',').map(|size| size.trim().trim_end_matches('L'));
    match *sizes.filter(|size| !size.is_empty()).collect::<Vec<_>>() {
        [rows, "3"] => rows.parse().map_err(|_| malformed(at, format!("{rows} is no number of rows"))),
        _ => Err(ReadFault::Unsupported(format!("an array of shape ({shape}); particles are (N, 3)"))),
    }
}
