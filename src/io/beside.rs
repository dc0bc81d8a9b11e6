//! A folder of files that a file beside it names: it gets its name before the file does, so that nobody finds a name of what is missing.
//!
//! Until then it is called like the file's temporary, and goes with that where the work is abandoned.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crc32fast::Hasher;

use crate::system::cancel::{BELONGINGS, belonging};

use super::counted::counted;

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
    /// Begins a folder beside the file at `place`, called like it but for the extension, for files that end in `extension`.
    ///
    /// # Errors
    /// Those of the system, [`io::ErrorKind::AlreadyExists`] and [`io::ErrorKind::InvalidInput`] as [`check`](Self::check).
    pub fn begin(place: &Path, temporary: &Path, extension: &'static str) -> io::Result<Self> {
        let (place, stem) = named(place)?;
        let [temporary, replaced] = BELONGINGS.map(|ending| belonging(temporary, ending));
        fs::create_dir(&temporary)?;
        Ok(Self { temporary, replaced, place, stem, extension, sum: Hasher::new() })
    }

    /// Makes sure that the folder beside the file at `place` is free, or holds nothing but files that another one has put there, if
    /// they may be replaced.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] for a folder that may not be replaced, and [`io::ErrorKind::InvalidInput`] for one that holds
    /// other files, or a name that is no text.
    pub fn check(place: &Path, extension: &str, replaceable: bool) -> io::Result<()> {
        let (folder, stem) = named(place)?;
        let entries = match fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(fault) if fault.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(fault) => return Err(fault),
        };
        let mut empty = true;
        for entry in entries {
            let name = entry?.file_name();
            let is_ours = name.to_str().is_some_and(|name| is_piece(name, &stem, extension));
            if !is_ours {
                let what = format!("the folder {} beside it holds other files", folder.display());
                return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
            }
            empty = false;
        }
        if empty || replaceable { Ok(()) } else { Err(io::ErrorKind::AlreadyExists.into()) }
    }

    /// Name of file number `number`, relative to the folder's own.
    #[must_use]
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
        let mut file = File::create_new(self.temporary.join(name))?;
        let (_, sum) = counted(&mut file, Some(Hasher::new()), content)?;
        sum.iter().for_each(|sum| self.sum.combine(sum));
        file.sync_all()
    }

    /// Adds what the files hold to the sum of the file that names them.
    #[must_use]
    pub fn sum_behind(&self, crc: u32, bytes: u64) -> u32 {
        let mut all = Hasher::new_with_initial_len(crc, bytes);
        all.combine(&self.sum);
        all.finalize()
    }

    /// Gives the folder its name. A file at `named`, which names what was in a folder before, goes first.
    ///
    /// # Errors
    /// Those of the system.
    pub fn keep(self, named: &Path) -> io::Result<()> {
        if self.place.exists() {
            match fs::remove_file(named) {
                Err(fault) if fault.kind() != io::ErrorKind::NotFound => return Err(fault),
                _ => fs::rename(&self.place, &self.replaced)?,
            }
        }
        fs::rename(&self.temporary, &self.place)
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
    let no_text =
        || io::Error::new(io::ErrorKind::InvalidInput, "its name is no text that other files can hold");
    let stem = stem.ok_or_else(no_text)?;
    Ok((place.with_file_name(&stem), stem))
}

fn is_piece(name: &str, stem: &str, extension: &str) -> bool {
    let number = name.strip_prefix(stem).and_then(|rest| rest.strip_prefix('_'));
    let number = number.and_then(|rest| rest.strip_suffix(extension)).and_then(|rest| rest.strip_suffix('.'));
    number.is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
}
