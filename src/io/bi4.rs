//! Reads the fluid particles of one frame from DualSPHysics' .bi4 (JBinaryData). DualSPHysics calls
//! a frame a part, and may divide a part into several files, which it calls pieces.
//!
//! A file head of 64 bytes is followed by a tree of items. An item contains named values, named
//! arrays and child items. Each item, each list of values and each array is preceded by the size of
//! its definition. The values of the root item describe the case. The root's child item `PART_xxxx`
//! has one array per quantity. The arrays mix fixed, moving, floating and fluid particles, and
//! fluid particles have the highest identifiers.

use std::path::{Path, PathBuf};

use crate::grid::units::positive_length;
use crate::particles::AttributeInfo;

use crate::particles::sieve::Sieve;

use super::bytes::{ByteView, Bytes, Unpacking, open_bytes_within};
use super::columns::{ColumnStore, Endian, ParticleRows, Scalar};
use super::cursor::Cursor;
use super::vertices::columns;
use super::wanted::WantedParticles;
use super::{ParticleFile, Pieces, ReadError, ReadFault, malformed};

const HEAD: usize = 64;
/// Number of particle identifiers per read.
const IDS: usize = 1 << 15;

/// Reads the part that the file at `path` belongs to. `bytes` is the content of this file. A part
/// can have further pieces in the same folder, such as `Part_p01_0000.bi4` next to
/// `Part_p00_0000.bi4`.
///
/// # Errors
/// The errors of [`read_particles`], with the path of the invalid piece, and [`ReadFault::Io`] if a
/// piece is missing.
pub fn open_particles(
    path: &Path,
    bytes: Bytes,
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    let fail = |fault| ReadError::new(path, fault);
    let count = Bi4Tree::read(bytes.view()).map_err(fail)?.case.pieces;
    if count <= 1 {
        return read_particles(bytes).map_err(fail);
    }
    let name = PieceName::of(path).ok_or_else(|| {
        let what = format!(
            "is one of {count} pieces of a frame; the names of the pieces must be like \
             Part_p00_0000.bi4"
        );
        fail(ReadFault::Unsupported(what))
    })?;
    let opened = wanted.pieces.of(count as usize) as u64;
    let share =
        Unpacking { in_memory: unpacking.in_memory / opened.saturating_add(1), ..unpacking };
    let (mut stores, mut first) = (Vec::new(), None);
    for number in 0..count {
        if !wanted.pieces.includes(number as usize) {
            stores.push(Pieces::default());
            continue;
        }
        let path = name.path(number);
        let bytes = open_bytes_within(&path, share)?;
        let piece = Bi4Piece::read(bytes.view()).and_then(|piece| {
            let found = (piece.case.piece, piece.case.pieces);
            let expected = (Some(number), count);
            if found == expected { Ok(piece) } else { Err(misplaced(found, expected)) }
        });
        let piece = piece.map_err(|fault| ReadError::new(&path, fault))?;
        first.get_or_insert((piece.case.spacing, piece.case.time));
        stores.push(piece.store(bytes).into());
    }
    let (spacing, time) = first.unwrap_or_default();
    let particles = Pieces::join(stores)
        .map_err(|(piece, fault)| ReadError::new(name.path(piece as u64), fault))?;
    Ok(ParticleFile {
        spacing,
        time,
        ..ParticleFile::new(particles, "DualSPHysics .bi4 in pieces")
    })
}

/// Whether the file at `path` is named like a .bi4 piece other than the first.
pub fn is_later_piece(path: &Path) -> bool {
    PieceName::of(path).is_some_and(|name| name.number > 0)
}

/// Paths of the pieces that follow the first piece of a part, up to the first file that does not
/// exist. Empty if `path` is not the first piece.
pub(super) fn later_pieces(path: &Path) -> Vec<PathBuf> {
    let first = PieceName::of(path).filter(|name| name.number == 0);
    first.map_or(Vec::new(), |name| {
        (1..).map(|number| name.path(number)).take_while(|p| p.exists()).collect()
    })
}

/// The error for a file that is not the expected piece. Each pair contains the number of the piece
/// and the number of pieces.
fn misplaced(found: (Option<u64>, u64), expected: (Option<u64>, u64)) -> ReadFault {
    let described = |(piece, pieces): (Option<u64>, u64)| {
        format!("piece {} of {pieces}", piece.map_or("?".to_owned(), |piece| piece.to_string()))
    };
    malformed(HEAD, format!("expected {}, found {}", described(expected), described(found)))
}

/// The components of a name such as `Part_p00_0000.bi4`.
struct PieceName<'a> {
    folder: &'a Path,
    before: &'a str,
    number: u64,
    digits: usize,
    after: &'a str,
}

