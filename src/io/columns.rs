//! Columns of numbers with a fixed stride in a range of bytes. All particle formats are read in
//! this form.
//!
//! The reader of a binary format parses the header and locates the columns. The reader of a text
//! format first decodes the text into little-endian columns. After this step, all formats are
//! handled in the same way.

use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;

use half::f16;

use crate::particles::kind::is_direction_name;
use crate::particles::sieve::Sieve;
use crate::particles::{AttributeInfo, AttributeKind, Label, Particles, RereadError};

use super::names::velocity_of_components;
use super::windows::{InputBytes, WindowPool, Windows};

/// Granularity, in bytes, at which memory is released.
const WINDOW: usize = 1 << 20;

/// Maximum span, in rows, of selected rows that are read together.
const NEAR: usize = 1 << 10;

/// The type of a stored number.
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
    F16,
    F32,
    F64,
}

impl Scalar {
    /// Whether it is a floating-point type.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F16 | Self::F32 | Self::F64)
    }

    /// The kind of an attribute whose numbers have this type.
    pub fn kind_of(self, info: &AttributeInfo) -> AttributeKind {
        match self {
            Self::F16 | Self::F32 | Self::F64 => info.kind,
            // A colour that is stored in bytes has values from 0 to 255, not fractions.
            Self::U8 if info.kind.is_colour() => AttributeKind::ByteColour,
            Self::U16 if info.kind.is_colour() => AttributeKind::ShortColour,
            _ if info.kind.is_colour() => AttributeKind::WholeColour,
            _ if is_direction_name(info) => AttributeKind::Number,
            Self::I8 | Self::U8 | Self::I16 | Self::U16 | Self::I32 => AttributeKind::Signed,
            Self::U32 => AttributeKind::Unsigned,
            Self::I64 | Self::U64 => AttributeKind::Wide,
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

/// The location of one number of every particle: the number of particle `i` starts at byte
/// `offset + i * stride`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Column {
    /// Byte offset of particle 0's number from the start of the data.
    pub offset: usize,
    /// Number of bytes from the start of one particle's number to the start of the next particle's.
    pub stride: usize,
    /// Type of the numbers.
    pub scalar: Scalar,
    /// Byte order of the numbers.
    pub endian: Endian,
}

impl Column {
    /// The column of component `index` of a tuple, if `self` is the column of component 0.
    pub fn component(self, index: usize) -> Self {
        Self { offset: self.offset + index * self.scalar.size(), ..self }
    }

    /// Decodes the number at the start of `bytes`.
    pub fn number(&self, bytes: &[u8]) -> f64 {
        let mut number = [0.0];
        let window = Window { particles: 0..1, rows: None, bytes };
        self.decode::<f64, 1>(&window, &mut number, 1);
        number[0]
    }
}

/// The columns of a particle file. Their bytes are in memory, borrowed, or read from the file on
/// demand.
#[derive(Debug)]
pub struct ColumnStore<B = InputBytes> {
    bytes: B,
    rows: ParticleRows,
    /// Columns of x, y and z, which need not be adjacent (a .ply may order its properties freely).
    position: [Column; 3],
    infos: Vec<AttributeInfo>,
    /// For each attribute, one column per component.
    columns: Vec<Vec<Column>>,
    labels: Vec<Label>,
    /// For each text attribute, a column of numbers, and a table that maps these numbers to indices
    /// of texts in the attribute's label.
    texts: Vec<(Column, Vec<u32>)>,
}

/// The rows of the columns that contain particles.
#[derive(Debug)]
pub enum ParticleRows {
    /// Rows 0 to `n - 1`, where `n` is this number.
    All(usize),
    /// The rows that a sieve selects, such as the fluid particles of a .bi4 file, or the particles
    /// that satisfy the conditions.
    Selected(Sieve),
}

impl ParticleRows {
    /// The number of rows that contain particles.
    pub fn count(&self) -> usize {
        match self {
            Self::All(count) => *count,
            Self::Selected(sieve) => sieve.count(),
        }
    }
}

impl<B: Windows> ColumnStore<B> {
    /// Combines columns with their bytes. If several attributes have the same name, keeps only the
    /// first. If the components of the velocity are separate attributes, such as `vx`, `vy` and
    /// `vz`, adds the whole velocity as the last attribute.
    ///
    /// # Panics
    /// If a column extends beyond the bytes, if the numbers of a column overlap, or if an attribute
    /// does not have one column per component. Readers must check a header's counts first.
    pub fn new(
        bytes: impl Into<B>,
        rows: ParticleRows,
        position: [Column; 3],
        mut attributes: Vec<(AttributeInfo, Vec<Column>)>,
    ) -> Self {
        let bytes = bytes.into();
        for (info, columns) in &mut attributes {
            if let Some(column) = columns.first() {
                info.kind = column.scalar.kind_of(info);
            }
        }
        let mut names = HashSet::new();
        attributes.retain(|(info, _)| names.insert(info.name.clone()));
        let (mut infos, mut columns): (Vec<_>, Vec<_>) = attributes.into_iter().unzip();
        if let Some((velocity, components)) = velocity_of_components(&infos) {
            infos.push(velocity);
            columns.push(components.iter().flat_map(|&index| columns[index].clone()).collect());
        }
        let last = match &rows {
            ParticleRows::All(count) => count.checked_sub(1),
            ParticleRows::Selected(sieve) => sieve.last(),
        };
        if let Some(last) = last {
            for column in position.iter().chain(columns.iter().flatten()) {
                let end = column.offset + last * column.stride + column.scalar.size();
                assert!(end <= bytes.count(), "a column ends at byte {end} of {}", bytes.count());
                assert!(
                    column.stride >= column.scalar.size(),
                    "the stride is only {} bytes",
                    column.stride
                );
            }
        }
        for (info, columns) in infos.iter().zip(&columns) {
            assert_eq!(info.components, columns.len(), "one column per component");
        }
        let (labels, texts) = (Vec::new(), Vec::new());
        Self { bytes, rows, position, infos, columns, labels, texts }
    }

    /// Fills `out` with one tuple per particle, from particle `first` on. A tuple has one number
    /// per column.
    fn read<T: NearestCast>(&self, columns: &[Column], first: usize, out: &mut [T]) {
        let width = columns.len();
        // If there is a single row, its stride may be shorter than a tuple. In this case, the
        // components are read one by one.
        let neighbours =
            columns.iter().enumerate().all(|(i, column)| *column == columns[0].component(i));
        match columns {
            [xyz, _, _] if neighbours && xyz.stride >= 3 * xyz.scalar.size() => {
                self.read_tuples::<T, 3>(xyz, first, out, width)
            }
            _ => {
                for (component, column) in columns.iter().enumerate() {
                    let out = out.get_mut(component..).unwrap_or_default();
                    self.read_tuples::<T, 1>(column, first, out, width);
                }
            }
        }
    }

    /// Reads `K` adjacent numbers of each particle, and writes them to the start of the particle's
    /// group of `step` numbers in `out`.
    fn read_tuples<T: NearestCast, const K: usize>(
        &self,
        column: &Column,
        first: usize,
        out: &mut [T],
        step: usize,
    ) {
        let size = K * column.scalar.size();
        let count = out.len().div_ceil(step);
        self.each_window(column, size, first..first.saturating_add(count), &mut |window| {
            let groups =
                window.particles.start * step..(window.particles.end * step).min(out.len());
            column.decode::<T, K>(&window, &mut out[groups], step);
        });
    }

    /// Calls `read` with windows that together hold all `particles`. For each particle, a window
    /// holds the `size` bytes from the start of the particle's number in `column`.
    fn each_window(
        &self,
        column: &Column,
        size: usize,
        particles: Range<usize>,
        read: &mut dyn FnMut(Window<'_>),
    ) {
        let (first, count) = (particles.start, particles.len());
        match &self.rows {
            ParticleRows::All(rows) => {
                let end = particles.end;
                assert!(end <= *rows, "range {first}..{end} of {rows} particles");
                if count > 0 {
                    let start = column.offset + first * column.stride;
                    let end = start + (count - 1) * column.stride + size;
                    self.bytes.with(start..end, |bytes| {
                        read(Window { particles: 0..count, rows: None, bytes });
                    });
                }
            }
            ParticleRows::Selected(sieve) => {
                let (mut done, mut near) = (0, Vec::with_capacity(NEAR.min(count)));
                let mut rows = sieve.rows(first).take(count).peekable();
                while let Some(&row) = rows.peek() {
                    // Read nearby rows as one window.
                    near.clear();
                    let next = || rows.next_if(|&other| other - row < NEAR);
                    near.extend(std::iter::from_fn(next).map(|other| other - row));
                    let particles = done..done + near.len();
                    done = particles.end;
                    let start = column.offset + row * column.stride;
                    let last = near.last().copied().unwrap_or_default();
                    self.bytes.with(start..start + last * column.stride + size, |bytes| {
                        read(Window { particles, rows: Some(&near), bytes });
                    });
                }
                assert!(done == count, "particles from {first} on of {}", sieve.count());
            }
        }
    }
}

/// The bytes of a column for consecutive particles.
struct Window<'a> {
    /// The particles, counted from the first particle that the caller requested.
    particles: Range<usize>,
    /// The row of each particle, counted from the first row of the window. `None` for consecutive
    /// rows.
    rows: Option<&'a [usize]>,
    bytes: &'a [u8],
}

impl Window<'_> {
    /// Converts `K` adjacent numbers of each particle, and writes them to the start of the
    /// particle's group of `step` numbers in `out`.
    ///
    /// The compiler generates a copy of this function for each pair of types. To keep these copies
    /// small, the function contains only the conversion.
    fn convert<T, const K: usize, const N: usize>(
        &self,
        stride: usize,
        out: &mut [T],
        step: usize,
        number: impl Fn([u8; N]) -> T,
    ) {
        if self.rows.is_none() && stride == K * N && step == K {
            // Without gaps in input and output, the compiler vectorizes this loop.
            for (out, stored) in out.iter_mut().zip(self.bytes.as_chunks::<N>().0) {
                *out = number(*stored);
            }
            return;
        }
        for (particle, out) in out.chunks_mut(step).enumerate() {
            let row = self.rows.map_or(particle, |rows| rows[particle]);
            let stored = self.bytes[row * stride..][..K * N].as_chunks::<N>().0;
            for (out, stored) in out[..K].iter_mut().zip(stored) {
                *out = number(*stored);
            }
        }
    }
}

