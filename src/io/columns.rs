//! One shape for every particle format: columns of numbers at a fixed stride in a run of bytes.
//!
//! A binary format's reader parses the header and says where the columns lie; a text format's reader
//! decodes into little-endian columns first. Nothing else differs between formats.

use std::ops::Deref;

use crate::particles::{AttributeInfo, Particles};

use super::bytes::Bytes;

/// How a number is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    /// Width in bytes.
    #[must_use]
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }
}

/// Byte order of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Endian {
    Little,
    Big,
}

/// Where a tuple of numbers lies for every particle: particle `i` has its components one after the other
/// from byte `offset + i * stride`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Column {
    /// Of particle 0's first component, in bytes from the start of the data.
    pub offset: usize,
    /// Bytes from one particle to the next.
    pub stride: usize,
    /// Type of every component.
    pub scalar: Scalar,
    /// Byte order of every component.
    pub endian: Endian,
}

/// The numbers of a particle file, still as stored, in bytes that are owned, mapped or borrowed.
#[derive(Debug)]
pub struct ColumnStore<B = Bytes> {
    bytes: B,
    rows: Rows,
    /// x, y and z, which need not be neighbours (a .ply may order its properties freely).
    position: [Column; 3],
    infos: Vec<AttributeInfo>,
    /// For each attribute, one column per component.
    columns: Vec<Vec<Column>>,
}

/// Which rows of the columns are particles of the fluid.
#[derive(Debug)]
pub enum Rows {
    /// The first so many.
    All(usize),
    /// These, in this order (a .bi4 mixes fluid with boundary).
    Chosen(Vec<u32>),
}

impl<B: Deref<Target = [u8]>> ColumnStore<B> {
    /// Joins columns to the bytes that hold them.
    ///
    /// # Panics
    /// If a column reaches past the bytes: readers check a header's counts before they believe them.
    #[must_use]
    pub fn new(
        bytes: B,
        rows: Rows,
        position: [Column; 3],
        attributes: Vec<(AttributeInfo, Vec<Column>)>,
    ) -> Self {
        let (infos, columns): (Vec<_>, Vec<_>) = attributes.into_iter().unzip();
        let last = match &rows {
            Rows::All(count) => count.checked_sub(1),
            Rows::Chosen(rows) => rows.iter().max().map(|&row| row as usize),
        };
        if let Some(last) = last {
            for column in position.iter().chain(columns.iter().flatten()) {
                let end = column.offset + last * column.stride + column.scalar.size();
                assert!(end <= bytes.len(), "a column ends at byte {end} of {}", bytes.len());
            }
        }
        for (info, columns) in infos.iter().zip(&columns) {
            assert_eq!(info.components, columns.len(), "one column a component");
        }
        Self { bytes, rows, position, infos, columns }
    }

