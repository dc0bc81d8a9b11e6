//! Joins the blocks of a frame. A list of frames or a list of blocks names the files of the blocks.
//! Blocks without particles are left out, and messages describe them.

use std::path::Path;

use crate::particles::Particles;
use crate::particles::selection::SelectionFault;

use super::bytes::Unpacking;
use super::collection::FrameBlock;
use super::input::{blocks_of, join, open_each, open_unselected};
use super::input_format::extension;
use super::wanted::WantedParticles;
use super::{ParticleFile, ReadError, ReadFault, UnreadPart};

/// Maximum number of blocks that a message lists.
const SHOWN: usize = 4;
/// Description of a block of lines, for [`UnreadPart::Block`].
const LINES: &str = "lines";

/// A block that was opened.
enum OpenedBlock {
    Particles(Box<ParticleFile>),
    /// Particles without an attribute that a condition tests.
    Lacking {
        particles: usize,
        only_lines: bool,
        error: ReadError,
    },
    /// Description of contents other than particles.
    Other(String),
}

impl OpenedBlock {
    /// Whether all cells of the block are lines. The points of lines may be particles.
    fn is_lines(&self) -> bool {
        match self {
            Self::Particles(file) => file.only_lines,
            Self::Lacking { only_lines, .. } => *only_lines,
            Self::Other(_) => false,
        }
    }

    /// Whether the block has points that are certainly particles, not points of lines.
    fn is_particles(&self) -> bool {
        let is_filled = match self {
            Self::Particles(file) => has_points(file),
            Self::Lacking { particles, .. } => *particles > 0,
            Self::Other(_) => false,
        };
        is_filled && !self.is_lines()
    }
}

/// Opens the blocks of a frame of the list at `path`, as one set of particles. A block that is
/// itself a list is replaced by the blocks in it.
///
/// Blocks without particles, such as meshes, are left out. Blocks of lines, such as wave gauges or
/// the paths of particles, are left out if another block contains particles. If only some blocks
/// have the attribute that a condition tests, no particle of the other blocks satisfies the
/// condition.
///
/// # Errors
/// The errors of [`open_joined`](super::input::open_joined), and [`ReadFault::Unsupported`] if no
/// block contains particles.
pub(super) fn open_blocks(
    path: &Path,
    blocks: &[FrameBlock],
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    let blocks = &flattened(blocks, wanted)?[..];
    let paths: Vec<&Path> = blocks.iter().map(|block| &*block.file).collect();
    let mut opened = open_each(&paths, wanted, unpacking, open_block)?;
    if opened.iter().flatten().any(OpenedBlock::is_particles) {
        for lines in opened.iter_mut().flatten().filter(|block| block.is_lines()) {
            *lines = OpenedBlock::Other(LINES.to_owned());
        }
    }
    let (mut files, mut left_out) = (Vec::new(), Vec::new());
    let (mut lacking, mut unselected): (Option<(usize, ReadError)>, _) = (None, 0);
    for (block, opened) in blocks.iter().zip(opened) {
        let file = match opened {
            Some(OpenedBlock::Particles(file)) => Some(*file),
            Some(OpenedBlock::Lacking { particles, error, .. }) => {
                // The message lists the attributes of one block only, so keep the error of the
                // block with the most particles.
                if lacking.as_ref().is_none_or(|(most, _)| particles > *most) {
                    lacking = Some((particles, error));
                }
                unselected += particles;
                None
            }
            Some(OpenedBlock::Other(holds)) => {
                left_out.push(UnreadPart::Block { name: block.title(), holds });
                None
            }
            None => None,
        };
        files.push(file);
    }
    if left_out.len() == files.len() {
        return Err(ReadError::new(path, no_particles(&left_out)));
    }
    if let Some((_, error)) = lacking.filter(|_| !files.iter().flatten().any(has_points)) {
        return Err(error);
    }
    left_out.extend(blocks.iter().zip(&files).filter_map(|(block, file)| block.empty(file)));
    left_out.extend(joined_names(blocks, &files));
    let joined = join(&paths, files, wanted)?;
    left_out.extend(joined.left_out);
    Ok(ParticleFile { unselected: joined.unselected + unselected, left_out, ..joined })
}