impl ColumnStore {
    /// Adds text attributes. Each has a column of numbers, and a table that maps these numbers to
    /// indices of texts in its [`Label`].
    #[must_use]
    pub fn with_labels(
        self,
        labels: impl IntoIterator<Item = (Label, (Column, Vec<u32>))>,
    ) -> Self {
        let (labels, texts) = labels.into_iter().unzip();
        Self { labels, texts, ..self }
    }

    /// Keeps only the particles that `sieve` selects.
    pub fn select(&mut self, sieve: Sieve) {
        self.rows = ParticleRows::Selected(match &self.rows {
            ParticleRows::All(_) => sieve,
            ParticleRows::Selected(rows) => rows.filtered_by(&sieve),
        });
    }

    /// Memory, in bytes, that the selection of rows takes.
    pub fn sieve_bytes(&self) -> u64 {
        match &self.rows {
            ParticleRows::All(_) => 0,
            ParticleRows::Selected(sieve) => sieve.bytes(),
        }
    }

    /// Number of bytes in scratch files.
    pub fn scratch_bytes(&self) -> u64 {
        self.bytes.scratch_bytes()
    }

    /// Number of bytes in the input file, which is read in windows.
    pub fn file_bytes(&self) -> u64 {
        self.bytes.file_bytes()
    }

