//! Reads snapshots of SWIFT and GADGET, which consist of one or more files. A snapshot has a group
//! for each type of particles. `PartType0` is gas.
//!
//! `base.0.hdf5`, `base.1.hdf5` and so on form one snapshot. Each file stores the number of files.
//! If there is also a file `base.hdf5`, its data sets are views of the other files, and only its
//! header is read.

use std::path::{Path, PathBuf};

use hdf5_reader::group::Group;
use rayon::prelude::*;

use crate::io::bytes::{Unpacking, open_bytes, open_bytes_within};
use crate::io::error::ADD_Z;
use crate::io::frame_files::snapshot_piece;
use crate::io::wanted::{WantedParticles, WantedPieces};
use crate::io::{ParticleFile, Pieces, ReadError, ReadFault, malformed};
use crate::particles::Particles;
use crate::particles::condition::Where;

use super::file::{H5File, convert_error, number, numbers, time_of};
use super::table::{H5Array, H5Table, named_type, no_type, types};

/// Name of the group that contains the header.
pub const HEADER: &str = "Header";
/// Prefix of the names of groups of particles.
const TYPE: &str = "PartType";
const GAS: &str = "PartType0";
const POSITION: &str = "Coordinates";
const FORMAT: &str = "SWIFT or GADGET HDF5";

/// The header of one file of a snapshot.
#[derive(Debug, Clone, PartialEq)]
struct SnapshotHeader {
    /// Number of particles of each type in this file.
    in_this_file: Vec<u64>,
    /// Number of particles of each type in all files.
    total: Option<Vec<u64>>,
    files: u64,
    time: Option<f64>,
    box_size: Option<[f64; 3]>,
    unit_metres: Option<f64>,
    /// Whether the data sets of this file are views of other files.
    is_view: bool,
}

/// Whether the root has the header of a snapshot.
pub fn has_snapshot_header(root: &Group) -> bool {
    root.group(HEADER).is_ok_and(|header| header.attribute("NumPart_ThisFile").is_ok())
}

impl SnapshotHeader {
    fn read(root: &Group) -> Result<Self, ReadFault> {
        let header = convert_error(root.group(HEADER))?;
        let counts = |name: &str| -> Option<Vec<u64>> {
            let counts = numbers(&header, name)?.into_iter();
            Some(counts.map(|count| if count >= 0.0 { count as u64 } else { 0 }).collect())
        };
        let in_this_file = counts("NumPart_ThisFile").ok_or_else(|| {
            malformed(0, "the numbers of particles are missing (NumPart_ThisFile)")
        })?;
        let high = counts("NumPart_Total_HighWord").unwrap_or_default();
        let total = counts("NumPart_Total").map(|low| {
            let high = high.into_iter().chain(std::iter::repeat(0));
            low.into_iter().zip(high).map(|(low, high)| low.saturating_add(high << 32)).collect()
        });
        let files =
            number(&header, "NumFilesPerSnapshot").filter(|files| *files >= 1.0).unwrap_or(1.0);
        let box_size = numbers(&header, "BoxSize").and_then(|edges| match *edges {
            [edge] => Some([edge; 3]),
            [x, y, z] => Some([x, y, z]),
            _ => None,
        });
        Ok(Self {
            in_this_file,
            total,
            files: files as u64,
            time: time_of(&header),
            box_size: box_size.filter(|edges| edges.iter().all(|edge| edge.is_finite())),
            unit_metres: unit_metres(root, &header),
            is_view: number(&header, "Virtual").is_some_and(|is| is != 0.0),
        })
    }

    /// Names of the types that have particles in any file.
    fn types(&self) -> Vec<String> {
        let counts = self.total.as_ref().unwrap_or(&self.in_this_file);
        (0..)
            .zip(counts)
            .filter(|(_, count)| **count > 0)
            .map(|(kind, _)| format!("{TYPE}{kind}"))
            .collect()
    }

    /// Whether a file with the header `other` can belong to the same snapshot.
    fn is_like(&self, other: &Self) -> bool {
        self.files == other.files && self.time == other.time && self.total == other.total
    }
}

/// The unit of length in metres. SWIFT stores it in the group `Units`, GADGET in the group `Header`
/// or `Parameters`.
fn unit_metres(root: &Group, header: &Group) -> Option<f64> {
    let swift = || number(&root.group("Units").ok()?, "Unit length in cgs (U_L)");
    let gadget = || {
        let name = "UnitLength_in_cm";
        number(header, name).or_else(|| number(&root.group("Parameters").ok()?, name))
    };
    swift().or_else(gadget).map(|centimetres| centimetres / 100.0).filter(|metres| *metres > 0.0)
}

