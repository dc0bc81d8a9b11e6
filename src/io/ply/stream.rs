//! A mesh that is read piece by piece from its .ply file.

use std::io;

use crate::io::bytes::{Bytes, Unpacking};
use crate::io::columns::{Endian, Scalar};
use crate::io::pieces::Pieces;
use crate::io::windows::{InputBytes, Windows};
use crate::io::{ReadFault, malformed};
use crate::particles::{AttributeInfo, AttributeKind, Particles, RereadError, velocity_attribute};
use crate::surface::mesh::source::{MeshSource, Outline, Vertices};

use super::header::{Encoding, PlyHeader};
use super::read::{faces, start, vertices};

/// Number of vertices or triangles per piece.
const PIECE: usize = 1 << 15;
/// Size, in bytes, of a triangle: one byte for the number of corners, and three vertex indices.
const ROW: usize = 1 + 3 * size_of::<u32>();

/// The mesh of a binary .ply file. Only the pieces that are being read are in memory.
#[derive(Debug)]
pub struct StreamedMesh {
    vertices: Pieces,
    /// The index of the attribute with the normals.
    normals: Option<usize>,
    /// The indices of all other attributes.
    others: Vec<usize>,
    faces: InputBytes,
    /// Byte offset of the first triangle in the file.
    at: usize,
    outline: Outline,
}

impl StreamedMesh {
    /// Opens a mesh in the form that this library writes: little-endian, with only triangles of
    /// 32-bit vertex indices, and nothing after them. Returns `None` for other files.
    ///
    /// `bytes` and `again` are the same file, opened twice to read vertices and faces
    /// independently.
    ///
    /// # Errors
    /// The errors of [`read_mesh`](super::read_mesh) about the header.
    pub fn open(bytes: Bytes, again: Bytes) -> Result<Option<Self>, ReadFault> {
        let header = PlyHeader::parse(bytes.view())?;
        let Some((element, _)) = faces(&header)? else { return Ok(None) };
        let is_list = |of: &super::header::PlyProperty| {
            of.list == Some(Scalar::U8) && matches!(of.scalar, Scalar::I32 | Scalar::U32)
        };
        let fits = header.encoding == Encoding::Binary(Endian::Little)
            && matches!(&element.properties[..], [list] if is_list(list))
            && matches!(&header.elements[..], [before @ .., last]
                if std::ptr::eq(last, element) && before.iter().all(|element| element.row().is_some()));
        if !fits {
            return Ok(None);
        }
        let view = bytes.view();
        let at = start(view, &header, element)?;
        let triangles = element.count;
        if triangles.checked_mul(ROW).and_then(|rows| rows.checked_add(at)) != Some(view.len()) {
            return Ok(None);
        }
        let read = vertices(view, &header, Unpacking::in_memory())?;
        let (count, normals) = (read.count, read.normals);
        let vertices = read.into_particles(bytes, "PLY").particles;
        let all = vertices.attributes();
        let others: Vec<usize> = (0..all.len()).filter(|&index| Some(index) != normals).collect();
        let velocity = velocity_attribute(all);
        let info = |&index: &usize| AttributeInfo {
            name: if Some(index) == velocity {
                "velocity".to_owned()
            } else {
                all[index].name.clone()
            },
            kind: all[index].kind.of_mesh(),
            components: all[index].components,
        };
        let outline = Outline {
            vertices: count as u64,
            triangles: triangles as u64,
            normals: normals.is_some(),
            attributes: others.iter().map(info).collect(),
            pieces: count.max(triangles).div_ceil(PIECE),
            lattice: None,
        };
        Ok(Some(Self { vertices, normals, others, faces: again.into(), at, outline }))
    }
}

impl MeshSource for StreamedMesh {
    fn outline(&self) -> Outline {
        self.outline.clone()
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        let range = range(piece, self.outline.vertices);
        let (first, count) = (range.start, range.len());
        let mut positions = vec![[0.0; 3]; count];
        self.vertices.positions(first, &mut positions);
        let attribute = |&index: &usize| {
            let info = &self.vertices.attributes()[index];
            let mut values = vec![0.0; count * info.components];
            if info.kind.is_whole() {
                let mut whole = vec![0; values.len()];
                self.vertices.integers(index, first, &mut whole);
                return whole.into_iter().map(AttributeKind::word).collect();
            }
            self.vertices.attribute(index, first, &mut values);
            values.into()
        };
        let normals = self.normals.map_or_else(Vec::new, |index| {
            let mut normals = vec![[0.0; 3]; count];
            self.vertices.attribute(index, first, normals.as_flattened_mut());
            normals
        });
        let attributes = self.others.iter().map(attribute).collect();
        self.vertices.check().map_err(unread)?;
        Ok(Vertices { positions: positions.into(), normals: normals.into(), attributes })
    }

    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        let range = range(piece, self.outline.triangles);
        let bytes = self.at + range.start * ROW..self.at + range.end * ROW;
        let corners = |row: &[u8; ROW]| {
            let [count, numbers @ ..] = row;
            let number = |n: usize| {
                let bytes = [0, 1, 2, 3].map(|byte| numbers[4 * n + byte]);
                u64::from(u32::from_le_bytes(bytes))
            };
            (*count == 3).then(|| [0, 1, 2].map(number))
        };
        let triangles: Option<Vec<_>> = self
            .faces
            .with(bytes.clone(), |bytes| bytes.as_chunks().0.iter().map(corners).collect());
        self.faces.check().map_err(unread)?;
        triangles.ok_or_else(|| {
            let what = "some faces are not triangles, so the mesh cannot be read piece by piece";
            io::Error::new(io::ErrorKind::InvalidData, malformed(bytes.start, what))
        })
    }
}

fn range(piece: usize, of: u64) -> std::ops::Range<usize> {
    (piece * PIECE).min(of as usize)..((piece + 1) * PIECE).min(of as usize)
}

fn unread(fault: RereadError) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, fault)
}
