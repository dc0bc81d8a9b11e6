//! NumPy's .npz: a zip archive of .npy arrays, one a quantity, all with a row for every particle.
//!
//! Arrays that are merely stored (`np.savez`) are read where they lie; where one is compressed
//! (`np.savez_compressed`), all are unpacked. The archive's checksums are verified either way.

use std::io::Read;

use zip::result::ZipError;
use zip::{CompressionMethod, ZipArchive};

use crate::particles::AttributeInfo;

use super::bytes::{Bytes, Kept, Passing, Unpacked, Unpacking, unpacked_limit};
use super::columns::{Column, ColumnStore, Rows};
use super::names::{Quantity, quantities};
use super::npy::{Header, shown};
use super::{ParticleFile, ReadFault, malformed};

/// Bytes that are unpacked at once.
const CHUNK: u64 = 1 << 18;
/// No header of an array of numbers is longer.
const LONGEST_HEADER: u64 = 1 << 16;
/// Wider rows are no value of a particle.
const MOST_COMPONENTS: u64 = 64;

/// Reads the arrays' headers and finds the position among them: an array (N, 3) called `pos`,
/// `position`, `x` or the like, three arrays `x`, `y`, `z`, or the only one that is (N, 3).
///
/// Every other array of N rows of numbers is an attribute; `vx`, `vy` and `vz` are one.
///
/// # Errors
/// [`ReadFault::Compression`] for an archive that is damaged or unpacks beyond all reason;
/// [`ReadFault::Unsupported`] where no position is found, and for compression and encryption that
/// are not known; [`ReadFault::Malformed`] for arrays that do not parse or fit;
/// [`ReadFault::Scratch`] where they are unpacked into a scratch file that fails.
pub fn read_particles(bytes: Bytes, unpacking: Unpacking) -> Result<ParticleFile, ReadFault> {
    let arrays = unless_changed(&bytes, arrays(&bytes))?;
    let (position, others) = position_among(&arrays)?;
    let rows = arrays[position.columns[0].array].header.shape[0];
    let fits = |place: &Place| arrays[place.array].header.shape[0] == rows;
    if !position.columns.iter().all(fits) {
        return Err(malformed(0, format!("the arrays of {} differ in length", position.name)));
    }
    for place in &position.columns {
        arrays[place.array].header.expect_position()?;
    }
    let attributes: Vec<_> = others.into_iter().filter(|q| q.columns.iter().all(fits)).collect();

    let mut needed = vec![false; arrays.len()];
    for place in position.columns.iter().chain(attributes.iter().flat_map(|q| &q.columns)) {
        needed[place.array] = true;
    }
    let (unpacked, starts) = unless_changed(&bytes, unpack(&bytes, &arrays, &needed, unpacking))?;
    let column = |place: &Place| {
        let header = &arrays[place.array].header;
        header.column(starts[place.array] + header.start, place.component)
    };
    let columns = |found: &Found| found.columns.iter().map(column).collect::<Vec<_>>();
    let position: [Column; 3] = columns(&position).try_into().expect("found with three");
    let attributes = attributes.iter().map(|found| {
        let columns = columns(found);
        (AttributeInfo { name: found.name.clone(), components: columns.len() }, columns)
    });
    let attributes = attributes.collect();
    let bytes = unpacked.map_or(bytes, Bytes::Kept);
    let particles: ColumnStore =
        ColumnStore::new(bytes, Rows::All(rows as usize), position, attributes);
    Ok(ParticleFile::new(particles, "NumPy .npz"))
}

/// An array of numbers in rows.
struct Array {
    name: String,
    /// The array's number in the archive.
    entry: usize,
    header: Header,
    /// Where it lies in the file, if it is merely stored.
    stored_at: Option<u64>,
    /// Unpacked, header included.
    bytes: u64,
}

/// A column of an array.
#[derive(Clone, Copy)]
struct Place {
    array: usize,
    component: usize,
}

/// One quantity, and where its components are.
struct Found {
    name: String,
    columns: Vec<Place>,
}

type Archive<'a> = ZipArchive<Passing<'a>>;

fn archive(bytes: &Bytes) -> Result<Archive<'_>, ReadFault> {
    ZipArchive::new(Passing::new(bytes.view(), 0)).map_err(fault)
}

