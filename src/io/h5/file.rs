//! Opens HDF5 files, with limits on the memory for their data.

use std::io;
use std::sync::Arc;

use hdf5_reader::error::{Error, Result as Parsed};
use hdf5_reader::group::Group;
use hdf5_reader::messages::HdfMessage;
use hdf5_reader::messages::layout::DataLayout;
use hdf5_reader::{Dataset, FilterRegistry, Hdf5File, OpenOptions, Storage, StorageBuffer};

use crate::io::bytes::{Bytes, Unpacking, unpacked_limit};
use crate::io::names::{TIMES, time_arrays};
use crate::io::{ReadFault, malformed};

use super::lzf;
use super::table::{H5Array, RowPart, scalar};

/// Maximum size, in bytes, of the cache of decoded chunks. The cache serves repeated reads of rows
/// in the same chunk.
const CHUNKS: u64 = 16 << 20;
/// Minimum size, in bytes, of a read after which the reader releases the input's memory for the
/// bytes that it read.
const LARGE: usize = 64 << 10;

/// An open file. All of its data sets must be dropped before [`into_bytes`](Self::into_bytes).
pub(super) struct H5File<'a> {
    hdf: Hdf5File,
    bytes: Arc<Bytes>,
    pub unpacking: Unpacking<'a>,
    /// Maximum number of bytes that the file's data may unpack to.
    pub limit: u64,
}

impl<'a> H5File<'a> {
    pub fn open(bytes: Bytes, unpacking: Unpacking<'a>) -> Result<Self, ReadFault> {
        let limit = unpacked_limit(bytes.view().len() as u64);
        let most = usize::try_from(limit).unwrap_or(usize::MAX);
        let mut filters = FilterRegistry::new();
        filters.register(lzf::ID, Box::new(|_, packed, _| lzf::unpack(packed)));
        let options = OpenOptions::default()
            .with_chunk_cache_bytes((unpacking.in_memory / 4).min(CHUNKS) as usize)
            .with_max_chunk_bytes(most)
            .with_max_read_bytes(most)
            .with_filter_registry(filters);
        let bytes = Arc::new(bytes);
        let storage = Arc::new(Ranges(Arc::clone(&bytes)));
        let hdf = convert_error(Hdf5File::from_storage_with_options(storage, options))?;
        let (needed, have) = (hdf.superblock().eof_address, bytes.view().len() as u64);
        if needed > have && needed < u64::MAX {
            return Err(ReadFault::Truncated { what: "HDF5".to_owned(), needed, have });
        }
        Ok(Self { hdf, bytes, unpacking, limit })
    }

    pub fn root(&self) -> Result<Group, ReadFault> {
        convert_error(self.hdf.root_group())
    }

    pub fn group(&self, path: &str) -> Result<Group, ReadFault> {
        convert_error(self.hdf.group(path))
    }

    /// Checks that the file has not changed since it was opened.
    ///
    /// # Errors
    /// [`ReadFault::Changed`] if the file has changed.
    pub fn check(&self) -> Result<(), ReadFault> {
        self.bytes.view().check()
    }

    /// Returns the file's bytes, from which columns can be read in place.
    pub fn into_bytes(self) -> Bytes {
        drop(self.hdf);
        Arc::into_inner(self.bytes).expect("all data sets were dropped")
    }

    /// Byte offset in the file of a data set's rows, which take `bytes` bytes in total. `None` if
    /// the rows are not contiguous in this file, or if a filter encodes them.
    pub fn contiguous_offset(&self, set: &Dataset, bytes: u64) -> Option<u64> {
        let header = self.hdf.get_or_parse_header(set.address()).ok()?;
        let is_external_or_filtered = |message: &HdfMessage| {
            matches!(message, HdfMessage::ExternalFiles(_) | HdfMessage::FilterPipeline(_))
        };
        let address = header.messages.iter().find_map(|message| match message {
            HdfMessage::DataLayout(message) => match message.layout {
                DataLayout::Contiguous { address, size } if size >= bytes => Some(address),
                _ => None,
            },
            _ => None,
        })?;
        let at = address.checked_add(self.hdf.superblock().base_address)?;
        let within = at.checked_add(bytes).is_some_and(|end| end <= self.bytes.view().len() as u64);
        (within && !header.messages.iter().any(is_external_or_filtered)).then_some(at)
    }
}

/// Numbers and names of compression filters that are not supported.
const FILTERS: [(&str, &str); 8] = [
    ("305", "LZO"),
    ("307", "bzip2"),
    ("32001", "Blosc"),
    ("32004", "LZ4"),
    ("32008", "bitshuffle"),
    ("32013", "ZFP"),
    ("32015", "Zstandard"),
    ("32026", "Blosc2"),
];

/// Converts an error of the HDF5 library.
pub(super) fn convert_error<T>(parsed: Parsed<T>) -> Result<T, ReadFault> {
    parsed.map_err(|error| match error {
        Error::Io(fault) => ReadFault::Io(fault),
        other => unsupported_in(&other).unwrap_or_else(|| malformed(0, other.to_string())),
    })
}

