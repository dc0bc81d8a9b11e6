//! Reads NumPy's .npz: a zip archive of .npy arrays. Each array is a quantity, with one row per
//! particle.
//!
//! The reader needs the arrays of the position, of the attributes and of the times. If all of these
//! arrays are uncompressed (`np.savez`), they are read in place. If any of them is compressed
//! (`np.savez_compressed`), the reader first unpacks or copies all of them. In both cases, the
//! reader verifies their checksums.

use std::io::Read;

use zip::result::ZipError;
use zip::{CompressionMethod, ZipArchive};

use crate::particles::AttributeInfo;

use super::bytes::{
    Bytes, PrivateBytes, SequentialReader, UnpackBuffer, Unpacking, unpacked_limit,
};
use super::columns::{Column, ColumnStore, ParticleRows};
use super::fields::{
    Arrangement, ColumnIndex, LocatedQuantity, NamedArray, advice_on_plane, arrange, only_vector,
    shown,
};
use super::names::time_arrays;
use super::npy::{NpyHeader, POSITION};
use super::{ParticleFile, ReadFault, malformed};

/// Number of bytes that are unpacked per step.
const CHUNK: u64 = 1 << 18;
/// Maximum length, in bytes, of the header of a numeric array.
const LONGEST_HEADER: u64 = 1 << 16;
/// Maximum number of arrays that an error lists.
const LISTED: usize = 20;

