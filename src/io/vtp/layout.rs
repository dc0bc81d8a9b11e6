//! Parses the XML of .vtp and .vtu files: the arrays, their types, and the positions of their data.

use std::ops::Range;

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use crate::io::bytes::{ByteView, PrivateBytes, Slice};
use crate::io::columns::{Endian, Scalar};
use crate::io::names::is_preferred_time;
use crate::io::scan::mark_length;
use crate::io::{ReadFault, malformed};

/// The part of the file to which an array belongs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Section {
    FieldData,
    PointData,
    CellData,
    Points,
    /// Vertex cells of a PolyData.
    Verts,
    Polys,
    /// Cells of an UnstructuredGrid.
    Cells,
}

/// An array that the XML declares.
pub(super) struct VtpArray {
    pub section: Section,
    pub name: String,
    pub scalar: Scalar,
    pub components: usize,
    pub data: DataLocation,
}

/// The location and the encoding of an array's data in the file.
pub(super) enum DataLocation {
    /// Decimal numbers in this range of the text.
    Text(Range<usize>),
    /// A header of lengths, followed by the numbers, in base64 in this range of the text.
    Base64(Range<usize>),
    /// A header of lengths, followed by the numbers, as raw bytes that start at this byte.
    Raw(u64),
    /// An offset into the appended data, whose position in the file is not known yet.
    Appended(u64),
}

impl VtpArray {
    /// Whether the position of the array's data is not known yet.
    fn has_unresolved_offset(&self) -> bool {
        matches!(self.data, DataLocation::Appended(_))
    }

    /// The position of the array's data, for messages.
    pub fn place(&self) -> usize {
        match &self.data {
            DataLocation::Text(text) | DataLocation::Base64(text) => text.start,
            DataLocation::Raw(at) | DataLocation::Appended(at) => *at as usize,
        }
    }

    /// The error for an array whose number of values does not fit `points` points.
    pub fn wrong_count(&self, points: usize) -> ReadFault {
        let Self { name, components, .. } = self;
        let what =
            format!("array {name} must have {components} numbers for each of {points} points");
        malformed(self.place(), what)
    }
}

/// Number of bytes at the start of a file that are searched for XML. Arrays can be read in place
/// only if all XML before their data fits into these bytes.
pub(super) const HEAD: usize = 1 << 20;
/// Number of bytes after [`HEAD`] that are also read. They contain the rest of a tag that [`HEAD`]
/// cuts off, and the white space after this tag.
const TAG: usize = 4 << 10;
/// Number of bytes that are searched at once, going backwards from the end of a file.
const TAIL: usize = 1 << 10;

/// The contents of a file's XML.
pub(super) struct VtpLayout<'a> {
    pub bytes: ByteView<'a>,
    /// The XML, if the file is not read as a whole.
    head: PrivateBytes,
    pub data_set: DataSet,
    pub endian: Endian,
    /// Number type of the lengths that precede an array's data.
    pub header: Scalar,
    /// Compression of arrays that are not text.
    pub compressor: Option<Compressor>,
    /// The array that contains the time of the file.
    pub time: Option<VtpArray>,
    pub pieces: Vec<VtpPiece>,
}

/// A piece of the data set, with points, their attributes, and cells.
#[derive(Default)]
pub(super) struct VtpPiece {
    pub points: usize,
    /// Number of vertex cells of a PolyData.
    pub vertices: usize,
    pub lines: usize,
    /// Number of cells of an UnstructuredGrid.
    pub cells: usize,
    pub polygons: usize,
    pub strips: usize,
    pub normals: Option<String>,
    /// Name of the array of global identifiers. Points of different pieces with equal identifiers
    /// are the same point.
    pub global_ids: Option<String>,
    pub arrays: Vec<VtpArray>,
    /// Names of text arrays with values for points.
    pub texts: Vec<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DataSet {
    PolyData,
    UnstructuredGrid,
}

/// The compression of the blocks of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Compressor {
    Zlib,
    /// The block format of LZ4.
    Lz4,
    /// The .xz format.
    Lzma,
}

impl VtpPiece {
    /// Number of polygons and strips.
    pub fn faces(&self) -> usize {
        self.polygons.saturating_add(self.strips)
    }

    /// The arrays that have a value for each point.
    pub fn of_points(&self) -> impl Iterator<Item = &VtpArray> {
        let of_points =
            |array: &&VtpArray| matches!(array.section, Section::Points | Section::PointData);
        self.arrays.iter().filter(of_points)
    }

    /// The array called `name` in `section`.
    pub fn array(&self, section: Section, name: &str) -> Option<&VtpArray> {
        self.arrays.iter().find(|array| array.section == section && array.name == name)
    }
}

