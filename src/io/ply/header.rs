//! The header of a .ply file: the elements and their properties.

use crate::io::ReadFault;
use crate::io::bytes::ByteView;
use crate::io::columns::{Endian, Scalar};
use crate::io::scan::Lines;

/// Length, in bytes, of the longest comment keyword, including the space after it.
const LONGEST_KEYWORD: usize = "obj_info ".len();

/// The encoding of the rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    Binary(Endian),
}

/// A property of each row: a single value, or a list, which is stored as its length and its values.
#[derive(Debug, Clone)]
pub(super) struct PlyProperty {
    pub name: String,
    pub scalar: Scalar,
    /// The number type of the list's length. `None` if the property is a single value.
    pub list: Option<Scalar>,
}

/// An element: rows that all have the same properties.
#[derive(Debug)]
pub(super) struct Element {
    pub name: String,
    pub count: usize,
    pub properties: Vec<PlyProperty>,
}

impl Element {
    /// Size, in bytes, of a binary row. `None` if rows contain lists and may therefore differ in
    /// size.
    pub fn row(&self) -> Option<usize> {
        self.properties.iter().map(|p| p.list.is_none().then(|| p.scalar.size())).sum()
    }

    /// A copy of the element without its list properties.
    pub fn without_lists(&self) -> Self {
        let properties = self.properties.iter().filter(|p| p.list.is_none()).cloned().collect();
        Self { name: self.name.clone(), count: self.count, properties }
    }

    /// The index of the property `name`. An exact match has priority over a match that ignores
    /// case.
    pub fn property(&self, name: &str) -> Option<usize> {
        let exact = self.properties.iter().position(|p| p.name == name);
        exact.or_else(|| self.properties.iter().position(|p| p.name.eq_ignore_ascii_case(name)))
    }
}

/// The contents of the header.
#[derive(Debug)]
pub(super) struct PlyHeader {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Byte offset of the data in the file.
    pub body: usize,
}

impl PlyHeader {
    pub fn parse(bytes: ByteView) -> Result<Self, ReadFault> {
        let mut lines = Lines::of_text(bytes)?;
        if lines.line()?.as_deref().map(str::trim_end) != Some("ply") {
            return Err(lines.fault(0, "a .ply file starts with `ply`".into()));
        }
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        loop {
            let here = lines.clone();
            let fault = |what: String| here.fault(here.at(), what);
            let ahead = lines.ahead(LONGEST_KEYWORD)?;
            if matches!(ahead.split(u8::is_ascii_whitespace).next(), Some(b"comment" | b"obj_info"))
            {
                lines.skip_line()?;
                continue;
            }
            let Some(text) = lines.line()? else {
                return Err(fault("the file ends before `end_header`".into()));
            };
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            match *words {
                [] => {}
                ["format", name, "1.0"] => {
                    encoding = Some(encoding_named(name).ok_or_else(|| {
                        fault(format!(
                            "format {name:?} is unknown; supported: ascii, binary_little_endian, \
                             binary_big_endian"
                        ))
                    })?)
                }
                ["element", name, count] => {
                    let count =
                        count.parse().map_err(|_| fault(format!("{count:?} is not a count")))?;
                    elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
                }
                ["property", ref rest @ ..] => {
                    let property = property(rest)
                        .ok_or_else(|| fault(format!("{text:?} is not a valid property")))?;
                    let element = elements
                        .last_mut()
                        .ok_or_else(|| fault("a property precedes the first element".into()))?;
                    element.properties.push(property);
                }
                ["end_header"] => {
                    let encoding = encoding
                        .ok_or_else(|| fault("the header does not name a format".into()))?;
                    return Ok(Self { encoding, elements, body: lines.at() });
                }
                _ => return Err(fault(format!("{text:?} is not a valid line of a .ply header"))),
            }
        }
    }
}

fn encoding_named(name: &str) -> Option<Encoding> {
    Some(match name {
        "ascii" => Encoding::Ascii,
        "binary_little_endian" => Encoding::Binary(Endian::Little),
        "binary_big_endian" => Encoding::Binary(Endian::Big),
        _ => return None,
    })
}

fn property(words: &[&str]) -> Option<PlyProperty> {
    let (list, scalar, name) = match words {
        ["list", list, scalar, name] => (Some(integer_named(list)?), scalar, name),
        [scalar, name] => (None, scalar, name),
        _ => return None,
    };
    Some(PlyProperty { name: (*name).to_owned(), scalar: scalar_named(scalar)?, list })
}

fn scalar_named(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "int64" | "longlong" => Scalar::I64,
        "uint64" | "ulonglong" => Scalar::U64,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

fn integer_named(name: &str) -> Option<Scalar> {
    scalar_named(name).filter(|scalar| !matches!(scalar, Scalar::F32 | Scalar::F64))
}
