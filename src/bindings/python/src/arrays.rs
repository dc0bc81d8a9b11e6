//! Reads Python arrays in place: NumPy arrays, and objects with DLPack, the array interface or the
//! buffer protocol.
//!
//! This module reads without the interpreter's lock, so another thread may write to an array at the
//! same time. The values behind a Rust slice must not change, so the module never makes a slice of
//! an array. Instead, each read of a number is one volatile load through a pointer. The library
//! reads positions several times, and reports positions that differ between reads as an error.

use meniscus::files::{AttributeInfo, AttributeKind, velocity_attribute};
use numpy::prelude::*;
use numpy::{PyArrayDescrMethods, PyUntypedArray};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use crate::errors::InputError;

/// DLPack device types whose memory the CPU can read: the CPU, and pinned memory of CUDA and ROCm.
const HOST: [i32; 3] = [1, 3, 11];

/// The memory layout of an array with rows and columns and any strides.
#[derive(Debug, Clone, Copy)]
pub struct Numbers {
    first: *const u8,
    rows: usize,
    columns: usize,
    /// Bytes from one row to the next, and from one column to the next.
    strides: [isize; 2],
    kind: Kind,
    aligned: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    F32,
    F64,
    I8,
    I16,
    I32,
    I64,
    U8,
    U16,
    U32,
    U64,
}

impl Kind {
    /// The number type with this NumPy kind letter and this size in bytes.
    fn of(letter: u8, bytes: usize) -> Option<Self> {
        Some(match (letter, bytes) {
            (b'f', 4) => Self::F32,
            (b'f', 8) => Self::F64,
            (b'i', 1) => Self::I8,
            (b'i', 2) => Self::I16,
            (b'i', 4) => Self::I32,
            (b'i', 8) => Self::I64,
            (b'u', 1) => Self::U8,
            (b'u', 2) => Self::U16,
            (b'u', 4) => Self::U32,
            (b'u', 8) => Self::U64,
            _ => return None,
        })
    }

    fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::F32 | Self::I32 | Self::U32 => 4,
            Self::F64 | Self::I64 | Self::U64 => 8,
        }
    }

    /// NumPy's name of the type.
    fn name(self) -> &'static str {
        match self {
            Self::F32 => "float32",
            Self::F64 => "float64",
            Self::I8 => "int8",
            Self::I16 => "int16",
            Self::I32 => "int32",
            Self::I64 => "int64",
            Self::U8 => "uint8",
            Self::U16 => "uint16",
            Self::U32 => "uint32",
            Self::U64 => "uint64",
        }
    }
}

/// Allowed number types of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Types {
    Floats,
    /// Floating-point numbers or integers.
    Numbers,
}

// SAFETY: this module only reads numbers, each in one volatile access, even if other threads write.
unsafe impl Send for Numbers {}
// SAFETY: for the same reason as `Send`.
unsafe impl Sync for Numbers {}

/// A Python array, kept alive, and the layout of its numbers.
pub struct BoundArray<'py> {
    pub array: Bound<'py, PyUntypedArray>,
    pub numbers: Numbers,
}

impl BoundArray<'_> {
    /// Size, in bytes, of all numbers.
    pub fn bytes(&self) -> u64 {
        (self.numbers.rows * self.numbers.columns * self.numbers.kind.bytes()) as u64
    }
}

/// Loads a number of type `$number` from the valid address `$at`, byte by byte if it is not
/// aligned.
macro_rules! load_number {
    ($number:ty, $at:expr, $aligned:expr) => {
        if $aligned {
            $at.cast::<$number>().read_volatile()
        } else {
            <$number>::from_ne_bytes($at.cast::<[u8; size_of::<$number>()]>().read_volatile())
        }
    };
}

impl Numbers {
    pub fn rows(&self) -> usize {
        self.rows
    }

    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Returns the layout of a single column.
    ///
    /// # Panics
    /// If there are fewer columns.
    pub fn column(&self, column: usize) -> Self {
        assert!(column < self.columns, "column out of range");
        let first = self.first.wrapping_offset(column as isize * self.strides[1]);
        Self { first, columns: 1, ..*self }
    }

    /// The kind of an attribute whose numbers have this type. The same rule applies to attributes
    /// in files.
    pub fn attribute_kind(&self, info: &AttributeInfo) -> AttributeKind {
        match self.kind {
            Kind::F32 | Kind::F64 => info.kind,
            Kind::U8 if info.kind.is_colour() => AttributeKind::ByteColour,
            Kind::U16 if info.kind.is_colour() => AttributeKind::ShortColour,
            _ if info.kind.is_colour() => AttributeKind::WholeColour,
            _ if velocity_attribute(std::slice::from_ref(info)).is_some() => AttributeKind::Number,
            Kind::I8 | Kind::I16 | Kind::I32 | Kind::U8 | Kind::U16 => AttributeKind::Signed,
            Kind::U32 => AttributeKind::Unsigned,
            Kind::I64 | Kind::U64 => AttributeKind::Wide,
        }
    }

