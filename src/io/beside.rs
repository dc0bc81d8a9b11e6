//! A folder of files that a file beside it names: it gets its name before the file does, so that
//! nobody finds a name of what is missing.
//!
//! Until then it is called like the file's temporary, and goes with that where the work is
//! abandoned.

use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use crc32fast::Hasher;

use crate::system::cancel::{BELONGINGS, belonging};

use super::whole::counted_in;

/// A folder that is being filled. Dropped without [`keep`](Self::keep), it is removed.
#[derive(Debug)]
pub struct Folder {
    temporary: PathBuf,
    /// Where a folder that is replaced waits to be removed.
    replaced: PathBuf,
    place: PathBuf,
    stem: String,
    extension: &'static str,
    /// Sums up the files so far.
    sum: Hasher,
}

impl Folder {
    /// Begins a folder beside the file at `place`, called like it but for the extension, for files
    /// that end in `extension`.
    ///
    /// # Errors
    /// Those of the system, [`io::ErrorKind::AlreadyExists`] and [`io::ErrorKind::InvalidInput`] as
    /// [`check`](Self::check).
    pub fn begin(place: &Path, temporary: &Path, extension: &'static str) -> io::Result<Self> {
        let (place, stem) = named(place)?;
        let [temporary, replaced] = BELONGINGS.map(|ending| belonging(temporary, ending));
        fs::create_dir(&temporary)?;
        Ok(Self { temporary, replaced, place, stem, extension, sum: Hasher::new() })
    }

    /// Makes sure that the folder beside the file at `place` is free, or holds nothing but files
    /// that another one has put there, if they may be replaced.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] for a folder that may not be replaced, and
    /// [`io::ErrorKind::InvalidInput`] for one that holds other files, or a name that is no text.
    pub fn check(place: &Path, extension: &str, replaceable: bool) -> io::Result<()> {
        let (folder, stem) = named(place)?;
        let entries = match fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(fault) if fault.kind() == ErrorKind::NotFound => return Ok(()),
            Err(fault) => return Err(fault),
        };
        let mut empty = true;
        for entry in entries {
            let name = entry?.file_name();
            let is_ours = name.to_str().is_some_and(|name| is_piece(name, &stem, extension));
            if !is_ours {
                let what = format!(
                    "the folder {} beside it contains other files; choose another \
                               name",
                    folder.display()
                );
                return Err(io::Error::new(ErrorKind::InvalidInput, what));
            }
            empty = false;
        }
        if empty || replaceable { Ok(()) } else { Err(ErrorKind::AlreadyExists.into()) }
    }

    /// Name of file number `number`, relative to the folder's own.
    pub fn name(&self, number: u64) -> String {
        let Self { stem, extension, .. } = self;
        format!("{stem}/{stem}_{number}.{extension}")
    }

    /// Writes the next file, which has the number `number`, and waits until it is on disk.
    ///
    /// # Errors
    /// Those of the system and of `content`.
    pub fn write(
        &mut self,
        number: u64,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> io::Result<()> {
        let name = self.name(number);
        let name = name.rsplit('/').next().unwrap_or_default();
        let file = File::create_new(self.temporary.join(name))?;
        let (_, sum) = counted_in(&file, Some(Hasher::new()), content)?;
        sum.iter().for_each(|sum| self.sum.combine(sum));
        file.sync_all()
    }

    /// Adds what the files hold to the sum of the file that names them.
    pub fn sum_behind(&self, crc: u32, bytes: u64) -> u32 {
        let mut all = Hasher::new_with_initial_len(crc, bytes);
        all.combine(&self.sum);
        all.finalize()
    }

    /// Renames the folder to its final name. An existing folder is removed if it is `replaceable`,
    /// after the file at `named`, which lists its files. Another process that does this at the same
    /// time waits for the end of [`turn`]; without file locks it continues, and the last folder
    /// stays.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] for a name that was taken meanwhile and may not be
    /// replaced, and the system's own.
    pub fn keep(self, named: &Path, replaceable: bool) -> io::Result<()> {
        if !replaceable && named.symlink_metadata().is_ok() {
            return Err(ErrorKind::AlreadyExists.into());
        }
        let mut left = TRIES;
        while let Err(fault) = fs::rename(&self.temporary, &self.place) {
            let taken =
                matches!(fault.kind(), ErrorKind::DirectoryNotEmpty | ErrorKind::AlreadyExists)
                    || self.place.is_dir();
            left -= 1;
            if !taken || left == 0 {
                return Err(fault);
            }
            if !replaceable {
                return Err(ErrorKind::AlreadyExists.into());
            }
            unless_gone(fs::remove_file(named))?;
            unless_gone(fs::remove_dir_all(&self.replaced))?;
            unless_gone(fs::rename(&self.place, &self.replaced))?;
        }
        Ok(())
    }
}

