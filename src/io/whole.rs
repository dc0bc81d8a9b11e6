//! A file that appears whole or not at all: whatever can be refused is refused before the work, and
//! whatever fails later leaves nothing behind.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crc32fast::Hasher;
use tempfile::NamedTempFile;

use crate::system::cancel::{BELONGINGS, remove_belongings};
use crate::system::held;
use crate::system::past_cache::PastCache;

use super::beside::{Folder, turn};
use super::{WriteError, WriteFault};

/// Prefix of temporary files' names, so that those that were left behind can be told.
const PREFIX: &str = ".meniscus-";
const SUFFIX: &str = ".tmp";

/// Whether an output may take the place of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Replace {
    /// No: what is there stays.
    Refuse,
    /// Yes, in one step, once the new file is whole.
    Allow,
}

/// A file that is ready to be written.
///
/// Dropped without [`write`](Self::write), or when that fails, it leaves nothing.
#[derive(Debug)]
pub struct WholeFile {
    /// The path as it was given, for messages.
    path: PathBuf,
    target: Target,
}

#[derive(Debug)]
enum Target {
    /// Beside `place`, to be moved there.
    Temporary { file: NamedTempFile, place: PathBuf, replace: Replace },
    /// A pipe or a device, which is there and stays there.
    Direct,
}

impl WholeFile {
    /// Makes sure, before the work, that `path` is free or may be replaced, and that a file can be
    /// created in its folder, by creating one. Pipes and devices are written directly.
    ///
    /// # Errors
    /// [`WriteFault::Exists`], and [`WriteFault::Io`] where the system refuses.
    pub fn prepare(path: &Path, replace: Replace) -> Result<Self, WriteError> {
        let fail = |fault: WriteFault| WriteError::new(path, fault);
        let found = metadata(path).map_err(|e| fail(e.into()))?;
        if is_direct(path, found.as_ref()) {
            return Ok(Self { path: path.to_owned(), target: Target::Direct });
        }
        if found.as_ref().is_some_and(fs::Metadata::is_dir) {
            return Err(fail(io::Error::from(io::ErrorKind::IsADirectory).into()));
        }
        if replace == Replace::Refuse && path.symlink_metadata().is_ok() {
            return Err(fail(WriteFault::Exists));
        }
        // Through a link, what it leads to is replaced, and not the link.
        let there = found.and_then(|_| path.canonicalize().ok());
        let place = there.unwrap_or_else(|| path.to_owned());
        let file = temporary_beside(&place).map_err(|e| fail(e.into()))?;
        Ok(Self { path: path.to_owned(), target: Target::Temporary { file, place, replace } })
    }

    /// Whether it is a pipe or a device, which needs no extension.
    pub fn is_direct(&self) -> bool {
        matches!(self.target, Target::Direct)
    }

    /// The path as it was given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Where the file will be, through links; `None` for a pipe or a device.
    pub(super) fn place(&self) -> Option<&Path> {
        match &self.target {
            Target::Temporary { place, .. } => Some(place),
            Target::Direct => None,
        }
    }

    /// The file that is written before it gets its name, and the folders that were made for it: what
    /// an interrupt leaves behind.
    pub(crate) fn leftovers(&self, folders: &MadeFolders) -> Vec<PathBuf> {
        let folders = folders.paths().iter().map(PathBuf::as_path);
        self.temporary().into_iter().chain(folders).map(Path::to_owned).collect()
    }

    /// The file that is written before it gets its name: what an interrupt leaves behind.
    pub fn temporary(&self) -> Option<&Path> {
        match &self.target {
            Target::Temporary { file, .. } => Some(file.path()),
            Target::Direct => None,
        }
    }