    /// Calls `put` for each number in `rows` rows, starting at row `first`, with the number's index
    /// in this range and its value. The order is row by row.
    ///
    /// # Panics
    /// If the array has fewer rows.
    pub fn read(&self, first: usize, rows: usize, put: impl FnMut(usize, f64)) {
        // SAFETY: `each` passes only addresses of the array's numbers.
        self.each(first, rows, |at| unsafe { self.load(at) }, put);
    }

    /// Like [`read`](Self::read), but exact for integers that f64 cannot represent. Values above
    /// the greatest i64 become the greatest i64.
    ///
    /// # Panics
    /// If the array has fewer rows.
    pub fn read_whole(&self, first: usize, rows: usize, put: impl FnMut(usize, i64)) {
        // SAFETY: `each` passes only addresses of the array's numbers.
        self.each(first, rows, |at| unsafe { self.load_whole(at) }, put);
    }

    /// Calls `put` for each number in `rows` rows, starting at row `first`, with the number's index
    /// in this range and the result of `load`.
    fn each<T>(
        &self,
        first: usize,
        rows: usize,
        load: impl Fn(*const u8) -> T,
        mut put: impl FnMut(usize, T),
    ) {
        assert!(first.checked_add(rows).is_some_and(|end| end <= self.rows), "rows out of range");
        let mut number = 0;
        for row in first..first + rows {
            for column in 0..self.columns {
                let [row_stride, column_stride] = self.strides;
                let offset = row as isize * row_stride + column as isize * column_stride;
                // SAFETY: the row and the column exist, and `BoundArray` keeps the array alive.
                put(number, load(unsafe { self.first.offset(offset) }));
                number += 1;
            }
        }
    }

    /// Loads the number at an address.
    ///
    /// # Safety
    /// `at` must be the address of one of the array's numbers.
    #[inline(always)]
    unsafe fn load(&self, at: *const u8) -> f64 {
        // SAFETY: the caller upholds this function's contract.
        unsafe {
            match self.kind {
                Kind::F32 => load_number!(f32, at, self.aligned).into(),
                Kind::F64 => load_number!(f64, at, self.aligned),
                _ => self.load_whole(at) as f64,
            }
        }
    }

    /// Loads the integer at an address.
    ///
    /// # Safety
    /// `at` must be the address of one of the array's numbers.
    #[inline(always)]
    unsafe fn load_whole(&self, at: *const u8) -> i64 {
        // SAFETY: the caller upholds this function's contract.
        unsafe {
            match self.kind {
                Kind::F32 => load_number!(f32, at, self.aligned) as i64,
                Kind::F64 => load_number!(f64, at, self.aligned) as i64,
                Kind::I8 => load_number!(i8, at, self.aligned).into(),
                Kind::I16 => load_number!(i16, at, self.aligned).into(),
                Kind::I32 => load_number!(i32, at, self.aligned).into(),
                Kind::I64 => load_number!(i64, at, self.aligned),
                Kind::U8 => load_number!(u8, at, self.aligned).into(),
                Kind::U16 => load_number!(u16, at, self.aligned).into(),
                Kind::U32 => load_number!(u32, at, self.aligned).into(),
                Kind::U64 => i64::try_from(load_number!(u64, at, self.aligned)).unwrap_or(i64::MAX),
            }
        }
    }
}

/// Reads positions or velocities: an array of shape (N, 3).
pub fn vectors<'py>(name: &str, object: &Bound<'py, PyAny>) -> PyResult<BoundArray<'py>> {
    let bound = bind_array(name, object, Types::Floats)?;
    let shape = bound.array.shape();
    if shape.len() != 2 || shape[1] != 3 {
        let way = match *shape {
            [3, _] => "; use .T",
            [_, 2] => "; for particles in a plane, add a column of zeros",
            _ => "",
        };
        return Err(InputError::new_err(format!(
            "{name}: must be an array of shape (N, 3), not {}{way}",
            shape_text(shape)
        )));
    }
    Ok(bound)
}

/// Reads one or several values per particle: an array of shape (N,) or (N, K) of floats or
/// integers.
pub fn columns<'py>(name: &str, object: &Bound<'py, PyAny>) -> PyResult<BoundArray<'py>> {
    let bound = bind_array(name, object, Types::Numbers)?;
    let shape = bound.array.shape();
    if !(1..=2).contains(&shape.len()) || bound.numbers.columns == 0 {
        return Err(InputError::new_err(format!(
            "{name}: must be an array of shape (N,) or (N, K), not {}",
            shape_text(shape)
        )));
    }
    Ok(bound)
}

/// Returns an error if an array does not have one row for each of the `particles`.
pub fn check_length(name: &str, bound: &BoundArray<'_>, particles: usize) -> PyResult<()> {
    if bound.numbers.rows == particles {
        return Ok(());
    }
    let rows = bound.numbers.rows;
    Err(InputError::new_err(format!("{name}: has {rows} rows for {particles} particles")))
}