impl<'a> VtpLayout<'a> {
    pub fn parse(bytes: ByteView<'a>) -> Result<Self, ReadFault> {
        if !ends_as_vtk(bytes)? {
            return Err(malformed(bytes.len(), "the file ends without </VTKFile>"));
        }
        if let ByteView::Kept(all) = bytes {
            return Self::of_xml(bytes, all);
        }
        let head = PrivateBytes::Owned(bytes.read(0..bytes.len().min(HEAD + TAG))?.into_owned());
        let layout = Self::of_xml(bytes, head.slice())?;
        Ok(Self { head, ..layout })
    }

    /// Parses the XML in `text`, which must include the start of the appended data.
    fn of_xml(bytes: ByteView<'a>, text: Slice) -> Result<Self, ReadFault> {
        let mark = mark_length(&text);
        let mut xml = Reader::from_reader(&text[mark..]);
        let mut layout = VtpLayout {
            bytes,
            head: PrivateBytes::Owned(Vec::new()),
            data_set: DataSet::PolyData,
            endian: Endian::Little,
            header: Scalar::U32,
            compressor: None,
            time: None,
            pieces: Vec::new(),
        };
        let mut section = None;
        let mut has_root = false;
        loop {
            let at = mark + xml.buffer_position() as usize;
            let event = xml.read_event().map_err(|fault| {
                malformed(mark + xml.error_position() as usize, fault.to_string())
            })?;
            let tag_end = mark + xml.buffer_position() as usize;
            text.release(at..tag_end);
            let (tag, is_empty) = match &event {
                Event::Start(tag) => (tag, false),
                Event::Empty(tag) => (tag, true),
                Event::End(end) => {
                    if section_named(end.name().as_ref()).is_some() {
                        section = None;
                    }
                    continue;
                }
                Event::Eof
                    if text.len() < bytes.len()
                        || layout.all_arrays().any(|a| a.has_unresolved_offset()) =>
                {
                    return Err(malformed(at, "the file has no <AppendedData>"));
                }
                Event::Eof => break,
                _ => continue,
            };
            let tag = Tag { tag, at };
            match (tag.tag.name().as_ref(), section) {
                ("VTKFile", _) => {
                    layout.root(&tag)?;
                    has_root = true;
                }
                ("Piece", _) => layout.pieces.push(VtpPiece::of(&tag)?),
                ("AppendedData", _) => {
                    layout.appended(&tag, &text, tag_end)?;
                    break;
                }
                ("DataArray", Some(section)) => layout.array(&tag, section, &text, tag_end)?,
                (name, _) if !is_empty && section_named(name).is_some() => {
                    section = section_named(name);
                    if let (Some(Section::PointData), Some(piece)) =
                        (section, layout.pieces.last_mut())
                    {
                        piece.normals = tag.value("Normals")?;
                        piece.global_ids = tag.value("GlobalIds")?;
                    }
                }
                _ => {}
            }
        }
        match (has_root, &*layout.pieces) {
            (false, _) => Err(malformed(0, "the file has no <VTKFile>")),
            (true, []) => Err(malformed(0, "the file has no <Piece>")),
            (true, _) => Ok(layout),
        }
    }

    fn all_arrays(&mut self) -> impl Iterator<Item = &mut VtpArray> {
        let of_pieces = self.pieces.iter_mut().flat_map(|piece| &mut piece.arrays);
        self.time.iter_mut().chain(of_pieces)
    }

    /// The total number of points in all pieces.
    pub fn points(&self) -> usize {
        self.pieces.iter().fold(0, |sum, piece| sum.saturating_add(piece.points))
    }

    /// The total number of polygons and strips in all pieces.
    pub fn faces(&self) -> usize {
        self.pieces.iter().fold(0, |sum, piece| sum.saturating_add(piece.faces()))
    }

    fn root(&mut self, tag: &Tag) -> Result<(), ReadFault> {
        let kind = tag.value("type")?.unwrap_or_default();
        self.data_set = match kind.as_str() {
            "PolyData" => DataSet::PolyData,
            "UnstructuredGrid" => DataSet::UnstructuredGrid,
            _ => {
                let what = "is not supported, only PolyData and UnstructuredGrid";
                return Err(ReadFault::Unsupported(format!("a data set of type {kind:?} {what}")));
            }
        };
        self.compressor = match tag.value("compressor")?.as_deref() {
            None | Some("") => None,
            Some("vtkZLibDataCompressor") => Some(Compressor::Zlib),
            Some("vtkLZ4DataCompressor") => Some(Compressor::Lz4),
            Some("vtkLZMADataCompressor") => Some(Compressor::Lzma),
            Some(other) => {
                let what = format!(
                    "the data is compressed with {other}, which is not supported; save it with \
                     zlib, LZ4 or LZMA, or uncompressed"
                );
                return Err(ReadFault::Unsupported(what));
            }
        };
        if tag.value("byte_order")?.as_deref() == Some("BigEndian") {
            self.endian = Endian::Big;
        }
        if tag.value("header_type")?.as_deref() == Some("UInt64") {
            self.header = Scalar::U64;
        }
        Ok(())
    }

