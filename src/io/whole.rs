//! Writes a file completely or not at all. As many errors as possible are found before the mesh is
//! computed, and a later error leaves no file behind.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crc32fast::Hasher;
use tempfile::NamedTempFile;

use crate::system::cancel::{COMPANION_SUFFIXES, remove_companions};
use crate::system::held;
use crate::system::past_cache::PastCache;

use super::beside::{FolderInProgress, lock_parent_folder};
use super::{WriteError, WriteFault};

/// Prefix of the names of temporary files, by which [`sweep`] recognises leftovers.
const PREFIX: &str = ".meniscus-";
const SUFFIX: &str = ".tmp";

/// Whether an output may replace an existing file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Replace {
    /// Refuses to replace an existing file.
    Refuse,
    /// Replaces an existing file atomically, once the new file is complete.
    Allow,
}

/// A file that is prepared for writing.
///
/// If it is dropped before [`write`](Self::write), or if `write` fails, no file remains.
#[derive(Debug)]
pub struct WholeFile {
    /// The path that the caller gave, for messages.
    path: PathBuf,
    target: WriteTarget,
}

#[derive(Debug)]
enum WriteTarget {
    /// A temporary file in the folder of `place`. A complete file is renamed to `place`.
    Temporary { file: NamedTempFile, place: PathBuf, replace: Replace },
    /// An existing pipe or device, which is written directly.
    Direct,
}

impl WholeFile {
    /// Checks, before any data is written, that `path` is free or may be replaced, and creates a
    /// temporary file in its folder. Pipes and devices are written directly.
    ///
    /// # Errors
    /// [`WriteFault::Exists`] if the file exists and may not be replaced, and [`WriteFault::Io`] if
    /// `path` is a folder or the temporary file cannot be created.
    pub fn prepare(path: &Path, replace: Replace) -> Result<Self, WriteError> {
        let fail = |fault: WriteFault| WriteError::new(path, fault);
        let found = metadata(path).map_err(|e| fail(e.into()))?;
        if is_direct(path, found.as_ref()) {
            return Ok(Self { path: path.to_owned(), target: WriteTarget::Direct });
        }
        if found.as_ref().is_some_and(fs::Metadata::is_dir) {
            return Err(fail(io::Error::from(io::ErrorKind::IsADirectory).into()));
        }
        if replace == Replace::Refuse && path.symlink_metadata().is_ok() {
            return Err(fail(WriteFault::Exists));
        }
        // If the path is a symbolic link, replace the link's target, not the link.
        let existing = found.and_then(|_| path.canonicalize().ok());
        let place = existing.unwrap_or_else(|| path.to_owned());
        let file = create_temporary(&place).map_err(|e| fail(e.into()))?;
        Ok(Self { path: path.to_owned(), target: WriteTarget::Temporary { file, place, replace } })
    }

    /// Whether the output is a pipe or a device, which needs no extension.
    pub fn is_direct(&self) -> bool {
        matches!(self.target, WriteTarget::Direct)
    }

    /// The path that the caller gave.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The final path of the file, with symbolic links resolved. `None` for a pipe or a device.
    pub(super) fn place(&self) -> Option<&Path> {
        match &self.target {
            WriteTarget::Temporary { place, .. } => Some(place),
            WriteTarget::Direct => None,
        }
    }

    /// The temporary file and the created folders, which an interrupt handler must remove.
    pub(crate) fn leftovers(&self, folders: &MadeFolders) -> Vec<PathBuf> {
        let folders = folders.paths().iter().map(PathBuf::as_path);
        self.temporary().into_iter().chain(folders).map(Path::to_owned).collect()
    }

    /// The temporary file, which an interrupt handler must remove.
    pub fn temporary(&self) -> Option<&Path> {
        match &self.target {
            WriteTarget::Temporary { file, .. } => Some(file.path()),
            WriteTarget::Direct => None,
        }
    }

