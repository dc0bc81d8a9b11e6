//! Columns of numbers from data sets with one row per particle. The columns are read in place if
//! all data sets are contiguous and uncompressed. Otherwise, they are decoded.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;

use bytemuck::NoUninit;
use hdf5_reader::error::Result as Parsed;
use hdf5_reader::group::Group;
use hdf5_reader::{ByteOrder, Dataset, Datatype, H5Type, SliceInfo, SliceInfoElem};

use crate::io::bytes::{Bytes, UnpackBuffer};
use crate::io::columns::{Column, ColumnStore, Endian, ParticleRows, Scalar};
use crate::io::encode::in_order;
use crate::io::fields::{MOST_COMPONENTS, other_shape};
use crate::io::vertices::{columns, integer};
use crate::io::wanted::WantedAttributes;
use crate::io::{ParticleFile, ReadFault, UnreadPart, malformed};
use crate::particles::AttributeInfo;
use crate::particles::condition::Where;
use crate::particles::sieve::Sieve;

use super::file::{H5File, convert_error};
use super::groups::last_name;

/// Maximum size, in bytes, of a window of rows (see [`RowWindows`]), unless a chunk is larger.
const WINDOW: u64 = 1 << 20;
/// Names, in lower case, of types of particles that are read by default. The first name comes from
/// snapshots of SWIFT and GADGET, in which this type is gas.
const FLUIDS: [&str; 2] = ["parttype0", "fluid"];
/// Name, in lower case, of the type that is read by default if no other type can be a liquid.
const GAS: &str = "gas";
/// Names, in lower case, of types of particles that are not liquids: walls, and components of a
/// galaxy other than gas.
const NON_LIQUIDS: [&str; 21] = [
    "boundary",
    "boundaries",
    "wall",
    "walls",
    "solid",
    "solids",
    "dm",
    "dark",
    "darkmatter",
    "dark_matter",
    "halo",
    "star",
    "stars",
    "bh",
    "blackhole",
    "blackholes",
    "black_hole",
    "black_holes",
    "sink",
    "sinks",
    "dust",
];
/// Maximum number of particle types that an error lists.
const LISTED: usize = 20;

const NATIVE: Endian = if cfg!(target_endian = "big") { Endian::Big } else { Endian::Little };

/// An array of numbers with one row per particle: a data set, a range of its rows, or a part of
/// each row.
pub(super) struct H5Array {
    pub set: Arc<Dataset>,
    pub name: String,
    pub scalar: Scalar,
    endian: Endian,
    pub components: usize,
    /// Index of the array's first row within the data set.
    pub first: u64,
    /// Number of rows in the array.
    pub rows: u64,
    part: RowPart,
}

/// The numbers of a data set that form a row of an array.
#[derive(Clone, Copy)]
pub(super) enum RowPart {
    /// All numbers at one index of the first axis.
    Row,
    /// All numbers at one index of the second axis. The first axis counts frames, and only the
    /// frame with the given index is read.
    Frame(u64),
    /// One number from each index of the first axis. The second axis counts particles.
    Columns,
    /// The numbers that start at byte `offset` of each row. A row has `stride` bytes.
    Member { offset: usize, stride: usize },
}

impl H5Array {
    /// All rows of a data set. `None` if it does not contain numbers, or if a row has too many
    /// numbers for an attribute.
    pub fn new(set: Dataset) -> Option<Self> {
        Self::of_any_width(set).filter(|array| !array.is_wide())
    }

    /// All rows of a data set, which may have too many numbers per row for an attribute.
    fn of_any_width(set: Dataset) -> Option<Self> {
        let name = set.name().rsplit('/').next().unwrap_or_default().to_owned();
        let (&rows, axes) = set.shape().split_first()?;
        let components = axes.iter().try_fold(1u64, |product, &size| product.checked_mul(size))?;
        let components = usize::try_from(components).ok().filter(|components| *components > 0)?;
        let number = scalar(set.dtype())?;
        Some(Self::of(Arc::new(set), name, number, rows, components, RowPart::Row))
    }

    /// Whether rows have too many numbers for an attribute.
    fn is_wide(&self) -> bool {
        self.components as u64 > MOST_COMPONENTS
    }

