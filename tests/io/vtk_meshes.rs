//! Tests that a file of any VTK format is a mesh if a cell has an area or a volume, and otherwise
//! contains particles.

use std::fs;
use std::path::{Path, PathBuf};

use meniscus::error::Error;
use meniscus::files::{Info, frames, info};
use meniscus::internals::io::bytes::Unpacking;
use meniscus::internals::io::input::{holds_mesh, open_particles};
use meniscus::internals::io::{ParticleFile, ReadError, ReadFault};
use tempfile::TempDir;

use crate::build::{Compressor, Placed, VtkXml, tuples};
use crate::common::particle_files::positions;

fn open(path: &Path) -> Result<ParticleFile, ReadError> {
    open_particles(path, Unpacking::in_memory())
}

/// The number of faces in the error that refuses a file because it is a mesh.
#[track_caller]
fn faces(path: &Path) -> u64 {
    let error = open(path).expect_err("the file contains a mesh");
    let ReadFault::Mesh { faces } = error.fault else { panic!("{error}") };
    faces
}

fn written(folder: &TempDir, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, content).unwrap();
    path
}

/// A .vtu file in text with two pieces. The first has the points (i, i, i) for i from 0 to 2, and
/// the second for i from 3 to 4. `types` contains the cell types of each piece.
fn grid(types: [&str; 2]) -> String {
    let piece = |points: &[usize], types: &str| {
        let numbers = |all: &mut dyn Iterator<Item = usize>| {
            all.map(|number| number.to_string()).collect::<Vec<_>>().join(" ")
        };
        let at = numbers(&mut points.iter().flat_map(|&i| [i; 3]));
        format!(
            "<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\"><Points>\
             <DataArray type=\"Float64\" NumberOfComponents=\"3\">{at}</DataArray></Points>\
             <Cells><DataArray type=\"UInt8\" Name=\"types\">{types}</DataArray></Cells></Piece>",
            points.len(),
            types.split_whitespace().count(),
        )
    };
    format!(
        "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid>{}{}</UnstructuredGrid></VTKFile>",
        piece(&[0, 1, 2], types[0]),
        piece(&[3, 4], types[1]),
    )
}

#[test]
fn a_vtu_cell_with_an_area_or_volume_makes_a_mesh_in_every_encoding() {
    let folder = TempDir::new().unwrap();
    let points = tuples(5);
    let list = "<VTKFile type=\"PUnstructuredGrid\"><PUnstructuredGrid><Piece Source=\"a.vtu\"/>\
                </PUnstructuredGrid></VTKFile>";
    let list = written(&folder, "a.pvtu", list);
    for layout in VtkXml::all() {
        // An empty cell, a vertex, several vertices, a line and several lines do not make the file
        // a mesh.
        let path = written(&folder, "a.vtu", layout.build_cells(&points, &[0., 1., 2., 3., 4.]));
        for path in [&path, &list] {
            assert_eq!(positions(&open(path).unwrap()), points, "{layout:?}");
            assert!(!holds_mesh(path).unwrap(), "{layout:?}");
        }
        for (types, count) in [
            ([5., 1., 1., 1., 1.], 1),
            ([1., 1., 1., 1., 7.], 1),
            ([3., 12., 1., 10., 42.], 3),
            ([1., 1., -1., 1., 1.], 1),
        ] {
            written(&folder, "a.vtu", layout.build_cells(&points, &types));
            for path in [&path, &list] {
                assert_eq!(faces(path), count, "{layout:?} {types:?}");
                assert!(holds_mesh(path).unwrap(), "{layout:?} {types:?}");
            }
        }
    }
}

#[test]
fn every_piece_of_a_vtu_counts_but_undeclared_cells_do_not() {
    let folder = TempDir::new().unwrap();
    let count = |types| faces(&written(&folder, "a.vtu", grid(types)));
    assert_eq!(count(["1 1 1", "1 9"]), 1);
    assert_eq!(count(["10 8", "5 3"]), 3);
    for types in [["1 1 1", "1 1"], ["2", "3"], ["", "1 1"], ["", ""]] {
        let path = written(&folder, "a.vtu", grid(types));
        assert_eq!(positions(&open(&path).unwrap()), [0, 1, 2, 3, 4].map(|i| [f64::from(i); 3]));
        assert!(!holds_mesh(&path).unwrap(), "{types:?}");
    }
    let none = grid(["10", ""]).replace("NumberOfCells=\"1\"", "NumberOfCells=\"0\"");
    assert_eq!(positions(&open(&written(&folder, "a.vtu", none)).unwrap()).len(), 5);
}

#[test]
fn cell_types_after_the_first_face_are_not_read() {
    let folder = TempDir::new().unwrap();
    let path = written(&folder, "a.vtu", grid(["1 10 wrong", "1"]));
    assert!(holds_mesh(&path).unwrap());
    // The error of `open` gives the number of faces, so `open` reads all cell types.
    assert!(matches!(open(&path).unwrap_err().fault, ReadFault::Line { .. }));
    let path = written(&folder, "a.vtu", grid(["1 wrong 10", "1"]));
    holds_mesh(&path).unwrap_err();
}

