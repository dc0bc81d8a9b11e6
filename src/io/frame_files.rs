//! Finds the files that a frame consists of.

use std::path::{Path, PathBuf};

use super::collection::{is_list, listed};
use super::input::file_and_step;
use super::input_format::InputFormat;
#[cfg(feature = "hdf5")]
use super::input_format::extension;
use super::{ReadError, bi4, vtp};

/// The pieces that the file at `path` lists. Empty for formats that do not list pieces.
///
/// # Errors
/// [`ReadError`] if the file cannot be read.
pub fn listed_pieces(path: &Path) -> Result<Vec<PathBuf>, ReadError> {
    match InputFormat::of(path) {
        Some(InputFormat::Pvtp) => vtp::parallel::pieces(path),
        _ => Ok(Vec::new()),
    }
}

/// The file of a frame, and the existing files of its other pieces.
pub fn files_of(path: &Path) -> Vec<PathBuf> {
    let (file, step) = file_and_step(path);
    // Leave out the list itself, because a simulation may append frames to the list without
    // changing the earlier frames.
    if let Some(frames) = is_list(file).then(|| listed(file).ok()).flatten() {
        let frame = usize::try_from(step.unwrap_or(0)).ok().and_then(|step| frames.get(step));
        return frame.map_or(Vec::new(), |frame| frame.files().flat_map(files_of).collect());
    }
    let mut files = vec![file.to_owned()];
    // Ignore an error here, because reading the file reports it.
    let named = listed_pieces(file).unwrap_or_default().into_iter();
    let snapshot =
        snapshot_pieces(file).filter(|pieces| *pieces > 1).map_or(Vec::new(), |pieces| {
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

/// The number of files of the snapshot that `path` belongs to. `None` if `path` belongs to no
/// snapshot.
#[cfg(feature = "hdf5")]
pub fn snapshot_pieces(path: &Path) -> Option<u64> {
    matches!(extension(path).as_deref(), Some("h5" | "hdf5")).then(|| super::h5::pieces_of(path))?
}

/// Returns `None`, because a build without HDF5 does not read snapshots.
#[cfg(not(feature = "hdf5"))]
pub fn snapshot_pieces(_: &Path) -> Option<u64> {
    None
}

/// Splits a name such as `base.0.hdf5` into the name without the piece's number, and the number.
pub fn snapshot_piece(path: &Path) -> Option<(PathBuf, u64)> {
    let (rest, extension) = path.file_name()?.to_str()?.rsplit_once('.')?;
    let (base, digits) = rest.rsplit_once('.').filter(|_| matches!(extension, "h5" | "hdf5"))?;
    let number =
        digits.bytes().all(|byte| byte.is_ascii_digit()).then(|| digits.parse().ok())??;
    Some((path.with_file_name(format!("{base}.{extension}")), number))
}
