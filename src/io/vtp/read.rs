//! Reading .vtp files.

use std::ops::Range;

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use crate::io::ReadFault;
use crate::io::bytes::Bytes;
use crate::io::columns::{Column, Endian, Scalar};
use crate::io::scan::{Scanner, malformed};
use crate::io::vertices::{Triangles, Vertices, columns, integer};
use crate::mesh::Mesh;
use crate::particles::AttributeInfo;

use super::NORMALS;

/// Reads points, their attributes, and polygons, fanned from their first corner.
///
/// The arrays may be appended raw, in either byte order, or text, but those of the points all in one way.
/// Vertices, lines and the data of cells are passed over.
///
/// # Errors
/// [`ReadFault::Truncated`] and [`ReadFault::Malformed`] for damage; [`ReadFault::Unsupported`] for compressed or
/// base64 data, several pieces, triangle strips, and other data sets than PolyData.
pub fn read_mesh(bytes: &[u8]) -> Result<Mesh, ReadFault> {
    let layout = Layout::parse(bytes)?;
    let mut triangles = Triangles::new(layout.points)?;
    let mut start = 0;
    let corners = layout.integers("connectivity")?;
    let ends = layout.integers("offsets")?;
    if ends.len() != layout.polygons {
        let what = format!("{} polygons are announced, {} have an offset", layout.polygons, ends.len());
        return Err(malformed(0, what));
    }
    for (face, &end) in ends.iter().enumerate() {
        let polygon = usize::try_from(end).ok().and_then(|end| corners.get(start..end));
        let polygon = polygon
            .ok_or_else(|| malformed(0, format!("polygon {face} has no corners from {start} to {end}")))?;
        triangles.polygon(face, 0, polygon)?;
        start += polygon.len();
    }
    Ok(layout.vertices()?.into_mesh(bytes, triangles.triangles))
}

/// Which part of the file an array belongs to.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Section {
    PointData,
    Points,
    Polys,
}

/// An array, as the XML has it.
struct Array {
    section: Section,
    name: String,
    scalar: Scalar,
    components: usize,
    data: Data,
}

enum Data {
    /// Where its length stands, from the start of the file.
    Appended(u64),
    /// The text, from the start of the file.
    Text(Range<usize>),
}

/// What the XML says.
struct Layout<'a> {
    bytes: &'a [u8],
    endian: Endian,
    /// Of an appended array's length.
    header: Scalar,
    points: usize,
    polygons: usize,
    normals: Option<String>,
    arrays: Vec<Array>,
}

impl<'a> Layout<'a> {
    fn parse(bytes: &'a [u8]) -> Result<Self, ReadFault> {
        if !bytes.trim_ascii_end().ends_with(b"</VTKFile>") {
            return Err(malformed(bytes.len(), "the file ends without </VTKFile>"));
        }
        let mut xml = Reader::from_reader(bytes);
        let mut layout = Layout {
            bytes,
            endian: Endian::Little,
            header: Scalar::U32,
            points: 0,
            polygons: 0,
            normals: None,
            arrays: Vec::new(),
        };
        let mut pieces = 0;
        let mut section = None;
        let mut seen_root = false;
        loop {
            let at = xml.buffer_position() as usize;
            let event = xml
                .read_event()
                .map_err(|fault| malformed(xml.error_position() as usize, fault.to_string()))?;
            let behind = xml.buffer_position() as usize;
            let (tag, is_empty) = match &event {
                Event::Start(tag) => (tag, false),
                Event::Empty(tag) => (tag, true),
                Event::End(end) => {
                    if section_named(end.name().as_ref()).is_some() {
                        section = None;
                    }
                    continue;
                }
                Event::Eof if layout.arrays.iter().any(|array| matches!(array.data, Data::Appended(_))) => {
                    return Err(malformed(at, "no <AppendedData>"));
                }
                Event::Eof => break,
                _ => continue,
            };
            let tag = Tag { tag, at };
            match (tag.tag.name().as_ref(), section) {
                ("VTKFile", _) => {
                    layout.root(&tag)?;
                    seen_root = true;
                }
                ("Piece", _) => {
                    pieces += 1;
                    layout.piece(&tag)?;
                }
                ("AppendedData", _) => {
                    layout.appended(&tag, behind)?;
                    break;
                }
                ("DataArray", Some(section)) => layout.array(&tag, section, behind)?,
                (name, _) if !is_empty && section_named(name).is_some() => {
                    section = section_named(name);
                    if section == Some(Section::PointData) {
                        layout.normals = tag.value("Normals")?;
                    }
                }
                _ => {}
            }
        }
        match (seen_root, pieces) {
            (false, _) => Err(malformed(0, "no <VTKFile>")),
            (true, 1) => Ok(layout),
            (true, _) => Err(ReadFault::Unsupported(format!("{pieces} pieces; save the mesh as one"))),
        }
    }

