//! Opens input files with the reader of their format, and distinguishes particles from meshes.

use std::path::Path;

use rayon::prelude::*;

use super::blocks::open_blocks;
use super::bytes::{ByteView, Bytes, Unpacking, open_bytes, open_bytes_within, open_for_frame};
use super::collection::{FrameBlock, is_list};
pub use super::input_format::InputFormat;
use super::input_format::extension;
use super::joined::{check_colour_scales, check_distinct_files};
use super::pieces::join_files;
use super::text_format::TextHint;
use super::wanted::{WantedParticles, WantedPieces};
use super::{
    ParticleFile, ReadError, ReadFault, bi4, collection, houdini, json, npy, npz, ply, text_format,
    vtk, vtp,
};

macro_rules! known {
    ($hdf5:literal, $vtkhdf:literal) => {
        concat!(
            ".bgeo, .bgeo.sc, .bhclassic, .bi4, .csv, .dat, .dump, .extxyz, .geo, ",
            $hdf5,
            ".json, .lammpstrj, .npy, .npz, .ply, .pvtp, .pvtu, .txt, .vtk, ",
            $vtkhdf,
            ".vtm, .vtp, .vtpc, .vtpd, .vtu, .xyz, and .gz, .xz or .zst after any of them"
        )
    };
}

/// The extensions that [`open_particles`] supports, for a message.
#[cfg(feature = "hdf5")]
pub const KNOWN: &str = known!(".h5, .h5md, .h5part, .hdf, .hdf5, ", ".vtkhdf, ");
/// The extensions that [`open_particles`] supports, for a message.
#[cfg(not(feature = "hdf5"))]
pub const KNOWN: &str = known!("", "");

impl InputFormat {
    /// The extensions of all formats, for a message.
    pub const KNOWN: &'static str = KNOWN;
}

/// Opens a particle file with the reader for its extension. The case of the extension does not
/// matter.
///
/// A file compressed by gzip, xz or zstd can have its plain name, or the additional extension
/// `.gz`, `.xz` or `.zst`.
///
/// # Errors
/// [`ReadFault::UnknownExtension`] before the file is opened, and the errors of the reader.
pub fn open_particles(path: &Path, unpacking: Unpacking) -> Result<ParticleFile, ReadError> {
    open_wanted(path, WantedParticles::default(), unpacking)
}

/// Opens a particle file like [`open_particles`], but reads only the wanted particles. It skips
/// other types and pieces, and particles that fail a condition.
///
/// # Errors
/// The errors of [`open_particles`], [`ReadFault::Unsupported`] for a type of particles that does
/// not exist, and [`ReadFault::Selection`] for a condition that cannot be applied.
pub fn open_wanted(
    path: &Path,
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    let (file, step) = file_and_step(path);
    if is_list(file) {
        return collection::open_particles(path, file, step, wanted, unpacking);
    }
    if step.is_none()
        && let Some((blocks, format)) = blocks_of(file, wanted.format)?
    {
        // `wanted.format` is the format of the list, not of the files in it.
        let wanted = WantedParticles { format: None, ..wanted };
        let opened = open_blocks(path, &blocks, wanted, unpacking)?;
        return Ok(ParticleFile { format, ..opened });
    }
    let file = read(path, (file, step), wanted, unpacking)?.without_ghosts();
    file.selected(wanted.conditions, unpacking).map_err(|fault| ReadError::new(path, fault))
}

/// The blocks in a list of blocks and in its nested lists, and the name of the list's format.
/// `None` for other files. `format` overrides the format that the extension implies.
///
/// # Errors
/// [`ReadError`] if a list cannot be read.
pub(super) fn blocks_of(
    file: &Path,
    format: Option<InputFormat>,
) -> Result<Option<(Vec<FrameBlock>, &'static str)>, ReadError> {
    match format.or_else(|| InputFormat::of(file)) {
        Some(InputFormat::Pvtp) => vtp::parallel::blocks(file),
        _ => Ok(None),
    }
}

/// Opens a particle file like [`open_wanted`], but does not apply conditions to its particles. The
/// file must not be a list of frames or blocks.
///
/// # Errors
/// The errors of [`open_wanted`], except [`ReadFault::Selection`].
pub(super) fn open_unselected(
    path: &Path,
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    read(path, file_and_step(path), wanted, unpacking).map(ParticleFile::without_ghosts)
}