impl<'a> PieceName<'a> {
    fn of(path: &'a Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?;
        name.rmatch_indices("_p").find_map(|(at, mark)| {
            let (before, rest) = name.split_at(at + mark.len());
            let digits = rest.find(|c: char| !c.is_ascii_digit())?;
            let (number, after) = rest.split_at(digits);
            let number = number.parse().ok()?;
            let folder = path.parent().unwrap_or(Path::new(""));
            after.starts_with('_').then_some(Self { folder, before, number, digits, after })
        })
    }

    fn path(&self, number: u64) -> PathBuf {
        let Self { before, digits, after, .. } = self;
        self.folder.join(format!("{before}{number:0digits$}{after}"))
    }
}

/// Reads the tree, and selects the fluid particles. The arrays are read later.
///
/// Every numeric array with one entry per particle becomes an attribute, except the positions.
///
/// # Errors
/// [`ReadFault::Unsupported`] for other DualSPHysics files, and for one piece of a part that has
/// several pieces. [`ReadFault::Malformed`] for an invalid tree, and [`ReadFault::Truncated`] if
/// the file ends within the tree.
pub fn read_particles(bytes: Bytes) -> Result<ParticleFile, ReadFault> {
    let piece = Bi4Piece::read(bytes.view())?;
    let Case { pieces, spacing, time, .. } = piece.case;
    if pieces > 1 {
        let what = format!(
            "is one of {pieces} pieces of a frame, which must be read together; open the file by \
             its path, so that the reader can find the other pieces"
        );
        return Err(ReadFault::Unsupported(what));
    }
    Ok(ParticleFile { spacing, time, ..ParticleFile::new(piece.store(bytes), "DualSPHysics .bi4") })
}

/// The particles of one file.
struct Bi4Piece {
    case: Case,
    /// The arrays that have one entry per particle.
    arrays: Vec<Bi4Array>,
    /// The index in `arrays` of the positions, which have three components.
    position: usize,
    fluid: FluidRows,
    endian: Endian,
}

impl Bi4Piece {
    /// Returns the columns of the fluid particles.
    fn store(self, bytes: Bytes) -> ColumnStore {
        let Self { arrays, position, fluid, endian, .. } = self;
        let columns = |array: &Bi4Array| {
            let (scalar, components) = array.shape;
            let stride = components * scalar.size();
            columns(array.offset + fluid.first * stride, stride, components, scalar, endian)
        };
        let others = arrays.iter().enumerate().filter(|(index, _)| *index != position);
        let attributes = others.map(|(_, array)| {
            let info = AttributeInfo::new(&array.name, array.shape.1);
            (info, columns(array))
        });
        let attributes = attributes.collect();
        let position = columns(&arrays[position]).try_into().expect("three components");
        ColumnStore::new(bytes, fluid.rows, position, attributes)
    }

    fn read(bytes: ByteView) -> Result<Self, ReadFault> {
        let Bi4Tree { case, mut arrays, endian } = Bi4Tree::read(bytes)?;
        let find = |names: [&str; 2], scalars: [Scalar; 2], components: usize| {
            let array = arrays.iter().find(|array| names.contains(&array.name.as_str()));
            let array = array.ok_or_else(|| {
                malformed(HEAD, format!("the file has no array {} or {}", names[0], names[1]))
            })?;
            let (scalar, width) = array.shape;
            if scalars.contains(&scalar) && width == components {
                Ok(array)
            } else {
                Err(malformed(
                    array.offset,
                    format!("the array {} has an unexpected type", array.name),
                ))
            }
        };
        let ids = find(["Idp", "Idpd"], [Scalar::U32, Scalar::U64], 1)?;
        let position = find(["Pos", "Posd"], [Scalar::F32, Scalar::F64], 3)?;
        if ids.count != position.count {
            let what =
                format!("the file has {} positions for {} particles", position.count, ids.count);
            return Err(malformed(position.offset, what));
        }
        let fluid = FluidRows::pick(bytes, ids, case.boundary()?, endian)?;
        let (count, offset, name) = (ids.count, position.offset, position.name.clone());
        arrays
            .retain(|array| array.count == count && (array.name != name || array.offset == offset));
        let position = arrays.iter().position(|array| array.name == name).expect("found above");
        Ok(Self { case, arrays, position, fluid, endian })
    }
}

/// The rows with fluid particles, which are the same in all arrays. Indices in `rows` are relative
/// to row `first`.
struct FluidRows {
    first: usize,
    rows: ParticleRows,
}