    /// Writes the temporary file with `content`, waits until it is on disk, and renames it to its
    /// final path. Returns its size in bytes.
    pub fn write(
        self,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<u64, WriteError> {
        self.filled(content, None)?.keep()
    }

    /// Writes the temporary file with `content`, and computes its checksum.
    ///
    /// # Errors
    /// [`WriteFault::Io`] for errors of the system or of `content`, and [`WriteFault::Unsupported`]
    /// if `content` fails with [`io::ErrorKind::InvalidInput`].
    pub fn fill(
        self,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<FilledFile, WriteError> {
        self.filled(content, Some(Hasher::new()))
    }

    fn filled(
        mut self,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
        crc: Option<Hasher>,
    ) -> Result<FilledFile, WriteError> {
        let filled = match &mut self.target {
            WriteTarget::Direct => {
                let open = OpenOptions::new().write(true).open(&self.path);
                match open.and_then(|mut file| write_counted(&mut file, crc, content)) {
                    // If the reader of a pipe closes the pipe early, this is not an error.
                    Err(fault) if fault.kind() == io::ErrorKind::BrokenPipe => Ok((0, None)),
                    outcome => outcome,
                }
            }
            WriteTarget::Temporary { file, .. } => {
                write_counted_to_file(file.as_file(), crc, content)
            }
        };
        match filled {
            Ok((bytes, crc)) => Ok(FilledFile {
                file: self,
                bytes,
                crc: crc.map_or(0, Hasher::finalize),
                folder: None,
            }),
            Err(fault) => Err(WriteError::new(&self.path, fault_of(fault))),
        }
    }
}

/// A complete temporary file.
#[derive(Debug)]
pub struct FilledFile {
    file: WholeFile,
    bytes: u64,
    crc: u32,
    /// The folder of further files that this file names. It is renamed before this file.
    folder: Option<FolderInProgress>,
}

impl FilledFile {
    /// Adds the folder of the files that this file names. The folder is renamed before this file.
    pub(super) fn after(self, folder: FolderInProgress) -> Self {
        Self { crc: folder.checksum_after_list(self.crc, self.bytes), folder: Some(folder), ..self }
    }

    /// CRC-32 of the bytes of this file and of the files that it names. 0 for a pipe whose reader
    /// stopped early.
    pub fn crc(&self) -> u32 {
        self.crc
    }

    /// The file's size in bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Waits until the file is on disk, and renames it to its final path. Returns its size in
    /// bytes.
    ///
    /// # Errors
    /// [`WriteFault::Io`] if the file cannot be synced or renamed, and [`WriteFault::Exists`] if a
    /// file with this name was created meanwhile.
    pub fn keep(self) -> Result<u64, WriteError> {
        let Self { file: WholeFile { path, target }, bytes, folder, .. } = self;
        let kept = match target {
            WriteTarget::Direct => Ok(()),
            WriteTarget::Temporary { file, place, replace } => {
                let synced = file.as_file().sync_all();
                // Lock the parent folder, so that the folder of further files and the file that
                // names them come from the same process.
                let _lock = folder.as_ref().and_then(|_| lock_parent_folder(&place));
                let before =
                    |folder: FolderInProgress| folder.keep(&place, replace == Replace::Allow);
                synced.and_then(|()| folder.map_or(Ok(()), before)).and_then(|()| match replace {
                    Replace::Allow => file.persist(place).map(drop).map_err(Into::into),
                    Replace::Refuse => file.persist_noclobber(place).map(drop).map_err(Into::into),
                })
            }
        };
        kept.map(|()| bytes).map_err(|fault| WriteError::new(&path, fault_of(fault)))
    }
}

/// Atomically replaces a small file. The new file is not synced, so a power failure may lose it.
///
/// # Errors
/// If the temporary file cannot be created, written or renamed.
pub fn replace_small(path: &Path, content: &[u8]) -> io::Result<()> {
    let mut file = create_temporary(path)?;
    file.write_all(content)?;
    file.persist(path)?;
    Ok(())
}

/// Removes temporary files that killed processes left in `folder`. Temporary files of running
/// processes stay, because they are locked. On most network file systems, the locks also work for
/// processes on other machines.
pub fn sweep(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if let Some(file) = temporary_file_of(&path).filter(|file| !file.exists()) {
            remove_companions(&file);
            continue;
        }
        if !(name.starts_with(PREFIX) && name.ends_with(SUFFIX)) {
            continue;
        }
        // Hold the lock until the file is removed. A process that has just created this file
        // notices the removal, and creates another file.
        if let Ok(_taken) = held::take(&path) {
            let _ = fs::remove_file(&path);
            remove_companions(&path);
        }
    }
}

/// [Sweeps](sweep) the folder of `file`. The file need not exist.
pub fn sweep_folder_of(file: &Path) {
    sweep(folder_of(file));
}

/// Folders that were created for a file. Dropping this value removes those that are empty.
#[derive(Debug)]
pub struct MadeFolders(Vec<PathBuf>);

impl MadeFolders {
    /// Creates the folder of `file` and its missing parents.
    ///
    /// # Errors
    /// I/O errors of the operating system.
    pub fn of(file: &Path) -> Result<Self, WriteError> {
        let folder = folder_of(file);
        let missing = folder.ancestors().take_while(|folder| !folder.as_os_str().is_empty());
        let made =
            Self(missing.take_while(|folder| !folder.exists()).map(Path::to_owned).collect());
        make_folder(folder).map_err(|fault| WriteError::new(file, fault))?;
        Ok(made)
    }

