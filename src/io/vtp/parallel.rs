//! Reads VTK's lists of files. A .pvtp or .pvtu names its pieces, which are .vtp or .vtu files with
//! relative paths. The points of all pieces form one set. A .vtm, .vtpd or .vtpc names blocks,
//! which may contain anything.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::io::bytes::{Bytes, Unpacking, open_bytes, open_bytes_within, open_whole};
use crate::io::collection::FrameBlock;
use crate::io::input_format::InputFormat;
use crate::io::joined::check_colour_scales;
use crate::io::listed::resolved;
use crate::io::pieces::join_files;
use crate::io::vertices::Triangles;
use crate::io::wanted::WantedParticles;
use crate::io::{ParticleFile, ReadError, ReadFault, malformed};
use crate::surface::mesh::Mesh;

use super::layout::{Tag, each_tag};
use super::read::{
    NumberedMesh, PieceContents, contents, read_numbered, read_particles, whole_file_if_inline,
};

/// Reads the points of all wanted pieces as particles, in list order.
///
/// An attribute is left out if a piece with particles lacks it.
///
/// # Errors
/// The errors of [`read_particles`](super::read_particles), with the path of the faulty piece.
/// [`ReadFault::Io`] if a piece does not exist.
pub fn open_particles(
    path: &Path,
    bytes: Bytes,
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    let list = bytes.read_whole(unpacking).map_err(|fault| ReadError::new(path, fault))?;
    let ListedFiles { files: listed, format, .. } = ListedFiles::parse(path, &list)?;
    let opened = wanted.pieces.of(listed.len()).max(1) as u64;
    let share = Unpacking { in_memory: unpacking.in_memory / opened, ..unpacking };
    let paths: Vec<&Path> = listed.iter().map(|piece| &*piece.file).collect();
    let open = |(number, path): (usize, &&Path)| match wanted.pieces.includes(number) {
        true => open_piece(path, share).map(Some),
        false => Ok(None),
    };
    // All pieces are read before errors are checked, so this function always returns the error of
    // the first faulty piece.
    let read: Vec<_> = paths.par_iter().enumerate().map(open).collect();
    let files = read.into_iter().collect::<Result<Vec<_>, _>>()?;
    check_colour_scales(&paths, &files, wanted.attributes)?;
    let file = join_files(files, wanted.pieces)
        .map_err(|(piece, fault)| ReadError::new(paths[piece], fault))?;
    Ok(ParticleFile { format, ..file })
}

/// Reads the particles of a piece. Removes ghosts piece by piece, because some pieces may lack
/// flags.
fn open_piece(path: &Path, unpacking: Unpacking) -> Result<ParticleFile, ReadError> {
    let file = read_particles(open_bytes_within(path, unpacking)?, unpacking);
    file.map(ParticleFile::without_ghosts).map_err(|fault| ReadError::new(path, fault))
}

/// The blocks in the list at `path` and in its nested lists, and the format of the list. `None` for
/// a list of pieces.
///
/// # Errors
/// [`ReadError`] if a list cannot be read.
pub fn blocks(path: &Path) -> Result<Option<(Vec<FrameBlock>, &'static str)>, ReadError> {
    let list = ListedFiles::parse(path, &open_whole(path)?)?;
    Ok(list.are_blocks.then_some((list.files, list.format)))
}

/// Whether the pieces form a mesh. They form a mesh if a cell of a piece has an area or a volume,
/// or if every piece is an empty mesh.
///
/// # Errors
/// [`ReadError`] if the pieces cannot be read.
pub fn has_faces(path: &Path) -> Result<bool, ReadError> {
    let mut is_empty_mesh = true;
    for piece in pieces(path)? {
        let bytes = open_bytes(&piece)?;
        let found = whole_file_if_inline(bytes).and_then(|bytes| contents(bytes.view()));
        match found.map_err(|fault| ReadError::new(&piece, fault))? {
            PieceContents::Faces => return Ok(true),
            PieceContents::EmptyMesh => {}
            PieceContents::Particles => is_empty_mesh = false,
        }
    }
    Ok(is_empty_mesh)
}