    /// Writes what `content` writes, waits until it is on disk, and gives the file its name.
    /// Returns its size in bytes.
    pub fn write(
        self,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<u64, WriteError> {
        self.filled(content, None)?.keep()
    }

    /// Writes what `content` writes to a file that has no name yet, and sums it up.
    ///
    /// # Errors
    /// [`WriteFault::Io`] where the system or `content` refuses, and [`WriteFault::Unsupported`]
    /// where `content` fails as [`io::ErrorKind::InvalidInput`].
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
            Target::Direct => {
                let open = OpenOptions::new().write(true).open(&self.path);
                match open.and_then(|mut file| counted(&mut file, crc, content)) {
                    // A reader that has seen enough is no error.
                    Err(fault) if fault.kind() == io::ErrorKind::BrokenPipe => Ok((0, None)),
                    outcome => outcome,
                }
            }
            Target::Temporary { file, .. } => counted_in(file.as_file(), crc, content),
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

/// A file that is written, and has no name yet.
#[derive(Debug)]
pub struct FilledFile {
    file: WholeFile,
    bytes: u64,
    crc: u32,
    /// Gets its name before the file does.
    folder: Option<Folder>,
}

impl FilledFile {
    /// Lets the folder of all files that this one names get its name before it.
    pub(super) fn after(self, folder: Folder) -> Self {
        Self { crc: folder.sum_behind(self.crc, self.bytes), folder: Some(folder), ..self }
    }

    /// CRC-32 of its bytes, and of those of the files that it names; 0 of a pipe that nobody reads
    /// to its end.
    pub fn crc(&self) -> u32 {
        self.crc
    }

    /// Returns the file's size in bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Waits until the file is on disk, and gives it its name. Returns its size in bytes.
    ///
    /// # Errors
    /// [`WriteFault::Io`] where the system refuses, and [`WriteFault::Exists`] if the name was
    /// taken meanwhile.
    pub fn keep(self) -> Result<u64, WriteError> {
        let Self { file: WholeFile { path, target }, bytes, folder, .. } = self;
        let kept = match target {
            Target::Direct => Ok(()),
            Target::Temporary { file, place, replace } => {
                let synced = file.as_file().sync_all();
                // The folder and the file that names what is in it are to be of one job.
                let _turn = folder.as_ref().and_then(|_| turn(&place));
                let before = |folder: Folder| folder.keep(&place, replace == Replace::Allow);
                synced.and_then(|()| folder.map_or(Ok(()), before)).and_then(|()| match replace {
                    Replace::Allow => file.persist(place).map(drop).map_err(Into::into),
                    Replace::Refuse => file.persist_noclobber(place).map(drop).map_err(Into::into),
                })
            }
        };
        kept.map(|()| bytes).map_err(|fault| WriteError::new(&path, fault_of(fault)))
    }
}

/// Puts a small file in place of any other in one step. It may be lost where power is.
///
/// # Errors
/// Those of the system.
pub fn replace_small(path: &Path, content: &[u8]) -> io::Result<()> {
    let mut file = temporary_beside(path)?;
    file.write_all(content)?;
    file.persist(path)?;
    Ok(())
}

/// Removes what processes that were killed have left half-written in `folder`. What belongs to a
/// process that lives, on this machine or another that shares the folder, is locked, and stays.
pub fn sweep(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if let Some(file) = belongs_to(&path).filter(|file| !file.exists()) {
            remove_belongings(&file);
            continue;
        }
        if !(name.starts_with(PREFIX) && name.ends_with(SUFFIX)) {
            continue;
        }
        // The file is taken until the name is gone: who just created it will find that, and begin
        // again.
        if let Ok(_taken) = held::take(&path) {
            let _ = fs::remove_file(&path);
            remove_belongings(&path);
        }
    }
}

/// [Sweeps](sweep) the folder that a file is in, or will be.
pub fn sweep_beside(file: &Path) {
    sweep(folder_of(file));
}

/// The folders that were made for a file: removed again where nothing comes to be in them.
#[derive(Debug)]
pub struct MadeFolders(Vec<PathBuf>);

impl MadeFolders {
    /// Makes the folder that a file will be in, and those that this is in, unless they are there.
    ///
    /// # Errors
    /// The system's refusal.
    pub fn of(file: &Path) -> Result<Self, WriteError> {
        let folder = folder_of(file);
        let missing = folder.ancestors().take_while(|folder| !folder.as_os_str().is_empty());
        let made =
            Self(missing.take_while(|folder| !folder.exists()).map(Path::to_owned).collect());
        make_folder(folder).map_err(|fault| WriteError::new(file, fault))?;
        Ok(made)
    }

