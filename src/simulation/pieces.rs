//! Distinguishes frames from their pieces.
//!
//! Pieces are identified by a `.pvtp` or `.pvtu` file that names them, by the names that
//! DualSPHysics uses, or by the header of a snapshot with the files `base.0.hdf5`, `base.1.hdf5`
//! and so on. The files of a snapshot form one frame, whose number is part of `base`.
//!
//! A `.pvtp` or `.pvtu` file is written after its pieces. Until then, the pieces are recognised by
//! comparison with a complete frame: if `pool_1.pvtp` names `pool_1_0.vtp`, `pool_2_0.vtp` is also
//! a piece.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use crate::io::bi4::is_later_piece;
use crate::io::frame_files::{listed_pieces, snapshot_piece, snapshot_pieces};

use super::pattern::{FrameCandidate, all_digits, digit_runs, skeleton};

/// Returns the frames among `paths`, in the same order.
pub(super) fn whole_frames(paths: Vec<PathBuf>) -> Vec<FrameCandidate> {
    // A file that cannot be read counts as a frame without pieces, whose conversion reports the
    // error.
    let (mut named, mut future_pieces) = (HashSet::new(), HashSet::new());
    for index in &paths {
        for piece in listed_pieces(index).unwrap_or_default() {
            future_pieces.extend(piece_naming(index, &piece));
            named.insert(piece);
        }
    }
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
        let is_future_piece =
            || naming_scheme(&path).is_some_and(|scheme| future_pieces.contains(&scheme));
        if named.contains(&path) || is_later_piece(&path) || is_future_piece() {
            return None;
        }
        match snapshot_piece(&path)
            .and_then(|(base, number)| Some((number, snapshots.get(&base)?, base)))
        {
            Some((number, snapshot, base)) if snapshot.in_pieces => {
                let is_representative = !snapshot.has_base && number == snapshot.first;
                // The names of all pieces begin with `base`, which contains the frame's number.
                is_representative.then(|| FrameCandidate {
                    runs: FrameCandidate::from(base).runs,
                    ..path.into()
                })
            }
            _ => Some(path.into()),
        }
    };
    paths.into_iter().filter_map(whole).collect()
}

/// The naming scheme of a frame's pieces: their folder, and the skeleton of their names. Returns
/// `None` unless `piece` is in the folder of the frame, the frame's name contains a number, and the
/// name of `piece` is the frame's name followed by another number.
fn piece_naming(index: &Path, piece: &Path) -> Option<(PathBuf, String)> {
    let stem = index.file_stem()?.to_str()?;
    let own = piece.file_name()?.to_str()?.strip_prefix(stem)?;
    let have_numbers = [stem, own].iter().all(|part| !digit_runs(part).is_empty());
    (have_numbers && piece.parent() == index.parent()).then(|| naming_scheme(piece))?
}

/// The folder of a file, and the skeleton of its name.
fn naming_scheme(path: &Path) -> Option<(PathBuf, String)> {
    let name = path.file_name()?.to_str()?;
    Some((path.parent()?.to_owned(), skeleton(name, &digit_runs(name))))
}

/// Whether a file may be a piece of a frame that does not exist yet. VTK's writers name the pieces
/// `pool_1_0.vtp`, `pool_1_1.vtp` and so on, and the frame `pool_1.pvtp`. The names with `.vtu` and
/// `.pvtu` follow the same scheme.
pub(super) fn may_be_piece(path: &Path) -> bool {
    let is_vtk = path.extension().is_some_and(|extension| extension == "vtp" || extension == "vtu");
    let stem = path.file_stem().and_then(|stem| stem.to_str()).filter(|_| is_vtk);
    stem.and_then(|stem| stem.rsplit_once('_')).is_some_and(|(frame, number)| {
        // Pieces are numbered from 0 without padding.
        let is_count = all_digits(number) && (number == "0" || !number.starts_with('0'));
        is_count && frame.ends_with(|c: char| c.is_ascii_digit())
    })
}

/// Facts about a snapshot, from the names of its files and from the header of one file.
struct Snapshot {
    in_pieces: bool,
    /// The lowest number of the existing pieces.
    first: u64,
    /// Whether a file such as `base.hdf5` exists, without the number of a piece in its name.
    has_base: bool,
}

impl Snapshot {
    fn of(piece: &Path) -> Self {
        let in_pieces = snapshot_pieces(piece).is_some_and(|pieces| pieces > 1);
        Self { in_pieces, first: u64::MAX, has_base: false }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piece_of_a_future_frame_is_recognised_by_the_pieces_of_another_frame() {
        let piece_naming =
            |index: &str, piece: &str| piece_naming(Path::new(index), Path::new(piece));
        let like = |name: &str| naming_scheme(Path::new(name));
        let pool = piece_naming("sim/pool_0001.pvtp", "sim/pool_0001_0.vtp");
        for name in ["sim/pool_0002_0.vtp", "sim/pool_0002_17.vtp", "sim/pool_1_0.vtp"] {
            assert_eq!(pool, like(name), "{name}");
        }
        for name in [
            "sim/pool_0002.pvtp",
            "sim/pool_0002.vtp",
            "sim/pool_a_0.vtp",
            "pool_0002_0.vtp",
            "sim/pool_2_0.vtu",
        ] {
            assert_ne!(pool, like(name), "{name}");
        }
        assert_eq!(piece_naming("run3.final.pvtu", "run3.final.p1.vtu"), like("run4.final.p0.vtu"));
        assert_eq!(piece_naming("a_1_v2.pvtu", "a_1_v2_0.vtu"), like("a_2_v2_1.vtu"));
        for (index, piece) in [
            ("a_1.pvtp", "b_1_0.vtp"),
            ("a.pvtp", "a_0.vtp"),
            ("a_1.pvtp", "a_1/a_1_0.vtp"),
            ("a_1.pvtp", "a_1.vtp"),
        ] {
            assert_eq!(piece_naming(index, piece), None, "{piece} of {index}");
        }
    }

    #[test]
    fn a_vtk_file_may_be_a_piece_if_a_number_follows_the_frame_number() {
        for (name, may_be) in [
            ("pool_1_0.vtp", true),
            ("pool_0001_12.vtu", true),
            ("pool_1.vtp", false),
            ("pool_2024_0001.vtp", false),
            ("pool_a_0.vtp", false),
            ("pool_1_0.ply", false),
            ("pool_1_0_a.vtp", false),
        ] {
            assert_eq!(may_be_piece(Path::new(name)), may_be, "{name}");
        }
    }
}
