//! Reads positions of f16, f32 or f64 from NumPy's .npy files.
//!
//! The array has shape (N, 3), (3, N) or, for several frames, (T, N, 3). It may also be a
//! structured array. Both byte orders are supported, and both memory layouts (C order and Fortran
//! order).
//!
//! The header is a Python dictionary. It is parsed according to the few rules that NumPy's own
//! writer follows, because a general parser of Python literals can take hours for a kilobyte of
//! brackets.

use crate::particles::AttributeInfo;

use super::bytes::{ByteView, Bytes};
use super::columns::{Column, ColumnStore, Endian, ParticleRows, Scalar};
use super::cursor::Cursor;
use super::fields::{
    Arrangement, Axes, ColumnIndex, LocatedQuantity, NamedArray, advice_on_plane, arrange, shown,
    zeros_as_z,
};
use super::{ParticleFile, ReadFault, malformed};

/// Name that the readers give to the positions in an array without a known name.
pub(super) const POSITION: &str = "pos";
/// Description, for messages, of the elements of a structured array.
const STRUCTURE: &str = "of a structure";
/// Maximum number of members of a structure.
const MOST_MEMBERS: usize = 1 << 10;

/// Reads the header. The array is read later. `step` is the number of a frame in an array with
/// several frames.
///
/// # Errors
/// [`ReadFault::Unsupported`] for other shapes or elements, for a missing `step` if there are
/// several frames, and for a `step` that does not exist. [`ReadFault::Malformed`] and
/// [`ReadFault::Truncated`] for a header that is invalid or does not fit the file.
pub fn read_particles(bytes: Bytes, step: Option<u64>) -> Result<ParticleFile, ReadFault> {
    let header = NpyHeader::read(bytes.view())?;
    let fields = header.fields(POSITION);
    let arranged = arrange(&fields)?.ok_or_else(|| header.no_position())?;
    let frame = arranged.frame(step)?;
    let Arrangement { rows, axes, position, attributes, left_out, .. } = arranged;
    for place in &position.places {
        header.expect_position(place.field)?;
    }
    header.expect_elements(bytes.view())?;
    let columns = |found: &LocatedQuantity| -> Vec<Column> {
        let column = |place: &ColumnIndex| {
            header.column(header.start, place.field, axes[place.field], frame, place.component)
        };
        found.places.iter().map(column).collect()
    };
    let attributes = attributes.iter().map(|found| {
        let info = AttributeInfo::new(&found.name, found.places.len());
        (info, columns(found))
    });
    let attributes = attributes.collect();
    let position = columns(&position).try_into().expect("three components");
    let particles: ColumnStore =
        ColumnStore::new(bytes, ParticleRows::All(rows as usize), position, attributes);
    Ok(ParticleFile { left_out, ..ParticleFile::new(particles, "NumPy .npy") })
}

/// The numbers of the frames in an array with several frames. Empty if there is a single frame.
///
/// # Errors
/// The errors of [`read_particles`] about the header.
pub fn steps(bytes: ByteView) -> Result<Vec<u64>, ReadFault> {
    let header = NpyHeader::read(bytes)?;
    let Some(arranged) = arrange(&header.fields(POSITION))? else { return Ok(Vec::new()) };
    header.expect_elements(bytes)?;
    Ok(arranged.steps())
}

/// The contents of an array's header.
pub(super) struct NpyHeader {
    /// The members of an element: a single number, or the numeric members of a structure.
    members: Vec<StructMember>,
    /// Size, in bytes, of an element. 0 for unsupported types, such as objects.
    element_bytes: u64,
    /// The element type in NumPy's notation.
    descr: String,
    pub shape: Vec<u64>,
    fortran: bool,
    /// Byte offset of the first element from the start of the header.
    pub start: usize,
}

/// A member of every element, with one number or an array of numbers.
struct StructMember {
    /// The member's name. Empty if the elements are plain numbers.
    name: String,
    endian: Endian,
    scalar: Scalar,
    /// The sizes of the axes of the member. Empty for a single number.
    shape: Vec<u64>,
    /// Byte offset of the member from the start of the element.
    offset: u64,
}

