//! Input files: which reader opens which, and whether a file holds particles or a mesh.

use std::path::{Path, PathBuf};

use crate::particles::{AttributeInfo, Particles, velocity_attribute};

use super::bytes::{Bytes, Unpacking, open_bytes, open_bytes_within};
use super::{ParticleFile, ReadError, ReadFault, bgeo, bi4, npy, npz, ply, vtk, vtp, xyz};

/// The extensions that [`open_particles`] knows, in the words of a message.
pub const KNOWN: &str = ".bgeo, .bhclassic, .bi4, .csv, .h5, .h5part, .hdf, .hdf5, .npy, .npz, .ply, .pvtp, .pvtu, .txt, .vtk, .vtkhdf, .vtp, .vtu, .xyz, and .gz after any of them";

/// Names of VTK's flags of points that are copies, or hidden.
const GHOSTS: [&str; 2] = ["vtkGhostType", "vtkGhostLevels"];
/// Name of PySPH's flag of particles that are copies.
pub(super) const TAG: &str = "tag";

/// The particles that are wanted of an input that may hold others too, and what of them.
#[derive(Debug, Clone, Copy, Default)]
pub struct Wanted<'a> {
    /// Name of their type, as the input spells it; without one gas, a fluid, or the only type that there is.
    pub particle_type: Option<&'a str>,
    /// Attributes that have to be there. A format that reads all at once has others too.
    pub attributes: WantedAttributes<'a>,
}

/// Attributes that are wanted of particles.
#[derive(Debug, Clone, Copy, Default)]
pub enum WantedAttributes<'a> {
    /// All that there are.
    #[default]
    All,
    /// The velocity.
    Velocity,
    /// Attributes of these names, `velocity` being whatever the particles call so.
    Named(&'a [String]),
}

impl WantedAttributes<'_> {
    /// Tells for each of an input's attributes whether it is to be read. All are, where one that is wanted is not there: whoever wants it will say
    /// what is.
    #[must_use]
    pub fn among(&self, infos: &[AttributeInfo]) -> Vec<bool> {
        let velocity = velocity_attribute(infos);
        let number = |name: &String| {
            let named = infos.iter().position(|info| info.name == *name);
            named.or(velocity.filter(|_| name == "velocity"))
        };
        let wanted: Option<Vec<usize>> = match self {
            Self::All => None,
            Self::Velocity => Some(velocity.into_iter().collect()),
            Self::Named(names) => names.iter().map(number).collect(),
        };
        let reads = |(number, info): (usize, &AttributeInfo)| {
            let is_flag = GHOSTS.contains(&info.name.as_str()) || info.name == TAG;
            is_flag || wanted.as_ref().is_none_or(|wanted| wanted.contains(&number))
        };
        infos.iter().enumerate().map(reads).collect()
    }
}

/// Opens a particle file with the reader that its extension names, in upper or lower case.
///
/// A gzipped file opens under its plain name as well as with `.gz` appended.
///
/// # Errors
/// [`ReadFault::UnknownExtension`] before the file is touched; else what the reader finds wrong with it.
pub fn open_particles(path: &Path, unpacking: Unpacking) -> Result<ParticleFile, ReadError> {
    open_wanted(path, Wanted::default(), unpacking)
}

/// Opens a particle file like [`open_particles`], for the particles that are wanted.
///
/// # Errors
/// As [`open_particles`], and [`ReadFault::Unsupported`] where there is no such type of particles.
pub fn open_wanted(path: &Path, wanted: Wanted, unpacking: Unpacking) -> Result<ParticleFile, ReadError> {
    let file = read(path, wanted, unpacking)?;
    Ok(GHOSTS.iter().fold(file, ParticleFile::without))
}

/// Refuses a type of particles in a file without such.
pub(super) fn no_types(name: &str) -> ReadFault {
    ReadFault::Unsupported(format!("its particles are of one type, and none is called {name}"))
}