#[test]
fn blocks_of_cell_types_after_the_first_face_are_not_decompressed() {
    let folder = TempDir::new().unwrap();
    let points = tuples(20);
    let is_packed =
        |l: &VtkXml| l.placed == Placed::AppendedRaw && l.compressor == Compressor::Zlib;
    for layout in VtkXml::all().into_iter().filter(is_packed) {
        for (first, is_mesh) in [(5.0, Some(true)), (1.0, None)] {
            // The cell types are the last array, in three blocks. Below, the checksum of the last
            // block is damaged.
            let types: Vec<f64> = (0..20).map(|cell| if cell == 0 { first } else { 1.0 }).collect();
            let mut bytes = layout.build_cells(&points, &types);
            let end = bytes.len() - "\n</AppendedData></VTKFile>\n".len();
            bytes[end - 1] ^= 1;
            let path = written(&folder, "a.vtu", bytes);
            assert_eq!(holds_mesh(&path).ok(), is_mesh, "{layout:?}");
        }
    }
}

#[test]
fn a_file_without_points_is_a_mesh_only_if_all_its_cells_are_polygons() {
    let folder = TempDir::new().unwrap();
    let cells = |name: &str| {
        format!("<{name}><DataArray type=\"Int32\" Name=\"offsets\"></DataArray></{name}>")
    };
    let [polys, verts] = ["Polys", "Verts"].map(cells);
    for (name, kind, cells, is_mesh) in [
        ("a.vtp", "PolyData", &*polys, true),
        // VTK also writes empty arrays.
        ("a.vtp", "PolyData", &format!("{verts}{polys}"), false),
        ("a.vtp", "PolyData", "", false),
        ("a.vtu", "UnstructuredGrid", "", false),
    ] {
        let text = format!(
            "<VTKFile type=\"{kind}\"><{kind}><Piece NumberOfPoints=\"0\">{cells}</Piece></{kind}>\
             </VTKFile>"
        );
        let path = written(&folder, name, text);
        assert_eq!(holds_mesh(&path).unwrap(), is_mesh, "{name}: {cells}");
        let found = info(&path).unwrap();
        assert_eq!(matches!(found, Info::Particles(_)), !is_mesh, "{name}: {cells}");
    }
}

#[test]
fn a_grid_is_refused_as_particles_with_the_same_reason_in_every_format() {
    let folder = TempDir::new().unwrap();
    let points: String = (0..8).map(|i| format!("{} {} {}\n", i & 1, i >> 1 & 1, i >> 2)).collect();
    written(
        &folder,
        "a.vtk",
        format!(
            "# vtk DataFile Version 3.0\ngrid\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 8 float\n\
             {points}CELLS 1 9\n8 0 1 3 2 4 5 7 6\nCELL_TYPES 1\n12\n"
        ),
    );
    written(
        &folder,
        "a.vtu",
        format!(
            "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid>\
             <Piece NumberOfPoints=\"8\" NumberOfCells=\"1\"><Points><DataArray type=\"Float32\" \
             NumberOfComponents=\"3\">{points}</DataArray></Points><Cells>\
             <DataArray type=\"UInt8\" Name=\"types\">12</DataArray></Cells></Piece>\
             </UnstructuredGrid></VTKFile>"
        ),
    );
    for name in ["a.vtk", "a.vtu"] {
        assert_eq!(faces(&folder.path().join(name)), 1, "{name}");
    }
    // The library reads no meshes from .vtu files, so `info` tries to read particles.
    let error = info(folder.path().join("a.vtu")).unwrap_err();
    let Error::Read(ReadError { fault: ReadFault::Mesh { faces: 1 }, .. }) = error else {
        panic!("{error}")
    };
}

#[test]
fn grids_in_a_folder_of_particles_are_not_taken_for_frames() {
    let folder = TempDir::new().unwrap();
    let particles = VtkXml::all()[0].build(&tuples(5));
    let list = "<VTKFile type=\"PUnstructuredGrid\"><PUnstructuredGrid>\
                <Piece Source=\"piece.vtu\"/></PUnstructuredGrid></VTKFile>";
    written(&folder, "piece.vtu", grid(["9", ""]));
    for frame in 1..=2 {
        written(&folder, &format!("fluid_{frame}.vtu"), &particles);
        written(&folder, &format!("wall_{frame}.vtu"), grid(["9 9", "9"]));
        written(&folder, &format!("floor_{frame}.pvtu"), list);
    }
    let frames = frames(&[folder.path().to_owned()]).unwrap();
    let paths: Vec<_> = frames.iter().map(|frame| frame.path.clone()).collect();
    assert_eq!(paths, [1, 2].map(|frame| folder.path().join(format!("fluid_{frame}.vtu"))));
}
