//! VTK's parallel XML: a .pvtp or .pvtu names its pieces, .vtp or .vtu files in other places
//! relative to it, whose points are one set.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use quick_xml::Reader;
use quick_xml::events::Event;
use rayon::prelude::*;

use crate::io::bytes::{Bytes, Unpacking, open_bytes, open_bytes_within, open_whole};
use crate::io::vertices::Triangles;
use crate::io::wanted::Wanted;
use crate::io::{ParticleFile, Pieces, ReadError, ReadFault, malformed};
use crate::surface::mesh::Mesh;

use super::layout::Tag;
use super::read::{NumberedMesh, counts, read_numbered, read_particles, unless_text};

/// Reads the points of all pieces that are wanted as particles, in the order of the pieces.
///
/// # Errors
/// As [`read_particles`](super::read_particles), each with the piece that it concerns; a missing
/// piece is [`ReadFault::Io`].
pub fn open_particles(
    path: &Path,
    bytes: Bytes,
    wanted: Wanted,
    unpacking: Unpacking,
) -> Result<ParticleFile, ReadError> {
    let list = bytes.read_whole(unpacking).map_err(|fault| ReadError::new(path, fault))?;
    let Sources { paths, format } = Sources::parse(path, &list)?;
    let opened = wanted.pieces.of(paths.len()).max(1) as u64;
    let share = Unpacking { in_memory: unpacking.in_memory / opened, ..unpacking };
    let open = |(number, piece): (usize, &PathBuf)| {
        if !wanted.pieces.hold(number) {
            return Ok(ParticleFile::new(Pieces::default(), format));
        }
        let bytes = open_bytes_within(piece, share)?;
        read_particles(bytes, share).map_err(|fault| ReadError::new(piece, fault))
    };
    // All are waited for, so that the error is the first piece's.
    let files: Vec<_> = paths.par_iter().enumerate().map(open).collect();
    let files = files.into_iter().collect::<Result<Vec<_>, _>>()?;
    let time = files.iter().find_map(|file| file.time);
    let ghosts = files.iter().map(|file| file.ghosts).sum();
    let all = files.into_iter().map(|file| file.particles).collect();
    let particles =
        Pieces::join(all).map_err(|(piece, fault)| ReadError::new(&paths[piece], fault))?;
    Ok(ParticleFile { time, ghosts, ..ParticleFile::new(particles, format) })
}

/// Whether there are polygons in any piece, or nothing at all in all of them.
///
/// # Errors
/// [`ReadError`] where the pieces cannot be read.
pub fn has_faces(path: &Path) -> Result<bool, ReadError> {
    let mut points = 0;
    for piece in pieces(path)? {
        let bytes = open_bytes(&piece)?;
        let found = unless_text(bytes).and_then(|bytes| counts(bytes.view()));
        let found = found.map_err(|fault| ReadError::new(&piece, fault))?;
        if found.faces > 0 {
            return Ok(true);
        }
        points += found.points;
    }
    Ok(points == 0)
}

/// The pieces that a .pvtp or .pvtu names.
///
/// # Errors
/// [`ReadError`] where it cannot be read.
pub fn pieces(path: &Path) -> Result<Vec<PathBuf>, ReadError> {
    Ok(Sources::parse(path, &open_whole(path)?)?.paths)
}

/// Reads the triangles of all pieces as one mesh. Vertices of different pieces are one where the
/// pieces give them the same number in an array of global identifiers; without that they stay
/// apart.
///
/// # Errors
/// As [`read_mesh`](super::read_mesh), each with the piece that it concerns.
pub fn read_mesh(path: &Path) -> Result<Mesh, ReadError> {
    let mut all = Joined::default();
    for piece in pieces(path)? {
        let fail = |fault| ReadError::new(&piece, fault);
        let mesh = read_numbered(&open_whole(&piece)?).map_err(fail)?;
        all.add(mesh).map_err(fail)?;
    }
    Ok(all.mesh)
}

/// The mesh of the pieces so far.
#[derive(Default)]
struct Joined {
    mesh: Mesh,
    /// The vertex that has a global identifier.
    known: HashMap<i64, u32>,
    begun: bool,
}

impl Joined {
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
            self.mesh.attributes.iter_mut().for_each(|attribute| attribute.values.clear());
        }
        let all = &mut self.mesh;
        let kind = |mesh: &Mesh| -> Vec<(String, usize)> {
            let normals = mesh.normals.iter().map(|_| ("Normals".to_owned(), 3));
            normals.chain(mesh.attributes.iter().map(|a| (a.name.clone(), a.components))).collect()
        };
        let [expected, found] = [kind(all), kind(&piece)];
        if expected != found {
            let what = format!("its arrays are {found:?}, those of the pieces before {expected:?}");
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
                    all.values.extend(&own.values[vertex * own.components..][..own.components]);
                }
            }
        }
        Triangles::new(all.positions.len())?;
        all.triangles.extend(piece.triangles.iter().map(|t| t.map(|corner| own[corner as usize])));
        Ok(())
    }
}

/// The pieces' paths.
struct Sources {
    paths: Vec<PathBuf>,
    format: &'static str,
}

impl Sources {
    fn parse(path: &Path, bytes: &[u8]) -> Result<Self, ReadError> {
        let fail = |fault| ReadError::new(path, fault);
        let (names, format) = names(bytes).map_err(fail)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut seen = HashSet::new();
        if let Some(twice) = names.iter().find(|name| !seen.insert(*name)) {
            return Err(fail(malformed(0, format!("the piece {twice} is named twice"))));
        }
        Ok(Self { paths: names.iter().map(|name| folder.join(name)).collect(), format })
    }
}

/// The pieces' names, and what they are.
fn names(bytes: &[u8]) -> Result<(Vec<String>, &'static str), ReadFault> {
    if !bytes.trim_ascii_end().ends_with(b"</VTKFile>") {
        return Err(malformed(bytes.len(), "the file ends without </VTKFile>"));
    }
    let mut xml = Reader::from_reader(bytes);
    let (mut names, mut format) = (Vec::new(), None);
    loop {
        let at = xml.buffer_position() as usize;
        let event = xml
            .read_event()
            .map_err(|fault| malformed(xml.error_position() as usize, fault.to_string()))?;
        let tag = match &event {
            Event::Start(tag) | Event::Empty(tag) => Tag { tag, at },
            Event::Eof => break,
            _ => continue,
        };
        match tag.tag.name().as_ref() {
            "VTKFile" => {
                let kind = tag.value("type")?.unwrap_or_default();
                format = Some(match kind.as_str() {
                    "PPolyData" => "VTK XML .pvtp",
                    "PUnstructuredGrid" => "VTK XML .pvtu",
                    _ => {
                        let what = "points are read from PPolyData and PUnstructuredGrid";
                        return Err(ReadFault::Unsupported(format!(
                            "a data set of type {kind:?}; {what}"
                        )));
                    }
                });
            }
            "Piece" => {
                let source = tag.value("Source")?.filter(|source| !source.is_empty());
                names.push(source.ok_or_else(|| malformed(at, "a piece without a Source"))?);
            }
            _ => {}
        }
    }
    let format = format.ok_or_else(|| malformed(0, "no <VTKFile>"))?;
    if names.is_empty() {
        return Err(malformed(0, "it names no pieces"));
    }
    Ok((names, format))
}