impl NpyHeader {
    /// Reads the header at the start of `bytes`.
    pub fn read(bytes: ByteView) -> Result<Self, ReadFault> {
        let mut cursor = Cursor::new(bytes, 0, Endian::Little);
        if cursor.take("the magic", 6)? != b"\x93NUMPY" {
            return Err(malformed(0, "not a .npy file: it does not begin with \"\\x93NUMPY\""));
        }
        let version = cursor.take("the version", 2)?[0];
        let length = match version {
            1 => cursor.u16("the header's length")?.into(),
            2 | 3 => cursor.u32("the header's length")?.into(),
            _ => {
                let what =
                    format!("version {version} of .npy is not supported, only versions 1 to 3");
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
        let descr = value("descr")?;
        let (descr, members, element_bytes) = match descr.starts_with('[') {
            true => {
                let (members, bytes) = structure(descr).unwrap_or_default();
                (STRUCTURE.to_owned(), members, bytes)
            }
            false => {
                let name = quoted(descr).map_or(STRUCTURE, |(name, _)| name);
                let element = element(name);
                let member = element.map(|(endian, scalar)| StructMember {
                    name: String::new(),
                    endian,
                    scalar,
                    shape: Vec::new(),
                    offset: 0,
                });
                let bytes = element.map_or(0, |(_, scalar)| scalar.size() as u64);
                (name.to_owned(), member.into_iter().collect(), bytes)
            }
        };
        let fortran = match value("fortran_order")? {
            order if order.starts_with("False") => false,
            order if order.starts_with("True") => true,
            _ => return Err(malformed(at, "'fortran_order' is neither True nor False")),
        };
        let shape = shape(value("shape")?, at)?;
        Ok(Self { members, element_bytes, descr, shape, fortran, start: cursor.at() })
    }

    /// Whether the elements are numbers, or structures with numbers.
    pub fn is_numeric(&self) -> bool {
        !self.members.is_empty()
    }

    /// Whether the elements are structures.
    pub fn is_structured(&self) -> bool {
        self.members.iter().any(|member| !member.name.is_empty())
    }

    /// Whether the elements are pickled Python objects.
    pub fn is_pickled(&self) -> bool {
        self.descr.ends_with('O')
    }

    /// The numeric arrays in this array. If the elements are structures, each numeric member of the
    /// structure is an array. If the elements are numbers, the whole array is returned as `name`.
    pub fn fields(&self, name: &str) -> Vec<NamedArray> {
        let fields = self.members.iter().map(|member| NamedArray {
            name: if member.name.is_empty() { name.to_owned() } else { member.name.clone() },
            shape: self.shape.iter().chain(&member.shape).copied().collect(),
        });
        fields.collect()
    }

    /// Checks that the field with index `field` contains floating-point numbers, and may therefore
    /// contain positions.
    pub fn expect_position(&self, field: usize) -> Result<(), ReadFault> {
        match self.members.get(field).map(|member| member.scalar) {
            Some(Scalar::F16 | Scalar::F32 | Scalar::F64) => Ok(()),
            _ => Err(self.unsupported_elements()),
        }
    }

    /// The error for elements that cannot be positions, with a suggestion.
    fn unsupported_elements(&self) -> ReadFault {
        ReadFault::Unsupported(match self.is_pickled() {
            true => "pickled Python objects are not supported; save an array of numbers with \
                     shape (N, 3)"
                .to_owned(),
            false if self.descr == STRUCTURE => {
                "nested structures and objects are not supported; save an array of numbers with \
                 shape (N, 3)"
                    .to_owned()
            }
            false => format!(
                "the elements are {}; positions must be float16, float32 or float64 \
                 (.astype(np.float32))",
                self.descr
            ),
        })
    }

    /// The error if the array contains no positions, with a suggestion.
    fn no_position(&self) -> ReadFault {
        if !self.is_numeric() {
            return self.unsupported_elements();
        }
        if self.is_structured() {
            let all = self.fields("");
            let fields: Vec<_> = all
                .iter()
                .take(20)
                .map(|field| format!("{} {}", field.name, shown(&field.shape)))
                .collect();
            let fields = fields.join(", ");
            let plane = advice_on_plane(&all, arrange);
            let plane = plane.map_or(String::new(), |advice| format!("; {advice}"));
            return ReadFault::Unsupported(format!(
                "the structured array has no fields x, y and z, or pos; its fields: {fields}{plane}"
            ));
        }
        let shape = shown(&self.shape);
        let remedy = zeros_as_z("a", &self.shape).unwrap_or_else(|| self.remedy().to_owned());
        ReadFault::Unsupported(format!(
            "the array has shape {shape}, but must have (N, 3), (3, N) or, for frames, (T, N, 3); \
             {remedy}"
        ))
    }

    /// Advice on changing the shape of an array that is not a position.
    fn remedy(&self) -> &'static str {
        match self.shape[..] {
            [rows, columns] if columns >= 4 && rows >= columns => {
                "save the columns of x, y and z, such as a[:, :3]"
            }
            [rows, columns] if rows.min(columns) >= 4 => {
                "save the rows of x, y and z, such as a[:3]"
            }
            [_, 3, rows] if rows >= 4 => "exchange the last two axes: a.transpose(0, 2, 1)",
            [_, rows, columns] if columns >= 4 && rows >= columns => {
                "save the columns of x, y and z, such as a[:, :, :3]"
            }
            [numbers] if numbers > 0 && numbers % 3 == 0 => {
                "if each particle's x, y and z are next to each other, use a.reshape(-1, 3)"
            }
            _ => "save an array of that shape",
        }
    }

    /// Number of elements.
    pub fn elements(&self) -> u64 {
        self.shape.iter().fold(1, |product: u64, &size| product.saturating_mul(size))
    }

    /// Total size, in bytes, of all elements.
    pub fn data_bytes(&self) -> u64 {
        self.elements().saturating_mul(self.element_bytes)
    }

    /// Returns an error if the header announces more data than `bytes` contains.
    fn expect_elements(&self, bytes: ByteView) -> Result<(), ReadFault> {
        let mut cursor = Cursor::new(bytes, self.start, Endian::Little);
        cursor.skip("the array", self.elements(), self.element_bytes).map(|_| ())
    }

    /// The column of component `component` of a field in frame `frame`. The first element is at
    /// byte `at`. The caller must have checked that the data is within the file.
    pub fn column(
        &self,
        at: usize,
        field: usize,
        axes: Axes,
        frame: u64,
        component: usize,
    ) -> Column {
        let member = &self.members[field];
        let strides = self.strides(member);
        let sizes: Vec<usize> =
            self.shape.iter().chain(&member.shape).map(|&size| size as usize).collect();
        let (rows, components, frame) = match axes {
            Axes::Particles => (0, 1..sizes.len(), 0),
            Axes::Components => (1, 0..1, 0),
            Axes::Frames => (1, 2..sizes.len(), frame as usize * strides[0]),
        };
        let (mut offset, mut rest) = (at + member.offset as usize + frame, component);
        for axis in components.rev() {
            offset += rest % sizes[axis] * strides[axis];
            rest /= sizes[axis];
        }
        Column { offset, stride: strides[rows], scalar: member.scalar, endian: member.endian }
    }

    /// The column of the numbers of an array with at most one axis, or of an array of shape (1, 1).
    /// The first number is at byte `at`. `None` for other arrays.
    pub fn list(&self, at: usize) -> Option<Column> {
        let is_list = matches!(self.shape[..], [] | [_] | [1, 1]) && !self.is_structured();
        let StructMember { scalar, endian, .. } = *self.members.first().filter(|_| is_list)?;
        Some(Column { offset: at, stride: scalar.size(), scalar, endian })
    }

    /// Distances, in bytes, between neighbouring numbers along each axis.
    fn strides(&self, member: &StructMember) -> Vec<usize> {
        /// The strides of an array without gaps, whose elements have `bytes` bytes.
        fn contiguous(bytes: u64, sizes: &[u64], fortran: bool) -> Vec<usize> {
            let mut strides = vec![0; sizes.len()];
            let mut next = bytes as usize;
            let mut place = |axis: usize| {
                strides[axis] = next;
                next = next.saturating_mul(sizes[axis] as usize);
            };
            match fortran {
                true => (0..sizes.len()).for_each(&mut place),
                false => (0..sizes.len()).rev().for_each(&mut place),
            }
            strides
        }
        let mut strides = contiguous(self.element_bytes, &self.shape, self.fortran);
        strides.extend(contiguous(member.scalar.size() as u64, &member.shape, false));
        strides
    }
}

/// The text after `'key':` in the dictionary `header`, to the end of the header.
fn value_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    ['\'', '"'].iter().find_map(|quote| {
        let (_, rest) = header.split_once(&format!("{quote}{key}{quote}"))?;
        Some(rest.trim_start().strip_prefix(':')?.trim_start())
    })
}