    /// The folders, the innermost first.
    pub(crate) fn paths(&self) -> &[PathBuf] {
        &self.0
    }
}

impl Drop for MadeFolders {
    fn drop(&mut self) {
        // The innermost first; one that holds something is not removed.
        self.0.iter().for_each(|folder| drop(fs::remove_dir(folder)));
    }
}

fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The temporary file that a folder belongs to, by its name.
fn belongs_to(folder: &Path) -> Option<PathBuf> {
    let name = folder.file_name()?.to_str().filter(|name| name.starts_with(PREFIX))?;
    let file = BELONGINGS.iter().find_map(|ending| name.strip_suffix(ending))?;
    file.ends_with(SUFFIX).then(|| folder.with_file_name(file))
}

/// Looks up the file at `path`, through links; None if its name is free.
fn metadata(path: &Path) -> io::Result<Option<fs::Metadata>> {
    match path.metadata() {
        Ok(metadata) => Ok(Some(metadata)),
        Err(fault) if fault.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(fault) => Err(fault),
    }
}

/// Names of what this process has open: that may be a file, but there is no room beside it.
const OPEN: [&str; 4] = ["/dev/stdout", "/dev/stderr", "/dev/fd", "/proc/self/fd"];

/// Whether the output is to be written where it is.
fn is_direct(path: &Path, found: Option<&fs::Metadata>) -> bool {
    let is_open = || OPEN.iter().any(|open| path.starts_with(open));
    found.is_some_and(|found| !found.is_dir() && (!found.is_file() || is_open()))
}

/// Makes a folder, and those that it is to be in, unless they are there.
///
/// # Errors
/// The system's refusal, of which the kind and the words are kept.
pub fn make_folder(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)
        .map_err(|fault| io::Error::new(fault.kind(), format!("cannot create the folder: {fault}")))
}

/// In the same folder, so that it can be moved there in one step; with the permissions of any new
/// file.
fn temporary_beside(place: &Path) -> io::Result<NamedTempFile> {
    let folder = folder_of(place);
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    loop {
        // The system would name the temporary file, of which nobody has heard.
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

/// A refusal of the format's writer has no number of the system's.
pub(super) fn fault_of(fault: io::Error) -> WriteFault {
    match (fault.kind(), fault.raw_os_error()) {
        (io::ErrorKind::AlreadyExists, _) => WriteFault::Exists,
        (io::ErrorKind::InvalidInput, None) => WriteFault::Unsupported(fault.to_string()),
        _ => WriteFault::Io(fault),
    }
}

/// Bytes that are given to the system at once: of small pieces as many, and of large ones no more,
/// for which it would look for memory that no program has used lately.
const AT_ONCE: usize = 256 << 10;

/// How many bytes `content` writes to `out`, and what sums them up, if anything does.
pub(super) fn counted(
    out: impl Write,
    crc: Option<Hasher>,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<(u64, Option<Hasher>)> {
    let out = Counted { out, bytes: 0, crc };
    let mut out = BufWriter::with_capacity(AT_ONCE, out);
    content(&mut out)?;
    out.flush()?;
    let Counted { bytes, crc, .. } = out.into_inner().map_err(|fault| fault.into_error())?;
    Ok((bytes, crc))
}

/// Works like [`counted`] for a file that is empty, and goes past the system's cache where that
/// becomes large.
pub(super) fn counted_in(
    file: &File,
    crc: Option<Hasher>,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<(u64, Option<Hasher>)> {
    let mut out = PastCache::new(file);
    let counted = counted(&mut out, crc, content)?;
    out.finish()?;
    Ok(counted)
}

struct Counted<W> {
    out: W,
    bytes: u64,
    crc: Option<Hasher>,
}

impl<W: Write> Write for Counted<W> {
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
    fn what_is_filled_gets_its_name_when_it_is_kept_and_leaves_nothing_if_it_never_is() {
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
    fn a_name_that_was_taken_between_filling_and_keeping_is_refused_and_stays_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        let file = filled(&path);
        fs::write(&path, "other").unwrap();
        assert!(matches!(file.keep().unwrap_err().fault, WriteFault::Exists));
        assert_eq!(fs::read(&path).unwrap(), b"other");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
    }
}