    fn root(&mut self, tag: &Tag) -> Result<(), ReadFault> {
        let kind = tag.value("type")?.unwrap_or_default();
        if kind != "PolyData" {
            return Err(ReadFault::Unsupported(format!("a data set of type {kind:?}; a mesh is PolyData")));
        }
        if let Some(compressor) = tag.value("compressor")? {
            return Err(ReadFault::Unsupported(format!(
                "data compressed by {compressor}; save it uncompressed"
            )));
        }
        if tag.value("byte_order")?.as_deref() == Some("BigEndian") {
            self.endian = Endian::Big;
        }
        if tag.value("header_type")?.as_deref() == Some("UInt64") {
            self.header = Scalar::U64;
        }
        Ok(())
    }

    fn piece(&mut self, tag: &Tag) -> Result<(), ReadFault> {
        self.points = tag.number("NumberOfPoints")?.unwrap_or(0);
        self.polygons = tag.number("NumberOfPolys")?.unwrap_or(0);
        match tag.number::<usize>("NumberOfStrips")? {
            None | Some(0) => Ok(()),
            Some(_) => Err(ReadFault::Unsupported("triangle strips; save them as triangles".to_owned())),
        }
    }

    fn array(&mut self, tag: &Tag, section: Section, behind: usize) -> Result<(), ReadFault> {
        let name = tag.value("Name")?.unwrap_or_default();
        let kind = tag.value("type")?.unwrap_or_default();
        let Some(scalar) = scalar_named(&kind) else {
            // Strings and bits are no values of a vertex; whatever else needs this array will miss it.
            return Ok(());
        };
        let components = tag.number("NumberOfComponents")?.unwrap_or(1);
        let data = match tag.value("format")?.as_deref() {
            Some("appended") => {
                let offset = tag.number("offset")?;
                Data::Appended(
                    offset.ok_or_else(|| malformed(tag.at, format!("array {name} has no offset")))?,
                )
            }
            Some("ascii") => {
                let rest = &self.bytes[behind..];
                let length = rest.iter().position(|&byte| byte == b'<').unwrap_or(rest.len());
                Data::Text(behind..behind + length)
            }
            other => {
                let shown = other.unwrap_or_default();
                let what = format!("array {name} has format {shown:?}; save the data as appended, raw");
                return Err(ReadFault::Unsupported(what));
            }
        };
        self.arrays.push(Array { section, name, scalar, components, data });
        Ok(())
    }

    /// Adds where the data start to the offsets so far. The XML ends here for us.
    fn appended(&mut self, tag: &Tag, behind: usize) -> Result<(), ReadFault> {
        let encoding = tag.value("encoding")?.unwrap_or_default();
        if encoding != "raw" {
            return Err(ReadFault::Unsupported(format!("data encoded as {encoding:?}; save them raw")));
        }
        let mut scan = Scanner::new(self.bytes, behind);
        scan.skip_whitespace();
        if scan.rest().first() != Some(&b'_') {
            return Err(malformed(scan.at(), "no underscore before the data"));
        }
        for array in &mut self.arrays {
            if let Data::Appended(offset) = &mut array.data {
                *offset = offset.saturating_add(scan.at() as u64 + 1);
            }
        }
        Ok(())
    }

    /// Where the numbers of an appended array lie.
    fn span(&self, name: &str, length_at: u64) -> Result<Range<usize>, ReadFault> {
        let have = self.bytes.len() as u64;
        let truncated = |needed| ReadFault::Truncated { what: format!("array {name}"), needed, have };
        let start = length_at.saturating_add(self.header.size() as u64);
        if start > have {
            return Err(truncated(start));
        }
        let length = integer(self.header, self.endian, &self.bytes[length_at as usize..start as usize]);
        let length = length.and_then(|length| u64::try_from(length).ok()).unwrap_or(u64::MAX);
        let end = start.saturating_add(length);
        if end > have { Err(truncated(end)) } else { Ok(start as usize..end as usize) }
    }

    /// All numbers of the polygons' array `name`, none if there is no such.
    fn integers(&self, name: &str) -> Result<Vec<i64>, ReadFault> {
        let found = self.arrays.iter().find(|a| a.section == Section::Polys && a.name == name);
        let Some(array) = found else { return Ok(Vec::new()) };
        match &array.data {
            Data::Text(text) => numbers(self.bytes, text),
            Data::Appended(at) => {
                let span = self.span(name, *at)?;
                let whole = self.bytes[span.clone()].chunks_exact(array.scalar.size());
                let numbers: Option<_> =
                    whole.map(|number| integer(array.scalar, self.endian, number)).collect();
                numbers.ok_or_else(|| malformed(span.start, format!("array {name} holds no integers")))
            }
        }
    }

