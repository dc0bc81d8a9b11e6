//! A mesh's file, from its name to its last byte: whatever can be refused is refused before the work, and
//! whatever fails later leaves nothing behind.

use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::mesh::Mesh;

use super::bytes::open_bytes;
use super::{CoordinateWidth, ReadError, ReadFault, WriteError, WriteFault};
use super::{obj, ply, stl, vtk, vtp};

/// What holds a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum MeshFormat {
    Ply,
    Obj,
    Vtk,
    Vtp,
    Stl,
}

impl fmt::Display for MeshFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ply => ".ply",
            Self::Obj => ".obj",
            Self::Vtk => ".vtk",
            Self::Vtp => ".vtp",
            Self::Stl => ".stl",
        })
    }
}

impl MeshFormat {
    /// The extensions, for messages.
    pub const KNOWN: &'static str = ".ply, .obj, .vtk, .vtp and .stl";

    /// By the extension, in upper or lower case.
    #[must_use]
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "ply" => Some(Self::Ply),
            "obj" => Some(Self::Obj),
            "vtk" => Some(Self::Vtk),
            "vtp" => Some(Self::Vtp),
            "stl" => Some(Self::Stl),
            _ => None,
        }
    }

    /// Whether it has a place for normals of vertices.
    #[must_use]
    pub fn holds_normals(self) -> bool {
        self != Self::Stl
    }

    /// Whether it has a place for velocities and other values of vertices.
    #[must_use]
    pub fn holds_attributes(self) -> bool {
        matches!(self, Self::Ply | Self::Vtk | Self::Vtp)
    }

    /// Whether coordinates can be wider than f32.
    #[must_use]
    pub fn holds_f64(self) -> bool {
        self != Self::Stl
    }

    /// Writes all of `mesh` that the format has a place for.
    ///
    /// # Errors
    /// Those of `out`, and [`io::ErrorKind::InvalidInput`] for more than the format can number.
    ///
    /// # Panics
    /// If normals or attributes are not of the vertices' number, or a triangle names a missing vertex.
    pub fn write(self, out: &mut dyn Write, mesh: &Mesh, width: CoordinateWidth) -> io::Result<()> {
        match self {
            Self::Ply => ply::write_mesh(out, mesh, width),
            Self::Obj => obj::write_mesh(out, mesh, width),
            Self::Vtk => vtk::write_mesh(out, mesh, width),
            Self::Vtp => vtp::write_mesh(out, mesh, width),
            Self::Stl => stl::write_mesh(out, mesh, width),
        }
    }

    /// Reads a whole file.
    ///
    /// # Errors
    /// For damage, and for what the format allows but its reader does not know; never panics.
    pub fn read(self, bytes: &[u8]) -> Result<Mesh, ReadFault> {
        match self {
            Self::Ply => ply::read_mesh(bytes),
            Self::Obj => obj::read_mesh(bytes),
            Self::Vtk => vtk::read_mesh(bytes),
            Self::Vtp => vtp::read_mesh(bytes),
            Self::Stl => stl::read_mesh(bytes),
        }
    }
}

/// Reads the mesh in `path`, whose extension says the format; it may be gzipped.
///
/// # Errors
/// Whatever [`MeshFormat::read`] or the system refuses, and [`ReadFault::UnknownExtension`].
pub fn read_mesh(path: &Path) -> Result<Mesh, ReadError> {
    let unknown = || ReadError::new(path, ReadFault::UnknownExtension { known: MeshFormat::KNOWN });
    let format = MeshFormat::of(path).ok_or_else(unknown)?;
    format.read(&open_bytes(path)?).map_err(|fault| ReadError::new(path, fault))
}

/// Whether an output may take the place of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Replace {
    /// No: what is there stays.
    Refuse,
    /// Yes, in one step, once the new file is whole.
    Allow,
}

/// A file that is ready to take a mesh.
///
/// Dropped without [`write`](Self::write), or when that fails, it leaves nothing.
#[derive(Debug)]
pub struct MeshOutput {
    /// As it was given, for messages.
    path: PathBuf,
    format: MeshFormat,
    target: Target,
}

#[derive(Debug)]
enum Target {
    /// Beside `place`, to be moved there.
    Temporary { file: NamedTempFile, place: PathBuf, replace: Replace },
    /// A pipe or a device, which is there and stays there.
    Direct,
}

