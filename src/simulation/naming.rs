//! The names of a simulation's outputs.

use std::path::{Path, PathBuf};

use crate::error::SimulationError;
use crate::io::alembic::frame_archive::FrameArchive;
use crate::io::frame_files::snapshot_piece;
use crate::io::output::MeshFormat;

use super::inputs::{Inputs, Sequence};
use super::pattern::{NumberKind, PIECE, Pattern, stem};

/// The names of outputs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Naming {
    /// A name with `{}` for the number.
    Pattern(Pattern),
    /// Files in this folder, with the names of the inputs and the extension `.ply`.
    Folder(PathBuf),
    /// One Alembic archive for all frames.
    Archive {
        /// The archive.
        path: PathBuf,
        /// The names of the files that hold the frames before they are added to the archive.
        frames: Pattern,
    },
}

/// The extension of outputs in a folder.
const IN_FOLDER: &str = ".ply";

impl Naming {
    /// Interprets an output path as the names of a simulation's outputs; `None` if it names one
    /// file.
    ///
    /// # Errors
    /// [`SimulationError::Names`] for an invalid pattern.
    pub fn of(path: &Path) -> Result<Option<Self>, SimulationError> {
        // An existing folder with the name of a mesh file, such as `water.ply`, does not count as a
        // folder for outputs. The path then stands for one mesh file, which cannot replace the
        // folder.
        let is_folder = path.is_dir() && MeshFormat::of(path).is_none();
        if is_folder || path.to_string_lossy().ends_with(std::path::is_separator) {
            return Ok(Some(Self::Folder(path.to_owned())));
        }
        let pattern = Pattern::parse(path)?;
        if pattern.as_ref().is_some_and(Pattern::has_pieces) {
            let what = "{piece} stands for a piece of an input; an output cannot contain it";
            return Err(SimulationError::Names(format!("{}: {what}", path.display())));
        }
        Ok(pattern.map(Self::Pattern))
    }

    /// Like [`of`](Self::of), but for the output of several frames, which may also be one archive.
    ///
    /// # Errors
    /// The errors of [`of`](Self::of).
    pub fn of_several(path: &Path) -> Result<Option<Self>, SimulationError> {
        Ok(Self::of(path)?.or_else(|| Self::of_archive(path)))
    }

    /// The names for an Alembic archive. The files of its frames and the state are in a folder next
    /// to it.
    fn of_archive(path: &Path) -> Option<Self> {
        let MeshFormat::Abc(_) = MeshFormat::of(path)? else { return None };
        let mut folder = path.as_os_str().to_owned();
        folder.push(".frames");
        let frames = Pattern {
            folder: folder.into(),
            prefix: format!("{}_", path.file_stem()?.to_str()?),
            suffix: ".abc".into(),
            width: None,
            numbers: NumberKind::Whole,
        };
        Some(Self::Archive { path: path.to_owned(), frames })
    }

    /// The archive of all frames; `None` if the output is not an archive.
    pub fn archive(&self) -> Option<FrameArchive> {
        let Self::Archive { path, frames } = self else { return None };
        Some(FrameArchive::new(path.clone(), frames.folder.clone()))
    }

    /// The folder of all outputs.
    pub fn folder(&self) -> &Path {
        match self {
            Self::Pattern(pattern) | Self::Archive { frames: pattern, .. } => pattern.folder(),
            Self::Folder(folder) => folder,
        }
    }

    /// Returns the pattern of the outputs of a simulation. In a folder, outputs have the names of
    /// the inputs with another extension.
    pub fn outputs(&self, inputs: &Sequence) -> Pattern {
        let folder = match self {
            Self::Pattern(pattern) | Self::Archive { frames: pattern, .. } => {
                return pattern.clone();
            }
            Self::Folder(folder) => folder.clone(),
        };
        let (prefix, tail) = match (inputs.source(), inputs.pattern()) {
            (Inputs::Steps { file, .. }, _) => (
                format!("{}_", file.file_stem().unwrap_or_default().to_string_lossy()),
                String::new(),
            ),
            // If the names of the inputs have no numbers, the inputs are numbered in order, and the
            // name of an output consists only of this number.
            (_, None) => Default::default(),
            (_, Some(Pattern { prefix, suffix, .. })) => {
                (without_piece(prefix), without_piece(&tail(suffix)))
            }
        };
        Pattern {
            folder,
            prefix,
            suffix: tail + IN_FOLDER,
            width: None,
            numbers: NumberKind::Whole,
        }
    }
}

