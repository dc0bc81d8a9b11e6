//! Data sets of numbers, a row a particle, as columns: where they lie if all do so as they are,
//! else decoded.

use std::io;

use bytemuck::NoUninit;
use hdf5_reader::group::Group;
use hdf5_reader::{ByteOrder, Dataset, Datatype, H5Type, SliceInfo, SliceInfoElem};

use crate::io::bytes::{Bytes, Unpacked};
use crate::io::columns::{Column, ColumnStore, Endian, Rows, Scalar};
use crate::io::encode::in_order;
use crate::io::vertices::{columns, integer};
use crate::io::wanted::WantedAttributes;
use crate::io::{ParticleFile, ReadFault, malformed};
use crate::particles::AttributeInfo;

use super::file::{File, checked};

/// Bytes that are decoded at once, where chunks are not larger.
const WINDOW: u64 = 1 << 20;
/// Components that an attribute may have: more are a matrix or a spectrum.
const MOST_COMPONENTS: u64 = 64;

const NATIVE: Endian = if cfg!(target_endian = "big") { Endian::Big } else { Endian::Little };

/// A data set of numbers, or some of its rows.
pub(super) struct Array {
    pub set: Dataset,
    pub name: String,
    pub scalar: Scalar,
    endian: Endian,
    pub components: usize,
    /// The first row that is meant.
    pub first: u64,
    /// The number of rows from there.
    pub rows: u64,
}

impl Array {
    /// All rows of a data set; `None` where it is not of rows of numbers.
    pub fn new(set: Dataset) -> Option<Self> {
        let name = set.name().rsplit('/').next().unwrap_or_default().to_owned();
        let components = match *set.shape() {
            [_] => 1,
            [_, components @ 1..=MOST_COMPONENTS] => components as usize,
            _ => return None,
        };
        let ((scalar, endian), rows) = (scalar(set.dtype())?, set.shape()[0]);
        Some(Self { set, name, scalar, endian, components, first: 0, rows })
    }

    /// All of a group, as the file lists them.
    pub fn all_of(group: &Group) -> Result<Vec<Self>, ReadFault> {
        Ok(checked(group.datasets())?.into_iter().filter_map(Self::new).collect())
    }

    /// All of a group, in the order of their names.
    pub fn by_name(group: &Group) -> Result<Vec<Self>, ReadFault> {
        let mut arrays = Self::all_of(group)?;
        arrays.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(arrays)
    }

    /// The data set called `name` in a group, which must be there and of numbers.
    pub fn named(group: &Group, name: &str) -> Result<Self, ReadFault> {
        let set = checked(group.dataset(name))?;
        Self::new(set).ok_or_else(|| malformed(0, format!("{name} is not of rows of numbers")))
    }

    /// Takes `rows` rows from `first` on.
    pub fn part(self, first: u64, rows: u64) -> Result<Self, ReadFault> {
        if first.checked_add(rows).is_none_or(|end| end > self.rows) {
            let Self { name, rows: all, .. } = &self;
            return Err(malformed(
                0,
                format!("{rows} rows from {first} on of the {all} of {name}"),
            ));
        }
        Ok(Self { first: self.first + first, rows, ..self })
    }

    fn stride(&self) -> usize {
        self.components * self.scalar.size()
    }

    /// Refuses more rows than the file's size vouches for, beside what was decoded before.
    fn check(&self, before: u64, limit: u64) -> Result<(), ReadFault> {
        let end =
            self.rows.checked_mul(self.stride() as u64).and_then(|bytes| bytes.checked_add(before));
        if end.is_none_or(|end| end > limit) {
            let Self { rows, name, .. } = self;
            let what = format!("{rows} rows of {name} are beyond all reason for this file");
            return Err(ReadFault::Compression(what));
        }
        Ok(())
    }

    /// Appends all rows, and says where their columns are.
    fn decode(&self, decoded: &mut Unpacked, file: &File) -> Result<Vec<Column>, ReadFault> {
        self.check(decoded.len(), file.limit)?;
        let start = decoded.len() as usize;
        let windows = self.windows();
        let window = |index: usize| windows.rows(index, self.rows);
        // A batch of windows is decoded while another is kept.
        let held = 4
            * rayon::current_num_threads() as u64
            * windows.size.saturating_mul(self.stride() as u64);
        let mut keep = |bytes: &[u8]| decoded.push(bytes).map_err(io::Error::other);
        let read = if held <= file.unpacking.in_memory.max(WINDOW) {
            let make = |index: usize, out: &mut Vec<u8>| {
                self.bytes(window(index), out).map_err(io::Error::other)
            };
            in_order(windows.count, make, keep)
        } else {
            let mut bytes = Vec::new();
            (0..windows.count).try_for_each(|index| {
                bytes.clear();
                self.bytes(window(index), &mut bytes).map_err(io::Error::other)?;
                keep(&bytes)
            })
        };
        read.map_err(fault_of)?;
        Ok(columns(start, self.stride(), self.components, self.scalar, NATIVE))
    }