    /// The created folders, the innermost first.
    pub(crate) fn paths(&self) -> &[PathBuf] {
        &self.0
    }
}

impl Drop for MadeFolders {
    fn drop(&mut self) {
        // The innermost folder comes first. `remove_dir` fails for a folder that is not empty.
        self.0.iter().for_each(|folder| drop(fs::remove_dir(folder)));
    }
}

fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The path of the temporary file to which a temporary folder belongs, derived from the folder's
/// name.
fn temporary_file_of(folder: &Path) -> Option<PathBuf> {
    let name = folder.file_name()?.to_str().filter(|name| name.starts_with(PREFIX))?;
    let file = COMPANION_SUFFIXES.iter().find_map(|ending| name.strip_suffix(ending))?;
    file.ends_with(SUFFIX).then(|| folder.with_file_name(file))
}

/// Looks up the file at `path`, following links. `None` if the file does not exist.
fn metadata(path: &Path) -> io::Result<Option<fs::Metadata>> {
    match path.metadata() {
        Ok(metadata) => Ok(Some(metadata)),
        Err(fault) if fault.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(fault) => Err(fault),
    }
}

/// Paths of open files of this process. Such a path may refer to a regular file, but no temporary
/// file can be created next to it.
const OPEN: [&str; 4] = ["/dev/stdout", "/dev/stderr", "/dev/fd", "/proc/self/fd"];

/// Whether the output is written directly, because it is a pipe, a device or an open file.
fn is_direct(path: &Path, found: Option<&fs::Metadata>) -> bool {
    let is_open = || OPEN.iter().any(|open| path.starts_with(open));
    found.is_some_and(|found| !found.is_dir() && (!found.is_file() || is_open()))
}

/// Creates a folder and its missing parents.
///
/// # Errors
/// If a folder cannot be created. The error has the kind and the message of the system's error.
pub fn make_folder(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)
        .map_err(|fault| io::Error::new(fault.kind(), format!("cannot create the folder: {fault}")))
}

/// Creates a temporary file in the folder of `place`, so that it can be renamed to `place`
/// atomically. It has the permissions of a new file.
fn create_temporary(place: &Path) -> io::Result<NamedTempFile> {
    let folder = folder_of(place);
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    loop {
        // The message of `tempfile` would name the temporary file, which the user does not know.
        let refused = |fault: io::Error| match fault.kind() {
            kind @ io::ErrorKind::NotFound if !folder.exists() => {
                io::Error::new(kind, format!("the folder {} does not exist", folder.display()))
            }
            kind => {
                let why = fault.raw_os_error().map_or(fault, io::Error::from_raw_os_error);
                io::Error::new(
                    kind,
                    format!("cannot create a file in the folder {}: {why}", folder.display()),
                )
            }
        };
        let file = builder.make_in(folder, held::create).map_err(refused)?;
        if file.path().try_exists()? {
            return Ok(file);
        }
    }
}

/// Converts an error that occurred during writing. An [`io::ErrorKind::InvalidInput`] error without
/// a system error number comes from the writer of the format, and becomes
/// [`WriteFault::Unsupported`].
pub(super) fn fault_of(fault: io::Error) -> WriteFault {
    match (fault.kind(), fault.raw_os_error()) {
        (io::ErrorKind::AlreadyExists, _) => WriteFault::Exists,
        (io::ErrorKind::InvalidInput, None) => WriteFault::Unsupported(fault.to_string()),
        _ => WriteFault::Io(fault),
    }
}

/// Maximum number of bytes per write. Small pieces are combined. Large pieces are divided, because
/// the system would need additional memory for a large write.
const AT_ONCE: usize = 256 << 10;

/// Lets `content` write to `out`. Returns the number of bytes, and their checksum if `crc` is
/// given.
pub(super) fn write_counted(
    out: impl Write,
    crc: Option<Hasher>,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<(u64, Option<Hasher>)> {
    let out = CountingWriter { out, bytes: 0, crc };
    let mut out = BufWriter::with_capacity(AT_ONCE, out);
    content(&mut out)?;
    out.flush()?;
    let CountingWriter { bytes, crc, .. } = out.into_inner().map_err(|fault| fault.into_error())?;
    Ok((bytes, crc))
}

/// Like [`write_counted`], for a file that is still empty. A large file bypasses the system's
/// cache.
pub(super) fn write_counted_to_file(
    file: &File,
    crc: Option<Hasher>,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<(u64, Option<Hasher>)> {
    let mut out = PastCache::new(file);
    let counted = write_counted(&mut out, crc, content)?;
    out.finish()?;
    Ok(counted)
}

struct CountingWriter<W> {
    out: W,
    bytes: u64,
    crc: Option<Hasher>,
}

impl<W: Write> Write for CountingWriter<W> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let written = self.out.write(&buffer[..buffer.len().min(AT_ONCE)])?;
        self.bytes += written as u64;
        self.crc.iter_mut().for_each(|crc| crc.update(&buffer[..written]));
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(path: &Path) -> FilledFile {
        WholeFile::prepare(path, Replace::Refuse)
            .unwrap()
            .fill(|out| out.write_all(b"mesh"))
            .unwrap()
    }

    #[test]
    fn a_file_appears_when_kept_and_a_dropped_file_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        let file = filled(&path);
        assert!(!path.exists());
        drop(file);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        assert_eq!(filled(&path).keep().unwrap(), 4);
        assert_eq!(fs::read(&path).unwrap(), b"mesh");
    }

    #[test]
    fn keep_fails_and_preserves_a_file_created_meanwhile() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        let file = filled(&path);
        fs::write(&path, "other").unwrap();
        assert!(matches!(file.keep().unwrap_err().fault, WriteFault::Exists));
        assert_eq!(fs::read(&path).unwrap(), b"other");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
    }
}