    /// An array of `rows` rows with `components` numbers each. `part` determines which numbers of
    /// the data set form a row.
    pub fn of(
        set: Arc<Dataset>,
        name: String,
        (scalar, endian): (Scalar, Endian),
        rows: u64,
        components: usize,
        part: RowPart,
    ) -> Self {
        Self { set, name, scalar, endian, components, first: 0, rows, part }
    }

    /// All arrays of a group, in file order. [`H5Table`] leaves out arrays whose rows have too many
    /// numbers for an attribute.
    pub fn all_of(group: &Group) -> Result<Vec<Self>, ReadFault> {
        Ok(convert_error(group.datasets())?.into_iter().filter_map(Self::of_any_width).collect())
    }

    /// All arrays of a group, sorted by name.
    pub fn by_name(group: &Group) -> Result<Vec<Self>, ReadFault> {
        let mut arrays = Self::all_of(group)?;
        arrays.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(arrays)
    }

    /// The array `name` of a group. Returns an error if it does not exist, contains no numbers, or
    /// has too many numbers per row for an attribute.
    pub fn named(group: &Group, name: &str) -> Result<Self, ReadFault> {
        let set = convert_error(group.dataset(name))?;
        Self::new(set)
            .ok_or_else(|| malformed(0, format!("{name} does not consist of rows of numbers")))
    }

    /// Restricts the array to `rows` rows, starting at row `first`.
    pub fn part(self, first: u64, rows: u64) -> Result<Self, ReadFault> {
        if first.checked_add(rows).is_none_or(|end| end > self.rows) {
            let Self { name, rows: all, .. } = &self;
            return Err(malformed(
                0,
                format!("{name} has {all} rows, expected {rows} rows from row {first} on"),
            ));
        }
        Ok(Self { first: self.first + first, rows, ..self })
    }

    /// Number of bytes per row.
    fn stride(&self) -> usize {
        match self.part {
            RowPart::Member { stride, .. } => stride,
            _ => self.components * self.scalar.size(),
        }
    }

    /// Returns an error if `before` decoded bytes and the bytes of this array together exceed
    /// `limit`.
    fn check(&self, before: u64, limit: u64) -> Result<(), ReadFault> {
        let end =
            self.rows.checked_mul(self.stride() as u64).and_then(|bytes| bytes.checked_add(before));
        if end.is_none_or(|end| end > limit) {
            let Self { rows, name, .. } = self;
            let what = format!("{rows} rows of {name} are too many for the size of this file");
            return Err(ReadFault::Compression(what));
        }
        Ok(())
    }

    /// Decodes the rows, and appends them to `decoded`.
    fn decode(&self, decoded: &mut UnpackBuffer, file: &H5File) -> Result<(), ReadFault> {
        self.check(decoded.len(), file.limit)?;
        let windows = self.windows();
        // Components that are stored separately are decoded one after another.
        let passes = if let RowPart::Columns = self.part { self.components } else { 1 };
        let count = windows.count * passes;
        let window =
            |index: usize| (windows.rows(index % windows.count, self.rows), index / windows.count);
        // Number of bytes in memory while `in_order` decodes one batch of windows and stores the
        // previous batch. A batch has two windows per thread.
        let batch_bytes = 4
            * rayon::current_num_threads() as u64
            * windows.size.saturating_mul(self.stride() as u64);
        let mut append = |bytes: &[u8]| decoded.push(bytes).map_err(io::Error::other);
        let read = if batch_bytes <= file.unpacking.in_memory.max(WINDOW) {
            let make = |index: usize, out: &mut Vec<u8>| {
                let (rows, component) = window(index);
                self.bytes(rows, component, out).map_err(io::Error::other)
            };
            in_order(count, make, append)
        } else {
            let mut bytes = Vec::new();
            (0..count).try_for_each(|index| {
                bytes.clear();
                let (rows, component) = window(index);
                self.bytes(rows, component, &mut bytes).map_err(io::Error::other)?;
                append(&bytes)
            })
        };
        read.map_err(fault_of)
    }

    /// The columns of the array in the decoded data, where row 0 starts at byte `start`.
    fn decoded_columns(&self, start: usize) -> Vec<Column> {
        let endian = if let RowPart::Member { .. } = self.part { self.endian } else { NATIVE };
        self.columns(start, self.rows, endian)
    }