    /// Rows to read at once: whole chunks.
    pub fn windows(&self) -> Windows {
        let chunk =
            self.set.chunks().and_then(|chunks| chunks.first().copied()).unwrap_or(1).max(1);
        let chunk = u64::from(chunk).min(self.rows.max(1));
        let fit = WINDOW / (chunk * self.stride() as u64).max(1);
        let size = chunk * fit.max(1);
        // The first window ends where a chunk does.
        let lead = (size - self.first % size).min(self.rows);
        let count = usize::from(lead > 0) + (self.rows - lead).div_ceil(size) as usize;
        Windows { lead, size, count }
    }

    /// Appends some rows as the machine stores numbers.
    fn bytes(&self, rows: [u64; 2], out: &mut Vec<u8>) -> Result<(), ReadFault> {
        fn put<T: H5Type + NoUninit>(
            array: &Array,
            rows: [u64; 2],
            out: &mut Vec<u8>,
        ) -> Result<(), ReadFault> {
            out.extend_from_slice(bytemuck::cast_slice(&array.values::<T>(rows)?));
            Ok(())
        }
        match self.scalar {
            Scalar::I8 => put::<i8>(self, rows, out),
            Scalar::U8 => put::<u8>(self, rows, out),
            Scalar::I16 => put::<i16>(self, rows, out),
            Scalar::U16 => put::<u16>(self, rows, out),
            Scalar::I32 => put::<i32>(self, rows, out),
            Scalar::U32 => put::<u32>(self, rows, out),
            Scalar::I64 => put::<i64>(self, rows, out),
            Scalar::U64 => put::<u64>(self, rows, out),
            Scalar::F32 => put::<f32>(self, rows, out),
            Scalar::F64 => put::<f64>(self, rows, out),
        }
    }

    /// All numbers as doubles.
    pub fn doubles(&self, rows: [u64; 2]) -> Result<Vec<f64>, ReadFault> {
        Ok(match self.scalar {
            Scalar::I8 => self.values::<i8>(rows)?.into_iter().map(f64::from).collect(),
            Scalar::U8 => self.values::<u8>(rows)?.into_iter().map(f64::from).collect(),
            Scalar::I16 => self.values::<i16>(rows)?.into_iter().map(f64::from).collect(),
            Scalar::U16 => self.values::<u16>(rows)?.into_iter().map(f64::from).collect(),
            Scalar::I32 => self.values::<i32>(rows)?.into_iter().map(f64::from).collect(),
            Scalar::U32 => self.values::<u32>(rows)?.into_iter().map(f64::from).collect(),
            Scalar::I64 => {
                self.values::<i64>(rows)?.into_iter().map(|value| value as f64).collect()
            }
            Scalar::U64 => {
                self.values::<u64>(rows)?.into_iter().map(|value| value as f64).collect()
            }
            Scalar::F32 => self.values::<f32>(rows)?.into_iter().map(f64::from).collect(),
            Scalar::F64 => self.values::<f64>(rows)?,
        })
    }

    /// Refuses rows that the file's size does not vouch for.
    pub fn check_small(&self, file: &File) -> Result<(), ReadFault> {
        self.check(0, file.limit)
    }

    /// All numbers as integers, of a data set that is small or read to be one mesh.
    pub fn integers(&self, file: &File) -> Result<Vec<i64>, ReadFault> {
        self.check(0, file.limit)?;
        self.some_integers([0, self.rows])
    }

    /// The numbers of some rows as integers.
    pub fn some_integers(&self, rows: [u64; 2]) -> Result<Vec<i64>, ReadFault> {
        let mut bytes = Vec::new();
        self.bytes(rows, &mut bytes)?;
        let numbers =
            bytes.chunks_exact(self.scalar.size()).map(|bytes| integer(self.scalar, NATIVE, bytes));
        let no_integers = || malformed(0, format!("{} is not of integers", self.name));
        numbers.collect::<Option<_>>().ok_or_else(no_integers)
    }

    fn values<T: H5Type>(&self, [start, end]: [u64; 2]) -> Result<Vec<T>, ReadFault> {
        let all = SliceInfoElem::Slice { start: 0, end: u64::MAX, step: 1 };
        let (first, last) = (self.first + start, self.first + end);
        let mut selections = vec![SliceInfoElem::Slice { start: first, end: last, step: 1 }];
        selections.extend((self.set.ndim() > 1).then_some(all));
        let values = checked(self.set.read_slice::<T>(&SliceInfo { selections }))?;
        let values: Vec<T> = values.iter().cloned().collect();
        let expected = (end - start) as usize * self.components;
        if values.len() != expected {
            let what = format!("{} has {} values of {expected}", self.name, values.len());
            return Err(malformed(0, what));
        }
        Ok(values)
    }
}

/// How the rows of a data set are divided.
pub(super) struct Windows {
    /// Rows of the first.
    lead: u64,
    /// Rows of all others but the last.
    size: u64,
    pub count: usize,
}

