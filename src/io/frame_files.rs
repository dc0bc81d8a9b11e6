//! The files that one frame is in.

use std::path::{Path, PathBuf};

use super::collection::{is_list, listed};
use super::input::file_and_step;
use super::input_format::InputFormat;
#[cfg(feature = "hdf5")]
use super::input_format::extension;
use super::{ReadError, bi4, vtp};

/// The pieces that a file names, whose particles are its own; none of another format.
///
/// # Errors
/// [`ReadError`] where the file cannot be read.
pub fn pieces_named(path: &Path) -> Result<Vec<PathBuf>, ReadError> {
    match InputFormat::of(path) {
        Some(InputFormat::Pvtp) => vtp::parallel::pieces(path),
        _ => Ok(Vec::new()),
    }
}

/// The file that holds a frame, and those of its other pieces that are there.
pub fn files_of(path: &Path) -> Vec<PathBuf> {
    let (file, step) = file_and_step(path);
    // A list may name more frames by now, which are no matter to those that it named before.
    if let Some(frames) = is_list(file).then(|| listed(file).ok()).flatten() {
        let frame = usize::try_from(step.unwrap_or(0)).ok().and_then(|step| frames.get(step));
        return frame.map_or(Vec::new(), |f| f.files.iter().flat_map(|f| files_of(f)).collect());
    }
    let mut files = vec![file.to_owned()];
    // What is wrong with it is told of when it is read.
    let named = pieces_named(file).unwrap_or_default().into_iter();
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

/// The number of files that the snapshot of one of them is in; `None` of anything else.
#[cfg(feature = "hdf5")]
pub fn snapshot_pieces(path: &Path) -> Option<u64> {
    matches!(extension(path).as_deref(), Some("h5" | "hdf5")).then(|| super::h5::pieces_of(path))?
}

/// The number of files that a snapshot is in, which this build does not read.
#[cfg(not(feature = "hdf5"))]
pub fn snapshot_pieces(_: &Path) -> Option<u64> {
    None
}

/// A file's name without its piece's number, and that number, where the name is like `base.0.hdf5`.
pub fn snapshot_piece(path: &Path) -> Option<(PathBuf, u64)> {
    let (rest, extension) = path.file_name()?.to_str()?.rsplit_once('.')?;
    let (base, digits) = rest.rsplit_once('.').filter(|_| matches!(extension, "h5" | "hdf5"))?;
    let number =
        digits.bytes().all(|byte| byte.is_ascii_digit()).then(|| digits.parse().ok())??;
    Some((path.with_file_name(format!("{base}.{extension}")), number))
}
