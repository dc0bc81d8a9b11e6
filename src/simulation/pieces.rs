//! Telling files that are frames from their pieces.
//!
//! Pieces are told by what names them: a .pvtp or .pvtu beside them, their own names as DualSPHysics spells them, or the header of a
//! snapshot whose files are `base.0.hdf5`, `base.1.hdf5` and so on. These are one frame, numbered as `base.hdf5` is.
//!
//! A .pvtp or .pvtu is written after its pieces. Until then they are told by their names, if there is another frame: `pool_2_0.vtp` is a
//! piece where `pool_1.pvtp` names `pool_1_0.vtp`.

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
    let (mut named, mut to_come) = (HashSet::new(), HashSet::new());
    for index in &paths {
        for piece in pieces_named(index).unwrap_or_default() {
            to_come.extend(Naming::of(index, &piece));
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
        let is_to_come = || to_come.iter().any(|naming| naming.fits(&path));
        if named.contains(&path) || is_later_piece(&path) || is_to_come() {
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

/// How the pieces of a frame are called: like it, and then something with numbers.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Naming {
    folder: PathBuf,
    /// Before the frame's number and behind it.
    around: [String; 2],
    /// Behind the frame's name, [`masked`].
    rest: String,
}

impl Naming {
    /// By a frame and one of its pieces; `None` where that is called otherwise, or has no number of its own.
    fn of(index: &Path, piece: &Path) -> Option<Self> {
        let (stem, folder) = (index.file_stem()?.to_str()?, index.parent()?);
        let rest = masked(piece.file_name()?.to_str()?.strip_prefix(stem)?);
        let is_like_it = piece.parent() == Some(folder) && rest.contains(NUMBER);
        let (before, _, behind) = last_number(stem).filter(|_| is_like_it)?;
        Some(Self { folder: folder.to_owned(), around: [before, behind].map(str::to_owned), rest })
    }

    /// Whether a file is called like a piece of a frame of any number.
    fn fits(&self, path: &Path) -> bool {
        let [before, behind] = &self.around;
        let rest = |name: &str| {
            let name = name.strip_prefix(&**before)?;
            let number = name.len() - name.trim_start_matches(|c: char| c.is_ascii_digit()).len();
            let rest = name[number..].strip_prefix(&**behind).filter(|_| number > 0)?;
            Some(masked(rest))
        };
        let name = path.file_name().and_then(|name| name.to_str());
        path.parent() == Some(&self.folder) && name.and_then(rest).as_ref() == Some(&self.rest)
    }
}

/// Mark of a number, whatever it is.
const NUMBER: char = '#';

/// A text in which every number is [`NUMBER`].
fn masked(text: &str) -> String {
    let mut masked = String::new();
    for c in text.chars() {
        match c {
            '0'..='9' if masked.ends_with(NUMBER) => {}
            '0'..='9' => masked.push(NUMBER),
            other => masked.push(other),
        }
    }
    masked
}

/// Cuts a text around its last number.
fn last_number(text: &str) -> Option<(&str, &str, &str)> {
    let is_digit = |c: char| c.is_ascii_digit();
    let end = text.rfind(is_digit)? + 1;
    let start = text[..end].trim_end_matches(is_digit).len();
    Some((&text[..start], &text[start..end], &text[end..]))
}

/// Whether a file may be a piece of a frame that is not there yet: VTK's writers call that `pool_1_0.vtp` or `pool_1_0.vtu` whose frame
/// is going to be `pool_1.pvtp` or `pool_1.pvtu`.
pub(super) fn may_be_piece(path: &Path) -> bool {
    let is_vtk = path.extension().is_some_and(|extension| extension == "vtp" || extension == "vtu");
    let numbers = path.file_stem().and_then(|stem| stem.to_str()).filter(|_| is_vtk).and_then(|stem| {
        let (frame, number, behind) = last_number(stem)?;
        let ends_with_number = frame.strip_suffix('_')?.ends_with(|c: char| c.is_ascii_digit());
        Some((number, behind.is_empty() && ends_with_number))
    });
    // Pieces are counted from 0, and not padded.
    numbers.is_some_and(|(number, fits)| fits && (number == "0" || !number.starts_with('0')))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piece_whose_frame_is_to_come_is_told_by_those_of_another_frame() {
        let naming = |index: &str, piece: &str| Naming::of(Path::new(index), Path::new(piece));
        let pool = naming("sim/pool_0001.pvtp", "sim/pool_0001_0.vtp").unwrap();
        for name in ["sim/pool_0002_0.vtp", "sim/pool_0002_17.vtp", "sim/pool_1_0.vtp"] {
            assert!(pool.fits(Path::new(name)), "{name}");
        }
        for name in [
            "sim/pool_0002.pvtp",
            "sim/pool_0002.vtp",
            "sim/pool_a_0.vtp",
            "pool_0002_0.vtp",
            "sim/pool_2_0.vtu",
        ] {
            assert!(!pool.fits(Path::new(name)), "{name}");
        }
        assert!(naming("run3.final.pvtu", "run3.final.p1.vtu").unwrap().fits(Path::new("run4.final.p0.vtu")));
        for (index, piece) in [
            ("a_1.pvtp", "b_1_0.vtp"),
            ("a.pvtp", "a_0.vtp"),
            ("a_1.pvtp", "a_1/a_1_0.vtp"),
            ("a_1.pvtp", "a_1.vtp"),
        ] {
            assert_eq!(naming(index, piece), None, "{piece} of {index}");
        }
    }

    #[test]
    fn a_file_may_be_a_piece_where_a_number_of_its_own_follows_its_frame_s() {
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
