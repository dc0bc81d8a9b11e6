//! Solids of a simulation's frames: the same for all frames, or one for each frame number.

use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::error::SimulationError;
use crate::settings::Settings;

use super::frame_file::FrameFile;
use super::pattern::{NumberKind, Pattern};

/// The names of solids.
#[derive(Debug, Default)]
pub(super) struct SolidNames {
    same: Vec<PathBuf>,
    numbered: Vec<Pattern>,
}

impl SolidNames {
    /// Reads the solids of the settings. A name with `{}`, or another program's notation, stands
    /// for one mesh per frame.
    ///
    /// # Errors
    /// [`SimulationError::Names`] for an invalid pattern.
    pub(super) fn of(settings: &Settings) -> Result<Self, SimulationError> {
        let mut names = Self::default();
        for path in settings.solid_files().iter().map(PathBuf::from) {
            match Pattern::parse(&path)? {
                None => names.same.push(path),
                Some(pattern) if pattern.has_pieces() || pattern.numbers == NumberKind::Times => {
                    let what = "a solid must be one file per frame, with {} for the frame number";
                    return Err(SimulationError::Names(format!("{}: {what}", path.display())));
                }
                Some(pattern) => names.numbered.push(pattern),
            }
        }
        Ok(names)
    }

    /// Whether each frame has its own solids.
    pub(super) fn are_numbered(&self) -> bool {
        !self.numbered.is_empty()
    }

    /// Sets the files of the solids of each frame. The files need not exist.
    pub(super) fn with_files(&self, mut frames: Vec<FrameFile>) -> Vec<FrameFile> {
        let numbered: Vec<_> =
            self.numbered.iter().map(|pattern| (pattern, existing_files(pattern))).collect();
        for frame in &mut frames {
            let own = numbered.iter().map(|(pattern, files)| {
                let found = files.get(&frame.number).cloned();
                found.unwrap_or_else(|| pattern.path(frame.number, &frame.digits))
            });
            frame.solids = self.same.iter().cloned().chain(own).collect();
        }
        frames
    }
}

/// The files that match a pattern, by their numbers.
fn existing_files(pattern: &Pattern) -> BTreeMap<i64, PathBuf> {
    let Ok(files) = std::fs::read_dir(pattern.folder()) else { return BTreeMap::new() };
    let mut names: Vec<String> =
        files.filter_map(|file| file.ok()?.file_name().into_string().ok()).collect();
    // If several names have the same number, the last name in sorted order is used, which has the
    // fewest leading zeros.
    names.sort_unstable();
    let numbered =
        |name: String| Some((pattern.digits(&name)?.parse().ok()?, pattern.folder.join(name)));
    names.into_iter().filter_map(numbered).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_have_shared_solids_and_those_of_their_number_with_any_padding() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("ship_0002.obj"), "").unwrap();
        let text = |name: &str| path(name).to_str().unwrap().to_owned();
        let solid = Some(vec![text("tank.obj"), text("ship_{}.obj")]);
        let names = SolidNames::of(&Settings { solid, ..Settings::default() }).unwrap();
        assert!(names.are_numbered());
        let frame = |number: i64| FrameFile::new(number, number.to_string(), path("water"));
        let frames = names.with_files(vec![frame(2), frame(3)]);
        assert_eq!(frames[0].solids, [path("tank.obj"), path("ship_0002.obj")]);
        // If the file of a solid is missing, its expected name contains the frame's own digits.
        assert_eq!(frames[1].solids, [path("tank.obj"), path("ship_3.obj")]);
        let timed = Some(vec![text("ship_{time}.obj")]);
        assert!(SolidNames::of(&Settings { solid: timed, ..Settings::default() }).is_err());
    }
}