    fn array(
        &mut self,
        tag: &Tag,
        section: Section,
        xml: &[u8],
        tag_end: usize,
    ) -> Result<(), ReadFault> {
        let is_points = section == Section::Points;
        let unnamed = || if is_points { "Points".to_owned() } else { String::new() };
        let name = tag.value("Name")?.unwrap_or_else(unnamed);
        let kind = tag.value("type")?.unwrap_or_default();
        let Some(scalar) = scalar_named(&kind) else {
            if is_points {
                let what = format!("the points have type {kind:?}, which is not numeric");
                return Err(malformed(tag.at, what));
            }
            // Strings and bits are not attributes. If the mesh needs this array, for example as its
            // corners, the reader reports an error later.
            if let (Section::PointData, Some(piece)) = (section, self.pieces.last_mut()) {
                piece.texts.push(name);
            }
            return Ok(());
        };
        let known_time = self.time.as_ref().map(|time| &*time.name);
        let arrays = match (section, self.pieces.last_mut()) {
            (Section::FieldData, _) if !is_preferred_time(&name, known_time) => return Ok(()),
            (Section::FieldData, _) => None,
            (_, Some(piece)) => Some(&mut piece.arrays),
            (_, None) => return Err(malformed(tag.at, format!("array {name} is in no <Piece>"))),
        };
        let default = if is_points { 3 } else { 1 };
        let components = tag.number("NumberOfComponents")?.unwrap_or(default);
        if components == 0 && section == Section::PointData {
            return Ok(());
        }
        // Skip field data with several numbers, because the time is a single number.
        let tuples = tag.value("NumberOfTuples")?;
        let has_several = components != 1 || tuples.is_some_and(|tuples| tuples.trim() != "1");
        if section == Section::FieldData && has_several {
            return Ok(());
        }
        let data = match tag.value("format")?.as_deref() {
            Some("appended") => {
                let offset = tag.number("offset")?;
                DataLocation::Appended(
                    offset
                        .ok_or_else(|| malformed(tag.at, format!("array {name} has no offset")))?,
                )
            }
            // VTK's own reader also assumes text if the format is missing.
            None | Some("ascii") => DataLocation::Text(text(xml, tag_end)),
            Some("binary") => DataLocation::Base64(text(xml, tag_end)),
            Some(other) => {
                return Err(malformed(
                    tag.at,
                    format!("array {name} has the unknown format {other:?}"),
                ));
            }
        };
        let array = VtpArray { section, name, scalar, components, data };
        match arrays {
            Some(arrays) => arrays.push(array),
            None => self.time = Some(array),
        }
        Ok(())
    }

    /// Replaces the offsets of appended arrays by positions in the file. Does not read the rest of
    /// the XML.
    fn appended(&mut self, tag: &Tag, xml: &[u8], tag_end: usize) -> Result<(), ReadFault> {
        let mark =
            tag_end + xml[tag_end..].iter().take_while(|byte| byte.is_ascii_whitespace()).count();
        if xml.get(mark) != Some(&b'_') {
            return Err(malformed(mark, "the data does not begin with an underscore"));
        }
        let data = mark as u64 + 1;
        let encoding = tag.value("encoding")?.unwrap_or_default();
        let text = match encoding.as_str() {
            "raw" => None,
            "base64" => Some(text(xml, data as usize)),
            _ => {
                let what = format!("the data has the unknown encoding {encoding:?}");
                return Err(malformed(tag.at, what));
            }
        };
        for array in self.all_arrays() {
            if let DataLocation::Appended(offset) = array.data {
                let at = data.saturating_add(offset);
                array.data = match &text {
                    None => DataLocation::Raw(at),
                    Some(text) => DataLocation::Base64((at as usize).min(text.end)..text.end),
                };
            }
        }
        Ok(())
    }

    /// Whether an array or the end of the appended data follows at byte `at`.
    pub fn is_end_of_array(&self, at: u64) -> Result<bool, ReadFault> {
        const END: &[u8] = b"</AppendedData";
        let of_pieces = self.pieces.iter().flat_map(|piece| &piece.arrays);
        let mut arrays = self.time.iter().chain(of_pieces);
        if arrays.any(|array| matches!(array.data, DataLocation::Raw(start) if start == at)) {
            return Ok(true);
        }
        let at = at as usize;
        let ahead = self.bytes.read(at..self.bytes.len().min(at + TAG))?;
        Ok(ahead.trim_ascii_start().starts_with(END))
    }