/// Splits `text` into the quoted string at its start, without quotes, and the rest.
fn quoted(text: &str) -> Option<(&str, &str)> {
    let quote = text.chars().next().filter(|quote| matches!(quote, '\'' | '"'))?;
    text[1..].split_once(quote)
}

/// Parses a structure such as `[('x', '<f4'), ('pos', '<f8', (3,))]`. Returns its numeric members
/// and its total size in bytes. `None` for nested structures and for objects.
fn structure(descr: &str) -> Option<(Vec<StructMember>, u64)> {
    let skip = |text: &'_ str, mark: char| -> Option<usize> {
        let rest = text.trim_start().strip_prefix(mark)?.trim_start();
        Some(text.len() - rest.len())
    };
    let (mut members, mut bytes) = (Vec::new(), 0u64);
    let mut rest = &descr[1..];
    for _ in 0..MOST_MEMBERS {
        rest = &rest[skip(rest, '(')?..];
        let (name, after) = quoted(rest)?;
        let (kind, after) = quoted(&after[skip(after, ',')?..])?;
        let after = after.trim_start();
        let (sizes, after) = match after.strip_prefix(')') {
            Some(after) => (Vec::new(), after),
            None => {
                let sizes = &after[skip(after, ',')?..];
                let (_, after) = sizes.split_once(')')?;
                (shape(sizes, 0).ok()?, &after[skip(after, ')')?..])
            }
        };
        let size = item_bytes(kind)?;
        let all = sizes.iter().try_fold(size, |product, &size| product.checked_mul(size))?;
        if let Some((endian, scalar)) = element(kind).filter(|_| !name.is_empty()) {
            let name = name.to_owned();
            members.push(StructMember { name, endian, scalar, shape: sizes, offset: bytes });
        }
        bytes = bytes.checked_add(all)?;
        rest = after.trim_start();
        match rest.strip_prefix(',').unwrap_or(rest).trim_start() {
            end if end.starts_with(']') => return Some((members, bytes)),
            more => rest = more,
        }
    }
    None
}