/// Reads the headers of the arrays, and finds the position.
///
/// The position is an array of shape (N, 3), (3, N) or, for several frames, (T, N, 3), called
/// `pos`, `position`, `x` or similar, or three arrays `x`, `y`, `z`. If no array has such a name,
/// the position is the only vector that does not have the name of another quantity. `step` is the
/// number of a frame.
///
/// Every other numeric array with N rows is an attribute. `vx`, `vy` and `vz` form one attribute.
/// An array `time`, `times` or `t` with one number per frame contains the times.
///
/// # Errors
/// [`ReadFault::Compression`] for a damaged archive or a compression ratio that is too high,
/// [`ReadFault::Unsupported`] if no position is found and for unknown compression or encryption,
/// [`ReadFault::Malformed`] for invalid arrays, and [`ReadFault::Scratch`] if the scratch file
/// cannot be written.
pub fn read_particles(
    bytes: Bytes,
    step: Option<u64>,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadFault> {
    let arrays = unless_changed(&bytes, arrays(&bytes))?;
    let contents = Contents::of(&arrays);
    let arranged = arranged(&contents.fields)?.ok_or_else(|| no_position(&arrays, &contents))?;
    let frame = arranged.frame(step)?;
    let Arrangement { rows, frames, axes, position, attributes, left_out } = arranged;
    for place in &position.places {
        let (array, member) = contents.sources[place.field];
        arrays[array].header.expect_position(member)?;
    }
    let mut needed = vec![false; arrays.len()];
    for place in position.places.iter().chain(attributes.iter().flat_map(|found| &found.places)) {
        needed[contents.sources[place.field].0] = true;
    }
    let times = times(&arrays, frames.unwrap_or(1));
    times.into_iter().for_each(|array| needed[array] = true);
    let (unpacked, starts) = unless_changed(&bytes, unpack(&bytes, &arrays, &needed, unpacking))?;
    let column = |place: &ColumnIndex| {
        let (array, member) = contents.sources[place.field];
        let header = &arrays[array].header;
        let at = starts[array] + header.start;
        header.column(at, member, axes[place.field], frame, place.component)
    };
    let columns = |found: &LocatedQuantity| found.places.iter().map(column).collect::<Vec<_>>();
    let position: [Column; 3] = columns(&position).try_into().expect("three components");
    let attributes = attributes.iter().map(|found| {
        let columns = columns(found);
        (AttributeInfo::new(&found.name, columns.len()), columns)
    });
    let attributes = attributes.collect();
    let bytes = unpacked.map_or(bytes, Bytes::Kept);
    let time = times.map(|array| arrays[array].number(&bytes, starts[array], frame)).transpose()?;
    let time = time.flatten().filter(|time| time.is_finite());
    let particles: ColumnStore =
        ColumnStore::new(bytes, ParticleRows::All(rows as usize), position, attributes);
    Ok(ParticleFile { time, left_out, ..ParticleFile::new(particles, "NumPy .npz") })
}

/// The index of the array that contains the times of `frames` frames. Integers are not times,
/// because they usually count steps.
fn times(arrays: &[NpzArray], frames: u64) -> Option<usize> {
    let has_all = |array: &NpzArray| {
        let header = &array.header;
        header.list(0).is_some_and(|column| column.scalar.is_float()) && header.elements() == frames
    };
    let called = |name: &str| arrays.iter().position(|array| array.name == name && has_all(array));
    time_arrays().find_map(called)
}

/// The numbers of the frames in an archive whose arrays have several frames. Empty for a single
/// frame.
///
/// # Errors
/// The errors of [`read_particles`] about headers.
pub fn steps(bytes: &Bytes) -> Result<Vec<u64>, ReadFault> {
    let arrays = unless_changed(bytes, arrays(bytes))?;
    let arranged = arranged(&Contents::of(&arrays).fields)?;
    Ok(arranged.map_or(Vec::new(), |arranged| arranged.steps()))
}

/// An array of the archive.
struct NpzArray {
    name: String,
    /// The index of the array's file in the archive.
    entry: usize,
    header: NpyHeader,
    /// Byte offset of the array's file within the archive. `None` if the array is compressed.
    stored_at: Option<u64>,
    /// Unpacked size, in bytes, including the header.
    bytes: u64,
}

impl NpzArray {
    /// The number at `index` of an array with at most one axis, whose file starts at byte `start`.
    /// `None` for other arrays.
    fn number(&self, bytes: &Bytes, start: usize, index: u64) -> Result<Option<f64>, ReadFault> {
        let Some(column) = self.header.list(start + self.header.start) else { return Ok(None) };
        let at = column.offset + index as usize * column.stride;
        let number = bytes.view().read(at..at + column.stride)?;
        Ok(Some(column.number(&number)))
    }
}

/// The named fields of all arrays: plain arrays, and members of structures.
struct Contents {
    fields: Vec<NamedArray>,
    /// The array number and the member number of each field.
    sources: Vec<(usize, usize)>,
}

impl Contents {
    fn of(arrays: &[NpzArray]) -> Self {
        let (mut fields, mut sources) = (Vec::new(), Vec::new());
        let structures = arrays.iter().filter(|array| array.header.is_structured()).count();
        for (number, NpzArray { name, header, .. }) in arrays.iter().enumerate() {
            for (member, mut field) in header.fields(name).into_iter().enumerate() {
                if field.shape.is_empty() {
                    continue;
                }
                // If the file has several structured arrays, prefix each field with its array's
                // name, so that it is clear to which array a position belongs.
                if header.is_structured() && structures > 1 {
                    field.name = format!("{name}.{}", field.name);
                }
                fields.push(field);
                sources.push((number, member));
            }
        }
        Self { fields, sources }
    }
}

/// Finds the position by its name, or as the only vector.
fn arranged(fields: &[NamedArray]) -> Result<Option<Arrangement>, ReadFault> {
    if let Some(arranged) = arrange(fields)? {
        return Ok(Some(arranged));
    }
    let Some(only) = only_vector(fields) else { return Ok(None) };
    let mut fields = fields.to_vec();
    fields[only].name = POSITION.to_owned();
    arrange(&fields)
}

/// The error if no position was found, with the contents of the archive and a suggestion.
fn no_position(arrays: &[NpzArray], contents: &Contents) -> ReadFault {
    let list = |all: Vec<String>| {
        let more = all.len().saturating_sub(LISTED);
        let listed = all.into_iter().take(LISTED).collect::<Vec<_>>().join(", ");
        match (listed.is_empty(), more) {
            (true, _) => "none".to_owned(),
            (_, 0) => listed,
            _ => format!("{listed} and {more} more"),
        }
    };
    let numbers = contents.fields.iter().map(|f| format!("{} {}", f.name, shown(&f.shape)));
    let numbers = list(numbers.collect());
    let pickled = arrays.iter().filter(|array| array.header.is_pickled());
    let pickled: Vec<_> = pickled.map(|array| array.name.clone()).collect();
    let mut what = format!(
        "no array of positions; save one as pos, with shape (N, 3). Arrays of numbers: {numbers}"
    );
    if let Some(advice) = advice_on_plane(&contents.fields, arranged) {
        what += &format!("; {advice}");
    }
    if !pickled.is_empty() {
        let is_pysph = ["particles", "solver_data"].iter().all(|n| pickled.iter().any(|p| p == n));
        what += &format!(". Pickled Python objects, which are not supported: {}", list(pickled));
        if is_pysph {
            what += ". This is a PySPH file. PySPH writes HDF5 if h5py is installed; to convert \
                     this file, call pysph.solver.output.dump with a name that ends in .hdf5";
        }
    }
    ReadFault::Unsupported(what)
}

type Archive<'a> = ZipArchive<SequentialReader<'a>>;

fn archive(bytes: &Bytes) -> Result<Archive<'_>, ReadFault> {
    ZipArchive::new(SequentialReader::new(bytes.view(), 0)).map_err(fault)
}