impl ParticleFile {
    /// Leaves out the particles that the attribute `flag` marks, and that.
    fn without(mut self, flag: &&str) -> Self {
        let is_it = |info: &AttributeInfo| info.name == *flag && info.components == 1;
        if let Some(index) = self.particles.attributes().iter().position(is_it) {
            self.ghosts += self.particles.leave_out(index);
        }
        self
    }
}

fn read(path: &Path, wanted: Wanted, unpacking: Unpacking) -> Result<ParticleFile, ReadError> {
    let fail = |fault| ReadError::new(path, fault);
    let (file, step) = file_and_step(path);
    let reader = reader_for(file).ok_or_else(|| fail(ReadFault::UnknownExtension { known: KNOWN }))?;
    let bytes = open_bytes_within(file, unpacking)?;
    if let (Some(name), Reader::OneFile(_) | Reader::Pieces(_)) = (wanted.particle_type, &reader) {
        return Err(fail(no_types(name)));
    }
    match reader {
        Reader::Steps(read) => read(file, bytes, step, wanted, unpacking),
        Reader::OneFile(read) => read(bytes, unpacking).map_err(fail),
        Reader::Pieces(open) => open(path, bytes, unpacking),
    }
}

/// The file, and which of the frames in it, where it holds several: `sim.h5part#12`.
#[must_use]
pub fn file_and_step(path: &Path) -> (&Path, Option<u64>) {
    let cut = path.to_str().and_then(|text| {
        let (file, step) = text.rsplit_once('#')?;
        let holds_steps = matches!(reader_for(Path::new(file)), Some(Reader::Steps(_)));
        Some((Path::new(file), step.parse().ok().filter(|_| holds_steps)?))
    });
    cut.map_or((path, None), |(file, step)| (file, Some(step)))
}

/// The numbers of the frames in a file, in order; none where it is one frame.
///
/// # Errors
/// [`ReadError`] where the file may hold several and cannot be read.
pub fn steps(path: &Path) -> Result<Vec<u64>, ReadError> {
    match reader_for(path) {
        #[cfg(feature = "hdf5")]
        Some(Reader::Steps(_)) => {
            super::h5::steps(open_bytes(path)?).map_err(|fault| ReadError::new(path, fault))
        }
        _ => Ok(Vec::new()),
    }
}

/// Whether a file's extension names a format of particles.
#[must_use]
pub fn is_known(path: &Path) -> bool {
    reader_for(path).is_some()
}

/// Whether a file holds a mesh rather than particles: by its extension, or by its faces where the format
/// serves both.
///
/// # Errors
/// [`ReadError`] where a file that may be either cannot be read.
pub fn holds_mesh(path: &Path) -> Result<bool, ReadError> {
    let has_faces = match extension(path).as_deref() {
        Some("obj" | "stl" | "usd" | "usdc") => return Ok(true),
        Some("ply") => ply::has_faces,
        Some("vtk") => vtk::has_faces,
        Some("vtp") => vtp::has_faces,
        Some("pvtp") => return vtp::parallel::has_faces(path),
        #[cfg(feature = "hdf5")]
        Some("hdf" | "vtkhdf") => {
            return super::h5::has_faces(open_bytes(path)?).map_err(|fault| ReadError::new(path, fault));
        }
        _ => return Ok(false),
    };
    has_faces(&open_bytes(path)?).map_err(|fault| ReadError::new(path, fault))
}

/// The pieces that a file names, whose particles are its own; none of another format.
///
/// # Errors
/// [`ReadError`] where the file cannot be read.
pub fn pieces_named(path: &Path) -> Result<Vec<PathBuf>, ReadError> {
    match extension(path).as_deref() {
        Some("pvtp" | "pvtu") => vtp::parallel::pieces(path),
        _ => Ok(Vec::new()),
    }
}