/// Replaces each block that is itself a list by the blocks in it. Blocks without a name get the
/// name of the list that contains them.
fn flattened(blocks: &[FrameBlock], wanted: WantedParticles) -> Result<Vec<FrameBlock>, ReadError> {
    let mut all = Vec::new();
    for block in blocks {
        match blocks_of(&block.file, wanted.format)? {
            Some((inner, _)) => all.extend(inner.into_iter().map(|inner| {
                let name = inner.name.or_else(|| block.name.clone());
                FrameBlock { name, ..inner }
            })),
            None => all.push(block.clone()),
        }
    }
    Ok(all)
}

fn open_block(
    path: &Path,
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<OpenedBlock, ReadError> {
    let file = match open_unselected(path, wanted, unpacking) {
        Ok(file) => file,
        Err(error) => return other_contents(path, error).map(OpenedBlock::Other),
    };
    let (particles, only_lines) = (file.particles.len(), file.only_lines);
    match file.selected(wanted.conditions, unpacking) {
        Ok(file) => Ok(OpenedBlock::Particles(Box::new(file))),
        Err(fault) => {
            let is_lacking =
                matches!(fault, ReadFault::Selection(SelectionFault::NoAttribute { .. }));
            let error = ReadError::new(path, fault);
            match is_lacking {
                true => Ok(OpenedBlock::Lacking { particles, only_lines, error }),
                false => Err(error),
            }
        }
    }
}

/// Whether a file has points, including ghosts and points that no condition selects.
fn has_points(file: &ParticleFile) -> bool {
    !file.particles.is_empty() || file.unselected > 0 || file.ghosts > 0
}

/// Describes a block that could not be opened because it holds no particles. Returns `error` if the
/// block could not be opened for another reason.
fn other_contents(path: &Path, error: ReadError) -> Result<String, ReadError> {
    match error.fault {
        ReadFault::Mesh { faces } if error.path == path => Ok(described_mesh(faces)),
        // The error counts the faces of only one of the block's pieces, so leave out the number.
        ReadFault::Mesh { .. } => Ok("a mesh".to_owned()),
        ReadFault::UnknownExtension { .. } => Ok(described_format(path)),
        _ => Err(error),
    }
}

/// The names of the blocks with particles, if there are several different names.
fn joined_names(blocks: &[FrameBlock], files: &[Option<ParticleFile>]) -> Option<UnreadPart> {
    let mut names: Vec<String> = Vec::new();
    for (block, file) in blocks.iter().zip(files) {
        let filled = file.as_ref().filter(|file| !file.particles.is_empty());
        if let Some(name) = block.name.as_ref().filter(|_| filled.is_some())
            && !names.contains(name)
        {
            names.push(name.clone());
        }
    }
    (names.len() > 1).then_some(UnreadPart::Names(names))
}

impl FrameBlock {
    /// The name of the block, or the name of its file if the block has no name.
    fn title(&self) -> String {
        let file = self.file.file_name().unwrap_or_default().to_string_lossy();
        self.name.clone().unwrap_or_else(|| file.into_owned())
    }

    /// The description of a block without points. `None` for other blocks, and for blocks without a
    /// name, which are usually the pieces of a parallel simulation.
    fn empty(&self, file: &Option<ParticleFile>) -> Option<UnreadPart> {
        let file = file.as_ref()?;
        let name = self.name.clone().filter(|_| !has_points(file))?;
        Some(UnreadPart::Block { name, holds: "no points".to_owned() })
    }
}

/// The error for a list in which no block contains particles.
fn no_particles(blocks: &[UnreadPart]) -> ReadFault {
    let shown: Vec<_> = blocks.iter().take(SHOWN).map(ToString::to_string).collect();
    let count = blocks.len();
    let what = format!("none of {count} blocks contains particles: {}", shown.join("; "));
    ReadFault::Unsupported(what)
}

/// Describes a mesh, for [`UnreadPart::Block`].
fn described_mesh(faces: u64) -> String {
    format!("a mesh of {faces} faces")
}

/// Describes a file in a format without particles, for [`UnreadPart::Block`].
fn described_format(path: &Path) -> String {
    format!("data in the format .{}", extension(path).unwrap_or_default())
}