/// Returns `read`, except that an error becomes [`ReadFault::Changed`] if the file has changed.
fn unless_changed<T>(bytes: &Bytes, read: Result<T, ReadFault>) -> Result<T, ReadFault> {
    read.or_else(|fault| {
        bytes.view().check()?;
        Err(fault)
    })
}

fn fault(error: ZipError) -> ReadFault {
    match error {
        ZipError::UnsupportedArchive(what) => {
            ReadFault::Unsupported(format!("zip archive: {what}"))
        }
        other => ReadFault::Compression(other.to_string()),
    }
}

/// Reads the headers of all arrays. The size of a numeric array must match its header.
fn arrays(bytes: &Bytes) -> Result<Vec<NpzArray>, ReadFault> {
    let mut archive = archive(bytes)?;
    let mut arrays = Vec::new();
    for entry in 0..archive.len() {
        let mut file = archive.by_index(entry).map_err(fault)?;
        let name = file.name().map_err(fault)?.into_owned();
        let Some(name) = name.strip_suffix(".npy").map(str::to_owned) else { continue };
        let stored = file.compression() == CompressionMethod::Stored;
        let (stored_at, size) = (file.data_start().filter(|_| stored), file.size());
        let mut head = Vec::new();
        let damaged = |e: std::io::Error| ReadFault::Compression(format!("array {name}: {e}"));
        file.by_ref().take(LONGEST_HEADER).read_to_end(&mut head).map_err(damaged)?;
        let header = NpyHeader::read(head[..].into()).map_err(|fault| match fault {
            // `NpyHeader::read` reports offsets relative to the array, so the error must name the
            // array.
            ReadFault::Unsupported(_) => fault,
            fault => malformed(stored_at.unwrap_or(0) as usize, format!("array {name}: {fault}")),
        })?;
        if header.is_numeric() && header.data_bytes().checked_add(header.start as u64) != Some(size)
        {
            let what = format!("array {name} has shape {}, but {size} bytes", shown(&header.shape));
            return Err(malformed(stored_at.unwrap_or(0) as usize, what));
        }
        arrays.push(NpzArray { name, entry, header, stored_at, bytes: size });
    }
    Ok(arrays)
}

/// Unpacks the arrays for which `needed` is true if any of them is compressed, and verifies their
/// checksums in any case. Returns the start of each of these arrays, in the file or in the unpacked
/// bytes.
fn unpack(
    bytes: &Bytes,
    arrays: &[NpzArray],
    needed: &[bool],
    unpacking: Unpacking,
) -> Result<(Option<PrivateBytes>, Vec<usize>), ReadFault> {
    let needed = || arrays.iter().enumerate().filter(|(index, _)| needed[*index]);
    let in_place = needed().all(|(_, array)| array.stored_at.is_some());
    let total = needed().fold(0u64, |sum, (_, array)| sum.saturating_add(array.bytes));
    if !in_place && total > unpacked_limit(bytes.view().len() as u64) {
        return Err(ReadFault::Compression(format!(
            "the data expands to {total} bytes, too many for a file of {} bytes; save it without \
             compression",
            bytes.view().len()
        )));
    }
    let mut archive = archive(bytes)?;
    let mut unpacked = UnpackBuffer::new(unpacking);
    let mut starts = vec![0; arrays.len()];
    for (index, array) in needed() {
        let damaged =
            |what: String| ReadFault::Compression(format!("array {}: {what}", array.name));
        let mut file = archive.by_index(array.entry).map_err(fault)?;
        starts[index] = array.stored_at.filter(|_| in_place).unwrap_or(unpacked.len()) as usize;
        let mut chunk = Vec::new();
        let mut read = 0;
        loop {
            chunk.clear();
            file.by_ref()
                .take(CHUNK)
                .read_to_end(&mut chunk)
                .map_err(|e| damaged(e.to_string()))?;
            if chunk.is_empty() {
                break;
            }
            read += chunk.len() as u64;
            if read > array.bytes {
                break;
            }
            if !in_place {
                unpacked.push(&chunk)?;
            }
        }
        if read != array.bytes {
            return Err(damaged(format!("its unpacked size is not {} bytes", array.bytes)));
        }
    }
    Ok((if in_place { None } else { Some(unpacked.finish()?) }, starts))
}