/// Opens several files as one set of particles, in order, with the attributes that all of them
/// have.
///
/// # Errors
/// The errors of [`open_wanted`], [`ReadFault::Twice`] for a file that is named twice,
/// [`ReadFault::ColourScale`] for colours of different scales, and [`ReadFault::Unsupported`] for
/// files with different units of length.
pub fn open_joined(
    paths: &[&Path],
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    if let [path] = paths {
        return open_wanted(path, wanted, unpacking);
    }
    join(paths, open_each(paths, wanted, unpacking, open_wanted)?, wanted)
}

/// Opens the wanted files with `open`, in parallel. The result has `None` for each file that is not
/// wanted.
///
/// # Errors
/// The error of the first file that cannot be opened, and [`ReadFault::Twice`] for a file that is
/// named twice.
pub(super) fn open_each<T: Send>(
    paths: &[&Path],
    wanted: WantedParticles,
    unpacking: Unpacking,
    open: impl Fn(&Path, WantedParticles, Unpacking) -> Result<T, ReadError> + Sync,
) -> Result<Vec<Option<T>>, ReadError> {
    check_distinct_files(paths.iter().copied())?;
    let count = paths.len().max(1) as u64;
    let share = Unpacking { in_memory: unpacking.in_memory / count, ..unpacking };
    // `wanted.pieces` selects among the files, so all pieces of each file are read.
    let whole = WantedParticles { pieces: WantedPieces::All, ..wanted };
    let open = |(number, path): (usize, &&Path)| {
        wanted.pieces.includes(number).then(|| open(path, whole, share)).transpose()
    };
    // All files are opened before errors are checked, so this function always returns the error of
    // the first faulty file.
    let files: Vec<_> = paths.par_iter().enumerate().map(open).collect();
    files.into_iter().collect()
}

/// Joins the opened files into one set of particles, in order. `None` stands for a file that was
/// not opened, or that holds no particles.
///
/// # Errors
/// [`ReadFault::ColourScale`] for colours of different scales, and [`ReadFault::Unsupported`] for
/// files with different units of length.
pub(super) fn join(
    paths: &[&Path],
    files: Vec<Option<ParticleFile>>,
    wanted: WantedParticles,
) -> Result<ParticleFile, ReadError> {
    check_colour_scales(paths, &files, wanted.attributes)?;
    check_units(paths, &files)?;
    join_files(files, wanted.pieces).map_err(|(file, fault)| ReadError::new(paths[file], fault))
}

/// Returns an error if two files have different units of length.
fn check_units(paths: &[&Path], files: &[Option<ParticleFile>]) -> Result<(), ReadError> {
    let mut units = paths.iter().zip(files).filter_map(|(path, file)| {
        let unit = file.as_ref()?.unit_metres;
        Some((path, unit))
    });
    let Some((first, of_first)) = units.next() else { return Ok(()) };
    let Some((other, of_other)) = units.find(|(_, unit)| *unit != of_first) else { return Ok(()) };
    let unit =
        |unit: Option<f64>| unit.map_or("no unit".to_owned(), |unit| format!("a unit of {unit} m"));
    let what = format!(
        "has {}, but {} has {}; only inputs with the same unit can be joined",
        unit(of_other),
        first.display(),
        unit(of_first)
    );
    Err(ReadError::new(*other, ReadFault::Unsupported(what)))
}

fn read(
    path: &Path,
    (file, step): (&Path, Option<u64>),
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    let fail = |fault| ReadError::new(path, fault);
    let format = wanted.format.or_else(|| InputFormat::of(file));
    let reader = reader(format.ok_or_else(|| fail(ReadFault::UnknownExtension { known: KNOWN }))?);
    let (bytes, stamp) = match step {
        Some(_) => open_for_frame(file, unpacking)?,
        None => (open_bytes_within(file, unpacking)?, None),
    };
    match reader {
        FormatReader::Text => {
            let hint = TextHint::of(file, wanted.format);
            let frame = (stamp.map(|stamp| (file, stamp)), step);
            text_format::read_particles(bytes, hint, frame, wanted.attributes, unpacking)
                .map_err(fail)
        }
        FormatReader::Steps(read) => read(path, bytes, step, wanted, unpacking),
        FormatReader::Arrays(read) => read(bytes, step, unpacking).map_err(fail),
        FormatReader::OneFile(_) | FormatReader::Pieces(_) if step.is_some() => {
            let what = "this format has a single frame; remove # and the number from the name";
            Err(fail(ReadFault::Unsupported(what.to_owned())))
        }
        FormatReader::OneFile(read) => read(bytes, unpacking).map_err(fail),
        FormatReader::Pieces(open) => open(path, bytes, wanted, unpacking),
    }
}

