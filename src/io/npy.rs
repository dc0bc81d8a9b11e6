//! NumPy's .npy: an N x 3 array of f32 or f64, in either byte order and either order of its axes.
//!
//! The header is a Python dictionary. It is read by the few rules that NumPy's own writer follows,
//! since a general parser of literals can be made to run for hours by a kilobyte of brackets.

use super::bytes::{Bytes, View};
use super::columns::{Column, ColumnStore, Endian, Rows, Scalar};
use super::cursor::Cursor;
use super::{ParticleFile, ReadFault, malformed};

/// Reads the header; the array stays where it is.
///
/// # Errors
/// [`ReadFault::Unsupported`] for any other shape or element, [`ReadFault::Malformed`] and
/// [`ReadFault::Truncated`] for a header that does not parse or does not fit the file.
pub fn read_particles(bytes: Bytes) -> Result<ParticleFile, ReadFault> {
    let header = Header::read(bytes.view())?;
    header.expect_position()?;
    let [rows, 3] = header.shape[..] else {
        let shape = shown(&header.shape);
        return Err(ReadFault::Unsupported(format!(
            "an array of shape {shape}; particles are (N, 3)"
        )));
    };
    let mut cursor = Cursor::new(bytes.view(), header.start, Endian::Little);
    cursor.skip("the array", rows, 3 * header.element_bytes())?;
    let position = [0, 1, 2].map(|axis| header.column(header.start, axis));
    let particles: ColumnStore =
        ColumnStore::new(bytes, Rows::All(rows as usize), position, Vec::new());
    Ok(ParticleFile::new(particles, "NumPy .npy"))
}

/// The contents of an array's header.
pub(super) struct Header {
    /// None for objects, texts and the like.
    element: Option<(Endian, Scalar)>,
    /// The element as NumPy spells it.
    descr: String,
    pub shape: Vec<u64>,
    fortran: bool,
    /// Offset of the first element, in bytes from the start of the header.
    pub start: usize,
}

impl Header {
    /// Reads the header that `bytes` begin with.
    pub fn read(bytes: View) -> Result<Self, ReadFault> {
        let mut cursor = Cursor::new(bytes, 0, Endian::Little);
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
        let header = cursor.take("the header", length)?.to_vec();
        let header =
            String::from_utf8(header).map_err(|_| malformed(at, "the header is not text"))?;
        let value = |key: &str| {
            value_of(&header, key)
                .ok_or_else(|| malformed(at, format!("the header has no '{key}'")))
        };
        let descr = descr(value("descr")?).to_owned();
        let fortran = match value("fortran_order")? {
            order if order.starts_with("False") => false,
            order if order.starts_with("True") => true,
            _ => return Err(malformed(at, "'fortran_order' is neither True nor False")),
        };
        let shape = shape(value("shape")?, at)?;
        Ok(Self { element: element(&descr), descr, shape, fortran, start: cursor.at() })
    }

    /// Whether the elements are numbers.
    pub fn is_numeric(&self) -> bool {
        self.element.is_some()
    }

    /// Makes sure that the elements may be positions.
    pub fn expect_position(&self) -> Result<(), ReadFault> {
        match self.element {
            Some((_, Scalar::F32 | Scalar::F64)) => Ok(()),
            _ => Err(ReadFault::Unsupported(format!(
                "elements {}; positions are read from float32 and float64 (.astype(np.float32))",
                self.descr
            ))),
        }
    }

    /// Width of an element; 0 where they are no numbers.
    pub fn element_bytes(&self) -> u64 {
        self.element.map_or(0, |(_, scalar)| scalar.size() as u64)
    }

    /// Numbers in every row.
    pub fn components(&self) -> u64 {
        self.shape
            .get(1..)
            .unwrap_or_default()
            .iter()
            .fold(1, |product, &size| product.saturating_mul(size))
    }

    /// Bytes of all elements.
    pub fn data_bytes(&self) -> u64 {
        self.shape.iter().fold(self.element_bytes(), |product, &size| product.saturating_mul(size))
    }

    /// Number `component` of every row, where the first element lies at byte `at`. Only where the
    /// data were found to be there.
    pub fn column(&self, at: usize, component: usize) -> Column {
        let (endian, scalar) = self.element.unwrap_or((Endian::Little, Scalar::U8));
        let size = scalar.size();
        let (stride, step) = match self.fortran {
            false => (self.components() as usize * size, size),
            true => (size, self.shape.first().map_or(0, |&rows| rows as usize * size)),
        };
        Column { offset: at + component * step, stride, scalar, endian }
    }
}

/// A shape as Python writes it.
pub(super) fn shown(shape: &[u64]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => format!("({})", shape.iter().map(u64::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// Returns the text that follows `'key':` in the dictionary, to its end.
fn value_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    ['\'', '"'].iter().find_map(|quote| {
        let (_, rest) = header.split_once(&format!("{quote}{key}{quote}"))?;
        Some(rest.trim_start().strip_prefix(':')?.trim_start())
    })
}

/// Returns the text between the quotes of `'<f4'` and the like.
fn descr(descr: &str) -> &str {
    let mut parts = descr.splitn(3, ['\'', '"']);
    match (parts.next(), parts.next(), parts.next()) {
        (Some(""), Some(name), Some(_)) => name,
        _ => "of a structure",
    }
}

/// The type that `<f4` names, and the like.
fn element(descr: &str) -> Option<(Endian, Scalar)> {
    let (order, kind) = descr.split_at_checked(1)?;
    let endian = if order == ">" { Endian::Big } else { Endian::Little };
    let scalar = match kind {
        "i1" => Scalar::I8,
        "u1" | "b1" => Scalar::U8,
        "i2" => Scalar::I16,
        "u2" => Scalar::U16,
        "i4" => Scalar::I32,
        "u4" => Scalar::U32,
        "i8" => Scalar::I64,
        "u8" => Scalar::U64,
        "f4" => Scalar::F32,
        "f8" => Scalar::F64,
        _ => return None,
    };
    let known = matches!(order, "<" | ">") || order == "|" && scalar.size() == 1;
    known.then_some((endian, scalar))
}

/// The sizes in `(N, 3)`.
fn shape(shape: &str, at: usize) -> Result<Vec<u64>, ReadFault> {
    let inside = shape.strip_prefix('(').and_then(|rest| rest.split_once(')'));
    let (inside, _) = inside.ok_or_else(|| malformed(at, "'shape' is not a tuple"))?;
    let sizes = inside.split(',').map(|size| size.trim().trim_end_matches('L'));
    let number = |size: &str| {
        size.parse().map_err(|_| malformed(at, format!("{size} is no size of an array")))
    };
    sizes.filter(|size| !size.is_empty()).map(number).collect()
}