/// How often a folder may find its name taken once more by another.
const TRIES: u32 = 100;

/// Takes what is not there for moved or removed already.
fn unless_gone(done: io::Result<()>) -> io::Result<()> {
    done.or_else(|fault| if fault.kind() == ErrorKind::NotFound { Ok(()) } else { Err(fault) })
}

/// How long a turn is waited for, and how often it is asked for.
const PATIENCE: Duration = Duration::from_secs(2);
const PAUSE: Duration = Duration::from_millis(2);

/// A lock on the folder in which the file at `place` and the folder beside it get their names, so
/// that both are of one job. Nothing where the system has no such lock, or somebody else holds on
/// to it.
pub fn turn(place: &Path) -> Option<File> {
    let folder =
        place.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = File::open(folder).ok()?;
    let begun = Instant::now();
    loop {
        match folder.try_lock() {
            Ok(()) => return Some(folder),
            Err(TryLockError::WouldBlock) if begun.elapsed() < PATIENCE => thread::sleep(PAUSE),
            Err(_) => return None,
        }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        for folder in [&self.temporary, &self.replaced] {
            let _ = fs::remove_dir_all(folder);
        }
    }
}

/// The folder beside a file, and its name.
fn named(place: &Path) -> io::Result<(PathBuf, String)> {
    let stem = place.file_stem().and_then(|stem| stem.to_str()).map(str::to_owned);
    let no_text = || {
        io::Error::new(
            ErrorKind::InvalidInput,
            "its name is not valid Unicode, so other files cannot refer to \
                               it; rename it",
        )
    };
    let stem = stem.ok_or_else(no_text)?;
    Ok((place.with_file_name(&stem), stem))
}

fn is_piece(name: &str, stem: &str, extension: &str) -> bool {
    let number = name.strip_prefix(stem).and_then(|rest| rest.strip_prefix('_'));
    let number = number
        .and_then(|rest| rest.strip_suffix(extension))
        .and_then(|rest| rest.strip_suffix('.'));
    number.is_some_and(|number| {
        !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder of one file beside `m.list`, as the job `job` makes it.
    fn filled(within: &Path, job: &str) -> Folder {
        let mut folder = Folder::begin(&within.join("m.list"), &within.join(job), "piece").unwrap();
        folder.write(0, |out| out.write_all(job.as_bytes())).unwrap();
        folder
    }

    #[test]
    fn folders_that_several_jobs_put_in_one_place_at_once_are_the_last_ones_and_fail_for_nobody() {
        let within = tempfile::tempdir().unwrap();
        let (list, piece) = (within.path().join("m.list"), within.path().join("m/m_0.piece"));
        let job = |name: &str| {
            for _ in 0..300 {
                filled(within.path(), name).keep(&list, true).unwrap();
            }
        };
        thread::scope(|scope| {
            ["a", "b", "c"]
                .map(|name| scope.spawn(move || job(name)))
                .map(|job| job.join().unwrap())
        });
        assert!(["a", "b", "c"].contains(&&*fs::read_to_string(piece).unwrap()));
        assert_eq!(fs::read_dir(&within).unwrap().count(), 1, "nothing else is left");
    }

    #[test]
    fn names_that_are_taken_before_the_folder_gets_its_own_are_refused_and_what_has_them_stays() {
        for taken in ["m/m_0.piece", "m.list"] {
            let within = tempfile::tempdir().unwrap();
            let folder = filled(within.path(), "a");
            let theirs = within.path().join(taken);
            fs::create_dir_all(theirs.parent().unwrap()).unwrap();
            fs::write(&theirs, "theirs").unwrap();
            let refused = folder.keep(&within.path().join("m.list"), false).unwrap_err();
            assert_eq!(refused.kind(), ErrorKind::AlreadyExists);
            assert_eq!(fs::read_to_string(&theirs).unwrap(), "theirs");
            assert_eq!(fs::read_dir(&within).unwrap().count(), 1, "nothing else is left");
        }
    }

    #[test]
    fn a_turn_is_one_jobs_at_a_time_and_comes_when_that_has_ended() {
        let within = tempfile::tempdir().unwrap();
        let list = within.path().join("m.list");
        let first = turn(&list).unwrap();
        let second = thread::spawn(move || turn(&list).is_some());
        thread::sleep(10 * PAUSE);
        assert!(!second.is_finished());
        drop(first);
        assert!(second.join().unwrap());
    }
}