    fn vertices(&self) -> Result<Vertices, ReadFault> {
        if self.points == 0 {
            let nowhere = Column { offset: 0, stride: 0, scalar: Scalar::F32, endian: self.endian };
            let position = [nowhere; 3];
            return Ok(Vertices { decoded: None, count: 0, position, attributes: Vec::new(), normals: None });
        }
        let mut decoded = Vec::new();
        let mut position = None;
        let mut normals = None;
        let mut attributes = Vec::new();
        let is_text = |array: &Array| matches!(array.data, Data::Text(_));
        let of_points = || self.arrays.iter().filter(|array| array.section != Section::Polys);
        let all_text = of_points().any(is_text);
        if all_text && !of_points().all(is_text) {
            return Err(ReadFault::Unsupported(
                "arrays partly in text; save them all as appended, raw".to_owned(),
            ));
        }
        // Many arrays might name the same bytes, and a small file ask for much memory.
        let mut claimed = 0;
        for array in of_points() {
            let columns = self.columns(array, &mut decoded)?;
            claimed += columns.len() * self.points * array.scalar.size();
            if claimed > self.bytes.len() && !all_text {
                return Err(malformed(0, format!("array {} shares its data with others", array.name)));
            }
            if array.section == Section::Points {
                position = <[Column; 3]>::try_from(columns).ok();
                continue;
            }
            if columns.len() == 3 && normals.is_none() && self.is_normals(array) {
                normals = Some(attributes.len());
            }
            attributes.push((AttributeInfo { name: array.name.clone(), components: columns.len() }, columns));
        }
        let position = position.ok_or_else(|| malformed(0, "no array of points of three components"))?;
        Ok(Vertices {
            decoded: all_text.then_some(Bytes::Owned(decoded)),
            count: self.points,
            position,
            attributes,
            normals,
        })
    }

    fn is_normals(&self, array: &Array) -> bool {
        array.name == self.normals.as_deref().unwrap_or(NORMALS)
    }

    /// Columns of an array with a value for every point; text is decoded first.
    fn columns(&self, array: &Array, decoded: &mut Vec<u8>) -> Result<Vec<Column>, ReadFault> {
        let &Array { ref name, scalar, components, .. } = array;
        let (at, count, (offset, scalar, endian)) = match &array.data {
            Data::Text(text) => {
                let numbers: Vec<f64> = numbers(self.bytes, text)?;
                let offset = decoded.len();
                decoded.extend(numbers.iter().copied().flat_map(f64::to_le_bytes));
                (text.start, Some(numbers.len()), (offset, Scalar::F64, Endian::Little))
            }
            Data::Appended(at) => {
                let span = self.span(name, *at)?;
                let is_whole = span.len().is_multiple_of(scalar.size());
                let count = is_whole.then_some(span.len() / scalar.size());
                (span.start, count, (span.start, scalar, self.endian))
            }
        };
        if components == 0 || count.is_none() || count != self.points.checked_mul(components) {
            let what =
                format!("array {name} is not of {components} numbers for each of {} points", self.points);
            return Err(malformed(at, what));
        }
        Ok(columns(offset, components * scalar.size(), components, scalar, endian))
    }
}

/// The numbers of a text.
fn numbers<T: std::str::FromStr>(bytes: &[u8], text: &Range<usize>) -> Result<Vec<T>, ReadFault> {
    let mut scan = Scanner::new(&bytes[..text.end], text.start);
    let mut numbers = Vec::new();
    loop {
        scan.skip_whitespace();
        if scan.rest().is_empty() {
            return Ok(numbers);
        }
        numbers.push(scan.number()?);
    }
}

/// An element and where it starts.
struct Tag<'a> {
    tag: &'a BytesStart<'a>,
    at: usize,
}

impl Tag<'_> {
    fn value(&self, name: &str) -> Result<Option<String>, ReadFault> {
        let fault = |fault: &dyn std::fmt::Display| malformed(self.at, fault.to_string());
        let attribute = self.tag.try_get_attribute(name).map_err(|e| fault(&e))?;
        attribute
            .map(|attribute| {
                let value = attribute.normalized_value(quick_xml::XmlVersion::Implicit1_0);
                value.map(|value| value.into_owned()).map_err(|e| fault(&e))
            })
            .transpose()
    }

    fn number<T: std::str::FromStr>(&self, name: &str) -> Result<Option<T>, ReadFault> {
        let Some(value) = self.value(name)? else { return Ok(None) };
        let parsed = value.trim().parse().map_err(|_| malformed(self.at, format!("{name} is {value:?}")))?;
        Ok(Some(parsed))
    }
}

fn section_named(name: &str) -> Option<Section> {
    match name {
        "PointData" => Some(Section::PointData),
        "Points" => Some(Section::Points),
        "Polys" => Some(Section::Polys),
        _ => None,
    }
}

fn scalar_named(name: &str) -> Option<Scalar> {
    Some(match name {
        "Int8" => Scalar::I8,
        "UInt8" => Scalar::U8,
        "Int16" => Scalar::I16,
        "UInt16" => Scalar::U16,
        "Int32" => Scalar::I32,
        "UInt32" => Scalar::U32,
        "Int64" => Scalar::I64,
        "UInt64" => Scalar::U64,
        "Float32" => Scalar::F32,
        "Float64" => Scalar::F64,
        _ => return None,
    })
}