/// The text between a frame's number and the extension, without the number of a snapshot's piece.
fn tail(suffix: &str) -> String {
    // Put the number 0 before the suffix to get a complete name. The number is removed again below.
    let name = format!("0{suffix}");
    let whole =
        snapshot_piece(Path::new(&name)).map(|(whole, _)| whole.to_string_lossy().into_owned());
    stem(&whole.unwrap_or(name))[1..].to_owned()
}

/// Removes the number of a piece, the word before it, and the separator before that word. The word
/// stays if the number of pieces follows, as in `out-{piece}_2-`.
fn without_piece(text: &str) -> String {
    let Some((before, after)) = text.split_once(PIECE) else { return text.to_owned() };
    let separators = ['_', '-', '.', ' '];
    let before = if after.trim_start_matches(separators).starts_with(|c: char| c.is_ascii_digit()) {
        before
    } else {
        before.trim_end_matches(separators).trim_end_matches(|c: char| c.is_alphabetic())
    };
    match before.strip_suffix(separators) {
        Some(shorter) if after.is_empty() || after.starts_with(separators) => {
            format!("{shorter}{after}")
        }
        None if before.is_empty() => after.trim_start_matches(separators).to_owned(),
        _ => format!("{before}{after}"),
    }
}

/// The text before the number, without separators at its end; `frames` if no text is left.
pub(super) fn without_number(stem: &str) -> &str {
    match stem.trim_end_matches(['_', '-', '.', ' ']) {
        "" => "frames",
        stem => stem,
    }
}

/// Returns the path of the meshes without their number. The state and the series of the simulation
/// are named after this path.
#[must_use]
pub fn simulation(outputs: &Pattern) -> PathBuf {
    outputs.folder().join(format!("{}{}", without_number(&outputs.prefix), outputs.suffix))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outputs(naming: &str, input: &str) -> Pattern {
        let inputs = Inputs::of(&[input.into()], None).unwrap().unwrap();
        Naming::of(Path::new(naming))
            .unwrap()
            .unwrap()
            .outputs(&inputs.simulations(None).unwrap()[0])
    }

    #[test]
    fn outputs_keep_the_padding_of_the_input_numbers() {
        let folder = outputs("mesh/", "sim/Fluid_{}.bgeo.gz");
        assert_eq!(folder.path(7, "007"), Path::new("mesh/Fluid_007.ply"));
        assert_eq!(simulation(&folder), Path::new("mesh/Fluid.ply"));
        let pattern = outputs("mesh/a_{}.obj", "sim/Fluid_{}.bgeo.gz");
        assert_eq!(pattern.path(7, "007"), Path::new("mesh/a_007.obj"));
        assert_eq!(simulation(&pattern), Path::new("mesh/a.obj"));
        let bare = outputs("{:02}.vtk", "sim/Fluid_{}.bgeo.gz");
        assert_eq!(bare.path(7, "007"), Path::new("07.vtk"));
        assert_eq!(simulation(&bare), Path::new("./frames.vtk"));
        assert_eq!(Naming::of(Path::new("mesh/a.ply")).unwrap(), None);
    }

    #[test]
    fn outputs_in_a_folder_keep_the_text_after_the_number() {
        for (input, output, series) in [
            ("frame_{}_v2.xyz", "frame_01_v2.ply", "frame_v2.ply"),
            ("{}_oil.csv", "01_oil.ply", "frames_oil.ply"),
            ("fluid.{}", "fluid.01.ply", "fluid.ply"),
            ("f_{}.final.vtu.gz", "f_01.final.ply", "f.final.ply"),
            ("snap_{}.0.hdf5", "snap_01.ply", "snap.ply"),
            ("f_{}_rank{piece}.npy", "f_01.ply", "f.ply"),
            ("rank_{piece}_f{}.npy", "f01.ply", "f.ply"),
            ("f_p{piece}_t{}_v2.npy", "f_t01_v2.ply", "f_t_v2.ply"),
            ("geometry-{piece}_2-{}.vtp", "geometry_2-01.ply", "geometry_2.ply"),
            ("PART_n{piece}.2_{}.vtp", "PART_n.2_01.ply", "PART_n.2.ply"),
        ] {
            let outputs = outputs("m/", input);
            assert_eq!(outputs.path(1, "01"), Path::new("m").join(output));
            assert_eq!(simulation(&outputs), Path::new("m").join(series));
        }
    }
}