impl Windows {
    /// The first row of a window, and the one behind its last, of so many.
    pub fn rows(&self, index: usize, all: u64) -> [u64; 2] {
        let end = |index: u64| (self.lead + self.size * index).min(all);
        match index as u64 {
            0 => [0, end(0)],
            index => [end(index - 1), end(index)],
        }
    }

    /// The number of the window that holds a row.
    pub fn holding(&self, row: u64) -> usize {
        row.checked_sub(self.lead).map_or(0, |beyond| 1 + (beyond / self.size) as usize)
    }

    /// Divides so many rows, of so many bytes each, that are in no data set.
    pub fn of(rows: u64, stride: u64) -> Self {
        let size = (WINDOW / stride.max(1)).max(1);
        Self { lead: size.min(rows), size, count: rows.div_ceil(size) as usize }
    }
}

/// A fault that went through the errors of input and output.
pub(super) fn fault_of(error: io::Error) -> ReadFault {
    match error.downcast::<ReadFault>() {
        Ok(fault) => fault,
        Err(error) => ReadFault::Io(error),
    }
}

fn scalar(kind: &Datatype) -> Option<(Scalar, Endian)> {
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

/// A column: the number of an array and that of its component.
pub(super) type Place = (usize, usize);

/// Columns of equally many rows, by where they are among arrays.
pub(super) struct Table {
    pub arrays: Vec<Array>,
    pub position: [Place; 3],
    pub attributes: Vec<(AttributeInfo, Vec<Place>)>,
}

impl Table {
    /// Takes every array as an attribute but for the one called `position`, of three components,
    /// and those of another number of rows.
    ///
    /// Returns `None` where there is no such position.
    pub fn of_arrays(arrays: Vec<Array>, position: &str) -> Option<Self> {
        let is_it = |array: &Array| array.name == position && array.components == 3;
        let found = arrays.iter().position(is_it)?;
        let rows = arrays[found].rows;
        let others =
            arrays.iter().enumerate().filter(|(index, a)| *index != found && a.rows == rows);
        let attributes = others.map(|(index, array)| {
            let info = AttributeInfo { name: array.name.clone(), components: array.components };
            (info, (0..array.components).map(|component| (index, component)).collect())
        });
        let attributes = attributes.collect();
        Some(Self { position: [0, 1, 2].map(|component| (found, component)), attributes, arrays })
    }

    /// Number of rows.
    pub fn rows(&self) -> u64 {
        self.arrays[self.position[0].0].rows
    }

    /// The particles with the attributes that are wanted. Their columns are those of the file where
    /// every array that is used lies there as it is; else all are decoded.
    pub fn read(
        self,
        file: File,
        format: &'static str,
        wanted: WantedAttributes,
    ) -> Result<ParticleFile, ReadFault> {
        let rows = usize::try_from(self.rows())
            .map_err(|_| malformed(0, "more rows than can be addressed"))?;
        let Self { arrays, position, attributes } = self;
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
        let in_file = rows == 0 || wanted().all(|array| in_place(&file, array).is_some());
        let mut decoded = Unpacked::new(file.unpacking);
        let mut found: Vec<Vec<Column>> = Vec::new();
        for (array, used) in arrays.iter().zip(used) {
            found.push(match in_place(&file, array).filter(|_| in_file) {
                _ if !used => Vec::new(),
                Some(columns) => columns,
                None if rows == 0 => {
                    columns(0, array.stride(), array.components, array.scalar, NATIVE)
                }
                None => array.decode(&mut decoded, &file)?,
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
        let particles: ColumnStore = ColumnStore::new(bytes, Rows::All(rows), position, attributes);
        Ok(ParticleFile { unread, ..ParticleFile::new(particles, format) })
    }
}

/// The columns of an array in the file.
fn in_place(file: &File, array: &Array) -> Option<Vec<Column>> {
    let stride = array.stride() as u64;
    let end = array.first.checked_add(array.rows)?.checked_mul(stride)?;
    let start = file.place(&array.set, end)?.checked_add(array.first * stride)?;
    Some(columns(
        usize::try_from(start).ok()?,
        array.stride(),
        array.components,
        array.scalar,
        array.endian,
    ))
}

/// The type of particles that is meant: by its name, or `usual`, or the only one.
pub(super) fn chosen_type(
    known: &[String],
    named: Option<&str>,
    usual: Option<&str>,
) -> Result<String, ReadFault> {
    let list = known.join(", ");
    let is_there = |name: &&str| known.iter().any(|known| known == name);
    match (named, known) {
        (Some(name), _) if is_there(&name) => Ok(name.to_owned()),
        (Some(name), _) => Err(ReadFault::Unsupported(format!(
            "no particles of the type {name}; there are: {list}"
        ))),
        (None, []) => Err(ReadFault::Unsupported("no particles at all".to_owned())),
        (None, [only]) => Ok(only.clone()),
        (None, _) => usual.filter(is_there).map(str::to_owned).ok_or_else(|| {
            ReadFault::Unsupported(format!("particles of several types: {list}; name one"))
        }),
    }
}
