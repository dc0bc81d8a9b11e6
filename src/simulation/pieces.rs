//! Telling files that are frames from their pieces.
//!
//! Pieces are told by what names them: a .pvtp or .pvtu beside them, their own names as DualSPHysics spells them, or the header of a
//! snapshot whose files are `base.0.hdf5`, `base.1.hdf5` and so on. These are one frame, numbered as `base.hdf5` is.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use crate::io::bi4::is_later_piece;
use crate::io::frame_files::{pieces_named, snapshot_piece, snapshot_pieces};

/// A file that stands for a frame.
pub(super) struct Whole {
    pub path: PathBuf,
    /// The name that the frame's number is in.
    pub named: PathBuf,
}

impl From<PathBuf> for Whole {
    fn from(path: PathBuf) -> Self {
        Self { named: path.clone(), path }
    }
}

/// Keeps those of `paths` that stand for frames, in their order.
pub(super) fn whole_frames(paths: Vec<PathBuf>) -> Vec<Whole> {
    // What cannot be read names no pieces, and is told of when its turn comes.
    let named: HashSet<PathBuf> =
        paths.iter().flat_map(|path| pieces_named(path).unwrap_or_default()).collect();
    let mut snapshots: HashMap<PathBuf, Snapshot> = HashMap::new();
    for path in &paths {
        let Some((base, number)) = snapshot_piece(path) else { continue };
        let snapshot = snapshots.entry(base).or_insert_with(|| Snapshot::of(path));
        snapshot.first = snapshot.first.min(number);
    }
    for base in &paths {
        if let Some(snapshot) = snapshots.get_mut(base) {
            snapshot.has_base = true;
        }
    }
    let whole = |path: PathBuf| {
        if named.contains(&path) || is_later_piece(&path) {
            return None;
        }
        match snapshot_piece(&path).and_then(|(base, number)| Some((number, snapshots.get(&base)?, base))) {
            Some((number, snapshot, base)) if snapshot.in_pieces => {
                let stands = !snapshot.has_base && number == snapshot.first;
                stands.then_some(Whole { path, named: base })
            }
            _ => Some(path.into()),
        }
    };
    paths.into_iter().filter_map(whole).collect()
}

/// A snapshot, by the names of its files and the header of one.
struct Snapshot {
    in_pieces: bool,
    /// The lowest number of the pieces that are there.
    first: u64,
    /// Whether a file is there that is called like the pieces, but for their number.
    has_base: bool,
}

impl Snapshot {
    fn of(piece: &Path) -> Self {
        let in_pieces = snapshot_pieces(piece).is_some_and(|pieces| pieces > 1);
        Self { in_pieces, first: u64::MAX, has_base: false }
    }
}