/// Splits `sim.h5part#12` into the file and the number of a frame in it.
#[must_use]
pub fn file_and_step(path: &Path) -> (&Path, Option<u64>) {
    let cut = path.to_str().and_then(|text| {
        let (file, step) = text.rsplit_once('#')?;
        use InputFormat::{Csv, Hdf5, Lammps, Npy, Npz, Xyz};
        let file = Path::new(file);
        let holds_steps = match InputFormat::of(file) {
            _ if is_list(file) => true,
            Some(Csv | Hdf5 | Lammps | Npy | Npz | Xyz) => true,
            // For other extensions, the caller may override the format. In this case, the number
            // after `#` is a step if a file exists at the path before `#`, and the whole path does
            // not exist.
            _ => file.is_file() && !path.exists(),
        };
        Some((file, step.parse().ok().filter(|_| holds_steps)?))
    });
    cut.map_or((path, None), |(file, step)| (file, Some(step)))
}

/// The numbers of the frames in a file, in order. Empty if the file contains a single frame.
/// `format` overrides the format that the extension implies.
///
/// # Errors
/// [`ReadError`] if the format can have several frames and the file cannot be read.
pub fn steps(path: &Path, format: Option<InputFormat>) -> Result<Vec<u64>, ReadError> {
    if is_list(path) {
        let frames = collection::listed(path)?.len() as u64;
        return Ok((0..frames).filter(|_| frames > 1).collect());
    }
    use InputFormat::{Csv, Lammps, Xyz};
    match format.or_else(|| InputFormat::of(path)) {
        Some(Csv | Lammps | Xyz) => {
            text_format::steps(open_bytes(path)?, TextHint::of(path, format))
                .map_err(|fault| ReadError::new(path, fault))
        }
        #[cfg(feature = "hdf5")]
        Some(InputFormat::Hdf5) => {
            super::h5::steps(open_bytes(path)?).map_err(|fault| ReadError::new(path, fault))
        }
        Some(InputFormat::Npy) => {
            npy::steps(open_bytes(path)?.view()).map_err(|fault| ReadError::new(path, fault))
        }
        Some(InputFormat::Npz) => {
            npz::steps(&open_bytes(path)?).map_err(|fault| ReadError::new(path, fault))
        }
        _ => Ok(Vec::new()),
    }
}

/// Whether a file in a folder may be a frame, judged by its extension. A .json file may contain
/// anything, so the function returns false for it, and the user must name such a file.
pub fn is_known(path: &Path) -> bool {
    InputFormat::of(path).is_some_and(|format| format != InputFormat::Json)
}

/// Whether a file contains a mesh instead of particles. If the format supports both, cells with an
/// area or a volume make the file a mesh. Otherwise, the extension decides.
///
/// # Errors
/// [`ReadError`] if the format supports both and the file cannot be read.
pub fn holds_mesh(path: &Path) -> Result<bool, ReadError> {
    let extension = extension(path);
    type HasFaces = fn(ByteView) -> Result<bool, ReadFault>;
    let has_faces: HasFaces = match extension.as_deref() {
        Some("abc" | "glb" | "obj" | "stl" | "usd" | "usdc") => return Ok(true),
        Some("ply") => ply::has_faces,
        Some("vtk") => vtk::has_faces,
        Some("vtp" | "vtu") => vtp::has_faces,
        Some("pvtp" | "pvtu") => return vtp::parallel::has_faces(path),
        #[cfg(feature = "hdf5")]
        Some("hdf" | "vtkhdf") => {
            return super::h5::has_faces(open_bytes(path)?)
                .map_err(|fault| ReadError::new(path, fault));
        }
        _ => return Ok(false),
    };
    let bytes = open_bytes(path)?;
    let bytes = match extension.as_deref() {
        Some("vtk") => vtk::whole_file_if_text(bytes, Unpacking::in_memory()),
        Some("vtp" | "vtu") => vtp::whole_file_if_inline(bytes),
        _ => Ok(bytes),
    };
    bytes.and_then(|bytes| has_faces(bytes.view())).map_err(|fault| ReadError::new(path, fault))
}

