//! The names of a simulation's outputs.

use std::path::{Path, PathBuf};

use crate::io::input::file_and_step;
use crate::io::output::MeshFormat;

use super::inputs::FrameFile;
use super::numbers::Pattern;
use crate::error::SimulationError;

/// How outputs are called.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Naming {
    /// A name with `{}` for the number.
    Pattern(Pattern),
    /// Named like the inputs, in this folder, as .ply.
    Folder(PathBuf),
}

/// The extension of outputs in a folder.
const IN_FOLDER: &str = ".ply";

impl Naming {
    /// Reads an output path as the names of a simulation; `None` where it names one file.
    ///
    /// # Errors
    /// [`SimulationError::Names`] for a pattern that cannot be one.
    pub fn of(path: &Path) -> Result<Option<Self>, SimulationError> {
        // A folder called as a mesh is in the way of one.
        let is_folder = path.is_dir() && MeshFormat::of(path).is_none();
        if is_folder || path.to_string_lossy().ends_with(std::path::is_separator) {
            return Ok(Some(Self::Folder(path.to_owned())));
        }
        Ok(Pattern::parse(path)?.map(Self::Pattern))
    }

    /// The folder of all outputs.
    #[must_use]
    pub fn folder(&self) -> &Path {
        match self {
            Self::Pattern(pattern) if pattern.folder.as_os_str().is_empty() => Path::new("."),
            Self::Pattern(pattern) => &pattern.folder,
            Self::Folder(folder) => folder,
        }
    }

    /// The output of a frame: its number padded as it is in the input's name, unless the pattern says how.
    #[must_use]
    pub fn path(&self, frame: &FrameFile) -> PathBuf {
        match self {
            Self::Pattern(pattern) => pattern.path(frame.number, &frame.digits),
            Self::Folder(folder) => {
                let stem = stem(frame);
                folder.join(format!("{stem}{}{IN_FOLDER}", frame.digits))
            }
        }
    }

    /// Beside the outputs, without any number: what state and series of the simulation are called by.
    #[must_use]
    pub fn simulation(&self, first: &FrameFile) -> PathBuf {
        let (stem, suffix) = match self {
            Self::Pattern(pattern) => (pattern.prefix.clone(), &*pattern.suffix),
            Self::Folder(_) => (stem(first), IN_FOLDER),
        };
        self.folder().join(format!("{}{suffix}", without_number(&stem)))
    }
}

/// The name of all frames, by what stands before their number.
pub(super) fn without_number(stem: &str) -> &str {
    match stem.trim_end_matches(['_', '-', '.', ' ']) {
        "" => "frames",
        stem => stem,
    }
}

/// The name of a frame before its number.
fn stem(frame: &FrameFile) -> String {
    if let (file, Some(_)) = file_and_step(&frame.path) {
        return format!("{}_", file.file_stem().unwrap_or_default().to_string_lossy());
    }
    // Empty where it is numbered by its place among the others.
    frame.family().prefix
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(name: &str, digits: &str) -> FrameFile {
        FrameFile { number: digits.parse().unwrap(), digits: digits.into(), path: name.into() }
    }

    #[test]
    fn outputs_keep_the_inputs_padding_and_the_sequence_has_no_number() {
        let input = frame("sim/Fluid_007.bgeo.gz", "007");
        let folder = Naming::of(Path::new("mesh/")).unwrap().unwrap();
        assert_eq!(folder.path(&input), Path::new("mesh/Fluid_007.ply"));
        assert_eq!(folder.simulation(&input), Path::new("mesh/Fluid.ply"));
        let pattern = Naming::of(Path::new("mesh/a_{}.obj")).unwrap().unwrap();
        assert_eq!(pattern.path(&input), Path::new("mesh/a_007.obj"));
        assert_eq!(pattern.simulation(&input), Path::new("mesh/a.obj"));
        let bare = Naming::of(Path::new("{:02}.vtk")).unwrap().unwrap();
        assert_eq!(bare.path(&input), Path::new("07.vtk"));
        assert_eq!(bare.simulation(&input), Path::new("./frames.vtk"));
        assert_eq!(Naming::of(Path::new("mesh/a.ply")).unwrap(), None);
    }
}