/// Size, in bytes, of an element type in NumPy's notation, such as `<f4`, `|S5` or `|V8`.
fn item_bytes(kind: &str) -> Option<u64> {
    let kind = kind.trim_start_matches(['<', '>', '|', '=']);
    let (letter, size) = kind.split_at_checked(1)?;
    let size: u64 = size.split('[').next()?.parse().ok()?;
    match letter {
        "U" => size.checked_mul(4),
        "i" | "u" | "f" | "c" | "b" | "S" | "a" | "V" | "m" | "M" => {
            Some(if matches!(letter, "m" | "M") { 8 } else { size })
        }
        _ => None,
    }
}

/// The byte order and the number type of a notation such as `<f4`.
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
        "f2" => Scalar::F16,
        "f4" => Scalar::F32,
        "f8" => Scalar::F64,
        _ => return None,
    };
    let known = matches!(order, "<" | ">") || order == "|" && scalar.size() == 1;
    known.then_some((endian, scalar))
}

/// Parses a shape such as `(N, 3)`. Errors report byte `at`.
fn shape(shape: &str, at: usize) -> Result<Vec<u64>, ReadFault> {
    let inside = shape.strip_prefix('(').and_then(|rest| rest.split_once(')'));
    let (inside, _) = inside.ok_or_else(|| malformed(at, "'shape' is not a tuple"))?;
    let sizes = inside.split(',').map(|size| size.trim().trim_end_matches('L'));
    let number = |size: &str| {
        size.parse().map_err(|_| malformed(at, format!("{size} is not a valid array size")))
    };
    sizes.filter(|size| !size.is_empty()).map(number).collect()
}