/// Formats a shape as Python does, such as (3, 4) or (5,).
fn shape_text(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => format!("({})", shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}

fn bind_array<'py>(
    name: &str,
    object: &Bound<'py, PyAny>,
    types: Types,
) -> PyResult<BoundArray<'py>> {
    let array = as_array(name, object)?;
    let dtype = array.dtype();
    if array.hasattr("mask")? {
        let way = match (dtype.kind(), types) {
            (b'f', _) => ".filled(numpy.nan)",
            (_, Types::Floats) => ".astype(\"float32\").filled(numpy.nan)",
            (_, Types::Numbers) => ".filled with a value for the masked particles",
        };
        return Err(PyTypeError::new_err(format!("{name}: the array has a mask; use {way}")));
    }
    let dtype_name = || dtype.str().map_or_else(|_| "another type".into(), |text| text.to_string());
    let kind = Kind::of(dtype.kind(), dtype.itemsize());
    let kind = match kind.filter(|kind| types == Types::Numbers || kind.is_float()) {
        Some(kind) => kind,
        None => {
            let way = match dtype.kind() {
                b'V' => "numpy.lib.recfunctions.structured_to_unstructured",
                // Tensors of torch, for example, have `float` instead of `astype`.
                _ if !object.hasattr("astype")? && object.hasattr("float")? => ".float()",
                _ => ".astype(\"float32\")",
            };
            let wanted = match types {
                Types::Floats => "numbers of type float32 or float64",
                Types::Numbers => "numbers of type float32 or float64, or integers",
            };
            return Err(PyTypeError::new_err(format!(
                "{name}: must contain {wanted}, not {}; use {way}",
                dtype_name()
            )));
        }
    };
    if dtype.is_native_byteorder() == Some(false) {
        return Err(PyTypeError::new_err(format!(
            "{name}: the numbers are byte-swapped ({}); use .astype(\"{}\")",
            dtype_name(),
            kind.name(),
        )));
    }
    let (shape, strides) = (array.shape(), array.strides());
    let extent = |axis: usize| {
        (shape.get(axis).copied().unwrap_or(1), strides.get(axis).copied().unwrap_or(0))
    };
    let ((rows, row_stride), (columns, column_stride)) = (extent(0), extent(1));
    // SAFETY: the type of `array` guarantees that the object is a NumPy array.
    let first = unsafe { (*array.as_array_ptr()).fields.data.cast_const().cast::<u8>() };
    let aligned = array.is_aligned();
    let numbers =
        Numbers { first, rows, columns, strides: [row_stride, column_stride], kind, aligned };
    Ok(BoundArray { array, numbers })
}

/// Returns the object itself if it is a NumPy array, and otherwise a NumPy array that shares its
/// memory.
fn as_array<'py>(name: &str, object: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyUntypedArray>> {
    let py = object.py();
    if let Ok(array) = object.cast::<PyUntypedArray>() {
        return Ok(array.clone());
    }
    let numpy = py.import("numpy")?;
    let conversion_error = |error: PyErr| {
        let of =
            object.getattr("dtype").map_or_else(|_| String::new(), |dtype| format!(" of {dtype}"));
        let what = format!(
            "{name}: {}{of} cannot be read as an array: {}",
            type_of(object),
            error.value(py)
        );
        PyTypeError::new_err(what)
    };
    let array = if object.hasattr("__dlpack__")? {
        let device = object.call_method0("__dlpack_device__").map_err(conversion_error)?;
        check_device(name, object, device.extract()?)?;
        numpy.call_method1("from_dlpack", (object,)).map_err(conversion_error)?
    } else if object.hasattr("__cuda_array_interface__")? {
        return Err(on_device(name, object, "a CUDA device"));
    } else if object.hasattr("__array_interface__")? {
        numpy.call_method1("asarray", (object,)).map_err(conversion_error)?
    } else {
        let view = py.import("builtins")?.call_method1("memoryview", (object,));
        let view = view.map_err(|_| {
            // Fields of Taichi, for example, have `to_numpy`.
            let has_way = object.hasattr("to_numpy").unwrap_or(false);
            let way = if has_way { ".to_numpy()" } else { "numpy.asarray" };
            PyTypeError::new_err(format!(
                "{name}: must be an array, not {}; try {way}",
                type_of(object)
            ))
        })?;
        numpy.call_method1("asarray", (view,)).map_err(conversion_error)?
    };
    array.cast_into::<PyUntypedArray>().map_err(|_| {
        PyTypeError::new_err(format!("{name}: {} cannot be read as an array", type_of(object)))
    })
}

fn type_of(object: &Bound<'_, PyAny>) -> String {
    object.get_type().name().map_or_else(|_| "an object".into(), |name| name.to_string())
}

/// Returns an error if the CPU cannot read the memory of an array.
fn check_device(name: &str, object: &Bound<'_, PyAny>, (kind, _): (i32, i32)) -> PyResult<()> {
    if HOST.contains(&kind) {
        return Ok(());
    }
    let device = match object.getattr("device") {
        Ok(device) => device.str()?.to_string(),
        Err(_) => format!("a device of DLPack type {kind}"),
    };
    Err(on_device(name, object, &device))
}

fn on_device(name: &str, object: &Bound<'_, PyAny>, device: &str) -> PyErr {
    PyTypeError::new_err(format!(
        "{name}: {} is on {device}; use .cpu() to copy it to the CPU",
        type_of(object)
    ))
}