/// The paths of the pieces in a .pvtp or .pvtu, or of the blocks in a .vtm, .vtpd or .vtpc.
///
/// # Errors
/// [`ReadError`] if the list cannot be read.
pub fn pieces(path: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let listed = ListedFiles::parse(path, &open_whole(path)?)?.files;
    Ok(listed.into_iter().map(|listed| listed.file).collect())
}

/// Reads the triangles of all pieces as one mesh. Vertices of different pieces are merged if their
/// global identifiers are equal. Without identifiers, they stay separate.
///
/// # Errors
/// The errors of [`read_mesh`](super::read_mesh), with the path of the faulty piece.
pub fn read_mesh(path: &Path) -> Result<Mesh, ReadError> {
    let mut all = JoinedMesh::default();
    for piece in pieces(path)? {
        let fail = |fault| ReadError::new(&piece, fault);
        let mesh = read_numbered(&open_whole(&piece)?).map_err(fail)?;
        all.add(mesh).map_err(fail)?;
    }
    Ok(all.mesh)
}

/// The mesh joined from the pieces that were read so far.
#[derive(Default)]
struct JoinedMesh {
    mesh: Mesh,
    /// The vertex index for each global identifier.
    known: HashMap<i64, u32>,
    is_started: bool,
}

impl JoinedMesh {
    fn add(
        &mut self,
        NumberedMesh { mesh: piece, numbers }: NumberedMesh,
    ) -> Result<(), ReadFault> {
        if piece.positions.is_empty() {
            return Ok(());
        }
        if !std::mem::replace(&mut self.is_started, true) {
            self.mesh = Mesh { positions: Vec::new(), triangles: Vec::new(), ..piece.clone() };
            self.mesh.normals.iter_mut().for_each(Vec::clear);
            self.mesh.attributes.iter_mut().for_each(|attribute| {
                attribute.values.clear();
                attribute.whole.clear();
            });
        }
        let all = &mut self.mesh;
        let kind = |mesh: &Mesh| -> Vec<(String, usize)> {
            let normals = mesh.normals.iter().map(|_| ("Normals".to_owned(), 3));
            normals.chain(mesh.attributes.iter().map(|a| (a.name.clone(), a.components))).collect()
        };
        let [expected, found] = [kind(all), kind(&piece)];
        if expected != found {
            let what = format!("the arrays are {found:?}, but {expected:?} in earlier pieces");
            return Err(malformed(0, what));
        }
        let mut own = Vec::with_capacity(piece.positions.len());
        for (vertex, position) in piece.positions.iter().enumerate() {
            let next = all.positions.len() as u32;
            let number = numbers.as_ref().map(|numbers| numbers[vertex]);
            let place = number.map_or(next, |number| *self.known.entry(number).or_insert(next));
            own.push(place);
            if place == next {
                all.positions.push(*position);
                if let (Some(all), Some(own)) = (&mut all.normals, &piece.normals) {
                    all.push(own[vertex]);
                }
                for (all, own) in all.attributes.iter_mut().zip(&piece.attributes) {
                    let range = vertex * own.components..(vertex + 1) * own.components;
                    all.values.extend(&own.values[range.clone()]);
                    all.whole.extend(own.whole.get(range).unwrap_or_default());
                }
            }
        }
        Triangles::new(all.positions.len())?;
        all.triangles.extend(piece.triangles.iter().map(|t| t.map(|corner| own[corner as usize])));
        Ok(())
    }
}

/// The files in a list and in its nested lists.
struct ListedFiles {
    files: Vec<FrameBlock>,
    format: &'static str,
    /// Whether the files are blocks, which may contain anything, instead of pieces.
    are_blocks: bool,
}

/// Maximum depth of nested lists.
const MOST_NESTED: usize = 8;

impl ListedFiles {
    fn parse(path: &Path, bytes: &[u8]) -> Result<Self, ReadError> {
        let mut all = Self { files: Vec::new(), format: "", are_blocks: false };
        let mut seen = HashSet::new();
        let format = all.add(path, bytes, None, &mut seen, 0)?;
        Ok(Self { format: format.name, are_blocks: format.blocks, ..all })
    }