    /// The bytes of the file's text: the whole file, or only its start if the file is not read as a
    /// whole.
    pub fn text(&self) -> Slice<'_> {
        match self.bytes {
            ByteView::File(_) => self.head.slice(),
            ByteView::Kept(all) => all,
        }
    }
}

impl VtpPiece {
    fn of(tag: &Tag) -> Result<Self, ReadFault> {
        let count = |name: &str| Ok::<_, ReadFault>(tag.number(name)?.unwrap_or(0));
        let points = tag.number("NumberOfPoints")?;
        Ok(Self {
            points: points.ok_or_else(|| malformed(tag.at, "a piece has no NumberOfPoints"))?,
            vertices: count("NumberOfVerts")?,
            lines: count("NumberOfLines")?,
            cells: count("NumberOfCells")?,
            polygons: count("NumberOfPolys")?,
            strips: count("NumberOfStrips")?,
            ..Self::default()
        })
    }
}

/// Whether a file ends with the tag that closes VTK's XML.
fn ends_as_vtk(bytes: ByteView) -> Result<bool, ReadFault> {
    const END: &[u8] = b"</VTKFile>";
    let mut end = bytes.len();
    while end > 0 {
        let start = end.saturating_sub(TAIL);
        let blanks = bytes
            .read(start..end)?
            .iter()
            .rev()
            .take_while(|byte| byte.is_ascii_whitespace())
            .count();
        end -= blanks;
        if end > start {
            break;
        }
    }
    Ok(*bytes.read(end.saturating_sub(END.len())..end)? == *END)
}

/// The range from byte `at` to the start of the next tag.
fn text(xml: &[u8], at: usize) -> Range<usize> {
    let rest = &xml[at..];
    at..at + rest.iter().position(|&byte| byte == b'<').unwrap_or(rest.len())
}

/// Calls `take` with each XML element in a file that lists other files, and with the number of
/// elements around it. The XML must be complete.
///
/// # Errors
/// [`ReadFault::Malformed`] for invalid or incomplete XML, and the errors of `take`.
pub(in crate::io) fn each_tag(
    bytes: &[u8],
    mut take: impl FnMut(&Tag<'_>, usize) -> Result<(), ReadFault>,
) -> Result<(), ReadFault> {
    if !bytes.trim_ascii_end().ends_with(b"</VTKFile>") {
        return Err(malformed(bytes.len(), "the file ends without </VTKFile>"));
    }
    let mark = mark_length(bytes);
    let mut xml = Reader::from_reader(&bytes[mark..]);
    let mut depth: usize = 0;
    loop {
        let at = mark + xml.buffer_position() as usize;
        let event = xml
            .read_event()
            .map_err(|fault| malformed(mark + xml.error_position() as usize, fault.to_string()))?;
        match &event {
            Event::Start(tag) => {
                take(&Tag { tag, at }, depth)?;
                depth += 1;
            }
            Event::Empty(tag) => take(&Tag { tag, at }, depth)?,
            Event::End(_) => depth = depth.saturating_sub(1),
            Event::Eof => return Ok(()),
            _ => {}
        }
    }
}

/// An XML element, and its position for messages.
pub(in crate::io) struct Tag<'a> {
    pub tag: &'a BytesStart<'a>,
    pub at: usize,
}

impl Tag<'_> {
    pub fn value(&self, name: &str) -> Result<Option<String>, ReadFault> {
        let fault = |fault: &dyn std::fmt::Display| malformed(self.at, fault.to_string());
        let attribute = self.tag.try_get_attribute(name).map_err(|e| fault(&e))?;
        attribute
            .map(|attribute| {
                let value = attribute.normalized_value(quick_xml::XmlVersion::Implicit1_0);
                value.map(|value| value.into_owned()).map_err(|e| fault(&e))
            })
            .transpose()
    }

    pub fn number<T: std::str::FromStr>(&self, name: &str) -> Result<Option<T>, ReadFault> {
        let Some(value) = self.value(name)? else { return Ok(None) };
        let what = || format!("{name} is not a valid number: {value:?}");
        let parsed = value.trim().parse().map_err(|_| malformed(self.at, what()))?;
        Ok(Some(parsed))
    }
}

fn section_named(name: &str) -> Option<Section> {
    match name {
        "FieldData" => Some(Section::FieldData),
        "PointData" => Some(Section::PointData),
        "CellData" => Some(Section::CellData),
        "Points" => Some(Section::Points),
        "Verts" => Some(Section::Verts),
        "Polys" => Some(Section::Polys),
        "Cells" => Some(Section::Cells),
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
