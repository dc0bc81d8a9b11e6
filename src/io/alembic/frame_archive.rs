//! One archive for all frames of a simulation. It grows frame by frame, and is complete after each
//! frame.
//!
//! Each frame is first written to a separate file, in a folder next to the archive. The bytes of
//! this file are appended to the archive, followed by groups that list all frames so far. The last
//! write replaces the position of the root group in the header. Therefore, the archive is complete
//! at any time, even after a crash. Then the file of the frame is removed.
//!
//! `archive.json` in the folder lists the position of each frame in the archive. It is replaced
//! after the header has changed. The next addition first truncates the archive to the size in
//! `archive.json`, which removes the bytes of an interrupted addition. The groups of earlier
//! additions stay in the archive, but are no longer used. The groups of one addition take about 16
//! bytes for each array of each frame. A frame that is computed again also leaves its old bytes in
//! the archive.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crc32fast::Hasher;
use serde::{Deserialize, Serialize};

use crate::io::WriteError;
use crate::io::series::SeriesFrame;
use crate::io::whole::{Replace, WholeFile, replace_small};
use crate::surface::mesh::source::Outline;

use super::archive::{AbcSample, TimeSampling, archive};
use super::content_hash::Digest;
use super::geometry::{AbcArray, arrays, objects, positions};
use super::ogawa::{HEADER, LENGTH, OgawaChild, header};

/// The archive of a simulation, and the folder of its frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameArchive {
    path: PathBuf,
    folder: PathBuf,
}

/// The frames that an archive contains, as `archive.json` stores them.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct ArchivedFrames {
    #[serde(skip)]
    archive: PathBuf,
    /// Fingerprint of the conversion's state, such as its settings, with which all frames were
    /// computed.
    fingerprint: u32,
    /// Byte offset of the archive's root group.
    root: u64,
    /// Size of the archive in bytes.
    end: u64,
    frames: BTreeMap<i64, ArchivedFrame>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct ArchivedFrame {
    /// Byte offset of the frame's file within the archive.
    at: u64,
    mesh: SeriesFrame,
}

impl ArchivedFrames {
    /// Whether the archive contains this mesh for this frame.
    #[must_use]
    pub fn holds(&self, mesh: &SeriesFrame) -> bool {
        self.frames.get(&mesh.frame).is_some_and(|archived| archived.mesh == *mesh)
    }

    /// CRC-32 of the bytes that the archive stores for `frame`. `None` if they are missing or
    /// cannot be read.
    #[must_use]
    pub fn crc(&self, frame: i64) -> Option<u32> {
        let ArchivedFrame { at, mesh } = self.frames.get(&frame)?;
        let mut file = File::open(&self.archive).ok()?;
        file.seek(SeekFrom::Start(*at)).ok()?;
        crc(file.take(mesh.bytes)).ok()
    }
}

impl FrameArchive {
    /// An archive at `path`, to which frames are added from files in `folder`.
    #[must_use]
    pub fn new(path: PathBuf, folder: PathBuf) -> Self {
        Self { path, folder }
    }

    /// The path of the archive.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The folder that contains the archive.
    #[must_use]
    pub fn parent(&self) -> &Path {
        let folder = self.path.parent().filter(|folder| !folder.as_os_str().is_empty());
        folder.unwrap_or(Path::new("."))
    }

    /// Checks, before frames are computed, that an existing file at the path can be replaced.
    ///
    /// # Errors
    /// The errors of [`WholeFile::prepare`].
    pub fn check(&self) -> Result<(), WriteError> {
        if self.path.exists() {
            WholeFile::prepare(&self.path, Replace::Allow).map(drop)
        } else {
            Ok(())
        }
    }

    fn table(&self) -> PathBuf {
        self.folder.join("archive.json")
    }

    /// The frames that the archive contains. Empty if `archive.json` cannot be read, or if the
    /// archive is shorter than `archive.json` says.
    #[must_use]
    pub fn frames(&self) -> ArchivedFrames {
        let read = || {
            let table = fs::read(self.table()).ok()?;
            let frames: ArchivedFrames = serde_json::from_slice(&table).ok()?;
            let bytes = fs::metadata(&self.path).ok()?.len();
            (bytes >= frames.end).then_some(frames)
        };
        ArchivedFrames { archive: self.path.clone(), ..read().unwrap_or_default() }
    }

    /// Removes `archive.json`, so that the next added frame starts a new archive. The old archive
    /// remains until this frame replaces it.
    ///
    /// # Errors
    /// I/O errors of the operating system.
    pub fn forget(&self) -> Result<(), WriteError> {
        match fs::remove_file(self.table()) {
            Err(fault) if fault.kind() != io::ErrorKind::NotFound => {
                Err(WriteError::new(&self.path, fault))
            }
            _ => Ok(()),
        }
    }

