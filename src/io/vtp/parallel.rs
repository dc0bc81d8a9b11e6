//! Reads VTK's lists of files. A .pvtp or .pvtu names its pieces, which are .vtp or .vtu files with
//! relative paths. The points of all pieces form one set. A .vtm names blocks, which may contain
//! anything.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::io::blocks::{described_format, no_particles};
use crate::io::bytes::{Bytes, Unpacking, open_bytes, open_bytes_within, open_whole};
use crate::io::input_format::{InputFormat, extension};
use crate::io::joined::refuse_other_scales;
use crate::io::listed::resolved;
use crate::io::pieces::join_files;
use crate::io::vertices::Triangles;
use crate::io::wanted::WantedParticles;
use crate::io::{ParticleFile, ReadError, ReadFault, UnreadPart, malformed};
use crate::surface::mesh::Mesh;

use super::layout::{Tag, each_tag};
use super::read::{
    NumberedMesh, PieceContents, contents, read_block, read_numbered, read_particles, unless_inline,
};

/// Reads the points of all wanted pieces as particles, in list order.
///
/// An attribute is left out if a piece with particles lacks it. Blocks of a .vtm without particles
/// are also left out.
///
/// # Errors
/// The errors of [`read_particles`](super::read_particles), with the path of the faulty piece.
/// [`ReadFault::Io`] if a piece does not exist. [`ReadFault::Unsupported`] if no block contains
/// particles.
pub fn open_particles(
    path: &Path,
    bytes: Bytes,
    wanted: WantedParticles,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    let fail = |fault| ReadError::new(path, fault);
    let list = bytes.read_whole(unpacking).map_err(fail)?;
    let Sources { sources, format } = Sources::parse(path, &list)?;
    let opened = wanted.pieces.of(sources.len()).max(1) as u64;
    let share = Unpacking { in_memory: unpacking.in_memory / opened, ..unpacking };
    let open = |(number, source): (usize, &ListedPiece)| match wanted.pieces.hold(number) {
        true => source.open(share).map(Some),
        false => Ok(None),
    };
    // Reads all pieces before it returns, so that the error is always that of the first faulty
    // piece.
    let read: Vec<_> = sources.par_iter().enumerate().map(open).collect();
    let (mut files, mut left_out) = (Vec::new(), Vec::new());
    for read in read {
        match read? {
            // Removes ghosts piece by piece, because some pieces may lack flags.
            Some(Ok(file)) => files.push(Some(file.without_ghosts())),
            Some(Err(other)) => {
                left_out.push(other);
                files.push(None);
            }
            None => files.push(None),
        }
    }
    if left_out.len() == files.len() {
        return Err(fail(no_particles(&left_out)));
    }
    let paths: Vec<&Path> = sources.iter().map(|source| &*source.path).collect();
    refuse_other_scales(&paths, &files, wanted.attributes)?;
    let file = join_files(files, wanted.pieces)
        .map_err(|(piece, fault)| ReadError::new(paths[piece], fault))?;
    left_out.extend(file.left_out);
    Ok(ParticleFile { format, left_out, ..file })
}

/// Whether the pieces form a mesh: a cell of a piece has an area or a volume, or every piece is an
/// empty mesh.
///
/// # Errors
/// [`ReadError`] if the pieces cannot be read.
pub fn has_faces(path: &Path) -> Result<bool, ReadError> {
    let mut is_empty_mesh = true;
    for piece in pieces(path)? {
        let bytes = open_bytes(&piece)?;
        let found = unless_inline(bytes).and_then(|bytes| contents(bytes.view()));
        match found.map_err(|fault| ReadError::new(&piece, fault))? {
            PieceContents::Faces => return Ok(true),
            PieceContents::EmptyMesh => {}
            PieceContents::Particles => is_empty_mesh = false,
        }
    }
    Ok(is_empty_mesh)
}

/// The paths of the pieces in a .pvtp or .pvtu, or of the blocks in a .vtm.
///
/// # Errors
/// [`ReadError`] if the list cannot be read.
pub fn pieces(path: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let sources = Sources::parse(path, &open_whole(path)?)?.sources;
    Ok(sources.into_iter().map(|source| source.path).collect())
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
    begun: bool,
}

