//! Tests that the division of a mesh into pieces does not change its file, and that no file remains
//! if a piece cannot be read.

use std::borrow::Cow;
use std::fs;
use std::io;
use std::ops::Range;

use meniscus::internals::io::alembic::SampleTime;
use meniscus::internals::io::output::{MeshFormat, MeshOutput, read_mesh};
use meniscus::internals::io::whole::Replace;
use meniscus::internals::io::{CoordinateWidth, UpAxis, WriteFault};
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::source::{MeshSource, Outline, Vertices};

use crate::common::shapes::{torus, with_attributes};

const FORMATS: [MeshFormat; 8] = [
    MeshFormat::Ply,
    MeshFormat::Obj,
    MeshFormat::Vtk,
    MeshFormat::Vtp,
    MeshFormat::VtkHdf,
    MeshFormat::Stl,
    MeshFormat::Usdc(UpAxis::Y),
    MeshFormat::Abc(SampleTime::ZERO),
];

/// A source that divides a mesh into pieces, which are ranges of vertices and triangles.
struct Cut {
    mesh: Mesh,
    pieces: Vec<[Range<usize>; 2]>,
    /// The piece whose vertices cannot be read, and the piece whose triangles cannot be read.
    lost: [Option<usize>; 2],
}

impl Cut {
    /// Divides a mesh into pieces. `vertices` and `triangles` are the numbers of vertices and of
    /// triangles in each piece except the last, which contains the rest of the mesh.
    fn new(mesh: &Mesh, vertices: &[usize], triangles: &[usize]) -> Self {
        let ranges = |sizes: &[usize], all: usize| -> Vec<Range<usize>> {
            let ends = sizes.iter().scan(0, |end, size| {
                *end += size;
                Some(*end)
            });
            let ends: Vec<_> = ends.chain([all]).collect();
            std::iter::once(0)
                .chain(ends.clone())
                .zip(ends)
                .map(|(start, end)| start..end)
                .collect()
        };
        let vertices = ranges(vertices, mesh.positions.len());
        let triangles = ranges(triangles, mesh.triangles.len());
        let pieces = vertices.into_iter().zip(triangles).map(|(v, t)| [v, t]).collect();
        Self { mesh: mesh.clone(), pieces, lost: [None; 2] }
    }

    fn range(&self, what: usize, piece: usize) -> io::Result<Range<usize>> {
        match self.lost[what] {
            Some(lost) if lost == piece => Err(io::Error::other(format!("piece {piece} is lost"))),
            _ => Ok(self.pieces[piece][what].clone()),
        }
    }
}

impl MeshSource for Cut {
    fn outline(&self) -> Outline {
        Outline {
            vertices: self.mesh.vertex_count(),
            triangles: self.mesh.triangle_count(),
            normals: self.mesh.has_normals(),
            attributes: self.mesh.attributes(),
            pieces: self.pieces.len(),
            lattice: None,
        }
    }

    fn vertices(&self, piece: usize) -> io::Result<Vertices<'_>> {
        let range = self.range(0, piece)?;
        let Mesh { positions, normals, attributes, .. } = &self.mesh;
        Ok(Vertices {
            positions: Cow::Owned(positions[range.clone()].to_vec()),
            normals: normals.as_ref().map_or(Cow::default(), |n| n[range.clone()].to_vec().into()),
            attributes: attributes
                .iter()
                .map(|a| {
                    a.values[range.start * a.components..range.end * a.components].to_vec().into()
                })
                .collect(),
        })
    }
    fn triangles(&self, piece: usize) -> io::Result<Vec<[u64; 3]>> {
        let range = self.range(1, piece)?;
        Ok(self.mesh.triangles[range].iter().map(|t| t.map(u64::from)).collect())
    }
}

fn written(format: MeshFormat, mesh: &dyn MeshSource, width: CoordinateWidth) -> Vec<u8> {
    let mut bytes = Vec::new();
    format.write(&mut bytes, mesh, width).unwrap();
    bytes
}