    /// Adds the frame in file `mesh.file` of the folder, and removes the file. Does nothing if the
    /// folder contains no file `mesh.file` of `mesh.bytes` bytes, because in this case, an earlier
    /// call has already added the frame.
    ///
    /// `times` must return the times of the given frames, in seconds and in frame order. An archive
    /// with a different `fingerprint` is replaced.
    ///
    /// # Errors
    /// I/O errors of the operating system.
    pub fn add(
        &self,
        mesh: &SeriesFrame,
        fingerprint: u32,
        times: impl Fn(&[SeriesFrame]) -> Vec<f64>,
    ) -> Result<(), WriteError> {
        let path = self.folder.join(&mesh.file);
        let fail = |fault: io::Error| WriteError::new(&self.path, fault);
        if fs::metadata(&path).map_or(0, |file| file.len()) != mesh.bytes {
            return Ok(());
        }
        // Lock the folder if the file system supports locks, because other processes may add frames
        // at the same time.
        let folder_lock = File::open(&self.folder).ok().filter(|folder| folder.lock().is_ok());
        let mut known = self.frames();
        if known.fingerprint != fingerprint {
            known = ArchivedFrames { archive: known.archive, fingerprint, ..Default::default() };
        }
        let crc_of_file = || File::open(&path).and_then(crc).ok();
        if known.holds(mesh) && known.crc(mesh.frame) == crc_of_file() {
            // The archive already contains this frame: an earlier process was killed after it added
            // the frame but before it removed the frame's file.
            return fs::remove_file(&path).map_err(fail);
        }
        self.append(&mut known, mesh, &path, times)?;
        let table = serde_json::to_vec(&known).expect("string keys and finite depth");
        replace_small(&self.table(), &table).map_err(fail)?;
        drop(folder_lock);
        fs::remove_file(&path).map_err(fail)
    }

    fn append(
        &self,
        known: &mut ArchivedFrames,
        mesh: &SeriesFrame,
        path: &Path,
        times: impl Fn(&[SeriesFrame]) -> Vec<f64>,
    ) -> Result<(), WriteError> {
        let fail = |fault: io::Error| WriteError::new(&self.path, fault);
        let is_new = known.frames.is_empty();
        let at = known.end.max(HEADER);
        let mut frame = File::open(path).map_err(fail)?;
        let mut samples = Vec::new();
        known.frames.insert(mesh.frame, ArchivedFrame { at, mesh: mesh.clone() });
        if is_new {
            samples.push(samples_of(&mut frame, 0, at, mesh).map_err(fail)?);
        } else {
            let mut archive = File::open(&self.path).map_err(fail)?;
            for (number, ArchivedFrame { at, mesh: own }) in &known.frames {
                let read = if *number == mesh.frame {
                    samples_of(&mut frame, 0, *at, own)
                } else {
                    samples_of(&mut archive, *at, *at, own)
                };
                samples.push(read.map_err(fail)?);
            }
        }
        let meshes: Vec<_> = known.frames.values().map(|frame| frame.mesh.clone()).collect();
        let sampling = TimeSampling::at(&times(&meshes));
        let (groups, root) =
            archive(at + mesh.bytes, &sampling, |blocks| objects(&samples, blocks));
        frame.rewind().map_err(fail)?;
        if is_new {
            WholeFile::prepare(&self.path, Replace::Allow)?.write(|out| {
                out.write_all(&header(root))?;
                io::copy(&mut frame, out)?;
                out.write_all(&groups)
            })?;
        } else {
            extend(&self.path, known, &mut frame, &groups, root).map_err(fail)?;
        }
        known.root = root.position();
        known.end = at + mesh.bytes + groups.len() as u64;
        Ok(())
    }
}

/// Appends the file of a frame and the groups to an archive, and then makes the header refer to the
/// new root group.
fn extend(
    path: &Path,
    known: &ArchivedFrames,
    frame: &mut File,
    groups: &[u8],
    root: OgawaChild,
) -> io::Result<()> {
    let mut archive = OpenOptions::new().read(true).write(true).open(path)?;
    let mut stored_root = [0; 8];
    archive.seek(SeekFrom::Start(HEADER - 8))?;
    archive.read_exact(&mut stored_root)?;
    if u64::from_le_bytes(stored_root) != known.root {
        // The header does not match `archive.json`: an earlier process was killed after it changed
        // the header but before it replaced `archive.json`. Restore the header.
        set_root(&mut archive, known.root)?;
    }
    archive.set_len(known.end)?;
    archive.seek(SeekFrom::Start(known.end))?;
    io::copy(frame, &mut archive)?;
    archive.write_all(groups)?;
    archive.sync_data()?;
    set_root(&mut archive, root.position())
}

/// Writes the position of the root group into the last 8 bytes of the header.
fn set_root(archive: &mut File, root: u64) -> io::Result<()> {
    archive.seek(SeekFrom::Start(HEADER - 8))?;
    archive.write_all(&root.to_le_bytes())?;
    archive.sync_data()
}

/// Returns the arrays of frame `mesh` with their samples, whose digests are read from `file`. The
/// bytes of the frame's file start at byte `read` of `file`, and at byte `at` of the archive.
fn samples_of(
    file: &mut File,
    read: u64,
    at: u64,
    mesh: &SeriesFrame,
) -> io::Result<Vec<(AbcArray, AbcSample)>> {
    let arrays = arrays(&Outline {
        vertices: mesh.vertices,
        triangles: mesh.triangles,
        normals: mesh.normals,
        attributes: mesh.attributes.clone(),
        pieces: 0,
        lattice: None,
    });
    let (positions, _) = positions(&arrays);
    let sample = |(array, position): (AbcArray, u64)| {
        if array.bytes() == 0 {
            let sample = AbcSample::empty();
            return Ok((array, sample));
        }
        let mut digest = Digest::default();
        file.seek(SeekFrom::Start(read + position + LENGTH))?;
        file.read_exact(&mut digest)?;
        let sample = array.sample(at + position, digest);
        Ok((array, sample))
    };
    arrays.into_iter().zip(positions).map(sample).collect()
}

/// CRC-32 of all bytes of `file`.
fn crc(mut file: impl Read) -> io::Result<u32> {
    let (mut crc, mut buffer) = (Hasher::new(), vec![0; 1 << 18]);
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(crc.finalize()),
            read => crc.update(&buffer[..read]),
        }
    }
}