    /// The columns of the array in the file. `None` if they cannot be read in place.
    fn in_place(&self, file: &H5File) -> Option<Vec<Column>> {
        let stride = self.stride() as u64;
        let all = *self.set.shape().first()?;
        let rows = match self.part {
            RowPart::Frame(_) => all.checked_mul(self.rows)?,
            RowPart::Columns => self.rows,
            RowPart::Row | RowPart::Member { .. } => all,
        };
        let first = match self.part {
            RowPart::Frame(frame) => frame.checked_mul(self.rows)?.checked_mul(stride)?,
            _ => self.first.checked_mul(stride)?,
        };
        let start =
            file.contiguous_offset(&self.set, rows.checked_mul(stride)?)?.checked_add(first)?;
        Some(self.columns(usize::try_from(start).ok()?, self.rows, self.endian))
    }

    fn columns(&self, start: usize, rows: u64, endian: Endian) -> Vec<Column> {
        let Self { components, scalar, part, .. } = *self;
        match part {
            RowPart::Row | RowPart::Frame(_) => {
                columns(start, self.stride(), components, scalar, endian)
            }
            RowPart::Member { offset, stride } => {
                columns(start + offset, stride, components, scalar, endian)
            }
            RowPart::Columns => (0..components)
                .map(|component| Column {
                    offset: start + component * rows as usize * scalar.size(),
                    stride: scalar.size(),
                    scalar,
                    endian,
                })
                .collect(),
        }
    }

    /// Divides the rows into windows that consist of complete chunks.
    pub fn windows(&self) -> RowWindows {
        let axis = usize::from(matches!(self.part, RowPart::Frame(_) | RowPart::Columns));
        let chunk =
            self.set.chunks().and_then(|chunks| chunks.get(axis).copied()).unwrap_or(1).max(1);
        let chunk = u64::from(chunk).min(self.rows.max(1));
        let fit = WINDOW / (chunk * self.stride() as u64).max(1);
        let size = chunk * fit.max(1);
        // The first window may be shorter, so that it ends where a chunk ends.
        let lead = (size - self.first % size).min(self.rows);
        let count = usize::from(lead > 0) + (self.rows - lead).div_ceil(size) as usize;
        RowWindows { lead, size, count }
    }

    /// Appends the bytes of a range of rows. Numbers are converted to the machine's byte order, and
    /// compound rows are copied unchanged. `component` selects a component if components are stored
    /// separately.
    fn bytes(&self, rows: [u64; 2], component: usize, out: &mut Vec<u8>) -> Result<(), ReadFault> {
        fn put<T: H5Type + NoUninit>(
            array: &H5Array,
            rows: [u64; 2],
            component: usize,
            out: &mut Vec<u8>,
        ) -> Result<(), ReadFault> {
            let values = array.values::<T>(rows, component)?;
            out.extend_from_slice(bytemuck::cast_slice(&values));
            Ok(())
        }
        if let RowPart::Member { stride, .. } = self.part {
            let before = out.len();
            let read =
                convert_error(self.set.read_slice::<RawElement>(&self.selection(rows, component)))?;
            read.iter().for_each(|bytes| out.extend_from_slice(&bytes.0));
            if out.len() - before != (rows[1] - rows[0]) as usize * stride {
                let what = format!("{} does not consist of rows of {stride} bytes", self.name);
                return Err(malformed(0, what));
            }
            return Ok(());
        }
        match self.scalar {
            Scalar::I8 => put::<i8>(self, rows, component, out),
            Scalar::U8 => put::<u8>(self, rows, component, out),
            Scalar::I16 => put::<i16>(self, rows, component, out),
            Scalar::U16 => put::<u16>(self, rows, component, out),
            Scalar::I32 => put::<i32>(self, rows, component, out),
            Scalar::U32 => put::<u32>(self, rows, component, out),
            Scalar::I64 => put::<i64>(self, rows, component, out),
            Scalar::U64 => put::<u64>(self, rows, component, out),
            // [`scalar`] rejects half floats, so no array has this type.
            Scalar::F16 => Err(malformed(
                0,
                format!("{} has 16-bit floats, which are not supported", self.name),
            )),
            Scalar::F32 => put::<f32>(self, rows, component, out),
            Scalar::F64 => put::<f64>(self, rows, component, out),
        }
    }

