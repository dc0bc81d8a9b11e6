//! Records of finished frames, one line of JSON each.
//!
//! Each process writes its own log, `frames.1.jsonl`, `frames.2.jsonl` and so on, and locks it
//! while the process runs. A process that finishes merges all unlocked logs into `frames.jsonl`, in
//! frame order. When all processes have finished, only `frames.jsonl` exists. Its bytes do not
//! depend on which process made which frame.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crc32fast::Hasher;
use serde::{Deserialize, Serialize};

use crate::io::WriteError;
use crate::io::frame_files::listed_pieces;
use crate::io::series::SeriesFrame;
use crate::io::whole::{Replace, WholeFile};
use crate::system::held;

use super::frame_file::FrameFile;
use super::shared_calibration::Stamp;
use crate::error::SimulationError;

const MERGED: &str = "frames.jsonl";

/// A finished frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The stamp of the frame's input.
    pub input: Stamp,
    /// The fingerprint of the state with which the frame was made.
    pub fingerprint: u32,
    /// The mesh's entry in the list of frames.
    pub mesh: SeriesFrame,
    /// CRC-32 of the bytes of the mesh's file and of its pieces.
    pub crc: u32,
}

impl Record {
    /// Whether `output` is a file of the recorded size.
    pub fn is_at(&self, output: &Path) -> bool {
        output.metadata().is_ok_and(|found| found.is_file() && found.len() == self.mesh.bytes)
    }

    /// Whether `output` still has the recorded bytes. Reads the whole file.
    pub fn is_whole(&self, output: &Path) -> bool {
        crc(output).is_ok_and(|crc| crc == self.crc)
    }
}

/// CRC-32 of a file's bytes and of the bytes of its pieces.
fn crc(path: &Path) -> io::Result<u32> {
    let (mut crc, mut buffer) = (Hasher::new(), vec![0; 1 << 18]);
    let pieces = listed_pieces(path).map_err(io::Error::other)?;
    for path in std::iter::once(path).chain(pieces.iter().map(PathBuf::as_path)) {
        let mut file = File::open(path)?;
        loop {
            match file.read(&mut buffer)? {
                0 => break,
                read => crc.update(&buffer[..read]),
            }
        }
    }
    Ok(crc.finalize())
}

/// The latest record of each frame.
#[derive(Debug, Default, PartialEq)]
pub struct Records(BTreeMap<i64, Record>);

impl Records {
    /// Reads the records in `folder`. Ignores invalid records, whose frames are then made again.
    pub fn read(folder: &Path) -> Self {
        // The merged file is read last, because another process may merge a log into it meanwhile.
        let logs: Vec<Vec<u8>> =
            logs(folder).into_values().filter_map(|path| fs::read(path).ok()).collect();
        let mut records = Self::default();
        records.add(&fs::read(folder.join(MERGED)).unwrap_or_default());
        logs.iter().for_each(|log| records.add(log));
        records
    }

    /// Adds records; later ones replace earlier ones.
    fn add(&mut self, lines: &[u8]) {
        let records =
            lines.split(|&byte| byte == b'\n').filter_map(|line| serde_json::from_slice(line).ok());
        self.0.extend(records.map(|record: Record| (record.mesh.frame, record)));
    }

    /// Whether a record names `output` as the mesh of a frame. The file may have changed since
    /// then.
    pub fn names(&self, output: &Path) -> bool {
        let name = output.file_name();
        self.0.values().any(|record| name.is_some_and(|name| *name == *record.mesh.file))
    }

    /// Returns the record of a frame if the frame's input, the state and the output's name are
    /// unchanged.
    pub fn of(&self, frame: &FrameFile, output: &Path, fingerprint: u32) -> Option<&Record> {
        let record = self.0.get(&frame.number)?;
        let same = record.fingerprint == fingerprint
            && frame.stamp().is_ok_and(|stamp| stamp == record.input)
            && output.file_name().is_some_and(|name| *name == *record.mesh.file);
        same.then_some(record)
    }
}

impl Records {
    /// Whether `output` is the recorded mesh of `frame`, made from an input that has changed since.
    pub fn has_other_input(&self, frame: &FrameFile, output: &Path) -> bool {
        self.0.get(&frame.number).is_some_and(|record| {
            frame.stamp().is_ok_and(|stamp| stamp != record.input)
                && output.file_name().is_some_and(|name| *name == *record.mesh.file)
        })
    }

    /// The latest record of each frame.
    pub fn all(&self) -> impl Iterator<Item = &Record> {
        self.0.values()
    }
}

