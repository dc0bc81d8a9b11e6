//! Finds the arrays of a legacy .vtk file, in one pass over its sections.

use crate::io::bytes::ByteView;
use crate::io::columns::{Endian, Scalar};
use crate::io::ghosts::is_flag;
use crate::io::names::{is_preferred_time, percent_decoded};
use crate::io::scan::{Lines, Scanner};
use crate::io::vertices::integer;
use crate::io::{ReadFault, malformed};

/// Maximum number of components of an array without tuples, which is the number of components of a
/// tensor. The size of the file does not limit this number, because the array takes no bytes.
const MAX_COMPONENTS_WITHOUT_TUPLES: usize = 9;

/// The sections of a file that the reader uses.
#[derive(Debug)]
pub(super) struct VtkLayout {
    pub ascii: bool,
    pub points: VtkArray,
    /// Arrays of `POINT_DATA`, which have one tuple per point.
    pub attributes: Vec<VtkArray>,
    /// Index, in `attributes`, of the array that `NORMALS` contains.
    pub normals: Option<usize>,
    /// Names of all text arrays, including those of cells and of the whole file.
    pub texts: Vec<String>,
    /// The last `VERTICES` section.
    pub vertices: Option<CellCorners>,
    /// Number of cells in all `LINES` sections.
    pub line_cells: usize,
    /// Whether a `LINES` section, or a `VERTICES` section before the last one, has cells.
    pub has_others: bool,
    pub cells: Vec<VtkCells>,
    /// Types of the cells of an `UNSTRUCTURED_GRID`.
    pub cell_types: Option<VtkArray>,
    /// Arrays of `CELL_DATA` that flag cells as ghosts.
    pub flags: Vec<VtkArray>,
    /// Other arrays of `CELL_DATA`.
    pub cell_data: Vec<VtkArray>,
    /// The array of one number that contains the time.
    pub time: Option<VtkArray>,
}

/// An array of consecutive numbers in the file.
#[derive(Debug, Clone)]
pub(super) struct VtkArray {
    pub name: String,
    /// Position of the first byte in the file.
    pub at: usize,
    /// Position after the last byte.
    pub end: usize,
    pub tuples: usize,
    pub components: usize,
    pub scalar: Scalar,
}

/// Cells, which are lists of point indices.
#[derive(Debug)]
pub(super) struct VtkCells {
    pub kind: CellKind,
    pub corners: CellCorners,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum CellKind {
    Polygons,
    Strips,
    /// Cells whose types are in `cell_types`.
    Typed,
}

#[derive(Debug)]
pub(super) enum CellCorners {
    /// The form before version 5, with a record for each of `cells` cells. A record contains the
    /// number of corners, followed by the corners.
    Counted { cells: usize, stream: VtkArray },
    /// The form since version 5, with an array of offsets and an array of corners. Cell i has the
    /// corners from offset i to offset i + 1.
    Offsets { offsets: VtkArray, connectivity: VtkArray },
}

/// Whether a section of attributes belongs to points or to cells, and the number of these points or
/// cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Owner {
    Points(usize),
    Cells(usize),
}

struct LayoutParser<'a> {
    bytes: ByteView<'a>,
    lines: Lines<'a>,
    /// The position of the current line.
    line_at: usize,
    ascii: bool,
    offsets: bool,
    owner: Option<Owner>,
    /// Number of components of the last array that was read.
    components: usize,
    points: Option<VtkArray>,
    attributes: Vec<VtkArray>,
    normals: Option<usize>,
    texts: Vec<String>,
    vertices: Option<CellCorners>,
    line_cells: usize,
    has_others: bool,
    cells: Vec<VtkCells>,
    cell_types: Option<VtkArray>,
    flags: Vec<VtkArray>,
    cell_data: Vec<VtkArray>,
    time: Option<VtkArray>,
}

/// Whether the header announces text instead of binary arrays.
pub fn is_text(bytes: ByteView) -> bool {
    LayoutParser::start(bytes).is_ok_and(|parser| parser.ascii)
}

impl VtkLayout {
    pub fn parse(bytes: ByteView) -> Result<Self, ReadFault> {
        let mut parser = LayoutParser::start(bytes)?;
        while let Some(line) = parser.next_line()? {
            parser.section(&words(&line))?;
        }
        parser.finish()
    }
}