    /// Makes these columns use the windows of `pool`, which several files share.
    pub fn share(&mut self, pool: &Arc<WindowPool>) {
        self.bytes.share(pool);
    }
}

impl<B: Windows> Particles for ColumnStore<B> {
    fn len(&self) -> usize {
        self.rows.count()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        self.read(&self.position, first, out.as_flattened_mut());
    }

    fn check(&self) -> Result<(), RereadError> {
        self.bytes.check()
    }

    fn resident_bytes(&self) -> u64 {
        self.bytes.resident_bytes()
    }

    fn release(&self, range: Range<usize>) {
        let range = match &self.rows {
            ParticleRows::All(_) => range,
            ParticleRows::Selected(sieve) => sieve.around(range),
        };
        let columns = self.position.iter().chain(self.columns.iter().flatten());
        let mut windows: Vec<Range<usize>> = columns
            .map(|c| c.offset + range.start * c.stride..c.offset + range.end * c.stride)
            .collect();
        windows.sort_unstable_by_key(|window| window.start);
        let len = self.bytes.count();
        for group in windows.chunk_by(|a, b| b.start < a.end) {
            let end = group.iter().map(|window| window.end).max().unwrap_or_default().min(len);
            // Release only complete windows. A later call releases a window that is incomplete now.
            let [begin, end] = [group[0].start, end].map(|at| at / WINDOW * WINDOW);
            if begin < end {
                self.bytes.release(begin..end);
            }
        }
    }