/// The layout class of virtual data sets, whose data is in other data sets (HDF5 file format
/// specification, "Data Layout message").
const VIRTUAL: u8 = 3;

/// The error for an unsupported filter or a virtual data set. `None` if the error has another
/// cause.
fn unsupported_in(error: &Error) -> Option<ReadFault> {
    match error {
        Error::Context { path, source } => match &**source {
            // The context of the error has the form "child 'name' at 0x320". Extract the name.
            Error::UnsupportedLayoutClass(VIRTUAL) => {
                let name = path.split('\'').nth(1).unwrap_or(path);
                Some(virtual_set(&format!("the data set {name:?}")))
            }
            source => unsupported_in(source),
        },
        Error::UnsupportedLayoutClass(VIRTUAL) => Some(virtual_set("a data set")),
        Error::UnsupportedFilter(which) => {
            let name = FILTERS.iter().find(|(number, _)| which.ends_with(&format!(" {number}")));
            let name = name.map_or(&**which, |(_, name)| name);
            Some(ReadFault::Unsupported(format!(
                "the data is compressed by {name}, which is not supported; rewrite it with gzip, \
                 for example by h5repack -f GZIP=4 OLD NEW"
            )))
        }
        _ => None,
    }
}

/// The error for a virtual data set.
fn virtual_set(what: &str) -> ReadFault {
    ReadFault::Unsupported(format!(
        "{what} is virtual: its data is in other HDF5 files, which h5dump -p lists; read these \
         files instead, or copy the data into one file, for example by h5repack -l CONTI OLD NEW"
    ))
}

/// The time that an attribute of a group contains.
pub(super) fn time_of(group: &Group) -> Option<f64> {
    TIMES.iter().find_map(|name| number(group, name)).filter(|time| time.is_finite())
}

/// The time that a data set of a group contains. If `frame` gives the number of the frame and the
/// number of all frames, the data set must contain one time per frame. Otherwise, it must contain a
/// single time.
pub(super) fn times_in(group: &Group, frame: Option<(u64, u64)>) -> Option<f64> {
    let (_, sets) = group.member_names().ok()?;
    let set = time_arrays().find_map(|name| {
        let name = sets.iter().find(|set| *set == name)?;
        group.dataset(name).ok()
    })?;
    let (frame, frames) = frame.unwrap_or((0, 1));
    let numbers = set.num_elements().ok()?;
    number_of(set, frame).filter(|time| numbers == frames && time.is_finite())
}

/// The number at `index` of a data set that has one axis or contains a single number.
pub(super) fn number_of(set: Dataset, index: u64) -> Option<f64> {
    let rows = match *set.shape() {
        [] | [1, 1] => 1,
        [rows] => rows,
        _ => return None,
    };
    let number = scalar(set.dtype())?;
    let array = H5Array::of(Arc::new(set), String::new(), number, rows, 1, RowPart::Row);
    let numbers = (index < rows).then(|| array.doubles([index, index + 1]).ok())??;
    numbers.first().copied()
}

/// The number that an attribute of a group contains.
pub(super) fn number(group: &Group, name: &str) -> Option<f64> {
    group.attribute(name).ok()?.read_as_f64().ok()
}

/// All numbers that an attribute of a group contains.
pub(super) fn numbers(group: &Group, name: &str) -> Option<Vec<f64>> {
    let attribute = group.attribute(name).ok()?;
    let whole = |values: Vec<i64>| values.into_iter().map(|value| value as f64).collect();
    let read = attribute.read_1d::<f64>();
    read.or_else(|_| {
        attribute.read_1d::<f32>().map(|values| values.into_iter().map(f64::from).collect())
    })
    .or_else(|_| attribute.read_1d::<i64>().map(whole))
    .or_else(|_| {
        attribute.read_1d::<u64>().map(|v| v.into_iter().map(|value| value as f64).collect())
    })
    .or_else(|_| attribute.read_1d::<i32>().map(|v| v.into_iter().map(f64::from).collect()))
    .or_else(|_| attribute.read_1d::<u32>().map(|v| v.into_iter().map(f64::from).collect()))
    .ok()
}

/// Gives the HDF5 library access to ranges of the file, without a cache.
struct Ranges(Arc<Bytes>);

impl Storage for Ranges {
    fn len(&self) -> u64 {
        self.0.view().len() as u64
    }

    fn read_range(&self, offset: u64, len: usize) -> Parsed<StorageBuffer> {
        let start = usize::try_from(offset).unwrap_or(usize::MAX);
        let range = start..start.saturating_add(len);
        if range.end > self.0.view().len() {
            let available = Storage::len(self).saturating_sub(offset);
            return Err(Error::UnexpectedEof { offset, needed: len as u64, available });
        }
        let read = match &*self.0 {
            Bytes::File(file) => {
                let mut read = vec![0; len];
                file.read_exact_at(offset, &mut read).map_err(io::Error::from)?;
                read
            }
            Bytes::Kept(kept) => {
                let read = kept[range.clone()].to_vec();
                if len >= LARGE {
                    kept.release(range);
                }
                read
            }
        };
        Ok(StorageBuffer::from_vec(read))
    }
}