    /// The numbers of a range of rows as f64.
    pub fn doubles(&self, rows: [u64; 2]) -> Result<Vec<f64>, ReadFault> {
        Ok(match self.scalar {
            Scalar::I8 => self.values::<i8>(rows, 0)?.into_iter().map(f64::from).collect(),
            Scalar::U8 => self.values::<u8>(rows, 0)?.into_iter().map(f64::from).collect(),
            Scalar::I16 => self.values::<i16>(rows, 0)?.into_iter().map(f64::from).collect(),
            Scalar::U16 => self.values::<u16>(rows, 0)?.into_iter().map(f64::from).collect(),
            Scalar::I32 => self.values::<i32>(rows, 0)?.into_iter().map(f64::from).collect(),
            Scalar::U32 => self.values::<u32>(rows, 0)?.into_iter().map(f64::from).collect(),
            Scalar::I64 => {
                self.values::<i64>(rows, 0)?.into_iter().map(|value| value as f64).collect()
            }
            Scalar::U64 => {
                self.values::<u64>(rows, 0)?.into_iter().map(|value| value as f64).collect()
            }
            Scalar::F16 => {
                return Err(malformed(
                    0,
                    format!("{} has 16-bit floats, which are not supported", self.name),
                ));
            }
            Scalar::F32 => self.values::<f32>(rows, 0)?.into_iter().map(f64::from).collect(),
            Scalar::F64 => self.values::<f64>(rows, 0)?,
        })
    }

    /// Returns an error if the array is larger than the limit for the file's data.
    pub fn check_small(&self, file: &H5File) -> Result<(), ReadFault> {
        self.check(0, file.limit)
    }

    /// All numbers as integers. The array must be small or belong to a mesh, because all numbers
    /// are kept in memory.
    pub fn integers(&self, file: &H5File) -> Result<Vec<i64>, ReadFault> {
        self.check(0, file.limit)?;
        self.some_integers([0, self.rows])
    }

    /// The numbers of a range of rows as integers.
    pub fn some_integers(&self, rows: [u64; 2]) -> Result<Vec<i64>, ReadFault> {
        let mut bytes = Vec::new();
        self.bytes(rows, 0, &mut bytes)?;
        let numbers =
            bytes.chunks_exact(self.scalar.size()).map(|bytes| integer(self.scalar, NATIVE, bytes));
        let no_integers = || malformed(0, format!("{} does not contain integers", self.name));
        numbers.collect::<Option<_>>().ok_or_else(no_integers)
    }

    /// The part of the data set that contains a range of rows.
    fn selection(&self, [start, end]: [u64; 2], component: usize) -> SliceInfo {
        let slice = |start, end| SliceInfoElem::Slice { start, end, step: 1 };
        let rows = slice(self.first + start, self.first + end);
        let one = |index: u64| slice(index, index.saturating_add(1));
        let mut selections = match self.part {
            RowPart::Row | RowPart::Member { .. } => vec![rows],
            RowPart::Frame(frame) => vec![one(frame), rows],
            RowPart::Columns => vec![one(component as u64), rows],
        };
        selections.resize(self.set.ndim(), slice(0, u64::MAX));
        SliceInfo { selections }
    }

    fn values<T: H5Type>(&self, rows: [u64; 2], component: usize) -> Result<Vec<T>, ReadFault> {
        let values = convert_error(self.set.read_slice::<T>(&self.selection(rows, component)))?;
        let values: Vec<T> = values.iter().cloned().collect();
        let components = if let RowPart::Columns = self.part { 1 } else { self.components };
        let expected = (rows[1] - rows[0]) as usize * components;
        if values.len() != expected {
            let what = format!("{} has {} values, expected {expected}", self.name, values.len());
            return Err(malformed(0, what));
        }
        Ok(values)
    }
}

/// Bytes of elements of any type, as the file stores them. The first element of a range holds the
/// bytes of all elements of the range, to avoid an allocation per element.
#[derive(Clone)]
struct RawElement(Vec<u8>);

impl H5Type for RawElement {
    fn hdf5_type() -> Datatype {
        Datatype::Opaque { size: 1, tag: String::new() }
    }