/// The log of this process, which is created when the process starts to make frames.
#[derive(Debug)]
pub struct Log {
    folder: PathBuf,
    file: Mutex<Option<File>>,
}

impl Log {
    /// A log in a folder that need not exist yet.
    pub fn new(folder: PathBuf) -> Self {
        Self { folder, file: Mutex::new(None) }
    }

    /// The folder of the logs.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Creates the log, whose lock shows other processes that this process is running.
    pub fn open(&self) -> Result<(), SimulationError> {
        let opened = create(&self.folder);
        let opened =
            opened.map_err(|fault| SimulationError::Io { path: self.folder.clone(), fault })?;
        self.file.lock().unwrap_or_else(PoisonError::into_inner).replace(opened);
        Ok(())
    }

    /// Whether another process is running, which means that it holds the lock of its log. Always
    /// false if the file system has no locks.
    pub fn others_are_open(&self) -> bool {
        logs(&self.folder).values().any(|path| held::is_held(path))
    }

    /// Appends the record of a frame.
    pub fn append(&self, record: &Record) -> Result<(), SimulationError> {
        let mut line = serde_json::to_vec(record).expect("string keys and finite depth");
        line.push(b'\n');
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        // If locks do not work between machines, another process may have mistaken this log for
        // the log of an ended process, and removed it.
        let named = file.take().filter(has_name);
        let written = named.map_or_else(|| create(&self.folder), Ok).and_then(|mut named| {
            named.write_all(&line)?;
            *file = Some(named);
            Ok(())
        });
        written.map_err(|fault| SimulationError::Io { path: self.folder.clone(), fault })
    }

    /// Ends this log, and merges all ended logs into one file. Only one process may call this at a
    /// time.
    pub fn merge(&self) -> Result<(), WriteError> {
        self.file.lock().unwrap_or_else(PoisonError::into_inner).take();
        // Logs that cannot be locked or read stay as they are.
        let ended = |path: PathBuf| {
            let (mut file, mut lines) = (held::take(&path).ok()?, Vec::new());
            file.read_to_end(&mut lines).ok()?;
            Some((path, file, lines))
        };
        let ended: Vec<_> = logs(&self.folder).into_values().filter_map(ended).collect();
        if ended.is_empty() {
            return Ok(());
        }
        let merged = self.folder.join(MERGED);
        let mut records = Records::default();
        match fs::read(&merged) {
            Ok(lines) => records.add(&lines),
            Err(fault) if fault.kind() == ErrorKind::NotFound => {}
            Err(_) => return Ok(()),
        }
        ended.iter().for_each(|(_, _, lines)| records.add(lines));
        WholeFile::prepare(&merged, Replace::Allow)?.write(|out| {
            for record in records.0.values() {
                serde_json::to_writer(&mut *out, record)?;
                out.write_all(b"\n")?;
            }
            Ok(())
        })?;
        // The logs stay locked until their names are removed. A process that has just created one
        // of these logs notices that its name is gone, and creates another log.
        ended.iter().for_each(|(path, ..)| drop(fs::remove_file(path)));
        Ok(())
    }
}

/// The logs in `folder`, by number.
fn logs(folder: &Path) -> BTreeMap<u64, PathBuf> {
    let number = |path: &Path| {
        let name = path.file_name()?.to_str()?;
        name.strip_prefix("frames.")?.strip_suffix(".jsonl")?.parse().ok()
    };
    let entries = fs::read_dir(folder).into_iter().flatten();
    entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter_map(|path| Some((number(&path)?, path)))
        .collect()
}

/// Creates a log whose number is higher than those of all existing logs.
fn create(folder: &Path) -> io::Result<File> {
    let mut number = logs(folder).last_key_value().map_or(0, |(number, _)| *number);
    loop {
        number += 1;
        let path = folder.join(format!("frames.{number}.jsonl"));
        let file = match held::create(&path) {
            Err(fault) if fault.kind() == ErrorKind::AlreadyExists => continue,
            created => created?,
        };
        if has_name(&file) {
            return Ok(file);
        }
    }
}