enum FormatReader {
    /// Reads text files, which may contain several frames.
    Text,
    OneFile(fn(Bytes, Unpacking) -> Result<ParticleFile, ReadFault>),
    /// Reads arrays, which may contain several frames.
    Arrays(fn(Bytes, Option<u64>, Unpacking) -> Result<ParticleFile, ReadFault>),
    /// Reads files that contain one or several frames.
    Steps(StepReader),
    /// Reads files with a single frame, which may be divided into several files.
    Pieces(fn(&Path, Bytes, WantedParticles, Unpacking) -> Result<ParticleFile, ReadError>),
}

/// Reads the frame with the given number. Without a number, the file must have a single frame.
type StepReader =
    fn(&Path, Bytes, Option<u64>, WantedParticles, Unpacking) -> Result<ParticleFile, ReadError>;

#[cfg(feature = "hdf5")]
const HDF5: StepReader = super::h5::open_particles;
#[cfg(not(feature = "hdf5"))]
const HDF5: StepReader = |path, _, _, _, _| Err(ReadError::new(path, no_hdf5()));

/// The error for HDF5 input in a build without HDF5.
#[cfg(not(feature = "hdf5"))]
pub(super) fn no_hdf5() -> ReadFault {
    let what = "this build of meniscus cannot read HDF5; build it with the Cargo feature hdf5";
    ReadFault::Unsupported(what.to_owned())
}

fn reader(format: InputFormat) -> FormatReader {
    use InputFormat::{
        Bgeo, Bi4, Csv, Hdf5, Json, Lammps, Npy, Npz, Ply, Pvtp, Tecplot, Vtk, Vtp, Xyz,
    };
    match format {
        Bgeo => FormatReader::Pieces(houdini::open_particles),
        Bi4 => FormatReader::Pieces(bi4::open_particles),
        Csv | Lammps | Tecplot | Xyz => FormatReader::Text,
        Hdf5 => FormatReader::Steps(HDF5),
        Json => FormatReader::OneFile(json::read_particles),
        Npy => FormatReader::Arrays(|bytes, step, _| npy::read_particles(bytes, step)),
        Npz => FormatReader::Arrays(npz::read_particles),
        Ply => FormatReader::OneFile(ply::read_particles),
        Pvtp => FormatReader::Pieces(vtp::parallel::open_particles),
        Vtk => FormatReader::OneFile(vtk::read_particles),
        Vtp => FormatReader::OneFile(vtp::read_particles),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::io::compression::EXTENSIONS;

    /// Extensions whose reader, in a build without HDF5, only returns an error that says how to
    /// build with HDF5.
    const ADVISED: [&str; 4] = ["h5", "h5md", "h5part", "hdf5"];

    #[test]
    fn messages_list_exactly_the_extensions_that_have_a_reader() {
        let known: BTreeSet<&str> = KNOWN
            .split(&[',', ' '][..])
            .filter_map(|word| word.rsplit_once('.'))
            .map(|(_, extension)| extension)
            .collect();
        let (_, arms) =
            include_str!("input_format.rs").split_once("match extension(path)?").unwrap();
        let (arms, _) = arms.split_once("_ => return None").unwrap();
        let arms = arms
            .lines()
            .filter_map(|line| line.split_once("=>"))
            .flat_map(|(arm, _)| arm.split('"'));
        let is_extension =
            |word: &&str| !word.is_empty() && word.chars().all(|c| c.is_ascii_alphanumeric());
        let read: BTreeSet<&str> = arms.filter(is_extension).collect();
        for extension in &read {
            for compressed in EXTENSIONS {
                let path = format!("a.{extension}.{compressed}");
                assert!(InputFormat::of(Path::new(&path)).is_some(), "{path}");
            }
            assert!(
                known.contains(extension) || ADVISED.contains(extension),
                "{extension} has a reader, but messages do not list it"
            );
        }
        let read = read.into_iter().chain(EXTENSIONS).collect();
        assert!(known.is_subset(&read) && known.len() > 12, "{known:?} and {read:?}");
        assert_eq!(known.contains("h5"), cfg!(feature = "hdf5"));
    }
}