    fn read<T>(&self, column: &Column, first: usize, count: usize, mut put: impl FnMut(usize, T))
    where
        T: FromScalar,
    {
        match (column.scalar, column.endian) {
            (Scalar::I8, _) => self
                .walk(column, first, count, |i, b: [u8; 1]| put(i, T::from_i64(i8::from_le_bytes(b).into()))),
            (Scalar::U8, _) => {
                self.walk(column, first, count, |i, b: [u8; 1]| put(i, T::from_i64(b[0].into())))
            }
            (Scalar::I16, Endian::Little) => {
                self.walk(column, first, count, |i, b| put(i, T::from_i64(i16::from_le_bytes(b).into())))
            }
            (Scalar::I16, Endian::Big) => {
                self.walk(column, first, count, |i, b| put(i, T::from_i64(i16::from_be_bytes(b).into())))
            }
            (Scalar::U16, Endian::Little) => {
                self.walk(column, first, count, |i, b| put(i, T::from_i64(u16::from_le_bytes(b).into())))
            }
            (Scalar::U16, Endian::Big) => {
                self.walk(column, first, count, |i, b| put(i, T::from_i64(u16::from_be_bytes(b).into())))
            }
            (Scalar::I32, Endian::Little) => {
                self.walk(column, first, count, |i, b| put(i, T::from_i64(i32::from_le_bytes(b).into())))
            }
            (Scalar::I32, Endian::Big) => {
                self.walk(column, first, count, |i, b| put(i, T::from_i64(i32::from_be_bytes(b).into())))
            }
            (Scalar::U32, Endian::Little) => {
                self.walk(column, first, count, |i, b| put(i, T::from_i64(u32::from_le_bytes(b).into())))
            }
            (Scalar::U32, Endian::Big) => {
                self.walk(column, first, count, |i, b| put(i, T::from_i64(u32::from_be_bytes(b).into())))
            }
            (Scalar::I64, Endian::Little) => {
                self.walk(column, first, count, |i, b| put(i, T::from_i64(i64::from_le_bytes(b))))
            }
            (Scalar::I64, Endian::Big) => {
                self.walk(column, first, count, |i, b| put(i, T::from_i64(i64::from_be_bytes(b))))
            }
            (Scalar::U64, Endian::Little) => {
                self.walk(column, first, count, |i, b| put(i, T::from_f64(u64::from_le_bytes(b) as f64)))
            }
            (Scalar::U64, Endian::Big) => {
                self.walk(column, first, count, |i, b| put(i, T::from_f64(u64::from_be_bytes(b) as f64)))
            }
            (Scalar::F32, Endian::Little) => {
                self.walk(column, first, count, |i, b| put(i, T::from_f32(f32::from_le_bytes(b))))
            }
            (Scalar::F32, Endian::Big) => {
                self.walk(column, first, count, |i, b| put(i, T::from_f32(f32::from_be_bytes(b))))
            }
            (Scalar::F64, Endian::Little) => {
                self.walk(column, first, count, |i, b| put(i, T::from_f64(f64::from_le_bytes(b))))
            }
            (Scalar::F64, Endian::Big) => {
                self.walk(column, first, count, |i, b| put(i, T::from_f64(f64::from_be_bytes(b))))
            }
        }
    }

    fn walk<const N: usize>(
        &self,
        column: &Column,
        first: usize,
        count: usize,
        mut put: impl FnMut(usize, [u8; N]),
    ) {
        let at = |row: usize| {
            let start = column.offset + row * column.stride;
            let mut bytes = [0; N];
            bytes.copy_from_slice(&self.bytes[start..start + N]);
            bytes
        };
        match &self.rows {
            Rows::All(rows) => {
                assert!(first + count <= *rows, "particles {first} to {} of {rows}", first + count);
                (0..count).for_each(|i| put(i, at(first + i)));
            }
            Rows::Chosen(rows) => {
                for (i, &row) in rows[first..first + count].iter().enumerate() {
                    put(i, at(row as usize));
                }
            }
        }
    }
}

impl<B: Deref<Target = [u8]> + Sync> Particles for ColumnStore<B> {
    fn len(&self) -> usize {
        match &self.rows {
            Rows::All(count) => *count,
            Rows::Chosen(rows) => rows.len(),
        }
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        for (axis, column) in self.position.iter().enumerate() {
            self.read(column, first, out.len(), |i, x: f64| out[i][axis] = x);
        }
    }

    fn attributes(&self) -> &[AttributeInfo] {
        &self.infos
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let columns = &self.columns[index];
        let count = out.len() / columns.len();
        for (component, column) in columns.iter().enumerate() {
            self.read(column, first, count, |i, x: f32| out[i * columns.len() + component] = x);
        }
    }
}

/// A number that a stored scalar converts to, to the nearest value.
trait FromScalar {
    fn from_i64(value: i64) -> Self;
    fn from_f32(value: f32) -> Self;
    fn from_f64(value: f64) -> Self;
}

impl FromScalar for f32 {
    fn from_i64(value: i64) -> Self {
        value as Self
    }
    fn from_f32(value: f32) -> Self {
        value
    }
    fn from_f64(value: f64) -> Self {
        value as Self
    }
}

impl FromScalar for f64 {
    fn from_i64(value: i64) -> Self {
        value as Self
    }
    fn from_f32(value: f32) -> Self {
        value.into()
    }
    fn from_f64(value: f64) -> Self {
        value
    }
}