/// Whether the file still has a name, which means that it was not removed.
fn has_name(file: &File) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        file.metadata().is_ok_and(|metadata| metadata.nlink() > 0)
    }
    #[cfg(not(unix))]
    {
        // A process that removes a log locks it first, which is impossible while the log is open.
        let _ = file;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(frame: i64, fingerprint: u32) -> Record {
        let mesh = SeriesFrame {
            frame,
            time: Some(0.1),
            file: format!("out_{frame}.ply"),
            bytes: 4,
            particles: 1,
            vertices: 0,
            triangles: 0,
            bounds: Some([[1e-17, -0.1, 1.0 / 3.0], [0.1 + 0.2, 0.0, 1e300]]),
            normals: true,
            attributes: Vec::new(),
        };
        Record {
            input: Stamp { bytes: 9, modified: 7, files: 2 },
            fingerprint,
            mesh,
            crc: crc32fast::hash(b"mesh"),
        }
    }

    fn names(folder: &Path) -> Vec<String> {
        let name = |entry: fs::DirEntry| entry.file_name().into_string().unwrap();
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|entry| name(entry.unwrap())).collect();
        names.sort();
        names
    }

    #[test]
    fn a_record_is_valid_only_for_the_same_input_output_and_settings() {
        let folder = tempfile::tempdir().unwrap();
        let [input, output] = ["in_1.xyz", "out_1.ply"].map(|name| folder.path().join(name));
        fs::write(&input, "particles").unwrap();
        fs::write(&output, "mesh").unwrap();
        let record = Record { input: Stamp::of(&input).unwrap(), ..record(1, 5) };
        let log = Log::new(folder.path().join("records"));
        fs::create_dir(log.folder()).unwrap();
        log.append(&record).unwrap();
        let records = Records::read(log.folder());
        let frame = |number: i64| FrameFile::new(number, number.to_string(), input.clone());
        let current = |fingerprint| {
            records.of(&frame(1), &output, fingerprint).filter(|record| record.is_at(&output))
        };
        assert_eq!(current(5), Some(&record));
        assert_eq!(current(6), None, "other settings");
        assert_eq!(records.of(&frame(2), &output, 5), None, "another frame");
        assert_eq!(records.of(&frame(1), &folder.path().join("b.ply"), 5), None, "another output");
        assert!(record.is_whole(&output));
        fs::write(&output, "mess").unwrap();
        assert!(!record.is_whole(&output), "other bytes of the same length");
        assert!(!record.is_whole(folder.path()), "no file");
        fs::write(&output, "mes").unwrap();
        assert_eq!(current(5), None, "a truncated output");
        fs::write(&output, "mesh").unwrap();
        fs::write(&input, "particles and more").unwrap();
        assert_eq!(current(5), None, "another input");
    }

    #[test]
    fn merged_logs_are_one_ordered_file_in_which_the_latest_record_wins() {
        let folder = tempfile::tempdir().unwrap();
        let [first, second, alive] = [(); 3].map(|()| Log::new(folder.path().to_owned()));
        let append = |log: &Log, records: &[(i64, u32)]| {
            records
                .iter()
                .for_each(|&(frame, fingerprint)| log.append(&record(frame, fingerprint)).unwrap());
        };
        let all =
            || Records::read(folder.path()).0.into_values().map(|r| (r.mesh.frame, r.fingerprint));
        append(&first, &[(12, 1), (3, 1)]);
        append(&second, &[(3, 2), (7, 2)]);
        append(&alive, &[(5, 3)]);
        append(&first, &[(7, 1)]);
        assert_eq!(names(folder.path()), ["frames.1.jsonl", "frames.2.jsonl", "frames.3.jsonl"]);
        let before: Vec<_> = all().collect();
        assert_eq!(before, [(3, 2), (5, 3), (7, 2), (12, 1)]);

        drop(first);
        second.merge().unwrap();
        assert_eq!(names(folder.path()), ["frames.3.jsonl", "frames.jsonl"], "an open log is kept");
        assert!(all().eq(before));
        append(&alive, &[(12, 3)]);
        alive.merge().unwrap();
        assert_eq!(names(folder.path()), ["frames.jsonl"]);
        assert!(all().eq([(3, 2), (5, 3), (7, 2), (12, 3)]));

        append(&alive, &[(9, 5)]);
        fs::remove_file(folder.path().join("frames.1.jsonl")).unwrap();
        append(&alive, &[(9, 6)]);
        assert!(
            all().any(|record| record == (9, 6)),
            "the record is not written to the removed log"
        );
        fs::remove_file(folder.path().join("frames.1.jsonl")).unwrap();

        let whole = fs::read(folder.path().join("frames.jsonl")).unwrap();
        append(&alive, &[(4, 4), (3, 4)]);
        let log = folder.path().join("frames.1.jsonl");
        let bytes = fs::read(&log).unwrap();
        fs::write(&log, &bytes[..bytes.len() - 2]).unwrap();
        assert!(all().eq([(3, 2), (4, 4), (5, 3), (7, 2), (12, 3)]), "a truncated line is ignored");
        drop(alive);
        fs::write(&log, "").unwrap();
        second.merge().unwrap();
        assert_eq!(fs::read(folder.path().join("frames.jsonl")).unwrap(), whole);
    }
}