/// Reads all files of the snapshot to which `file` belongs. The particles are of the type that
/// `wanted` names, by default gas.
pub fn open_particles(
    path: &Path,
    file: H5File,
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    let fail = |fault| ReadError::new(path, fault);
    let header = file.root().and_then(|root| SnapshotHeader::read(&root)).map_err(fail)?;
    let kind = snapshot_type(&header.types(), wanted.conditions).map_err(fail)?;
    let read = if header.files == 1 && !header.is_view {
        read_piece(file, &kind, wanted, &header, None).map_err(fail)?
    } else {
        drop(file);
        let paths = piece_paths(path, &header)?;
        let opened = wanted.pieces.of(paths.len()).max(1) as u64;
        let share = Unpacking { in_memory: unpacking.in_memory / opened, ..unpacking };
        let open = |(number, piece): (usize, &PathBuf)| {
            if !wanted.pieces.includes(number) {
                return Ok(ParticleFile::new(Pieces::default(), FORMAT));
            }
            let bytes = open_bytes_within(piece, share)?;
            let read = H5File::open(bytes, share).and_then(|file| {
                let own = SnapshotHeader::read(&file.root()?)?;
                read_piece(file, &kind, wanted, &own, Some(&header))
            });
            read.map_err(|fault| ReadError::new(piece, fault))
        };
        // Read all files before returning, so that the error is always that of the first faulty
        // piece.
        let all: Vec<_> = paths.par_iter().enumerate().map(open).collect();
        let all = all.into_iter().collect::<Result<Vec<_>, _>>()?;
        let filled = all.iter().find(|file| !file.particles.is_empty());
        let (unread, left_out) =
            filled.map_or_else(Default::default, |f| (f.unread.clone(), f.left_out.clone()));
        let all = all.into_iter().map(|file| file.particles).collect();
        let joined =
            Pieces::join(all).map_err(|(piece, fault)| ReadError::new(&paths[piece], fault))?;
        let format = "SWIFT or GADGET HDF5 in pieces";
        ParticleFile { unread, left_out, ..ParticleFile::new(joined, format) }
    };
    if let WantedPieces::All = wanted.pieces {
        check_total(&header, &kind, read.particles.len()).map_err(fail)?;
    }
    let particle_types = types(header.types(), &kind);
    let SnapshotHeader { time, box_size, unit_metres, .. } = header;
    Ok(ParticleFile { time, box_size, unit_metres, particle_types, ..read })
}

/// The type that a condition names. Gas if no condition names a type.
fn snapshot_type(known: &[String], wanted: &[Where]) -> Result<String, ReadFault> {
    match named_type(known, wanted)? {
        Some(named) => Ok(named.to_owned()),
        None if known.iter().any(|name| name == GAS) => Ok(GAS.to_owned()),
        None => Err(no_type(known, GAS)),
    }
}

/// Checks that all files together contain the number of particles that their headers announce.
fn check_total(header: &SnapshotHeader, kind: &str, found: usize) -> Result<(), ReadFault> {
    let index: usize = kind[TYPE.len()..].parse().unwrap_or(usize::MAX);
    match header.total.as_ref().and_then(|total| total.get(index)) {
        Some(&total) if total != found as u64 => Err(malformed(
            0,
            format!(
                "the header announces {total} particles of {kind}, but the files contain \
                     {found}"
            ),
        )),
        _ => Ok(()),
    }
}

/// Reads the particles of one file of a snapshot. `own` is the header of this file. For a snapshot
/// of several files, `of` is the header of the file by which the snapshot was opened.
fn read_piece(
    file: H5File,
    kind: &str,
    wanted: WantedParticles,
    own: &SnapshotHeader,
    of: Option<&SnapshotHeader>,
) -> Result<ParticleFile, ReadFault> {
    if of.is_some_and(|of| !own.is_like(of)) {
        return Err(malformed(0, "the header of this file belongs to another snapshot"));
    }
    let index: usize = kind[TYPE.len()..].parse().unwrap_or(usize::MAX);
    let announced = own.in_this_file.get(index).copied().unwrap_or(0);
    if of.is_some() && announced == 0 {
        return Ok(ParticleFile::new(Pieces::default(), FORMAT));
    }
    let group = file.group(kind)?;
    let arrays = H5Array::by_name(&group)?;
    let missing =
        || malformed(0, format!("{kind} has no {POSITION} with three components; {ADD_Z}"));
    let table = H5Table::of_arrays(arrays, POSITION).ok_or_else(missing)?;
    if table.rows() != announced {
        let what = format!(
            "the header announces {announced} particles of {kind}, but the file \
                     contains {}",
            table.rows()
        );
        return Err(malformed(0, what));
    }
    drop(group);
    table.read(file, FORMAT, wanted.attributes)
}

/// The paths of the files of a snapshot. Returns an error if a file does not exist.
fn piece_paths(path: &Path, header: &SnapshotHeader) -> Result<Vec<PathBuf>, ReadError> {
    let base = snapshot_piece(path).filter(|(_, number)| !header.is_view && *number < header.files);
    let base = base.map_or_else(|| path.to_owned(), |(base, _)| base);
    let [stem, extension] =
        [base.file_stem(), base.extension()].map(|part| part.and_then(|part| part.to_str()));
    let unnamed = || {
        ReadFault::Unsupported(
            "the snapshot has several files; their names must be like base.0.hdf5".into(),
        )
    };
    let (stem, extension) = stem.zip(extension).ok_or_else(|| ReadError::new(path, unnamed()))?;
    let mut paths = Vec::new();
    for number in 0..header.files {
        let piece = path.with_file_name(format!("{stem}.{number}.{extension}"));
        // Stop at the first missing file, in case the header announces far too many files.
        piece.metadata().map_err(|fault| ReadError::new(&piece, fault.into()))?;
        paths.push(piece);
    }
    Ok(paths)
}

/// The number of files of the snapshot to which `path` belongs. `None` if it belongs to no
/// snapshot.
pub fn pieces_of(path: &Path) -> Option<u64> {
    let file = H5File::open(open_bytes(path).ok()?, Unpacking::in_memory()).ok()?;
    let root = file.root().ok().filter(has_snapshot_header)?;
    SnapshotHeader::read(&root).ok().map(|header| header.files)
}