impl FluidRows {
    fn pick(
        bytes: ByteView,
        ids: &Bi4Array,
        boundary: u64,
        endian: Endian,
    ) -> Result<Self, ReadFault> {
        let each = |visit: &mut dyn FnMut(usize)| {
            let width = ids.shape.0.size();
            for first in (0..ids.count).step_by(IDS) {
                let rows = first..ids.count.min(first + IDS);
                let piece =
                    bytes.read(ids.offset + rows.start * width..ids.offset + rows.end * width)?;
                let fluid = rows
                    .zip(piece.chunks_exact(width))
                    .filter(|(_, id)| number(id, endian) >= boundary);
                fluid.for_each(|(row, _)| visit(row));
            }
            Ok::<_, ReadFault>(())
        };
        let (mut first, mut last, mut count) = (0, 0, 0);
        each(&mut |row| {
            first = if count == 0 { row } else { first };
            last = row;
            count += 1;
        })?;
        if count == 0 || last - first + 1 == count {
            return Ok(Self { first, rows: ParticleRows::All(count) });
        }
        let mut rows = Sieve::none(ids.count);
        each(&mut |row| Sieve::set(&mut rows, row))?;
        Ok(Self { first: 0, rows: ParticleRows::Selected(Sieve::new(rows)) })
    }
}

/// Decodes an unsigned integer of up to eight bytes.
fn number(bytes: &[u8], endian: Endian) -> u64 {
    let push = |number: u64, &byte: &u8| number << 8 | u64::from(byte);
    match endian {
        Endian::Big => bytes.iter().fold(0, push),
        Endian::Little => bytes.iter().rev().fold(0, push),
    }
}

/// Values from the file: particle counts, number of pieces, piece number, spacing and time.
#[derive(Default)]
struct Case {
    /// Numbers of fixed, moving and floating particles: CaseNfixed, CaseNmoving and CaseNfloat.
    not_fluid: [Option<u64>; 3],
    pieces: u64,
    piece: Option<u64>,
    spacing: Option<f64>,
    time: Option<f64>,
}

impl Case {
    /// The lowest identifier of a fluid particle. It equals the number of particles that are not
    /// fluid.
    fn boundary(&self) -> Result<u64, ReadFault> {
        self.not_fluid.iter().try_fold(0u64, |sum, count| sum.checked_add((*count)?)).ok_or_else(
            || {
                malformed(
                    HEAD,
                    "the counts of fixed, moving and floating particles are missing (CaseNfixed \
                     and others)",
                )
            },
        )
    }

    /// Stores the value called `name` if the name is known.
    fn set_value(&mut self, name: &[u8], kind: Bi4Type, value: &[u8], endian: Endian) {
        let whole =
            matches!(kind.scalar, Some(Scalar::U32 | Scalar::U64)).then(|| number(value, endian));
        match name {
            b"CaseNfixed" => self.not_fluid[0] = whole,
            b"CaseNmoving" => self.not_fluid[1] = whole,
            b"CaseNfloat" => self.not_fluid[2] = whole,
            b"Piece" => self.piece = whole,
            b"Npiece" => self.pieces = whole.unwrap_or(1),
            b"Dp" if kind.scalar == Some(Scalar::F64) => {
                let spacing = f64::from_bits(number(value, endian));
                self.spacing = positive_length("Dp", spacing).ok();
            }
            b"TimeStep" if kind.scalar == Some(Scalar::F64) => {
                self.time =
                    Some(f64::from_bits(number(value, endian))).filter(|time| time.is_finite());
            }
            _ => {}
        }
    }
}

/// An array of the part. The reader has checked that its bytes lie within the file.
struct Bi4Array {
    name: String,
    /// Type of the numbers, and number of components.
    shape: (Scalar, usize),
    count: usize,
    offset: usize,
}

/// The type of a value or of an array's entries.
#[derive(Clone, Copy)]
struct Bi4Type {
    /// The type of the numbers. `None` for texts and booleans.
    scalar: Option<Scalar>,
    components: usize,
    /// Size, in bytes, of a value. `None` if each value is preceded by its length.
    size: Option<u64>,
}

impl Bi4Type {
    fn read(cursor: &mut Cursor) -> Result<Self, ReadFault> {
        let at = cursor.at();
        let code = cursor.u32("a type")?;
        let scalar = match code {
            1 => return Ok(Self { scalar: None, components: 1, size: None }),
            2 => return Ok(Self { scalar: None, components: 1, size: Some(4) }),
            3 => Scalar::I8,
            4 => Scalar::U8,
            5 => Scalar::I16,
            6 => Scalar::U16,
            7 | 20 => Scalar::I32,
            8 | 21 => Scalar::U32,
            9 => Scalar::I64,
            10 => Scalar::U64,
            11 | 22 => Scalar::F32,
            12 | 23 => Scalar::F64,
            _ => return Err(malformed(at, format!("unknown type {code}"))),
        };
        let components = if code >= 20 { 3 } else { 1 };
        Ok(Self {
            scalar: Some(scalar),
            components,
            size: Some((components * scalar.size()) as u64),
        })
    }
}