    fn from_bytes(bytes: &[u8], _: &Datatype) -> Parsed<Self> {
        Ok(Self(bytes.to_vec()))
    }

    fn element_size(_: &Datatype) -> usize {
        1
    }

    fn decode_vec(raw: &[u8], _: &Datatype, count: usize) -> Option<Parsed<Vec<Self>>> {
        let mut all = vec![Self(Vec::new()); count];
        all.first_mut()?.0 = raw.to_vec();
        Some(Ok(all))
    }
}

/// The division of the rows of a data set into windows, which are ranges of rows that are read at
/// once.
pub(super) struct RowWindows {
    /// Number of rows in the first window.
    lead: u64,
    /// Number of rows in each further window. The last window may have fewer.
    size: u64,
    pub count: usize,
}

impl RowWindows {
    /// The first row of window number `index`, and the row after its last row. The array has `all`
    /// rows.
    pub fn rows(&self, index: usize, all: u64) -> [u64; 2] {
        let end = |index: u64| (self.lead + self.size * index).min(all);
        match index as u64 {
            0 => [0, end(0)],
            index => [end(index - 1), end(index)],
        }
    }

    /// The number of the window that contains a row.
    pub fn containing(&self, row: u64) -> usize {
        row.checked_sub(self.lead).map_or(0, |beyond| 1 + (beyond / self.size) as usize)
    }

    /// Divides `rows` rows of `stride` bytes each into windows, without regard to chunks.
    pub fn of(rows: u64, stride: u64) -> Self {
        let size = (WINDOW / stride.max(1)).max(1);
        Self { lead: size.min(rows), size, count: rows.div_ceil(size) as usize }
    }
}

/// Converts an I/O error into a fault. A [`ReadFault`] inside the error is returned unchanged.
pub(super) fn fault_of(error: io::Error) -> ReadFault {
    match error.downcast::<ReadFault>() {
        Ok(fault) => fault,
        Err(error) => ReadFault::Io(error),
    }
}

/// The number type and byte order of a data type. `None` if the type is not a supported number.
pub(super) fn scalar(kind: &Datatype) -> Option<(Scalar, Endian)> {
    let (scalar, order) = match kind {
        Datatype::FixedPoint { size, signed, byte_order } => {
            let scalar = match (size, signed) {
                (1, true) => Scalar::I8,
                (1, false) => Scalar::U8,
                (2, true) => Scalar::I16,
                (2, false) => Scalar::U16,
                (4, true) => Scalar::I32,
                (4, false) => Scalar::U32,
                (8, true) => Scalar::I64,
                (8, false) => Scalar::U64,
                _ => return None,
            };
            (scalar, byte_order)
        }
        Datatype::FloatingPoint { size: 4, byte_order } => (Scalar::F32, byte_order),
        Datatype::FloatingPoint { size: 8, byte_order } => (Scalar::F64, byte_order),
        _ => return None,
    };
    let endian = match order {
        ByteOrder::BigEndian => Endian::Big,
        ByteOrder::LittleEndian => Endian::Little,
    };
    Some((scalar, endian))
}

/// A column: the index of an array, and the index of a component in this array.
pub(super) type Place = (usize, usize);

/// Columns from several arrays with the same number of rows.
pub(super) struct H5Table {
    pub arrays: Vec<H5Array>,
    pub position: [Place; 3],
    pub attributes: Vec<(AttributeInfo, Vec<Place>)>,
    /// Arrays with too many numbers per row for an attribute, or with another number of rows.
    pub left_out: Vec<UnreadPart>,
    /// The rows that contain particles. `None` if all rows do.
    pub present: Option<Sieve>,
}

impl H5Table {
    /// Makes a table from arrays with the same number of rows. The array `position` contains the
    /// positions, and all others are attributes.
    ///
    /// Returns `None` if there is no array `position` with three components.
    pub fn of_arrays(arrays: Vec<H5Array>, position: &str) -> Option<Self> {
        let is_position = |array: &H5Array| array.name == position && array.components == 3;
        let found = arrays.iter().position(is_position)?;
        let position = [0, 1, 2].map(|component| (found, component));
        Some(Self::with_others(arrays, position, Vec::new()))
    }