impl<'a> LayoutParser<'a> {
    fn start(bytes: ByteView<'a>) -> Result<Self, ReadFault> {
        let mut lines = Lines::of_text(bytes)?;
        let first = lines.line()?.unwrap_or_default();
        let version = first.strip_prefix("# vtk DataFile Version ");
        let major =
            version.and_then(|version| version.trim().split('.').next()?.parse::<u32>().ok());
        let major = major.ok_or_else(|| {
            lines.fault(
                0,
                "a legacy .vtk file starts with `# vtk DataFile Version` and a number".into(),
            )
        })?;
        lines.skip_line()?;
        let line_at = lines.at();
        let ascii = match lines.line()?.as_deref().map(str::trim) {
            Some(word) if word.eq_ignore_ascii_case("ASCII") => true,
            Some(word) if word.eq_ignore_ascii_case("BINARY") => false,
            _ => return Err(lines.fault(line_at, "expected ASCII or BINARY".into())),
        };
        Ok(Self {
            bytes,
            lines,
            line_at,
            ascii,
            offsets: major >= 5,
            owner: None,
            components: 0,
            points: None,
            attributes: Vec::new(),
            normals: None,
            texts: Vec::new(),
            vertices: None,
            line_cells: 0,
            has_others: false,
            cells: Vec::new(),
            cell_types: None,
            flags: Vec::new(),
            cell_data: Vec::new(),
            time: None,
        })
    }

    /// Reads the next line that is not blank.
    fn next_line(&mut self) -> Result<Option<String>, ReadFault> {
        self.lines.skip_whitespace()?;
        self.line_at = self.lines.at();
        self.lines.line()
    }

    /// Reads the next line that is not blank, after any `METADATA`. Returns an error if the file
    /// ends before `what`.
    fn line_of(&mut self, what: &str) -> Result<String, ReadFault> {
        loop {
            match self.next_line()? {
                Some(line) if words(&line) == ["METADATA"] => self.metadata()?,
                Some(line) => return Ok(line),
                None => return Err(self.fault(format!("the file ends where {what} should follow"))),
            }
        }
    }

    fn fault(&self, what: String) -> ReadFault {
        if self.ascii {
            self.lines.fault(self.line_at, what)
        } else {
            malformed(self.line_at, what)
        }
    }