/// The file that holds a frame, and those of its other pieces that are there.
#[must_use]
pub fn files_of(path: &Path) -> Vec<PathBuf> {
    let (file, _) = file_and_step(path);
    let mut files = vec![file.to_owned()];
    // What is wrong with it is told of when it is read.
    let named = pieces_named(file).unwrap_or_default().into_iter();
    let snapshot = snapshot_pieces(file).filter(|pieces| *pieces > 1).map_or(Vec::new(), |pieces| {
        let base = snapshot_piece(file).map_or_else(|| file.to_owned(), |(base, _)| base);
        let piece = |number: u64| {
            let extension = base.extension().unwrap_or_default().to_string_lossy();
            base.with_extension(format!("{number}.{extension}"))
        };
        (0..pieces).map(piece).take_while(|piece| piece.exists()).collect()
    });
    let others = named.chain(snapshot).chain(bi4::later_pieces(file));
    files.extend(others.filter(|other| other != file && other.exists()));
    files
}

/// A file's name without its piece's number, and that number, where the name is like `base.0.hdf5`.
#[must_use]
pub fn snapshot_piece(path: &Path) -> Option<(PathBuf, u64)> {
    let (rest, extension) = path.file_name()?.to_str()?.rsplit_once('.')?;
    let (base, digits) = rest.rsplit_once('.').filter(|_| matches!(extension, "h5" | "hdf5"))?;
    let number = digits.bytes().all(|byte| byte.is_ascii_digit()).then(|| digits.parse().ok())??;
    Some((path.with_file_name(format!("{base}.{extension}")), number))
}

/// The number of files that the snapshot of one of them is in; `None` of anything else.
#[cfg(feature = "hdf5")]
#[must_use]
pub fn snapshot_pieces(path: &Path) -> Option<u64> {
    matches!(extension(path).as_deref(), Some("h5" | "hdf5")).then(|| super::h5::pieces_of(path))?
}

/// The number of files that a snapshot is in, which this build does not read.
#[cfg(not(feature = "hdf5"))]
#[must_use]
pub fn snapshot_pieces(_: &Path) -> Option<u64> {
    None
}

/// In lower case, without `.gz`.
fn extension(path: &Path) -> Option<String> {
    let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
    let (_, extension) = name.strip_suffix(".gz").unwrap_or(&name).rsplit_once('.')?;
    Some(extension.to_owned())
}

enum Reader {
    OneFile(fn(Bytes, Unpacking) -> Result<ParticleFile, ReadFault>),
    /// Frame by frame, or all of a file that is one.
    Steps(StepReader),
    /// The file may be one of several.
    Pieces(fn(&Path, Bytes, Unpacking) -> Result<ParticleFile, ReadError>),
}

/// Reads the frame of a number, or the only one.
type StepReader = fn(&Path, Bytes, Option<u64>, Wanted, Unpacking) -> Result<ParticleFile, ReadError>;

#[cfg(feature = "hdf5")]
const HDF5: StepReader = super::h5::open_particles;
#[cfg(not(feature = "hdf5"))]
const HDF5: StepReader = |path, _, _, _, _| Err(ReadError::new(path, no_hdf5()));

/// Refuses HDF5, in a build that does not read it.
#[cfg(not(feature = "hdf5"))]
pub(super) fn no_hdf5() -> ReadFault {
    ReadFault::Unsupported("HDF5 is read by a meniscus built with the feature hdf5".to_owned())
}

fn reader_for(path: &Path) -> Option<Reader> {
    Some(Reader::OneFile(match extension(path)?.as_str() {
        // `.bgeo.sc` is recognised to say what to do instead.
        "bgeo" | "bhclassic" | "sc" => |bytes, _| bgeo::read_particles(bytes),
        "bi4" => return Some(Reader::Pieces(bi4::open_particles)),
        "csv" | "txt" => xyz::read_text,
        "h5" | "h5part" | "hdf" | "hdf5" | "vtkhdf" => return Some(Reader::Steps(HDF5)),
        "npy" => |bytes, _| npy::read_particles(bytes),
        "npz" => npz::read_particles,
        "ply" => ply::read_particles,
        "pvtp" | "pvtu" => return Some(Reader::Pieces(vtp::parallel::open_particles)),
        "vtk" => vtk::read_particles,
        "vtp" | "vtu" => vtp::read_particles,
        "xyz" => xyz::read_particles,
        _ => return None,
    }))
}