    /// Makes a table from the given columns. Every other array with the same number of rows also
    /// becomes an attribute, unless it has too many numbers per row.
    pub fn with_others(
        arrays: Vec<H5Array>,
        position: [Place; 3],
        mut attributes: Vec<(AttributeInfo, Vec<Place>)>,
    ) -> Self {
        let rows = arrays[position[0].0].rows;
        let mut used = vec![false; arrays.len()];
        let places = attributes.iter().flat_map(|(_, places)| places);
        position.iter().chain(places).for_each(|&(array, _)| used[array] = true);
        let mut left_out = Vec::new();
        for (index, array) in arrays.iter().enumerate() {
            let H5Array { name, components, .. } = array;
            if used[index] {
                continue;
            }
            if array.rows != rows {
                left_out.extend(other_shape(name, array.set.shape(), rows, None));
            } else if array.is_wide() {
                let numbers = *components as u64;
                left_out.push(UnreadPart::WideArray { name: name.clone(), numbers });
            } else {
                let places = (0..*components).map(|component| (index, component)).collect();
                attributes.push((AttributeInfo::new(name, *components), places));
            }
        }
        Self { arrays, position, attributes, left_out, present: None }
    }

    /// Number of rows in the table.
    pub fn rows(&self) -> u64 {
        self.arrays[self.position[0].0].rows
    }

    /// Reads the particles with the wanted attributes. The columns are read in place if this is
    /// possible for every used array. Otherwise, all used arrays are decoded.
    pub fn read(
        self,
        file: H5File,
        format: &'static str,
        wanted: WantedAttributes,
    ) -> Result<ParticleFile, ReadFault> {
        let rows = usize::try_from(self.rows())
            .map_err(|_| malformed(0, "more rows than can be addressed"))?;
        let Self { arrays, position, attributes, left_out, present } = self;
        let infos: Vec<AttributeInfo> = attributes.iter().map(|(info, _)| info.clone()).collect();
        let mut reads = wanted.among(&infos).into_iter();
        let (attributes, unread): (Vec<_>, Vec<_>) =
            attributes.into_iter().partition(|_| reads.next().unwrap_or(true));
        let unread = unread.into_iter().map(|(info, _)| info).collect();
        let mut used = vec![false; arrays.len()];
        for &(array, _) in position.iter().chain(attributes.iter().flat_map(|(_, places)| places)) {
            used[array] = true;
        }
        let wanted = || arrays.iter().zip(&used).filter(|(_, used)| **used).map(|(array, _)| array);
        let in_file = rows == 0 || wanted().all(|array| array.in_place(&file).is_some());
        let mut decoded = UnpackBuffer::new(file.unpacking);
        // Maps the address of each data set to the start of its decoded rows. All arrays that are
        // members of the same data set share these rows.
        let mut members = BTreeMap::new();
        let mut found: Vec<Vec<Column>> = Vec::new();
        for (array, used) in arrays.iter().zip(used) {
            // An unused array needs no columns. It may have any number of components.
            if !used {
                found.push(Vec::new());
                continue;
            }
            found.push(match array.in_place(&file).filter(|_| in_file) {
                Some(columns) => columns,
                None if rows == 0 => array.decoded_columns(0),
                None => {
                    let before = match array.part {
                        RowPart::Member { .. } => members.get(&array.set.address()).copied(),
                        _ => None,
                    };
                    let start = before.unwrap_or(decoded.len() as usize);
                    if before.is_none() {
                        array.decode(&mut decoded, &file)?;
                        members.insert(array.set.address(), start);
                    }
                    array.decoded_columns(start)
                }
            });
        }
        let column = |&(array, component): &Place| found[array][component];
        let position = [0, 1, 2].map(|axis| column(&position[axis]));
        let attributes = attributes
            .iter()
            .map(|(info, places)| (info.clone(), places.iter().map(column).collect()));
        let attributes = attributes.collect();
        drop(arrays);
        file.check()?;
        let bytes = if in_file { file.into_bytes() } else { Bytes::Kept(decoded.finish()?) };
        let rows = present.map_or(ParticleRows::All(rows), ParticleRows::Selected);
        let particles: ColumnStore = ColumnStore::new(bytes, rows, position, attributes);
        Ok(ParticleFile { unread, left_out, ..ParticleFile::new(particles, format) })
    }
}