/// The contents of a file as a flat list: the values of all items, and the arrays of the part.
struct Bi4Tree {
    case: Case,
    arrays: Vec<Bi4Array>,
    endian: Endian,
}

impl Bi4Tree {
    fn read(bytes: ByteView) -> Result<Self, ReadFault> {
        let mut cursor = Cursor::new(bytes, 0, Endian::Little);
        let head = cursor.take("the file head", HEAD as u64)?;
        let code = head[..58].strip_prefix(b"#FileJBD ".as_slice()).map(<[u8]>::trim_ascii_end);
        match code {
            Some(b"JPartDataBi4") => {}
            Some(other) => {
                let what = String::from_utf8_lossy(other);
                let what =
                    format!("a {what} file contains no particles; use files like Part_0000.bi4");
                return Err(ReadFault::Unsupported(what));
            }
            None => {
                return Err(malformed(0, "not a .bi4 file: it does not begin with \"#FileJBD\""));
            }
        }
        let (endian, wide) = match head[60] {
            0 => (Endian::Little, false),
            1 => (Endian::Big, false),
            10 => (Endian::Little, true),
            11 => (Endian::Big, true),
            other => return Err(malformed(60, format!("unknown byte order {other}"))),
        };
        let mut cursor = Cursor::new(bytes, HEAD, endian);
        let mut tree = Self { case: Case::default(), arrays: Vec::new(), endian };
        // An item's children follow it directly, so the loop only needs to count the items that
        // remain.
        let mut remaining: u64 = 1;
        while remaining > 0 {
            remaining = remaining - 1 + tree.item(&mut cursor, wide)?;
        }
        Ok(tree)
    }

    /// Reads one item without its children, and returns the number of children.
    fn item(&mut self, cursor: &mut Cursor, wide: bool) -> Result<u64, ReadFault> {
        cursor.u32("an item's size")?;
        tag(cursor, b"\nITEM\n")?;
        let is_part = text(cursor, "an item's name")?.starts_with(b"PART_");
        cursor.take("an item's flags", 8)?;
        text(cursor, "an item's format")?;
        text(cursor, "an item's format")?;
        let arrays = cursor.u32("the number of arrays")?;
        let items = cursor.u32("the number of items")?;
        if cursor.u32("the size of the values")? > 0 {
            self.values(cursor)?;
        }
        for _ in 0..arrays {
            let array = Bi4Array::read(cursor, wide)?;
            self.arrays.extend(array.filter(|_| is_part));
        }
        Ok(items.into())
    }

    fn values(&mut self, cursor: &mut Cursor) -> Result<(), ReadFault> {
        tag(cursor, b"\nVALUES")?;
        for _ in 0..cursor.u32("the number of values")? {
            let name = text(cursor, "a value's name")?.to_vec();
            let kind = Bi4Type::read(cursor)?;
            let value = match kind.size {
                Some(size) => cursor.take("a value", size)?,
                None => text(cursor, "a text")?,
            };
            self.case.set_value(&name, kind, value, self.endian);
        }
        Ok(())
    }
}

impl Bi4Array {
    /// Reads an array. `None` if its entries are not numbers.
    fn read(cursor: &mut Cursor, wide: bool) -> Result<Option<Self>, ReadFault> {
        cursor.u32("an array's size")?;
        tag(cursor, b"\nARRAY")?;
        let name = String::from_utf8_lossy(text(cursor, "an array's name")?).into_owned();
        cursor.take("an array's flag", 4)?;
        let kind = Bi4Type::read(cursor)?;
        let at = cursor.at();
        let mut size = |what| if wide { cursor.u64(what) } else { cursor.u32(what).map(u64::from) };
        let count = size("an array's count")?;
        let bytes = size("an array's size")?;
        let entry = kind.size.filter(|_| kind.scalar.is_some());
        if entry.is_some_and(|size| count.checked_mul(size) != Some(bytes)) {
            return Err(malformed(
                at,
                format!("the array {name} has {count} entries, but a size of {bytes} bytes"),
            ));
        }
        let offset = cursor.skip(&format!("the array {name}"), bytes, 1)?;
        Ok(kind.scalar.map(|scalar| Self {
            name,
            shape: (scalar, kind.components),
            count: count as usize,
            offset,
        }))
    }
}

/// Reads bytes that are preceded by their length.
fn text<'c>(cursor: &'c mut Cursor, what: &str) -> Result<&'c [u8], ReadFault> {
    let length = cursor.u32(what)?;
    cursor.take(what, length.into())
}

fn tag(cursor: &mut Cursor, tag: &[u8]) -> Result<(), ReadFault> {
    let at = cursor.at();
    let found = text(cursor, "a tag")?;
    if found != tag {
        let [found, tag] = [found, tag].map(String::from_utf8_lossy);
        return Err(malformed(at, format!("expected {tag:?}, found {found:?}")));
    }
    Ok(())
}