    fn attributes(&self) -> &[AttributeInfo] {
        &self.infos
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        self.read(&self.columns[index], first, out);
    }

    fn labels(&self) -> &[Label] {
        &self.labels
    }

    fn label(&self, index: usize, first: usize, out: &mut [u32]) {
        let (column, places) = &self.texts[index];
        let mut numbers = vec![0.0_f64; out.len()];
        self.read(std::slice::from_ref(column), first, &mut numbers);
        for (out, number) in out.iter_mut().zip(numbers) {
            *out = places.get(number as usize).copied().unwrap_or_default();
        }
    }

    fn component(&self, (index, component): (usize, usize), first: usize, out: &mut [f64]) {
        self.read(&self.columns[index][component..=component], first, out);
    }

    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        self.read(&self.columns[index], first, out);
    }
}

/// Defines the operations of each number type. Half floats are converted to f32 first.
macro_rules! stored {
    ($($scalar:ident $type:ident),*) => {
        impl Scalar {
            /// Size in bytes.
            pub fn size(self) -> usize {
                match self {
                    Self::F16 => size_of::<f16>(),
                    $(Self::$scalar => size_of::<$type>()),*
                }
            }
        }

        /// A type to which every number type can be converted, by rounding to the nearest value.
        trait NearestCast: Copy {
            $(fn $type(value: $type) -> Self;)*
        }

        #[allow(clippy::cast_lossless)] // `as` also converts i64, for which `From` is missing.
        impl NearestCast for f32 {
            $(fn $type(value: $type) -> Self { value as Self })*
        }

        #[allow(clippy::cast_lossless)]
        impl NearestCast for f64 {
            $(fn $type(value: $type) -> Self { value as Self })*
        }

        #[allow(clippy::cast_lossless)]
        impl NearestCast for i64 {
            $(fn $type(value: $type) -> Self {
                (value as i128).clamp(Self::MIN.into(), Self::MAX.into()) as Self
            })*
        }

        impl Column {
            /// Calls [`Window::convert`] for the type and byte order of the column.
            fn decode<T: NearestCast, const K: usize>(
                &self,
                window: &Window<'_>,
                out: &mut [T],
                step: usize,
            ) {
                let stride = self.stride;
                match (self.scalar, self.endian) {
                    (Scalar::F16, Endian::Little) => window.convert::<T, K, _>(
                        stride, out, step, |bytes| T::f32(f16::from_le_bytes(bytes).into()),
                    ),
                    (Scalar::F16, Endian::Big) => window.convert::<T, K, _>(
                        stride, out, step, |bytes| T::f32(f16::from_be_bytes(bytes).into()),
                    ),
                    $((Scalar::$scalar, Endian::Little) => window.convert::<T, K, _>(
                        stride, out, step, |bytes| T::$type($type::from_le_bytes(bytes)),
                    ),
                    (Scalar::$scalar, Endian::Big) => window.convert::<T, K, _>(
                        stride, out, step, |bytes| T::$type($type::from_be_bytes(bytes)),
                    ),)*
                }
            }
        }
    };
}

stored!(I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, I64 i64, U64 u64, F32 f32, F64 f64);