    /// Adds the files of a list and its nested lists. Blocks without a name get the name `outer` of
    /// the block that refers to the list. Returns the format of the list.
    fn add(
        &mut self,
        path: &Path,
        bytes: &[u8],
        outer: Option<&str>,
        seen: &mut HashSet<PathBuf>,
        depth: usize,
    ) -> Result<Format, ReadError> {
        let fail = |fault| ReadError::new(path, fault);
        let List { files, format } = List::parse(bytes).map_err(fail)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        for PieceFile { source, name } in files {
            let file = resolved(folder, &source);
            if !seen.insert(file.clone()) {
                return Err(fail(malformed(0, format!("the list names the piece {source} twice"))));
            }
            let name = name.or_else(|| outer.map(str::to_owned));
            let is_list = InputFormat::of(&file) == Some(InputFormat::Pvtp);
            if !format.blocks || !is_list {
                self.files.push(FrameBlock { file, name });
            } else if depth == MOST_NESTED {
                let what = format!("lists are nested more than {MOST_NESTED} levels deep");
                return Err(fail(ReadFault::Unsupported(what)));
            } else {
                self.add(&file, &open_whole(&file)?, name.as_deref(), seen, depth + 1)?;
            }
        }
        Ok(format)
    }
}

/// The contents of one list.
struct List {
    files: Vec<PieceFile>,
    format: Format,
}

/// An entry of a list.
struct PieceFile {
    source: String,
    /// The name of the block, or else the name of the innermost named element that contains it.
    /// `None` for pieces.
    name: Option<String>,
}

impl List {
    fn parse(bytes: &[u8]) -> Result<Self, ReadFault> {
        let (mut files, mut format) = (Vec::new(), None);
        // The names of the current element and of the elements that contain it.
        let mut names: Vec<Option<String>> = Vec::new();
        each_tag(bytes, |tag, depth| {
            names.truncate(depth);
            names.push(tag.value("name")?.filter(|name| !name.is_empty()));
            match (tag.tag.name().as_ref(), format) {
                ("VTKFile", _) => format = Some(Format::of(tag)?),
                ("Piece", Some(Format { blocks: false, .. })) => {
                    let source = tag.value("Source")?.filter(|source| !source.is_empty());
                    let source =
                        source.ok_or_else(|| malformed(tag.at, "a piece has no Source"))?;
                    files.push(PieceFile { source, name: None });
                }
                // A DataSet without a file is an empty block.
                ("DataSet", Some(Format { blocks: true, .. })) => {
                    if let Some(source) = tag.value("file")?.filter(|file| !file.is_empty()) {
                        let name = names.iter().rev().flatten().next().cloned();
                        files.push(PieceFile { source, name });
                    }
                }
                _ => {}
            }
            Ok(())
        })?;
        let format = format.ok_or_else(|| malformed(0, "the file has no <VTKFile>"))?;
        if files.is_empty() {
            return Err(malformed(0, "the list names no pieces"));
        }
        Ok(Self { files, format })
    }
}

/// The kind of a list.
#[derive(Clone, Copy)]
struct Format {
    name: &'static str,
    /// Whether the files are blocks, which may contain anything.
    blocks: bool,
}

impl Format {
    fn of(tag: &Tag) -> Result<Self, ReadFault> {
        let kind = tag.value("type")?.unwrap_or_default();
        let (name, blocks) = match kind.as_str() {
            "PPolyData" => ("VTK XML .pvtp", false),
            "PUnstructuredGrid" => ("VTK XML .pvtu", false),
            "vtkMultiBlockDataSet" => ("VTK XML .vtm", true),
            "vtkPartitionedDataSet" => ("VTK XML .vtpd", true),
            "vtkPartitionedDataSetCollection" => ("VTK XML .vtpc", true),
            _ => {
                let what = "is not supported, only PPolyData, PUnstructuredGrid and block lists";
                return Err(ReadFault::Unsupported(format!("a data set of type {kind:?} {what}")));
            }
        };
        Ok(Self { name, blocks })
    }
}