/// The names of all particle types, with the chosen type first.
pub(super) fn types(known: Vec<String>, chosen: &str) -> Vec<String> {
    let others = known.into_iter().filter(|name| name != chosen);
    [chosen.to_owned()].into_iter().chain(others).collect()
}

/// The chosen type of particles: the type that a condition names, or else the only type, or else
/// the [`default_type`].
pub(super) fn chosen_type(known: &[String], wanted: &[Where]) -> Result<String, ReadFault> {
    match (named_type(known, wanted)?, known) {
        (Some(named), _) => Ok(named.to_owned()),
        (None, []) => Err(ReadFault::Unsupported("the file contains no particles".to_owned())),
        (None, [only]) => Ok(only.clone()),
        (None, _) => default_type(known).map(str::to_owned).ok_or_else(|| {
            ReadFault::Unsupported(format!(
                "the file contains several types: {}; choose one with the condition type=NAME",
                list_of(known)
            ))
        }),
    }
}

/// The type that is read by default. `None` if the names do not determine it.
///
/// This function takes the first name in [`FLUIDS`] that exactly one type has, and returns this
/// type. If there is no such name, it returns the type called [`GAS`], if exactly one type has this
/// name and no other type can be a liquid.
///
/// The comparison of names ignores case. If a type's name is a path, only its last component is
/// compared.
fn default_type(known: &[String]) -> Option<&str> {
    let is_called = |name: &String, other: &str| last_name(name).eq_ignore_ascii_case(other);
    let only = |called: &str| {
        let mut found = known.iter().filter(|name| is_called(name, called));
        found.next().filter(|_| found.next().is_none()).map(String::as_str)
    };
    let is_non_liquid = |name: &String| {
        let name = last_name(name).to_ascii_lowercase();
        name == GAS || name.starts_with("parttype") || NON_LIQUIDS.contains(&&*name)
    };
    let gas = || only(GAS).filter(|_| known.iter().all(is_non_liquid));
    FLUIDS.into_iter().find_map(only).or_else(gas)
}

/// The type of particles that a condition names. `None` if no condition names a type. A condition
/// with a number that is not a type is ignored here, because it may refer to the attribute `type`.
///
/// # Errors
/// [`ReadFault::Unsupported`] if conditions name types, but none of these types exists.
pub(super) fn named_type<'a>(
    known: &[String],
    wanted: &'a [Where],
) -> Result<Option<&'a str>, ReadFault> {
    let named = Where::types(wanted).find(|name| known.iter().any(|known| known == name));
    let is_name = |name: &&str| name.parse::<f64>().is_err();
    match (named, Where::types(wanted).find(is_name)) {
        (None, Some(missing)) => Err(no_type(known, missing)),
        (named, _) => Ok(named),
    }
}

/// The error for a file without particles of type `missing`.
pub(super) fn no_type(known: &[String], missing: &str) -> ReadFault {
    let list = list_of(known);
    ReadFault::Unsupported(format!("no particles of type {missing}; available: {list}"))
}

fn list_of(known: &[String]) -> String {
    let mut list = known.iter().take(LISTED).cloned().collect::<Vec<_>>().join(", ");
    if let more @ 1.. = known.len().saturating_sub(LISTED) {
        list += &format!(", and {more} more");
    }
    list
}

#[cfg(test)]
mod tests {
    use super::default_type;

    #[test]
    fn gas_is_the_default_only_if_no_other_type_can_be_a_liquid() {
        for (known, expected) in [
            (&["wall", "Fluid"][..], Some("Fluid")),
            (&["fluid", "gas", "oil"], Some("fluid")),
            (&["PartType0", "PartType1", "water"], Some("PartType0")),
            (&["gas", "Wall"], Some("gas")),
            (&["DM", "Gas", "stars"], Some("Gas")),
            (&["PartType4", "box/gas"], Some("box/gas")),
            (&["gas", "liquid"], None),
            (&["gas", "liquid", "wall"], None),
            (&["water", "gas"], None),
            (&["/", "gas"], None),
            (&["a/gas", "b/gas"], None),
            (&["a/fluid", "b/fluid"], None),
            (&["sand", "wall"], None),
        ] {
            let known: Vec<String> = known.iter().copied().map(String::from).collect();
            assert_eq!(default_type(&known), expected, "{known:?}");
        }
    }
}