impl MeshOutput {
    /// Makes sure, before the work, that a mesh can be written to `path`: that its extension names a format, that
    /// it is free or may be replaced, and that a file can be created in its folder, by creating one.
    ///
    /// Pipes and devices are written directly, and need no extension: they take .ply.
    ///
    /// # Errors
    /// [`WriteFault::UnknownExtension`], [`WriteFault::Exists`], and [`WriteFault::Io`] where the system refuses.
    pub fn prepare(path: &Path, replace: Replace) -> Result<Self, WriteError> {
        let fail = |fault: WriteFault| WriteError::new(path, fault);
        let found = metadata(path).map_err(|e| fail(e.into()))?;
        let format = MeshFormat::of(path);
        let unknown = || fail(WriteFault::UnknownExtension { known: MeshFormat::KNOWN });
        if is_direct(path, found.as_ref()) {
            let format = match path.extension() {
                Some(_) => format.ok_or_else(unknown)?,
                None => MeshFormat::Ply,
            };
            return Ok(Self { path: path.to_owned(), format, target: Target::Direct });
        }
        let format = format.ok_or_else(unknown)?;
        if found.is_some_and(|metadata| metadata.is_dir()) {
            return Err(fail(io::Error::from(io::ErrorKind::IsADirectory).into()));
        }
        if replace == Replace::Refuse && path.symlink_metadata().is_ok() {
            return Err(fail(WriteFault::Exists));
        }
        // Through a link, what it leads to is replaced, and not the link.
        let place = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let file = temporary_beside(&place).map_err(|e| fail(e.into()))?;
        Ok(Self { path: path.to_owned(), format, target: Target::Temporary { file, place, replace } })
    }

    /// What the extension says.
    #[must_use]
    pub fn format(&self) -> MeshFormat {
        self.format
    }

    /// The file that is written before it gets its name: what an interrupt leaves behind.
    #[must_use]
    pub fn temporary(&self) -> Option<&Path> {
        match &self.target {
            Target::Temporary { file, .. } => Some(file.path()),
            Target::Direct => None,
        }
    }

    /// Writes `mesh`, waits until it is on disk, and gives the file its name. Returns its size in bytes.
    ///
    /// # Errors
    /// [`WriteFault::Io`] where the system refuses, [`WriteFault::Exists`] if the name was taken meanwhile, and
    /// [`WriteFault::Unsupported`] for more than the format can number.
    ///
    /// # Panics
    /// As [`MeshFormat::write`].
    pub fn write(self, mesh: &Mesh, width: CoordinateWidth) -> Result<u64, WriteError> {
        let Self { path, format, target } = self;
        let written = match target {
            Target::Direct => OpenOptions::new()
                .write(true)
                .open(&path)
                .and_then(|mut file| write_counted(&mut file, format, mesh, width)),
            Target::Temporary { mut file, place, replace } => {
                write_counted(file.as_file_mut(), format, mesh, width).and_then(|bytes| {
                    file.as_file().sync_all()?;
                    match replace {
                        Replace::Allow => file.persist(place)?,
                        Replace::Refuse => file.persist_noclobber(place)?,
                    };
                    Ok(bytes)
                })
            }
        };
        written.map_err(|fault| WriteError::new(&path, fault_of(fault)))
    }
}

/// What is at `path`, through links; nothing if its name is free.
fn metadata(path: &Path) -> io::Result<Option<fs::Metadata>> {
    match path.metadata() {
        Ok(metadata) => Ok(Some(metadata)),
        Err(fault) if fault.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(fault) => Err(fault),
    }
}

/// Whether the output is to be written where it is: /dev/stdout may be a file, but has no room beside it.
fn is_direct(path: &Path, found: Option<&fs::Metadata>) -> bool {
    found.is_some_and(|found| !found.is_dir() && (!found.is_file() || path.starts_with("/dev")))
}

/// In the same folder, so that it can be moved there in one step; with the permissions of any new file.
fn temporary_beside(place: &Path) -> io::Result<NamedTempFile> {
    let folder = place.parent().filter(|folder| !folder.as_os_str().is_empty());
    let mut builder = tempfile::Builder::new();
    builder.prefix(".meniscus-").suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The system takes away what the user's mask says.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder.unwrap_or(Path::new(".")))
}

fn write_counted(
    file: &mut File,
    format: MeshFormat,
    mesh: &Mesh,
    width: CoordinateWidth,
) -> io::Result<u64> {
    let mut counted = Counted { out: BufWriter::new(file), bytes: 0 };
    format.write(&mut counted, mesh, width)?;
    counted.flush()?;
    Ok(counted.bytes)
}

/// A refusal of the format's writer has no number of the system's.
fn fault_of(fault: io::Error) -> WriteFault {
    match (fault.kind(), fault.raw_os_error()) {
        (io::ErrorKind::AlreadyExists, _) => WriteFault::Exists,
        (io::ErrorKind::InvalidInput, None) => WriteFault::Unsupported(fault.to_string()),
        _ => WriteFault::Io(fault),
    }
}

struct Counted<W> {
    out: W,
    bytes: u64,
}

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let written = self.out.write(buffer)?;
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