    fn section(&mut self, words: &[&str]) -> Result<(), ReadFault> {
        let keyword = words[0].to_ascii_uppercase();
        match (keyword.as_str(), &words[1..]) {
            ("DATASET", [kind])
                if is_keyword(kind, "POLYDATA") || is_keyword(kind, "UNSTRUCTURED_GRID") => {}
            ("DATASET", [kind]) => {
                let what = "is not supported, only POLYDATA and UNSTRUCTURED_GRID";
                return Err(ReadFault::Unsupported(format!("DATASET {kind} {what}")));
            }
            ("POINTS", [count, kind]) => {
                let array = self.numbers("POINTS", self.count(count)?, 3, kind)?;
                if self.points.replace(array).is_some() {
                    return Err(self.fault("there are two sections POINTS".into()));
                }
            }
            ("VERTICES", [count, size]) => {
                let vertices = self.corners(count, size)?;
                let before = self.vertices.replace(vertices);
                self.has_others |= before.is_some_and(|before| before.cells() > 0);
            }
            ("LINES", [count, size]) => {
                let cells = self.corners(count, size)?.cells();
                self.line_cells = self.line_cells.saturating_add(cells);
                self.has_others |= cells > 0;
            }
            ("POLYGONS", [count, size]) => self.cells(CellKind::Polygons, count, size)?,
            ("TRIANGLE_STRIPS", [count, size]) => self.cells(CellKind::Strips, count, size)?,
            ("CELLS", [count, size]) => self.cells(CellKind::Typed, count, size)?,
            ("CELL_TYPES", [count]) => {
                self.cell_types = Some(self.numbers("CELL_TYPES", self.count(count)?, 1, "int")?);
            }
            ("POINT_DATA", [count]) => self.owner = Some(Owner::Points(self.point_data(count)?)),
            ("CELL_DATA", [count]) => self.owner = Some(Owner::Cells(self.count(count)?)),
            ("METADATA", []) => self.metadata()?,
            ("FIELD", [_, count]) => {
                for _ in 0..self.count(count)? {
                    self.field_array()?;
                }
            }
            ("SCALARS", [name, kind, rest @ ..]) if rest.len() <= 1 => {
                let components = rest.first().map_or(Ok(1), |count| self.count(count))?;
                let at = self.line_at;
                let table = self.line_of("LOOKUP_TABLE")?;
                if !table
                    .split_ascii_whitespace()
                    .next()
                    .is_some_and(|word| is_keyword(word, "LOOKUP_TABLE"))
                {
                    return Err(
                        self.fault(format!("SCALARS {name} (byte {at}) has no LOOKUP_TABLE"))
                    );
                }
                self.attribute(name, components, kind)?;
            }
            ("NORMALS", [name, kind]) => {
                self.normals = self.attribute(name, 3, kind)?.or(self.normals);
            }
            ("VECTORS", [name, kind]) => {
                self.attribute(name, 3, kind)?;
            }
            ("TENSORS", [name, kind]) => {
                self.attribute(name, 9, kind)?;
            }
            ("TENSORS6", [name, kind]) => {
                self.attribute(name, 6, kind)?;
            }
            ("TEXTURE_COORDINATES", [name, components, kind]) => {
                self.attribute(name, self.count(components)?, kind)?;
            }
            ("GLOBAL_IDS" | "PEDIGREE_IDS" | "EDGE_FLAGS", [name, kind]) => {
                self.attribute(name, 1, kind)?;
            }
            ("COLOR_SCALARS", [_, components]) => {
                let tuples = self.tuples()?;
                self.array("COLOR_SCALARS", tuples, self.count(components)?, "unsigned_char")?;
            }
            ("LOOKUP_TABLE", [_, count]) => {
                self.array("LOOKUP_TABLE", self.count(count)?, 4, "unsigned_char")?;
            }
            _ => {
                let line: String = words.join(" ").chars().take(60).collect();
                return Err(self.fault(format!("{line:?} is not a section of a legacy .vtk file")));
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<VtkLayout, ReadFault> {
        let end = self.lines.at();
        let points = self.points.ok_or_else(|| malformed(end, "the file ends without POINTS"))?;
        let typed = self.cells.iter().filter(|cells| cells.kind == CellKind::Typed);
        let cells: usize = typed.map(|cells| cells.corners.cells()).sum();
        let types = self.cell_types.as_ref().map_or(0, |types| types.tuples);
        if cells != types {
            return Err(malformed(
                end,
                format!("the file has {cells} CELLS, but {types} CELL_TYPES"),
            ));
        }
        Ok(VtkLayout {
            ascii: self.ascii,
            points,
            attributes: self.attributes,
            normals: self.normals,
            texts: self.texts,
            vertices: self.vertices,
            line_cells: self.line_cells,
            has_others: self.has_others,
            cells: self.cells,
            cell_types: self.cell_types,
            flags: self.flags,
            cell_data: self.cell_data,
            time: self.time,
        })
    }

    fn count(&self, word: &str) -> Result<usize, ReadFault> {
        word.parse().map_err(|_| self.fault(format!("{word:?} is not a count")))
    }

    fn point_data(&self, count: &str) -> Result<usize, ReadFault> {
        let count = self.count(count)?;
        match &self.points {
            Some(points) if points.tuples == count => Ok(count),
            Some(points) => Err(self.fault(format!(
                "POINT_DATA is for {count} points, but POINTS has {}",
                points.tuples
            ))),
            None => Err(self.fault("POINT_DATA must come after POINTS".into())),
        }
    }

    fn tuples(&self) -> Result<usize, ReadFault> {
        match self.owner {
            Some(Owner::Points(count) | Owner::Cells(count)) => Ok(count),
            None => Err(self.fault("an attribute must come after POINT_DATA or CELL_DATA".into())),
        }
    }

    /// Skips an array of the current attribute section, which has one tuple per point or cell.
    /// Returns the array's index if it is an attribute of points.
    fn attribute(
        &mut self,
        name: &str,
        components: usize,
        kind: &str,
    ) -> Result<Option<usize>, ReadFault> {
        let tuples = self.tuples()?;
        let array = self.array(&percent_decoded(name), tuples, components, kind)?;
        Ok(self.add_array(array))
    }

    fn field_array(&mut self) -> Result<(), ReadFault> {
        let line = self.line_of("an array of FIELD")?;
        match *words(&line) {
            ["NULL_ARRAY"] => Ok(()),
            [name, components, tuples, kind] => {
                let (name, tuples) = (percent_decoded(name), self.count(tuples)?);
                match self.owner {
                    Some(Owner::Points(points)) if tuples != points => {
                        Err(self.fault(format!("{name} has {tuples} entries for {points} points")))
                    }
                    _ => {
                        let array = self.array(&name, tuples, self.count(components)?, kind)?;
                        match self.owner {
                            None => self.keep_time(array),
                            Some(_) => {
                                self.add_array(array);
                            }
                        }
                        Ok(())
                    }
                }
            }
            _ => {
                Err(self.fault("expected an array of FIELD: name, components, tuples, type".into()))
            }
        }
    }

    /// Keeps an array that belongs to the whole file, if it contains the time.
    fn keep_time(&mut self, array: Option<VtkArray>) {
        let known = self.time.as_ref().map(|time| &*time.name);
        let is_time =
            |array: &VtkArray| array.values() == 1 && is_preferred_time(&array.name, known);
        if let Some(time) = array.filter(is_time) {
            self.time = Some(time);
        }
    }

    fn add_array(&mut self, array: Option<VtkArray>) -> Option<usize> {
        let array = array?;
        if let Some(Owner::Cells(_)) = self.owner {
            match is_flag(&array.name, array.components, array.scalar) {
                true => self.flags.push(array),
                false => self.cell_data.push(array),
            }
            return None;
        }
        let most = if array.tuples > 0 { usize::MAX } else { MAX_COMPONENTS_WITHOUT_TUPLES };
        let kept =
            matches!(self.owner, Some(Owner::Points(_))) && (1..=most).contains(&array.components);
        kept.then(|| {
            self.attributes.push(array);
            self.attributes.len() - 1
        })
    }

    fn cells(&mut self, kind: CellKind, count: &str, size: &str) -> Result<(), ReadFault> {
        let corners = self.corners(count, size)?;
        self.cells.push(VtkCells { kind, corners });
        Ok(())
    }

    fn corners(&mut self, count: &str, size: &str) -> Result<CellCorners, ReadFault> {
        let (count, size) = (self.count(count)?, self.count(size)?);
        if !self.offsets {
            return Ok(CellCorners::Counted {
                cells: count,
                stream: self.numbers("cells", size, 1, "int")?,
            });
        }
        let offsets = self.cell_array("OFFSETS", count)?;
        let connectivity = self.cell_array("CONNECTIVITY", size)?;
        Ok(CellCorners::Offsets { offsets, connectivity })
    }

    fn cell_array(&mut self, keyword: &str, count: usize) -> Result<VtkArray, ReadFault> {
        let line = self.line_of(keyword)?;
        match *words(&line) {
            [word, kind] if is_keyword(word, keyword) => self.numbers(keyword, count, 1, kind),
            _ => Err(self.fault(format!("expected {keyword} and a type"))),
        }
    }

    /// Skips an array that must contain numbers.
    fn numbers(
        &mut self,
        name: &str,
        tuples: usize,
        components: usize,
        kind: &str,
    ) -> Result<VtkArray, ReadFault> {
        let array = self.array(name, tuples, components, kind)?;
        array.ok_or_else(|| self.fault(format!("{name} cannot have the type {kind}")))
    }

    /// Skips the array that starts here. Returns its position and type if it contains numbers, and
    /// `None` otherwise.
    fn array(
        &mut self,
        name: &str,
        tuples: usize,
        components: usize,
        kind: &str,
    ) -> Result<Option<VtkArray>, ReadFault> {
        self.components = components;
        let values = tuples.saturating_mul(components);
        let scalar = match kind.to_ascii_lowercase().as_str() {
            "bit" if self.ascii => None,
            "bit" => return self.lines.skip(values.div_ceil(8), name).map(|()| None),
            "string" => {
                self.texts.push(name.to_owned());
                return self.strings(values, name).map(|()| None);
            }
            kind => Some(
                scalar_named(kind)
                    .ok_or_else(|| self.fault(format!("{name} has the unknown type {kind:?}")))?,
            ),
        };
        let at = self.lines.at();
        match scalar {
            Some(scalar) if !self.ascii => {
                self.lines.skip(values.saturating_mul(scalar.size()), name)?
            }
            _ => {
                let mut scan = Scanner::releasing(self.bytes.kept()?, at);
                scan.expect_numbers(values, name)?;
                for index in 0..values {
                    scan.skip_whitespace();
                    if scan.word().is_empty() {
                        let what =
                            format!("the file ends where value {index} of {name} should follow");
                        return Err(scan.fault(scan.at(), what));
                    }
                }
                self.lines = Lines::new(self.bytes, scan.at());
            }
        }
        let end = self.lines.at();
        Ok(scalar.map(|scalar| VtkArray {
            name: name.to_owned(),
            at,
            end,
            tuples,
            components,
            scalar,
        }))
    }

    /// Skips strings. In a text file, each string is a line. In a binary file, the length of a
    /// string precedes it. The first two bits of the length say how many bytes the length has.
    fn strings(&mut self, count: usize, name: &str) -> Result<(), ReadFault> {
        for _ in 0..count {
            if self.ascii {
                if !self.lines.skip_line()? {
                    return Err(self.fault(format!("the file ends within the strings of {name}")));
                }
                continue;
            }
            let ahead = self.lines.ahead(size_of::<u64>())?;
            let wide = ahead.first().map_or(1, |first| 8 >> (first >> 6));
            self.lines.skip(wide, name)?;
            let length =
                ahead[..wide].iter().fold(0, |length, &byte| length << 8 | u64::from(byte));
            let length = length & (u64::MAX >> (64 - 8 * wide + 2));
            self.lines.skip(usize::try_from(length).unwrap_or(usize::MAX), name)?;
        }
        Ok(())
    }

    /// Skips `METADATA` up to an empty line. After `COMPONENT_NAMES`, each component has a line
    /// with its name, which may be empty.
    fn metadata(&mut self) -> Result<(), ReadFault> {
        loop {
            match self.lines.line()?.as_deref().map(str::trim) {
                Some("") => return Ok(()),
                Some("COMPONENT_NAMES") => {
                    let mut left = self.components;
                    while left > 0 && self.lines.skip_line()? {
                        left -= 1;
                    }
                }
                Some(_) => {}
                None => return Err(self.fault("METADATA does not end with an empty line".into())),
            }
        }
    }
}

impl VtkArray {
    /// Number of values, in all tuples. The parser has checked it against the file's size, so the
    /// product cannot overflow.
    pub fn values(&self) -> usize {
        self.tuples * self.components
    }
}

impl CellCorners {
    /// The number of cells.
    pub fn cells(&self) -> usize {
        match self {
            Self::Counted { cells, .. } => *cells,
            Self::Offsets { offsets, .. } => offsets.tuples.saturating_sub(1),
        }
    }
}

fn words(line: &str) -> Vec<&str> {
    line.split_ascii_whitespace().collect()
}

fn is_keyword(word: &str, keyword: &str) -> bool {
    word.eq_ignore_ascii_case(keyword)
}

fn scalar_named(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "signed_char" => Scalar::I8,
        "unsigned_char" => Scalar::U8,
        "short" => Scalar::I16,
        "unsigned_short" => Scalar::U16,
        // Identifiers are stored as int in the file, even if VTK uses 64 bits in memory.
        "int" | "vtkidtype" => Scalar::I32,
        "unsigned_int" => Scalar::U32,
        "long" | "vtktypeint64" => Scalar::I64,
        "unsigned_long" | "vtktypeuint64" => Scalar::U64,
        "float" => Scalar::F32,
        "double" => Scalar::F64,
        _ => return None,
    })
}

/// Number of values that are read at once.
pub(super) const AT_ONCE: usize = 1 << 14;

/// Calls `take` with the index and value of each number of an array.
pub(super) fn each_integer(
    bytes: ByteView,
    ascii: bool,
    array: &VtkArray,
    mut take: impl FnMut(usize, i64),
) -> Result<(), ReadFault> {
    let (count, size) = (array.values(), array.scalar.size());
    if ascii {
        let mut scan = Scanner::releasing_to(bytes.kept()?, array.at..array.end);
        for index in 0..count {
            scan.skip_whitespace();
            take(index, scan.number()?);
        }
        return Ok(());
    }
    for first in (0..count).step_by(AT_ONCE) {
        let end = count.min(first + AT_ONCE);
        let piece = bytes.read(array.at + first * size..array.at + end * size)?;
        for (index, number) in (first..).zip(stored(&piece, array)) {
            take(index, number?);
        }
    }
    Ok(())
}

pub(super) type Integers<'a> = Box<dyn Iterator<Item = Result<i64, ReadFault>> + 'a>;

/// The integers of an array, for a file that is in memory.
pub(super) fn integers<'a>(bytes: &'a [u8], ascii: bool, array: &'a VtkArray) -> Integers<'a> {
    let VtkArray { at, scalar, .. } = *array;
    if ascii {
        let mut scan = Scanner::new(bytes, at);
        return Box::new((0..array.values()).map(move |_| {
            scan.skip_whitespace();
            scan.number()
        }));
    }
    Box::new(stored(&bytes[at..at + array.values() * scalar.size()], array))
}

/// The integers in `bytes`, which are part of a binary array.
pub(super) fn stored<'b>(
    bytes: &'b [u8],
    array: &'b VtkArray,
) -> impl Iterator<Item = Result<i64, ReadFault>> + 'b {
    bytes.chunks_exact(array.scalar.size()).map(|stored| {
        let value = integer(array.scalar, Endian::Big, stored);
        value.ok_or_else(|| malformed(array.at, format!("{} are not integers", array.name)))
    })
}