/// Passes on what was read or found wrong, unless the file has changed meanwhile.
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

/// All arrays of numbers that have rows of values.
fn arrays(bytes: &Bytes) -> Result<Vec<Array>, ReadFault> {
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
        let header = Header::read(head[..].into()).map_err(|fault| match fault {
            // Of the array, where else a byte is the file's.
            ReadFault::Unsupported(_) => fault,
            fault => malformed(stored_at.unwrap_or(0) as usize, format!("array {name}: {fault}")),
        })?;
        let components = header.components();
        if !header.is_numeric()
            || header.shape.is_empty()
            || !(1..=MOST_COMPONENTS).contains(&components)
        {
            continue;
        }
        if header.data_bytes().checked_add(header.start as u64) != Some(size) {
            let what = format!("array {name} of shape {} has {size} bytes", shown(&header.shape));
            return Err(malformed(stored_at.unwrap_or(0) as usize, what));
        }
        arrays.push(Array { name, entry, header, stored_at, bytes: size });
    }
    Ok(arrays)
}

/// The position, and all that is not.
fn position_among(arrays: &[Array]) -> Result<(Found, Vec<Found>), ReadFault> {
    // A vector's columns are named so that they belong together.
    let mut names = Vec::new();
    let mut places = Vec::new();
    let mut others = Vec::new();
    for (array, Array { name, header, .. }) in arrays.iter().enumerate() {
        let components = header.components() as usize;
        let columns = (0..components).map(|component| Place { array, component });
        match components {
            1 => names.push(name.clone()),
            3 => names.extend(["x", "y", "z"].map(|axis| format!("{name}.{axis}"))),
            _ => {
                others.push(Found { name: name.clone(), columns: columns.collect() });
                continue;
            }
        }
        places.extend(columns);
    }
    let found = |q: Quantity| Found {
        name: q.name,
        columns: q.columns.iter().map(|&c| places[c]).collect(),
    };
    if let Some((position, rest)) = quantities(&names) {
        return Ok((found(position), rest.into_iter().map(found).chain(others).collect()));
    }
    let vectors: Vec<_> =
        (0..arrays.len()).filter(|&array| arrays[array].header.components() == 3).collect();
    let [array] = vectors[..] else {
        let listed = arrays.iter().map(|a| format!("{} {}", a.name, shown(&a.header.shape)));
        let listed: Vec<_> = listed.take(20).collect();
        let listed = if listed.is_empty() { "none".to_owned() } else { listed.join(", ") };
        let what = format!(
            "no array of positions; save it as pos, of shape (N, 3). Arrays of numbers: {listed}"
        );
        return Err(ReadFault::Unsupported(what));
    };
    let columns = [0, 1, 2].map(|component| Place { array, component }).to_vec();
    let alone = arrays
        .iter()
        .enumerate()
        .filter(|(other, a)| *other != array && a.header.components() == 1);
    let alone = alone.map(|(array, a)| Found {
        name: a.name.clone(),
        columns: vec![Place { array, component: 0 }],
    });
    let others = alone.chain(others).collect();
    Ok((Found { name: arrays[array].name.clone(), columns }, others))
}

/// Verifies what is needed. Returns where each array starts, in the file or in what had to be
/// unpacked.
fn unpack(
    bytes: &Bytes,
    arrays: &[Array],
    needed: &[bool],
    unpacking: Unpacking,
) -> Result<(Option<Kept>, Vec<usize>), ReadFault> {
    let needed = || arrays.iter().enumerate().filter(|(index, _)| needed[*index]);
    let in_place = needed().all(|(_, array)| array.stored_at.is_some());
    let total = needed().fold(0u64, |sum, (_, array)| sum.saturating_add(array.bytes));
    if !in_place && total > unpacked_limit(bytes.view().len() as u64) {
        return Err(ReadFault::Compression(format!(
            "it unpacks to {total} bytes, more than is reasonable"
        )));
    }
    let mut archive = archive(bytes)?;
    let mut unpacked = Unpacked::new(unpacking);
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
            return Err(damaged(format!("not of {} bytes", array.bytes)));
        }
    }
    Ok((if in_place { None } else { Some(unpacked.finish()?) }, starts))
}