/// Several divisions of a mesh: with empty pieces, with tiny pieces, and with all vertices in one
/// piece and all triangles in another.
fn cuts(mesh: &Mesh) -> [Cut; 4] {
    let [vertices, triangles] = [mesh.positions.len(), mesh.triangles.len()];
    let ones: Vec<_> = (0..99).map(|i| i % 2).collect();
    let twos: Vec<_> = (0..99).map(|i| i % 3).collect();
    [
        Cut::new(mesh, &[], &[]),
        Cut::new(mesh, &[vertices, 0], &[0, triangles]),
        Cut::new(mesh, &[0, 0, 0, vertices], &[0, triangles, 0, 0]),
        Cut::new(mesh, &ones, &twos),
    ]
}

#[test]
fn the_bytes_of_a_mesh_are_independent_of_its_pieces() {
    let bare = torus(200, 100);
    assert!(bare.pieces() > 1, "the mesh has only one piece");
    for mesh in [Mesh::default(), with_attributes(torus(200, 100)), bare] {
        for format in FORMATS {
            for width in [CoordinateWidth::F32, CoordinateWidth::F64] {
                let whole = written(format, &mesh, width);
                let small = mesh.positions.is_empty();
                let cuts = if small {
                    vec![Cut::new(&mesh, &[0, 0], &[0, 0])]
                } else {
                    cuts(&mesh).into()
                };
                for (number, cut) in cuts.iter().enumerate() {
                    assert!(
                        written(format, cut, width) == whole,
                        "{format} {width:?}, cut {number}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_source_without_pieces_is_read_back_as_an_empty_mesh() {
    let none = Cut { mesh: Mesh::default(), pieces: Vec::new(), lost: [None; 2] };
    let folder = tempfile::tempdir().unwrap();
    for format in FORMATS.into_iter().filter(|format| format.is_read()) {
        let path = folder.path().join(format!("a{format}"));
        fs::write(&path, written(format, &none, CoordinateWidth::F32)).unwrap();
        let read = read_mesh(&path).unwrap_or_else(|fault| panic!("{fault}"));
        assert_eq!(read, Mesh::default(), "{format}");
    }
}

#[test]
fn an_unreadable_piece_fails_the_write_and_leaves_no_file() {
    let mesh = with_attributes(torus(40, 30));
    for format in FORMATS {
        for (lost, first) in
            [([Some(3), None], 3), ([None, Some(50)], 50), ([Some(99), Some(0)], 99)]
        {
            let [.., mut cut] = cuts(&mesh);
            cut.lost = lost;
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join(format!("a{format}"));
            let output = MeshOutput::prepare(&path, Replace::Refuse).unwrap();
            let fault = output.write(&cut, CoordinateWidth::F32).unwrap_err();
            assert_eq!(fault.path, path);
            assert!(matches!(&fault.fault, WriteFault::Io(_)), "{format}: {fault}");
            assert!(
                fault.to_string().ends_with(&format!("piece {first} is lost")),
                "{format}: {fault}"
            );
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "{format}");
        }
    }
}

#[test]
#[should_panic = "all vertices are in the pieces"]
fn writing_pieces_with_a_missing_vertex_panics() {
    let mut cut = Cut::new(&torus(40, 30), &[10, 10], &[5, 5]);
    cut.pieces[1][0].end -= 1;
    written(MeshFormat::Ply, &cut, CoordinateWidth::F32);
}

#[test]
#[should_panic = "a triangle refers to vertex"]
fn writing_a_triangle_with_a_missing_vertex_panics() {
    let mut mesh = torus(40, 30);
    mesh.triangles[7][1] = 1200;
    written(MeshFormat::Obj, &mesh, CoordinateWidth::F32);
}

#[test]
#[should_panic = "one normal per vertex"]
fn writing_more_normals_than_vertices_panics() {
    let mesh =
        Mesh { normals: Some(vec![[0.; 3]; 9]), positions: vec![[0.; 3]; 8], ..Mesh::default() };
    written(MeshFormat::Vtp, &mesh, CoordinateWidth::F32);
}