impl JoinedMesh {
    fn add(
        &mut self,
        NumberedMesh { mesh: piece, numbers }: NumberedMesh,
    ) -> Result<(), ReadFault> {
        if piece.positions.is_empty() {
            return Ok(());
        }
        if !std::mem::replace(&mut self.begun, true) {
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

/// A file that a list names.
struct ListedPiece {
    path: PathBuf,
    /// The name of the block, if the file is a block. A block may contain particles or other data.
    block: Option<String>,
}

impl ListedPiece {
    /// Reads the particles. For a block without particles, returns a description of its contents.
    fn open(&self, unpacking: Unpacking) -> Result<Result<ParticleFile, UnreadPart>, ReadError> {
        let fail = |fault| ReadError::new(&self.path, fault);
        let open = || open_bytes_within(&self.path, unpacking);
        let Some(name) = &self.block else {
            return read_particles(open()?, unpacking).map(Ok).map_err(fail);
        };
        let read = match extension(&self.path).as_deref() {
            Some("vtp" | "vtu") => read_block(open()?, unpacking).map_err(fail)?,
            _ => Err(described_format(&self.path)),
        };
        Ok(read.map_err(|holds| UnreadPart::Block { name: name.clone(), holds }))
    }
}

/// The files that a list and its nested lists name.
struct Sources {
    sources: Vec<ListedPiece>,
    format: &'static str,
}

/// Maximum depth of nested lists.
const MOST_NESTED: usize = 8;

impl Sources {
    fn parse(path: &Path, bytes: &[u8]) -> Result<Self, ReadError> {
        let mut all = Self { sources: Vec::new(), format: "" };
        let mut seen = HashSet::new();
        all.format = all.add(path, bytes, &mut seen, 0)?;
        Ok(all)
    }

    /// Adds the files of a list and its nested lists. Returns the format of the list.
    fn add(
        &mut self,
        path: &Path,
        bytes: &[u8],
        seen: &mut HashSet<PathBuf>,
        depth: usize,
    ) -> Result<&'static str, ReadError> {
        let fail = |fault| ReadError::new(path, fault);
        let List { files, format } = List::parse(bytes).map_err(fail)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        for PieceFile { name, block } in files {
            let path = resolved(folder, &name);
            if !seen.insert(path.clone()) {
                return Err(fail(malformed(0, format!("the list names the piece {name} twice"))));
            }
            let is_list = InputFormat::of(&path) == Some(InputFormat::Pvtp);
            if block.is_none() || !is_list {
                self.sources.push(ListedPiece { path, block });
            } else if depth == MOST_NESTED {
                let what = format!("lists are nested more than {MOST_NESTED} levels deep");
                return Err(fail(ReadFault::Unsupported(what)));
            } else {
                self.add(&path, &open_whole(&path)?, seen, depth + 1)?;
            }
        }
        Ok(format)
    }
}

/// The contents of one list.
struct List {
    files: Vec<PieceFile>,
    format: &'static str,
}

/// An entry of a list.
struct PieceFile {
    name: String,
    block: Option<String>,
}

impl List {
    fn parse(bytes: &[u8]) -> Result<Self, ReadFault> {
        let (mut files, mut format) = (Vec::new(), None);
        each_tag(bytes, |tag| {
            match (tag.tag.name().as_ref(), format) {
                ("VTKFile", _) => format = Some(Format::of(tag)?),
                ("Piece", Some(Format { blocks: false, .. })) => {
                    let name = tag.value("Source")?.filter(|source| !source.is_empty());
                    let name = name.ok_or_else(|| malformed(tag.at, "a piece has no Source"))?;
                    files.push(PieceFile { name, block: None });
                }
                // An empty block names no file.
                ("DataSet", Some(Format { blocks: true, .. })) => {
                    if let Some(name) = tag.value("file")?.filter(|name| !name.is_empty()) {
                        let block = tag.value("name")?.unwrap_or_else(|| name.clone());
                        files.push(PieceFile { name, block: Some(block) });
                    }
                }
                _ => {}
            }
            Ok(())
        })?;
        let Format { name, .. } =
            format.ok_or_else(|| malformed(0, "the file has no <VTKFile>"))?;
        if files.is_empty() {
            return Err(malformed(0, "names no pieces"));
        }
        Ok(Self { files, format: name })
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
